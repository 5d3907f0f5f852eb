"""A detector: an ONNX network (the shipped one or a user's) and its card, which relates its boxes to vehicles."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..core.boxes import Boxes
from ..core.detections import UNKNOWN_HEIGHT, UNKNOWN_RULER
from ..core.ruler import Ruler
from ..core.source import NO_DATA_GREY
from ..errors import InputError
from ..formats.reading import decoded, read_bytes
from ..system.budget import memory, require
from . import foreign_worker
from .foreign import IMAGE_ALONE, NO_NETWORK, ForeignError, Said, Worker
from .output_forms import NetworkForm, Normalisation, Shape, recognise

SHIPPED = "small_vehicle.onnx"
FINDER = "finder.onnx"  # finds vehicles better than SHIPPED, and measures them worse
# A shared library with operators that onnxruntime lacks; MMDeploy's networks need its libmmdeploy_onnxruntime_ops.
OPERATORS = "ORTHOSCALE_ONNX_OPS"
OVERLAP = 128  # shared by neighbouring tiles or windows [px of the input]; more than the longest usable vehicle
VEHICLES = "vehicle"
CARD, CARD_HINT = "a network with an orthoscale card that can be read", "Export it with training.export."
LONGEST_CARD = 100_000  # characters
IMAGE_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}  # of input images
# Boxes of one kind in one image, before non-maximum suppression; real pictures have some hundreds.
MOST_BOXES = 10_000
CUT = 2.0  # boxes closer than this to the edge of a tile or window may be cut by it [px of the input]
CUT_OBJECT = 8.0  # the same for standard objects: they are larger, and so are the errors of their boxes


class Passes(StrEnum):
    """Which network makes the two passes over a picture, and in which order. What only the first pass sees is
    `doubtful`; the second may look only where the first saw anything.

    CONFIRMED : fine pass by the detector, coarse pass by the shipped FINDER, which confirms and does not measure.
    FINE_FIRST : both by the detector. COARSE_FIRST : both by the detector, the coarse one, at half the cost, first. A
    coarse pass makes half as many mistakes, so this is for many frames, where the share of confirmed boxes is not used.
    TWICE_CONFIRMED : both by the detector, the fine one first, and the FINDER must also see what they show. For single
    photos and orthophotos without the measurer: the detector's own boxes count there, and neither other views nor the
    measurer distinguish vehicles from glints and roofs.
    """

    CONFIRMED = "confirmed"
    FINE_FIRST = "fine first"
    COARSE_FIRST = "coarse first"
    TWICE_CONFIRMED = "twice, confirmed"


@dataclass(frozen=True)
class Card:
    """A detector's description, stored in the ONNX file's metadata under ``orthoscale``.

    usable_length : (low, high) vehicle lengths that it finds well [px of its input].
    best_length : the length at which it does best; the scale search aims for it [px of its input].
    score : the confidence above which a box counts in one pass.
    sure : the mean confidence of two passes above which a vehicle counts; 0 if it is enough that both show it.
    effective_height : the height up to which its boxes enclose a vehicle seen obliquely, along length and width [m].
    undercut : how far inside its outline a vehicle meets the ground, along length and width [m]; 0 if unknown.
    stride : height and width of its input must be multiples of this [px].
    body : the shape of the vehicles that it finds, one of `core.projection.exact.BODIES`.
    """

    name: str
    usable_length: tuple[float, float]
    best_length: float
    score: float
    effective_height: tuple[float, float]
    ruler: Ruler
    training: str = ""
    licence: str = ""
    undercut: tuple[float, float] = (0.0, 0.0)
    sure: float = 0.0
    stride: int = 32
    body: str = "car"
    normalisation: Normalisation = Normalisation()

    @classmethod
    def from_json(cls, text: str, origin: str = "the card") -> Card:
        """Parse the text in a file's metadata; messages call it `origin`. Raises InputError if it is not a card."""
        from msgspec import UNSET, structs

        from ..formats.schemas.networks import CardEntry

        if len(text) > LONGEST_CARD:
            raise InputError(f"{origin}: longer than the {LONGEST_CARD} characters that it may have", CARD_HINT)
        entry = decoded(text, CardEntry, origin, CARD, CARD_HINT)
        how = entry.normalisation
        values = structs.asdict(entry) | {
            "ruler": entry.ruler.ruler,
            "normalisation": Normalisation() if how is UNSET else Normalisation(**structs.asdict(how)),
        }
        del values["extra"]
        return cls(**values)

    @classmethod
    def unknown(cls, name: str) -> Card:
        """For a detector without a card: a ruler that nobody has measured, and the sizes at which detectors trained on
        DOTA do well. `orthoscale calibrate` measures the ruler. The score is that of arXiv 2603.07535."""
        return cls(name, (12.0, 90.0), 38.0, 0.5, UNKNOWN_HEIGHT, UNKNOWN_RULER)


class Detector:
    """Finds small vehicles in an RGB image. Holds one network; safe to call from several threads.

    The shipped network runs in this process. Any other runs in a process of its own, with limits on memory and time,
    and processes one image at a time (`foreign.Worker`).

    settings : (path, decoder, vehicle_classes, passes) with which another process makes the same detector.
    confirming : the shipped FINDER, if `passes` are CONFIRMED or TWICE_CONFIRMED; else None.
    notes : remarks for the user on what it found.
    """

    def __init__(
        self,
        path: Path | None = None,
        decoder: str | None = None,
        vehicle_classes: Sequence[str] = (),
        threads: int = 0,
        passes: Passes = Passes.FINE_FIRST,
        shipped: str = SHIPPED,
    ):
        """Load a network.

        path : an ONNX file; None for the shipped weights named `shipped`.
        decoder : the form of its outputs (`detect.output_forms.DECODERS`); None to recognise it.
        vehicle_classes : names or numbers of the classes that count, instead of those that are called small vehicles.
        threads : work on one image together; 0 for as many as there are cores.
        passes : how a sweep makes its two passes.
        Raises InputError, UsageError.
        """
        self.settings = (path, decoder, tuple(vehicle_classes), passes)
        confirmed = passes in (Passes.CONFIRMED, Passes.TWICE_CONFIRMED)
        self.confirming = Detector(threads=threads, shipped=FINDER) if confirmed else None
        self.passes = passes
        self.notes: list[str] = []
        self.path, content, self._network = load_network(path, shipped, threads)
        path = self.path
        inputs, outputs, meta = self._network.said
        if len(inputs) != 1:
            raise InputError(f"{path}: a network with {len(inputs)} inputs, not one image", IMAGE_ALONE)
        ((_, kind, shape),) = inputs
        if kind not in IMAGE_TYPES:
            raise InputError(f"{path}: its input is a {kind}, not an image of single or half precision", IMAGE_ALONE)
        shapes = {name: _shape(sizes) for name, _, sizes in outputs}
        layout = recognise(path, meta, _shape(shape), shapes, decoder, vehicle_classes)
        self.card = _card(path, meta, layout)
        if layout.decoder == "orthoscale":
            layout = replace(layout, multiple=self.card.stride, normalisation=self.card.normalisation)
        self.layout = layout
        self.sha256 = hashlib.sha256(content).hexdigest()
        self._type = IMAGE_TYPES[kind]

    @property
    def name(self) -> str:
        """The name that is reported with its boxes."""
        return f"{self.card.name}, confirmed by {self.confirming.card.name}" if self.confirming else self.card.name

    @property
    def sure(self) -> float:
        """The mean confidence of two passes from which a vehicle counts."""
        return (self.confirming if self.confirming and self.passes == Passes.CONFIRMED else self).card.sure

    @property
    def takes_parts(self) -> bool:
        """Whether it detects the same in a part of an image as in the whole, at less cost. Our networks do; others may
        have an input of fixed size, or use the whole image for each box."""
        return isinstance(self._network, _Shipped)

    def __call__(self, image: np.ndarray, threshold: float | None = None) -> Boxes:
        """Boxes in `image`, RGB uint8 (h, w, 3), before non-maximum suppression; coordinates in its pixels."""
        return self.see(image, threshold)[VEHICLES]

    def see(self, image: np.ndarray, threshold: float | None = None) -> dict[str, Boxes]:
        """Like a call, but by kind: boxes of VEHICLES, and of other objects of standard size in `image` (`objects`)."""
        threshold = self.card.score if threshold is None else threshold
        if self.layout.size is None:
            return self._run(image, threshold)
        # The network's input has a fixed size: look at windows of it, and leave what a window cuts to its neighbour.
        parts: dict[str, list[Boxes]] = {kind: [Boxes.empty()] for kind in (VEHICLES, *self.layout.objects)}
        height, width = image.shape[:2]
        for y in _starts(height, self.layout.size[0]):
            for x in _starts(width, self.layout.size[1]):
                window = image[y : y + self.layout.size[0], x : x + self.layout.size[1]]
                start, end = np.array([x, y]), np.array([x + window.shape[1], y + window.shape[0]])
                for kind, boxes in self._run(window, threshold).items():
                    found = boxes.mapped(1, (x, y))
                    cut = CUT if kind == VEHICLES else CUT_OBJECT
                    low = np.where(start > 0, start + cut, -np.inf)
                    high = np.where(end < (width, height), end - cut, np.inf)
                    parts[kind].append(found[found.between(low, high)])
        return {kind: Boxes.concatenate(some) for kind, some in parts.items()}

    def _run(self, image: np.ndarray, threshold: float) -> dict[str, Boxes]:
        height, width = image.shape[:2]
        n = self.layout.multiple
        rows, columns = self.layout.size or (-(-height // n) * n, -(-width // n) * n)
        require(12 * rows * columns, f"{self.path}: an input of {columns} x {rows} px")
        how = self.layout.normalisation
        std = np.array(how.std, np.float32)[:, None, None]
        shift = np.array(how.mean, np.float32)[:, None, None] / std
        padded = np.empty((1, 3, rows, columns), np.float32)
        padded[..., height:, :] = padded[..., width:] = NO_DATA_GREY / std
        channels = cv2.split(image)  # far faster than transposing in NumPy
        for k, channel in enumerate(channels if how.channels == "RGB" else channels[::-1]):
            np.multiply(channel, (1 / std)[k], out=padded[0, k, :height, :width])
        if shift.any():
            padded -= shift
        failed = f"{self.path}: the network fails on an image of {columns} x {rows} px"
        try:
            arrays = self._network.run(padded.astype(self._type, copy=False))
        except ForeignError as error:
            raise InputError(
                f"{failed} ({error})", "Export it again, with an input of that size or of any size."
            ) from error
        classes = {VEHICLES: self.layout.vehicles, **self.layout.objects}
        try:
            return {
                kind: self._not_too_many(self.layout.decode(arrays, numbers, threshold))
                for kind, numbers in classes.items()
            }
        except (IndexError, ValueError, TypeError) as error:
            shapes = ", ".join(str(list(array.shape)) for array in arrays)
            raise InputError(
                f"{failed}: its outputs {shapes} are not those that its decoder {self.layout.decoder!r} reads",
                "Name another one by --decoder, or export it again.",
            ) from error

    def _not_too_many(self, boxes: Boxes) -> Boxes:
        if len(boxes) <= MOST_BOXES:
            return boxes
        note = f"{self.card.name} detects over {MOST_BOXES} objects of a kind in one tile; the best {MOST_BOXES} count"
        if note not in self.notes:
            self.notes.append(note)
        return boxes[np.sort(np.argsort(-boxes.score, kind="stable")[:MOST_BOXES])]


def read_network(path: Path) -> bytes:
    """The content of the ONNX file `path`, which must fit the memory budget. Raises InputError."""
    return read_bytes(path, "Give a network as an .onnx file; --memory allows larger ones.", memory())


def load_network(path: Path | None, shipped: str, threads: int) -> tuple[Path, bytes, _Shipped | Worker]:
    """The network in the file at `path`, or our weights named `shipped`: its file, the file's content, and what runs
    it. Raises InputError."""
    file = path or Path(str(resources.files(__package__) / "weights" / shipped))
    content = read_network(file)
    return file, content, _Shipped(content, threads) if path is None else load_foreign(file, content, threads)


class _Shipped:
    """A network of ours, in this process; used like `foreign.Worker`."""

    def __init__(self, content: bytes, threads: int):
        settings = {"threads": threads, "operators": None, "arena": True}
        self._session = foreign_worker.session(content, settings)
        self.said = Said(**foreign_worker.said(self._session))

    def run(self, image: np.ndarray) -> list[np.ndarray]:
        return self._session.run(None, {self.said.inputs[0][0]: image})


def load_foreign(path: Path, content: bytes, threads: int, seconds: float | None = None) -> Worker:
    """The network `content` of a user's file at `path`, with `seconds` for each image; see `foreign.Worker`. Raises
    InputError."""
    library = os.environ.get(OPERATORS)
    try:
        return Worker(path, content, threads, library, seconds)
    except ForeignError as error:
        if error.library:
            raise InputError(
                f"{library}: no library of operators that onnxruntime can load ({error})",
                f"Correct or unset the variable {OPERATORS}.",
            ) from error
        if "not a registered" in str(error):
            raise InputError(
                f"{path}: has operators that onnxruntime does not know ({error})",
                f"For MMDeploy's, set {OPERATORS} to the path of its libmmdeploy_onnxruntime_ops.so.",
            ) from error
        raise InputError(f"{path}: not an ONNX network that onnxruntime can load ({error})", NO_NETWORK) from error


def _card(path: Path, metadata: dict[str, str], layout: NetworkForm) -> Card:
    if "orthoscale" in metadata:
        return Card.from_json(metadata["orthoscale"], str(path))
    if layout.decoder == "orthoscale":
        raise InputError(
            f"{path}: outputs like those of orthoscale's own networks, but without an orthoscale card",
            CARD_HINT,
        )
    name = metadata.get("description") or path.name
    return Card.unknown(f"{name} ({layout.decoder}{'; assumed: ' if layout.assumed else ''}{layout.assumed})")


def _starts(size: int, span: int) -> list[int]:
    """Start of each of the windows of `span` px that cover `size` px; neighbours share OVERLAP px or more."""
    if size <= span:
        return [0]
    shared = min(OVERLAP, span // 2)
    count = -(-(size - shared) // (span - shared))
    return [round(k * (size - span) / (count - 1)) for k in range(count)]


def _shape(shape: Sequence[Any]) -> Shape:
    return tuple(n if isinstance(n, int) and n > 0 else None for n in shape)
