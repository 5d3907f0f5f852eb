"""What boxes may show besides the vehicles of a fleet: larger vehicles, lorries, partly hidden vehicles, no vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from ..boxes import KINDS
from ..market_segments import Class, shares_of

# Outlier class: uniform over a box in (log length, log width) as wide as anything a detector could call a vehicle.
OUTLIER_DENSITY = 1 / (3.0 * 2.5)
OUTLIER_SHARE = 0.1  # prior share of the boxes, ...
OUTLIER_BOXES = 10.0  # ... as if it had been counted on so many: it depends on the picture, not on the country's mix
# Boxes without a vehicle are called any kind with equal probability. Lorries, which are not of these classes either,
# are called larger.
OUTLIER_CALLED = 1 / len(KINDS)
# Vans of middle size and large ones, minivans, pickups of middle and of full size, and the largest SUVs, which a
# detector of small vehicles finds too: the mean and the spread of those six segments (5.00 to 5.85 m long, 1.86 to
# 2.05 m wide; four are in data/fleets.json, the vans in the table that it was made from). Which of them stand at a
# place is not known, so their mean there is a parameter of its own, with the spread between the segments as its prior.
LARGER = Class(
    "larger", 1.0, np.array([5.39, 1.98, 2.0]), np.array([0.31, 0.065, 0.25]), 0.5, np.zeros(3),
    kinds=np.array([0.25, 0.25, 0.4, 0.1]),  # those six in equal parts, and small lorries; judged
)  # fmt: skip
# Small lorries, large vans and minibuses, which look like cars to a detector of small vehicles: the middle and the
# spread of their usual sizes (Toyota Coaster 6.3 to 7.0 x 2.04 m, Isuzu NPR 6.0 to 7.7 x 2.1, Mercedes Sprinter, long,
# 7.0 x 2.02, Tata 407 5.7 x 2.1, American cutaway vans 7.3 x 2.4; makers' sheets, recalled). They say little of the
# scale. Without a class of their own they would pass for LARGER at a smaller scale, and cars for the smallest class.
LORRIES = Class(
    "small lorries and buses", 1.0, np.array([6.8, 2.2, 2.7]), np.array([0.7, 0.15, 0.35]), 0.5, np.zeros(3),
    kinds=np.array([0.0, 0.0, 0.4, 0.6]),
)  # fmt: skip
LORRIES_SHARE = 0.03  # of the vehicles: 19 of 521 boxes of eight orthophotos are longer than 5.9 m, none American
# That share is known as if it had been counted on so many: it is 0 to 0.06 at the six of those places that have more
# than 20 boxes. Where most vehicles would have to be lorries, it is the scale that is wrong.
LORRIES_VEHICLES = 100.0
# Vehicles of which a part is not recognised: it lies under a tree or a roof or in black shade, or looks like the
# ground. They are measured too short, by a little or by half, and hardly too narrow. Without a class of their own they
# would pass for the fleet's smallest vehicles, at a larger scale: at 52 American places made of chips
# (benchmarks/results/places.md) the error was 6.1 % (root mean square) without this class and 4.3 % with it; other
# sizes, spreads and twice the share gave 4.1 to 4.9 %. Since then the measurer measures fewer vehicles too short, so
# half as many are expected.
HIDDEN_SIZE, HIDDEN_SD = (0.78, 0.94), (0.15, 0.1)  # mean and spread, as shares of the fleet's mean length and width
HIDDEN_SHARE, HIDDEN_VEHICLES = 0.03, 100.0  # of the vehicles, as with lorries: where most would be, the scale is wrong
# The share of LARGER at a place, beyond the fleet's own. Vans are 10 to 12 % of the light vehicles registered in Europe
# (ACEA: 30 of 280 million), and fleets of cars do not contain them. A fleet with pickups contains its long vehicles
# already, but still lacks some. How well that share is known: `PlaceKind.left_out`.
LEFT_OUT = 0.11
LEFT_OUT_AT_LEAST = 0.05
LONG = 5.2  # [m] a third of LARGER is shorter than that
BESIDE_FLEET = 3  # number of classes besides a fleet's own: LARGER, LORRIES, and partly hidden vehicles


def left_out(classes: Sequence[Class]) -> float:
    """Share of LARGER beside a fleet of `classes`, beyond its own."""
    own = sum(c.weight * ndtr((c.mean[0] - LONG) / c.sd[0]) for c in classes) / sum(c.weight for c in classes)
    return float(max(LEFT_OUT - own, LEFT_OUT_AT_LEAST))


def partly_hidden(classes: Sequence[Class]) -> Class:
    """The class of partly hidden vehicles of `classes`, by what is seen of them."""
    weight = shares_of(classes)
    mean, kinds = weight @ [c.mean for c in classes], weight @ [c.kinds for c in classes]
    size, sd = (np.array([*share, 1.0]) * mean for share in (HIDDEN_SIZE, HIDDEN_SD))
    return Class("partly hidden", 1.0, size, sd, 0.0, np.zeros(3), kinds)
