r"""Kinds of vehicles, classified by eye: car, pickup, van, larger.

    python -m training.kinds sheets --labels ../shared/data/vehicles/labels.json --count 800 --out runs/kinds
    python -m training.kinds sheets --labels ../shared/data/vehicles/chips --likely 0.15 --out runs/rare
    python -m training.kinds sheets --found manila=../shared/data/orthophotos/manila.tif:BOXES.json --out runs/manila
    python -m training.kinds keep runs/kinds ANSWERS.json [ANSWERS.json ...] --data ../shared/data
    python -m training.kinds agreement runs/kinds ANSWERS.json ANSWERS.json    # of two readers of the same sheets

`sheets` draws vehicles as `training.by_hand` does, smaller and without rulers; with `--likely`, only those that may be
pickups or vans, which are rare. ANSWERS.json has a string of letters for each row of a sheet,
``{"SHEET": ["ccpcvccc", ...], ...}``; `READING` explains them, and is written beside the sheets. `keep` adds to
labels/kinds.json the vehicles on which all readers agree; one that they disagree on, or that one of them cannot
classify, is left out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from orthoscale.core.boxes import KINDS, Boxes
from orthoscale.detect.measurer import ANSWERS, Measurer

from .by_hand import (
    Cell,
    choose,
    enlarged,
    join,
    load_kept,
    pictures_of,
    read_sheets,
    sheet_options,
    store,
    stored_name,
    write_cells,
)
from .data import as_stored

LABELS = Path(__file__).parent / "labels" / "kinds.json"
SHARE = 0.5  # size of a cell, as a share of the cells in which edges are read
COLUMNS, ROWS = 6, 8
PER_SHEET = COLUMNS * ROWS
SMALLEST = 12.0  # vehicles shorter than this are not drawn [px of the picture]
RARE = [ANSWERS.index(kind) for kind in ("pickup", "van")]
LETTERS = dict(zip("cpvln", ANSWERS, strict=True))
READING = f"""Which kind of vehicle stands in each cell of sheet_00.png, sheet_01.png, ...

A sheet has {ROWS} rows of {COLUMNS} cells. Each cell shows one vehicle from above, about level, in the cell's middle;
which end is its front differs. Answer with one JSON file: for each sheet a list of {ROWS} strings of {COLUMNS} letters,

    {{"0": ["ccpcvc", "cc?ccc", ...], "1": [...]}}

c  car: hatchback, saloon, estate, SUV, people carrier with a bonnet. The roof lies between a windscreen and a rear
   window; bonnet (and boot) are of the body's colour. An SUV's roof reaches nearly to its rear end.
p  pickup: an open bed behind a cab. The cab's roof lies in the middle or forward of it, and the rear third to two
   fifths is a flat bed with a rim: a dark or differently bright rectangle, often with something in it. Also one whose
   bed is covered by a tonneau or a cap of another colour. A pickup is longer and more angular than a saloon, whose boot
   is shorter than its bonnet and has no rim.
v  van, minibus, delivery van, jeepney: one box, a flat roof nearly from end to end, hardly any bonnet, ribs or racks or
   hatches on the roof, square corners.
l  larger: lorry, bus, trailer, caravan, motorhome, a truck with a separate box or a bed with more than two axles.
n  no vehicle, or not a motor vehicle of four wheels (motorcycle, three-wheeler, boat, roof, shadow, skip).
?  cannot be told: too blurred, hidden, dark, cut. Do not guess between car and pickup.

Judge each cell for itself. Do not expect any share of the kinds: in some towns nearly all are cars, in others half are
pickups. Crop and magnify a cell when in doubt.
"""


def likely_rare(
    pictures: Iterable[tuple[str, Path, np.ndarray, tuple[int, int]]], measurer: Measurer, least: float
) -> Iterable[tuple[str, Path, np.ndarray, tuple[int, int]]]:
    """The pictures, as `by_hand.choose` takes them, with only those vehicles that the measurer gives a probability of
    at least `least` to be of a RARE kind."""
    for scene, file, boxes, size in pictures:
        told = measurer.in_pixels(as_stored(file)[..., ::-1], Boxes(boxes, np.ones(len(boxes))))
        yield scene, file, boxes[told.kind[:, RARE].sum(1) >= least], size


def draw_sheets(folder: Path, cells: Sequence[Cell]) -> None:
    """Write the cells to sheets of ROWS x COLUMNS, and beside them the file that `read_sheets` reads."""
    write_cells(folder, cells, READING)
    join(folder, "sheet", {number: enlarged(cell, SHARE) for number, cell in enumerate(cells)}, COLUMNS, ROWS)


def read_answers(file: Path, cells: int) -> dict[int, str]:
    """{cell: one of ANSWERS, or "" for a vehicle that could not be classified} from a reader's file on sheets with a
    total of `cells`.

    Raises ValueError for a sheet with wrong rows: answers would be assigned to other vehicles.
    """
    told: dict[int, str] = {}
    for sheet, rows in json.loads(file.read_text()).items():
        first, letters = int(sheet) * PER_SHEET, "".join(rows)
        in_rows = rows == [letters[k : k + COLUMNS] for k in range(0, len(letters), COLUMNS)]
        enough = min(cells - first, PER_SHEET) <= len(letters) <= PER_SHEET
        if not in_rows or not enough or set(letters) - {*LETTERS, "?"}:
            raise ValueError(
                f"{file}: sheet {sheet} needs {ROWS} rows of {COLUMNS} letters of {''.join(LETTERS)}?, "
                "the last sheet as many as it has cells"
            )
        told.update((first + k, LETTERS.get(letter, "")) for k, letter in enumerate(letters))
    return told


def agreed(readers: Sequence[dict[int, str]]) -> dict[int, str]:
    """{cell: kind} of the cells on which all readers who saw them agree."""
    said: dict[int, set[str]] = {}
    for answers in readers:
        for cell, kind in answers.items():
            said.setdefault(cell, set()).add(kind)
    return {cell: next(iter(kinds)) for cell, kinds in said.items() if len(kinds) == 1 and "" not in kinds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    sheets = commands.add_parser("sheets", help="draw vehicles")
    sheet_options(sheets, SMALLEST, 200)
    sheets.add_argument("--likely", type=float, help="only what is a pickup or van with at least this probability")
    sheets.add_argument("--measurer", type=Path, help="ONNX file that tells it (the shipped one)")
    keep = commands.add_parser("keep", help="add to --to what was told")
    agreement = commands.add_parser("agreement", help="how often readers say the same")
    for command in (keep, agreement):
        command.add_argument("folder", type=Path, help="of the sheets")
        command.add_argument("answers", type=Path, nargs="+", help='JSON: {sheet: ["ccpcvccc", ...]}')
    keep.add_argument("--data", type=Path, required=True, help="folder from which on pictures are named")
    for command, what in ((sheets, "what was read before, not to be drawn again"), (keep, "what to add to")):
        command.add_argument("--to", type=Path, default=LABELS, help=f"{what} (%(default)s)")
    options = parser.parse_args()
    if options.command == "sheets":
        pictures = pictures_of(options)
        if options.likely is not None:
            pictures = likely_rare(pictures, Measurer(options.measurer), options.likely)
        # What was read before is not read again.
        before = [{**vehicle, "read": vehicle["box"]} for vehicle in load_kept(options.to)["vehicles"]]
        draw_sheets(options.out, choose(pictures, options.count, options.seed, options.smallest, before))
        return
    cells = read_sheets(options.folder)
    readers = [read_answers(file, len(cells)) for file in options.answers]
    if options.command == "agreement":
        print(agreement_table(readers))
        return
    kept = load_kept(options.to)
    for number, kind in sorted(agreed(readers).items()):
        if number < len(cells):
            cell = cells[number]
            kept["vehicles"].append({
                "scene": cell.scene,
                "picture": stored_name(cell.picture, options.data),
                "box": cell.label.round(2).tolist(),
                "kind": kind,
                "readers": sum(number in answers for answers in readers),
            })  # fmt: skip
    store(options.to, kept)


def agreement_table(readers: Sequence[dict[int, str]]) -> str:
    """A Markdown table of counts: the kind by one reader (rows) against that by another (columns)."""
    names = (*KINDS, "none", "")
    count = np.zeros((len(names), len(names)), int)
    for i, one in enumerate(readers):
        for k, other in enumerate(readers):
            for cell in one.keys() & other.keys() if i != k else ():
                count[names.index(one[cell]), names.index(other[cell])] += 1
    shown = [name or "cannot tell" for name in names]
    lines = ["| | " + " | ".join(shown) + " |", "|---" * (len(names) + 1) + "|"]
    return "\n".join(
        [*lines, *(f"| {n} | " + " | ".join(map(str, row)) + " |" for n, row in zip(shown, count, strict=True))]
    )


if __name__ == "__main__":
    main()
