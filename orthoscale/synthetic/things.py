"""Objects of a scene besides vehicles, many of them chosen because detectors mistake them for vehicles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .mesh import (
    Colour,
    Mesh,
    Surface,
    at_height,
    disc,
    dome,
    faces,
    gable,
    hip,
    join,
    loft,
    patch,
    prism,
    rectangle,
    rounded,
)
from .vehicle import GLASS, RUBBER

PANEL = (0.02, 0.03, 0.06)
"""Solar panels."""


@dataclass(frozen=True)
class Thing:
    """An object at the origin that occupies a rectangle of `length` (along x) by `width` [m]."""

    mesh: Mesh
    length: float
    width: float


def grey(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """(3,) a neutral colour between two albedos."""
    return np.ones(3) * rng.uniform(low, high)


def tinted(rng: np.random.Generator, colour: Colour, tone: float = 0.35, hue: float = 0.12) -> np.ndarray:
    """(3,) a colour lighter or darker by up to the share `tone`, each channel changed by up to the share `hue`."""
    return np.asarray(colour, float) * rng.uniform(1 - tone, 1 + tone) * rng.uniform(1 - hue, 1 + hue, 3)


def pick(rng: np.random.Generator, options: list, weights: list[float] | None = None):
    """One of `options`, whatever they are."""
    share = None if weights is None else np.array(weights) / sum(weights)
    return options[rng.choice(len(options), p=share)]


# Buildings.


def building(rng: np.random.Generator, length: float, width: float, eaves: float, flat: float = 0.4) -> Thing:
    """A building; `flat` is the probability of a flat roof."""
    kind = pick(rng, ["facade", "plaster", "corrugated"], [0.6, 0.25, 0.15])
    walls = (kind, tinted(rng, (0.45, 0.41, 0.36), 0.5))
    if rng.random() > flat and width > 4:
        mesh = _pitched(rng, length, width, eaves, walls)
    else:
        mesh = _flat(rng, length, width, eaves, walls)
    return Thing(mesh, length + 0.8, width + 0.8)


def _metal(rng: np.random.Generator) -> np.ndarray:
    coat = pick(rng, [(0.06, 0.13, 0.3), (0.3, 0.06, 0.04), (0.05, 0.2, 0.12), (0.35, 0.33, 0.3)])
    return grey(rng, 0.2, 0.56) if rng.random() < 0.55 else tinted(rng, coat)


def _pitched(rng: np.random.Generator, length: float, width: float, eaves: float, walls: Surface) -> Mesh:
    brick, slate, metal = tinted(rng, (0.34, 0.13, 0.075)), tinted(rng, (0.09, 0.095, 0.105), 0.4), _metal(rng)
    coverings: list[Surface] = [("tiles", brick), ("tiles", slate), ("corrugated", metal), ("seam", metal)]
    coverings.append(("bitumen", slate))
    shape = gable if rng.random() < 0.65 else hip
    rise = rng.uniform(0.3, 0.9)
    ridge = eaves + width / 2 * rise
    parts = [shape(length, width, eaves, ridge, walls, pick(rng, coverings, [0.42, 0.2, 0.2, 0.1, 0.08]))]

    def on_slope(x0: float, x1: float, y0: float, y1: float, lift: float) -> np.ndarray:
        """A rectangle (4, 3) that lies on the southern slope."""
        plan = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        return at_height(plan, eaves + (plan[:, 1] + width / 2) * rise + lift)

    if rng.random() < 0.6:  # a chimney
        stack = rectangle(*rng.uniform(0.5, 1.2, 2)) + rng.uniform(-1, 1, 2) * [0.3 * length, 0.15 * width]
        parts.append(prism(stack, eaves, ridge + 0.6, ("plaster", brick), ("plain", slate)))
    if rng.random() < 0.25:
        reach = rng.uniform(0.15, 0.35) * length
        parts.append(faces(on_slope(-reach, reach, -0.42 * width, -0.12 * width, 0.12), "solar", PANEL, 0.5))
    elif rng.random() < 0.3:  # skylights
        for x in rng.uniform(-0.35, 0.3, rng.integers(1, 5)) * length:
            y = -0.32 * width
            parts.append(faces(on_slope(x, x + 0.8, y, y + 0.9, 0.06), "paint", GLASS, 1.0))
    return join(parts)


def _flat(rng: np.random.Generator, length: float, width: float, eaves: float, walls: Surface) -> Mesh:
    metal = _metal(rng)
    coverings: list[Surface] = [
        ("bitumen", grey(rng, 0.06, 0.24)),
        ("roof_gravel", tinted(rng, (0.3, 0.29, 0.27), hue=0.0)),
        ("corrugated", metal),
        ("concrete", tinted(rng, (0.38, 0.36, 0.32))),
        ("plaster", grey(rng, 0.45, 0.78)),
        ("seam", metal),
        ("tiles", (0.3, 0.2, 0.15)),
    ]
    covering = pick(rng, coverings, [0.25, 0.2, 0.2, 0.12, 0.12, 0.06, 0.05])
    parts = [prism(rectangle(length, width), 0, eaves, walls, covering)]
    if rng.random() < 0.7:  # a parapet
        rim: Surface = ("plain", np.asarray(walls[1]) * rng.uniform(0.8, 1.3))
        for side in (-1, 1):
            parts.append(prism(rectangle(length, 0.3) + [0, side * (width / 2 - 0.15)], eaves, eaves + 0.5, rim))
            parts.append(prism(rectangle(0.3, width) + [side * (length / 2 - 0.15), 0], eaves, eaves + 0.5, rim))
    for _ in range(rng.poisson(min(length * width / 45, 14))):
        place = rng.uniform(-0.42, 0.42, 2) * [length, width]
        parts.append(_on_roof(rng).placed(place[0], place[1], z=eaves))
    return join(parts)


def _on_roof(rng: np.random.Generator) -> Mesh:
    """A machine (some as large as a car, on purpose), a skylight, a rack of solar panels or a water tank."""
    kind = pick(rng, ["machine", "skylight", "panels", "tank"], [0.4, 0.2, 0.2, 0.2])
    if kind == "machine":
        size, high, tone = rng.uniform(0.7, 2.4, 2), rng.uniform(0.4, 1.8), grey(rng, 0.17, 0.7)
        size[0] *= 1.0 if rng.random() < 0.7 else 1.9
        fan = patch(disc(0.35 * size.min()), high + 0.02, "plain", tone * 0.3)
        return join([prism(rectangle(*size), 0, high, ("plain", tone)), fan])
    if kind == "skylight":
        return prism(
            rectangle(*rng.uniform(0.8, 2.2, 2)), 0, 0.3, ("plain", (0.5,) * 3), ("paint", (0.45, 0.5, 0.55)), 0.4
        )
    if kind == "panels":
        plan = rectangle(rng.integers(1, 5) * 1.0, rng.integers(1, 3) * 1.7)
        return faces(at_height(plan, 0.2 + 0.25 * (plan[:, 1] - plan[:, 1].min())), "solar", PANEL, 0.6)
    tone = np.array(pick(rng, [(0.02, 0.02, 0.02), (0.1, 0.25, 0.5), (0.5, 0.5, 0.5)]))
    return prism(disc(rng.uniform(0.4, 0.9)), 0, 1.5, ("plain", tone), ("plain", tone * 1.1))


# Plants.


def tree(rng: np.random.Generator, radius: float, leaf: np.ndarray) -> Thing:
    """A bush (radius below 1.2 m), a conifer, or a trunk with irregular boughs; leaves vary about the colour `leaf`."""
    tone = leaf * rng.uniform(0.6, 1.5) * rng.uniform([0.85, 0.9, 0.8], [1.4, 1.05, 1.2])
    if rng.random() < 0.04:
        tone = np.array(pick(rng, [(0.3, 0.18, 0.03), (0.25, 0.07, 0.03), (0.16, 0.03, 0.05)]))
    tall = radius * rng.uniform(1.6, 2.6)
    if radius < 1.2:
        parts = [dome(rng, (0, 0, 0.3 * radius), radius * 0.85, radius * rng.uniform(0.7, 1.2), tone, 3, 8)]
    elif rng.random() < 0.15:
        girth = radius * 0.8 * (1 - np.arange(5) / 5.5)
        heights = np.linspace(0.5, tall * 1.5, 5)
        parts = [dome(rng, (0, 0, z), r, r, tone * 0.6, 3, 9, 0.2) for z, r in zip(heights, girth, strict=True)]
    else:
        parts = [prism(disc(0.12 * min(radius, 2), 6), 0, 0.6 * tall, ("planks", (0.1, 0.07, 0.05)))]
        for k in range(rng.integers(6, 11)):
            bough = radius * rng.uniform(0.4, 0.62)
            angle, out = k * 2.4 + rng.uniform(0, 0.8), (radius - bough) * np.sqrt(rng.uniform(0.1, 1)) * (k > 0)
            z = max(tall - 0.55 * bough - 0.6 * tall * (out / radius) ** 2 * rng.uniform(0.6, 1.6), 0.8 * bough)
            shade = tone * rng.uniform(0.75, 1.15)
            parts.append(
                dome(rng, (out * np.cos(angle), out * np.sin(angle), z), bough, 0.85 * bough, shade, ragged=0.2)
            )
    return Thing(join(parts), 2 * radius, 2 * radius)


def boulder(rng: np.random.Generator, colour: Colour) -> Thing:
    """A heap of earth or rubble."""
    r = rng.uniform(0.8, 2.5)
    return Thing(dome(rng, (0, 0, 0), r, 0.5 * r, tinted(rng, colour, 0.25, 0), material="rubble"), 2.4 * r, 2.4 * r)


def border(rng: np.random.Generator, length: float, leaf: np.ndarray) -> Thing:
    """A hedge, a wall or a fence along x."""
    hedge: Surface = ("leaves", leaf * rng.uniform(0.7, 1.2))
    kinds = [(hedge, 1.4, 0.9), (("plaster", (0.45, 0.43, 0.4)), 1.8, 0.25), (("planks", (0.2, 0.14, 0.09)), 1.6, 0.12)]
    surface, tall, thick = pick(rng, kinds)
    return Thing(prism(rectangle(length, thick), 0, tall, surface), length, thick)


# Things about the size of vehicles.


def container(rng: np.random.Generator) -> Thing:
    """One 20-foot ISO container, or two on top of each other."""
    paints = [(0.05, 0.12, 0.3), (0.35, 0.08, 0.04), (0.4, 0.22, 0.04), (0.06, 0.2, 0.1), (0.5, 0.5, 0.5)]
    steel: Surface = ("corrugated", np.array(pick(rng, paints)) * rng.uniform(0.6, 1.2))
    return Thing(prism(rectangle(6.058, 2.438), 0.1, 2.6 * rng.integers(1, 3), steel), 6.3, 2.7)


def boat(rng: np.random.Generator) -> Thing:
    """A boat of 4 to 8 m, some with a cabin."""
    length = rng.uniform(4, 8)
    width = 0.36 * length
    bow = np.array([[-0.5, -0.4], [0.1, -0.5], [0.35, -0.3], [0.5, 0], [0.35, 0.3], [0.1, 0.5], [-0.5, 0.4]])
    plan, white = bow * [length, width], grey(rng, 0.4, 0.75)
    deck: Surface = ("planks", (0.3, 0.2, 0.12)) if rng.random() < 0.5 else ("plain", rng.uniform(0.05, 0.5, 3))
    parts = [
        prism(plan, 0.2, 1.1, ("plain", white), gloss=0.2),
        patch(plan * 0.75 - [0.06 * length, 0], 1.11, *deck),
    ]
    if rng.random() < 0.5:
        parts.append(prism(rectangle(0.25 * length, 0.6 * width), 1.1, 2.0, ("paint", GLASS), ("plain", white)))
    return Thing(join(parts), length, width)


def lorry(rng: np.random.Generator) -> Thing:
    """A bus or a lorry, heading +x: larger than the vehicles that are measured."""
    paints = [(0.7, 0.7, 0.7), (0.1, 0.2, 0.45), (0.45, 0.05, 0.04), (0.5, 0.42, 0.08), (0.1, 0.3, 0.12)]
    paint: Surface = ("paint", pick(rng, paints))
    if rng.random() < 0.45:
        length, width, height = rng.uniform(9, 12.5), 2.5, 3.1
        plan = rounded(length, width, 0.3, 0.2)
        parts = [
            loft(at_height(plan, 0.3), at_height(plan, 1.2), *paint, 0.4),
            loft(at_height(plan, 1.2), at_height(plan, 2.5), "paint", GLASS, 0.8),
            prism(plan, 2.5, height, paint, gloss=0.3),
        ]
        for x in rng.uniform(-0.4, 0.4, 3) * length:
            unit = rectangle(rng.uniform(0.8, 2.2), rng.uniform(0.8, 1.6)) + [x, 0]
            parts.append(prism(unit, height, height + 0.2, paint, ("plain", (0.5, 0.5, 0.5))))
        return Thing(join(parts), length, width)
    length, width, cab = rng.uniform(6.5, 11), 2.45, 2.0
    bed = rectangle(length - cab - 0.3, width) + [-(cab + 0.3) / 2, 0]
    front = rounded(cab, width - 0.1, 0.2, 0.05) + [(length - cab) / 2, 0]
    if rng.random() < 0.4:  # a tipper with a visible load
        load: Surface = ("rubble", (0.25, 0.19, 0.12))
        height, sides = rng.uniform(1.6, 2.0), paint
    else:
        load = ("corrugated", grey(rng, 0.3, 0.75))
        height, sides = rng.uniform(2.6, 3.6), ("paint", load[1])
    parts = [
        prism(bed, 0.6, height, sides),
        patch(bed * [1, 0.92], height + 0.01, *load),
        prism(front, 0.4, 1.7, paint, gloss=0.5),
        prism(front * [1, 0.96], 1.7, 2.3, ("paint", GLASS), paint, 0.7),
    ]
    return Thing(join(parts), length, width)


# Small things.


def _bench(rng: np.random.Generator) -> Thing:
    return Thing(prism(rectangle(1.6, 0.5), 0.1, 0.5, ("planks", (0.22, 0.13, 0.08))), 1.6, 0.5)


def _bin(rng: np.random.Generator) -> Thing:
    size = pick(rng, [0.7, 1.3, 2.2]), pick(rng, [0.7, 1.0, 1.4])
    tone = _tone(rng)
    return Thing(prism(rectangle(*size), 0.05, 1.2, ("plain", tone), ("plain", tone * 1.2)), *size)


def _tarpaulin(rng: np.random.Generator) -> Thing:
    size = rng.uniform(1.2, 5, 2)
    tone = pick(rng, [(0.05, 0.15, 0.45), (0.1, 0.25, 0.1), (0.6, 0.6, 0.6), (0.5, 0.2, 0.03)])
    return Thing(patch(rectangle(*size), 0.02, "plain", tone), *size)


def _shed(rng: np.random.Generator) -> Thing:
    width, length = np.sort(rng.uniform(1.8, 3.4, 2))
    wood, tin = ("planks", (0.25, 0.18, 0.12)), ("corrugated", grey(rng, 0.17, 0.52))
    return Thing(gable(length, width, 1.9, rng.uniform(2.1, 2.7), wood, tin, 0.15), length, width)


def _motorbikes(rng: np.random.Generator) -> Thing:
    count, seat = rng.integers(1, 6), ("paint", RUBBER)
    parts = []
    for y in 0.8 * (np.arange(count) - (count - 1) / 2):
        body: Surface = ("paint", _tone(rng) * 0.5)
        parts.append(prism(rounded(1.9, 0.3, 0.1, 0.1) + [0, y], 0.2, 0.8, body, seat, 0.3))
        parts.append(prism(rectangle(0.12, 0.7) + [0.6, y], 0.9, 1.0, body, seat, 0.3))
    return Thing(join(parts), 2.0, 0.8 * count)


def _person(rng: np.random.Generator) -> Thing:
    clothes, hair = ("plain", _tone(rng)), ("plain", (0.03, 0.02, 0.02))
    body = prism(rounded(0.3, 0.5, 0.1, 0.1), 0.0, 1.4, clothes)
    return Thing(
        join([body, prism(rounded(0.22, 0.2, 0.08, 0.08), 1.4, 1.72, ("plain", (0.1, 0.06, 0.04)), hair)]), 0.5, 0.5
    )


def pool(rng: np.random.Generator) -> Thing:
    """A swimming pool with its paved edge, from a garden's 3 x 2 m to 6.5 x 3.5 m."""
    length, width = rng.uniform([3, 2], [6.5, 3.5])
    edge = patch(rounded(length + 0.8, width + 0.8, 0.6, 0.6), 0.003, "plaster", (0.5, 0.48, 0.45))
    water = patch(rounded(length, width, 0.5, 0.5), 0.005, "water", (0.08, 0.35, 0.45), 0.5)
    return Thing(join([edge, water]), length + 0.8, width + 0.8)


def _stack(rng: np.random.Generator) -> Thing:
    size = rng.uniform(0.8, 3.5, 2)
    return Thing(prism(rectangle(*size), 0, rng.uniform(0.3, 1.4), ("planks", (0.32, 0.24, 0.14))), *size)


def _parasol(rng: np.random.Generator) -> Thing:
    rim = at_height(disc(1.5, 8), 2.3)
    corners = np.stack([rim, np.roll(rim, -1, 0), np.broadcast_to([0, 0, 2.9], rim.shape)], 1)
    return Thing(faces(corners, "plain", _tone(rng) + 0.1), 3.0, 3.0)


def _trailer(rng: np.random.Generator) -> Thing:
    length = rng.uniform(2, 3.5)
    return Thing(
        prism(rectangle(length, 1.5), 0.4, 0.85, ("paint", _tone(rng)), ("planks", (0.15, 0.12, 0.1))), length, 1.5
    )


def _tone(rng: np.random.Generator) -> np.ndarray:
    """(3,) any colour, mostly dull."""
    tone = rng.uniform(0.02, 0.5, 3)
    return tone.mean() + rng.uniform(0.2, 1) * (tone - tone.mean())


SMALL_THINGS: list[Callable[[np.random.Generator], Thing]] = [
    _bench, _bin, _tarpaulin, _shed, _motorbikes, _person, _stack, _parasol, _trailer,
]  # fmt: skip


def play_equipment(rng: np.random.Generator) -> Thing:
    """A bright box on a playground."""
    size, low = rng.uniform(0.4, 3.2, 2), rng.uniform(0, 1.2)
    return Thing(prism(rectangle(*size), low, low + rng.uniform(0.3, 1.5), ("plain", rng.uniform(0.02, 0.6, 3))), *size)


def court(rng: np.random.Generator, room: tuple[float, float]) -> Thing:
    """A basketball court (28 x 15 m) or a tennis court (23.77 x 10.97 m) if `room` allows, else a painted pitch."""
    kinds = [(28.0, 15.0, "basketball"), (23.77, 10.97, "tennis"), (room[0] * 0.75, room[1] * 0.75, "pitch")]
    length, width, kind = next(k for k in kinds if (k[0] + 3 < room[0] and k[1] + 3 < room[1]) or k[2] == "pitch")
    tone = np.array(pick(rng, [(0.05, 0.14, 0.07), (0.05, 0.1, 0.25), (0.32, 0.09, 0.05), (0.2, 0.2, 0.2)]))
    outer = tone[[1, 0, 2]] if rng.random() < 0.4 else tone
    parts = [
        patch(rectangle(length + 2.4, width + 2.4), 0.002, "plaster", outer),
        patch(rectangle(length, width), 0.003, "plaster", tone),
    ]
    x, y, t = length / 2, width / 2, 0.08
    lines: list[tuple[float, ...]] = [(0, 0, t, width)]  # centre x, y, length, width [m]
    for side in (-1, 1):
        lines += [(0, side * y, length, t), (side * x, 0, t, width)]
        if kind == "tennis":
            lines += [(0, side * (y - 1.37), length, t), (side * 6.4, 0, t, width - 2.74), (side * 3.2, 0, 6.4, t)]
        elif kind == "basketball":
            lines += [(side * (x - 5.8), 0, t, 4.9)] + [(side * (x - 2.9), q * 2.45, 5.8, t) for q in (-1, 1)]
    parts += [patch(rectangle(along, across) + [a, b], 0.004, *MARKING) for a, b, along, across in lines]
    return Thing(join(parts), length, width)


MARKING: Surface = ("plain", (0.62, 0.62, 0.6))
"""White road paint."""
