"""Streets through a site: road, pavements, markings, places for parked and moving vehicles, trees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .mesh import Surface, disc, patch
from .site import Site, Span
from .things import MARKING, pick

STREET_SPACING_M = {"city": (40, 75), "suburb": (45, 75), "village": (35, 70)}


def lay_streets(site: Site) -> tuple[list[Span], list[Span]]:
    """Lay streets in both directions through the site; returns the spans of x and of y [m] between them."""
    spacing = STREET_SPACING_M.get(site.style, (60, 110))
    along, upright = _lines(site, *spacing), _lines(site, *spacing)
    rows = _gaps([(y, _street(site, y, width, False)) for y, width in along], site.reach)
    columns = _gaps([(x, _street(site, x, width, True)) for x, width in upright], site.reach)
    for x, w in upright:
        for y, h in along:
            site.lay((x - w / 2, x + w / 2), (y - h / 2, y + h / 2), 6, site.road)
    return columns, rows


def _lines(site: Site, low: float, high: float) -> list[tuple[float, float]]:
    """Centre lines and widths of parallel streets."""
    at, lines = -site.reach + site.rng.uniform(0, high), []
    while at < site.reach:
        lines.append((at, pick(site.rng, [6.0, 7.5, 9.0, 11.0, 14.0], [0.25, 0.3, 0.2, 0.15, 0.1])))
        at += site.rng.uniform(low, high) + lines[-1][1]
    return lines


@dataclass(frozen=True)
class _Street:
    """A street through the whole site, along x or (`upright`) along y. Its methods take places along it and across from
    its centre line [m]. at : y, or x, of the centre line. walk : width of its pavements."""

    site: Site
    at: float
    width: float
    upright: bool
    walk: float

    @property
    def half(self) -> float:
        return self.width / 2

    @property
    def whole(self) -> Span:
        return -self.site.reach, self.site.reach

    @property
    def paved(self) -> bool:
        return self.site.road[0].endswith("asphalt")

    def somewhere(self, apart: float) -> np.ndarray:
        """Random places along it, about one per `apart` metres."""
        rng, (low, high) = self.site.rng, self.whole
        return np.asarray(rng.uniform(low, high, rng.poisson((high - low) / apart)))

    def place(self, along: float, across: float, heading: float = 0.0) -> tuple[float, float, float]:
        """x, y and heading in street coordinates of the site."""
        if self.upright:
            return across + self.at, along, np.pi / 2 - heading
        return along, across + self.at, heading

    def lay(self, along: Span, across: Span, layer: int, surface: Surface) -> None:
        """Cover a rectangle of the street."""
        across = min(across) + self.at, max(across) + self.at
        self.site.lay(*((across, along) if self.upright else (along, across)), layer, surface)

    def pave(self) -> None:
        """Lay pavements and road, with repairs and manholes."""
        site, rng, half = self.site, self.site.rng, self.half
        if self.paved:
            pavement = pick(rng, [site.concrete, site.stones, site.ground], [0.4, 0.4, 0.2])
            self.lay(self.whole, (-half - self.walk, half + self.walk), 1, pavement)
            self.lay(self.whole, (-half - 0.15, half + 0.15), 2, ("plain", (0.4, 0.39, 0.37)))
        self.lay(self.whole, (-half, half), 3, site.road)
        for s in self.somewhere(24):
            across, size = rng.uniform(-half + 1, half - 1), rng.uniform(0.3, 3)
            tone = np.asarray(site.road[1]) * rng.uniform(0.55, 1.25)
            self.lay((s, s + size), (across - 0.4, across + 0.4 + size / 6), 5, (site.road[0], tone))
        for s in self.somewhere(60):
            x, y, _ = self.place(s, -self.width / 4)
            site.add(patch(disc(0.33), 0.005, "plain", (0.05, 0.05, 0.05)), x, y)

    def mark(self, lane: float) -> None:
        """Paint dashes along the centre line, perhaps edge lines `lane` from it, and zebra crossings."""
        rng, half = self.site.rng, self.half
        dash, gap = pick(rng, [(3.0, 4.5), (2.0, 4.0), (4.0, 8.0)])
        for s in np.arange(*self.whole, dash + gap):
            self.lay((s, s + dash), (-0.07, 0.07), 7, MARKING)
        if rng.random() < 0.4:
            for side in (-1, 1):
                self.lay(self.whole, (side * (lane - 0.1), side * (lane - 0.22)), 4, MARKING)
        for s in self.somewhere(90):
            for stripe in np.arange(-half + 0.4, half - 0.5, 1.0):
                self.lay((s - 1.6, s + 1.6), (stripe, stripe + 0.5), 7, MARKING)

    def park_along(self, side: int, pitch: float, lane: float, marked: bool) -> None:
        """Offer places for vehicles one behind the other, every `pitch` metres."""
        rng, half = self.site.rng, self.half
        for s in np.arange(-self.site.reach + rng.uniform(0, pitch), self.site.reach, pitch):
            self.site.offer(*self.place(s, side * (half - 1.05)), pitch - 0.7)
            if marked and self.width > 8 and rng.random() < 0.7:
                s += pitch / 2
                self.lay((s - 0.05, s + 0.05), (side * lane, side * half), 4, MARKING)

    def park_across(self, side: int, marked: bool) -> None:
        """Lay and offer bays for vehicles side by side."""
        half, bays = self.half, (side * self.half, side * (self.half + 5.2))
        self.lay(self.whole, bays, 2, self.site.road if self.site.rng.random() < 0.6 else self.site.stones)
        for s in np.arange(*self.whole, 2.6):
            self.site.offer(*self.place(s, side * (half + 2.6), np.pi / 2))
            if marked:
                self.lay((s + 1.25, s + 1.35), bays, 4, MARKING)

    def plant(self, side: int) -> None:
        """Plant trees along one side."""
        rng = self.site.rng
        for s in np.arange(*self.whole, rng.uniform(9, 16)):
            if rng.random() < 0.6:
                x, y, _ = self.place(s, side * (self.half + self.walk * 0.6))
                self.site.tree(x, y, rng.uniform(1.0, 2.6))


def _street(site: Site, at: float, width: float, upright: bool) -> float:
    """Build a street; returns the width that it takes with pavements and bays [m]."""
    rng = site.rng
    street = _Street(site, at, width, upright, walk=rng.uniform(1.5, 3.5))
    street.pave()
    parking = pick(rng, ["parallel", "perpendicular", "none"], [0.6, 0.15, 0.25])
    lane = street.half - 2.1 if parking == "parallel" and width > 8 else street.half
    marked = street.paved and rng.random() < 0.75
    if marked:
        street.mark(lane)
    pitch = rng.uniform(5.6, 7.0)
    for side in (-1, 1):
        if parking == "parallel":
            street.park_along(side, pitch, lane, marked)
        elif parking == "perpendicular" and rng.random() < 0.7:
            street.park_across(side, marked)
        for s in street.somewhere(45):  # traffic
            site.offer(*street.place(s, side * min(width / 4, 1.9)), 6.0)
        if rng.random() < 0.5:
            street.plant(side)
    if rng.random() < 0.3:
        site.lorry(*street.place(rng.uniform(*street.whole), rng.choice([-1, 1]) * width / 4))
    return width + 2 * max(street.walk, 5.3 if parking == "perpendicular" else 0.0) + 0.4


def _gaps(lines: Sequence[tuple[float, float]], reach: float) -> list[Span]:
    """The intervals between streets, whose centre lines and widths are `lines`."""
    edges = [-reach, *(e for at, width in lines for e in (at - width / 2, at + width / 2)), reach]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 8]
