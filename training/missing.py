"""Find vehicles that the labels lack, and things that are taken for vehicles, for a person to judge.

    python -m training.missing --detector WEIGHTS.onnx --labels LABELS.json --out runs/missing
    python -m training.missing --detector WEIGHTS.onnx --labels ../shared/data/vehicles/chips --unsure \\
        --scenes buildings,harbor --out runs/negatives
    python -m training.propose keep runs/negatives --as chips --add

A vehicle in a training image that its labels lack is learnt as background; and things that a detector wrongly takes
for vehicles are those from which it can learn most. The previous detector makes the proposals: boxes that it sees at
two zooms and that overlap no label (with ``--unsure``: no labelled vehicle, so ignored boxes are proposed again).
Written are `proposals.json`, in which each box counts as background until a person says otherwise, and numbered contact
sheets of all proposals. `propose` explains how to write the judgement down, and stores it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.boxes import Boxes, matched, overlapping
from orthoscale.detect.detector import Detector
from orthoscale.detect.tiles import one_pass
from orthoscale.sources.picture_file import PictureFile

from .data import BACKGROUND, LabelledImage, group_of, read_labels, split
from .geometry import MAX_ENLARGEMENT

LENGTH = 36.0  # length of a scene's vehicles in the first look [px]; the second is half an octave coarser
SAME = 0.5  # IoU from which boxes of two looks are of one vehicle
KNOWN = 0.15  # IoU with a label from which a box is that label's
CELL, COLUMNS, ROWS = 110, 14, 9  # of a contact sheet [px, cells]


def proposals(image: LabelledImage, detector: Detector, length: float, known: np.ndarray) -> Boxes:
    """Boxes seen at two zooms that are not among the `known` ones (N, 5) [px of the image]; sizes are the geometric
    mean of both looks."""
    picture = PictureFile(image.path.name, image.path, image.width, image.height)
    zoom = min(LENGTH / length, MAX_ENLARGEMENT)
    first, second = (one_pass([picture], z, detector)[picture.name] for z in (zoom, zoom / np.sqrt(2)))
    i, j, _ = matched(first, second, SAME)
    xylwa = first.xylwa[i].copy()
    xylwa[:, 2:4] = np.sqrt(xylwa[:, 2:4] * second.xylwa[j, 2:4])
    both = Boxes(xylwa, (first.score[i] + second.score[j]) / 2)
    new = np.ones(len(both), bool)
    new[overlapping(both, Boxes(known, np.ones(len(known))), KNOWN)[0]] = False
    return both[new]


def cell(image: LabelledImage, box: np.ndarray, text: str) -> np.ndarray:
    """The picture around one box, which is drawn 60 px long; RGB (CELL, CELL, 3). Its contrast is stretched from black
    to white, for vehicles in the shade."""
    scale = 60 / box[2]
    shift = CELL / 2 - scale * box[:2]
    x, y = shift + scale / 2 - 0.5  # OpenCV puts a pixel's centre at its integer index
    pixels = cv2.warpAffine(
        image.level(0), np.array([[scale, 0, x], [0, scale, y]]), (CELL, CELL),
        flags=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC,
    )  # fmt: skip
    dark, bright = np.percentile(pixels, (1, 99))
    pixels = (np.clip((pixels - dark) / max(bright - dark, 1.0), 0, 1) * 255).astype(np.uint8)
    corners = Boxes(box[None], np.ones(1)).corners[0] * scale + shift - 0.5
    cv2.polylines(pixels, [corners.round().astype(np.int32)], True, (255, 230, 0), 1, cv2.LINE_AA)
    cv2.putText(pixels, text, (2, 11), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 60, 60), 1, cv2.LINE_AA)
    return pixels


def write_sheets(cells: dict[str, list[np.ndarray]], out: Path) -> None:
    """Write contact sheets ``out/NAME_00.png`` and so on of the cells, RGB (CELL, CELL, 3), by name."""
    page = COLUMNS * ROWS
    for name, sheet in cells.items():
        for first in range(0, len(sheet), page):
            part = sheet[first : first + page]
            part += [np.zeros((CELL, CELL, 3), np.uint8)] * (-len(part) % COLUMNS)
            rows = [np.hstack(part[k : k + COLUMNS]) for k in range(0, len(part), COLUMNS)]
            file = out / f"{name}_{first // page:02d}.png"
            cv2.imwrite(str(file), cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR))
        print(f"{name}: {len(sheet)} proposals")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--detector", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True, help="label file, or folder of pictures with one")
    parser.add_argument("--scenes", default="", help="comma separated; all by default")
    parser.add_argument("--unsure", action="store_true", help="propose boxes again that the labels ignore")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    detector = Detector(options.detector)
    scenes = set(filter(None, options.scenes.split(",")))
    images = read_labels(options.labels)
    if scenes:
        _, images = split(images, scenes)
    lengths: dict[str, list[float]] = {}
    for image in images:
        lengths.setdefault(image.scene, []).extend(image.vehicles[:, 2])
    found: dict[str, list[dict]] = {}
    cells: dict[str, list[np.ndarray]] = {}
    for image in images:
        typical = image.median_length or np.median(lengths[image.scene] or [image.usual_length])
        known = image.vehicles if options.unsure else image.boxes[image.kinds != "candidate"]
        boxes = proposals(image, detector, float(typical), np.concatenate([known, image.lookalikes]))
        boxes = boxes[np.argsort(-boxes.score)]
        found[image.path.name] = [
            {"box": row.round(2).tolist(), "score": round(float(score), 3), "kind": BACKGROUND}
            for row, score in zip(boxes.xylwa, boxes.score, strict=True)
        ]
        sheet = cells.setdefault(group_of(image.path.name), [])
        for row, score in zip(boxes.xylwa, boxes.score, strict=True):
            sheet.append(cell(image, row, f"{len(sheet)} .{score * 100:02.0f}"))
    (options.out / "proposals.json").write_text(json.dumps(found))
    write_sheets(cells, options.out)


if __name__ == "__main__":
    main()
