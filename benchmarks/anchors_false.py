"""How often finders take something else for an anchor: ``python benchmarks/anchors_false.py KIND [--draw FOLDER]``.

Searches for a kind in every real picture of ``../shared/data`` (or ``ORTHOSCALE_DATA``) and in drawn pictures of other
things: at their scale and with that wrong by a factor, as they are or mirrored, turned and shrunk. It prints what it
finds. Which finds are false has to be judged by eye, on the pictures that ``--draw`` writes. The scale of training
pictures is by their vehicles. Mpx are those that the finder sees; "fused" are the finds that would change a scale, as
they are probably anchors. The same ground turned, shrunk or with another scale is a new trial of the finder, but not
new ground: `hectares` are the area of the pictures.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from orthoscale.anchors.kinds import ANCHOR_KINDS, finder, slug
from orthoscale.sources.opening import open_source

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

from anchor_places import DATA, Sample, chips, read, scenes  # noqa: E402
from support.aerial import town  # noqa: E402
from support.courts import (  # noqa: E402
    GRASS,
    GREEN,
    basketball,
    court_picture,
    handball,
    penalty_area,
    tennis,
    volleyball,
)
from support.gridiron import field_picture  # noqa: E402
from support.markings import PAINT, picture, stroke  # noqa: E402
from support.running import running_track  # noqa: E402

VEHICLE = 4.4  # [m] median length of vehicles, for the scale of training pictures
GROUND_ALONE = 0.05  # [m/px] of training pictures without vehicles
COUNTRIES = {"munich": "DE", "minsk": "BY", "bogota": "CO", "warsaw": "PL"}
SD = 0.1
SHOWING = {"tennis court": ("tennis",)}  # by kind, how names of pictures begin that show some
FLIGHTS = "brighton", "weedon", "boruszyn"  # and `sheffield`, which has two tennis courts
DRAWN_GSD, TOWN_GSD = (0.12, 0.2, 0.3, 0.45), 0.12  # [m/px]
DRAWN_EACH, TOWNS = 4, 16


def training() -> Iterator[Sample]:
    """The training pictures of the detector; only every eighth of Munich, as they show the same street."""
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
        yield path.stem, read(path), own.get(image["file"], usual), COUNTRIES.get(image["set"], "US")


def flights() -> Iterator[Sample]:
    """Ground pictures of reconstructions, in which the program searches."""
    for name in FLIGHTS:
        folder = DATA / "reconstructions" / name
        known = json.loads((folder / "truth.json").read_text())
        posed = open_source(folder).posed
        assert posed is not None, "it is a reconstruction"
        for view in posed.ground_pictures:
            size = view.width, view.height
            gsd = known["metres_per_model_unit"] * view.unit_per_pixel
            yield f"{name}-{Path(view.name).stem}", view.read(0, 0, *size, *size), gsd, known["country"]


def drawn() -> Iterator[Sample]:
    """Pictures of things painted like a court: other courts, fields, running tracks, car parks, roofs of sheets."""
    rng = np.random.default_rng(6)
    for gsd, number in product(DRAWN_GSD, range(DRAWN_EACH)):
        turn = rng.uniform(0, np.pi)
        looks = {"blur_px": rng.uniform(0.5, 0.9), "noise": rng.uniform(1, 4), "seed": number}
        for paint in (volleyball, basketball, handball, penalty_area, tennis):
            size = 2 * [round(64 / gsd)]
            court = court_picture([(paint(), (32, 32), turn)], gsd, size, ground=GRASS, surface=GREEN, **looks)
            yield f"{paint.__name__}-{gsd}-{number}", court, gsd, "US"
        yield f"gridiron-{gsd}-{number}", field_picture(gsd, turn, **looks), gsd, "US"
        yield f"track-{gsd}-{number}", running_track(gsd, 110, (30, 20), turn, **looks), gsd, "US"
        looks["blur"] = looks.pop("blur_px")
        nose, pitch = rng.uniform(4.8, 5.6), rng.uniform(2.4, 2.9)
        rows = [(stroke(10 + pitch * k, y, 2 * nose, 0.1, 90), PAINT) for k in range(22) for y in (18, 36, 54)]
        rows += [(stroke(10 + pitch * 10.5, y, pitch * 21, 0.1), PAINT) for y in (18, 36, 54)]
        yield f"lot-{gsd}-{number}", picture(rows, gsd, (76, 72), np.degrees(turn), **looks), gsd, "US"
        sheet = rng.uniform(2.5, 4.5, 2)
        roof = [(stroke(10 + sheet[0] * k, 36, 52, 0.1, 90), PAINT) for k in range(int(52 / sheet[0]))]
        roof += [(stroke(36, 10 + sheet[1] * k, 52, 0.1), PAINT) for k in range(int(52 / sheet[1]))]
        yield f"roof-{gsd}-{number}", picture(roof, gsd, (72, 72), np.degrees(turn), **looks), gsd, "US"


def towns() -> Iterator[Sample]:
    """Drawn towns of random roofs, roads and trees."""
    for seed in range(TOWNS):
        yield f"town-{seed}", town(seed, 2000), TOWN_GSD, "US"


SORTS = {
    "chips": chips, "scenes": scenes, "training": training, "flights": flights, "drawn": drawn, "towns": towns,
}  # fmt: skip


def turned(image: np.ndarray, degrees: float) -> np.ndarray:
    """RGB `image` mirrored and turned about its middle, cropped to the largest upright part of the same aspect
    ratio."""
    if not degrees:
        return image
    height, width = image.shape[:2]
    rotation = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), degrees, 1.0)
    whole = cv2.warpAffine(np.ascontiguousarray(image[:, ::-1]), rotation, (width, height), flags=cv2.INTER_CUBIC)
    c, s = abs(np.cos(np.radians(degrees))), abs(np.sin(np.radians(degrees)))
    share = min(width / (width * c + height * s), height / (width * s + height * c))
    cut_x, cut_y = (int(np.ceil(side * (1 - share) / 2)) for side in (width, height))
    return whole[cut_y : height - cut_y, cut_x : width - cut_x]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=[slug(kind) for kind in ANCHOR_KINDS])
    parser.add_argument("--draw", type=Path)
    parser.add_argument("--sorts", nargs="+", choices=list(SORTS), default=list(SORTS))
    parser.add_argument("--factors", nargs="+", type=float, default=[1.0, 0.8, 1.25])
    parser.add_argument("--turns", nargs="+", type=float, default=[0.0], help="degrees; mirrored, too, where not 0")
    parser.add_argument("--coarser", nargs="+", type=float, default=[1.0], help="by how much pictures are shrunk")
    chosen = parser.parse_args()
    kind = next(kind for kind in ANCHOR_KINDS if slug(kind) == chosen.kind)
    look = finder(kind, {})
    if chosen.draw:
        chosen.draw.mkdir(parents=True, exist_ok=True)
    print("| kind | pictures | told, turned, shrunk | number | hectares | Mpx | found | fused | CPU s/Mpx |")
    print(9 * "|---" + "|")
    for sort, factor, turn, coarser in product(chosen.sorts, chosen.factors, chosen.turns, chosen.coarser):
        count = finds = fused = 0
        mpx = area = seconds = 0.0
        for name, whole, gsd, country in SORTS[sort]():
            told = gsd * factor * coarser
            if told > look.coarsest or name.startswith(SHOWING.get(kind, ())):
                continue
            image = turned(whole, turn)
            zoom = min(1.0, told / look.finest) / coarser
            size = [max(1, round(side * zoom)) for side in image.shape[1::-1]]
            seen = np.ascontiguousarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA) if zoom < 1 else image)
            start = time.process_time()
            found = look.find(seen, gsd * factor / zoom, SD, country)
            seconds += time.process_time() - start
            count, mpx = count + 1, mpx + size[0] * size[1] / 1e6
            area += image.shape[0] * image.shape[1] * gsd**2 / 1e4
            for k, anchor in enumerate(found):
                error = float(np.abs(np.log(anchor.metres_per_pixel() * zoom / gsd)).min())
                finds, fused = finds + 1, fused + (anchor.false < 0.5)
                print(
                    f"  {name}, told {factor:g} of its scale, turned {turn:g}, shrunk {coarser:g}: "
                    f"at {np.round(anchor.place / zoom)}, {anchor.standards[0].name}, off by {100 * error:.1f} %, "
                    f"false {anchor.false:.2f}",
                    flush=True,
                )
                if chosen.draw:
                    draw(seen, anchor.lines, chosen.draw / f"{name}-{factor:g}-{turn:g}-{coarser:g}-{k}.png")
        how = f"{factor:g}, {turn:g}, {coarser:g}"
        row = f"| {chosen.kind} | {sort} | {how} | {count} | {area:.0f} | {mpx:.1f} | {finds} | {fused} "
        print(f"{row}| {seconds / max(mpx, 1e-9):.2f} |", flush=True)


def draw(image: np.ndarray, lines: np.ndarray, path: Path) -> None:
    """Write the part of RGB `image` around `lines` [px], without and with these drawn."""
    canvas = image[..., ::-1].copy()
    for line in np.round((lines + 0.5) * 8).astype(int).tolist():
        cv2.line(canvas, line[0], line[1], (0, 255, 255), 1, cv2.LINE_AA, 3)
    low = np.maximum(lines.min((0, 1)) - 30, 0).astype(int)
    high = (lines.max((0, 1)) + 30).astype(int)
    part = np.s_[low[1] : high[1], low[0] : high[0]]
    cv2.imwrite(str(path), np.hstack([image[part][..., ::-1], canvas[part]]))


if __name__ == "__main__":
    main()
