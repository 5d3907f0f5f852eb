"""Evidence from places that are known in metres: distances and ground control, and the ground that places lie on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from .evidence import BY_CONTROL, BY_DISTANCE, Evidence
from .pooling.posterior import Z90, Posterior

DISTANCE_SD = 0.01  # of a known distance's metres, where none is given: a tape, and pixels clicked by hand
SHORTEST, LONGEST = 1e-3, 1e6  # of a known distance [m]: what shows in a picture
READING_SD = 0.5  # [px] one sigma of a point that a person reads in a picture, along a line
SUREST = 1e-6  # sigma of a known distance, as a share of it: surveyors reach that
CONTROL_SD = 0.05  # of a ground control point's position at best, and where no residuals say [m]
# Of horizontal distances in a ground that is taken for level, a share of them: down streets of 8 %, the steepest usual
# ones (`sources.ground_sheet.WANDER`), distances along the ground are longer by so much.
LEVEL_SD = 0.003


def known_distance(
    points: np.ndarray, metres: float, sd: float | None = None, where: str = "", read_sd: float = 0.0
) -> Evidence:
    """Two points (2, D) [units], `metres` apart, good to `sd` [m] (1 % where it is not given). read_sd : one sigma of
    their distance, from how well the two can be read [units].

    Raises ValueError where the points coincide or a number is not positive.
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
    """Points (N, D) [units] and the same points (N, D) [m], N >= 2: the scale of the similarity transform between them
    (ratio of their spreads about the centroid, Horn 1987). Their axes may have any direction, and be mirrored. read_sd
    : one sigma of how well each point can be read along a line [units], one number or (N,). level_sd : where `units`
    lie in a ground that is taken for level, relative one sigma of all their distances. how : what else is said of them.
    Raises ValueError.

    What the points leave of the transform holds all their errors, those of reading too. Few points tell its size badly:
    the sigma is that whose 90 % interval is the one of Student's t. But a small rest may be luck, and two points leave
    none: the errors are no smaller than is assumed of them, CONTROL_SD and `read_sd`.
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
    freedom = dims * len(units) - dims - dims * (dims - 1) // 2 - 1  # what shift, rotation and scale leave
    if freedom > 0:
        # The best rotation, or mirrored one, leaves that of the sum of squares (Kabsch 1976).
        rest = 1 - (np.linalg.norm(first.T @ second, "nuc") / spread[0] / spread[1]) ** 2
        sd = max(sd, float(np.sqrt(max(rest, 0.0) / freedom) * stdtrit(freedom, 0.95)) / Z90)
    else:
        says.append(f"taken to be good to {CONTROL_SD:g} m")
    if level_sd:
        says.append("the ground taken for level")
    sd = float(np.hypot(sd, level_sd))
    return Evidence(BY_CONTROL, spread[1] / spread[0], sd, f"ground control ({', '.join(says)})")


def meeting_point(centres: np.ndarray, rays: np.ndarray, sds: np.ndarray) -> tuple[np.ndarray, float]:
    """Where rays (N, 3) from cameras at `centres` (N, 3) meet, N >= 2, as nearly as they do: (3,), and one sigma of it
    along a line, on average over all directions.

    The sum of the squares of its distances from the rays is least, each by its own sigma, `sds` (N,) of how well the
    ray is read across it; all in the same units. Rays must not be parallel.
    """
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    across = (np.eye(3) - along[:, :, None] * along[:, None, :]) / sds[:, None, None] ** 2
    covariance = np.linalg.inv(across.sum(0))
    place = covariance @ (across @ centres[:, :, None]).sum(0)[:, 0]
    return place, float(np.sqrt(np.trace(covariance) / 3))


def missed_by(place: np.ndarray, centres: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N,) how far rays (N, 3) from `centres` (N, 3) pass by a place (3,), in its units."""
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    off = place - centres
    return np.asarray(np.linalg.norm(off - (off * along).sum(1, keepdims=True) * along, axis=1))


def widest_angle(rays: np.ndarray) -> float:
    """The greatest angle between any two of `rays` (N, 3) [rad]; 0 for one."""
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.arccos(np.clip(along @ along.T, -1, 1)).max())


def ground_shares(points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N,) by what share all distances between `points` (N, D) grow, for each share of the cameras' height by which the
    ground under one of them lies lower: together 1 for points of one picture. rays : (N, D) from the cameras to the
    points, 0 for one that was not seen on the ground; in the same units."""
    off = points - points.mean(0)
    return np.asarray((off * rays).sum(1) / (off**2).sum())


def on_ground(found: Evidence, shares: np.ndarray, own: np.ndarray, shared: float) -> Evidence:
    """What was `found` from places on a reconstruction's ground, with the error of that ground's height.

    shares : (N,) how much of it they have (`ground_shares`). own : (N, N) covariance of it, as a share of the cameras'
    height, and shared : one sigma of what is common to all that was seen on that ground. What has more than all of the
    latter, or has it reversed, does not err as the vehicles do by so much more.
    """
    whole = float(shares.sum())
    common = float(np.clip(whole, 0, 1)) * shared
    sd = float(np.sqrt(found.relative_sd**2 + shares @ own @ shares + (whole * shared - common) ** 2))
    return Evidence.mixed(found.kind, Posterior.normal(float(np.log(found.value)), sd), [found.says], common=common)
