"""How much does the scale change with a few vehicles more or fewer, and how much does it claim to?

    python benchmarks/stability.py [--places 10] [--fleets US DE ...] [--vehicles 12 40 100 300]   # minutes

Simulated places whose vehicles are not quite those of the tables: every class's mean is off by 2 % and its spread by 15
% (one sigma), up to a fifth are vans of any size, up to 8 % of the boxes are not vehicles. Each place is pooled as it
is, with its vehicles resampled with replacement, and with a twentieth of them left out. The ruler is the measurer's.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoscale.core.fleet import MEAN_CORRELATION, Fleet
from orthoscale.core.normal import Z90
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import Votes
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import load_fleet

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.simulate import not_quite, place_of, table  # noqa: E402

FLEETS = ("US", "DE", "NL", "JP", "PH", "CN", "NP", "UG")
VEHICLES = (12, 40, 100, 300)
GSDS = (0.06, 0.12, 0.30)  # [m/px]
RULER = Ruler(margin=(0.43, -0.12), margin_sd=(0.15, 0.15), bias_sd=(0.018, 0.044), common_sd=0.01, noise=(1.0, 0.7))
VANS, FALSE = (0.0, 0.03, 0.08, 0.2), (0.0, 0.02, 0.08)  # shares, of which each place draws one
REDRAWN = 2  # resamplings of each place


def scene(rng: np.random.Generator, fleet: Fleet, n: int, gsd: float) -> Votes:
    """Votes of `n` boxes at one place, in an orthophoto of `gsd` [m/px]."""
    here, unknown = not_quite(rng, place_of(rng, fleet)), fleet.mean_sd[:2] / fleet.mean[:2]
    stray = np.sqrt(MEAN_CORRELATION) * rng.standard_normal() + np.sqrt(1 - MEAN_CORRELATION) * rng.standard_normal(2)
    size = here.sample(rng, n)[:, :2] * np.exp(unknown * stray)
    van = rng.random(n) < rng.choice(VANS)
    usual = rng.uniform([5.0, 1.9], [6.0, 2.1])
    size[van] = rng.normal(usual, [0.3, 0.06], (int(van.sum()), 2))
    bias = rng.normal(0, RULER.bias_sd) + RULER.common_sd * rng.standard_normal()
    sigma = np.maximum((0.02 + 0.03 * rng.random((n, 1))) * [1, 1.3], 0.35 * gsd / size)
    noise = rng.standard_normal((n, 2)) * sigma
    px = size / gsd * (np.exp(bias) + noise) + rng.normal(RULER.margin, RULER.margin_sd)
    wrong = rng.random(n) < rng.choice(FALSE)
    length = rng.uniform(1.5, 7.5, int(wrong.sum())) / gsd
    px[wrong] = np.stack([length, length * rng.uniform(0.25, 1.0, len(length))], -1)
    px = np.sort(np.maximum(px, 1.0), axis=1)[:, ::-1].copy()
    ones = np.ones(n)
    return Votes(px, ones, np.ones(n, int), np.zeros((n, 2)), ones, [np.array([k]) for k in range(n)], sigma=sigma)


def some_of(votes: Votes, index: np.ndarray) -> Votes:
    """The votes at `index`, which may repeat."""
    names = ("size", "pixel", "views", "place", "score", "sigma", "kinds")
    values = {name: getattr(votes, name)[index] for name in names}
    return replace(votes, **values, members=[votes.members[k] for k in index])


def row(fleets: Sequence[str], n: int, places: int) -> list[str]:
    """The row of all places with `n` boxes: errors, claimed errors, and how much the scale changes."""
    found, moves = [], {"again": list[float](), "fewer": list[float]()}
    for code in fleets:
        fleet = load_fleet(code)
        for k in range(places):
            rng = np.random.default_rng([n, sum(map(ord, code)), k])
            gsd = float(rng.choice(GSDS))
            votes = scene(rng, fleet, n, gsd)
            scale = pool(votes, fleet, RULER, "m/px")
            low, high = scale.interval90
            off = np.log(scale.value / gsd)
            found.append((off, np.log(high / low) / 2, low <= gsd <= high, scale.parts["sampling"]))
            for _ in range(REDRAWN):
                for name, index in (
                    ("again", rng.integers(0, n, n)),
                    ("fewer", rng.permutation(n)[max(1, round(n / 20)) :]),
                ):
                    try:
                        other = pool(some_of(votes, index), fleet, RULER, "m/px").value
                    except TooLittleEvidence:
                        continue
                    moves[name].append(float(np.log(other / scale.value)))
    error, half, hit, sampling = (np.array(column, float) for column in zip(*found, strict=True))
    again, fewer = (np.sqrt(np.mean(np.square(moves[name]))) for name in ("again", "fewer"))
    claimed = np.sqrt((sampling**2).mean())
    figures = (np.sqrt((error**2).mean()), np.median(np.abs(error)), half.mean() / Z90, claimed, again, fewer)
    return [
        f"{n}",
        *(f"{100 * v:.1f}" for v in figures[:3]),
        f"{100 * hit.mean():.0f} %",
        *(f"{100 * v:.2f}" for v in figures[3:]),
        f"{again / claimed:.2f}",
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--places", type=int, default=10, help="of each fleet and number (%(default)s)")
    parser.add_argument("--fleets", nargs="+", default=FLEETS)
    parser.add_argument("--vehicles", nargs="+", type=int, default=VEHICLES)
    options = parser.parse_args()
    columns = (
        "boxes",
        "RMS error",
        "median",
        "claimed",
        "coverage",
        "sampling part",
        "drawn again",
        "a twentieth less",
    )
    rows = [row(options.fleets, n, options.places) for n in options.vehicles]
    print(table((*columns, "drawn again over sampling part"), rows))
