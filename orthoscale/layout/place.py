"""Where facilities go: inside the lot, clear of each other, north to south if possible. Pure geometry, in metres.

Where may the centre of a rectangle be so that it lies inside a free area? In the area minus the Minkowski sum of its
boundary with the rectangle. For straight edges that sum is a union of convex hulls, so the answer is an exact polygon,
and its corners are the tightest places. Facilities are placed one after the other, the largest first, each as far as
possible towards one corner of the lot; the best of several attempts with different corners is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from ..core.angles import quarter_turn, unit_vector
from .catalogue import Facility

# [deg] from north within which a facility counts as lying north to south. The ITF's Facilities Guide (2020) asks for
# "generally north-south", or 25 degrees off it where latitude and season require; this limit is our choice.
TOLERANCE = 20.0
STEP, COARSE_STEP = 5.0, 15.0  # [deg] between directions that are tried: for placing, and for computing what is missing
SLACK = 1e-3  # [m] by which a rectangle may overlap what it must not cross
PRECISION = 0.05  # [m] of how much is missing
WORTH_TELLING = 0.5  # least share of a side that must be left for "so many metres shorter" to be reported
UNIT_CORNERS = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
ATTEMPTS = 12  # the first four towards one corner each, the others with a corner drawn for each facility


@dataclass(frozen=True)
class PlacedFacility:
    """A facility at `centre` [m], its length along `bearing`, clockwise from north [deg, 0..180)."""

    facility: Facility
    centre: tuple[float, float]
    bearing: float

    def on_ground(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) from the facility's own axes to east and north [m]."""
        return _turned(points, self.bearing) + self.centre

    @property
    def area(self) -> Polygon:
        """The playing area."""
        return Polygon(self.on_ground(self.facility.outline))

    @property
    def full_area(self) -> Polygon:
        """The area with the run-off, as a rectangle."""
        return self.grown(1.0)

    def grown(self, factor: float) -> Polygon:
        """`full_area` enlarged about its centre."""
        f = self.facility
        return Polygon(self.on_ground(_corners(f.full_length * factor, f.full_width * factor)))

    @property
    def from_north(self) -> float:
        """How far its length is turned away from north-south [deg, 0..90]."""
        return min(self.bearing % 180, 180 - self.bearing % 180)


@dataclass(frozen=True)
class Missing:
    """A facility that was not placed, and why. place : where it was requested, if a place was given.

    short_length, short_width : length missing at full width, and width missing at full length [m]; None if half of that
    side or more would have to go. share : how large it could be in its own proportions, 0..1.
    empty_lot : whether it would fit alone. outside, overlapping : at a given place [m2].
    """

    facility: Facility
    empty_lot: bool
    share: float = 0.0
    short_length: float | None = None
    short_width: float | None = None
    place: PlacedFacility | None = None
    outside: float = 0.0
    overlapping: float = 0.0

    def sentence(self) -> str:
        """The reason in words."""
        size = f"{self.facility.full_length:.1f} x {self.facility.full_width:.1f} m with its run-off"
        if self.place is not None:
            excess = ((self.outside, "outside of the free lot"), (self.overlapping, "on others"))
            parts = [f"{area:.1f} m2 {where}" for area, where in excess if area > 0]
            return f"{self.facility.name} ({size}) does not fit where it was asked for: {', '.join(parts)}"
        sides = ((self.short_length, "length at full width"), (self.short_width, "width at full length"))
        lacks = [f"{short:.1f} m of {what}" for short, what in sides if short is not None]
        if not lacks:
            short = [side * (1 - self.share) for side in (self.facility.full_length, self.facility.full_width)]
            lacks = [f"{short[0]:.1f} m of length and {short[1]:.1f} m of width"]
        where = "there is no room left" if self.empty_lot else "the lot is too small even when empty"
        return f"{self.facility.name} ({size}) does not fit: {where}, it lacks {' or '.join(lacks)}"


def arrange(
    lot: BaseGeometry,
    wanted: Sequence[Facility],
    fixed: Sequence[PlacedFacility] = (),
    clearance: float = 1.0,
    avoid: BaseGeometry | None = None,
) -> tuple[list[PlacedFacility], list[Missing]]:
    """Place `wanted`, and `fixed` at their given places, inside `lot`; coordinates are metres east and north.

    clearance : between facilities, run-off included, and to the lot's edge [m]. avoid : area to keep free.
    """
    space = shapely.buffer(lot, -clearance, join_style="mitre") if clearance else lot
    if avoid is not None and not avoid.is_empty:
        space = space.difference(shapely.buffer(avoid, clearance, join_style="mitre"))
    kept, missing = _fix(space, fixed, clearance)
    directions = _directions(lot)
    hopeless = {f.code for f in wanted if not _fits(space, f.full_length, f.full_width, directions)}
    by_area = sorted(wanted, key=lambda f: -f.full_length * f.full_width)
    rng = np.random.default_rng(0)
    best: tuple[list[PlacedFacility], list[Facility]] | None = None
    for attempt in range(ATTEMPTS if by_area else 1):
        placed, failed, full = list(kept), [], set(hopeless)
        free = _without(space, kept, clearance)
        for facility in by_area:
            corner = UNIT_CORNERS[attempt] if attempt < len(UNIT_CORNERS) else rng.choice(UNIT_CORNERS)
            found = None if facility.code in full else _best_place(free, facility, directions, corner)
            if found is None:
                full.add(facility.code)
                failed.append(facility)
                continue
            placed.append(found)
            free = _without(free, [found], clearance)
        if best is None or _merit(placed) > _merit(best[0]):
            best = placed, failed
        if attempt + 1 >= len(UNIT_CORNERS) and {f.code for f in best[1]} <= hopeless:
            break
    assert best is not None
    placed, failed = best
    free = _without(space, placed, clearance)
    accounts: dict[str, Missing] = {}
    for facility in failed:
        if facility.code not in accounts:
            accounts[facility.code] = _shortfall(space, free, facility, _directions(lot, COARSE_STEP))
        missing.append(accounts[facility.code])
    return placed, missing


def holds(lot: BaseGeometry, placed: Sequence[PlacedFacility], factor: float) -> list[bool]:
    """Whether each facility would still lie in the lot and clear of the others if all were `factor` times as large in
    the picture, as for a scale that is wrong by that factor."""
    areas = [p.grown(factor) for p in placed]
    roomy = shapely.buffer(lot, SLACK)
    return [
        bool(roomy.covers(area))
        and all(k == j or area.intersection(other).area < 0.01 for j, other in enumerate(areas))
        for k, area in enumerate(areas)
    ]


def rings(area: BaseGeometry) -> Iterator[np.ndarray]:
    """(n, 2) the outline of each polygon in `area`, and of each of its holes; the last point is the first."""
    for part in shapely.get_parts(area):
        if part.geom_type == "Polygon":
            yield from map(shapely.get_coordinates, (part.exterior, *part.interiors))


def centres(free: BaseGeometry, length: float, width: float, bearing: float) -> BaseGeometry:
    """Where the centre of a `length` x `width` [m] rectangle along `bearing` [deg] may be so that it lies within
    `free`."""
    # Where a disc as wide as the rectangle fits: often nowhere, which saves the rest.
    room = shapely.buffer(free, -(min(length, width) - SLACK) / 2)
    if room.is_empty:
        return room
    corners = _turned(_corners(length - SLACK, width - SLACK), bearing)
    edges = np.concatenate([np.stack([r[:-1], r[1:]], 1) for r in rings(free)])  # (E, 2 ends, 2)
    swept = (edges[:, :, None] + corners).reshape(-1, 2)  # eight points each
    blocked = shapely.convex_hull(shapely.multipoints(swept, indices=np.repeat(np.arange(len(edges)), 8)))
    shapely.prepare(room)
    return room.difference(shapely.union_all(blocked[shapely.intersects(room, blocked)]))


def _turned(points: np.ndarray, bearing: float) -> np.ndarray:
    """(n, 2) east and north of `points` (n, 2) along `bearing`, clockwise from north [deg], and to its left."""
    ahead = unit_vector(np.radians(90 - bearing))
    return points[:, :1] * ahead + points[:, 1:] * quarter_turn(ahead)


def _corners(length: float, width: float) -> np.ndarray:
    return np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * (length / 2, width / 2)


def _directions(lot: BaseGeometry, step: float = STEP) -> list[float]:
    """Bearings to try [deg, 0..180): those of the lot's long edges and their normals first, then evenly spaced ones."""
    hull = shapely.get_coordinates(shapely.simplify(lot.convex_hull, 0.5))
    edges = np.diff(hull, axis=0)
    length = np.linalg.norm(edges, axis=1)
    along = np.degrees(np.arctan2(*edges[length > 0.1 * length.max()].T)) % 180
    own = [round(float(b), 3) for b in np.concatenate([along, (along + 90) % 180])]
    return list(dict.fromkeys([*own, *np.arange(0.0, 180.0, step).tolist()]))


def _ranked(facility: Facility, directions: Sequence[float]) -> list[list[float]]:
    """Groups of bearings, the better group first: close to north if that matters. In a group the lot's own come
    first."""
    if not facility.north_south:
        return [list(directions)]
    turned = {b: min(b, 180 - b) for b in directions}
    near = [b for b in directions if turned[b] <= TOLERANCE]
    rest = sorted((b for b in directions if turned[b] > TOLERANCE), key=lambda b: round(turned[b] / TOLERANCE))
    return [near, rest]


def _best_place(
    free: BaseGeometry, facility: Facility, directions: Sequence[float], corner: np.ndarray
) -> PlacedFacility | None:
    """The tightest place towards `corner`, in the first group of directions that has any."""
    for group in _ranked(facility, directions):
        options = []
        for rank, bearing in enumerate(group):
            may_be = centres(free, facility.full_length, facility.full_width, bearing)
            points = shapely.get_coordinates(may_be)
            if len(points):
                # Distance towards the corner, less a penalty for the direction's rank: up to a tenth of the length.
                pull = points @ corner - 0.1 * facility.full_length * rank / len(group)
                k = int(np.argmax(pull))
                options.append((float(pull[k]), bearing, (float(points[k, 0]), float(points[k, 1]))))
        if options:
            _, bearing, centre = max(options)
            return PlacedFacility(facility, centre, bearing)
    return None


def _merit(placed: Sequence[PlacedFacility]) -> tuple[float, float, float]:
    """Sort key of a layout: more area first, then fewer degrees from north, then a smaller convex hull."""
    area = sum(p.full_area.area for p in placed)
    turned = sum(max(p.from_north - TOLERANCE, 0) for p in placed if p.facility.north_south)
    sprawl = shapely.MultiPolygon([p.full_area for p in placed]).convex_hull.area if placed else 0.0
    return round(area, 3), -turned, -sprawl


def _without(free: BaseGeometry, placed: Sequence[PlacedFacility], clearance: float) -> BaseGeometry:
    taken = [shapely.buffer(p.full_area, clearance, join_style="mitre") for p in placed]
    return free.difference(shapely.union_all(taken)) if taken else free


def _fix(
    space: BaseGeometry, fixed: Sequence[PlacedFacility], clearance: float
) -> tuple[list[PlacedFacility], list[Missing]]:
    kept: list[PlacedFacility] = []
    missing = []
    for place in fixed:
        area = place.full_area
        others = shapely.union_all([shapely.buffer(p.full_area, clearance, join_style="mitre") for p in kept])
        outside, over = area.difference(space).area, area.intersection(others).area
        if outside > 0.01 or over > 0.01:
            missing.append(Missing(place.facility, True, place=place, outside=outside, overlapping=over))
        else:
            kept.append(place)
    return kept, missing


def _fits(free: BaseGeometry, length: float, width: float, directions: Sequence[float]) -> bool:
    return any(not centres(free, length, width, b).is_empty for b in directions)


def _shortfall(space: BaseGeometry, free: BaseGeometry, facility: Facility, directions: Sequence[float]) -> Missing:
    """How much is missing: by the longest of full width, the widest of full length, and the largest in its own
    proportions that still fit in one of `directions`."""
    length, width = facility.full_length, facility.full_width
    empty_lot = _fits(space, length, width, directions)
    free = free if empty_lot else space

    def largest(fits: Callable[[float], bool]) -> float:
        """The largest share of a side that `fits`, to PRECISION of the length."""
        low, high = 0.0, 1.0
        while (high - low) * length > PRECISION:
            middle = (low + high) / 2
            low, high = (middle, high) if fits(middle) else (low, middle)
        return low

    share = largest(lambda v: _fits(free, v * length, v * width, directions))
    long = largest(lambda v: _fits(free, v * length, width, directions))
    wide = largest(lambda v: _fits(free, length, v * width, directions))
    return Missing(
        facility,
        empty_lot=empty_lot,
        share=share,
        short_length=(1 - long) * length if long > WORTH_TELLING else None,
        short_width=(1 - wide) * width if wide > WORTH_TELLING else None,
    )
