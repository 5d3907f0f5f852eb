"""Parts of an orthophoto with another pixel size: there vehicles look like cars of another size, and do not count."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import binom

from ..verdicts import TOO_LARGE, TOO_SMALL

FEWEST_ODD = 5  # vehicles of another size, as many as a scale needs
# Probability that as many of them have one another as neighbours, if they stood among the others by chance. Neighbours
# are mutual, so the true one is larger, about its root.
APART_BY_CHANCE = 1e-5
# How far their median length over width may be from that of the vehicles that count (log). Cars are 2.4 times as
# long as wide, lorries and buses 3 to 5 times, three-wheelers 2.0 times. A judgement; of 14 orthophotos none has such a
# part.
CAR_SHAPED = 0.12


def other_size(vehicles: np.ndarray) -> tuple[float, str]:
    """How many times larger (log) vehicles of a car's shape appear in a part of the picture where no others stand,
    and a warning in words; zero and '' if there is no such part.

    vehicles : the `vehicle_table` of the picture.
    """
    used = vehicles["used"]
    for reason in (TOO_LARGE, TOO_SMALL):
        odd = vehicles["reason"] == reason
        if odd.sum() < FEWEST_ODD or not used.any():
            continue
        both = vehicles[used | odd]
        place, odd = np.stack([both["x_unit"], both["y_unit"]], -1), both["reason"] == reason
        beside = odd[cKDTree(place).query(place[odd], 2)[1][:, 1]].sum()
        apart = binom.sf(beside - 1, odd.sum(), (odd.sum() - 1) / (len(both) - 1)) < APART_BY_CHANCE
        shape = np.log(both["length"] / both["width"])
        if apart and abs(np.median(shape[odd]) - np.median(shape[~odd])) < CAR_SHAPED:
            size = -float(np.median(both["scale_deviation"][odd]) - np.median(both["scale_deviation"][~odd]))
            return abs(size), (
                f"{odd.sum()} vehicles of a car's shape, {np.exp(size):.2g} times as large as the others, stand where "
                "these do not: the picture may be put together from parts with different pixel sizes"
            )
    return 0.0, ""
