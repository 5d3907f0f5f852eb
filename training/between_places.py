"""How far the vehicles of places differ from their country's: ``python -m training.between_places ../shared/data``.

Vehicles that were measured by eye (`labels/by_hand.json`) in orthophotos of known scale have lengths in metres. Their
mean differs from the country's fleet because they are few, because the country's fleet is not known exactly, because of
the readers' bias (the mean over all places, which is subtracted), and because places differ. The last is the
between-places standard deviation of a random-effects model (DerSimonian and Laird 1986), printed with its 90 % interval
(Cochran's Q, Viechtbauer 2007). Widths are used only from pictures finer than FINE: in coarser ones readers take blur
for vehicle.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from orthoscale.fleets import load_fleet

from .evaluate import BY_HAND

FINE = 0.15  # metres per pixel
LARGER = 6.2  # longer vehicles are in no fleet [m]
FEWEST = 3  # vehicles of a place


def deviations(data: Path) -> dict[str, tuple[str, float, np.ndarray, np.ndarray]]:
    """By place: country, metres per pixel, (2,) log ratio of mean length and width to the fleet's, (2,) its one sigma
    due to the number of vehicles."""
    truth = {}
    for folder in ("places", "orthophotos"):
        truth |= {Path(k).stem: v for k, v in json.loads((data / folder / "truth.json").read_text()).items()}
    sizes: dict[str, list[list[float]]] = {}
    for vehicle in json.loads(BY_HAND.read_text())["vehicles"]:
        if "gsd_m" in truth.get(vehicle["scene"], ()):
            sizes.setdefault(vehicle["scene"], []).append(vehicle["read"][2:4])
    found = {}
    for scene, pixels in sorted(sizes.items()):
        gsd, country = truth[scene]["gsd_m"], truth[scene]["country"]
        size = np.array(pixels) * gsd
        size = size[size[:, 0] < LARGER]
        if len(size) >= FEWEST:
            fleet = load_fleet(country)
            sd = np.sqrt(np.diag(fleet.log_covariance) / len(size))
            found[scene] = country, gsd, np.log(size).mean(0) - fleet.log_mean, sd
    return found


def between(value: np.ndarray, sd: np.ndarray) -> tuple[float, float, float]:
    """The standard deviation of the places' true values, and its 90 % interval, from `value` with one-sigma `sd`."""

    def q(tau: float) -> float:
        weight = 1 / (sd**2 + tau**2)
        return float((weight * (value - weight @ value / weight.sum()) ** 2).sum())

    weight, free = 1 / sd**2, len(value) - 1
    best = max(0.0, (q(0.0) - free) / (weight.sum() - (weight**2).sum() / weight.sum())) ** 0.5

    def where(share: float) -> float:
        wanted = chi2.ppf(share, free)
        return 0.0 if q(0.0) < wanted else float(brentq(lambda tau: q(tau) - wanted, 0.0, 1.0))

    return best, where(0.95), where(0.05)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    found = deviations(parser.parse_args().data)
    for scene, (country, gsd, apart, sd) in found.items():
        length, width = (f"{100 * a:+5.1f} +- {100 * s:.1f}" for a, s in zip(apart, sd, strict=True))
        print(f"{scene:22s} {country}  {gsd:.3f} m/px  length {length} %  width {width} %")
    for axis, name in enumerate(("length", "width")):
        rows = [(a[axis], s[axis]) for _, gsd, a, s in found.values() if axis == 0 or gsd < FINE]
        best, low, high = between(*np.array(rows).T)
        print(f"{name}: {len(rows)} places differ by {100 * best:.1f} % ({100 * low:.1f} to {100 * high:.1f})")


if __name__ == "__main__":
    main()
