r"""Cuts real vehicles, and places without any, from labelled pictures, with their surroundings.

    python -m training.measurer.real runs/bank --labels ../shared/data/vehicles/labels.json \\
        --labels ../shared/data/vehicles/chips --hand ../shared/data --kinds ../shared/data

Written are a file for each scene; for the scenes of READ one more with vehicles whose edges were read by eye
(``hand_SCENE.npz``); and for those of TOLD one more with vehicles whose kind was determined by eye
(``kind_SCENE.npz``). Places of known scale are not among them. Boxes are as `training.data` reads them. Boxes that were
judged not to be vehicles, and random places clear of all boxes, are stored as "none"; of the chips' boxes, only those
are stored.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from orthoscale.detect.measurer import ANSWERS
from training.data import LabelledImage, as_stored, read_labels
from training.evaluate import measured_scenes
from training.kinds import LABELS

SCENES = ("munich", "minsk", "bogota", "warsaw")  # whose vehicles are trained on; those of others are held out
EMPTY = ("park", "dunes")
DECEIVING = ("buildings", "harbor", "storagetanks", "tenniscourt")  # of which only things like vehicles are kept
SMALLEST = 12.0  # vehicles shorter than this are not trained on [px]
CROP_LENGTHS = 1.6  # half side of a patch around a vehicle's centre, in vehicle lengths
GROUND = 6  # random places without a vehicle from each picture, EMPTY_GROUND from those of scenes without any
EMPTY_GROUND = 25
GROUND_LENGTHS = (16.0, 90.0)  # of the box at a place without a vehicle [px]
READ = (*SCENES, "judged", "ohio", "chips")  # whose edges, read by eye, are trained on; other places are for tests
# The same for kinds; the chips' pictures are named by what they show.
TOLD = (*SCENES, "judged", "ohio", "buildings", "denseresidential", "freeway", "intersection", "mobilehomepark",
        "overpass", "parkinglot", "storagetanks", "tenniscourt")  # fmt: skip
SLANTED = ("sheffield",)  # scenes of oblique frames, where readers and measurers mean different edges
WIDTH_HABIT = 1.027  # factor by which readers saw widths too small (labels/margins.json)
NONE, UNKNOWN = ANSWERS.index("none"), -1


@dataclass(frozen=True)
class Patch:
    """pixels : (H, W, 3) uint8 RGB. box : (5,) in it. whole : bool, not cut by the picture's edge. kind : index
    into ANSWERS, or UNKNOWN for a vehicle of any kind."""

    pixels: np.ndarray
    box: np.ndarray
    whole: bool
    kind: int


def patches(image: LabelledImage, rng: np.random.Generator) -> list[Patch]:
    """All vehicles of a labelled picture, and places without any; of a DECEIVING scene only things like vehicles."""
    pixels = cv2.imread(str(image.path), cv2.IMREAD_COLOR)
    if pixels is None:
        raise FileNotFoundError(f"{image.path}: not an image that OpenCV can read")
    pixels = pixels[..., ::-1]
    wanted = [(box, NONE) for box in image.lookalikes if box[2] > SMALLEST]
    random = 0
    if image.scene not in DECEIVING:
        wanted += [(box, UNKNOWN) for box in image.vehicles if box[2] > SMALLEST]
        random = GROUND if len(image.boxes) else EMPTY_GROUND
    for _ in range(random):
        length = image.median_length or np.exp(rng.uniform(*np.log(GROUND_LENGTHS)))
        length *= rng.uniform(0.7, 1.4)
        place = clear_place(image.width, image.height, image.boxes, length, rng)
        if place is not None:
            wanted.append((np.array([*place, length, 0.42 * length, rng.uniform(0, 2 * np.pi)]), NONE))
    cut = [_patch(pixels, box, kind) for box, kind in wanted]
    return [patch for patch in cut if patch is not None]


def clear_place(
    width: int, height: int, boxes: np.ndarray, length: float, rng: np.random.Generator
) -> np.ndarray | None:
    """(2,) a random place [px] in a picture of `width` x `height` px; None if a vehicle of `length` px there might
    touch one of the `boxes` (N, 5)."""
    place = rng.uniform(0, 1, 2) * (width, height)
    clear = (np.hypot(*(boxes[:, :2] - place).T) > 0.6 * boxes[:, 2] + 0.3 * length).all()
    return place if clear else None


def read_patches(path: Path, read: np.ndarray) -> list[Patch]:
    """The vehicles of one picture whose boxes (N, 5) were read by eye."""
    return _patches(path, [(box * [1, 1, 1, WIDTH_HABIT, 1], UNKNOWN) for box in read])


def told_patches(data: Path, told: Iterable[Mapping[str, Any]]) -> list[Patch]:
    """Vehicles in the form of labels/kinds.json, whose pictures lie under `data`."""
    return [
        patch
        for picture, some in by_name(told, "picture").items()
        for patch in _patches(data / picture, [(np.array(v["box"]), ANSWERS.index(v["kind"])) for v in some])
    ]


def by_name(vehicles: Iterable[Mapping[str, Any]], name: str) -> dict[str, list[Mapping[str, Any]]]:
    """The vehicles grouped by their entry `name`."""
    some: dict[str, list[Mapping[str, Any]]] = {}
    for vehicle in vehicles:
        some.setdefault(vehicle[name], []).append(vehicle)
    return some


def _patches(path: Path, wanted: Iterable[tuple[np.ndarray, int]]) -> list[Patch]:
    pixels = as_stored(path)[..., ::-1]
    cut = [_patch(pixels, box, kind) for box, kind in wanted]
    return [patch for patch in cut if patch is not None]


def _patch(pixels: np.ndarray, box: np.ndarray, kind: int) -> Patch | None:
    """A box with its surroundings; None if hardly any of it lies in the picture."""
    reach = CROP_LENGTHS * max(box[2], 2 * box[3]) + 4
    height, width = pixels.shape[:2]
    x0, y0 = np.maximum(np.floor(box[:2] - reach), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(box[:2] + reach), (width, height)).astype(int)
    if min(x1 - x0, y1 - y0) < 8:
        return None
    half = (box[2] + box[3]) / 2
    whole = bool(half < box[0] < width - half and half < box[1] < height - half)
    return Patch(pixels[y0:y1, x0:x1], box - [x0, y0, 0, 0, 0], whole, kind)


def save(file: Path, found: list[Patch]) -> None:
    np.savez(
        file,
        pixels=np.concatenate([p.pixels.reshape(-1) for p in found]),
        shapes=np.array([p.pixels.shape for p in found]),
        boxes=np.array([p.box for p in found]),
        whole=np.array([p.whole for p in found]),
        kind=np.array([p.kind for p in found]),
    )


def load(file: Path) -> list[Patch]:
    with np.load(file) as stored:
        shapes = stored["shapes"]
        parts = np.split(stored["pixels"], np.cumsum(shapes.prod(1))[:-1])
        rows = zip(parts, shapes, stored["boxes"], stored["whole"], stored["kind"], strict=True)
        return [Patch(part.reshape(shape), box, bool(whole), int(kind)) for part, shape, box, whole, kind in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder")
    parser.add_argument("--labels", type=Path, action="append", default=[], help="label file; may be repeated")
    parser.add_argument("--hand", type=Path, metavar="DATA", help="folder of the pictures of labels/by_hand.json")
    parser.add_argument("--kinds", type=Path, metavar="DATA", help="folder of the pictures of labels/kinds.json")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(16)
    scenes: dict[str, list[Patch]] = {}
    for image in (i for file in options.labels for i in read_labels(file)):
        if image.scene in SCENES + EMPTY + DECEIVING:
            scenes.setdefault(image.scene, []).extend(patches(image, rng))
    for scene, found in scenes.items():
        save(options.out / f"real_{scene}.npz", found)
        print(f"{scene}: {sum(p.kind == UNKNOWN for p in found)} vehicles, {sum(p.kind == NONE for p in found)} others")
    for scene in measured_scenes(options.hand) if options.hand else ():
        if scene.name in READ:
            read = [patch for p in scene.pictures for patch in read_patches(p.picture.path, p.vehicles)]
            save(options.out / f"hand_{scene.name}.npz", read)
            print(f"{scene.name}: {len(read)} vehicles read by eye")
    told = json.loads(LABELS.read_text())["vehicles"] if options.kinds else []
    for name, some in by_name(told, "scene").items():
        if name in TOLD and (cut := told_patches(options.kinds, some)):
            save(options.out / f"kind_{name}.npz", cut)
            print(f"{name}: {len(cut)} vehicles whose kind was told by eye")


if __name__ == "__main__":
    main()
