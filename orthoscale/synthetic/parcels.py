"""Divides the land between streets into parcels, and fills each by its use."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import lookalikes, things
from .mesh import Surface, patch, rectangle, rounded
from .site import Site, Span
from .things import MARKING, Thing, pick

LARGEST_PARCEL_M = {"city": 34, "suburb": 26, "village": 24}


def divide(site: Site, x: Span, y: Span) -> None:
    """Cut the land between streets in two until parcels are small enough, and fill each by a random use."""
    rng, w, h = site.rng, x[1] - x[0], y[1] - y[0]
    if max(w, h) > 16 and max(w, h) > LARGEST_PARCEL_M.get(site.style, 60) * rng.uniform(0.8, 1.3):
        share = rng.uniform(0.38, 0.62)
        if w > h:
            cut = x[0] + share * w
            divide(site, (x[0], cut), y)
            divide(site, (cut, x[1]), y)
        else:
            cut = y[0] + share * h
            divide(site, x, (y[0], cut))
            divide(site, x, (cut, y[1]))
        return
    middle = site.footprint(sum(x) / 2, sum(y) / 2, w, h)[:2]
    # Parcels outside of the scene matter only if they can cast shadows into it.
    if min(w, h) < 7 or np.abs(middle).max() > site.extent / 2 + np.hypot(w, h) / 2 + 15:
        return
    uses = USES[site.style]
    use = pick(rng, list(uses), list(uses.values()))
    use(site, (x[0] + 0.3, x[1] - 0.3), (y[0] + 0.3, y[1] - 0.3))


def _house(site: Site, x: Span, y: Span) -> None:
    """A house in a garden, with a drive beside it if there is room."""
    rng = site.rng
    site.lay(x, y, 1, pick(rng, [*site.greens[:2], site.stones, site.earths[0]], [0.5, 0.2, 0.15, 0.15]))
    w = min((x[1] - x[0]) * rng.uniform(0.45, 0.7), 22)
    h = min((y[1] - y[0]) * rng.uniform(0.4, 0.7), 16)
    at = site.somewhere(x, y, max(w, h))
    at = (
        float(np.clip(at[0] + rng.normal(0, 3), x[0] + w / 2 + 0.8, x[1] - w / 2 - 0.8)),
        float(np.clip(at[1] + rng.normal(0, 3), y[0] + h / 2 + 0.8, y[1] - h / 2 - 0.8)),
    )
    _building(site, *at, w, h, pick(rng, [3.0, 5.8, 8.5], [0.45, 0.4, 0.15]))
    drive = pick(rng, [site.stones, site.concrete, site.asphalt])
    for a, b in ((x[0], at[0] - w / 2), (at[0] + w / 2, x[1])):
        if b - a > 3.4:
            b = min(b, a + 3.6)
            site.lay((a + 0.3, b), (y[0], y[0] + 7), 2, drive)
            site.offer((a + b + 0.3) / 2, y[0] + 3.2, np.pi / 2, 5.5)
            site.offer((a + b + 0.3) / 2, y[0] + 9.2, np.pi / 2, 5.0)
            break
    if rng.random() < 0.25:
        site.put(things.pool(rng), *site.somewhere(x, y, 4), rng.uniform(0, 7))
    _furnish(site, x, y, trees=0.008, small=0.012)


def _hall(site: Site, x: Span, y: Span) -> None:
    """A large building that fills its parcel."""
    rng, margin = site.rng, site.rng.uniform(1.0, 4.0)
    site.lay(x, y, 1, pick(rng, [site.concrete, site.asphalt, site.stones]))
    size = x[1] - x[0] - 2 * margin, y[1] - y[0] - 2 * margin
    if min(size) > 3:
        _building(site, sum(x) / 2, sum(y) / 2, *size, rng.uniform(4, 12), flat=0.75)
    _furnish(site, x, y, trees=0.002, small=0.008)


def _lot(site: Site, x: Span, y: Span) -> None:
    """A parking lot: double rows of bays with aisles between."""
    rng = site.rng
    surface = pick(rng, [site.asphalt, site.concrete, site.stones, site.earths[2]], [0.6, 0.15, 0.15, 0.1])
    site.lay(x, y, 1, surface)
    swapped = (x[1] - x[0] < y[1] - y[0]) if rng.random() < 0.7 else bool(rng.random() < 0.5)
    (a0, a1), (b0, b1) = (y, x) if swapped else (x, y)
    bay, marked = rng.uniform(2.35, 2.8), surface[0] != "gravel" and rng.random() < 0.85
    paint: Surface = MARKING if rng.random() < 0.85 else ("plain", (0.55, 0.42, 0.06))

    def line(along: Span, across: Span) -> None:
        if marked:
            site.lay(*((across, along) if swapped else (along, across)), 3, paint)

    row = b0 + 0.6
    while row + 5 < b1:
        rows = 2 if row + 16 < b1 or rng.random() < 0.5 else 1
        for b in [row + 5 * k for k in range(rows) if row + 5 * k + 5 < b1]:
            for a in np.arange(a0 + 1.2, a1 - bay, bay):
                line((a - 0.05, a + 0.05), (b, b + 4.9))
                p, q = (b + 2.5, a + bay / 2) if swapped else (a + bay / 2, b + 2.5)
                if rng.random() > 0.02:
                    site.offer(p, q, 0.0 if swapped else np.pi / 2)
                else:
                    site.add(patch(rounded(2, 2, 0.5, 0.5), 0.004, *site.greens[0]), p, q)
                    site.tree(p, q, rng.uniform(1.0, 1.25))
        if row + 10 < b1:
            line((a0 + 1.2, a1 - bay), (row + 4.95, row + 5.05))
        row += 10 + rng.uniform(5.5, 7.0)
    for _ in range(rng.integers(0, 4) if marked else 0):
        at, heading = site.somewhere(x, y, 3), rng.integers(4) * np.pi / 2
        site.add(patch(rectangle(2.0, 0.2), 0.004, *paint), *at, heading)
        site.add(patch(np.array([[1.0, -0.4], [1.9, 0], [1.0, 0.4]]), 0.004, *paint), *at, heading)
    _furnish(site, x, y, trees=0.001, small=0.001)


def _green(site: Site, x: Span, y: Span) -> None:
    """Grass with trees, anything from a lawn to a wood, and perhaps a path."""
    rng = site.rng
    site.lay(x, y, 1, pick(rng, site.greens))
    if rng.random() < 0.5:
        path = rng.uniform(y[0] + 1, y[1] - 3)
        site.lay(x, (path, path + rng.uniform(1.2, 2.5)), 2, pick(rng, [site.stones, *site.earths]))
    _furnish(site, x, y, trees=pick(rng, [0.004, 0.015, 0.05]), small=0.005)


def _waste(site: Site, x: Span, y: Span) -> None:
    """Bare ground: a building site, wasteland."""
    rng = site.rng
    site.lay(x, y, 1, pick(rng, site.earths))
    for _ in range(rng.integers(0, 5)):
        site.put(things.boulder(rng, site.earths[0][1]), *site.somewhere(x, y, 2.5), rng.uniform(0, 7))
    _furnish(site, x, y, trees=0.004, small=0.02)
    for _ in range(2):
        site.offer(*site.somewhere(x, y, 3), rng.uniform(0, 2 * np.pi), 6)


def _field(site: Site, x: Span, y: Span) -> None:
    crop = pick(site.rng, [np.asarray(site.greens[0][1]) * 1.3, site.greens[2][1], site.earths[0][1]])
    site.lay(x, y, 1, ("field", crop))


def _yard(site: Site, x: Span, y: Span) -> None:
    """Containers or boats in rows, a lorry, some vehicles between."""
    rng = site.rng
    site.lay(x, y, 1, pick(rng, [site.concrete, site.asphalt, site.earths[2], site.earths[0]]))
    boats, across = rng.random() < 0.2, rng.random() < 0.5
    heading = np.pi / 2 if boats or across else 0.0
    step = (3.2, 7.5) if heading else (7.2, 3.4)
    for b in np.arange(y[0] + 4, y[1] - 3, step[1]):
        for a in np.arange(x[0] + 3.7, x[1] - 4, step[0]):
            if rng.random() < 0.5:
                continue
            if rng.random() < 0.3 and not boats:
                site.offer(a, b, heading, 6)
            else:
                thing = things.boat(rng) if boats else things.container(rng)
                site.put(thing, a, b, heading + rng.normal(0, 0.06 if boats else 0.02))
    if rng.random() < 0.6:
        site.lorry(site.somewhere(x, y, 6)[0], y[1] - 2, 0.0)
    _furnish(site, x, y, trees=0.0, small=0.015)


def _water(site: Site, x: Span, y: Span) -> None:
    """A pond with boats on it."""
    rng, middle = site.rng, (sum(x) / 2, sum(y) / 2)
    site.lay(x, y, 1, site.greens[0])
    size = x[1] - x[0] - 3, y[1] - y[0] - 3
    tone = pick(rng, [(0.02, 0.04, 0.035), (0.05, 0.07, 0.04), (0.02, 0.04, 0.07)])
    pond = patch(rounded(*size, min(size) * 0.42, min(size) * 0.36), 0.002, "water", tone, 0.6)
    for _ in range(rng.integers(0, 4)):
        site.put(things.boat(rng), *site.somewhere(x, y, 6), rng.uniform(0, 7))
    site.put(Thing(pond, x[1] - x[0], y[1] - y[0]), *middle, if_free=False)


def _court(site: Site, x: Span, y: Span) -> None:
    site.lay(x, y, 1, pick(site.rng, [site.greens[0], site.asphalt, site.stones]))
    w, h = x[1] - x[0], y[1] - y[0]
    thing = things.court(site.rng, (max(w, h), min(w, h)))
    site.put(thing, sum(x) / 2, sum(y) / 2, np.pi / 2 if h > w else 0.0)


def _playground(site: Site, x: Span, y: Span) -> None:
    site.lay(x, y, 1, site.greens[0])
    site.lay((x[0] + 1.5, x[1] - 1.5), (y[0] + 1.5, y[1] - 1.5), 2, site.earths[1])
    for _ in range(site.rng.integers(4, 10)):
        site.put(things.play_equipment(site.rng), *site.somewhere(x, y, 2.5), site.rng.uniform(0, 7))
    _furnish(site, x, y, trees=0.01, small=0.01)


def _panels(site: Site, x: Span, y: Span) -> None:
    """A building whose flat roof is full of solar panels or machines."""
    rng, w, h = site.rng, x[1] - x[0], y[1] - y[0]
    site.lay(x, y, 1, pick(rng, [site.concrete, site.asphalt, site.stones]))
    margin = rng.uniform(1.0, 4.0)
    size = w - 2 * margin, h - 2 * margin
    if min(size) > 4:
        roof = lookalikes.crowded_roof(rng, max(size), min(size))
        site.put(roof, sum(x) / 2, sum(y) / 2, np.pi / 2 if h > w else 0.0)
    _furnish(site, x, y, trees=0.002, small=0.004)


def _solar_park(site: Site, x: Span, y: Span) -> None:
    site.lay(x, y, 1, pick(site.rng, site.greens + site.earths))
    w, h = x[1] - x[0] - 2, y[1] - y[0] - 2
    site.put(Thing(lookalikes.panels(site.rng, w, h), w, h), sum(x) / 2, sum(y) / 2)


def _garages(site: Site, x: Span, y: Span) -> None:
    """Rows of garages with lanes between."""
    rng, deep, lane = site.rng, site.rng.uniform(5.2, 6.5), site.rng.uniform(5.5, 8)
    site.lay(x, y, 1, pick(rng, [site.concrete, site.asphalt, site.earths[2]]))
    for b in np.arange(y[0] + deep / 2 + 0.5, y[1] - deep / 2, deep + lane):
        site.put(lookalikes.garages(rng, x[1] - x[0] - 2, deep), sum(x) / 2, b)
        for a in rng.uniform(x[0] + 3, x[1] - 3, 2):
            site.offer(a, b + deep / 2 + lane / 2, 0.0)


def _rows(site: Site, x: Span, y: Span) -> None:
    """Similar things in rows: graves, tents, bales, tanks, bins, containers, boats, painted outlines, bushes."""
    rng = site.rng
    site.lay(x, y, 1, pick(rng, [*site.greens, *site.earths, site.concrete, site.asphalt]))
    _row_things(site, pick(rng, lookalikes.IN_ROWS)(rng), x, y)


def _marina(site: Site, x: Span, y: Span) -> None:
    """Boats side by side along piers."""
    rng, middle = site.rng, (sum(x) / 2, sum(y) / 2)
    tone = pick(rng, [(0.02, 0.04, 0.035), (0.05, 0.07, 0.04), (0.02, 0.04, 0.07)])
    site.lay(x, y, 1, ("water", tone))
    berth = rng.uniform(2.6, 4.2)
    for b in np.arange(y[0] + 9, y[1] - 8, rng.uniform(20, 26)):
        site.put(Thing(patch(rectangle(x[1] - x[0], 1.6), 0.3, "planks", (0.3, 0.24, 0.17)), x[1] - x[0], 1.6),
                  middle[0], b)  # fmt: skip
        for a in np.arange(x[0] + berth, x[1] - berth, berth):
            for side in (-1, 1):
                if rng.random() < 0.75:
                    site.put(things.boat(rng), a, b + side * 5.2, side * np.pi / 2 + rng.normal(0, 0.05))


def _row_things(site: Site, make: lookalikes.Maker, x: Span, y: Span) -> None:
    """Things of one maker on a lattice over a parcel; some places stay empty, and headings may vary."""
    rng, w, h = site.rng, x[1] - x[0] - 2, y[1] - y[0] - 2
    first, turned = make(rng), rng.random() < 0.5
    gaps, stray, share = rng.uniform([0.1, 0.3], [2.5, 4.0]), pick(rng, [0.0, 0.04, 0.2]), rng.uniform(0.5, 1)
    room = (h, w) if turned else (w, h)
    for a, b in lookalikes.lattice(*room, first.length, first.width, *gaps):
        if rng.random() < share:
            p, q = (b, a) if turned else (a, b)
            heading = (np.pi / 2 if turned else 0.0) + rng.normal(0, stray)
            site.put(make(rng), sum(x) / 2 + p, sum(y) / 2 + q, heading)


def _building(site: Site, x: float, y: float, w: float, h: float, eaves: float, flat: float = 0.4) -> None:
    thing = things.building(site.rng, max(w, h), min(w, h), eaves, flat)
    site.put(thing, x, y, np.pi / 2 if h > w else 0.0)


def _furnish(site: Site, x: Span, y: Span, trees: float, small: float) -> None:
    """Add patches of other ground, perhaps a hedge, wall or fence, and trees and small things, both given per square
    metre."""
    rng, area = site.rng, (x[1] - x[0]) * (y[1] - y[0])
    for _ in range(rng.poisson(area / 250) if trees > 0.002 else 0):
        angle = np.sort(rng.uniform(0, 2 * np.pi, 11))
        plan = rng.uniform(0.5, 3.5, 2) * np.stack([np.cos(angle), np.sin(angle)], 1)
        spot = patch(plan, 0.0015, *pick(rng, [*site.greens, *site.earths]))
        site.add(spot, *site.somewhere(x, y, 3.5), rng.uniform(0, 7))
    if rng.random() < 0.25:
        site.put(things.border(rng, x[1] - x[0], site.leaf), sum(x) / 2, y[0] + 0.45)
    for _ in range(min(rng.poisson(trees * area), 40)):
        low, high = pick(rng, [(0.6, 1.6), (1.5, 3.4), (3, 6)], [0.35, 0.45, 0.2])
        radius = rng.uniform(low, high)
        if min(x[1] - x[0], y[1] - y[0]) > 2 * radius + 0.4:
            site.tree(*site.somewhere(x, y, radius), radius)
    for _ in range(min(rng.poisson(small * area), 30)):
        thing = pick(rng, things.SMALL_THINGS)(rng)
        site.put(thing, *site.somewhere(x, y, 0.8), rng.uniform(0, 2 * np.pi))


Use = Callable[[Site, Span, Span], None]
USES: dict[str, dict[Use, float]] = {
    # The uses of parcels in each style of scene, with their weights.
    "city": {_house: 2, _hall: 3, _lot: 3, _green: 1.5, _court: 0.7, _yard: 0.6, _waste: 0.5},
    "suburb": {_house: 6, _lot: 1, _green: 2, _court: 0.5, _hall: 0.5, _waste: 0.3},
    "village": {_house: 4, _waste: 2, _green: 1, _yard: 1, _field: 1, _hall: 0.5, _lot: 0.6},
    "industrial": {_hall: 4, _yard: 3, _lot: 2, _waste: 1, _green: 0.7},
    "carpark": {_lot: 5, _hall: 1.5, _green: 1.5, _court: 0.5},
    "park": {_green: 5, _water: 1.2, _court: 1.2, _playground: 1, _lot: 1.4, _field: 1},
    "lookalikes": {_panels: 4, _rows: 4, _marina: 1, _garages: 1.2, _solar_park: 1, _lot: 1.5, _yard: 0.5},
}
