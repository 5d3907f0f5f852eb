"""How often finders take something else for an anchor: ``python benchmarks/anchors_false.py KIND [--draw FOLDER]``.

Looks for a kind in every real picture of ``../shared/data`` (or ``ORTHOSCALE_DATA``), at its scale and as if that were
wrong by a factor, and prints what it finds; which of that is false is for eyes to say, on the pictures that ``--draw``
writes. The scale of training pictures is that of their vehicles. Mpx are those that the finder sees, after shrinking;
"fused" are the finds that would move a scale, of an anchor that is probably one.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from orthoscale.anchors.kinds import ANCHOR_KINDS, finder, slug

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared" / "data")
CHIP_GSD = 0.3048
VEHICLE = 4.4  # [m] median length of vehicles, for the scale of training pictures
GROUND_ALONE = 0.05  # [m/px] of training pictures without vehicles
COUNTRIES = {"munich": "DE", "minsk": "BY", "bogota": "CO", "warsaw": "PL"}
SD = 0.1


def chips() -> Iterator[tuple[Path, float, str]]:
    """American pictures of a foot per pixel."""
    for path in sorted((DATA / "vehicles" / "chips").glob("*.jpg")):
        yield path, CHIP_GSD, "US"


def scenes() -> Iterator[tuple[Path, float, str]]:
    """Orthophotos and straight-down frames; no montages, which are made of chips."""
    for folder in ("places", "orthophotos"):
        for name, known in json.loads((DATA / folder / "truth.json").read_text()).items():
            if "gsd_m" in known and not name.startswith("us_"):
                yield DATA / folder / name, known["gsd_m"], known["country"]


def training() -> Iterator[tuple[Path, float, str]]:
    """The pictures that the detector was trained on; of Munich every eighth, they show the same street."""
    images = json.loads((DATA / "vehicles" / "labels.json").read_text())["images"]
    own: dict[str, float] = {}
    by_set: dict[str, list[float]] = {}
    for image in images:
        lengths = [box["length"] for box in image["boxes"] if box["kind"] == "vehicle"]
        if len(lengths) > 4:
            own[image["file"]] = VEHICLE / float(np.median(lengths))
            by_set.setdefault(image["set"], []).append(own[image["file"]])
    munich = [image for image in images if image["set"] == "munich"]
    for image in [image for image in images if image["set"] != "munich"] + munich[::8]:
        usual = float(np.median(by_set.get(image["set"], [GROUND_ALONE])))
        path = DATA / "vehicles" / "images" / image["file"]
        yield path, own.get(image["file"], usual), COUNTRIES.get(image["set"], "US")


SORTS = {"chips": chips, "scenes": scenes, "training": training}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=[slug(kind) for kind in ANCHOR_KINDS])
    parser.add_argument("--draw", type=Path)
    parser.add_argument("--sorts", nargs="+", choices=list(SORTS), default=list(SORTS))
    parser.add_argument("--factors", nargs="+", type=float, default=[1.0, 0.8, 1.25])
    chosen = parser.parse_args()
    look = finder(next(kind for kind in ANCHOR_KINDS if slug(kind) == chosen.kind), {})
    if chosen.draw:
        chosen.draw.mkdir(parents=True, exist_ok=True)
    for sort in chosen.sorts:
        for factor in chosen.factors:
            count = finds = fused = 0
            mpx = seconds = 0.0
            for path, gsd, country in SORTS[sort]():
                told = gsd * factor
                if told > look.coarsest:
                    continue
                image = np.asarray(cv2.imread(str(path)))[..., ::-1]
                zoom = min(1.0, told / look.finest)
                size = [max(1, round(side * zoom)) for side in image.shape[1::-1]]
                seen = np.ascontiguousarray(
                    cv2.resize(image, size, interpolation=cv2.INTER_AREA) if zoom < 1 else image
                )
                start = time.process_time()
                found = look.find(seen, told / zoom, SD, country)
                seconds += time.process_time() - start
                count, mpx = count + 1, mpx + size[0] * size[1] / 1e6
                for k, anchor in enumerate(found):
                    error = float(np.abs(np.log(anchor.metres_per_pixel() * zoom / gsd)).min())
                    finds, fused = finds + 1, fused + (anchor.false < 0.5)
                    print(
                        f"  {path.name}, told {factor:g} of its scale: at {np.round(anchor.place / zoom)}, "
                        f"{anchor.standards[0].name}, off by {100 * error:.1f} %, false {anchor.false:.2f}",
                        flush=True,
                    )
                    if chosen.draw:
                        draw(seen, anchor.lines, chosen.draw / f"{path.stem}-{factor:g}-{k}.png")
            row = f"| {chosen.kind} | {sort} | {factor:g} | {count} | {mpx:.1f} | {finds} | {fused} "
            print(f"{row}| {seconds / max(mpx, 1e-9):.2f} |", flush=True)


def draw(image: np.ndarray, lines: np.ndarray, path: Path) -> None:
    """What is about `lines` [px] in RGB `image`, without and with them."""
    canvas = image[..., ::-1].copy()
    for line in np.round((lines + 0.5) * 8).astype(int).tolist():
        cv2.line(canvas, line[0], line[1], (0, 255, 255), 1, cv2.LINE_AA, 3)
    low = np.maximum(lines.min((0, 1)) - 30, 0).astype(int)
    high = (lines.max((0, 1)) + 30).astype(int)
    part = np.s_[low[1] : high[1], low[0] : high[0]]
    cv2.imwrite(str(path), np.hstack([image[part][..., ::-1], canvas[part]]))


if __name__ == "__main__":
    main()
