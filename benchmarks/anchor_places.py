"""Real pictures of known scale, and the scale of each from its vehicles and all its anchors together."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from orthoscale.core.anchors import Anchor
from orthoscale.core.measuring.anchors import votes_in_plan
from orthoscale.core.pooling.anchors import evidence_of
from orthoscale.core.pooling.combining import combined
from orthoscale.core.pooling.posterior import Posterior
from orthoscale.core.scale import PER_PIXEL

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared" / "data")
CHIP_GSD = 0.3048  # [m/px] one foot per pixel
VEHICLES_SD = 0.08  # relative one sigma of the vehicles' scale
SAME_LOG = 0.01  # [ln] two possible scales of an anchor that are this near each other count as one


Sample = tuple[str, np.ndarray, float, str]
"""Name, RGB picture, ground sampling distance [m/px] and country."""


def read(path: Path) -> np.ndarray:
    """RGB of a picture's file."""
    return np.asarray(cv2.imread(str(path)))[..., ::-1]


def chips(wanted: Callable[[Path], bool] = lambda path: True) -> Iterator[Sample]:
    """American chips, those whose paths are `wanted`."""
    for path in sorted((DATA / "vehicles" / "chips").glob("*.jpg")):
        if wanted(path):
            yield path.stem, read(path), CHIP_GSD, "US"


def scenes(montages: bool = False) -> Iterator[Sample]:
    """Orthophotos and nadir frames; those that are `montages` of chips only if asked for."""
    for folder in ("places", "orthophotos"):
        for name, known in json.loads((DATA / folder / "truth.json").read_text()).items():
            if "gsd_m" in known and (montages or not name.startswith("us_")):
                yield Path(name).stem, read(DATA / folder / name), known["gsd_m"], known["country"]


def vehicles_off(rng: np.random.Generator) -> float:
    """The factor by which the vehicles' scale is wrong: a random VEHICLES_SD, at most 1.5 of them."""
    return float(np.exp(np.clip(rng.normal(0, VEHICLES_SD), -1.5 * VEHICLES_SD, 1.5 * VEHICLES_SD)))


class Place(NamedTuple):
    """Relative error of a scale, and of the lower and the upper end of its 90 % interval; and whether the anchors were
    taken for the standard that is nearest to the truth."""

    error: float
    low: float
    high: float
    right: bool


def place_of(anchors: Sequence[Anchor], gsd: float, told: float, told_sd: float, country: str) -> Place:
    """The errors of the scale from `anchors` of one kind together with vehicles, whose scale is `told` [m/px] with a
    relative one sigma of `told_sd`; `gsd` [m/px] is the truth."""
    vehicles = Posterior.normal(float(np.log(told)), told_sd)
    (evidence,) = evidence_of(votes_in_plan(anchors, 4 * told_sd), country)
    fused = combined(vehicles, {}, [evidence], PER_PIXEL)
    value, low, high = fused.summary
    off = np.abs(evidence.own.mean - np.log(gsd))
    right = abs(np.log(fused.evidence[0].value / gsd)) <= off.min() + SAME_LOG
    return Place(value / gsd - 1, low / gsd - 1, high / gsd - 1, bool(right))


def held(places: np.ndarray) -> float:
    """Share of `places` (N, 4) whose 90 % interval holds the truth."""
    return float(np.mean((places[:, 1] <= 0) & (places[:, 2] >= 0)))


def half_width(places: np.ndarray) -> float:
    """Median half width of the 90 % intervals of `places` (N, 4)."""
    return float(np.median(places[:, 2] - places[:, 1]) / 2)
