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
from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoscale.core.detections import Detections
from orthoscale.core.measuring.measure import measure
from orthoscale.core.measuring.plan import PlanGeometry
from orthoscale.core.scale import Scale
from orthoscale.detect.cache import TileCache, cache_key
from orthoscale.detect.coarse_pass import FAR, FAR_TILES, UNPROMISING, hint
from orthoscale.detect.detector import Detector, Passes
from orthoscale.detect.find import Effort, find_vehicles
from orthoscale.detect.order import visiting_order
from orthoscale.detect.sweep import Found, Stop, sweep_twice
from orthoscale.detect.tiles import CONFIRMING_ZOOM, tiles
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import load_fleet
from orthoscale.sources.opening import open_source


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raster", type=Path)
    parser.add_argument("--fleet", default="world")
    parser.add_argument("--target", type=float, default=Effort.target)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--zoom", type=float, help="instead of the search")
    parser.add_argument("--time", action="store_true", help="also run both sweeps without the cache, and time them")
    a = parser.parse_args()

    source, fleet = open_source(a.raster), load_fleet(a.fleet)
    plan, (picture,) = source.plan, source.pictures
    assert plan is not None, "an orthophoto"
    detector = Detector(threads=1, passes=Passes.CONFIRMED)  # as orthophotos are swept
    every, _ = find_vehicles([picture], detector, a.zoom, effort=Effort(exhaustive=True))
    zoom = every.zoom
    jobs = [(picture, tile) for tile in tiles(picture, zoom)]
    places = [tile for _, tile in jobs]
    pixels = np.array([t.out_width * t.out_height for t in places])
    key = cache_key([picture], detector, zoom)
    assert key is not None
    far = np.array([hint(job, detector) for job in jobs])

    def scale_of(found: Found | Detections) -> Scale:
        """The scale by the vehicles found so far, measured in the same way for all sweeps. Raises TooLittleEvidence."""
        return measure(PlanGeometry.of(plan, replace(every, boxes=found.boxes)), fleet).scale

    def sampling(found: Found | Detections) -> float:
        try:
            return scale_of(found).parts["sampling"]
        except TooLittleEvidence:
            return np.inf

    rows = []
    with TileCache(key) as cache:

        def seen_before(order: np.ndarray, stop: Stop | None = None) -> Found:
            """A sweep in this order, all of whose looks are in the cache."""
            return sweep_twice(jobs, order, lambda _: iter(()), cache, stop, sure=detector.sure, passes=detector.passes)

        whole = scale_of(seen_before(np.arange(len(jobs))))
        for seed in range(a.seeds):
            evenly = visiting_order(places, np.ones(len(jobs)), seed)
            weight = np.full(len(jobs), UNPROMISING)
            weight[evenly[:FAR_TILES]] = np.where(far[evenly[:FAR_TILES]], 1.0, UNPROMISING)
            found = seen_before(visiting_order(places, weight, seed), Stop(sampling, a.target))
            seen = pixels[[places.index(tile) for _, tile in found.swept.tiles]].sum() * (1 + CONFIRMING_ZOOM**2)
            cost = seen + pixels[evenly[:FAR_TILES]].sum() * FAR**2
            last = scale_of(found)
            rows.append((len(found.swept.tiles), cost, last.value, last.parts["sampling"], last.vehicles_used))
    n, cost, value, sd, used = np.array(rows).T
    all_cost = pixels.sum() * (1 + CONFIRMING_ZOOM**2)
    error = np.log(value / whole.value)
    print(f"{a.raster.name}: {picture.width * picture.height / 1e6:.0f} Mpx, {len(jobs)} tiles at zoom {zoom:.3f}")
    print(f"exhaustive: {whole.value:.5g} m/px, {whole.vehicles_used} vehicles, "
          f"sampling {100 * whole.parts['sampling']:.2f} %")  # fmt: skip
    print(f"{a.seeds} sweeps to {100 * a.target:g} %: {np.median(n):.0f} tiles, {n.min():.0f} to {n.max():.0f}, "
          f"{np.median(used):.0f} vehicles, sampling {100 * np.median(sd):.2f} %")  # fmt: skip
    print(
        f"network pixels, exhaustive over anytime: {all_cost / np.median(cost):.1f} (worst {all_cost / cost.max():.1f})"
    )
    standard = error.std(ddof=1) / np.sqrt(len(error))
    print(f"anytime against exhaustive: mean {100 * error.mean():+.3f} +- {100 * standard:.3f} %, "
          f"spread {100 * error.std(ddof=1):.2f} %, largest {100 * np.abs(error).max():.2f} %")  # fmt: skip
    if a.time:
        seconds = []
        for effort in (Effort(a.target, cache=False), Effort(exhaustive=True, cache=False)):
            start = time.perf_counter(), time.process_time()
            find_vehicles([picture], detector, zoom, effort=effort, sampling=sampling)
            seconds.append((time.perf_counter() - start[0], time.process_time() - start[1]))
        ratio = np.array(seconds[1]) / seconds[0]
        print(f"sweeps alone: anytime {seconds[0][0]:.1f} s, exhaustive {seconds[1][0]:.1f} s; "
              f"ratio {ratio[0]:.1f} (wall), {ratio[1]:.1f} (processor)")  # fmt: skip


if __name__ == "__main__":
    main()
