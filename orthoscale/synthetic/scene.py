"""Scenes in metres with exact truth: streets, lots and parcels, what stands on them, and vehicles parked between.

x east, y north, z up; the ground is z = 0 and the origin is the scene's centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Protocol

import numpy as np

from .mesh import Mesh, Surface, join
from .parcels import divide
from .site import Site, overlaps
from .streets import lay_streets
from .things import pick
from .vehicle import Vehicle, choose

STYLES = ("city", "suburb", "village", "industrial", "carpark", "park", "lookalikes")
OFTEN = (0.25, 0.2, 0.17, 0.15, 0.15, 0.08, 0.0)
"""How often a scene of unnamed style has each; `lookalikes`, full of what is taken for vehicles, must be asked for."""


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
    """A scene's content and light.

    extent_m : side of the square that the scene fills [m].
    vehicles : the small vehicles, exact.
    lorries : (N, 5) footprints of lorries and buses, centre x, y, length, width [m], heading [rad].
    scenery : everything but the vehicles.
    ground : its surface where nothing else lies.
    sun : (3,) unit vector towards the sun. sunlight, skylight : (3,) linear light, red green blue.
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
    site = Site(rng, style, extent_m)
    columns, rows = lay_streets(site)
    for column, row in product(columns, rows):
        divide(site, column, row)
    vehicles = _parked(site, NormalFleet() if fleet is None else fleet, n_vehicles)
    azimuth, height = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(22, 68))
    sun = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
    cloud = float(rng.uniform(0, 0.25) if rng.random() < 0.7 else rng.uniform(0.6, 1))
    sunlight = (1 - cloud) * np.array([1.15, 1.09, 0.99])
    skylight = (0.75 + 1.9 * cloud) * np.array([0.30 + 0.036 * cloud, 0.33, 0.38 - 0.03 * cloud])
    lorries = np.array(site.lorries).reshape(-1, 5)
    return Scene(seed, extent_m, vehicles, lorries, join(site.parts), site.ground, sun, sunlight, skylight)


def _parked(site: Site, fleet: SizeSource, count: int) -> tuple[Vehicle, ...]:
    """Park vehicles on slots in random order, then on any free ground, except where one would touch anything."""
    rng, half = site.rng, site.extent / 2 - 3.0
    slots = [s for s in site.slots if max(abs(s[0]), abs(s[1])) < half]
    anywhere = rng.uniform(-half, half, (20 * count, 2))
    headings = site.turn + np.pi / 2 * rng.integers(0, 4, len(anywhere))
    places = [slots[i] for i in rng.permutation(len(slots))]
    places += [(x, y, heading, 6.0) for (x, y), heading in zip(anywhere, headings, strict=True)]
    sizes = np.asarray(fleet.sample(rng, max(len(places), 1)), float).tolist()
    taken = site.obstacles
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
