"""Reads label files and their images as arrays that are ready to be cropped.

A label file is ``{"images": [{"file", "set", "width", "height", "source", "licence", "boxes": [...]}]}``; a box is
``{"cx", "cy", "length", "width", "angle", "kind"}`` in pixels (corner origin: the top-left pixel's centre is
(0.5, 0.5)) and radians of the long side from +x, clockwise on screen. The images lie in ``images/`` beside it.

Kinds: ``vehicle`` is learnt; everything else (``large-vehicle``, ``ignore``, ``candidate``) is neither vehicle nor
background, and gives the network no gradient.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from orthoscale.sources.picture_file import stored_size

# Vehicle length assumed for a picture without vehicles [px]; it only sets how such ground is enlarged or reduced.
NOMINAL_LENGTH = 45.0


@dataclass
class LabelledImage:
    """One image with its boxes; pixels are decoded on first use and kept, with two half-size levels."""

    path: Path
    scene: str
    width: int
    height: int
    source: str
    licence: str
    boxes: np.ndarray  # (N, 5) centre x, centre y, length, width [px], angle [rad]
    kinds: np.ndarray  # (N,) str
    usual_length: float = NOMINAL_LENGTH  # of vehicles in such pictures [px]
    lookalikes: np.ndarray = field(default_factory=lambda: np.empty((0, 5)))  # (M, 5) judged to be no vehicles
    _levels: list[np.ndarray] = field(default_factory=list, repr=False)

    @classmethod
    def unlabelled(cls, path: Path, scene: str) -> LabelledImage:
        """A picture without labels; it is read at once."""
        image = cls(path, scene, 0, 0, "", "", np.empty((0, 5)), np.empty(0, object))
        image.height, image.width = image.level(0).shape[:2]
        return image

    @property
    def is_vehicle(self) -> np.ndarray:
        """(N,) bool; False means neither vehicle nor background."""
        return self.kinds == "vehicle"

    @property
    def vehicles(self) -> np.ndarray:
        return self.boxes[self.is_vehicle]

    @property
    def median_length(self) -> float | None:
        """Median vehicle length in pixels, None for a scene image without vehicles."""
        return float(np.median(self.vehicles[:, 2])) if self.is_vehicle.any() else None

    def level(self, octave: int) -> np.ndarray:
        """RGB uint8 (h, w, 3), shrunk by 2**octave with an area filter."""
        if not self._levels:
            image = cv2.imread(str(self.path), cv2.IMREAD_COLOR)
            if image is None:
                raise FileNotFoundError(f"{self.path}: not an image that OpenCV can read")
            self._levels.append(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        while len(self._levels) <= octave:
            last = self._levels[-1]
            size = (last.shape[1] // 2, last.shape[0] // 2)
            self._levels.append(cv2.resize(last, size, interpolation=cv2.INTER_AREA))
        return self._levels[octave]


LABELS = Path(__file__).parent / "labels"
MARGINS = LABELS / "margins.json"
JUDGED = LABELS / "judged.json"
BACKGROUND = "background"  # kind of a judged box that looks like a vehicle but is not one
LARGEST_SHARE = 0.25  # of the width that a margin may take off, so that tiny boxes stay boxes


def as_stored(path: Path) -> np.ndarray:
    """(h, w, 3) uint8 BGR, the picture as it is stored; its EXIF orientation is ignored. Raises ValueError."""
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise ValueError(f"{path}: not an image that OpenCV can read")
    return pixels


def read_labels(label_file: Path, tighten: bool = True, complete: bool = True) -> list[LabelledImage]:
    """The images of one label file, in its order, with the margin of their scene taken off the boxes
    (labels/margins.json).

    People and detectors draw boxes around a vehicle with a margin, which differs between the labels of scenes. A
    network that learns from them unchanged measures a vehicle by the scene that it resembles. `tighten=False`: the
    boxes as drawn. Boxes that the labels lack and a person has judged since (labels/judged.json) are added, unless
    `complete=False`. Boxes judged to be background are not labels, but the image's `lookalikes`.

    The boxes of a folder of pictures are in labels/FOLDER.json (see `propose`); pictures whose names differ only in
    digits are one scene.
    """
    margins = json.loads(MARGINS.read_text())["margin_px"] if tighten else {}
    if label_file.is_dir():
        return _of_folder(label_file, margins.get(label_file.name, 0.0))
    judged = json.loads(JUDGED.read_text())["images"] if complete else {}
    folder = label_file.parent / "images"
    images = []
    for entry in json.loads(label_file.read_text())["images"]:
        boxes = np.array(
            [[b[k] for k in ("cx", "cy", "length", "width", "angle")] for b in entry["boxes"]], float
        ).reshape(-1, 5)
        boxes = _freed(boxes, margins.get(entry["set"], 0.0))
        kinds = np.array([b["kind"] for b in entry["boxes"]], dtype=object)
        since = judged.get(entry["file"], {})
        boxes, kinds = _with_judged(boxes, kinds, since, margins.get("judged", 0.0))
        images.append(
            LabelledImage(
                folder / entry["file"], entry["set"], entry["width"], entry["height"],
                entry["source"], entry["licence"], boxes, kinds, lookalikes=_lookalikes(since),
            )
        )  # fmt: skip
    return images


def _of_folder(folder: Path, margin: float | list[float]) -> list[LabelledImage]:
    """The pictures of a folder that labels/FOLDER.json lists, with their boxes."""
    labels = json.loads((LABELS / f"{folder.name}.json").read_text())
    images = []
    for file, rows in labels["images"].items():
        boxes, kinds = _freed(_stacked(rows), margin), _kinds(rows)
        labelled = kinds != BACKGROUND
        images.append(
            LabelledImage(
                folder / file, group_of(file), *stored_size(folder / file), labels["source"], labels["licence"],
                boxes[labelled], kinds[labelled], labels["usual_length"], _lookalikes(rows),
            )
        )  # fmt: skip
    return images


def _lookalikes(rows: dict[str, list[list[float]]]) -> np.ndarray:
    """(N, 5) the boxes that were judged not to be vehicles."""
    return np.array(rows.get(BACKGROUND, []), float).reshape(-1, 5)


def group_of(picture: str) -> str:
    """The name without its last digits and its ending."""
    return Path(picture).stem.rstrip("0123456789")


def _stacked(rows: dict[str, list[list[float]]]) -> np.ndarray:
    """(N, 5) the boxes of all kinds, in order."""
    return np.array([row for of_kind in rows.values() for row in of_kind], float).reshape(-1, 5)


def _kinds(rows: dict[str, list[list[float]]]) -> np.ndarray:
    """(N,) the kind of each box, in the same order."""
    return np.array([kind for kind, of_kind in rows.items() for _ in of_kind], dtype=object)


def _freed(boxes: np.ndarray, margin: float | list[float]) -> np.ndarray:
    """Boxes (N, 5) without their margin of length and width [px]."""
    size = boxes[:, 2:4] - np.minimum(margin, LARGEST_SHARE * boxes[:, 3:4])
    return np.c_[boxes[:, :2], size, boxes[:, 4:]]


def _with_judged(
    boxes: np.ndarray, kinds: np.ndarray, judged: dict[str, list[list[float]]], margin: float | list[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Labels and the boxes judged since; a judged box replaces candidates whose centres lie in it."""
    added, added_kinds = _freed(_stacked(judged), margin), _kinds(judged)
    away = boxes[:, None, :2] - added[None, :, :2]
    settled = (np.hypot(away[..., 0], away[..., 1]) < added[:, 3] / 2).any(1) & (kinds == "candidate")
    kept = added_kinds != BACKGROUND
    return np.r_[boxes[~settled], added[kept]], np.r_[kinds[~settled], added_kinds[kept]]


def split(images: list[LabelledImage], held_out: set[str]) -> tuple[list[LabelledImage], list[LabelledImage]]:
    """(training, held out), by whole scene: frames of one scene show the same parked vehicles."""
    unknown = held_out - {image.scene for image in images}
    if unknown:
        raise ValueError(f"no such scene in the labels: {', '.join(sorted(unknown))}")
    return (
        [image for image in images if image.scene not in held_out],
        [image for image in images if image.scene in held_out],
    )
