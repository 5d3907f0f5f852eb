"""Anytime against exhaustive: is a sweep that stops early unbiased, and how much does stopping save?

    python benchmarks/anytime.py RASTER.tif --fleet DE [--seeds 200]

One exhaustive sweep of RASTER gives what every tile shows (it is kept in the cache, so a second run of this program
takes no time for it). Anytime sweeps are then run over it for many seeds, each with its own order of tiles and its own
sample of the coarse pass, and compared with it. The cost of a sweep is counted in network pixels (of both detection
passes and of the coarse pass), which does not depend on who else uses the machine; --time also runs both for real, one
after the other.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from orthoscale.core.detections import Detections, Tile
from orthoscale.core.fleet import Fleet
from orthoscale.core.measuring.measure import measure
from orthoscale.core.measuring.plan import PlanGeometry
from orthoscale.core.scale import Scale
from orthoscale.core.source import Picture, Plan
from orthoscale.detect.cache import TileCache, cache_key
from orthoscale.detect.coarse_pass import FAR, FAR_TILES, UNPROMISING, hint
from orthoscale.detect.detector import Detector, Passes
from orthoscale.detect.effort import Effort
from orthoscale.detect.find import find_vehicles
from orthoscale.detect.order import visiting_order
from orthoscale.detect.sweep import Found, Stop, sweep_twice
from orthoscale.detect.tiles import CONFIRMING_ZOOM, tiles
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import load_fleet
from orthoscale.sources.opening import open_source

# Network pixels of both passes, as a multiple of those of the fine one.
BOTH_PASSES = 1 + CONFIRMING_ZOOM**2


@dataclass(frozen=True)
class Raster:
    """An orthophoto whose every tile was looked at. every : what all tiles show. key : of the looks in the cache. far :
    (N,) bool, which tiles the coarse pass finds promising."""

    name: str
    plan: Plan
    fleet: Fleet
    detector: Detector
    every: Detections
    jobs: list[tuple[Picture, Tile]]
    key: str
    far: np.ndarray

    @classmethod
    def looked_at(cls, path: Path, fleet: str, zoom: float | None) -> Raster:
        """Sweep all of it, or take the looks of a former sweep from the cache."""
        source = open_source(path)
        plan, (picture,) = source.plan, source.pictures
        assert plan is not None, "an orthophoto"
        detector = Detector(threads=1, passes=Passes.CONFIRMED)  # as orthophotos are swept
        every = find_vehicles([picture], detector, zoom, effort=Effort(exhaustive=True))
        jobs = [(picture, tile) for tile in tiles(picture, every.zoom)]
        key = cache_key([picture], detector, every.zoom)
        assert key is not None
        far = np.array([hint(job, detector) for job in jobs])
        return cls(path.name, plan, load_fleet(fleet), detector, every, jobs, key, far)

    @property
    def pixels(self) -> np.ndarray:
        """(N,) network pixels of each tile, in the fine pass."""
        return np.array([tile.out_width * tile.out_height for _, tile in self.jobs])

    def scale_of(self, found: Found | Detections) -> Scale:
        """The scale by the vehicles found so far, measured in the same way for all sweeps. Raises TooLittleEvidence."""
        return measure(PlanGeometry.of(self.plan, replace(self.every, boxes=found.boxes)), self.fleet).scale

    def sampling(self, found: Found | Detections) -> float:
        """The sampling part of that scale's uncertainty, infinite for too little evidence."""
        try:
            return self.scale_of(found).parts["sampling"]
        except TooLittleEvidence:
            return np.inf

    def swept(self, cache: TileCache, order: np.ndarray, stop: Stop | None = None) -> Found:
        """A sweep in this order, all of whose looks are in the cache."""
        how = {"sure": self.detector.sure, "passes": self.detector.passes}
        return sweep_twice(self.jobs, order, lambda _: iter(()), cache, stop, **how)


@dataclass(frozen=True)
class Sweeps:
    """Anytime sweeps, one for each seed: tiles and vehicles (N,) that they looked at and used, network pixels of both
    passes and of the coarse pass, and the scale with its sampling part."""

    tiles: np.ndarray
    cost: np.ndarray
    scale: np.ndarray
    sampling: np.ndarray
    vehicles: np.ndarray

    @classmethod
    def over(cls, raster: Raster, cache: TileCache, seeds: int, target: float) -> Sweeps:
        """`seeds` sweeps that stop at the `target`."""
        places, pixels = [tile for _, tile in raster.jobs], raster.pixels
        rows = []
        for seed in range(seeds):
            sample = visiting_order(places, np.ones(len(places)), seed)[:FAR_TILES]
            weight = np.full(len(places), UNPROMISING)
            weight[sample] = np.where(raster.far[sample], 1.0, UNPROMISING)
            found = raster.swept(cache, visiting_order(places, weight, seed), Stop(raster.sampling, target))
            seen = pixels[[places.index(tile) for _, tile in found.swept.tiles]].sum() * BOTH_PASSES
            last = raster.scale_of(found)
            cost = seen + pixels[sample].sum() * FAR**2
            rows.append((len(found.swept.tiles), cost, last.value, last.parts["sampling"], last.vehicles_used))
        return cls(*np.array(rows).T)


def tell(raster: Raster, whole: Scale, sweeps: Sweeps, target: float) -> None:
    """Print how the anytime `sweeps` differ from the `whole`."""
    n, cost = sweeps.tiles, sweeps.cost
    all_cost = raster.pixels.sum() * BOTH_PASSES
    error = np.log(sweeps.scale / whole.value)
    width, height = raster.plan.width, raster.plan.height
    print(f"{raster.name}: {width * height / 1e6:.0f} Mpx, {len(raster.jobs)} tiles at zoom {raster.every.zoom:.3f}")
    print(f"exhaustive: {whole.value:.5g} m/px, {whole.vehicles_used} vehicles, "
          f"sampling {100 * whole.parts['sampling']:.2f} %")  # fmt: skip
    print(f"{len(n)} sweeps to {100 * target:g} %: {np.median(n):.0f} tiles, {n.min():.0f} to {n.max():.0f}, "
          f"{np.median(sweeps.vehicles):.0f} vehicles, sampling {100 * np.median(sweeps.sampling):.2f} %")  # fmt: skip
    print(
        f"network pixels, exhaustive over anytime: {all_cost / np.median(cost):.1f} (worst {all_cost / cost.max():.1f})"
    )
    standard = error.std(ddof=1) / np.sqrt(len(error))
    print(f"anytime against exhaustive: mean {100 * error.mean():+.3f} +- {100 * standard:.3f} %, "
          f"spread {100 * error.std(ddof=1):.2f} %, largest {100 * np.abs(error).max():.2f} %")  # fmt: skip


def time_both(raster: Raster, target: float) -> None:
    """Run both sweeps without the cache, and print how long they take."""
    seconds = []
    for effort in (Effort(target, cache=False), Effort(exhaustive=True, cache=False)):
        start = time.perf_counter(), time.process_time()
        picture, _ = raster.jobs[0]
        find_vehicles([picture], raster.detector, raster.every.zoom, effort=effort, sampling=raster.sampling)
        seconds.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    ratio = np.array(seconds[1]) / seconds[0]
    print(f"sweeps alone: anytime {seconds[0][0]:.1f} s, exhaustive {seconds[1][0]:.1f} s; "
          f"ratio {ratio[0]:.1f} (wall), {ratio[1]:.1f} (processor)")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raster", type=Path)
    parser.add_argument("--fleet", default="world")
    parser.add_argument("--target", type=float, default=Effort.target)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--zoom", type=float, help="instead of the search")
    parser.add_argument("--time", action="store_true", help="also run both sweeps without the cache, and time them")
    a = parser.parse_args()

    raster = Raster.looked_at(a.raster, a.fleet, a.zoom)
    with TileCache(raster.key) as cache:
        whole = raster.scale_of(raster.swept(cache, np.arange(len(raster.jobs))))
        sweeps = Sweeps.over(raster, cache, a.seeds, a.target)
    tell(raster, whole, sweeps, a.target)
    if a.time:
        time_both(raster, a.target)


if __name__ == "__main__":
    main()
