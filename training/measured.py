"""Replaces the drawn boxes of labelled vehicles by those of the measurer.

    python -m training.measured --labels ../shared/data/vehicles/labels.json --out runs/measured.json
    python -m training.train ... --measured runs/measured.json

Drawn boxes have a different margin in every scene, and scatter by some per cent from vehicle to vehicle; a detector
that learns from them learns both. The measurer's edges differ by half a per cent from place to place
([measurer](measurer/README.md)). Boxes in which it sees no vehicle, or another one, stay as they were drawn.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoscale.core.boxes import Boxes
from orthoscale.detect.measurer import Measurer
from orthoscale.detect.remeasure import NONE

from .data import LabelledImage, read_labels

LOOKS = 2  # passes of the measurer: drawn boxes are closer to the vehicle than a detector's
# A measured box is accepted if its size is within the factor NEAR of the drawn one's, its centre within the share ASIDE
# of the length, and its axis within as many radians.
NEAR = 1.2
ASIDE = 0.15


def measured(measurer: Measurer, image: LabelledImage) -> dict[int, list[float]]:
    """Measured boxes [cx, cy, length, width, angle] that are accepted, by their index in `image.boxes`."""
    index = np.flatnonzero(image.is_vehicle)
    if not len(index):
        return {}
    drawn = image.boxes[index]
    told = measurer.in_pixels(image.level(0), Boxes(drawn, np.ones(len(drawn))), LOOKS)
    # Boxes keep the order in which they were proposed; one that came out wider than long was turned by a quarter.
    found = told.boxes.xylwa.copy()
    found[:, 2:4] -= measurer.card.ruler.margin
    factor = np.abs(np.log(found[:, 2:4] / drawn[:, 2:4])).max(1)
    away = np.hypot(*(found[:, :2] - drawn[:, :2]).T) / drawn[:, 2]
    turned = np.abs(np.sin(found[:, 4] - drawn[:, 4]))
    good = (told.kind[:, -1] < NONE) & (factor < np.log(NEAR)) & (away < ASIDE) & (turned < ASIDE)
    return {int(k): np.round(box, 3).tolist() for k, box, ok in zip(index, found, good, strict=True) if ok}


def with_measured(images: Sequence[LabelledImage], file: Path) -> list[LabelledImage]:
    """The same images with the measured boxes from `file`, which this program wrote."""
    kept = json.loads(file.read_text())["images"]
    out = []
    for image in images:
        boxes = image.boxes.copy()
        for k, box in kept.get(image.path.name, {}).items():
            boxes[int(k)] = box
        out.append(replace(image, boxes=boxes))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--labels", type=Path, action="append", required=True, help="label file; may be repeated")
    parser.add_argument("--measurer", type=Path, help="instead of the shipped one")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    measurer = Measurer(options.measurer, threads=options.threads)
    kept, vehicles, believed, change = {}, 0, 0, []
    for image in (image for file in options.labels for image in read_labels(file)):
        boxes = measured(measurer, image)
        image._levels.clear()
        if boxes:
            kept[image.path.name] = boxes
            index = list(boxes)
            change += np.log(np.array(list(boxes.values()))[:, 2:4] / image.boxes[index, 2:4]).tolist()
        vehicles, believed = vehicles + int(image.is_vehicle.sum()), believed + len(boxes)
    options.out.write_text(json.dumps({"measurer": measurer.card.name, "images": kept}))
    length, width = 100 * np.median(change, axis=0)
    print(f"{believed} of {vehicles} vehicles measured; lengths change by {length:+.1f} %, widths {width:+.1f} %")


if __name__ == "__main__":
    main()
