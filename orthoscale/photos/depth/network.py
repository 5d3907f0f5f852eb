"""A metric depth network, from a user's ONNX file; it runs in a process of its own (`detect.foreign`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...core.source import Picture
from ...detect.detector import IMAGE_TYPES, load_foreign, read_network
from ...detect.foreign import ForeignError
from ...detect.workers import cores
from ...errors import InputError, UsageError
from .rules import Rule

PATCH = 14  # [px] side of the patches of vision transformers; sides of an input of free size are multiples of it
LONGEST_LOOK = 300.0  # [s] limit for one picture: large transformers on two cores
DEPTH_OUTPUTS = ("depth", "predicted_depth", "metric_depth")  # names of the depth among several outputs
NETWORK_HINT = "Export it with one picture [1, 3, height, width] as input and the depth as output."


class DepthNetwork:
    """Gives the depth of a picture in the network's own unit. Raises InputError for a network that is not for depth."""

    def __init__(self, path: Path, rule: Rule):
        """Load the network at `path`, whose input and unit are those of `rule`."""
        self.path, self.rule = path, rule
        self._worker = load_foreign(path, read_network(path), cores(), LONGEST_LOOK)
        inputs, outputs, _ = self._worker.said
        if len(inputs) != 1:
            asked = ", ".join(name for name, _, _ in inputs)
            raise InputError(f"{path}: a network with {len(inputs)} inputs ({asked}), not one picture", NETWORK_HINT)
        ((_, kind, shape),) = inputs
        channels = shape[-3] if len(shape) in (4, 5) else None
        if kind not in IMAGE_TYPES or len(shape) not in (4, 5) or (isinstance(channels, int) and channels != 3):
            raise InputError(f"{path}: its input is a {kind} of shape {shape}, not a picture", NETWORK_HINT)
        self._type, self._rank = IMAGE_TYPES[kind], len(shape)
        self._size = tuple(n if isinstance(n, int) and n > 0 else None for n in shape[-2:])
        names = [name for name, _, _ in outputs]
        chosen = [k for k, name in enumerate(names) if name in DEPTH_OUTPUTS] or ([0] if len(names) == 1 else [])
        if not chosen:
            raise InputError(f"{path}: which of its outputs is the depth? {', '.join(names)}", NETWORK_HINT)
        self._output = chosen[0]

    def __call__(self, picture: Picture) -> tuple[np.ndarray, float]:
        """The depth (H, W) float32 of all of `picture`, and the factor by which the picture was shrunk for the network:
        there its focal length in pixels is that many times shorter."""
        rows, columns = self._input_size(picture)
        scale = min(rows / picture.height, columns / picture.width)
        if self._size == (None, None):  # the picture fills the input; its sides may shrink a little differently
            high, wide = rows, columns
        else:
            high, wide = (max(1, round(side * scale)) for side in (picture.height, picture.width))
        top, left = (rows - high) // 2, (columns - wide) // 2
        how = self.rule.normalisation
        mean, sd = np.array(how.mean, np.float32), np.array(how.std, np.float32)
        pixels = picture.read(0, 0, picture.width, picture.height, wide, high)
        shown = np.empty((rows, columns, 3), np.float32)
        shown[:] = self.rule.padding
        shown[top : top + high, left : left + wide] = (pixels - mean) / sd
        tensor = shown.transpose(2, 0, 1).reshape((1,) * (self._rank - 3) + (3, rows, columns))
        try:
            depth = self._worker.run(tensor.astype(self._type))[self._output]
        except ForeignError as error:
            raise InputError(
                f"{self.path}: the network fails on an image of {columns} x {rows} px ({error})", NETWORK_HINT
            ) from error
        values = depth.astype(np.float32).reshape([n for n in depth.shape if n != 1])
        if values.ndim != 2:
            raise InputError(f"{self.path}: its output {list(depth.shape)} is not a depth map", NETWORK_HINT)
        return _cropped(values, rows, columns, (top, left, high, wide)), float(
            np.sqrt(picture.width * picture.height / (wide * high))
        )

    def _input_size(self, picture: Picture) -> tuple[int, int]:
        """Rows and columns of the input [px]."""
        if all(self._size):
            return self._size  # type: ignore[return-value]
        if any(self._size):
            raise UsageError(f"{self.path}: only one side of its input has a fixed size", NETWORK_HINT)
        shrink = self.rule.side / max(picture.width, picture.height)
        rows, columns = (max(PATCH, round(n * shrink / PATCH) * PATCH) for n in (picture.height, picture.width))
        return rows, columns


def _cropped(depth: np.ndarray, rows: int, columns: int, filled: tuple[int, int, int, int]) -> np.ndarray:
    """The part of `depth` that shows the picture, which took the part `filled` (top, left, height, width) of the input;
    the output may be smaller than the input."""
    top, left, high, wide = filled
    down, across = depth.shape[0] / rows, depth.shape[1] / columns
    return depth[
        round(top * down) : max(round((top + high) * down), 1), round(left * across) : round((left + wide) * across)
    ]
