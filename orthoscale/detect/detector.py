"""The shipped detector: an ONNX network and the card that says what its boxes mean."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np

from ..boxes import Boxes
from ..errors import InputError
from ..pooling import Ruler
from .decoders import decode_maps

SHIPPED = "small_vehicle.onnx"
INPUT_MULTIPLE = 32  # the network halves its input five times


@dataclass(frozen=True)
class Card:
    """What a detector says of itself, kept in the ONNX file's metadata under ``orthoscale``.

    usable_length : (low, high) vehicle lengths that it finds well [px of its input].
    best_length : the length at which it does best; the zoom search aims there [px].
    score : the confidence above which a box counts.
    effective_height : the height up to which its boxes enclose a vehicle seen obliquely, along length and width [m].
    """

    name: str
    usable_length: tuple[float, float]
    best_length: float
    score: float
    effective_height: tuple[float, float]
    ruler: Ruler
    training: str = ""
    licence: str = ""
    extra: dict = field(default_factory=dict)

    @classmethod
    def from_json(cls, text: str) -> Card:
        values = json.loads(text)
        values["ruler"] = Ruler.from_json(values["ruler"])
        for name in ("usable_length", "effective_height"):
            low, high = values[name]
            values[name] = (float(low), float(high))
        return cls(**values)


class Detector:
    """Finds small vehicles in an RGB image. Holds one inference session; safe to call from several threads."""

    def __init__(self, path: Path | None = None, threads: int = 0):
        """`path`: an ONNX file with an orthoscale card; None: the shipped weights. Raises InputError.

        `threads` work on one image together; 0 for as many as there are cores.
        """
        import onnxruntime

        if path is None:
            path = Path(str(resources.files(__package__) / "weights" / SHIPPED))
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        # Spinning threads starve the reader and the decoder where cores are few.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            content = path.read_bytes()
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read ({error.strerror})", "Give a detector as an .onnx file."
            ) from error
        except Exception as error:  # onnxruntime raises its own unrelated types
            raise InputError(f"{path}: not an ONNX network that onnxruntime can load ({error})") from error
        try:
            self.card = Card.from_json(self._session.get_modelmeta().custom_metadata_map["orthoscale"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{path}: an ONNX file without an orthoscale card that can be read ({error!r})",
                "Export it with training.export.",
            ) from error
        self.sha256 = hashlib.sha256(content).hexdigest()
        self._input = self._session.get_inputs()[0].name

    def __call__(self, image: np.ndarray, threshold: float | None = None) -> Boxes:
        """Boxes in `image`, RGB uint8 (h, w, 3), before non-maximum suppression; coordinates in its pixels."""
        height, width = image.shape[:2]
        padded = np.full(
            (1, 3, -(-height // INPUT_MULTIPLE) * INPUT_MULTIPLE, -(-width // INPUT_MULTIPLE) * INPUT_MULTIPLE),
            114 / 255,
            np.float32,
        )
        np.multiply(image.transpose(2, 0, 1), np.float32(1 / 255), out=padded[0, :, :height, :width])
        (maps,) = self._session.run(None, {self._input: padded})
        return decode_maps(maps[0], threshold or self.card.score)
