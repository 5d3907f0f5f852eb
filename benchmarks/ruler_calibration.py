"""Does a reconstruction find its own ruler? ``python benchmarks/ruler_calibration.py``

Simulated flights over parked vehicles, whose boxes have a known effective height and margin. The detector's card has
other values; self-calibration must find the true ones, and the scale must not suffer.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from orthoscale.core.projection.own_ruler import HEIGHT, MARGIN, UNDERCUT
from orthoscale.fleets import load_fleet

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # for simulated boxes of known truth, as in the tests

from support.ruler_flights import find, fly  # noqa: E402
from support.simulate import table  # noqa: E402

HEIGHTS, MARGINS = (0.5, 0.8, 1.2, 1.6), (0.0, 2.0, 4.0)
UNDERCUTS = ((0.9, 2.0, 0.15), (0.9, 2.0, 0.3), (1.3, 2.0, 0.3))  # more cases: height [m], margin [px], undercut [m]
FLIGHTS = 6


def main() -> None:
    fleet = load_fleet("DE")
    rows = []
    for height, margin, undercut in [*((h, m, 0.0) for h in HEIGHTS for m in MARGINS), *UNDERCUTS]:
        flights = [fly(np.random.default_rng([k, 1]), fleet, height, margin, undercut=undercut) for k in range(FLIGHTS)]
        found = [find(flight) for flight in flights]
        shown = [HEIGHT, MARGIN, UNDERCUT]
        value = np.array([ruler.value[:, shown] for ruler, _ in found])  # (flights, axes, shown)
        error = 100 * np.array([e for _, e in found])
        cells = [f"{v.mean():.2f} ± {v.std():.2f}" for v in value.transpose(2, 1, 0).reshape(6, -1)]
        cells += [f"{e.mean():+.2f} ± {e.std():.2f}" for e in (*error.T, error.mean(1))]
        rows.append([f"{height}", f"{margin:.0f}", f"{undercut}", *cells])
    head = ["height [m]", "margin [px]", "undercut [m]"]
    head += [name for what in ("height", "margin", "undercut") for name in (f"{what} by lengths", "by widths")]
    print(table([*head, "scale by lengths [%]", "by widths", "both"], rows))


if __name__ == "__main__":
    main()
