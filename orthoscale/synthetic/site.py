"""The site on which a scene is built: what lies and stands where, and the local materials."""

from __future__ import annotations

import numpy as np

from . import things
from .mesh import Mesh, Surface, pavement
from .things import Thing, pick, tinted

Span = tuple[float, float]
"""From, to [m]."""


class Site:
    """A scene under construction.

    Streets and parcels are axis-parallel in street coordinates, which are the scene's rotated by `turn` [rad]; all
    methods take street coordinates, while `parts`, `obstacles`, `slots` and `lorries` are kept in the scene's.

    rng : used for all random choices. style : see `scene.STYLES`. extent : side of the scene's square [m].
    """

    def __init__(self, rng: np.random.Generator, style: str, extent: float) -> None:
        self.rng, self.style, self.extent = rng, style, extent
        self.parts: list[Mesh] = []
        self.obstacles = np.empty((0, 5))
        self.slots: list[tuple[float, float, float, float]] = []
        self.lorries: list[np.ndarray] = []
        self.turn = rng.uniform(0, 2 * np.pi)
        self.reach = extent / np.sqrt(2) + 12
        green = tinted(rng, (0.11, 0.14, 0.06), 0.4)
        dry = tinted(rng, (0.26, 0.23, 0.12), 0.3, 0)
        earth = tinted(rng, (0.30, 0.22, 0.14), 0.5, 0.1)
        self.greens: list[Surface] = [("grass", green), ("dry_grass", (green + dry) / 2), ("dry_grass", dry)]
        self.earths: list[Surface] = [("soil", earth), ("sand", earth * 1.2 + 0.05), ("gravel", earth * 0.6 + 0.12)]
        tar = np.array([1.0, 0.98, 0.95]) * rng.uniform(0.05, 0.2)
        self.asphalt: Surface = (pick(rng, ["asphalt", "worn_asphalt"]), tar)
        self.concrete: Surface = ("concrete", tinted(rng, (0.38, 0.36, 0.32), 0.3, 0.02))
        self.stones: Surface = ("paving", tinted(rng, (0.28, 0.26, 0.245), 0.35, 0.05))
        self.leaf = tinted(rng, (0.068, 0.105, 0.037), 0.45, 0.05)
        dusty = style == "village"
        self.ground: Surface = pick(rng, self.earths) if dusty else pick(rng, self.greens, [0.6, 0.25, 0.15])
        self.road: Surface = pick(rng, self.earths[::2]) if dusty and rng.random() < 0.35 else self.asphalt

    def footprint(self, x: float, y: float, length: float, width: float, heading: float = 0.0) -> np.ndarray:
        """(5,) centre x, y, length, width, heading in the scene's coordinates."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.array([cos * x - sin * y, sin * x + cos * y, length, width, heading + self.turn])

    def is_free(self, x: float, y: float, length: float, width: float, heading: float = 0.0) -> bool:
        """Whether the rectangle touches no obstacle."""
        return not overlaps(self.footprint(x, y, length, width, heading), self.obstacles).any()

    def add(self, mesh: Mesh, x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> None:
        """Add a mesh that is no obstacle to others."""
        x, y, _, _, heading = self.footprint(x, y, 0, 0, heading)
        self.parts.append(mesh.placed(x, y, heading))

    def put(self, thing: Thing, x: float, y: float, heading: float = 0.0, if_free: bool = True) -> bool:
        """Add a thing, whose footprint becomes an obstacle; returns False and adds nothing if the place is taken."""
        size = thing.length, thing.width
        if if_free and not self.is_free(x, y, *size, heading):
            return False
        self.add(thing.mesh, x, y, heading)
        self.obstacles = np.vstack([self.obstacles, self.footprint(x, y, *size, heading)])
        return True

    def offer(self, x: float, y: float, heading: float, depth: float = 5.0) -> None:
        """Offer a place to a vehicle of up to `depth` m."""
        x, y, _, _, heading = self.footprint(x, y, 0, 0, heading)
        self.slots.append((x, y, heading, depth))

    def lay(self, x: Span, y: Span, layer: int, surface: Surface) -> None:
        """Cover a rectangle of ground. Layers lie a millimetre apart."""
        if x[1] - x[0] > 0.01 and y[1] - y[0] > 0.01:
            self.add(pavement(x, y, 0.001 * layer, *surface))

    def somewhere(self, x: Span, y: Span, margin: float) -> tuple[float, float]:
        """A random place in a parcel, `margin` from its sides or as far as its size allows."""
        mx, my = min(margin, (x[1] - x[0]) / 2), min(margin, (y[1] - y[0]) / 2)
        u, v = self.rng.random(2)
        return x[0] + mx + u * (x[1] - x[0] - 2 * mx), y[0] + my + v * (y[1] - y[0] - 2 * my)

    def tree(self, x: float, y: float, radius: float) -> None:
        """Add a tree, if there is room for its trunk."""
        if self.is_free(x, y, 1.3 * radius, 1.3 * radius):  # crowns may meet
            self.put(things.tree(self.rng, radius, self.leaf), x, y, if_free=False)

    def lorry(self, x: float, y: float, heading: float) -> None:
        """Add a lorry or bus, if there is room."""
        thing = things.lorry(self.rng)
        if self.put(thing, x, y, heading):
            self.lorries.append(self.footprint(x, y, thing.length, thing.width, heading))


def overlaps(one: np.ndarray, many: np.ndarray) -> np.ndarray:
    """(N,) bool: whether the rectangle (5,) centre x, y, length, width, heading touches each of `many` (N, 5).

    Two rectangles are apart if a side of one of them separates them.
    """
    shift, turn = many[:, :2] - one[:2], many[:, 4] - one[4]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    a, b = np.broadcast_to(one[2:4] / 2, shift.shape), many[:, 2:4] / 2
    apart = np.zeros(len(many), bool)
    for heading, mine, other in ((one[4], a, b), (many[:, 4], b, a)):
        u = np.abs(shift[:, 0] * np.cos(heading) + shift[:, 1] * np.sin(heading))
        v = np.abs(shift[:, 1] * np.cos(heading) - shift[:, 0] * np.sin(heading))
        apart |= u > mine[:, 0] + other[:, 0] * cos + other[:, 1] * sin
        apart |= v > mine[:, 1] + other[:, 0] * sin + other[:, 1] * cos
    return ~apart
