"""Scenes in metres with exact truth: streets, lots and parcels, what stands on them, and vehicles parked between.

x east, y north, z up; the ground is z = 0 and the origin is the scene's centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from . import lookalikes, things
from .mesh import Mesh, Surface, disc, join, patch, pavement, rectangle, rounded
from .things import MARKING, Thing, pick, tinted
from .vehicle import Vehicle, choose

STYLES = ("city", "suburb", "village", "industrial", "carpark", "park", "lookalikes")
OFTEN = (0.25, 0.2, 0.17, 0.15, 0.15, 0.08, 0.0)
"""How often a scene of unnamed style has each; `lookalikes`, full of what is taken for vehicles, must be asked for."""

USES = {
    # What parcels are used for, with weights.
    "city": {"house": 2, "hall": 3, "lot": 3, "green": 1.5, "court": 0.7, "yard": 0.6, "waste": 0.5},
    "suburb": {"house": 6, "lot": 1, "green": 2, "court": 0.5, "hall": 0.5, "waste": 0.3},
    "village": {"house": 4, "waste": 2, "green": 1, "yard": 1, "field": 1, "hall": 0.5, "lot": 0.6},
    "industrial": {"hall": 4, "yard": 3, "lot": 2, "waste": 1, "green": 0.7},
    "carpark": {"lot": 5, "hall": 1.5, "green": 1.5, "court": 0.5},
    "park": {"green": 5, "water": 1.2, "court": 1.2, "playground": 1, "lot": 1.4, "field": 1},
    "lookalikes": {"panels": 4, "rows": 4, "marina": 1, "garages": 1.2, "solar_park": 1, "lot": 1.5, "yard": 0.5},
}
STREET_SPACING_M = {"city": (40, 75), "suburb": (45, 75), "village": (35, 70)}
LARGEST_PARCEL_M = {"city": 34, "suburb": 26, "village": 24}
Span = tuple[float, float]
"""From, to [m]."""


class SizeSource(Protocol):
    """Anything that draws vehicle sizes, such as `orthoscale.core.fleet.Fleet`."""

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, 3) length, width, height [m]."""


@dataclass(frozen=True)
class NormalFleet:
    """A fleet of known mean and spread; lengths and widths are correlated by 0.7. Length, width, height [m]."""

    mean: tuple[float, float, float] = (4.45, 1.79, 1.54)
    spread: tuple[float, float, float] = (0.38, 0.08, 0.13)

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, 3) length, width, height [m], drawn from within 2.5 standard deviations."""
        z = rng.standard_normal((n, 3)).clip(-2.5, 2.5)
        z[:, 1] = 0.7 * z[:, 0] + np.sqrt(1 - 0.7**2) * z[:, 1]
        return np.array(self.mean) + np.array(self.spread) * z


@dataclass(frozen=True, eq=False)
class Scene:
    """What there is to see.

    extent_m : side of the square that the scene fills [m].
    vehicles : the small vehicles, exact.
    lorries : (N, 5) footprints of lorries and buses, centre x, y, length, width [m], heading [rad].
    scenery : everything but the vehicles.
    ground : what there is where nothing lies on it.
    sun : (3,) unit vector towards it. sunlight, skylight : (3,) linear light, red green blue.
    """

    seed: int
    extent_m: float
    vehicles: tuple[Vehicle, ...]
    lorries: np.ndarray
    scenery: Mesh
    ground: Surface
    sun: np.ndarray
    sunlight: np.ndarray
    skylight: np.ndarray

    @cached_property
    def mesh(self) -> Mesh:
        """Scenery and vehicles; a vehicle's faces are owned by its index."""
        cars = [v.mesh(np.random.default_rng([self.seed, i])).owned(i) for i, v in enumerate(self.vehicles)]
        return join([self.scenery, *cars])


def make_scene(
    seed: int,
    fleet: SizeSource | None = None,
    extent_m: float = 100.0,
    n_vehicles: int = 40,
    style: str | None = None,
) -> Scene:
    """A random scene; equal arguments give equal scenes.

    fleet : draws the vehicles' sizes; None is `NormalFleet()`.
    extent_m : side of the square [m].
    n_vehicles : how many vehicles; fewer only if there is no room for them.
    style : one of `STYLES`; None draws one.
    """
    rng = np.random.default_rng(seed)
    if style is None:
        style = pick(rng, list(STYLES), list(OFTEN))
    plan = _Draft(rng, style, extent_m)
    plan.lay_out()
    vehicles = plan.park(NormalFleet() if fleet is None else fleet, n_vehicles)
    azimuth, height = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(22, 68))
    sun = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
    cloud = float(rng.uniform(0, 0.25) if rng.random() < 0.7 else rng.uniform(0.6, 1))
    sunlight = (1 - cloud) * np.array([1.15, 1.09, 0.99])
    skylight = (0.75 + 1.9 * cloud) * np.array([0.30 + 0.036 * cloud, 0.33, 0.38 - 0.03 * cloud])
    lorries = np.array(plan.lorries).reshape(-1, 5)
    return Scene(seed, extent_m, vehicles, lorries, join(plan.parts), plan.ground, sun, sunlight, skylight)


class _Draft:
    """A scene in the making.

    Streets and parcels are axis-parallel in street coordinates, which are the scene's turned by `turn` [rad]; all
    methods take street coordinates, while `parts`, `obstacles`, `slots` and `lorries` are kept in the scene's.
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

    # Placing.

    def _footprint(self, x: float, y: float, length: float, width: float, heading: float = 0.0) -> np.ndarray:
        """(5,) centre x, y, length, width, heading in the scene's coordinates."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.array([cos * x - sin * y, sin * x + cos * y, length, width, heading + self.turn])

    def _free(self, x: float, y: float, length: float, width: float, heading: float = 0.0) -> bool:
        return not overlaps(self._footprint(x, y, length, width, heading), self.obstacles).any()

    def _add(self, mesh: Mesh, x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> None:
        """Add what needs no room of its own."""
        x, y, _, _, heading = self._footprint(x, y, 0, 0, heading)
        self.parts.append(mesh.placed(x, y, heading))

    def _put(self, thing: Thing, x: float, y: float, heading: float = 0.0, if_free: bool = True) -> bool:
        """Add a thing and keep all others off its footprint; not, and False, if something is there already."""
        size = thing.length, thing.width
        if if_free and not self._free(x, y, *size, heading):
            return False
        self._add(thing.mesh, x, y, heading)
        self.obstacles = np.vstack([self.obstacles, self._footprint(x, y, *size, heading)])
        return True

    def _slot(self, x: float, y: float, heading: float, depth: float = 5.0) -> None:
        """Offer a place to a vehicle of up to `depth` m."""
        x, y, _, _, heading = self._footprint(x, y, 0, 0, heading)
        self.slots.append((x, y, heading, depth))

    def _lay(self, x: Span, y: Span, layer: int, surface: Surface) -> None:
        """Cover a rectangle of ground. Layers lie a millimetre apart."""
        if x[1] - x[0] > 0.01 and y[1] - y[0] > 0.01:
            self._add(pavement(x, y, 0.001 * layer, *surface))

    def _somewhere(self, x: Span, y: Span, margin: float) -> tuple[float, float]:
        """A random place in a parcel, `margin` from its sides or as far as it allows."""
        mx, my = min(margin, (x[1] - x[0]) / 2), min(margin, (y[1] - y[0]) / 2)
        u, v = self.rng.random(2)
        return x[0] + mx + u * (x[1] - x[0] - 2 * mx), y[0] + my + v * (y[1] - y[0] - 2 * my)

    # Streets.

    def lay_out(self) -> None:
        """Streets, then parcels between them."""
        spacing = STREET_SPACING_M.get(self.style, (60, 110))
        along, upright = self._lines(*spacing), self._lines(*spacing)
        rows = _gaps([(y, self._street(y, width, False)) for y, width in along], self.reach)
        columns = _gaps([(x, self._street(x, width, True)) for x, width in upright], self.reach)
        for x, w in upright:
            for y, h in along:
                self._lay((x - w / 2, x + w / 2), (y - h / 2, y + h / 2), 6, self.road)
        for column in columns:
            for row in rows:
                self._quarter(column, row)

    def _lines(self, low: float, high: float) -> list[tuple[float, float]]:
        """Middles and widths of parallel streets."""
        at, lines = -self.reach + self.rng.uniform(0, high), []
        while at < self.reach:
            lines.append((at, pick(self.rng, [6.0, 7.5, 9.0, 11.0, 14.0], [0.25, 0.3, 0.2, 0.15, 0.1])))
            at += self.rng.uniform(low, high) + lines[-1][1]
        return lines

    def _street(self, at: float, width: float, upright: bool) -> float:
        """A street through the whole scene, along x or (`upright`) along y.

        Returns the width that it takes with pavements and bays.
        """
        rng, reach, half = self.rng, self.reach, width / 2

        def place(along: float, across: float, heading: float = 0.0) -> tuple[float, float, float]:
            return (across + at, along, np.pi / 2 - heading) if upright else (along, across + at, heading)

        def lay(along: Span, across: Span, layer: int, surface: Surface) -> None:
            across = min(across) + at, max(across) + at
            self._lay(*((across, along) if upright else (along, across)), layer, surface)

        whole, walk = (-reach, reach), rng.uniform(1.5, 3.5)
        paved = self.road[0].endswith("asphalt")
        if paved:
            lay(
                whole,
                (-half - walk, half + walk),
                1,
                pick(rng, [self.concrete, self.stones, self.ground], [0.4, 0.4, 0.2]),
            )
            lay(whole, (-half - 0.15, half + 0.15), 2, ("plain", (0.4, 0.39, 0.37)))
        lay(whole, (-half, half), 3, self.road)
        for s in rng.uniform(*whole, rng.poisson(reach / 12)):  # repairs
            across, size = rng.uniform(-half + 1, half - 1), rng.uniform(0.3, 3)
            tone = np.asarray(self.road[1]) * rng.uniform(0.55, 1.25)
            lay((s, s + size), (across - 0.4, across + 0.4 + size / 6), 5, (self.road[0], tone))
        for s in rng.uniform(*whole, rng.poisson(reach / 30)):  # manholes
            x, y, _ = place(s, -width / 4)
            self._add(patch(disc(0.33), 0.005, "plain", (0.05, 0.05, 0.05)), x, y)
        parking = pick(rng, ["parallel", "perpendicular", "none"], [0.6, 0.15, 0.25])
        lane = half - 2.1 if parking == "parallel" and width > 8 else half
        marked = paved and rng.random() < 0.75
        if marked:
            dash, gap = pick(rng, [(3.0, 4.5), (2.0, 4.0), (4.0, 8.0)])
            for s in np.arange(*whole, dash + gap):
                lay((s, s + dash), (-0.07, 0.07), 7, MARKING)
            if rng.random() < 0.4:
                for side in (-1, 1):
                    lay(whole, (side * (lane - 0.1), side * (lane - 0.22)), 4, MARKING)
            for s in rng.uniform(*whole, rng.poisson(reach / 45)):  # zebra crossings
                for stripe in np.arange(-half + 0.4, half - 0.5, 1.0):
                    lay((s - 1.6, s + 1.6), (stripe, stripe + 0.5), 7, MARKING)
        pitch = rng.uniform(5.6, 7.0)
        for side in (-1, 1):
            if parking == "parallel":
                for s in np.arange(-reach + rng.uniform(0, pitch), reach, pitch):
                    self._slot(*place(s, side * (half - 1.05)), pitch - 0.7)
                    if marked and width > 8 and rng.random() < 0.7:
                        s += pitch / 2
                        lay((s - 0.05, s + 0.05), (side * lane, side * half), 4, MARKING)
            elif parking == "perpendicular" and rng.random() < 0.7:
                bays = side * half, side * (half + 5.2)
                lay(whole, bays, 2, self.road if rng.random() < 0.6 else self.stones)
                for s in np.arange(*whole, 2.6):
                    self._slot(*place(s, side * (half + 2.6), np.pi / 2))
                    if marked:
                        lay((s + 1.25, s + 1.35), bays, 4, MARKING)
            for s in rng.uniform(*whole, rng.poisson(2 * reach / 45)):  # traffic
                self._slot(*place(s, side * min(width / 4, 1.9)), 6.0)
            if rng.random() < 0.5:  # an avenue
                for s in np.arange(*whole, rng.uniform(9, 16)):
                    if rng.random() < 0.6:
                        x, y, _ = place(s, side * (half + walk * 0.6))
                        self._tree(x, y, rng.uniform(1.0, 2.6))
        if rng.random() < 0.3:
            self._lorry(*place(rng.uniform(*whole), rng.choice([-1, 1]) * width / 4))
        return width + 2 * max(walk, 5.3 if parking == "perpendicular" else 0.0) + 0.4

    def _quarter(self, x: Span, y: Span) -> None:
        """The land between streets, halved until parcels are small enough, each then put to some use."""
        rng, w, h = self.rng, x[1] - x[0], y[1] - y[0]
        if max(w, h) > 16 and max(w, h) > LARGEST_PARCEL_M.get(self.style, 60) * rng.uniform(0.8, 1.3):
            share = rng.uniform(0.38, 0.62)
            if w > h:
                cut = x[0] + share * w
                self._quarter((x[0], cut), y)
                self._quarter((cut, x[1]), y)
            else:
                cut = y[0] + share * h
                self._quarter(x, (y[0], cut))
                self._quarter(x, (cut, y[1]))
            return
        middle = self._footprint(sum(x) / 2, sum(y) / 2, w, h)[:2]
        # What lies outside the scene matters only as far as it throws shadows into it.
        if min(w, h) < 7 or np.abs(middle).max() > self.extent / 2 + np.hypot(w, h) / 2 + 15:
            return
        uses = USES[self.style]
        use = pick(rng, list(uses), list(uses.values()))
        getattr(self, f"_{use}")((x[0] + 0.3, x[1] - 0.3), (y[0] + 0.3, y[1] - 0.3))

    # Uses of a parcel.

    def _house(self, x: Span, y: Span) -> None:
        """A house in a garden, with a drive beside it if there is room."""
        rng = self.rng
        self._lay(x, y, 1, pick(rng, [*self.greens[:2], self.stones, self.earths[0]], [0.5, 0.2, 0.15, 0.15]))
        w = min((x[1] - x[0]) * rng.uniform(0.45, 0.7), 22)
        h = min((y[1] - y[0]) * rng.uniform(0.4, 0.7), 16)
        at = self._somewhere(x, y, max(w, h))
        at = (
            float(np.clip(at[0] + rng.normal(0, 3), x[0] + w / 2 + 0.8, x[1] - w / 2 - 0.8)),
            float(np.clip(at[1] + rng.normal(0, 3), y[0] + h / 2 + 0.8, y[1] - h / 2 - 0.8)),
        )
        self._building(*at, w, h, pick(rng, [3.0, 5.8, 8.5], [0.45, 0.4, 0.15]))
        drive = pick(rng, [self.stones, self.concrete, self.asphalt])
        for a, b in ((x[0], at[0] - w / 2), (at[0] + w / 2, x[1])):
            if b - a > 3.4:
                b = min(b, a + 3.6)
                self._lay((a + 0.3, b), (y[0], y[0] + 7), 2, drive)
                self._slot((a + b + 0.3) / 2, y[0] + 3.2, np.pi / 2, 5.5)
                self._slot((a + b + 0.3) / 2, y[0] + 9.2, np.pi / 2, 5.0)
                break
        if rng.random() < 0.25:
            self._put(things.pool(rng), *self._somewhere(x, y, 4), rng.uniform(0, 7))
        self._furnish(x, y, trees=0.008, small=0.012)

    def _hall(self, x: Span, y: Span) -> None:
        """A large building that fills its parcel."""
        rng, margin = self.rng, self.rng.uniform(1.0, 4.0)
        self._lay(x, y, 1, pick(rng, [self.concrete, self.asphalt, self.stones]))
        size = x[1] - x[0] - 2 * margin, y[1] - y[0] - 2 * margin
        if min(size) > 3:
            self._building(sum(x) / 2, sum(y) / 2, *size, rng.uniform(4, 12), flat=0.75)
        self._furnish(x, y, trees=0.002, small=0.008)

    def _lot(self, x: Span, y: Span) -> None:
        """A parking lot: double rows of bays with aisles between."""
        rng = self.rng
        surface = pick(rng, [self.asphalt, self.concrete, self.stones, self.earths[2]], [0.6, 0.15, 0.15, 0.1])
        self._lay(x, y, 1, surface)
        swapped = (x[1] - x[0] < y[1] - y[0]) if rng.random() < 0.7 else bool(rng.random() < 0.5)
        (a0, a1), (b0, b1) = (y, x) if swapped else (x, y)
        bay, marked = rng.uniform(2.35, 2.8), surface[0] != "gravel" and rng.random() < 0.85
        paint: Surface = MARKING if rng.random() < 0.85 else ("plain", (0.55, 0.42, 0.06))

        def line(along: Span, across: Span) -> None:
            if marked:
                self._lay(*((across, along) if swapped else (along, across)), 3, paint)

        row = b0 + 0.6
        while row + 5 < b1:
            rows = 2 if row + 16 < b1 or rng.random() < 0.5 else 1
            for b in [row + 5 * k for k in range(rows) if row + 5 * k + 5 < b1]:
                for a in np.arange(a0 + 1.2, a1 - bay, bay):
                    line((a - 0.05, a + 0.05), (b, b + 4.9))
                    p, q = (b + 2.5, a + bay / 2) if swapped else (a + bay / 2, b + 2.5)
                    if rng.random() > 0.02:
                        self._slot(p, q, 0.0 if swapped else np.pi / 2)
                    else:
                        self._add(patch(rounded(2, 2, 0.5, 0.5), 0.004, *self.greens[0]), p, q)
                        self._tree(p, q, rng.uniform(1.0, 1.25))
            if row + 10 < b1:
                line((a0 + 1.2, a1 - bay), (row + 4.95, row + 5.05))
            row += 10 + rng.uniform(5.5, 7.0)
        for _ in range(rng.integers(0, 4) if marked else 0):
            at, heading = self._somewhere(x, y, 3), rng.integers(4) * np.pi / 2
            self._add(patch(rectangle(2.0, 0.2), 0.004, *paint), *at, heading)
            self._add(patch(np.array([[1.0, -0.4], [1.9, 0], [1.0, 0.4]]), 0.004, *paint), *at, heading)
        self._furnish(x, y, trees=0.001, small=0.001)

    def _green(self, x: Span, y: Span) -> None:
        """Grass with trees, anything from a lawn to a wood, and perhaps a path."""
        rng = self.rng
        self._lay(x, y, 1, pick(rng, self.greens))
        if rng.random() < 0.5:
            path = rng.uniform(y[0] + 1, y[1] - 3)
            self._lay(x, (path, path + rng.uniform(1.2, 2.5)), 2, pick(rng, [self.stones, *self.earths]))
        self._furnish(x, y, trees=pick(rng, [0.004, 0.015, 0.05]), small=0.005)

    def _waste(self, x: Span, y: Span) -> None:
        """Bare ground: a building site, wasteland."""
        rng = self.rng
        self._lay(x, y, 1, pick(rng, self.earths))
        for _ in range(rng.integers(0, 5)):
            self._put(things.boulder(rng, self.earths[0][1]), *self._somewhere(x, y, 2.5), rng.uniform(0, 7))
        self._furnish(x, y, trees=0.004, small=0.02)
        for _ in range(2):
            self._slot(*self._somewhere(x, y, 3), rng.uniform(0, 2 * np.pi), 6)

    def _field(self, x: Span, y: Span) -> None:
        crop = pick(self.rng, [np.asarray(self.greens[0][1]) * 1.3, self.greens[2][1], self.earths[0][1]])
        self._lay(x, y, 1, ("field", crop))

    def _yard(self, x: Span, y: Span) -> None:
        """Containers or boats in rows, a lorry, some vehicles between."""
        rng = self.rng
        self._lay(x, y, 1, pick(rng, [self.concrete, self.asphalt, self.earths[2], self.earths[0]]))
        boats, across = rng.random() < 0.2, rng.random() < 0.5
        heading = np.pi / 2 if boats or across else 0.0
        step = (3.2, 7.5) if heading else (7.2, 3.4)
        for b in np.arange(y[0] + 4, y[1] - 3, step[1]):
            for a in np.arange(x[0] + 3.7, x[1] - 4, step[0]):
                if rng.random() < 0.5:
                    continue
                if rng.random() < 0.3 and not boats:
                    self._slot(a, b, heading, 6)
                else:
                    thing = things.boat(rng) if boats else things.container(rng)
                    self._put(thing, a, b, heading + rng.normal(0, 0.06 if boats else 0.02))
        if rng.random() < 0.6:
            self._lorry(self._somewhere(x, y, 6)[0], y[1] - 2, 0.0)
        self._furnish(x, y, trees=0.0, small=0.015)

    def _water(self, x: Span, y: Span) -> None:
        """A pond with boats on it."""
        rng, middle = self.rng, (sum(x) / 2, sum(y) / 2)
        self._lay(x, y, 1, self.greens[0])
        size = x[1] - x[0] - 3, y[1] - y[0] - 3
        tone = pick(rng, [(0.02, 0.04, 0.035), (0.05, 0.07, 0.04), (0.02, 0.04, 0.07)])
        pond = patch(rounded(*size, min(size) * 0.42, min(size) * 0.36), 0.002, "water", tone, 0.6)
        for _ in range(rng.integers(0, 4)):
            self._put(things.boat(rng), *self._somewhere(x, y, 6), rng.uniform(0, 7))
        self._put(Thing(pond, x[1] - x[0], y[1] - y[0]), *middle, if_free=False)

    def _court(self, x: Span, y: Span) -> None:
        self._lay(x, y, 1, pick(self.rng, [self.greens[0], self.asphalt, self.stones]))
        w, h = x[1] - x[0], y[1] - y[0]
        thing = things.court(self.rng, (max(w, h), min(w, h)))
        self._put(thing, sum(x) / 2, sum(y) / 2, np.pi / 2 if h > w else 0.0)

    def _playground(self, x: Span, y: Span) -> None:
        self._lay(x, y, 1, self.greens[0])
        self._lay((x[0] + 1.5, x[1] - 1.5), (y[0] + 1.5, y[1] - 1.5), 2, self.earths[1])
        for _ in range(self.rng.integers(4, 10)):
            self._put(things.play_equipment(self.rng), *self._somewhere(x, y, 2.5), self.rng.uniform(0, 7))
        self._furnish(x, y, trees=0.01, small=0.01)

    # Parcels full of what is taken for vehicles.

    def _panels(self, x: Span, y: Span) -> None:
        """A building whose flat roof is full of solar panels or machines."""
        rng, w, h = self.rng, x[1] - x[0], y[1] - y[0]
        self._lay(x, y, 1, pick(rng, [self.concrete, self.asphalt, self.stones]))
        margin = rng.uniform(1.0, 4.0)
        size = w - 2 * margin, h - 2 * margin
        if min(size) > 4:
            roof = lookalikes.crowded_roof(rng, max(size), min(size))
            self._put(roof, sum(x) / 2, sum(y) / 2, np.pi / 2 if h > w else 0.0)
        self._furnish(x, y, trees=0.002, small=0.004)

    def _solar_park(self, x: Span, y: Span) -> None:
        self._lay(x, y, 1, pick(self.rng, self.greens + self.earths))
        w, h = x[1] - x[0] - 2, y[1] - y[0] - 2
        self._put(Thing(lookalikes.panels(self.rng, w, h), w, h), sum(x) / 2, sum(y) / 2)

    def _garages(self, x: Span, y: Span) -> None:
        """Rows of garages with lanes between."""
        rng, deep, lane = self.rng, self.rng.uniform(5.2, 6.5), self.rng.uniform(5.5, 8)
        self._lay(x, y, 1, pick(rng, [self.concrete, self.asphalt, self.earths[2]]))
        for b in np.arange(y[0] + deep / 2 + 0.5, y[1] - deep / 2, deep + lane):
            self._put(lookalikes.garages(rng, x[1] - x[0] - 2, deep), sum(x) / 2, b)
            for a in rng.uniform(x[0] + 3, x[1] - 3, 2):
                self._slot(a, b + deep / 2 + lane / 2, 0.0)

    def _rows(self, x: Span, y: Span) -> None:
        """Things that are alike, in rows: graves, tents, bales, tanks, bins, containers, boats, painted outlines."""
        rng = self.rng
        self._lay(x, y, 1, pick(rng, [*self.greens, *self.earths, self.concrete, self.asphalt]))
        self._row_things(pick(rng, list(lookalikes.IN_ROWS))(rng), x, y)

    def _marina(self, x: Span, y: Span) -> None:
        """Boats side by side along piers."""
        rng, middle = self.rng, (sum(x) / 2, sum(y) / 2)
        tone = pick(rng, [(0.02, 0.04, 0.035), (0.05, 0.07, 0.04), (0.02, 0.04, 0.07)])
        self._lay(x, y, 1, ("water", tone))
        berth = rng.uniform(2.6, 4.2)
        for b in np.arange(y[0] + 9, y[1] - 8, rng.uniform(20, 26)):
            self._put(Thing(patch(rectangle(x[1] - x[0], 1.6), 0.3, "planks", (0.3, 0.24, 0.17)), x[1] - x[0], 1.6),
                      middle[0], b)  # fmt: skip
            for a in np.arange(x[0] + berth, x[1] - berth, berth):
                for side in (-1, 1):
                    if rng.random() < 0.75:
                        self._put(things.boat(rng), a, b + side * 5.2, side * np.pi / 2 + rng.normal(0, 0.05))

    def _row_things(self, make: lookalikes.Maker, x: Span, y: Span) -> None:
        """Things of one maker on a lattice over a parcel, some left out, all or none of them out of line."""
        rng, w, h = self.rng, x[1] - x[0] - 2, y[1] - y[0] - 2
        first, turned = make(rng), rng.random() < 0.5
        gaps, stray, share = rng.uniform([0.1, 0.3], [2.5, 4.0]), pick(rng, [0.0, 0.04, 0.2]), rng.uniform(0.5, 1)
        room = (h, w) if turned else (w, h)
        for a, b in lookalikes.lattice(*room, first.length, first.width, *gaps):
            if rng.random() < share:
                p, q = (b, a) if turned else (a, b)
                heading = (np.pi / 2 if turned else 0.0) + rng.normal(0, stray)
                self._put(make(rng), sum(x) / 2 + p, sum(y) / 2 + q, heading)

    # What parcels have in common.

    def _building(self, x: float, y: float, w: float, h: float, eaves: float, flat: float = 0.4) -> None:
        thing = things.building(self.rng, max(w, h), min(w, h), eaves, flat)
        self._put(thing, x, y, np.pi / 2 if h > w else 0.0)

    def _furnish(self, x: Span, y: Span, trees: float, small: float) -> None:
        """Spots of other ground, then trees and small things, both per square metre, and perhaps a hedge or fence."""
        rng, area = self.rng, (x[1] - x[0]) * (y[1] - y[0])
        for _ in range(rng.poisson(area / 250) if trees > 0.002 else 0):
            angle = np.sort(rng.uniform(0, 2 * np.pi, 11))
            plan = rng.uniform(0.5, 3.5, 2) * np.stack([np.cos(angle), np.sin(angle)], 1)
            spot = patch(plan, 0.0015, *pick(rng, [*self.greens, *self.earths]))
            self._add(spot, *self._somewhere(x, y, 3.5), rng.uniform(0, 7))
        if rng.random() < 0.25:
            self._put(things.border(rng, x[1] - x[0], self.leaf), sum(x) / 2, y[0] + 0.45)
        for _ in range(min(rng.poisson(trees * area), 40)):
            low, high = pick(rng, [(0.6, 1.6), (1.5, 3.4), (3, 6)], [0.35, 0.45, 0.2])
            radius = rng.uniform(low, high)
            if min(x[1] - x[0], y[1] - y[0]) > 2 * radius + 0.4:
                self._tree(*self._somewhere(x, y, radius), radius)
        for _ in range(min(rng.poisson(small * area), 30)):
            self._put(things.small_thing(rng), *self._somewhere(x, y, 0.8), rng.uniform(0, 2 * np.pi))

    def _tree(self, x: float, y: float, radius: float) -> None:
        if self._free(x, y, 1.3 * radius, 1.3 * radius):  # crowns may meet
            self._put(things.tree(self.rng, radius, self.leaf), x, y, if_free=False)

    def _lorry(self, x: float, y: float, heading: float) -> None:
        thing = things.lorry(self.rng)
        if self._put(thing, x, y, heading):
            self.lorries.append(self._footprint(x, y, thing.length, thing.width, heading))

    # Vehicles.

    def park(self, fleet: SizeSource, count: int) -> tuple[Vehicle, ...]:
        """Fill slots in random order, then any free ground, leaving out places where a vehicle would touch anything."""
        rng, half = self.rng, self.extent / 2 - 3.0
        slots = [s for s in self.slots if max(abs(s[0]), abs(s[1])) < half]
        anywhere = rng.uniform(-half, half, (20 * count, 2))
        headings = self.turn + np.pi / 2 * rng.integers(0, 4, len(anywhere))
        places = [slots[i] for i in rng.permutation(len(slots))]
        places += [(x, y, heading, 6.0) for (x, y), heading in zip(anywhere, headings, strict=True)]
        sizes = np.asarray(fleet.sample(rng, max(len(places), 1)), float).tolist()
        taken = self.obstacles
        vehicles: list[Vehicle] = []
        for (x, y, heading, depth), (length, width, height) in zip(places, sizes, strict=False):
            if len(vehicles) == count:
                break
            x, y, heading = np.array([x, y, heading]) + rng.normal(0, [0.12, 0.12, 0.025])
            footprint = np.array([x, y, length + 0.1, width + 0.3, heading])  # mirrors need room
            if length > depth + 0.6 or overlaps(footprint, taken).any():
                continue
            taken = np.vstack([taken, footprint])
            heading = float((heading + np.pi * rng.integers(2)) % (2 * np.pi))
            shape, paint = choose(rng, length, height)
            vehicles.append(Vehicle(float(x), float(y), heading, length, width, height, shape, paint))
        return tuple(vehicles)


def _gaps(lines: Sequence[tuple[float, float]], reach: float) -> list[Span]:
    """The intervals between streets, given as their middles and widths."""
    edges = [-reach, *(e for at, width in lines for e in (at - width / 2, at + width / 2)), reach]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 8]


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
