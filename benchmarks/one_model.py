"""Rendered lots whose vehicles are all of one model, measured by the whole program with the country named.

    python benchmarks/one_model.py [--lots 16] [--keep FOLDER]

Each model is drawn from a fleet, of the countries in turn, and its versions differ as in `orthoscale.registrations`.
Which of the vehicles' shapes are rendered does not depend on the model. Pictures are kept in FOLDER.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from itertools import cycle, islice
from pathlib import Path

import numpy as np

import orthoscale
from orthoscale.errors import OrthoscaleError
from orthoscale.fleets import load_fleet
from orthoscale.registrations import VERSIONS
from orthoscale.synthetic import make_scene, write_ortho
from orthoscale.synthetic.scene import NormalFleet

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.simulate import table  # noqa: E402

COUNTRIES = ("US", "DE", "JP", "BR")
STYLES = ("carpark", "suburb", "city")
GSD = 0.08  # [m/px]
EXTENT, VEHICLES = 90.0, 50  # side of a scene [m], vehicles in it


def lot(k: int, country: str, folder: Path) -> tuple[Path, np.ndarray]:
    """The picture of the `k`-th lot, rendered if it is not in `folder`; and its model's length and width [m]."""
    size = load_fleet(country).sample(np.random.default_rng([51, k]), 1)[0]
    path = folder / f"lot_{k:02d}_{country}.png"
    if not path.exists():
        models = NormalFleet(tuple(size), tuple(VERSIONS))
        write_ortho(make_scene(5100 + k, models, EXTENT, VEHICLES, STYLES[k % len(STYLES)]), path, GSD)
    return path, size[:2]


def main(count: int, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rows, errors, held = [], [], 0
    for k, country in enumerate(islice(cycle(COUNTRIES), count)):
        path, size = lot(k, country, folder)
        row = [country, "{:.2f} x {:.2f}".format(*size)]
        try:
            scale = orthoscale.estimate(path, fleet=country).scale
        except OrthoscaleError as error:
            rows.append([*row, f"none: {error.message.removeprefix(f'{path}: ')}", "", ""])
            continue
        low, high = scale.interval90
        held += low <= GSD <= high
        errors.append(np.log(scale.value / GSD))
        off = [f"{100 * (value / GSD - 1):+.1f}" for value in (scale.value, low, high)]
        out = "" if low <= GSD <= high else " **out**"
        rows.append([*row, f"{off[0]} ({off[1]} to {off[2]}){out}", scale.verdict, f"{scale.vehicles_used}"])
    print(table(("country", "model [m]", "error (90 % interval) [%]", "verdict", "vehicles"), rows))
    rms = 100 * np.sqrt(np.mean(np.square(errors)))
    print(f"\n{held} of {len(errors)} intervals hold; RMS error {rms:.1f} %")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lots", type=int, default=16)
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        main(options.lots, options.keep or Path(scratch))
