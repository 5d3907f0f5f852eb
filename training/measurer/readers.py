r"""Place-to-place errors of the measurer, separated from those of its readers.

    python -m training.measurer.readers --measurer M.onnx --data ../shared/data [READ.json ...]

The difference between the measurer and one reader at a place contains the errors of both. Another reader, who saw
neither the first one's answers nor any box, makes independent errors. So each reader's bias, a factor and a margin in
pixels, is removed, and the residuals of readers are compared: the part that two of them share is the measurer's error
(or due to what both take for the edge). The mean residual of each place is printed, too. By default the readings are
those of labels/.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.normal import median_and_sd
from orthoscale.detect.detector import Detector
from orthoscale.detect.measurer import Measurer
from training.evaluate import BY_HAND, measured_scenes

from .evaluate import FEWEST, SHIPPED, Place, against_readings, variance_of
from .real import READ as LEARNT
from .real import SLANTED

READ = (BY_HAND, *(BY_HAND.with_name(f"read_again_{reader}.json") for reader in "abcdeghijklm"))
STRAY = (0.01, 0.015)  # place-to-place one sigma of length and width that is assumed for the weights of readings
DRAWS = 1000  # of places, for the uncertainty (bootstrap; Efron 1979)


@dataclass(frozen=True, kw_only=True)
class Reading(Place):
    """The measurer against one reader's vehicles of the place named `place`."""

    reader: int
    place: str


def without_habits(readings: Sequence[Reading], axis: int) -> tuple[np.ndarray, np.ndarray]:
    """(N,) residuals of readings of length (axis 0) or width (1), and (N,) their weights [1 / one sigma].

    Readings are modelled as `bias of the reader + margin of the reader / size + error at the place`, by weighted least
    squares.
    """
    readers = sorted({r.reader for r in readings})
    y = np.array([r.log_ratio[axis] for r in readings])
    habit = np.zeros((len(readings), 2 * len(readers)))
    for row, r in zip(habit, readings, strict=True):
        k = 2 * readers.index(r.reader)
        row[k : k + 2] = 1, 1 / r.size[axis]
    weight = 1 / np.sqrt([r.variance[axis] + STRAY[axis] ** 2 for r in readings])
    left = y - habit @ np.linalg.lstsq(habit * weight[:, None], y * weight, rcond=None)[0]
    return left, weight


def stray(readings: Sequence[Reading]) -> np.ndarray:
    """(2,) variance of the measurer's errors at places, in length and width, as far as readers agree on them: the mean
    product of two readers' residuals at one place, which is the covariance of errors that both share. It may come out
    negative."""
    shared = np.zeros(2)
    for axis in (0, 1):
        left, weight = without_habits(readings, axis)
        pairs = [
            (left[i] * left[j], weight[i] * weight[j] / (len(there) - 1))
            for there in by_place(readings).values()
            for i, j in combinations(there, 2)
        ]
        product, weights = np.array(pairs).T
        shared[axis] = np.average(product, weights=weights)
    return shared


def by_place(readings: Sequence[Reading]) -> dict[str, list[int]]:
    """Numbers of the readings of each place."""
    return {
        place: [k for k, r in enumerate(readings) if r.place == place] for place in sorted({r.place for r in readings})
    }


def drawn(readings: Sequence[Reading], seed: int = 0) -> np.ndarray:
    """(DRAWS, 2) `stray` of places drawn with replacement, each with all its readings (bootstrap)."""
    rng = np.random.default_rng(seed)
    at = by_place(readings)
    found = []
    while len(found) < DRAWS:
        names = rng.choice(list(at), len(at))
        some = [replace(readings[n], place=f"{k} {name}") for k, name in enumerate(names) for n in at[name]]
        if len({r.reader for r in some}) > 1:
            found.append(stray(some))
    return np.array(found)


def read_by(measurer: Measurer, detector: Detector, data: Path, file: Path, reader: int) -> list[Reading]:
    """One reader's readings of the places that were not trained on."""
    found = []
    for scene in measured_scenes(data, file):
        if scene.name in (*LEARNT, *SLANTED):
            continue
        rows = against_readings(measurer, detector, scene)
        sure = rows[:, -1] > 0
        if sure.sum() < FEWEST:
            continue
        size = np.concatenate([p.vehicles for p in scene.pictures])[sure, 2:4]
        median, spread = median_and_sd(rows[sure, :2])
        variance = variance_of(spread, sure.sum())
        found.append(Reading(median, variance, np.median(size, axis=0), reader=reader, place=scene.name))
    return found


def _sd(variance: float) -> str:
    """Square root of a variance [%], with the variance's sign."""
    return f"{100 * np.sign(variance) * np.sqrt(abs(variance)):.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measurer", type=Path, required=True)
    parser.add_argument("--detector", type=Path, default=SHIPPED, help="(%(default)s)")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("read", nargs="*", type=Path, default=READ, help="one file for each reader or group of them")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    measurer, detector = Measurer(options.measurer), Detector(options.detector, threads=1)
    readings = [
        reading for k, file in enumerate(options.read) for reading in read_by(measurer, detector, options.data, file, k)
    ]
    shared, trials = stray(readings), drawn(readings)
    print(f"{len(options.read)} readers, {len({r.place for r in readings})} places, {len(readings)} readings of them")
    left = [without_habits(readings, axis) for axis in (0, 1)]
    for place, there in by_place(readings).items():
        means = [
            f"{100 * np.average(rest[there], weights=weight[there] ** 2):+5.1f} +- "
            f"{100 / np.sqrt((weight[there] ** 2).sum()):.1f} %"
            for rest, weight in left
        ]
        print(f"{place:20s} {len(there)} readers: length {means[0]}, width {means[1]}")
    for axis, name in enumerate(("length", "width")):
        low, high = np.quantile(trials[:, axis], (0.16, 0.84))
        print(
            f"{name:6s} strays from place to place by {_sd(shared[axis])} % as readers agree "
            f"(one sigma: {_sd(low)} to {_sd(high)})"
        )


if __name__ == "__main__":
    main()
