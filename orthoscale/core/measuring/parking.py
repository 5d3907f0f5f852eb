"""The pitch of parking rows: vehicles side by side repeat at the width of a stall, which each country standardises.

Only the boxes are used. In a row, the lateral distances between vehicles are multiples of one pitch, apart from how
inaccurately they are parked. Where that pitch is found, it gives the scale independently of the vehicles' sizes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..anchors import BAYS, Anchor, AnchorVote, Standard
from ..fleet import WORLD
from ..linked import linked

PARALLEL = np.cos(np.radians(7))  # vehicles of one row have the same heading, or the opposite one
ASKEW = 0.25  # of a length: how far one neighbour may stand ahead of the other
PITCHES = (1.15, 1.75)  # of a vehicle's width: 2.2 m for the widest cars to 2.8 m for the narrowest
STALLS_COMPARED = 6  # largest distance compared: the pitch's error grows with it, parking jitter does not
NEIGHBOURS = 256  # most neighbours within that reach: twice as many as fit, if no two boxes show one vehicle
MIN_ROW = 3  # vehicles side by side make a row
MIN_IN_ROWS = 8  # vehicles in rows, below which no pitch is measured
# Mean of cos(2 pi distance / pitch) above which distances count as multiples of the pitch: 0.9 for vehicles that stand
# within 0.12 m of their stall's middle, 0 for vehicles at random places.
RHYTHM = 0.7
AT_ONCE = 4096  # vehicles or distances that are worked on at a time, in some 10 MB
# How far the stalls of one place differ, all together, from their country's standard, one sigma [m]: the sourced rows
# of the table give 2.3 to 2.8 m for Japan, 2.4 to 2.7 for China, 2.59 to 2.74 for the USA. With the table's own sigma
# that makes 0.17 m or more. The figures that the table's sources name differ from their rows by about as much:
# the 37 that differ at all by 0.23 m rms, together with the 26 that do not by 0.18. RECALLED_SD is for standards that
# were only recalled; half of those behind the world's row were. Rows differ by 0.09 m (one sigma), which with 0.23 is
# 0.25.
PLACE_SD = 0.15
RECALLED_SD = 0.25


def parking_pitch(
    place: np.ndarray,
    along: np.ndarray,
    size: np.ndarray,
    stalls: Mapping[str, Mapping[str, Any]],
    country: str,
) -> AnchorVote | None:
    """The pitch of parking rows, as an anchor; None where no rows of MIN_IN_ROWS vehicles together show one, or
    `country` has no standard.

    place : (N, D) where vehicles stand [units], D 2 or 3. along : (N, D) unit vectors of their long sides.
    size : (N, 2) length and width [units]. stalls : widths and their one sigma by country, as in ``data/stalls.json``
    [m]. country : ISO code, or the key of a row; for ``WORLD`` the pitch may follow any row's standard.
    """
    rules = [key for key, stall in stalls.items() if country in (WORLD, key, *stall.get("countries", ()))]
    if not rules or len(place) < MIN_IN_ROWS:
        return None
    length, width = np.median(size, axis=0)
    row, distance = _rows(place, along, float(length), float(width))
    if not len(row):
        return None
    candidates = width * np.linspace(*PITCHES, 241)
    rhythm = _rhythm_of_rows(row[:, 0], distance, candidates)
    together = rhythm.sum(0)
    pitch = float(candidates[np.argmax(together)])
    # Next neighbours always have some mean distance; only vehicles further apart show whether it repeats.
    apart = distance > PITCHES[1] * width
    fits = np.cos(2 * np.pi * distance / pitch)
    repeats = apart.any() and min(fits[apart].mean(), fits[~apart].mean()) > RHYTHM
    vehicles = len(np.unique(row[:, 1:]))
    if vehicles < MIN_IN_ROWS or not repeats or not candidates[0] < pitch < candidates[-1]:
        return None
    # How far the pitch moves when one row is left out (Tukey's jackknife), which needs at least two rows.
    left_out = candidates[np.argmax(together - rhythm, axis=1)]
    spread = np.std(np.log(left_out)) * np.sqrt(len(rhythm) - 1) if len(rhythm) > 1 else 0.0
    step = np.log(candidates[1] / candidates[0])
    sd, middle = float(np.hypot(spread, step)), np.median(place, axis=0)
    meant = tuple(_standard(key, stalls[key]) for key in rules)
    lines, residual = np.empty((0, 2, 2)), np.empty(0)
    anchor = Anchor(BAYS, middle, lines, pitch, sd, residual, meant, 0.0, count=vehicles)
    return AnchorVote(anchor, middle, pitch, sd)


def documented(stall: Mapping[str, Any]) -> bool:
    """Whether the width in a row of the table comes from a rule that was found, and not from memory."""
    return bool(stall.get("documented", True))


def _standard(key: str, stall: Mapping[str, Any]) -> Standard:
    """The standard of stalls that only the vehicles in them show. Rules give the least width ("at least" in ten rows of
    the table), and no document says how much wider a place built them: `PLACE_SD` is a judgement, so this improves no
    verdict."""
    own = np.hypot(stall["width_sd"], PLACE_SD if documented(stall) else RECALLED_SD)
    return Standard(
        "stalls, by the vehicles in them",
        stall["width"],
        float(own / stall["width"]),
        stall["source"],
        countries=tuple(stall.get("countries", (key,))),
        documented=False,
    )


def _rhythm_of_rows(row: np.ndarray, distance: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """(R, C) how well the distances in each of R rows are multiples of each of C candidate pitches: the sum over the
    row's distances, each of which contributes -1 to 1.

    row : (P,) number of the row to which each distance (P,) belongs.
    """
    from scipy.sparse import csr_array

    rows, number = np.unique(row, return_inverse=True)
    sums = np.zeros((len(rows), len(candidates)))
    for k in range(0, len(row), AT_ONCE):
        here = number[k : k + AT_ONCE]
        member = csr_array((np.ones(len(here)), (here, np.arange(len(here)))), shape=(len(rows), len(here)))
        sums += member @ np.cos(2 * np.pi * distance[k : k + AT_ONCE, None] / candidates)
    return sums


def _rows(place: np.ndarray, along: np.ndarray, length: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of vehicles in one row: (P, 3) number of the row and the two vehicles, and (P,) distance across [units]."""
    from scipy.spatial import cKDTree

    # Of vehicles at exactly the same place one is kept; the tree could not tell them apart.
    single = np.sort(np.unique(place, axis=0, return_index=True)[1])
    tree = cKDTree(place[single])
    reach = STALLS_COMPARED * PITCHES[1] * width
    parts = []
    for k in range(0, len(single), AT_ONCE):
        i = single[k : k + AT_ONCE]
        near, j = tree.query(place[i], np.arange(1, NEIGHBOURS + 2), distance_upper_bound=reach)  # the first is itself
        pair, _ = np.nonzero(np.isfinite(near))
        parts.append(_side_by_side(i[pair], single[j[np.isfinite(near)]], place, along, length))
    i, j, across = (np.concatenate(column) for column in zip(*parts, strict=True))
    near = across < PITCHES[1] * width
    row = linked(i[near], j[near], len(place))
    kept = (row[i] == row[j]) & (np.bincount(row)[row[i]] >= MIN_ROW)
    return np.stack([row[i], i, j], -1)[kept], across[kept]


def _side_by_side(
    i: np.ndarray, j: np.ndarray, place: np.ndarray, along: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Those of the pairs (i, j), each once, that are parallel and stand beside each other; and their distance across
    [units]. Across is perpendicular to the mean of both headings, so the order of a pair does not matter."""
    i, j = i[i < j], j[i < j]
    apart = place[j] - place[i]
    alike = (along[i] * along[j]).sum(1)
    ahead = (apart * (along[i] + np.copysign(1.0, alike)[:, None] * along[j])).sum(1) / np.sqrt(2 + 2 * np.abs(alike))
    across = np.sqrt(np.maximum((apart**2).sum(1) - ahead**2, 0))
    beside = (np.abs(alike) > PARALLEL) & (np.abs(ahead) < ASKEW * length)
    return i[beside], j[beside], across[beside]
