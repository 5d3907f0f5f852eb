"""The similarity transform that brings a model to metres, and the files that store it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError, UsageError
from ..names import write_json
from ..reading import SMALL, read, read_text

MATRIX = "sim3_4x4.txt"
SIM3_HINT = "Give the sim3.json (or sim3.txt) that `orthoscale fix` wrote."


@dataclass(frozen=True)
class Sim3:
    """metric_from_model: ``x_metric = scale * x_model``, about the model's own origin, without rotation or shift.

    scale : metres per model unit, positive and finite; raises UsageError for any other.
    """

    scale: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise UsageError(f"cannot scale by {self.scale}", "A scale is a positive number of metres per unit.")

    def save(self, folder: Path) -> None:
        """Write sim3.json, and two files for `colmap model_transformer --transform_path`, which cannot hold comments:
        sim3.txt (``scale qw qx qy qz tx ty tz``) for COLMAP 3.9 and newer, sim3_4x4.txt (a matrix) for 3.8 and
        older."""
        text = {
            "target_from_source": "metric_from_model",
            "scale": self.scale,
            "rotation_wxyz": [1.0, 0.0, 0.0, 0.0],
            "translation": [0.0, 0.0, 0.0],
            "unit": "m",
        }
        write_json(text, folder / "sim3.json")
        (folder / "sim3.txt").write_text(f"{self.scale:.17g} 1 0 0 0 0 0 0\n", encoding="utf-8")
        rows = np.diag([self.scale] * 3 + [1.0]).tolist()
        matrix = "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in rows)
        (folder / MATRIX).write_text(matrix, encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Sim3:
        """Read sim3.json or sim3.txt. Raises InputError for anything else, UsageError if it rotates or shifts."""
        if path.suffix.lower() == ".json":
            from ..schemas.models import Sim3Entry

            entry = read(path, Sim3Entry, "a similarity", SIM3_HINT)
            scale, rest = entry.scale, [*entry.rotation_wxyz, *entry.translation]
        else:
            try:
                scale, *rest = map(float, read_text(path, SIM3_HINT, SMALL).split())
            except ValueError as error:
                raise InputError(f"{path}: not a similarity (expected eight numbers)", SIM3_HINT) from error
        if len(rest) != 7:
            raise InputError(f"{path}: not a similarity ({len(rest) + 1} numbers, 8 are needed)", SIM3_HINT)
        if rest != [1, 0, 0, 0, 0, 0, 0]:
            raise UsageError(f"{path} turns or shifts the model as well; only its scale can be applied", SIM3_HINT)
        return cls(scale)
