"""The vehicles found in a source, and the file that keeps them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .boxes import Boxes
from .errors import InputError
from .evidence.objects import known_objects
from .pooling.ruler import Ruler
from .projection.exact import BODIES

if TYPE_CHECKING:
    from .detect.sweep import Swept

# Boxes from a file that does not say what ruler they are: a margin nobody has measured.
UNKNOWN_RULER = Ruler(margin=(0.0, 0.0), margin_sd=(1.5, 1.2), bias_sd=(0.02, 0.03), noise=(2.0, 1.2))
UNKNOWN_HEIGHT = (0.7, 0.6)  # of a DOTA-trained YOLO-OBB on oblique frames, for want of better [m]
FIELDS = ("cx", "cy", "length", "width", "angle")


@dataclass(frozen=True)
class Detections:
    """Boxes by picture name [px of the picture], with what is needed to measure with them.

    zoom : detector pixels per picture pixel; the ruler's margin and noise are in detector pixels.
    effective_height : up to where the boxes enclose a vehicle seen obliquely, along its length and its width [m].
    objects : boxes of other classes than vehicles, by picture name and class, for `objects.standard_object`.
    doubtful : boxes that were seen but not believed, by picture name, with the reason.
    planar : those of a reconstruction's frames warped onto the ground, by the frame's name, in the plans' pixels.
    body : what the vehicles are shaped like, one of `projection.exact.BODIES`; the card's.
    swept : which tiles were looked at, where the boxes do not come from a file.
    """

    boxes: dict[str, Boxes]
    zoom: float
    ruler: Ruler
    effective_height: tuple[float, float]
    detector: str
    detector_sha256: str = ""
    doubtful: dict[str, Boxes] = field(default_factory=dict)
    objects: dict[str, dict[str, Boxes]] = field(default_factory=dict)
    doubt: str = "low confidence, or detected at only one resolution"
    planar: Detections | None = None
    swept: Swept | None = None
    body: str = "car"
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return sum(map(len, self.boxes.values()))

    def about(self) -> dict[str, Any]:
        """All that is needed to measure with the boxes, as plain values."""
        return {
            "detector": self.detector,
            "detector_sha256": self.detector_sha256,
            "zoom": self.zoom,
            "effective_height": list(self.effective_height),
            "body": self.body,
            "ruler": asdict(self.ruler),
        }

    @classmethod
    def of(cls, boxes: dict[str, Boxes], about: Mapping[str, Any] | None, name: str, origin: str) -> Detections:
        """Boxes from a file, with what `about` says of them; without that they are those of `name`, a detector that
        nobody has measured. Raises InputError, which calls the file `origin`."""
        if about is None:
            return cls(boxes, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, name)
        try:
            return cls(
                boxes=boxes,
                zoom=float(about["zoom"]),
                ruler=Ruler.from_json(about["ruler"]) if "ruler" in about else UNKNOWN_RULER,
                effective_height=_pair(about["effective_height"]),
                detector=str(about.get("detector", name)),
                detector_sha256=str(about["detector_sha256"]),
                body=_body(about.get("body", "car")),
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"{origin}: not a detections file (what it says of its detector is damaged: {error!r})",
                "Save the detections again.",
            ) from error

    def save(self, path: Path) -> None:
        """Write as JSON: ``pictures: {name: [{cx, cy, length, width, angle, score}]}`` in pixels and radians."""
        path.write_text(json.dumps(self._document(), indent=0))

    def _document(self) -> dict[str, Any]:
        pictures = {name: _rows(boxes) + self._object_rows(name) for name, boxes in self.boxes.items()}
        text = {**self.about(), "pictures": pictures}
        return text if self.planar is None else {**text, "planar": self.planar._document()}

    def _object_rows(self, name: str) -> list[dict[str, Any]]:
        others = self.objects.get(name, {})
        return [{**row, "kind": kind} for kind, boxes in others.items() for row in _rows(boxes)]

    @classmethod
    def load(cls, path: Path) -> Detections:
        """Read what `save` wrote, or a plain ``{name: [box, ...]}``. Raises InputError."""
        try:
            text = json.loads(path.read_text(encoding="utf-8"))
            boxes, objects = _pictures(text)
            planar = _pictures(text["planar"])[0] if "pictures" in text and "planar" in text else None
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})", "Give a detections file.") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"{path}: not a detections file ({error!r})",
                'Expected {"picture name": [{"cx", "cy", "length", "width", "angle", "score"}]} in pixels and radians.',
            ) from error
        about, name = text if "pictures" in text else None, f"boxes of {path.name}"
        found = replace(cls.of(boxes, about, name, str(path)), objects=objects)
        return found if planar is None else replace(found, planar=cls.of(planar, text["planar"], name, str(path)))


def _pictures(text: dict[str, Any]) -> tuple[dict[str, Boxes], dict[str, dict[str, Boxes]]]:
    """Vehicles by picture, and other objects by picture and kind."""
    pictures = text.get("pictures", text)
    objects = {name: kinds for name, rows in pictures.items() if (kinds := _objects(rows))}
    return {name: _boxes(rows) for name, rows in pictures.items()}, objects


def _body(name: str) -> str:
    if name not in BODIES:
        raise ValueError(f"body {name!r} is none of {', '.join(BODIES)}")
    return name


def _pair(values: list[float]) -> tuple[float, float]:
    length, width = values
    return float(length), float(width)


def _rows(boxes: Boxes) -> list[dict[str, float]]:
    return [
        {
            **{k: round(float(v), 4 if k == "angle" else 2) for k, v in zip(FIELDS, row, strict=True)},
            "score": round(float(s), 3),
        }
        for row, s in zip(boxes.xylwa, boxes.score, strict=True)
    ]


def _objects(rows: list[dict]) -> dict[str, Boxes]:
    kinds = {row["kind"] for row in rows if row.get("kind") in known_objects()}
    return {kind: _boxes(rows, kind) for kind in sorted(kinds)}


def _boxes(rows: list[dict], kind: str = "vehicle") -> Boxes:
    rows = [row for row in rows if row.get("kind", "vehicle") == kind]
    xylwa = np.array([[float(row[k]) for k in FIELDS] for row in rows], float).reshape(-1, 5)
    if not np.isfinite(xylwa).all() or (xylwa[:, 2:4] <= 0).any():
        raise ValueError("a box with a size that is not a positive number")
    return Boxes(xylwa, np.array([float(row.get("score", 1.0)) for row in rows]))
