r"""By how much readers and the measurer change a vehicle's size if its picture is reduced, sharpened and compressed.

    python -m training.measurer.reduced sheets --data ../shared/data --beside banepa --out runs/reduced
    python -m training.by_hand draw runs/reduced ANSWERS.json          # as any sheets, see training/by_hand.py
    python -m training.measurer.reduced keep runs/reduced ANSWERS.json --reader e --data ../shared/data
    python -m training.measurer.reduced told --measurer M.onnx --data ../shared/data --readers e g
    python -m training.measurer.reduced small --measurer M.onnx --data ../shared/data

The true edges of small vehicles are unknown, but for large ones several readers agree to 1 %. So another reader reads
large vehicles that were read before: some as they are, some reduced to the size of those at a doubtful place, and mixed
with vehicles of that place itself. The difference from the former readers is the reader's bias, not the measurer's.
`keep` writes labels/read_again_X.json (vehicles read as they are) and labels/read_reduced_X.json.

`small`: by how many pixels the measurer makes vehicles larger if they are small, in pictures reduced in several ways.
This is the card's margin, apart from its error on large ones (`training.measurer.evaluate rendered`).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.boxes import Boxes
from orthoscale.core.normal import median_and_sd
from orthoscale.detect.measurer import Measurer
from training.by_hand import BY_HAND, Cell, cell_about, measured, read_answers, store, write_sheets
from training.data import as_stored
from training.evaluate import measured_scenes

from .chain import jpeg, sharpen
from .evaluate import trusted

SMALL = (22.0, 34.0)  # lengths of the reduced vehicles [px], as of the cars in `banepa`
LARGE = 44.0  # least length of vehicles that are reduced [px]
LENGTHS = (13, 16, 20, 28)  # of vehicles in `small` [px]
SHARP = ("brighton", "chongqing", "kampala", "manila", "tianjin", "weedon")  # test places of large vehicles
AROUND = 3.0  # half side of the window around a vehicle's centre, in vehicle lengths
SOURCES = "sources.json"  # in the sheets' folder: the origin of each reduced picture


Way = Callable[[np.ndarray], np.ndarray]  # the processing of a picture (H, W, 3), light 0..1, after its reduction


def _blurred(sigma: float) -> Way:
    return lambda x: cv2.GaussianBlur(x, (0, 0), sigma)


def _sharpened(soft: float, amount: float, radius: float, quality: int) -> Way:
    return lambda x: jpeg(np.clip(sharpen(_blurred(soft)(x), amount, radius), 0, 1), quality)


def _stretched(x: np.ndarray) -> np.ndarray:
    soft = _blurred(0.6)(x)
    low, high = np.percentile(soft, (3, 97))
    return jpeg(np.clip((soft - low) / (high - low), 0, 1), 80)


def _enlarged(x: np.ndarray) -> np.ndarray:
    small = cv2.resize(x, None, fx=1 / 1.6, fy=1 / 1.6, interpolation=cv2.INTER_AREA)
    return cv2.resize(small, x.shape[1::-1], interpolation=cv2.INTER_CUBIC)


AS_BANEPA = "sharpened, as banepa"
WAYS: dict[str, Way] = {
    "by area": lambda x: x,
    AS_BANEPA: _sharpened(0.5, 0.8, 1.0, 75),
    "sharpened more": _sharpened(0.7, 1.2, 1.2, 85),
    "contrast stretched": _stretched,
    "enlarged 1.6 times": _enlarged,
    "blurred by 1 px": _blurred(1.0),
    "blurred by 1.5 px": _blurred(1.5),
}


def reduced(pixels: np.ndarray, factor: float, way: Way) -> np.ndarray:
    """`pixels` (H, W, 3) uint8 at `factor` times the size, and then processed in the way `way`."""
    size = round(pixels.shape[1] * factor), round(pixels.shape[0] * factor)
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    return np.asarray(np.clip(np.round(255 * way(small)), 0, 255)).astype(np.uint8)


def window(picture: Path, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pixels of a picture around `box` (5,), BGR, and the box in them."""
    half = int(AROUND * box[2])
    x, y = (max(int(c) - half, 0) for c in box[:2])
    return as_stored(picture)[y : y + 2 * half, x : x + 2 * half].copy(), box - [x, y, 0, 0, 0]


def made_small(
    pixels: np.ndarray, box: np.ndarray, factor: float, way: str = AS_BANEPA
) -> tuple[np.ndarray, np.ndarray]:
    """A `window` and the box in it, `reduced` in one of WAYS."""
    fewer = reduced(pixels, factor, WAYS[way])
    shrunk = np.array([fewer.shape[1] / pixels.shape[1], fewer.shape[0] / pixels.shape[0]])
    return fewer, box * [*shrunk, *[np.sqrt(shrunk.prod())] * 2, 1]


def sheets(data: Path, places: Sequence[str], beside: str, count: int, seed: int, folder: Path) -> None:
    """Draw `count` large vehicles of each of `places`, two of three reduced, and as many small ones of the place
    `beside` as are reduced.

    None is drawn twice: a reader would measure one by the other.
    """
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    cells: list[Cell] = []
    sources: dict[str, dict] = {}
    for scene in measured_scenes(data):
        vehicles = [(p.picture.path, box) for p in scene.pictures for box in p.vehicles]
        if scene.name == beside:
            some = [v for v in vehicles if v[1][2] < SMALL[1]]
            chosen = [some[k] for k in rng.permutation(len(some))[: 2 * count * len(places) // 3]]
            cells += [cell_about(scene.name, path, box, rng) for path, box in chosen]
        elif scene.name in places:
            large = [v for v in vehicles if v[1][2] > LARGE]
            for n, k in enumerate(rng.permutation(len(large))[:count]):
                path, box = large[k]
                if n % 3 == 0:
                    cells.append(cell_about(scene.name, path, box, rng))
                    continue
                factor = rng.uniform(*SMALL) / box[2]
                pixels, there = made_small(*window(path, box), factor)
                name = f"reduced_{len(sources):03d}.png"
                cv2.imwrite(str(folder / name), pixels)
                sources[name] = {
                    "picture": str(path.relative_to(data)),
                    "label": box.round(2).tolist(),
                    "factor": factor,
                }
                cells.append(cell_about(scene.name, folder / name, there, rng))
    (folder / SOURCES).write_text(json.dumps(sources))
    write_sheets(folder, [cells[k] for k in rng.permutation(len(cells))])


def keep(folder: Path, answers: Path, reader: str, data: Path) -> None:
    sources = json.loads((folder / SOURCES).read_text())
    read = measured(folder, [read_answers(answers)], data)
    small = [
        {
            "scene": row["scene"],
            **sources[row["picture"]],
            "read": (np.array(row["read"][2:4]) / row["label"][2]).round(4).tolist(),
        }
        for row in read if row["picture"] in sources
    ]  # fmt: skip
    again = [row for row in read if row["picture"] not in sources]
    for name, what, rows in (
        ("again", "Vehicles that this reader measured by eye once more, among reduced ones.", again),
        ("reduced", "The same, reduced by `factor`: read is length and width by the label's length there.", small),
    ):
        text = f"{what} Reader {reader.upper()}, by training/measurer/reduced.py."
        store(BY_HAND.with_name(f"read_{name}_{reader}.json"), {"what": text, "vehicles": rows})


def told_size(measurer: Measurer, pixels: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(2,) the measurer's length and width in `pixels`, BGR, divided by the length of `box` (5,); NaN if unsure."""
    found = measurer.in_pixels(np.ascontiguousarray(pixels[..., ::-1]), Boxes(box[None], np.ones(1)))
    return np.where(trusted(found)[0], found.boxes.xylwa[0, 2:4] / box[2], np.nan)


def small(measurer: Measurer, data: Path, places: Sequence[str]) -> str:
    """By how many pixels the measurer makes lengths and widths of large vehicles larger if they are reduced: medians
    over all vehicles, by length and way."""
    lines = [f"{'':22s}" + "".join(f"{length:14d} px" for length in LENGTHS)]
    vehicles = [
        window(p.picture.path, box) for scene in measured_scenes(data) if scene.name in places
        for p in scene.pictures for box in p.vehicles if box[2] > LARGE
    ]  # fmt: skip
    before = [told_size(measurer, *vehicle) for vehicle in vehicles]
    for way in WAYS:
        cells = []
        for length in LENGTHS:
            larger = []
            for (pixels, box), sharp in zip(vehicles, before, strict=True):
                after = told_size(measurer, *made_small(pixels, box, length / box[2], way))
                larger.append(length * (after - sharp))
            cells.append("{:+8.2f} {:+5.2f}".format(*np.nanmedian(larger, axis=0)))
        lines.append(f"{way:22s}" + "   ".join(cells))
    return f"{len(vehicles)} vehicles: length, width [px]\n" + "\n".join(lines)


def told(measurer: Measurer, data: Path, readers: Sequence[str]) -> str:
    """Changes of vehicles' sizes by a reduction, according to each reader and to the measurer; medians and their one
    sigma."""

    def line(name: str, changes: Sequence[np.ndarray]) -> str:
        rows = np.array([c for c in changes if np.isfinite(c).all()])
        median, spread = median_and_sd(rows)
        error = spread * np.sqrt(np.pi / 2 / len(rows))
        parts = (f"{100 * m:+5.1f} +- {100 * e:.1f} %" for m, e in zip(median, error, strict=True))
        return f"{name:44s} {len(rows):3d}: length {{}}, width {{}}".format(*parts)

    lines = []
    for reader in readers:
        again, read_small = (
            json.loads(BY_HAND.with_name(f"read_{name}_{reader}.json").read_text())["vehicles"]
            for name in ("again", "reduced")
        )
        places = {row["scene"] for row in read_small}
        habit, changed, reduced_ones, doubtful = [], [], [], []
        for row in again:
            box, read = np.array(row["label"]), np.array(row["read"][2:4])
            if row["scene"] in places:
                habit.append(np.log(read / box[2:4]))
            else:
                told_there = told_size(measurer, *window(data / row["picture"], box))
                doubtful.append(np.log(told_there * box[2] / read))
        small_habit = [np.log(np.array(row["read"]) * row["label"][2] / row["label"][2:4]) for row in read_small]
        for row in read_small:
            large = window(data / row["picture"], np.array(row["label"]))
            after = told_size(measurer, *made_small(*large, row["factor"]))
            changed.append(np.log(after / told_size(measurer, *large)))
            reduced_ones.append(np.log(after / row["read"]))
        lines += [
            line(f"{reader.upper()} against readers before, as they are", habit),
            line("  reduced", small_habit),
            line("  measurer: reduced against as they are", changed),
            line("  measurer against reader: reduced", reduced_ones),
            line("  measurer against reader: place in doubt", doubtful),
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("sheets")
    draw.add_argument("--beside", required=True, help="place of small vehicles that is in doubt")
    draw.add_argument("--count", type=int, default=10, help="vehicles of each place (%(default)s)")
    draw.add_argument("--seed", type=int, default=0)
    draw.add_argument("--out", type=Path, required=True)
    kept = commands.add_parser("keep")
    kept.add_argument("folder", type=Path)
    kept.add_argument("answers", type=Path)
    kept.add_argument("--reader", required=True, help="letter of the reader")
    tell = commands.add_parser("told")
    tell.add_argument("--measurer", type=Path, required=True)
    tell.add_argument("--readers", nargs="+", required=True)
    make = commands.add_parser("small")
    make.add_argument("--measurer", type=Path, required=True)
    for command in (draw, make):
        command.add_argument("--places", nargs="+", default=SHARP)
    for command in (draw, kept, tell, make):
        command.add_argument("--data", type=Path, required=True)
    options = parser.parse_args()
    if options.command == "sheets":
        sheets(options.data, options.places, options.beside, options.count, options.seed, options.out)
    elif options.command == "keep":
        keep(options.folder, options.answers, options.reader, options.data)
    elif options.command == "small":
        print(small(Measurer(options.measurer), options.data, options.places))
    else:
        print(told(Measurer(options.measurer), options.data, options.readers))


if __name__ == "__main__":
    main()
