"""Railway tracks, by the distance between the heads of their rails.

Two lines that run a gauge apart are followed along the track, block by block; sleepers between them, or a second track
beside, distinguish them from kerbs and lane lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..core.anchors import Anchor, Standard, holding
from ..core.angles import axis_angle, quarter_turn, unit_vector
from ..core.normal import median_sd, robust_sd
from .following import SECTION_STEP, followed, ridge_across, three_back
from .peaks import peak_shift
from .repeated import LOCAL_STRETCH
from .ridges import SEED_PX, Segments, lightness, ridge_noise, segments, steered
from .rules import sizes, within_reach
from .strokes import values

HEAD = 0.072  # [m] width of a rail's head: 60E1 of EN 13674-1; R65 of GOST 51685 has 0.075, 136RE of AREMA 0.0746
# [m] one sigma of the distance between the visible parts of both heads, by half a polished strip to either side, and by
# how far a track in use is off its gauge (EN 13848-5: some mm).
HEAD_SEEN = 0.015

# Gauge [m], its prior where the country is not known, and the countries whose main lines have it.
_UIC = "EN 15273; UIC 510"
_AUSTRALIA = "Wikipedia, Rail gauge in Australia"
GAUGES = (
    (1.435, 1.0, "", _UIC),
    (1.520, 0.3, "RU BY UA KZ EE LV LT FI MD GE AM AZ UZ KG TJ TM MN", "GOST 34894 (1.520 m); Finland's 1.524 m"),
    (1.668, 0.1, "ES PT", "Iberian gauge, Adif NAV 7 (1.668 m)"),
    (1.676, 0.1, "IN PK BD LK AR CL", "Indian Railways, Schedule of Dimensions (1.676 m)"),
    (1.600, 0.05, "IE BR AU", f"Irish gauge, 5 ft 3 in; Victoria and South Australia: {_AUSTRALIA}"),
    (1.067, 0.2, "JP ZA NZ ID PH TW ZW ZM BW AO GH NG SD AU",
     f"Cape gauge, 3 ft 6 in; Queensland and Western Australia: {_AUSTRALIA}"),
    (1.000, 0.2, "CH TH VN MY MM KH KE UG TZ SN ML CI BR AR CL BO BD",
     "metre gauge; Wikipedia, Bangladesh Railway, beside 1.676 m"),
)  # fmt: skip
# Vietnam: Wikipedia, Transport in Vietnam: in the north, beside 1.000 m.
STANDARD_TOO = "ES PT IN JP AR BR CH TW KE TZ NG MY TH IE AU VN"  # which also have lines of standard gauge

RAIL_FALSE = 0.05  # with sleepers; none was found on real pictures without rails, see benchmarks
RAIL_FALSE_WITHOUT = 0.15  # with a second track only

RAIL_SEED = 0.3  # least mean ridge of a piece of a rail
RAIL_PARALLEL = np.radians(2.5)  # between two pieces of one track
STARTS = 150  # pairs per megapixel, those that most others continue
CONTINUED = 2  # least number of pairs that continue a pair in its line ...
CONTINUED_WITHIN, CONTINUED_ASIDE = 2.5, 0.1  # ... within so many seeds, and off it by this share of the distance
BLOCK = 3.0  # [m] of track whose cross section is taken at once
RAIL_SD, RAIL_SD_PX = 0.045, 0.75  # least one sigma of the ridge filter [m] and [px]
RAIL_WINDOW = 0.1  # of the distance between rails: how far from their places they are searched
RAIL_CLEAR = 2.5  # [sigmas of the noise] least ridge of the weaker rail in a cross section
FEWEST_RAIL_BLOCKS = 8
RAIL_FILLED = 0.75  # least share of the blocks tried that show two rails
RAIL_UNEVEN = 0.02  # of the distance: most that it may scatter over the blocks, one sigma; rails keep it to some mm
RAIL_ALONE = 0.6  # of the weaker rail's ridge: a stronger ridge between or beside the rails is a third line ...
RAIL_CROWDED = 0.35  # ... which at most this share of the blocks may have
CLOSE_BESIDE, FARTHEST_BESIDE = 0.9, 1.6  # [distances of rails] from the middle: limits of where that is searched
RAIL_SAME_GROUND = 22.0  # [grey levels] by which the ground may differ between the rails and outside
SLEEPERS = 0.48, 0.72  # [m] period: 0.60 to 0.65 in Europe, 0.50 to 0.55 under wood in America and Russia
AROUND_SLEEPERS = 0.35, 2.5  # [m] other periods, to compare with
BETWEEN_RAILS = 0.3  # [distances of rails] from the middle: where what lies between the rails is sampled
OUTSIDE_RAILS = 0.65  # [distances of rails] from the middle, out to CLOSE_BESIDE: where the ground beside is sampled
SLEEPER_PEAK = 5.0  # least peak, in medians of the spectrum of what lies between the rails
TRACKS_APART = 3.3, 6.5  # [m] between the middles of two tracks
ALIKE_TRACKS = 0.02  # largest relative difference of the distances between their rails


def _standards() -> tuple[Standard, ...]:
    """Standard gauge everywhere except where main lines have another, and those others there."""
    found = []
    for gauge, prior, countries, source in GAUGES:
        metres = gauge + HEAD
        words = f"{source}; heads {HEAD:g} m wide (EN 13674-1) seen in their middle"
        name, sd = f"gauge {gauge:.3f} m", HEAD_SEEN / metres
        found.append(Standard(name, metres, sd, words, prior, tuple(countries.split())))
        if not countries:
            found.append(Standard(f"{name}, new lines", metres, sd, words, 0.3, tuple(STANDARD_TOO.split())))
    return tuple(found)


@dataclass(frozen=True)
class TrackBlock:
    """A block of a track. place : (2,) its middle [px]. heading : of the track [rad]. apart, third, ground : one row of
    `Track`."""

    place: np.ndarray
    heading: float
    apart: float
    third: tuple[float, float]
    ground: np.ndarray


@dataclass(frozen=True)
class Track:
    """Blocks (B,) of a track. middle : (B, 2) [px]. along : (B, 2) unit vectors. apart : (B,) distance between the
    rails [px]. third : (B, 2) strongest other ridge between the rails and close beside them, and the same out to where
    a second track may begin, as shares of the weaker rail's. ground : (B, 3) grey levels left of, between and right of
    the rails. tried : number of blocks looked at."""

    middle: np.ndarray
    along: np.ndarray
    apart: np.ndarray
    third: np.ndarray
    ground: np.ndarray
    tried: int

    @property
    def distance(self) -> float:
        """Median distance between the rails [px]."""
        return float(np.median(self.apart))

    @property
    def scatter(self) -> float:
        """One sigma of the blocks' distances, as a share of their median."""
        return float(robust_sd(self.apart)) / self.distance

    @property
    def distance_sd(self) -> float:
        """Relative one sigma of `distance`, as the median of independent blocks."""
        return median_sd(self.apart) / self.distance

    def lines(self) -> np.ndarray:
        """(2 (B - 1), 2, 2) lines of both rails, from block to block [px]."""
        across = quarter_turn(self.along) * self.distance / 2
        return np.concatenate(
            [np.stack([rail[:-1], rail[1:]], 1) for rail in (self.middle + s * across for s in (-1, 1))]
        )


@dataclass(frozen=True)
class RailTracks:
    """Finds straight and slightly bent railway tracks (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = _standards()
    kind = "railway track"
    extent = 60.0
    finest = 0.05
    coarsest = 0.16

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        standards = holding(self.standards, country) if country else list(self.standards)
        low, high = sizes(standards, gsd, gsd_sd)
        light = lightness(image)
        tracks = [track for look in (light, 255 - light) for track in _tracks(look, low, high, gsd)]
        found = []
        for track in tracks:
            meant = within_reach(standards, track.distance, gsd, gsd_sd)
            if not meant:
                continue
            if _has_sleepers(light, track, meant):
                false = RAIL_FALSE
            elif _is_alone(track, 1) and any(_beside(track, other, gsd) for other in tracks):
                false = RAIL_FALSE_WITHOUT
            else:
                continue
            sd = float(np.hypot(track.distance_sd, LOCAL_STRETCH))
            residual = track.apart - track.distance
            found.append(
                Anchor(self.kind, track.middle.mean(0), track.lines(), track.distance, sd, residual, meant, false)
            )
        return found


def _tracks(light: np.ndarray, low: float, high: float, gsd: float) -> list[Track]:
    """Tracks whose rails are brighter than their surroundings and `low` to `high` [px] apart."""
    pairs = _pairs(segments(steered(light), RAIL_SEED), low, high, round(STARTS * light.size / 1e6))
    left = np.ones(len(pairs), bool)
    found: list[Track] = []
    for k, (x, y, angle, apart) in enumerate(pairs):
        if not left[k]:
            continue
        track = _followed(light, np.array([x, y]), angle, apart, gsd)
        left[k] = False
        if track is None:
            continue
        near, _ = cKDTree(track.middle).query(pairs[:, :2])
        left &= near > max(BLOCK / gsd, 0.5 * apart)
        if _is_track(track):
            found.append(track)
    return found


def _pairs(seeds: Segments, low: float, high: float, most: int) -> np.ndarray:
    """(N, 4) middle x, y [px], angle [rad] and distance [px] of pairs of parallel pieces side by side that other pairs
    continue; those that most continue first."""
    if len(seeds.angle) < 2:
        return np.zeros((0, 4))
    pair = cKDTree(seeds.middle).query_pairs(float(np.hypot(high, SEED_PX / 2)), output_type="ndarray")
    turn = axis_angle(seeds.angle[pair[:, 1]] - seeds.angle[pair[:, 0]])
    angle = (seeds.angle[pair[:, 0]] + turn / 2) % np.pi
    step = seeds.middle[pair[:, 1]] - seeds.middle[pair[:, 0]]
    apart = np.abs(step[:, 1] * np.cos(angle) - step[:, 0] * np.sin(angle))
    ahead = np.abs(step[:, 0] * np.cos(angle) + step[:, 1] * np.sin(angle))
    good = (np.abs(turn) <= RAIL_PARALLEL) & (apart >= low) & (apart <= high) & (ahead <= SEED_PX / 2)
    pair, angle, apart = pair[good], angle[good], apart[good]
    if not len(pair):
        return np.zeros((0, 4))
    middle = seeds.middle[pair].mean(1)
    # pairs alike in place, direction and distance: a turn of RAIL_PARALLEL, or a tenth in distance, is half the reach
    reach = CONTINUED_WITHIN * SEED_PX
    by_turn = reach / (4 * RAIL_PARALLEL) * unit_vector(2 * angle)
    place = np.column_stack([middle, by_turn, np.log(apart) * reach * 5])
    near = cKDTree(place).query_pairs(reach, output_type="ndarray")
    c, s = np.cos(angle[near[:, 0]]), np.sin(angle[near[:, 0]])
    gap = middle[near[:, 1]] - middle[near[:, 0]]
    behind = (np.abs(gap[:, 1] * c - gap[:, 0] * s) < CONTINUED_ASIDE * apart[near[:, 0]]) & (
        np.abs(gap[:, 0] * c + gap[:, 1] * s) > SEED_PX / 2
    )
    support = np.bincount(near[behind].ravel(), minlength=len(pair))
    order = np.argsort(-support, kind="stable")
    order = order[support[order] >= CONTINUED][:most]
    return np.column_stack([middle, angle, apart])[order]


def _followed(light: np.ndarray, start: np.ndarray, angle: float, apart: float, gsd: float) -> Track | None:
    """The track through `start` [px], followed both ways; None if it has too few blocks."""
    step = BLOCK / gsd
    first = _block(light, start, angle, apart, step, gsd)
    if first is None:
        return None

    def further(place: np.ndarray, before: Sequence[TrackBlock], way: float) -> TrackBlock | None:
        seen = _block(light, place, before[-1].heading, apart, step, gsd)
        if seen is None or len(before) == 1:
            return seen
        chord = (seen.place - three_back(before).place) * way
        return replace(seen, heading=float(np.arctan2(chord[1], chord[0])))

    blocks, tried = followed(first, step, light.shape, further)
    if len(blocks) < FEWEST_RAIL_BLOCKS:
        return None
    middle = np.array([block.place for block in blocks])
    along = np.gradient(middle, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return Track(
        middle,
        along,
        np.array([block.apart for block in blocks]),
        np.array([block.third for block in blocks]),
        np.array([block.ground for block in blocks]),
        tried,
    )


def _block(
    light: np.ndarray, place: np.ndarray, angle: float, apart: float, length: float, gsd: float
) -> TrackBlock | None:
    """The block of track about `place` [px], `length` [px] long, with rails about `apart` [px] that run at `angle`
    [rad]; None where two rails are not seen."""
    along = unit_vector(angle)
    across = quarter_turn(along)
    sd = max(RAIL_SD / gsd, RAIL_SD_PX)
    reach = np.ceil(FARTHEST_BESIDE * apart / SECTION_STEP)
    offset = np.arange(-reach, reach + 1) * SECTION_STEP
    t = np.linspace(-0.5, 0.5, max(8, int(length))) * length
    grid = place + t[:, None, None] * along + offset[:, None] * across
    profile = values(light, grid).mean(0)
    response = ridge_across(profile, sd)
    rail = []
    for side in (-1, 1):
        about = np.abs(offset - side * apart / 2) <= RAIL_WINDOW * apart
        k = int(np.flatnonzero(about)[response[about].argmax()])
        if not (0 < k < len(offset) - 1) or response[k] < max(response[k - 1], response[k + 1]):
            return None
        left, middle, right = response[k - 1 : k + 2]
        rail.append((offset[k] + SECTION_STEP * float(peak_shift(left, middle, right)), middle))
    (a, one), (b, other) = rail
    away = (np.abs(offset - a) > 3 * sd) & (np.abs(offset - b) > 3 * sd)
    close = np.abs(offset) < CLOSE_BESIDE * apart
    near = away & close
    weaker = min(one, other)
    if weaker < RAIL_CLEAR * ridge_noise(response[near]):
        return None
    between, beside = np.abs(offset) < BETWEEN_RAILS * apart, (np.abs(offset) > OUTSIDE_RAILS * apart) & close
    ground = np.array([np.median(profile[part]) for part in (beside & (offset < 0), between, beside & (offset > 0))])
    third = float(response[near].max()) / weaker, float(response[away].max()) / weaker
    return TrackBlock(place + (a + b) / 2 * across, angle, b - a, third, ground)


def _is_track(track: Track) -> bool:
    """Whether the two lines keep their distance, with no third line close by, on uniform ground."""
    if len(track.apart) < FEWEST_RAIL_BLOCKS or len(track.apart) < RAIL_FILLED * track.tried:
        return False
    ground = np.median(track.ground, axis=0)
    return (
        _is_alone(track, 0)
        and track.scatter < RAIL_UNEVEN
        and float(np.abs(ground[[0, 2]] - ground[1]).max()) < RAIL_SAME_GROUND
    )


def _is_alone(track: Track, out: int) -> bool:
    """Whether there is no third line close by (`out` is 0), or out to where a second track may begin (`out` is 1)."""
    return bool(np.mean(track.third[:, out] > RAIL_ALONE) <= RAIL_CROWDED)


def _has_sleepers(light: np.ndarray, track: Track, standards: Sequence[Standard]) -> bool:
    """Whether the picture between the rails repeats at the period of sleepers."""
    steps = np.linalg.norm(np.diff(track.middle, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    s = np.arange(0, at[-1], 0.5)
    place = np.column_stack([np.interp(s, at, track.middle[:, k]) for k in (0, 1)])
    along = np.column_stack([np.interp(s, at, track.along[:, k]) for k in (0, 1)])
    across = quarter_turn(along)
    offset = np.linspace(-BETWEEN_RAILS, BETWEEN_RAILS, 13)[:, None, None] * track.distance
    seen = values(light, place + offset * across).mean(0)
    width = max(3, int(2 * track.distance))
    seen = seen - np.convolve(
        np.pad(seen, width, mode="reflect"), np.ones(2 * width + 1) / (2 * width + 1), mode="valid"
    )
    spectrum = np.abs(np.fft.rfft(seen * np.hanning(len(seen))))
    rate = np.fft.rfftfreq(len(seen), 0.5)  # per pixel
    for standard in standards:
        pixel = standard.metres / track.distance
        among = (rate * SLEEPERS[1] / pixel >= 1) & (rate * SLEEPERS[0] / pixel <= 1)
        around = (rate * AROUND_SLEEPERS[1] / pixel >= 1) & (rate * AROUND_SLEEPERS[0] / pixel <= 1) & ~among
        if among.any() and around.any() and spectrum[among].max() > SLEEPER_PEAK * np.median(spectrum[around]):
            return True
    return False


def _beside(track: Track, other: Track, gsd: float) -> bool:
    """Whether `other` is a second track that runs along `track`."""
    if track is other or abs(np.log(track.distance / other.distance)) > ALIKE_TRACKS:
        return False
    gap, nearest = cKDTree(other.middle).query(track.middle)
    aligned = np.abs((track.along * other.along[nearest]).sum(1)) > np.cos(2 * RAIL_PARALLEL)
    off = other.middle[nearest] - track.middle
    apart = np.abs(off[:, 1] * track.along[:, 0] - off[:, 0] * track.along[:, 1]) * gsd
    low, high = TRACKS_APART
    return bool((aligned & (gap * gsd < high + BLOCK) & (apart > low) & (apart < high)).mean() > 0.5)
