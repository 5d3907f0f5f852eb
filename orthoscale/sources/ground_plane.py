"""Finds the plane below the cameras that most of a reconstruction's ground lies on, and so which way is up."""

from __future__ import annotations

import numpy as np

from ..errors import InputError

# Chosen by eye on the synthetic flights of tests/test_ground.py and two real models; no script has tuned them.
MIN_POINTS = 50  # with fewer points no ground is looked for
NEAR_PLANE = 0.03  # a plane's points are within this share of the median distance to the nearest camera
TRIPLES = 1500  # of points, each of which proposes a plane
THIN = 1e-3  # area of a triple, in units of that distance squared, below which it defines no plane
OVERLOOKED = 0.9  # share of the cameras that are above the ground, at least
BEHIND = 0.5  # weight of a point below a plane, which counts against it; a point on it counts 1 for it
NO_WAY = 1e-6  # share of a vector's length that lies in a plane, below which it has no direction there
POINTS_FITTED = 10  # points near a plane that are needed to fit it to them


def no_ground() -> InputError:
    """The error if no ground is found."""
    return InputError(
        "no ground surface lies below the cameras of this reconstruction",
        "Views from above over mostly open ground are needed; models of facades or objects have no ground to stand on.",
    )


def plane_below(points: np.ndarray, centres: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Rotation (3, 3) `plane_from_world` whose third row is up: the normal of the plane that most points lie on.

    Random triples of points propose planes (RANSAC). A plane counts only if nearly all cameras are on one side of it;
    points in it count for it and points behind it against it, so that the ground wins over a roof or a canopy. The
    first row points from the cameras' mean towards the points' mean.
    """
    some = points[random.choice(len(points), min(len(points), 2000), replace=False)]
    few = centres[random.choice(len(centres), min(len(centres), 200), replace=False)]
    distance = np.median(np.linalg.norm(some[:, None] - few[None], axis=2).min(1))
    band = NEAR_PLANE * distance
    if not band > 0:
        raise no_ground()

    a, b, c = points[random.integers(0, len(points), (3, TRIPLES))]
    normals = np.cross(b - a, c - a)
    size = np.linalg.norm(normals, axis=1)
    usable = size > THIN * distance**2
    normals, a = normals[usable] / size[usable, None], a[usable]
    offset = (normals * a).sum(1)
    above = normals @ few.T - offset[:, None]
    normals *= np.where(np.median(above, axis=1) < 0, -1, 1)[:, None]
    offset = (normals * a).sum(1)

    overlooked = (normals @ few.T - offset[:, None] > band).mean(1) >= OVERLOOKED
    if not overlooked.any():
        raise no_ground()
    normals, offset = normals[overlooked], offset[overlooked]
    residual = normals @ some.T - offset[:, None]
    support = np.clip(1 - (residual / band) ** 2, 0, None).sum(1)
    best = np.argmax(support - BEHIND * (residual < -2 * band).sum(1))
    normal, middle = normals[best], normals[best] * offset[best]

    for width in (2.0, 1.5, 1.0):
        near = points[np.abs((points - middle) @ normal) < width * band]
        if len(near) < POINTS_FITTED:
            break
        middle = near.mean(0)
        refined = np.linalg.svd(near - middle, full_matrices=False)[2][2]
        normal = refined if refined @ normal > 0 else -refined
    if np.median((centres - middle) @ normal) <= band:
        raise no_ground()
    aside = _aside(normal, points.mean(0) - centres.mean(0))
    return np.stack([aside, np.cross(normal, aside), normal])


def _aside(normal: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(3,) unit vector in the plane of `normal`: the projection of `towards`, a direction that belongs to the scene.

    The axes of the world are used only if that is impossible: with them the result would change with the world's
    rotation.
    """
    along = towards - (towards @ normal) * normal
    if not np.linalg.norm(along) > NO_WAY * np.linalg.norm(towards):
        along = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    return along / np.linalg.norm(along)
