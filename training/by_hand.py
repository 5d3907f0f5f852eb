r"""Vehicles measured by hand, and by how much the labels of each scene exceed them in length and width.

    python -m training.by_hand sheets --labels ../shared/data/vehicles/labels.json \\
        --labels runs/synthetic/labels.json --checked ../shared/data --out runs/by_hand
    python -m training.by_hand sheets --found manila=../shared/data/orthophotos/manila.tif:BOXES.json --smallest 8 \\
        --out runs/by_hand/manila                                   # places that nobody has labelled
    python -m training.by_hand sheets --again ../shared/data --out runs/again   # once more, by other readers
    python -m training.by_hand draw runs/by_hand READINGS.json      # what was read, drawn onto the sheets
    python -m training.by_hand keep runs/by_hand READINGS.json [READINGS.json ...] --data ../shared/data
    python -m training.by_hand margins                              # of all that was kept, in labels/by_hand.json

`sheets` draws vehicles of all scenes that were not measured before: in random order, enlarged, roughly level, without
any box, each at a scale and place of its own, so that one cell says nothing about the next. A reader marks the ends of
each vehicle, checks and corrects the marks on drawn sheets, and leaves out vehicles that cannot be measured. `--found`
needs only a detector's boxes (a detections file, or a plain
``{picture: [{cx, cy, length, width, angle, score}]}``), which serve only to find the vehicles. What is read `--again`
is averaged with former readings, each reader having equal weight.

READINGS.json is ``{"CELL": [left, right, top, bottom, tilt] or null, ...}``: the ends of the vehicle in its cell [px of
the cell, as on its rulers], after the vehicle was turned level about its centre by `tilt` [deg, clockwise on screen];
null for what cannot be measured within 3 %. `READING` explains how to read, and is written beside the sheets.

The margin of a scene's labels is the median of label - reading, separately for lengths and widths, in pixels of the
scene's pictures. It does not depend on metres or a fleet. Two things show the reader's own bias: rendered vehicles,
whose labels are exact (the margin of ``synthetic`` should be zero), and places of known scale, where a fleet's mean
size is known.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from orthoscale.core.angles import axis_angle
from orthoscale.core.boxes import Boxes
from orthoscale.core.normal import median_and_sd

from .data import as_stored, read_labels
from .evaluate import BY_HAND, checked_scenes, measured_scenes, reference_scene

CELL = (400, 230)  # width, height [px of the sheet]; vision models see a sheet of twelve without reducing it
COLUMNS, ROWS = 3, 4
PER_SHEET = COLUMNS * ROWS
LENGTHS = (230.0, 310.0)  # of a vehicle's label in its cell [px]
SHIFT = 16.0  # largest shift of the label's centre from the cell's, either way [px]
TURN = 4.0  # largest rotation of the label from level, either way [deg]
SMALLEST = 24.0  # vehicles shorter than this are not measured, unless asked for [px of the picture]
TICK, LINE = 10, 50  # between marks of a cell's rulers, and between its numbered lines [px]
READING = """How to read the sheets of this folder (sheet_00.png, sheet_01.png, ...).

Each cell shows one vehicle, about level, enlarged, near its middle. The rulers at the left and upper edge
count the cell's own pixels: a mark each 10, a faint line each 50, numbered each 100. "cell N" is at the lower right.

Answer with one JSON file, {"N": [left, right, top, bottom, tilt], ...}, a line for every cell:
- left, right: x where the vehicle's two ends (bumpers) are; top, bottom: y where its two sides are; to 1 px.
  The end is the middle of the transition between vehicle and ground, not the outer rim of its blur or halo.
- Bumper to bumper, with flanks and wheels in sight. Not: mirrors, shadow, a tow bar, luggage, blur, sharpening's halo.
  A shadow's side: the vehicle ends where the paint (or the dark gap below the sill) ends, not where the shadow does.
- tilt: how far the vehicle is turned from level, in degrees, clockwise on screen positive (right end lower).
  left, right, top and bottom are those of the vehicle after it was turned level about its own centre.
- null instead of the list for what cannot be told within 3 % of the length: hidden, cut, too blurred, no vehicle.
  An edge that merges with a neighbour or a shadow makes the cell null.
Read each cell for itself; vehicles differ in size, and each cell has another scale. Look at a cell enlarged if you can
(crop the PNG and magnify it 2 to 3 times) before you answer. Then draw your answers and correct them:

    python -m training.by_hand draw FOLDER ANSWERS.json        # writes drawn_00.png, ... beside the sheets
"""
JUDGED = "judged"  # the vehicles of labels/judged.json, of whatever scene: one detector drew them all


@dataclass(frozen=True)
class Cell:
    """One vehicle on a sheet. to_cell : (2, 3) affine map from the picture [px, corner origin] to the cell.
    label : (5,) its label as drawn, before any margin is taken off [px of the picture]."""

    scene: str
    picture: Path
    to_cell: np.ndarray
    label: np.ndarray


def choose(
    pictures: Iterable[tuple[str, Path, np.ndarray, tuple[int, int]]],
    count: int,
    seed: int,
    smallest: float = SMALLEST,
    kept: Iterable[dict] = (),
) -> list[Cell]:
    """`count` vehicles of each scene, at least `smallest` px long, in random order, from as many pictures as possible.

    pictures : scene, file, vehicles (N, 5) and (width, height) [px] of each.
    kept : vehicles in the form of labels/by_hand.json that were measured before, and are left out.
    """
    before: dict[str, list[list[float]]] = {}
    for vehicle in kept:
        before.setdefault(Path(vehicle["picture"]).name, []).append(vehicle["read"])
    rng = np.random.default_rng(seed)
    scenes: dict[str, list[tuple[int, float, Path, np.ndarray]]] = {}
    for scene, file, boxes, (width, height) in pictures:
        fit = Boxes(boxes, np.ones(len(boxes))).inside(width, height, 8.0) & (boxes[:, 2] > smallest)
        whole = boxes[fit & ~_measured_before(boxes, before.get(file.name, [])).any(1)]
        # A picture's second vehicle comes after every picture's first.
        scenes.setdefault(scene, []).extend(
            (n, rng.random(), file, box) for n, box in enumerate(rng.permutation(whole))
        )
    chosen = (
        (scene, vehicle) for scene, all_ in scenes.items() for vehicle in sorted(all_, key=lambda v: v[:2])[:count]
    )
    cells = [cell_about(scene, file, box, rng) for scene, (_, _, file, box) in chosen]
    return [cells[k] for k in rng.permutation(len(cells))]


def _measured_before(boxes: np.ndarray, read: Sequence[Sequence[float]]) -> np.ndarray:
    """(N, M) bool: the centre of box N lies within half a vehicle's width of that of vehicle M that was read."""
    there = np.array(read, float).reshape(-1, 5)
    apart = np.hypot(*(boxes[:, None, :2] - there[:, :2]).transpose(2, 0, 1))
    return np.asarray(apart < there[:, 3] / 2)


def cell_about(scene: str, picture: Path, box: np.ndarray, rng: np.random.Generator) -> Cell:
    """A cell with the vehicle in `box` (5,) of a picture, at a random scale, place and rotation."""
    scale = rng.uniform(*LENGTHS) / box[2]
    turn = -box[4] + np.radians(rng.uniform(-TURN, TURN)) + np.pi * rng.integers(2)
    linear = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    shift = np.array(CELL) / 2 + rng.uniform(-SHIFT, SHIFT, 2) - linear @ box[:2]
    return Cell(scene, picture, np.c_[linear, shift], box)


def enlarged(cell: Cell, share: float = 1.0) -> np.ndarray:
    """The cell's picture, BGR, its contrast stretched, at `share` of the size of CELL."""
    image = as_stored(cell.picture)
    linear, shift = share * cell.to_cell[:, :2], share * cell.to_cell[:, 2]
    centres = np.c_[linear, shift + linear @ (0.5, 0.5) - 0.5]  # OpenCV puts a pixel's centre at its integer index
    size = (int(share * CELL[0]), int(share * CELL[1]))
    pixels = cv2.warpAffine(image, centres, size, flags=cv2.INTER_CUBIC).astype(np.float32)
    low, high = np.percentile(pixels, (1, 99))
    return np.clip((pixels - low) / max(high - low, 1) * 235 + 10, 0, 255).astype(np.uint8)


def draw_cell(cell: Cell) -> np.ndarray:
    """`enlarged`, with a scale in cell pixels at its edges and a faint grid."""
    canvas = enlarged(cell)
    lines = canvas.copy()
    for axis, size in enumerate(CELL):
        for at in range(0, size, TICK):
            end = CELL[1 - axis] if at % LINE == 0 else 4
            onto = lines if at % LINE == 0 else canvas
            cv2.line(onto, *(((at, 0), (at, end)) if axis == 0 else ((0, at), (end, at))), (255, 255, 255), 1)
            if at % (2 * LINE) == 0 and at:
                place = (at + 2, 14) if axis == 0 else (6, at - 2)
                cv2.putText(canvas, str(at), place, cv2.FONT_HERSHEY_SIMPLEX, 0.36, (0, 255, 255), 1, cv2.LINE_AA)
    return cv2.addWeighted(canvas, 0.8, lines, 0.2, 0)


def read_box(reading: Sequence[float]) -> np.ndarray:
    """(5,) box [px of the cell] of a reading: left, right, top and bottom end of the vehicle after it was turned level
    about its centre [px], and its tilt from level, clockwise on screen [deg]."""
    left, right, top, bottom, tilt = reading
    return np.array([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top, np.radians(tilt)])


def to_picture(box: np.ndarray, to_cell: np.ndarray) -> np.ndarray:
    """(5,) box of a cell in its picture's pixels."""
    linear, shift = to_cell[:, :2], to_cell[:, 2]
    scale = np.sqrt(np.linalg.det(linear))
    turn = np.arctan2(linear[1, 0], linear[0, 0])
    return np.array([*np.linalg.solve(linear, box[:2] - shift), box[2] / scale, box[3] / scale, box[4] - turn])


def margins(kept: Iterable[dict]) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """By scene: margin of its labels in length and width (2,) [px], a median; its uncertainty (2,); and the measured
    sizes (N, 2) [px]. kept : vehicles in the form of labels/by_hand.json."""
    sizes: dict[str, list[tuple[list[float], list[float]]]] = {}
    for vehicle in kept:
        sizes.setdefault(vehicle["scene"], []).append((vehicle["label"][2:4], vehicle["read"][2:4]))
    told = {}
    for scene, pairs in sizes.items():
        label, read = np.array(pairs).transpose(1, 0, 2)
        median, spread = median_and_sd(label - read)
        # The variance of a normal sample's median is pi/2 times that of its mean.
        told[scene] = (median, spread * np.sqrt(np.pi / 2 / len(read)), read)
    return told


def sheet_options(parser: argparse.ArgumentParser, smallest: float, count: int) -> None:
    """Add the options that `pictures_of` and `choose` need."""
    parser.add_argument("--labels", type=Path, action="append", default=[], help="label file; may be repeated")
    parser.add_argument("--checked", type=Path, metavar="DATA", help="folder of the pictures of labels/checked.json")
    parser.add_argument("--again", type=Path, metavar="DATA", help="folder of the pictures of labels/by_hand.json")
    parser.add_argument("--found", action="append", default=[], metavar="NAME=IMAGES:BOXES.json")
    parser.add_argument("--scenes", nargs="*", help="only these")
    parser.add_argument("--smallest", type=float, default=smallest, help="vehicle length [px] (%(default)s)")
    parser.add_argument("--count", type=int, default=count, help="vehicles of each scene (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)


def pictures_of(options: argparse.Namespace) -> Iterable[tuple[str, Path, np.ndarray, tuple[int, int]]]:
    """Scene, file, vehicles (N, 5) and (width, height) [px] of each picture that the `sheet_options` select."""
    return (picture for picture in _every_picture(options) if not options.scenes or picture[0] in options.scenes)


def _every_picture(options: argparse.Namespace) -> Iterable[tuple[str, Path, np.ndarray, tuple[int, int]]]:
    for file in options.labels:
        drawn, complete = (read_labels(file, tighten=False, complete=c) for c in (False, True))
        for image, more in zip(drawn, complete, strict=True):
            size = (image.width, image.height)
            yield image.scene, image.path, image.vehicles, size
            yield JUDGED, image.path, more.vehicles[len(image.vehicles) :], size
    for scene in checked_scenes(options.checked) if options.checked else []:
        for p in scene.pictures:
            yield scene.name, p.picture.path, p.vehicles, (p.picture.width, p.picture.height)
    again = measured_scenes(options.again) if options.again else []
    for scene in [*again, *map(reference_scene, options.found)]:
        for p in scene.pictures:
            yield scene.name, p.picture.path, p.vehicles, (p.picture.width, p.picture.height)


def write_cells(folder: Path, cells: Sequence[Cell], reading: str) -> None:
    """Write the file that `read_sheets` reads, and the instructions `reading` for the reader."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = [
        {"scene": c.scene, "picture": str(c.picture), "to_cell": c.to_cell.tolist(), "label": c.label.tolist()}
        for c in cells
    ]
    (folder / "cells.json").write_text(json.dumps(entries))
    (folder / "READING.txt").write_text(reading)


def write_sheets(folder: Path, cells: Sequence[Cell]) -> None:
    write_cells(folder, cells, READING)
    _join_numbered(folder, "sheet", dict(enumerate(map(draw_cell, cells))))


def read_sheets(folder: Path) -> list[Cell]:
    return [
        Cell(c["scene"], Path(c["picture"]), np.array(c["to_cell"]), np.array(c["label"]))
        for c in json.loads((folder / "cells.json").read_text())
    ]


def read_answers(file: Path) -> dict[int, list[float]]:
    """A reader's file, {cell: [left, right, top, bottom, tilt] or null}, without the cells that could not be read."""
    return {int(cell): reading for cell, reading in json.loads(file.read_text()).items() if reading is not None}


def draw_answers(folder: Path, answers: dict[int, list[float]]) -> None:
    """Write the sheets that were read again, with the answers drawn on them."""
    cells = read_sheets(folder)
    wanted = {number // PER_SHEET for number in answers}
    drawn = {number: draw_cell(cell) for number, cell in enumerate(cells) if number // PER_SHEET in wanted}
    for number, reading in answers.items():
        corners = np.round(Boxes(read_box(reading)[None], np.ones(1)).corners * 16).astype(np.int32)
        cv2.polylines(drawn[number], list(corners), True, (0, 255, 0), 1, cv2.LINE_AA, 4)
    _join_numbered(folder, "drawn", drawn)


def measured(folder: Path, readers: Sequence[dict[int, list[float]]], data: Path) -> list[dict]:
    """Vehicles in the form of labels/by_hand.json; if several readers have read one, with the mean box. Pictures in the
    folder `data` have paths relative to it, others their name alone."""
    kept = []
    for number, cell in enumerate(read_sheets(folder)):
        boxes = [to_picture(read_box(answers[number]), cell.to_cell) for answers in readers if number in answers]
        if boxes:
            kept.append({
                "scene": cell.scene,
                "picture": stored_name(cell.picture, data),
                "label": cell.label.round(2).tolist(),
                "read": np.mean(boxes, axis=0).round(2).tolist(),
                "readers": len(boxes),
            })  # fmt: skip
    return kept


def stored_name(picture: Path, data: Path) -> str:
    """A picture's path relative to the folder `data`; its name alone if it lies elsewhere."""
    file, data = picture.resolve(), data.resolve()
    return str(file.relative_to(data)) if file.is_relative_to(data) else file.name


def joined(kept: Iterable[dict], new: Iterable[dict]) -> list[dict]:
    """Vehicles as from `measured`; those of the same picture and place are merged into the mean over all readers."""
    vehicles = list(kept)
    by_picture: dict[str, list[int]] = {}
    for n, vehicle in enumerate(vehicles):
        by_picture.setdefault(vehicle["picture"], []).append(n)
    for vehicle in new:
        there = by_picture.get(vehicle["picture"], [])
        same = _measured_before(np.array([vehicle["read"]]), [vehicles[n]["read"] for n in there])
        if not same.any():
            vehicles.append(vehicle)
            continue
        before = vehicles[there[int(same[0].argmax())]]
        readers = before["readers"] + vehicle["readers"]
        change = np.subtract(vehicle["read"], before["read"])
        change[4] = axis_angle(change[4])  # either end may be called the right one
        before["read"] = (before["read"] + change * vehicle["readers"] / readers).round(2).tolist()
        before["readers"] = readers
    return vehicles


def join(folder: Path, name: str, cells: dict[int, np.ndarray], columns: int, rows: int) -> None:
    """Write pictures of cells, all of the same size, in order of their numbers to sheets of `columns` x `rows`."""
    for sheet in {number // (columns * rows) for number in cells}:
        mine = {number: cell for number, cell in cells.items() if number // (columns * rows) == sheet}
        height, width = next(iter(mine.values())).shape[:2]
        canvas = np.zeros((rows * height, columns * width, 3), np.uint8)
        for number, cell in mine.items():
            row, column = divmod(number % (columns * rows), columns)
            y, x = row * height, column * width
            canvas[y : y + height, x : x + width] = cell
            cv2.rectangle(canvas, (x, y), (x + width - 1, y + height - 1), (0, 0, 0), width // 200)
        cv2.imwrite(str(folder / f"{name}_{sheet:02d}.png"), canvas)


def _join_numbered(folder: Path, name: str, cells: dict[int, np.ndarray]) -> None:
    """Write sheets of COLUMNS x ROWS cells with their numbers."""
    at = CELL[0] - 62, CELL[1] - 6
    for number, cell in cells.items():
        cv2.putText(cell, f"cell {number}", at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 255, 255), 1, cv2.LINE_AA)
    join(folder, name, cells, COLUMNS, ROWS)


def load_kept(file: Path) -> dict[str, Any]:
    """A file of vehicles as `store` writes it; without vehicles if there is no file."""
    return json.loads(file.read_text()) if file.exists() else {"vehicles": []}


def store(file: Path, kept: dict[str, Any]) -> None:
    """Write `kept`: its texts, and a line for each of its vehicles."""
    rows = ",\n  ".join(json.dumps(vehicle) for vehicle in kept["vehicles"])
    rest = "".join(f" {json.dumps(name)}: {json.dumps(text)},\n" for name, text in kept.items() if name != "vehicles")
    file.write_text(f'{{\n{rest} "vehicles": [\n  {rows}\n ]\n}}\n')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    sheets = commands.add_parser("sheets", help="draw vehicles to be measured")
    sheet_options(sheets, SMALLEST, 24)
    draw, keep = (commands.add_parser(name, help=text) for name, text in
                  {"draw": "draw readings onto the sheets", "keep": "add what was read to --to"}.items())  # fmt: skip
    for command in (draw, keep):
        command.add_argument("folder", type=Path, help="of the sheets")
        command.add_argument("readings", type=Path, nargs="+", help="JSON: {cell: [left, right, top, bottom, tilt]}")
    keep.add_argument("--data", type=Path, required=True, help="folder from which on pictures are named")
    keep.add_argument("--to", type=Path, default=BY_HAND, help="(%(default)s)")
    tell = commands.add_parser("margins", help="compare labels with what was kept")
    tell.add_argument("--of", type=Path, default=BY_HAND, help="(%(default)s)")
    options = parser.parse_args()
    if options.command == "sheets":
        kept = [] if options.again else json.loads(BY_HAND.read_text())["vehicles"]
        write_sheets(options.out, choose(pictures_of(options), options.count, options.seed, options.smallest, kept))
    elif options.command == "draw":
        draw_answers(options.folder, {k: v for file in options.readings for k, v in read_answers(file).items()})
    elif options.command == "keep":
        kept = load_kept(options.to)
        new = measured(options.folder, [read_answers(file) for file in options.readings], options.data)
        kept["vehicles"] = joined(kept["vehicles"], new)
        store(options.to, kept)
    else:
        print("scene      vehicles    label longer [px]      wider [px]   measured: length [px], length to width")
        for scene, (margin, sd, read) in margins(json.loads(options.of.read_text())["vehicles"]).items():
            print(
                f"{scene:10s} {len(read):8d}    {margin[0]:+6.2f} +- {sd[0]:4.2f}    {margin[1]:+6.2f} +- {sd[1]:4.2f}"
                f"   {np.median(read[:, 0]):7.1f}    {np.median(read[:, 0] / read[:, 1]):.2f}"
            )


if __name__ == "__main__":
    main()
