"""Objects that detectors mistake for vehicles, in rows and of about their size: panels, boats, graves, garages.

Sizes are the usual commercial ones, drawn once for a whole row if real rows are uniform.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from .mesh import (
    Mesh,
    Surface,
    at_height,
    disc,
    dome,
    faces,
    gable,
    join,
    loft,
    patch,
    prism,
    rectangle,
    rounded,
)
from .things import Thing, boat, container, grey, pick, tinted
from .vehicle import GLASS

Maker = Callable[[np.random.Generator], Thing]


# Roofs.


def panels(rng: np.random.Generator, length: float, width: float) -> Mesh:
    """Solar modules that fill a rectangle about the origin, in tables of rows along x, tilted towards -y or lying flat.

    A module is 1.0 to 1.15 m by 1.6 to 2.3 m, upright or on its side; tilted tables leave room for their shadow.
    """
    module = rng.uniform([1.6, 0.98], [2.3, 1.15])
    a, b = module if rng.random() < 0.6 else module[::-1]  # along and across the row
    deep = int(pick(rng, [1, 2, 3, 4], [0.55, 0.25, 0.1, 0.1]))  # modules one above the other in a table
    many = int(pick(rng, [1, 2, 6, 12, 24], [0.15, 0.1, 0.25, 0.25, 0.25]))  # side by side
    seam = rng.uniform(0.015, 0.05)
    tilt = pick(rng, [0.0, rng.uniform(0.1, 0.5)], [0.35, 0.65])
    aisle = rng.uniform(0.25, 1.4) if tilt else rng.uniform(0.05, 0.8)
    glass = tinted(rng, pick(rng, [(0.02, 0.03, 0.06), (0.012, 0.012, 0.014), (0.03, 0.05, 0.12)]), 0.3)
    frame = grey(rng, 0.02, 0.08) if rng.random() < 0.4 else grey(rng, 0.3, 0.6)
    table, row = many * (a + seam), deep * (b + seam) * np.cos(tilt)
    gap = rng.uniform(0.2, 1.2)
    x0 = np.arange(-length / 2, length / 2 - a, a + seam)
    x0 = x0 + gap * np.floor((x0 + length / 2) / table)
    x0 = x0[x0 + a <= length / 2]
    y0 = np.arange(-width / 2, width / 2 - row, row + aisle)
    skip = rng.random((len(y0), len(x0))) < rng.choice([0.0, 0.0, 0.04])
    quads, rims = [], []
    for j, y in enumerate(y0):
        for i, x in enumerate(x0):
            if skip[j, i]:
                continue
            for k in range(deep):
                up = k * (b + seam) + np.array([0, 0, b, b])
                corners = np.stack([x + np.array([0, a, a, 0]), y + up * np.cos(tilt), 0.15 + up * np.sin(tilt)], 1)
                rims.append(corners)
                inner = corners.mean(0) + (corners - corners.mean(0)) * (1 - 0.07 / np.array([a, b, b]))
                quads.append(inner + [0, 0, 0.01])
    if not quads:
        return join([])
    return join([faces(np.array(rims), "plain", frame), faces(np.array(quads), "plain", glass, 0.6)])


def roof_machines(rng: np.random.Generator, length: float, width: float) -> Mesh:
    """Skylights, ventilators or air conditioners, all alike, on a lattice over a rectangle about the origin."""
    a, b = rng.uniform([1.0, 0.8], [5.0, 2.2])
    high, tone = rng.uniform(0.15, 1.6), rng.uniform(0.1, 0.75)
    side: Surface = ("plain", grey(rng, 0.2, 0.6))
    top: Surface = pick(rng, [("paint", GLASS), ("plain", np.ones(3) * tone), ("plain", np.array([0.55, 0.6, 0.62]))])
    fan = rng.random() < 0.5 and high > 0.6
    unit = [prism(rectangle(a, b), 0, high, side, top, 0.5)]
    if fan:
        fans = max(1, round(a / b))
        for k in range(fans):
            at = [(k + 0.5) * a / fans - a / 2, 0]
            unit.append(patch(disc(0.38 * min(b, a / fans)) + at, high + 0.02, "plain", np.ones(3) * tone * 0.3))
    one = join(unit)
    return join(
        [one.placed(x, y) for x, y in lattice(length, width, a, b, rng.uniform(0.4, 5.0), rng.uniform(0.4, 5.0))]
    )


def lattice(length: float, width: float, a: float, b: float, along: float, across: float) -> np.ndarray:
    """(N, 2) centres of rectangles `a` by `b`, spaced by gaps `along` x and `across`, that fill a rectangle `length` by
    `width` about the origin."""
    nx, ny = (int((room + gap) // (size + gap)) for room, size, gap in ((length, a, along), (width, b, across)))
    x = (np.arange(nx) - (nx - 1) / 2) * (a + along)
    y = (np.arange(ny) - (ny - 1) / 2) * (b + across)
    return np.stack([v.ravel() for v in np.meshgrid(x, y)], 1)


def crowded_roof(rng: np.random.Generator, length: float, width: float) -> Thing:
    """A building with a flat roof full of panels or machines, in one to three fields."""
    eaves, metal = rng.uniform(3, 14), grey(rng, 0.15, 0.6)
    covering: Surface = pick(
        rng,
        [("bitumen", grey(rng, 0.06, 0.25)), ("roof_gravel", grey(rng, 0.25, 0.35)), ("corrugated", metal),
         ("seam", metal), ("plaster", grey(rng, 0.5, 0.8)), ("plain", grey(rng, 0.5, 0.8))],
    )  # fmt: skip
    parts = [prism(rectangle(length, width), 0, eaves, ("facade", tinted(rng, (0.45, 0.41, 0.36))), covering)]
    cuts = np.r_[0, np.sort(rng.uniform(0.2, 0.8, rng.integers(0, 3))), 1] * (length - 1.6) - (length - 1.6) / 2
    filling = pick(rng, [panels, roof_machines], [0.7, 0.3])
    for a, b in pairwise(cuts):
        room = b - a - 0.8, width - 1.6
        if min(room) < 2:
            continue
        turned = rng.random() < 0.5
        field = filling(rng, *(room[::-1] if turned else room))
        parts.append(field.placed((a + b) / 2, 0, np.pi / 2 if turned else 0.0, eaves))
    return Thing(join(parts), length + 0.5, width + 0.5)


def garages(rng: np.random.Generator, length: float, width: float) -> Thing:
    """A row along x of adjoining garages or carports with flat roofs, each 2.6 to 3.3 m wide and `width` deep."""
    unit, high = rng.uniform(2.6, 3.3), rng.uniform(2.2, 2.8)
    tone, parts = grey(rng, 0.1, 0.6), []
    count = max(1, int(length / unit))
    metal: Surface = ("corrugated", tone) if rng.random() < 0.3 else ("bitumen", tone)
    for k in range(count):
        shade = metal[0], np.asarray(metal[1]) * rng.uniform(0.75, 1.3)
        size = rectangle(unit - rng.uniform(0.03, 0.2), width)
        box = prism(size, 0, high + rng.uniform(-0.06, 0.06), ("plaster", (0.5, 0.48, 0.45)), shade)
        parts.append(box.placed((k - (count - 1) / 2) * unit, 0))
    return Thing(join(parts), count * unit, width)


# Rows on the ground; each function returns a maker of similar things.


def graves(rng: np.random.Generator) -> Maker:
    """Slabs of stone 1.9 to 2.4 m long with a headstone."""
    length, width, high = rng.uniform(1.9, 2.4), rng.uniform(0.8, 1.3), rng.uniform(0.2, 0.5)

    def grave(rng: np.random.Generator) -> Thing:
        stone: Surface = ("plain", grey(rng, 0.05, 0.6) * rng.uniform(0.9, 1.1, 3))
        head = prism(rectangle(0.15, width * 0.8) + [length / 2 - 0.1, 0], 0, rng.uniform(0.6, 1.1), stone)
        top = stone if rng.random() < 0.7 else ("grass", (0.1, 0.14, 0.06))
        return Thing(join([prism(rectangle(length, width), 0, high, stone, top, 0.3), head]), length, width)

    return grave


def tents(rng: np.random.Generator) -> Maker:
    """Tents, or the canopies of a market, 2 to 6 m long."""
    length, width, high = rng.uniform(2.2, 6), rng.uniform(1.8, 3.2), rng.uniform(1.4, 2.6)
    common = rng.random() < 0.5
    cloth = rng.uniform(0.05, 0.7, 3) if rng.random() < 0.6 else grey(rng, 0.6, 0.8)

    def tent(rng: np.random.Generator) -> Thing:
        tone: Surface = ("plain", cloth if common else rng.uniform(0.03, 0.75, 3))
        return Thing(gable(length, width, 0.6 * high, high, tone, tone, 0.1), length, width)

    return tent


def bales(rng: np.random.Generator) -> Maker:
    """Bales of straw, round, square, or wrapped in white, green or black."""
    size = pick(rng, [(1.3, 1.3), (2.4, 1.2), (1.5, 1.2), (2.2, 0.9)])
    tone = np.array(pick(rng, [(0.42, 0.33, 0.14), (0.75, 0.75, 0.75), (0.25, 0.4, 0.2), (0.03, 0.03, 0.03)]))
    plan = rounded(size[0], size[1], 0.3, 0.3) if rng.random() < 0.6 else rectangle(*size)

    def bale(rng: np.random.Generator) -> Thing:
        colour = tone * rng.uniform(0.85, 1.15)
        return Thing(prism(plan, 0, 1.2, ("plain", colour), ("plain", colour * 1.1)), *size)

    return bale


def tanks(rng: np.random.Generator) -> Maker:
    """Tanks: upright ones 2 to 16 m across, or lying ones of the size of vehicles."""
    tone = grey(rng, 0.35, 0.8) if rng.random() < 0.8 else tinted(rng, (0.3, 0.25, 0.2))
    lies, radius = rng.random() < 0.5, np.exp(rng.uniform(*np.log([1.0, 8.0])))
    size = (rng.uniform(3.5, 9), rng.uniform(1.4, 2.6)) if lies else (2 * radius, 2 * radius)

    def tank(rng: np.random.Generator) -> Thing:
        colour = tone * rng.uniform(0.9, 1.1)
        if lies:
            ring = np.linspace(0.1, 0.9, 6) * np.pi
            bands = [
                at_height(rounded(size[0], size[1] * np.sin(t), 0.15, 0.15), size[1] / 2 * (1 - np.cos(t)))
                for t in ring
            ]
            shells = [loft(low, high, "plain", colour, 0.3) for low, high in pairwise(bands)]
            return Thing(join([*shells, faces(bands[-1], "plain", colour, 0.3)]), *size)
        body = prism(disc(radius, 12), 0, rng.uniform(0.6, 1.6) * radius, ("plain", colour * 0.8), ("plain", colour))
        return Thing(body, *size)

    return tank


def bins(rng: np.random.Generator) -> Maker:
    """Waste containers or skips."""
    length, width = (rng.uniform(1.0, 2.0), rng.uniform(0.7, 1.1)) if rng.random() < 0.5 else (3.6, 1.8)
    paint = rng.uniform(0.02, 0.5, 3)

    def one(rng: np.random.Generator) -> Thing:
        tone = paint * rng.uniform(0.8, 1.2)
        lid: Surface = ("rubble", (0.2, 0.17, 0.14)) if length > 2 and rng.random() < 0.5 else ("plain", tone * 1.3)
        return Thing(prism(rectangle(length, width), 0.05, 1.3, ("plain", tone), lid), length, width)

    return one


def outlines(rng: np.random.Generator) -> Maker:
    """Rectangles painted on the ground, as for parking bays, loading zones and games."""
    length, width, line = rng.uniform(3, 6), rng.uniform(1.4, 2.8), rng.uniform(0.08, 0.2)
    paint = pick(rng, [(0.62, 0.62, 0.6), (0.55, 0.42, 0.06), (0.5, 0.1, 0.06), (0.1, 0.2, 0.5)])
    filled = rng.random() < 0.3

    def one(rng: np.random.Generator) -> Thing:
        if filled:
            return Thing(patch(rectangle(length, width), 0.004, "plain", paint), length, width)
        sides = [(0, s * width / 2, length, line) for s in (-1, 1)] + [
            (s * length / 2, 0, line, width) for s in (-1, 1)
        ]
        parts = [patch(rectangle(a, b) + [x, y], 0.004, "plain", paint) for x, y, a, b in sides]
        return Thing(join(parts), length, width)

    return one


def bushes(rng: np.random.Generator) -> Maker:
    """Clipped bushes in rows, longer than wide: an orchard, a nursery, a vineyard."""
    length, width = rng.uniform(2, 5), rng.uniform(1.0, 2.2)
    leaf = tinted(rng, (0.06, 0.1, 0.035), 0.4)

    def bush(rng: np.random.Generator) -> Thing:
        parts = [dome(rng, (x, 0, 0.4), width / 2, width / 2, leaf, 3, 8) for x in (-length / 4, 0, length / 4)]
        return Thing(join(parts), length, width)

    return bush


# Containers have any colour, and boats any size, within a row too.
IN_ROWS: list[Callable[[np.random.Generator], Maker]] = [
    graves, tents, bales, tanks, bins, lambda _: container, lambda _: boat, outlines, bushes,
]  # fmt: skip
