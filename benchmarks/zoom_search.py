"""Does the scale search find the right zoom, and does it never give the scale of something else than vehicles?

    python benchmarks/zoom_search.py copies --keep copies.jsonl   # real pictures, 0.5 to 4 times as large: 10 minutes
    python benchmarks/zoom_search.py towns --keep towns.jsonl     # 200 rendered towns full of look-alikes: half an hour

`copies`: the pictures of ``../shared/data`` (or ``ORTHOSCALE_DATA``), shrunk by area averaging or enlarged by cubic
splines, each measured with its country's fleet as if its pixel size were unknown. `towns`: seeded towns of solar roofs,
boats, graves, garages, containers and other things in rows (`orthoscale.synthetic`, style ``lookalikes``), of four
fleets, at 0.05 to 0.2 m/px, with 12 to 80 vehicles.

A scale is wrong if it is given (`Scale.require_useful`) and off by more than OFF: the vehicles of a place never differ
so much from their country's, but other things than vehicles, or another zoom, do. --keep FILE has a line of JSON for
each picture; those in it are not measured again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import places

import orthoscale
from orthoscale.errors import OrthoscaleError
from orthoscale.fleets import load_fleet
from orthoscale.synthetic import make_scene, write_ortho

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.simulate import table  # noqa: E402

FACTORS = (0.5, 1.0, 2.0, 4.0)
OFF = 0.15
FLEETS = ("DE", "US", "IN", "JP")
PIXELS = 1400  # along the side of a town


def measured(path: Path, fleet: str, truth: float) -> dict[str, float | str]:
    """Error of the scale and of both ends of its interval, or why there is no scale."""
    try:
        result = orthoscale.estimate(path, fleet=fleet)
        result.require_useful()
    except OrthoscaleError as error:
        return {"refused": f"{type(error).__name__}: {error.message.splitlines()[0]}"}
    low, high = result.scale.interval90
    return {
        "error": result.scale.value / truth - 1,
        "low": low / truth - 1,
        "high": high / truth - 1,
        "vehicles": result.scale.vehicles_used,
    }


def copies(scratch: Path) -> Iterator[tuple[dict[str, object], Callable[[], dict[str, float | str]]]]:
    """The description of each run, and a function that runs it."""
    for scene in places.scenes():
        if scene.path.is_dir():
            continue
        for factor in FACTORS:

            def run(scene: places.Scene = scene, factor: float = factor) -> dict[str, float | str]:
                pixels = cv2.imread(str(scene.path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
                way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
                size = (round(pixels.shape[1] * factor), round(pixels.shape[0] * factor))
                copy = scratch / f"{scene.name}.png"  # without georeferencing
                cv2.imwrite(str(copy), cv2.resize(pixels, size, interpolation=way))
                return measured(copy, scene.country, scene.truth / factor)

            yield {"name": scene.name, "factor": factor}, run


def towns(scratch: Path, count: int) -> Iterator[tuple[dict[str, object], Callable[[], dict[str, float | str]]]]:
    for number in range(count):
        rng = np.random.default_rng([16, number])
        fleet = FLEETS[number % len(FLEETS)]
        gsd = float(np.exp(rng.uniform(np.log(0.05), np.log(0.2))))
        vehicles = int(np.exp(rng.uniform(np.log(12), np.log(80))))

        def run(number: int = number, fleet: str = fleet, gsd: float = gsd, vehicles: int = vehicles) -> dict:
            picture = scratch / "town.png"
            scene = make_scene(20_000 + number, load_fleet(fleet), gsd * PIXELS, vehicles, "lookalikes")
            write_ortho(scene, picture, gsd, number)
            return measured(picture, fleet, gsd)

        yield {"name": f"town {number}", "fleet": fleet, "gsd": round(gsd, 3), "asked": vehicles}, run


def right(row: dict) -> bool:
    return "error" in row and abs(row["error"]) <= OFF


def cells(rows: list[dict]) -> list[str]:
    given = [r for r in rows if "error" in r]
    error = np.array([r["error"] for r in given if right(r)])
    holds = sum(r["low"] <= 0 <= r["high"] for r in given)
    middle = f"{100 * np.median(np.abs(error)):.1f} %" if len(error) else ""
    wrong = [f"{r['name']} {100 * r['error']:+.0f} %" for r in given if not right(r)]
    return [str(len(rows)), str(len(given)), str(len(error)), middle, f"{holds} of {len(given)}", ", ".join(wrong)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("of", choices=("copies", "towns"))
    parser.add_argument("--count", type=int, default=200, help="of towns (%(default)s)")
    parser.add_argument("--keep", type=Path, help="file of what was measured")
    options = parser.parse_args()
    kept: list[dict] = []
    if options.keep and options.keep.exists():
        kept = [json.loads(line) for line in options.keep.read_text().splitlines()]
    with tempfile.TemporaryDirectory() as folder:
        runs = copies(Path(folder)) if options.of == "copies" else towns(Path(folder), options.count)
        for what, run in runs:
            if any(what.items() <= row.items() for row in kept):
                continue
            kept.append({**what, **run()})
            if options.keep:
                with options.keep.open("a") as file:
                    file.write(json.dumps(kept[-1]) + "\n")
    by = "factor" if options.of == "copies" else "fleet"
    groups = {value: [row for row in kept if row[by] == value] for value in dict.fromkeys(row[by] for row in kept)}
    head = [
        by,
        "pictures",
        "scale given",
        f"within {100 * OFF:.0f} %",
        "median error of these",
        "interval holds",
        "wrong",
    ]
    print(table(head, [[str(value), *cells(rows)] for value, rows in groups.items()] + [["all", *cells(kept)]]))
    for row in kept:
        if "refused" in row:
            print(f"- {row['name']} ({by} {row[by]}): {row['refused']}", file=sys.stderr)


if __name__ == "__main__":
    main()
