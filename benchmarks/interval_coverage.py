"""Do the 90 % intervals keep their word, and how near is the value? ``python benchmarks/interval_coverage.py``.

Simulated car parks in orthophotos; in each, the fleet's mean, the margin and the labels' bias are off by as much as
they claim to be. Pooled by orthoscale and, on the same boxes, by the paper's IQR mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from simulate import car_park, table

from orthoscale.errors import TooLittleEvidence
from orthoscale.fleet import Fleet
from orthoscale.paper import pool_iqr
from orthoscale.pooling import Ruler, pool

FLEETS = ("US", "DE", "JP", "IN", "BR", "CN", "PH", "WORLD")
SCENES = 500
VEHICLES = 60
GSDS = (0.05, 0.12, 0.30)  # metres per pixel, taken in turn
RULER = Ruler(margin=(1.0, 1.5), margin_sd=(0.5, 0.5), bias_sd=(0.015, 0.02), noise=(1.5, 1.0))
NO_MARGIN = Ruler(margin=(0.0, 0.0), margin_sd=(0.0, 0.0), bias_sd=(0.015, 0.02), noise=(1.5, 1.0))
CONDITIONS = {
    "vehicles only": {},
    "25 % vans": {"vans": 0.25},
    "10 % false boxes": {"false": 0.1},
    "both": {"vans": 0.25, "false": 0.1},
}
COUNTS = (5, 10, 20, 50, 100, 300, 1000, 3000, 10_000)


@dataclass
class Tally:
    """What one set of scenes gave: errors as log(value / truth), claimed one-sigmas, hits of the intervals."""

    error: np.ndarray
    sd: np.ndarray
    hit: np.ndarray
    paper_error: np.ndarray
    paper_hit: np.ndarray
    refused: int

    def coverage(self) -> str:
        return f"{100 * self.hit.mean():.0f} %"

    def rms(self) -> str:
        return f"{100 * np.sqrt((self.error**2).mean()):.1f}"

    def bias(self) -> str:
        return f"{100 * self.error.mean():+.1f}"


def run(
    fleet: Fleet,
    scenes: int = SCENES,
    n: int = VEHICLES,
    ruler: Ruler = RULER,
    gsds: tuple[float, ...] = GSDS,
    seed: int = 0,
    **condition: float,
) -> Tally:
    rows, refused = [], 0
    for k in range(scenes):
        gsd = gsds[k % len(gsds)]
        votes = car_park(np.random.default_rng([seed, k]), fleet, n, gsd, ruler, **condition)
        try:
            scale = pool(votes, fleet, ruler, "m/px")
        except TooLittleEvidence:
            refused += 1
            continue
        paper = pool_iqr((fleet.mean[:2] / votes.size).mean(1), votes.score)
        low, high = scale.interval90
        paper_low, paper_high = paper.interval90
        rows.append(
            (
                np.log(scale.value / gsd),
                scale.relative_sd,
                low <= gsd <= high,
                np.log(paper.value / gsd),
                paper_low <= gsd <= paper_high,
            )
        )
    error, sd, hit, paper_error, paper_hit = np.array(rows, float).T
    return Tally(error, sd, hit, paper_error, paper_hit, refused)


def by_fleet(ruler: Ruler) -> str:
    """Coverage, then bias and root mean square error, of each fleet in each condition."""
    rows = []
    for code in FLEETS:
        tallies = [run(Fleet.load(code), ruler=ruler, **c) for c in CONDITIONS.values()]
        rows.append([code, *(f"{t.coverage()} ({t.bias()}, {t.rms()})" for t in tallies)])
    return table(["fleet", *CONDITIONS], rows)


def by_count(code: str, scenes: int = 200, **condition: float) -> str:
    """Error against the number of vehicles, and what the paper's mean makes of the same boxes."""
    rows = []
    for n in COUNTS:
        t = run(Fleet.load(code), scenes if n < 3000 else scenes // 4, n, **condition)
        rows.append(
            [
                f"{n:,}",
                t.rms(),
                f"{100 * np.sqrt((t.sd**2).mean()):.1f}",
                t.coverage(),
                f"{100 * np.sqrt((t.paper_error**2).mean()):.1f}",
                f"{100 * t.paper_hit.mean():.0f} %",
                f"{t.refused}",
            ]
        )
    head = ["vehicles", "error [%]", "claimed [%]", "coverage", "paper's error [%]", "paper's coverage", "refused"]
    return table(head, rows)


def main() -> None:
    gsds = ", ".join(f"{100 * g:.0f}" for g in GSDS)
    print(
        f"## Coverage of the 90 % interval (bias, RMS error [%])\n\n{SCENES} scenes of {VEHICLES} boxes at {gsds} cm/px\n"
    )
    print(f"With box margins\n\n{by_fleet(RULER)}\n")
    print(f"Without\n\n{by_fleet(NO_MARGIN)}\n")
    print("## Error against the number of boxes\n")
    for code in ("DE", "US", "WORLD"):
        print(f"{code}, vehicles only\n\n{by_count(code)}\n")
        print(f"{code}, 25 % vans and 10 % false boxes\n\n{by_count(code, vans=0.25, false=0.1)}\n")


if __name__ == "__main__":
    main()
