"""How accurate is the scale of a reconstruction, and do its 90 % intervals hold?

    python benchmarks/flights.py                       # 300 simulated flights: ten minutes to half an hour
    python benchmarks/flights.py --flights 40 --known  # fleet and box bias are known: what geometry adds
    python benchmarks/flights.py --flights 40 --dense  # the same flights with a dense cloud beside each model
    python benchmarks/flights.py --flights 12 --deck 8   # all vehicles on a parking deck of 8 m
    python benchmarks/flights.py --flights 12 --speed 3  # all vehicles drive, 3 m from frame to frame

Simulated blocks (`tests/support/blocks.py`): nadir, oblique, grid and strip flights over slopes, trees and roofs, few
or many sparse points, and models whose focal length is 10 to 20 % too long. Boxes are those of a perfect detector with
noise, through the true cameras; ground, projection, both measuring modes and pooling are the program's own. Whatever
the program states an uncertainty for is off by as much: the fleet, its mix at the place, vans among it, box bias,
shrinkage, and the height and the shape of the bodies that boxes enclose. With ``--known`` fleet, mix and box bias are
exact, and the program knows it.
Prints Markdown, seeded. ``--rows FILE`` continues an earlier run.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orthoscale.core.measuring.ways import measure_source
from orthoscale.errors import OrthoscaleError
from orthoscale.fleets import load_fleet

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # for simulated boxes of known truth, as in the tests

from support.blocks import EXACT, KINDS, RULER, Conditions, exactly, fly  # noqa: E402
from support.simulate import table  # noqa: E402

FLEETS = ("US", "DE", "PL")
FEW_POINTS, WOODED, GROUND_OFF = 600, 0.5, 0.02


@dataclass(frozen=True)
class Outcome:
    """The result of one flight. error : log(value / truth), modes : the same in each measuring mode. lost : share of
    the boxes that could not be measured. ground_off : median error of the ground sheet under the sparse points, as a
    share of the cameras' height."""

    conditions: Conditions
    error: float
    sd: float
    hit: bool
    modes: dict[str, float]
    lost: float
    ground_off: float

    @classmethod
    def read(cls, row: dict[str, Any]) -> Outcome:
        """The inverse of `asdict`."""
        return cls(**{**row, "conditions": Conditions(**row["conditions"])})


ROWS: dict[str, Callable[[Outcome], bool]] = {
    **{kind: (lambda o, kind=kind: o.conditions.kind == kind) for kind in KINDS},
    "focal length 10 or 20 % too long": lambda o: o.conditions.focal > 0,
    f"fewer than {FEW_POINTS} points": lambda o: o.conditions.points < FEW_POINTS,
    "crowns over half of the ground": lambda o: o.conditions.crowns > WOODED,
    "sheet off by 2 % of the height": lambda o: abs(o.ground_off) > GROUND_OFF,
    "all": lambda o: True,
}


def outcome(number: int, known: bool, dense: bool, deck: float, speed: float) -> Outcome:
    """The outcome of the flight of that number. deck [m], speed [m a frame]: of its vehicles.

    Raises OrthoscaleError if it has no scale.
    """
    rng = np.random.default_rng([19, number])
    conditions = replace(Conditions.drawn(rng, KINDS[number % len(KINDS)]), deck=deck, speed=speed)
    fleet = load_fleet(FLEETS[number % len(FLEETS)])
    if known:
        fleet = exactly(fleet)
    block = fly(rng, fleet, conditions, ruler=EXACT if known else RULER, dense=dense)
    measured = measure_source(block.source, block.found, fleet)
    scale, truth = measured.scale, block.metres_per_unit
    low, high = scale.interval90
    return Outcome(
        conditions,
        float(np.log(scale.value / truth)),
        scale.relative_sd,
        bool(low <= truth <= high),
        {name: float(np.log(m.scale.value / truth)) for name, m in measured.modes.items()},
        sum(measured.lost.values()) / max(len(block.found), 1),
        float(np.median(block.terrain_error)),
    )


def cells(some: list[Outcome]) -> list[str]:
    """One row of the table."""
    error = np.array([o.error for o in some])
    by_mode = []
    for mode in ("oblique", "planar"):
        each = np.abs([o.modes[mode] for o in some if mode in o.modes])
        by_mode.append(f"{100 * each.mean():.1f} %" if len(each) else "")
    return [
        str(len(some)),
        f"{100 * np.abs(error).mean():.2f} %",
        f"{100 * error.mean():+.2f} %",
        f"{100 * np.abs(error).max():.1f} %",
        f"{100 * np.mean([o.sd for o in some]):.1f} %",
        f"{100 * np.mean([o.hit for o in some]):.0f} %",
        *by_mode,
        f"{100 * np.mean([o.lost for o in some]):.1f} %",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--known", action="store_true", help="nothing but geometry, bodies and luck is unknown")
    parser.add_argument("--dense", action="store_true", help="a dense cloud lies beside each model")
    parser.add_argument("--deck", type=float, default=0.0, metavar="METRES", help="height of a deck under all vehicles")
    parser.add_argument("--speed", type=float, default=0.0, metavar="METRES", help="that vehicles drive between frames")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="keep each flight there, and read those that it has")
    asked = parser.parse_args()
    kept: dict[int, Any] = {}
    if asked.rows and asked.rows.exists():
        kept = dict(json.loads(line) for line in asked.rows.read_text().splitlines())
    done, without = [], 0
    for number in range(asked.first, asked.first + asked.flights):
        if number not in kept:
            try:
                kept[number] = asdict(outcome(number, asked.known, asked.dense, asked.deck, asked.speed))
            except OrthoscaleError as error:
                kept[number] = error.message
            if asked.rows:
                with asked.rows.open("a") as file:
                    file.write(json.dumps([number, kept[number]]) + "\n")
        if isinstance(kept[number], str):
            without += 1
            print(f"flight {number}: {kept[number]}", file=sys.stderr)
        else:
            done.append(Outcome.read(kept[number]))
    head = ["", "flights", "mean abs. error", "mean", "worst", "claimed sd", "90 % intervals hold", "oblique", "planar"]
    rows = [[name, *cells(some)] for name, of in ROWS.items() if (some := [o for o in done if of(o)])]
    print(table([*head, "boxes lost"], rows))
    print(f"\n{without} of {asked.flights} flights have no scale.")


if __name__ == "__main__":
    main()
