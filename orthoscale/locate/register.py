"""Registers a picture of the ground on a georeferenced map: its position, orientation and scale.

The picture is turned and scaled in all possible ways, each is correlated with the map, and the best places are verified
by local matches that agree on one similarity transform. How many must agree follows from the counts that the same
picture reaches at wrong places of the same map.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Protocol

import numpy as np
import pyproj

from ..core.evenly import evenly
from ..core.progress import Progress, of_step
from ..errors import TooLittleEvidence, UsageError
from ..sources.satellite import Satellite
from .correlate import Peak, Template, search
from .features import Features
from .ground import GroundImage, Query
from .maps import MapFeatures, MapGrid
from .verify import PlaneSimilarity, Verified, needed, verified

ACROSS = 320.0  # [px] to which the longer side of a picture is brought
FINER = 640.0  # [px] the same for the refinement at the best place, if the map has so much detail
EVERY = 2  # the refinement matches every second cell of the picture, across and down
SMALLEST_ON_MAP = 96.0  # [px] that the shorter side of a picture must have on the map
SCALE_STEP = 1.1  # ratio of the scales that are tried: features still agree at half a step off
HEADING_STEP = np.radians(10.0)  # between the headings; half of it moves the edge of a picture by 4 % of its size
HEADING_SD = np.radians(8.0)  # error allowed for a known heading, to both sides
MOST_STEPS = 12  # number of scales; they span a factor of 3
CHANNELS = 24  # of the features that are correlated
VERIFIED = 20  # number of candidates that are verified
NEGATIVES = 20  # places of the mirrored picture that show how many matches agree by chance
MIRRORED_WAYS = 12  # ways in which the mirrored picture is searched
LEAST_COVERED = 0.5  # least share of a wrong place with data of the map, for its count to mean anything
LEAST_MATCHES = 12  # that must agree, however few do elsewhere ...
LEAST_SQUARES = 10  # ... and squares of the picture in which they must lie; wrong places reach 7, right ones mostly 20
RIVAL = 0.7  # share of the best candidate's matches from which another place is about as good
ANOTHER_PLACE = 0.25  # [pictures' diagonals] least distance between different places
LEVELLING_SD = 0.005  # relative, of the map's scale: neither terrain nor picture is quite level. An assumption.


@dataclass(frozen=True)
class Known:
    """What is known before the search.

    scales : (lowest, highest) true metres per claimed metre of the picture. heading : of its top, clockwise from north
    [rad]; None if unknown. prior : (longitude, latitude, radius [m]) of a circle in which the middle of its ground
    lies; None for the whole map.
    """

    scales: tuple[float, float] = (1.0, 1.0)
    heading: float | None = None
    prior: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Candidate:
    """A place that was verified.

    pose : from claimed metres of the picture, right and down of its reference point, to pixels of `grid`. score : mean
    cosine of the search. inliers : number of matches that agree; squares : number of squares in which they lie, see
    `Verified`. middle : (2,) longitude and latitude of the middle of the picture's ground [deg]. heading : of the
    picture's top, clockwise from north [rad].
    scale : true metres per claimed metre; scatter : its relative one sigma, by the scatter of the matches. matches :
    (N, 4) those that agree: x, y of the picture [claimed m right and down], x, y of the map [its pixels].
    """

    grid: MapGrid
    pose: PlaneSimilarity
    score: float
    inliers: int
    squares: int
    middle: np.ndarray
    heading: float
    scale: float
    scatter: float
    matches: np.ndarray

    def map_pixels(self, places: np.ndarray) -> np.ndarray:
        """(N, 2) the map's own pixels at places (N, 2) of the picture [claimed m right and down]."""
        return self.grid.map_pixel(self.pose(places))

    def lon_lat(self, places: np.ndarray) -> np.ndarray:
        """(N, 2) longitude and latitude [deg] of places (N, 2) of the picture [claimed m right and down]."""
        return self.grid.satellite.lon_lat(self.map_pixels(places))


@dataclass(frozen=True)
class Registration:
    """The result of a registration.

    candidates : the verified places, best first; none if nothing on the map resembles the picture. needed : number of
    matches that must agree. rival : index of another candidate about as good as the first, None if there is none.
    scale_sd : relative one sigma of the first one's scale, infinite if it is not good enough.
    """

    candidates: tuple[Candidate, ...]
    needed: int
    rival: int | None
    scale_sd: float

    @property
    def located(self) -> Candidate | None:
        """The best candidate, if it is good enough and alone."""
        return None if self.problem else self.candidates[0]

    @property
    def ambiguous(self) -> bool:
        """Whether two places match well enough, and about equally well."""
        return self.rival is not None

    @property
    def problem(self) -> str:
        """Why the picture was not located, in words; '' if it was."""
        if not self.candidates:
            return "nothing on the map resembles it"
        best = self.candidates[0].inliers
        if best < self.needed:
            return f"best candidate has {best} matches, {self.needed} needed"
        squares = self.candidates[0].squares
        if squares < LEAST_SQUARES:
            where = f"{squares} squares of the picture only, {LEAST_SQUARES} needed"
            return f"the {best} matches of the best candidate lie in {where}"
        if self.rival is not None:
            return f"two places match about equally: {best} and {self.candidates[self.rival].inliers} matches"
        return ""


def register(
    seen: Query,
    satellite: Satellite,
    features: Features,
    known: Known = Known(),  # noqa: B008 - a frozen value
    cache: bool = True,
    progress: Progress | None = None,
    finder: PlaceFinder | None = None,
) -> Registration:
    """Find `seen` on the map `satellite`.

    cache : whether to keep the map's features for the next picture. finder : finds the places to verify; by default,
    correlation of `features`.
    Raises UsageError for a prior outside of the map, TooLittleEvidence for a picture that is too small on the map.
    """
    grid = grid_for(seen, satellite, known.scales)
    mapped = MapFeatures(grid, features, CHANNELS, cache)
    area = search_area(mapped, known.prior)
    scales = scale_steps(known.scales)
    image = seen.at(grid.gsd / max(scales))
    turns = heading_steps(known.heading, up_of(grid, area, features.stride))
    ways = [Way.of(image, turn, scale, mapped) for turn, scale in product(turns, scales)]
    apart = ANOTHER_PLACE * float(np.hypot(*(image.size * np.median(scales)))) / (grid.gsd * features.stride)
    report = of_step(progress, "Searching the map")
    if finder is None:
        found = search([way.template for way in ways], mapped.window, area, apart, VERIFIED, report)
    else:
        found = finder(ways, mapped, area, apart, VERIFIED, report)
    looks = [(ways[peak.template], peak, verified(ways[peak.template].template, peak, mapped)) for peak in found]
    places = different(looks, image, mapped, apart)
    wrong = mirrored(ways, mapped, area, apart / 2) + [look for _, _, look in places[1:]]
    wrong = [look for look in wrong if look.covered >= LEAST_COVERED] or wrong
    enough = max(LEAST_MATCHES, needed([look.count for look in wrong], len(places)))
    candidates = tuple(_candidate(*place, image, mapped) for place in places if place[2].fit is not None)
    return judged(candidates, enough, seen, mapped)


def grid_for(seen: Query, satellite: Satellite, scales: tuple[float, float]) -> MapGrid:
    """The grid on which `seen` has about ACROSS px. Raises TooLittleEvidence where the map is too coarse or
    far too small for it."""
    size = seen.size * float(np.sqrt(scales[0] * scales[1]))
    grid = MapGrid.of(satellite, float(size.max()) / ACROSS)
    if size.min() / grid.gsd < SMALLEST_ON_MAP:
        across, down = size / grid.gsd
        raise TooLittleEvidence(
            f"the picture shows {size[0]:.0f} x {size[1]:.0f} m, {across:.0f} x {down:.0f} px of "
            f"{satellite.source.name}; each side needs {SMALLEST_ON_MAP:.0f} px",
            "Use a map with smaller pixels, or a picture from higher up.",
        )
    if grid.size.max() < 1:
        raise TooLittleEvidence(
            f"the picture shows {size[0]:.3g} x {size[1]:.3g} m, all of {satellite.source.name} less than a "
            f"{ACROSS:.0f}th of that",
            "Check the picture's GSD, and take a map that holds it.",
        )
    return grid


def search_area(mapped: MapFeatures, prior: tuple[float, float, float] | None) -> tuple[int, int, int, int]:
    """Row, column, height and width of the area to search [cells]. Raises UsageError for a prior outside of the map."""
    height, width = mapped.shape
    if prior is None:
        return 0, 0, height, width
    lon, lat, radius = prior
    grid = mapped.grid
    middle = grid.place_of(grid.satellite.pixel_of(lon, lat)) / mapped.features.stride
    reach = radius / (grid.gsd * mapped.features.stride)
    low, high = np.floor(middle - reach), np.ceil(middle + reach)
    if not np.isfinite(middle).all() or (high <= 0).any() or (low >= [width, height]).any():
        raise UsageError(
            f"the prior, {radius:g} m around {lon:.6f}, {lat:.6f}, lies outside of {grid.satellite.source.name}",
            grid.satellite.extent_in_words(),
        )
    left, top = (int(v) for v in np.maximum(low, 0))
    right, bottom = (int(v) for v in np.minimum(high, [width, height]))
    return top, left, bottom - top, right - left


def up_of(grid: MapGrid, area: tuple[int, int, int, int], stride: int) -> float:
    """The direction of the map's up at the middle of `area` [cells], clockwise from north [rad]."""
    top, left, height, width = area
    middle = grid.map_pixel(np.array([left + width / 2, top + height / 2]) * stride)
    here, above = grid.satellite.lon_lat(np.stack([middle, middle - (0.0, 50.0)]))
    return float(np.radians(pyproj.Geod(ellps="WGS84").inv(*here, *above)[0]))


def scale_steps(scales: tuple[float, float]) -> np.ndarray:
    """The scales to try, at equal ratios from the lowest to the highest. Raises UsageError for too many."""
    low, high = scales
    steps = int(np.ceil(np.log(high / low) / np.log(SCALE_STEP) - 1e-9)) + 1 if high > low else 1
    if steps > MOST_STEPS:
        raise UsageError(
            f"a scale between {low:.3g} and {high:.3g} times the claimed one is too uncertain for a search",
            "Give a better scale (--gsd).",
        )
    return np.geomspace(low, high, steps)


def heading_steps(heading: float | None, up: float) -> np.ndarray:
    """The turns to try [rad], clockwise from the map's up; `up` is the direction of that, clockwise from north
    [rad]."""
    if heading is None:
        return np.arange(0, 2 * np.pi - 1e-9, HEADING_STEP)
    return heading - up + np.array([-1.0, 0.0, 1.0]) * HEADING_SD


@dataclass(frozen=True)
class Way:
    """The picture turned and scaled in one way. pose : from its claimed metres to the template's pixels."""

    pose: PlaneSimilarity
    template: Template

    @classmethod
    def of(cls, image: GroundImage, turn: float, scale: float, mapped: MapFeatures) -> Way:
        """`image` turned clockwise by `turn` [rad], with `scale` times its claimed metres."""
        turned, to_pixels = image.turned(turn, scale, mapped.grid.gsd)
        pose = PlaneSimilarity.of_affine(to_pixels)
        features = mapped.usual.of_features(mapped.features.of(turned.pixels, turned.valid))
        return cls(pose, Template(features, pose(image.middle[None])[0, ::-1] / mapped.features.stride, turned))


class PlaceFinder(Protocol):
    """Finds places on the map that are worth verifying."""

    def __call__(
        self,
        ways: Sequence[Way],
        mapped: MapFeatures,
        area: tuple[int, int, int, int],
        apart: float,
        most: int,
        step: Callable[[int, int], None] | None = None,
    ) -> list[Peak]:
        """The `most` best places of the pictures `ways` with their middles in `area` (row, column, height, width)
        [cells], no two nearer than `apart` [cells], best first. Raises InputError."""
        ...


Look = tuple[Way, Peak, Verified]  # a way, where the search put it, and the matches there


def mirrored(ways: Sequence[Way], mapped: MapFeatures, area: tuple[int, int, int, int], apart: float) -> list[Verified]:
    """Looks at places where the picture certainly is not: the best places of its mirror image, found in the same way.

    Only some of the `ways` are used; no two places are nearer than `apart` [cells]. Repeated structures, such as rows
    of houses or bays, agree in part with a mirror image too."""
    templates = [ways[k].template.mirrored(mapped) for k in evenly(len(ways), MIRRORED_WAYS)]
    found = search(templates, mapped.window, area, apart, NEGATIVES)
    return [verified(templates[peak.template], peak, mapped) for peak in found]


def different(looks: Sequence[Look], image: GroundImage, mapped: MapFeatures, apart: float) -> list[Look]:
    """`looks` with most matches first, without those whose matches lead to the place of a better one: two peaks side by
    side may be one place. apart : as in `search` [cells]."""
    kept: list[Look] = []
    places: list[np.ndarray] = []
    for look in sorted(looks, key=lambda each: -each[2].count):
        way, peak, each = look
        place = np.array([peak.column, peak.row], float)
        if each.fit is not None:
            place = each.fit.similarity(way.pose(image.middle[None]) / mapped.features.stride)[0]
        if all(np.hypot(*(place - other)) >= apart for other in places):
            kept.append(look)
            places.append(place)
    return kept


def judged(candidates: Sequence[Candidate], enough: int, seen: Query, mapped: MapFeatures) -> Registration:
    """The result for `candidates`, best first: the first is right if it has `enough` matches, in enough squares."""
    if not candidates:
        return Registration((), enough, None, float("inf"))
    best = candidates[0]
    if best.inliers < enough or best.squares < LEAST_SQUARES:
        return Registration(tuple(candidates), enough, None, float("inf"))
    rival = next((k for k, other in enumerate(candidates) if k and other.inliers >= RIVAL * best.inliers), None)
    best, sd = refined(best, seen, mapped)
    return Registration((best, *candidates[1:]), enough, rival, float(np.hypot(sd, LEVELLING_SD)))


def refined(best: Candidate, seen: Query, mapped: MapFeatures) -> tuple[Candidate, float]:
    """`best` after one more look on a finer grid, turned and scaled as it was found; and the relative one sigma of its
    scale by the scatter of its matches. Its counts stay those of the first look."""
    fine = mapped.finer(float(seen.size.max()) * best.scale / FINER)
    own = best.pose.scale * best.grid.gsd  # of the grid's metres
    image = seen.at(fine.grid.gsd / own)
    way = Way.of(image, best.pose.turn, own, fine)
    column, row = best.pose(image.middle[None])[0] * best.grid.gsd / (fine.grid.gsd * fine.features.stride)
    peak = Peak(best.score, 0, int(np.rint(row)), int(np.rint(column)))
    look = verified(way.template, peak, fine, EVERY)
    if look.fit is None or look.count < LEAST_MATCHES:
        return best, best.scatter
    better = _candidate(way, peak, look, image, fine)
    better = replace(better, inliers=best.inliers, squares=best.squares, scatter=better.scatter / EVERY)
    return better, better.scatter


def _candidate(way: Way, peak: Peak, look: Verified, image: GroundImage, mapped: MapFeatures) -> Candidate:
    assert look.fit is not None
    grid, stride = mapped.grid, mapped.features.stride
    inner = look.fit.similarity
    pose = PlaneSimilarity(inner.factor, inner.shift * stride).after(way.pose)
    middle = grid.map_pixel(pose(image.middle[None]))
    ahead = grid.map_pixel(pose(image.middle[None] - (0.0, image.size[1] / 4)))
    here, above = grid.satellite.lon_lat(np.concatenate([middle, ahead]))
    heading = float(np.radians(pyproj.Geod(ellps="WGS84").inv(*here, *above)[0]) % (2 * np.pi))
    # The grid's metres hold at the map's middle; elsewhere a map projection stretches lengths.
    local = float(np.sqrt((grid.satellite.pixel_size(middle[0]) / grid.pixel).prod()))
    agreed = look.matches[look.fit.inliers] * stride
    matches = np.hstack([way.pose.inverse(agreed[:, :2]), grid.map_pixel(agreed[:, 2:])])
    # Overlapping blocks are not independent: block**2 of them count as one.
    scatter = look.fit.scale_sd * mapped.features.block
    own = pose.scale * grid.gsd * local
    return Candidate(grid, pose, peak.score, look.count, look.squares, here, heading, own, scatter, matches)
