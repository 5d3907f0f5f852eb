"""Streets through a site: road, pavements, markings, parked and moving vehicles' places, trees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .mesh import Surface, disc, patch
from .site import Site, Span
from .things import MARKING, pick

STREET_SPACING_M = {"city": (40, 75), "suburb": (45, 75), "village": (35, 70)}


def lay_streets(site: Site) -> tuple[list[Span], list[Span]]:
    """Streets both ways through the site; the spans of x and of y [m] that they leave between them."""
    spacing = STREET_SPACING_M.get(site.style, (60, 110))
    along, upright = _lines(site, *spacing), _lines(site, *spacing)
    rows = _gaps([(y, _street(site, y, width, False)) for y, width in along], site.reach)
    columns = _gaps([(x, _street(site, x, width, True)) for x, width in upright], site.reach)
    for x, w in upright:
        for y, h in along:
            site.lay((x - w / 2, x + w / 2), (y - h / 2, y + h / 2), 6, site.road)
    return columns, rows


def _lines(site: Site, low: float, high: float) -> list[tuple[float, float]]:
    """Middles and widths of parallel streets."""
    at, lines = -site.reach + site.rng.uniform(0, high), []
    while at < site.reach:
        lines.append((at, pick(site.rng, [6.0, 7.5, 9.0, 11.0, 14.0], [0.25, 0.3, 0.2, 0.15, 0.1])))
        at += site.rng.uniform(low, high) + lines[-1][1]
    return lines


def _street(site: Site, at: float, width: float, upright: bool) -> float:
    """A street through the whole scene, along x or (`upright`) along y.

    Returns the width that it takes with pavements and bays.
    """
    rng, reach, half = site.rng, site.reach, width / 2

    def place(along: float, across: float, heading: float = 0.0) -> tuple[float, float, float]:
        return (across + at, along, np.pi / 2 - heading) if upright else (along, across + at, heading)

    def lay(along: Span, across: Span, layer: int, surface: Surface) -> None:
        across = min(across) + at, max(across) + at
        site.lay(*((across, along) if upright else (along, across)), layer, surface)

    whole, walk = (-reach, reach), rng.uniform(1.5, 3.5)
    paved = site.road[0].endswith("asphalt")
    if paved:
        lay(
            whole,
            (-half - walk, half + walk),
            1,
            pick(rng, [site.concrete, site.stones, site.ground], [0.4, 0.4, 0.2]),
        )
        lay(whole, (-half - 0.15, half + 0.15), 2, ("plain", (0.4, 0.39, 0.37)))
    lay(whole, (-half, half), 3, site.road)
    for s in rng.uniform(*whole, rng.poisson(reach / 12)):  # repairs
        across, size = rng.uniform(-half + 1, half - 1), rng.uniform(0.3, 3)
        tone = np.asarray(site.road[1]) * rng.uniform(0.55, 1.25)
        lay((s, s + size), (across - 0.4, across + 0.4 + size / 6), 5, (site.road[0], tone))
    for s in rng.uniform(*whole, rng.poisson(reach / 30)):  # manholes
        x, y, _ = place(s, -width / 4)
        site.add(patch(disc(0.33), 0.005, "plain", (0.05, 0.05, 0.05)), x, y)
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
                site.offer(*place(s, side * (half - 1.05)), pitch - 0.7)
                if marked and width > 8 and rng.random() < 0.7:
                    s += pitch / 2
                    lay((s - 0.05, s + 0.05), (side * lane, side * half), 4, MARKING)
        elif parking == "perpendicular" and rng.random() < 0.7:
            bays = side * half, side * (half + 5.2)
            lay(whole, bays, 2, site.road if rng.random() < 0.6 else site.stones)
            for s in np.arange(*whole, 2.6):
                site.offer(*place(s, side * (half + 2.6), np.pi / 2))
                if marked:
                    lay((s + 1.25, s + 1.35), bays, 4, MARKING)
        for s in rng.uniform(*whole, rng.poisson(2 * reach / 45)):  # traffic
            site.offer(*place(s, side * min(width / 4, 1.9)), 6.0)
        if rng.random() < 0.5:  # an avenue
            for s in np.arange(*whole, rng.uniform(9, 16)):
                if rng.random() < 0.6:
                    x, y, _ = place(s, side * (half + walk * 0.6))
                    site.tree(x, y, rng.uniform(1.0, 2.6))
    if rng.random() < 0.3:
        site.lorry(*place(rng.uniform(*whole), rng.choice([-1, 1]) * width / 4))
    return width + 2 * max(walk, 5.3 if parking == "perpendicular" else 0.0) + 0.4


def _gaps(lines: Sequence[tuple[float, float]], reach: float) -> list[Span]:
    """The intervals between streets, given as their middles and widths."""
    edges = [-reach, *(e for at, width in lines for e in (at - width / 2, at + width / 2)), reach]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 8]
