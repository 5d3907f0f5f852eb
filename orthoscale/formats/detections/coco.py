"""COCO's JSON (https://cocodataset.org/#format-data): boxes as four-cornered segmentations.

Read: ``segmentation`` polygons, or a ``bbox`` of five numbers as detectron2 writes it (centre x, y, width, height, and
degrees counter-clockwise). A plain ``bbox`` of four numbers has no direction and is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.boxes import Boxes
from ...errors import InputError
from ..reading import checked, reason
from .items import LABEL, Item
from .own import measured_notes

if TYPE_CHECKING:
    from ..schemas.detections import CocoAnnotation

COCO_HINT = "Oriented boxes are needed: a segmentation with four corners, or a bbox with an angle."


def is_coco(text: Any) -> bool:
    """Whether a JSON document is a COCO data set, or a list of COCO results."""
    if isinstance(text, dict):
        return isinstance(text.get("annotations"), list)
    return isinstance(text, list) and bool(text) and isinstance(text[0], dict) and "category_id" in text[0]


def read(text: Any, origin: str) -> tuple[list[Item], dict[str, tuple[int, int]]]:
    """The boxes of a document, and the pictures' sizes (width, height) where it has them. Raises InputError."""
    from ..schemas.detections import Coco

    whole = checked(text if isinstance(text, dict) else {"annotations": text}, Coco, origin, "COCO's JSON", COCO_HINT)
    pictures = {image.id: image.file_name for image in whole.images}
    sizes = {image.file_name: (int(image.width), int(image.height)) for image in whole.images}
    labels = {category.id: category.name for category in whole.categories}
    items = []
    for number, annotation in enumerate(whole.annotations, 1):
        try:
            image = annotation.image_id
            if pictures and image not in pictures:
                raise ValueError(f"image_id {image!r} is not among its images")
            picture = pictures.get(image, image if isinstance(image, str) else None)
            category = annotation.category_id
            if labels and category not in labels:
                raise ValueError(f"category_id {category!r} is not among its categories")
            label = None if category is None else labels.get(category)
            items.append(
                Item(_polygon(annotation), annotation.score, label, picture, annotation.sigma, annotation.kinds)
            )
        except ValueError as error:
            raise InputError(f"{origin}: annotation {number} cannot be used ({reason(error)})", COCO_HINT) from error
    return items, sizes


def _polygon(annotation: CocoAnnotation) -> np.ndarray:
    parts = annotation.segmentation
    if isinstance(parts, dict):
        raise ValueError("its segmentation is a mask (RLE), not corners")
    if parts:
        if any(len(part) % 2 for part in parts):
            raise ValueError("its segmentation has an x without a y")
        points = np.concatenate([np.asarray(part, float).reshape(-1, 2) for part in parts])
        if len(points) < 3:
            raise ValueError("its segmentation has fewer than three corners")
        return points
    if annotation.bbox is None or len(annotation.bbox) != 5:
        raise ValueError("its bbox has no direction" if annotation.bbox else "it has no segmentation and no bbox")
    x, y, width, height, degrees = annotation.bbox
    if not (width > 0 and height > 0):
        raise ValueError("its bbox has no extent")
    return Boxes(np.array([[x, y, width, height, -np.radians(degrees)]]), np.ones(1)).corners[0]


def document(boxes: Mapping[str, Boxes], sizes: Mapping[str, tuple[int, int]], note: Mapping[str, Any]) -> dict:
    """A COCO data set of `boxes` by picture name; `sizes` (width, height) where known; `note` goes into its info."""
    images: list[dict] = []
    annotations: list[dict] = []
    for image_id, (picture, found) in enumerate(boxes.items(), 1):
        width, height = sizes.get(picture, (0, 0))
        images.append({"id": image_id, "file_name": picture, "width": width, "height": height})
        rows = zip(found.corners, found.score, found.xylwa, measured_notes(found), strict=True)
        for corners, score, row, more in rows:
            low, high = corners.min(0), corners.max(0)
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_id,
                    "category_id": 1,
                    "segmentation": [[round(float(v), 3) for v in corners.ravel()]],
                    "bbox": [round(float(v), 3) for v in (*low, *(high - low))],
                    "area": round(float(row[2] * row[3]), 3),
                    "iscrowd": 0,
                    "score": round(float(score), 4),
                    **more,
                }
            )
    return {
        "info": {"description": "vehicles found by orthoscale", "orthoscale": dict(note)},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": 1, "name": LABEL}],
    }
