"""Evidence from places that are known in metres: distances and ground control; and errors of the ground's height."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from .evidence import BY_CONTROL, BY_DISTANCE, Evidence
from .normal import Z90
from .pooling.posterior import Posterior

DISTANCE_SD = 0.01  # relative one sigma of a known distance without a given one: a tape, and points clicked by hand
SHORTEST, LONGEST = 1e-3, 1e6  # limits of a known distance [m]: what can show in a picture
READING_SD = 0.5  # [px] one sigma, along a line, of a point that a person reads in a picture
SUREST = 1e-6  # least relative one sigma of a known distance: surveyors reach that
CONTROL_SD = 0.05  # least one sigma of a ground control point, and its value without residuals [m]
# Relative one sigma of horizontal distances on a ground that is taken for level: down a street of 8 %, the steepest
# that is usual (`sources.ground_sheet.WANDER`), distances along the ground are longer by that much.
LEVEL_SD = 0.003


def known_distance(
    points: np.ndarray, metres: float, sd: float | None = None, where: str = "", read_sd: float = 0.0
) -> Evidence:
    """Two points (2, D) [units], `metres` apart, with one sigma `sd` [m] (1 % if not given). read_sd : one sigma of
    their distance [units] from reading the two points.

    Raises ValueError where the points coincide or a number is out of range.
    """
    units = float(np.linalg.norm(points[0] - points[1]))
    sd = DISTANCE_SD * metres if sd is None else sd
    if not (np.isfinite(units) and units > 0):
        raise ValueError("the points must differ")
    if not SHORTEST <= metres <= LONGEST:
        raise ValueError(f"the distance must be a number of metres from {SHORTEST:g} to {LONGEST:g}")
    if not SUREST * metres <= sd <= metres:
        raise ValueError("the sigma must be positive metres, from a millionth of the distance to all of it")
    relative_sd = float(np.hypot(sd / metres, read_sd / units))
    return Evidence(BY_DISTANCE, metres / units, relative_sd, f"the known distance of {metres:g} m{where}")


def ground_control(
    units: np.ndarray,
    metres: np.ndarray,
    read_sd: float | np.ndarray = 0.0,
    level_sd: float = 0.0,
    how: Sequence[str] = (),
) -> Evidence:
    """The scale of the similarity transform between points (N, D) [units] and the same points (N, D) [m], N >= 2: the
    ratio of their spreads about the centroid (Horn 1987). The axes may have any direction, and be mirrored. read_sd :
    one sigma of reading each point along a line [units], one number or (N,). level_sd : relative one sigma of all
    distances, if `units` lie on a ground that is taken for level. how : further words of the description. Raises
    ValueError.

    The residuals of the transform contain all errors of the points, also those of reading. Few points determine their
    size badly, so the sigma is that whose 90 % interval is the one of Student's t. But small residuals may be luck, and
    two points have none: the errors are taken to be no smaller than CONTROL_SD and `read_sd`.
    """
    if len(units) < 2 or len(units) != len(metres):
        raise ValueError("at least two points are needed, each in both systems")
    first, second = (p - p.mean(0) for p in (units, metres))
    spread = [float(np.linalg.norm(p)) for p in (first, second)]
    if not np.isfinite(spread).all() or min(spread) <= 0:
        raise ValueError("the points must differ from one another")
    reading = float(np.linalg.norm(np.linalg.norm(first, axis=1) * read_sd)) / spread[0] ** 2
    sd = float(np.hypot(CONTROL_SD / spread[1], reading))
    says = [f"{len(units)} points", *how]
    dims = units.shape[1]
    freedom = dims * len(units) - dims - dims * (dims - 1) // 2 - 1  # less shift, rotation and scale
    if freedom > 0:
        # Share of the sum of squares that the best rotation, or mirrored rotation, leaves (Kabsch 1976).
        rest = 1 - (np.linalg.norm(first.T @ second, "nuc") / spread[0] / spread[1]) ** 2
        sd = max(sd, float(np.sqrt(max(rest, 0.0) / freedom) * stdtrit(freedom, 0.95)) / Z90)
    else:
        says.append(f"assumed good to {CONTROL_SD:g} m, as two do not check each other")
    if level_sd:
        says.append("the ground assumed level")
    sd = float(np.hypot(sd, level_sd))
    return Evidence(BY_CONTROL, spread[1] / spread[0], sd, f"ground control ({', '.join(says)})")


def meeting_point(centres: np.ndarray, rays: np.ndarray, sds: np.ndarray) -> tuple[np.ndarray, float]:
    """The point (3,) nearest to all rays (N, 3) from cameras at `centres` (N, 3), N >= 2; and its one sigma along a
    line, on average over all directions.

    It has the least sum of squared distances from the rays, each weighted by `sds` (N,), one sigma of the ray across
    itself; all in the same units. The rays must not be parallel.
    """
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    across = (np.eye(3) - along[:, :, None] * along[:, None, :]) / sds[:, None, None] ** 2
    covariance = np.linalg.inv(across.sum(0))
    place = covariance @ (across @ centres[:, :, None]).sum(0)[:, 0]
    return place, float(np.sqrt(np.trace(covariance) / 3))


def missed_by(place: np.ndarray, centres: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N,) distances at which rays (N, 3) from `centres` (N, 3) pass a place (3,), in its units."""
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    off = place - centres
    return np.asarray(np.linalg.norm(off - (off * along).sum(1, keepdims=True) * along, axis=1))


def widest_angle(rays: np.ndarray) -> float:
    """The greatest angle between any two of `rays` (N, 3) [rad]; 0 for one."""
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.arccos(np.clip(along @ along.T, -1, 1)).max())


def ground_shares(points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N,) relative growth of all distances between `points` (N, D) per lowering of the ground under each of them, as a
    share of the cameras' height; they sum to 1 for points of one picture. rays : (N, D) from the cameras to the points,
    0 for a point that was not seen on the ground; in the same units."""
    off = points - points.mean(0)
    return np.asarray((off * rays).sum(1) / (off**2).sum())


def on_ground(found: Evidence, shares: np.ndarray, own: np.ndarray, shared: float) -> Evidence:
    """Evidence `found` from places on a reconstruction's ground, with the error of that ground's height added.

    shares : (N,) how far that error affects it, by place (`ground_shares`). own : (N, N) covariance of the places' own
    errors, and shared : one sigma of the error common to all that was seen on that ground, both as shares of the
    cameras' height. Shares that sum to more than 1, or to less than 0, take the excess as an error of their own: the
    vehicles do not have it.
    """
    whole = float(shares.sum())
    common = float(np.clip(whole, 0, 1)) * shared
    sd = float(np.sqrt(found.relative_sd**2 + shares @ own @ shares + (whole * shared - common) ** 2))
    return Evidence.mixed(found.kind, Posterior.normal(float(np.log(found.value)), sd), [found.says], common=common)
