"""The error of each projection, on simulated boxes of known vehicles: ``python benchmarks/projection_bias.py``.

Everything is noise-free, so what is left is the model's own error. Each model is given the vehicle's length and width;
the decoupled ones and the cuboid also how high the boxes reach. A cell is the mean and the standard deviation over
boxes of ``log(scale / truth)`` in percent: the bias that remains after pooling, and the spread that pooling averages
out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from orthoscale.core.projection import decoupled, exact
from orthoscale.core.projection.exact import Hull
from orthoscale.core.projection.own_ruler import CORNER, HEIGHT, LEAN, SeenBoxes
from orthoscale.core.projection.view import Views

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # for simulated boxes of known truth, as in the tests

from support.simulate import (  # noqa: E402
    DENSEUAV,
    MESHES,
    PITCHES,
    UNIT,
    VISLOC,
    Body,
    Flight,
    Seen,
    car_mesh,
    cuboid,
    cut,
    fly,
    found_ruler,
    table,
)  # fmt: skip

VEHICLES = 2000
# The hull of `exact` is in metres, so measuring is iterated; a round leaves up to half the error, at -30 degrees.
ROUNDS = 12
VARIANTS = {"naive": decoupled.NAIVE, "text": decoupled.TEXT, "program": decoupled.PROGRAM}
METHODS = (*VARIANTS, "exact")

CAR = (4.4, 1.9)
ASSUMED = {
    "flat, painted on the ground": (Body.of("", cuboid(0.01), CAR), cuboid(0.01)),
    "car, boxes reach 0.8 m": (Body.of("", Hull(), CAR), Hull()),
    "car, boxes reach the roof, 1.5 m": (Body.of("", Hull(height=1.5), CAR), Hull(height=1.5)),
    "cuboid 1.6 m": (Body.of("", cuboid(1.6), CAR), cuboid(1.6)),
}
OTHERS = {  # bodies that `exact` does not assume
    "saloon": Body.of("", Hull(1.45, belt=0.8, roof=1.45, front_inset=0.36, rear_inset=0.2, side_inset=0.13), CAR),
    "SUV": Body.of("", Hull(1.7, belt=1.0, roof=1.7, front_inset=0.26, rear_inset=0.06, side_inset=0.08), (4.7, 1.9)),
    "van": Body.of("", Hull(2.0, belt=1.1, roof=2.0, front_inset=0.18, rear_inset=0.02, side_inset=0.06), (5.3, 2.0)),
    "cuboid": Body.of("", cuboid(1.6), CAR),
}


def scales(seen: Seen, views: Views, body: Body, method: str, hull: Hull) -> np.ndarray:
    """(N,) metres per unit by each box; `exact` starts a tenth off and converges as in the program."""
    if method != "exact":
        return decoupled.paper_scale(seen.boxes, views, (*body.size, body.height), VARIANTS[method])
    metres_per_unit = 1.1 * UNIT
    for _ in range(ROUNDS):
        each = (np.array(body.size) / exact.ground_size(seen.boxes, views, metres_per_unit, hull)).mean(1)
        before, metres_per_unit = metres_per_unit, float(np.nanmedian(each))
        if abs(metres_per_unit / before - 1) < 1e-4:
            break
    return each


def error(seen: Seen, body: Body, method: str, hull: Hull, **mistake: float) -> np.ndarray:
    """(N,) log(scale / truth)."""
    return np.log(scales(seen, seen.views(**mistake, unit=UNIT), body, method, hull) / UNIT)


def cell(errors: np.ndarray) -> str:
    return f"{100 * np.nanmean(errors):+.1f} ± {100 * np.nanstd(errors):.1f}"


def bias(flight: Flight, tight: bool = False) -> str:
    rows = []
    for name, (body, hull) in ASSUMED.items():
        for pitch in PITCHES:
            seen = fly(np.random.default_rng(-pitch), VEHICLES, flight, pitch, body, tight)
            rows.append([name, f"{pitch}", *(cell(error(seen, body, m, hull)) for m in METHODS)])
    return table(["boxes made from", "pitch", *METHODS], rows)


def other_bodies(flight: Flight, vehicles: int = 100) -> str:
    """`exact` with the ruler found from the views themselves, on boxes of hulls and meshes that it does not assume."""
    rows = []
    whole = {f"{name}, hull": body for name, body in OTHERS.items()}
    whole |= {f"{shape}, mesh": car_mesh(shape) for shape in MESHES}
    low = {f"{name}, hull": cut(body, 0.8) for name, body in OTHERS.items()}
    low |= {f"{shape}, mesh": car_mesh(shape, 0.8) for shape in MESHES}
    told = [(name, body) for name in whole for body in ("van", "cuboid") if name.startswith(body)]
    for reach, bodies, as_what in (
        ("0.8 m", low, [(name, "car") for name in low]),
        ("the roof", whole, [(name, "car") for name in whole] + told),
    ):
        for name, kind in as_what:
            body = bodies[name]
            seen = [fly(np.random.default_rng(-p), vehicles, flight, p, body) for p in PITCHES]
            ruler = found_ruler(seen, kind)
            cells = []
            for s in seen:
                size = UNIT * ruler.size(SeenBoxes(s.boxes, s.views(unit=UNIT), 1.0, UNIT))
                cells.append(cell(np.log(body.size / size).mean(1)))
            found = [" / ".join(f"{v:.2f}" for v in ruler.value[:, k]) for k in (HEIGHT, LEAN)]
            rows.append([name, reach, kind, *found, f"{ruler.value[0, CORNER]:.2f}", *cells])
    head = ["boxes made from", "up to", "taken for a", "height [m]", "lean [1/m]", "corner", *map(str, PITCHES)]
    return table(head, rows)


def sensitivity(flight: Flight) -> str:
    """Percent by which the altitude and the footprint change when pitch or focal length is wrong.

    Both follow from the scale in units of the altitude: footprint ~ altitude / (f |sin pitch|).
    """
    body, hull = ASSUMED["car, boxes reach 0.8 m"]
    rows = []
    for pitch in PITCHES:
        seen = fly(np.random.default_rng(-pitch), VEHICLES, flight, pitch, body)
        for name, mistake in (("pitch + 1°", {"pitch_error": np.radians(1)}), ("f + 1 %", {"focal_error": 0.01})):
            cells = []
            for method in METHODS:
                change = error(seen, body, method, hull, **mistake) - error(seen, body, method, hull)
                of_altitude = float(np.nanmean(change))
                axis = np.radians(pitch)
                divisor = np.sin(axis + mistake.get("pitch_error", 0.0)) / np.sin(axis)
                of_footprint = of_altitude - np.log(divisor * (1 + mistake.get("focal_error", 0.0)))
                cells.append(f"{100 * of_altitude:+.2f} / {100 * of_footprint:+.2f}")
            rows.append([f"{pitch}", name, *cells])
    return table(["pitch", "mistake", *METHODS], rows)


def run_time(n: int = 100_000) -> str:
    body, hull = ASSUMED["car, boxes reach the roof, 1.5 m"]
    seen = fly(np.random.default_rng(0), n, DENSEUAV, -60, body)
    views = seen.views(unit=UNIT)
    jobs: dict[str, Callable[[], np.ndarray]] = {
        name: partial(decoupled.ground_size, seen.boxes, views, (*body.size, body.height), variant)
        for name, variant in VARIANTS.items()
    }
    jobs["exact, 0.8 m"] = partial(exact.ground_size, seen.boxes, views, UNIT, Hull())
    jobs["exact, 1.5 m"] = partial(exact.ground_size, seen.boxes, views, UNIT, hull)
    rows = []
    for name, job in jobs.items():
        start = time.process_time()
        job()
        seconds = time.process_time() - start
        rows.append([name, f"{seconds * n / len(seen.boxes):.2f}"])
    return table(["model", f"{n:,} boxes [processor s]"], rows)


def main() -> None:
    for flight in (DENSEUAV, VISLOC):
        low, high = flight.altitude
        print(f"## {flight.name}: f {flight.focal_px:.0f} px, {low:.0f} to {high:.0f} m\n")
        print(f"Boxes from the body that exact assumes; bias ± spread [%]\n\n{bias(flight)}\n")
        print(f"Boxes from other bodies; the ruler found by the views\n\n{other_bodies(flight)}\n")
        print(f"Boxes of least area instead of boxes along the heading\n\n{bias(flight, tight=True)}\n")
        print(f"Sensitivity: change of altitude / of footprint [%]\n\n{sensitivity(flight)}\n")
    print(f"## Run time\n\n{run_time()}")


if __name__ == "__main__":
    main()
