"""The vehicles found in a source, and the file that keeps them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evidence.objects import known_objects
from ..formats.reading import LARGE, checked, read_plain
from .boxes import Boxes
from .ruler import Ruler

if TYPE_CHECKING:
    from ..detect.sweep import Swept
    from ..formats.schemas import BoxEntry, DetectionsEntry, NoteEntry

# Boxes from a file that does not say what ruler they are: a margin nobody has measured.
UNKNOWN_RULER = Ruler(margin=(0.0, 0.0), margin_sd=(1.5, 1.2), bias_sd=(0.02, 0.03), noise=(2.0, 1.2))
UNKNOWN_HEIGHT = (0.7, 0.6)  # of a DOTA-trained YOLO-OBB on oblique frames, for want of better [m]
FIELDS = ("cx", "cy", "length", "width", "angle")
WHAT = "a detections file"
HINT = 'Expected {"picture name": [{"cx", "cy", "length", "width", "angle", "score"}]} in pixels and radians.'


@dataclass(frozen=True)
class Detections:
    """Boxes by picture name [px of the picture], with what is needed to measure with them.

    zoom : detector pixels per picture pixel; the ruler's margin and noise are in detector pixels.
    effective_height : up to where the boxes enclose a vehicle seen obliquely, along its length and its width [m].
    objects : boxes of other classes than vehicles, by picture name and class, for `evidence.objects.standard_object`.
    doubtful : boxes that were seen but not believed, by picture name, with the reason.
    planar : those of a reconstruction's frames warped onto the ground, by the frame's name, in the plans' pixels.
    body : what the vehicles are shaped like, one of `core.projection.exact.BODIES`; the card's.
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

    def note(self) -> dict[str, Any]:
        """What a file of another format keeps beside the vehicles' boxes, so that `of` gives back all: `about`, the
        doubtful boxes, the objects, and what `planar` holds, as plain values."""
        objects = {name: rows for name in self.objects if (rows := self._object_rows(name))}
        return {**self.about(), **self._rest(), **({"objects": objects} if objects else {})}

    @classmethod
    def of(cls, boxes: dict[str, Boxes], note: Mapping[str, Any] | None, name: str, origin: str) -> Detections:
        """Boxes from a file, with the `note` that it keeps of them; without one they are those of `name`, a detector
        that nobody has measured. Raises InputError, which calls the file `origin`."""
        if note is None:
            return cls(boxes, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, name)
        from ..formats.schemas import NoteEntry

        return cls._noted(boxes, checked(note, NoteEntry, origin, WHAT, "Save the detections again."), name)

    @classmethod
    def _noted(cls, boxes: dict[str, Boxes], note: NoteEntry, name: str) -> Detections:
        from msgspec import UNSET

        planar = None if note.planar is None else cls._whole(note.planar, name)
        found = cls(
            boxes=boxes,
            zoom=note.zoom,
            ruler=UNKNOWN_RULER if note.ruler is UNSET else note.ruler.ruler,
            effective_height=note.effective_height,
            detector=name if note.detector is UNSET else note.detector,
            detector_sha256=note.detector_sha256,
            doubtful=_vehicles(note.doubtful),
            objects=_objects(note.objects),
            planar=planar,
            body=note.body,
        )
        return found if note.doubt is UNSET else replace(found, doubt=note.doubt)

    def save(self, path: Path) -> None:
        """Write as JSON: ``pictures: {name: [{cx, cy, length, width, angle, score}]}`` in pixels and radians."""
        path.write_text(json.dumps(self._document(), indent=0))

    def _document(self) -> dict[str, Any]:
        names = dict.fromkeys([*self.boxes, *self.objects])
        pictures = {name: _rows(self.boxes.get(name, Boxes.empty())) + self._object_rows(name) for name in names}
        return {**self.about(), **self._rest(), "pictures": pictures}

    def _rest(self) -> dict[str, Any]:
        rest: dict[str, Any] = {}
        if self.doubtful:
            rest |= {"doubt": self.doubt, "doubtful": {name: _rows(boxes) for name, boxes in self.doubtful.items()}}
        return rest if self.planar is None else {**rest, "planar": self.planar._document()}

    def _object_rows(self, name: str) -> list[dict[str, Any]]:
        others = self.objects.get(name, {})
        return [{**row, "kind": kind} for kind, boxes in others.items() for row in _rows(boxes)]

    @classmethod
    def load(cls, path: Path) -> Detections:
        """Read what `save` wrote, or a plain ``{name: [box, ...]}``. Raises InputError."""
        return cls.of_document(read_plain(path, WHAT, HINT, LARGE), path)

    @classmethod
    def of_document(cls, text: Any, path: Path) -> Detections:
        """The same from the plain values that are in the file `path`. Raises InputError."""
        from ..formats.schemas import BoxesByPicture, DetectionsEntry

        name = f"boxes of {path.name}"
        if not (isinstance(text, dict) and "pictures" in text):
            pictures = checked(text, BoxesByPicture, str(path), WHAT, HINT)
            return replace(cls.of(_vehicles(pictures), None, name, str(path)), objects=_objects(pictures))
        return cls._whole(checked(text, DetectionsEntry, str(path), WHAT, HINT), name)

    @classmethod
    def _whole(cls, text: DetectionsEntry, name: str) -> Detections:
        return replace(cls._noted(_vehicles(text.pictures), text, name), objects=_objects(text.pictures))


def _vehicles(pictures: Mapping[str, Sequence[BoxEntry]]) -> dict[str, Boxes]:
    return {name: _boxes(rows) for name, rows in pictures.items()}


def _objects(pictures: Mapping[str, Sequence[BoxEntry]]) -> dict[str, dict[str, Boxes]]:
    """Boxes of standard objects, by picture and kind."""
    objects = {}
    for name, rows in pictures.items():
        kinds = {row.kind for row in rows} & set(known_objects())
        if kinds:
            objects[name] = {kind: _boxes(rows, kind) for kind in sorted(kinds)}
    return objects


def _rows(boxes: Boxes) -> list[dict[str, Any]]:
    assert boxes.spread is not None  # since it was made
    rows = []
    for row, score, spread in zip(boxes.xylwa, boxes.score, boxes.spread, strict=True):
        plain = {k: round(float(v), 4 if k == "angle" else 2) for k, v in zip(FIELDS, row, strict=True)}
        rows.append({**plain, "score": round(float(score), 3), **spread_note(spread)})
    return rows


def spread_note(spread: np.ndarray) -> dict[str, list[float | None]]:
    """What a file says of one box's spread (2,), nothing where it is not known."""
    values = [round(float(v), 5) if np.isfinite(v) else None for v in spread]
    return {} if values == [None, None] else {"spread": values}


def _boxes(rows: Sequence[BoxEntry], kind: str = "vehicle") -> Boxes:
    rows = [row for row in rows if row.kind == kind]
    xylwa = np.array([[getattr(row, k) for k in FIELDS] for row in rows], float).reshape(-1, 5)
    spread = np.array([row.spread for row in rows], float).reshape(-1, 2)  # None becomes NaN
    return Boxes(xylwa, np.array([row.score for row in rows], float), spread)
