"""Compares an orthophoto with the reconstruction it was made from, by the vehicles that both show.

The orthophoto has the vehicles' positions in pixels, the model in its units. The positions fix the similarity transform
between the two, independently of the vehicles' sizes. So the model's scale gives metres per pixel a second time, from
other pictures and by another projection than the orthophoto's own boxes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import pdtrc

from ..core.pooling.agreement import Agreement, compare
from ..core.pooling.posterior import Z90
from ..errors import TooLittleEvidence, UsageError

if TYPE_CHECKING:
    from .result import Result

SAME_POSITION = 0.35  # of a vehicle's length: how far apart one may stand in the two
LIKELY_RATIO = 0.25  # the two scales differ by less, so that chance alignments need not be tried
PAIRS_TRIED = 20_000  # pairs of vehicles that are tried
MIN_MATCHED = 6
BY_CHANCE = 1e-3  # of so many tries, how many may reach as many common vehicles where there are none


@dataclass(frozen=True)
class CrossCheck:
    """An orthophoto compared with a model.

    units_per_pixel : model units that one pixel of the orthophoto covers. common : vehicles found in both. by_model :
    metres per pixel by the model's vehicles; by_ortho : by the orthophoto's own. agreement : of the two.
    """

    units_per_pixel: float
    common: int
    by_ortho: float
    by_model: float
    interval90_by_model: tuple[float, float]
    agreement: Agreement

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "units_per_pixel": self.units_per_pixel,
            "common_vehicles": self.common,
            "metres_per_pixel_by_ortho": self.by_ortho,
            "metres_per_pixel_by_model": self.by_model,
            "interval90_by_model": list(self.interval90_by_model),
            "difference": self.agreement.difference,
            "sigmas": self.agreement.tension,
            "contradicts": self.agreement.contradicts,
        }


def check_against_model(ortho: Result, model: Result) -> CrossCheck:
    """Compare the scale of the orthophoto `ortho` with that of the reconstruction `model`.

    Raises UsageError if they are not one of each, TooLittleEvidence if their vehicles do not match: another place, or
    too few.
    """
    posed = model.source.posed
    if ortho.source.plan is None or posed is None:
        raise UsageError("a cross-check needs an orthophoto and a model", "Give ORTHO.tif and --model FOLDER.")
    places = posed.from_above(model.votes.place[model.scale.used])
    pixels = ortho.votes.place[ortho.scale.used] * (1.0, -1.0)  # y up, as in the plan
    found = match(
        pixels * ortho.scale.value,
        places * model.scale.value,
        SAME_POSITION * float(np.median(model.vehicles["length"][model.scale.used])),
    )
    if found is None:
        raise TooLittleEvidence(
            f"the vehicles of {ortho.source.path} and {model.source.path} do not fall on one another "
            f"({len(pixels)} and {len(places)} of them)",
            "Is the orthophoto of the same place? More vehicles are needed where they stand too regularly.",
        )
    factor, common = found
    units_per_pixel = factor * ortho.scale.value / model.scale.value
    by_model = model.scale.value * units_per_pixel
    half = Z90 * model.scale.relative_sd
    agreement = compare(
        {"orthophoto": ortho.scale, "model": replace(model.scale, value=by_model, unit=ortho.scale.unit)}
    )
    interval = (float(by_model * np.exp(-half)), float(by_model * np.exp(half)))
    return CrossCheck(units_per_pixel, common, ortho.scale.value, by_model, interval, agreement)


def match(a: np.ndarray, b: np.ndarray, reach: float) -> tuple[float, int] | None:
    """The scale of the similarity from `a` (N, 2) to `b` (M, 2) that most points follow, and how many; None if few do.

    Both in about the same unit (to LIKELY); `reach` is how far apart a pair may be. Pairs of points in `a` are laid on
    pairs of like distance in `b`; the best of those is refined by least squares (Umeyama 1991). Seeded.
    """
    if min(len(a), len(b)) < MIN_MATCHED:
        return None
    i, j = np.triu_indices(len(a), 1)
    k, m = np.where(~np.eye(len(b), dtype=bool))  # either way round
    za, zb = a @ (1, 1j), b @ (1, 1j)  # a similarity of the plane is a complex factor and a shift
    da, db = np.abs(za[i] - za[j]), np.abs(zb[k] - zb[m])
    far = np.flatnonzero(da > np.percentile(da, 30))  # near pairs turn too freely
    random = np.random.default_rng(0)
    order = np.argsort(db)
    low, high = (np.searchsorted(db[order], da[far] * f) for f in (1 - LIKELY_RATIO, 1 + LIKELY_RATIO))
    room = np.maximum(high - low, 0)
    if not room.sum():
        return None
    pick = random.choice(len(far), PAIRS_TRIED, p=room / room.sum())
    partner = order[low[pick] + (random.random(PAIRS_TRIED) * room[pick]).astype(int)]
    p = far[pick]
    factor = (zb[m[partner]] - zb[k[partner]]) / (za[j[p]] - za[i[p]])
    shift = zb[k[partner]] - factor * za[i[p]]
    tree = cKDTree(b)
    counts = []
    for part in np.array_split(np.arange(PAIRS_TRIED), PAIRS_TRIED // 1000):
        z = factor[part, None] * za + shift[part, None]
        distance = tree.query(np.stack([z.real, z.imag], -1), distance_upper_bound=reach)[0]
        counts.append((distance < np.inf).sum(1))
    best = int(np.argmax(np.concatenate(counts)))
    f, s = factor[best], shift[best]
    for _ in range(5):
        z = f * za + s
        distance, index = tree.query(np.stack([z.real, z.imag], -1), distance_upper_bound=reach)
        near = distance < np.inf
        if near.sum() < MIN_MATCHED:
            return None
        x, y = za[near], zb[index[near]]
        f = np.vdot(x - x.mean(), y - y.mean()) / np.vdot(x - x.mean(), x - x.mean())
        s = y.mean() - f * x.mean()
    chance = len(a) * min(len(b) * np.pi * reach**2 / max(float(np.prod(np.ptp(b, axis=0))), 1e-300), 1.0)
    if PAIRS_TRIED * pdtrc(int(near.sum()) - 1, chance) > BY_CHANCE:
        return None
    return float(abs(f)), int(near.sum())
