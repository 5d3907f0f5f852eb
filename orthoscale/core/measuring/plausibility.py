"""Whether boxes can be vehicles at all: any boxes give some scale, so implausible ones are refused or doubted.

Boxes of an orthophoto are implausible if they overlap, have no common directions, all have the same length, are seldom
found by both detection passes, lie on pixels that are not square, or leave out others that look like cars.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..boxes import KINDS, Boxes
from ..confirmed import AS_LIKELY, OF_MISTAKES
from ..equal_sizes import of_one_size
from ..remarks import CAUTION, REFUSAL, Remark, percent
from ..scale import Scale
from ..verdicts import AT_BEST_DOUBTED, UNUSABLE, one_step_below, worst
from .squeeze import SQUEEZE, Squeeze, squeeze

NEAREST = 5  # neighbours that are tested for each box; where more are near, some of these overlap anyway
# Share of overlapping vehicles above which these are more than occasional mistakes. Of the 4,649 labelled vehicles of
# five places, 0.0 to 0.16 % have their centre in another one's box; of random boxes of the size of vehicles, 9 % where
# they cover 8 % of the picture, and 84 % where they cover all of it.
IN_ONE_ANOTHER = 0.1
LEAST_USED = 20  # vehicles below which a single pair would be too large a share

NEAR = 3.0  # vehicle lengths between centres within which the nearest vehicle is a neighbour
LEAST_PAIRS = 30  # pairs of neighbours below which chance may look like order, and the check is skipped
# Least mean cosine of four times the angle between neighbours: 1 where all are parallel or perpendicular, 0 by chance.
# Eight orthophotos of known scale and 109 parts of them with 25 pairs or more have 0.54 to 0.98, 67 labelled pictures
# with 15 or more 0.68 to 1; of 4,000 sets of random boxes with 30 pairs, one in a thousand reaches 0.35.
ALIGNED = 0.35

SQUEEZED_SIGMAS = 3.0  # deviation from square pixels at which it is significant
NOTABLE_SQUEEZE = 0.05  # log aspect below which it is not reported
# Log aspect above which no scale is fair: lengths along the axes err by half of it, by 6 % rms over all directions.
FAR_SQUEEZED = 0.17

LEAST_SEEN = 20  # boxes, counting or not, below which their share says little
# Share of larger vehicles (`Scale.larger_share`) above which a scale by few of the boxes is refused. Twelve orthophotos
# of known scale have up to 0.23, and up to 0.21 where so few boxes count; of 351 rendered towns full of look-alikes,
# the eight that were refused for it had 0.245 to 0.55 (`benchmarks/zoom_search.py`, 2026-11-24).
MANY_LARGER = 0.23
# Share of boxes that count below which these must agree well, and how well (`Scale.half_width`). 99 real pictures
# (places, quarters, chips) have a share of 0.2 or more. Of rendered towns of look-alikes with less than 0.1, those with
# the right scale have a half-width of 0.04; one with 0.09 was 22 % too large (2026-11-26).
HARDLY_ANY = 0.1
AGREEING = 0.06
INSPECT = "Inspect the boxes (--save-detections), or say roughly how large a pixel is (--gsd-hint METRES_PER_PIXEL)"


def plausible(scale: Scale, boxes: Boxes, uncounted: int, aspect: float = 1.0, searched: bool = True) -> Scale:
    """`scale`, with a remark for each check that its `boxes` (N, of one picture) fail.

    scale : from `boxes`, of which it uses some. uncounted : number of boxes that were detected but do not count.
    aspect : how many times as wide as high pixels are taken to be. searched : whether the scale search chose what size
    vehicles have; if the user gave it, other things of another size cannot pass for them.
    """
    used = boxes[scale.used]
    for check in (if_apart, if_in_order, if_unlike):
        scale = check(scale, used)
    if searched:
        scale = if_by_chance(if_alone(scale, boxes), len(boxes) + uncounted)
    return if_confirmed(if_square(scale, squeeze(used, aspect)), len(boxes), uncounted)


def if_apart(scale: Scale, used: Boxes) -> Scale:
    """`scale`, refused if many of the vehicles that it uses overlap: such boxes are not vehicles."""
    share = float(standing_in_another(used).mean()) if len(used) >= LEAST_USED else 0.0
    if share < IN_ONE_ANOTHER:
        return scale
    remark = Remark(
        REFUSAL,
        f"{100 * share:.0f} % of the vehicles overlap each other: the boxes are not vehicles, or some are duplicates",
        "Inspect the boxes (--save-detections), or let the built-in detector look",
    )
    return scale.remarked(remark, at_best=UNUSABLE)


def if_in_order(scale: Scale, used: Boxes) -> Scale:
    """`scale`, ``poor`` at best if the directions of the vehicles that it uses are random.

    Vehicles are parallel or perpendicular to their neighbours, because of lanes, kerbs, bays and rows. Boxes of
    unrelated directions may be things of any size.
    """
    pairs, agreement = alignment(used)
    if pairs < LEAST_PAIRS or agreement >= ALIGNED:
        return scale
    remark = Remark(
        CAUTION,
        f"the directions of {pairs} pairs of neighbours agree by {agreement:.2f}; for vehicles in lanes and rows it is "
        "0.5 to 1: check whether the boxes are vehicles",
    )
    return scale.remarked(remark, at_best="poor")


def if_unlike(scale: Scale, used: Boxes) -> Scale:
    """`scale`, refused if the vehicles that it uses are too similar in length: boxes of panels and roof machines of one
    make scatter by 1 or 2 %, those of vehicles in twelve places by 6 to 20 %."""
    if not of_one_size(used):
        return scale
    remark = Remark(
        REFUSAL,
        f"all {len(used)} boxes are equally long, unlike vehicles: they may be panels, graves or machines, or a lot "
        "full of one car model",
        "Inspect the boxes (--save-detections); give the vehicles' size (--gsd-hint METRES_PER_PIXEL) if there are any",
    )
    return scale.remarked(remark, at_best=UNUSABLE)


def if_alone(scale: Scale, boxes: Boxes) -> Scale:
    """`scale`, refused if nearly as many of `boxes` (N) as it uses are too large for it, or too small, though the
    measurer takes them for cars: then these may be the cars, and the others something else.

    Nearly as many is a share of AS_LIKELY, as for two lengths in the scale search. Lamps in pairs, 10 px long, gave
    2.3 times the scale of a school's yard once, whose three cars were "too large" (a sixteenth of `tartu_b`). In 140
    other parts of real orthophotos up to 0.17 as many are cars of another size: partly hidden, or two taken for one.
    """
    cars = ~scale.used & (boxes.kinds[:, KINDS.index("car")] > 0.5)
    usual = float(np.median(boxes.length[scale.used]))
    larger = boxes.length > usual
    others = max((boxes.length[cars & side] for side in (larger, ~larger)), key=len)
    if not len(others) or len(others) < AS_LIKELY * scale.vehicles_used:
        return scale
    length = float(np.median(others))
    remark = Remark(
        REFUSAL,
        f"vehicles may be {usual:.0f} px long, as {scale.vehicles_used} boxes are, or {length:.0f} px, as "
        f"{len(others)} others are that look like cars: the scale is {scale.value:.3g} {scale.unit}, or "
        f"{scale.value * usual / length:.3g}",
        INSPECT,
    )
    return scale.remarked(remark, at_best=UNUSABLE)


def if_by_chance(scale: Scale, seen: int) -> Scale:
    """`scale`, refused if it uses few vehicles, and these are few of all boxes `seen`, counting or not: a share of
    OF_MISTAKES or less. So many of them may agree on some size by chance."""
    used = scale.vehicles_used
    if seen < LEAST_SEEN or used >= LEAST_USED or used > OF_MISTAKES * seen:
        return scale
    remark = Remark(
        REFUSAL,
        f"only {used} of {seen} boxes agree on a size of vehicles ({percent(used / seen)}), as may be by chance: check "
        "whether there are vehicles at all",
        INSPECT,
    )
    return scale.remarked(remark, at_best=UNUSABLE)


def if_square(scale: Scale, found: Squeeze | None) -> Scale:
    """`scale`, less certain and doubted if pixels are not as square as assumed; refused if they are far from it.

    A single scale then does not hold along both axes. Lengths along x and along y err by half of the log aspect, with
    opposite signs; over all directions the rms error is the log aspect divided by the root of 8. The measurer's boxes
    show only a part of a squeeze (`squeeze`).
    """
    if found is None or found.sigmas < SQUEEZED_SIGMAS or abs(found.log_aspect) < NOTABLE_SQUEEZE:
        return scale
    sides, more = ("longer and narrower", "less") if found.log_aspect < 0 else ("shorter and wider", "more")
    far = abs(found.log_aspect) > FAR_SQUEEZED
    remark = Remark(
        REFUSAL if far else CAUTION,
        f"vehicles along rows of pixels look {sides} than those along columns: pixels seem to be "
        f"{np.exp(found.log_aspect):.2f} times as wide as high or {more} (+-{percent(found.sd)}, "
        f"{found.sigmas:.1f} sigma), "
        "besides what the georeferencing says",
        "Warp the picture to square pixels, or give it the georeferencing that it had" if far else "",
    )
    less = scale.with_parts({**scale.parts, SQUEEZE: abs(found.log_aspect) / np.sqrt(8)})
    return less.remarked(remark, at_best=UNUSABLE if far else AT_BEST_DOUBTED)


def if_confirmed(scale: Scale, believed: int, uncounted: int) -> Scale:
    """`scale`, with its verdict one step lower and ``poor`` at best where few of all boxes count.

    believed : number of boxes that count: found by both detection passes and not set aside (`Detections.set_aside`).
    uncounted : number of the others. Few is a share of OF_MISTAKES or less. The scale is refused where less than
    HARDLY_ANY count and these do not agree well, and where more than MANY_LARGER of the vehicles are larger ones.

    Vehicles are found at any resolution, other things only now and then. A picture without vehicles, full of panels,
    skylights and sheds, also gives boxes. If these have some other size, they give as certain a scale as vehicles, and
    anchors then follow it. Many vehicles much larger than cars are a bad sign there: the supposed cars may be graves or
    tents, and the supposed larger vehicles the cars.
    """
    seen = believed + uncounted
    if seen < LEAST_SEEN or believed > OF_MISTAKES * seen:
        return scale
    refused = believed < HARDLY_ANY * seen and scale.half_width > AGREEING
    few = Remark(
        REFUSAL if refused else CAUTION,
        f"{believed} of {seen} boxes count ({percent(believed / seen)}), as few as among false detections: check "
        "why the others do not, and whether there are vehicles at all",
        INSPECT if refused else "",
    )
    if refused:
        return scale.remarked(few, at_best=UNUSABLE)
    lower = scale.remarked(few, at_best=worst(one_step_below(scale.verdict), "poor"))
    if scale.larger_share <= MANY_LARGER:
        return lower
    remark = Remark(
        REFUSAL,
        f"{percent(scale.larger_share)} of the boxes are much larger than cars, as where most are mistakes: these "
        "may be the cars, and the others something else",
        INSPECT,
    )
    return lower.remarked(remark, at_best=UNUSABLE)


def standing_in_another(boxes: Boxes) -> np.ndarray:
    """(N,) bool: boxes whose centre lies in another box, or that contain another's centre; all of one picture."""
    inside = np.zeros(len(boxes), bool)
    if len(boxes) < 2:
        return inside
    count = min(NEAREST + 1, len(boxes))
    near = cKDTree(boxes.centre).query(boxes.centre, count)[1]
    one, other = np.repeat(np.arange(len(boxes)), count), near.ravel()
    one, other = one[one != other], other[one != other]
    offset = boxes.centre[one] - boxes.centre[other]
    u, v = ((offset * axis[other]).sum(1) for axis in (boxes.along, boxes.across))
    hit = (np.abs(u) < boxes.length[other] / 2) & (np.abs(v) < boxes.width[other] / 2)
    inside[one[hit]] = inside[other[hit]] = True
    return inside


def alignment(boxes: Boxes) -> tuple[int, float]:
    """Number of pairs of nearest neighbours in `boxes` (N, of one picture), and how well their directions agree: the
    mean of cos(4 difference), which is 1 for parallel and for perpendicular boxes, and 0 without any pair."""
    if len(boxes) < 2:
        return 0, 0.0
    distance, nearest = cKDTree(boxes.centre).query(boxes.centre, 2)
    near = distance[:, 1] < NEAR * np.median(boxes.length)
    pairs = np.unique(np.sort(np.column_stack([np.arange(len(boxes)), nearest[:, 1]])[near], 1), axis=0)
    if not len(pairs):
        return 0, 0.0
    between = boxes.angle[pairs[:, 0]] - boxes.angle[pairs[:, 1]]
    return len(pairs), float(np.cos(4 * between).mean())
