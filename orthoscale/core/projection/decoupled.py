"""The paper's decoupled stereoscopic projection (arXiv 2603.07535), and what it leaves out.

It looks at a vehicle across the viewing ray. There its ground extent along the ray's azimuth (radial) is foreshortened
and its height adds to it; its extent across (tangential) is seen in full. So length and width, each by itself, appear
as effective extents ``L_eff`` and ``W_eff`` [m] at the distance ``altitude / sin a``, and one box side l [px] gives

    s = L_eff sin a / l        metres per pixel of the nadir view from the same altitude, altitude = s f.

This assumes that a pixel covers ``1/f`` of the distance. In a flat image it covers ``1/f`` of the depth, which is
shorter by ``|ray| / f``, the length of the pixel's ray in focal lengths: the authors' program has that factor, the text
does not. Neither has the second such factor, by which a flat image stretches radially. Its absence alone makes scales
at nadir 5 % too small with DenseUAV's camera and 3 % with UAV-VisLoc's (benchmarks/projection_bias.py), so the
program's other factor, 1.05, may well make up for it.

orthoscale measures with `exact`; this is for comparison and cross-checks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..boxes import Boxes
from .height import radial_cosine
from .view import Views

PRIORS = (4.4, 1.9, 1.6)  # length, width, height [m] of a small vehicle in the paper


@dataclass(frozen=True)
class Variant:
    """Which formula; ``dataclasses.replace(PROGRAM, factor=1.0)`` makes another.

    effective : extents seen across the ray, foreshortened and with the height; else length and width as they are.
    ray_length : pixels measured at the vehicle's depth (``|ray| / f``); else at its distance.
    factor : by which the scale is multiplied in the end.
    """

    effective: bool = True
    ray_length: bool = True
    factor: float = 1.0


TEXT = Variant(ray_length=False)  # as printed
PROGRAM = Variant(factor=1.05)  # as the authors' program computes; the text mentions neither difference
NAIVE = Variant(effective=False)  # the box's edges are the vehicle's: L/l metres per pixel where it stands


def ground_size(
    boxes: Boxes, views: Views, priors: tuple[float, float, float] = PRIORS, variant: Variant = TEXT
) -> np.ndarray:
    """(N, 2) length and width of each vehicle on the ground [units of `views`].

    Length (width) over size is the scale by lengths (by widths). The model needs to know the vehicle it measures: how
    far height and foreshortening change a side depends on `priors`, length, width and height in metres.
    """
    seen = _effective(boxes, views, priors) if variant.effective else np.array([priors[:2]])
    reach = views.ground[:, 2] if variant.ray_length else np.linalg.norm(views.ground, axis=1)
    metres_per_unit = variant.factor * seen / boxes.sides * (views.focal / reach)[:, None]
    return np.asarray(priors[:2]) / metres_per_unit


def paper_scale(
    boxes: Boxes, views: Views, priors: tuple[float, float, float] = PRIORS, variant: Variant = TEXT
) -> np.ndarray:
    """(N,) metres per unit of `views`: the mean of the scales by length and by width, as in the paper."""
    return (np.asarray(priors[:2]) / ground_size(boxes, views, priors, variant)).mean(1)


def focal_plane_scale(boxes: Boxes, views: Views, variant: Variant = TEXT) -> np.ndarray:
    """(N, 2) the paper's ``s_len, s_wid``: metres per pixel of the nadir view from the same altitude.

    The unit of `views` does not enter, nor does the altitude: ``s = metres_per_unit * altitude_in_units / f``.
    """
    altitude_units = -(views.ground * views.normal).sum(1)
    scale = np.asarray(PRIORS[:2]) / ground_size(boxes, views, variant=variant)
    return scale * (altitude_units / views.focal)[:, None]


def relative_orientation(boxes: Boxes, views: Views) -> np.ndarray:
    """(N,) the paper's angle g between a vehicle's long side and the radial direction, in 0..pi/2 [rad].

    Measured on the ground, where ``L cos g`` and ``L sin g`` are lengths; radial is the viewing ray's azimuth. Straight
    below the camera there is no azimuth, and pi/2 is returned: ``L_eff`` does not depend on it there.
    """
    return np.arccos(radial_cosine(boxes, views))


def _effective(boxes: Boxes, views: Views, priors: tuple[float, float, float]) -> np.ndarray:
    """(N, 2) extents across the ray [m], ``L_eff = hypot((L sin a + H cos a) cos g, L sin g)``; W_eff with g turned."""
    length, width, height = priors
    a, g = views.elevation, relative_orientation(boxes, views)
    return np.stack(
        [
            np.hypot((length * np.sin(a) + height * np.cos(a)) * np.cos(g), length * np.sin(g)),
            np.hypot((width * np.sin(a) + height * np.cos(a)) * np.sin(g), width * np.cos(g)),
        ],
        -1,
    )
