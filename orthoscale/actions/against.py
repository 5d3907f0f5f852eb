"""Matches the input to a georeferenced map of another date: its position and orientation there, and its scale.

The map's scale is further evidence besides the vehicles, with its own uncertainty. An orthophoto also takes its
position and orientation from the map. An uncertain match is not used, and a note says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..core.control import on_ground
from ..core.evidence import BY_MAP, Evidence
from ..core.measuring.footing import BY_POINTS, Footing
from ..core.progress import Progress
from ..core.projection.planar import square_pixels
from ..core.source import PosedSet, Source
from ..errors import TooLittleEvidence
from ..sources.on_map import OnMap

if TYPE_CHECKING:
    from ..locate.ground import SeenPlan
    from ..locate.register import Candidate, Registration
    from ..sources.satellite import Satellite

SCALES_AROUND = 4.0  # the map's scale is searched within this many sigmas of the vehicles' scale ...
LEAST_AROUND, MOST_AROUND = math.log(1.3), math.log(1.6)  # ... within these bounds: the map must be able to contradict
VIEWS_TRIED = 3  # number of a reconstruction's ground pictures that are tried, the largest first


def on_map(
    source: Source,
    satellite: Satellite,
    scale: tuple[float, float],
    cache: bool = True,
    progress: Progress | None = None,
    footing: Footing = BY_POINTS,
) -> OnMap:
    """Where `source` lies on the map `satellite`.

    scale : metres per unit known so far, and its relative one-sigma. cache : keep the map's features.
    footing : the ground of a reconstruction.
    Raises InputError if the map or the source is damaged.
    """
    around = float(np.clip(SCALES_AROUND * scale[1], LEAST_AROUND, MOST_AROUND))
    problems = []
    best: tuple[SeenPlan, Registration] | None = None
    for seen in (replace(each, gsd=each.gsd * scale[0]) for each in _pictures(source)):
        try:
            found = _registered(seen, satellite, around, cache, progress)
        except TooLittleEvidence as error:
            problems.append(error.message)
            continue
        if found.located is None:
            problems.append(found.problem)
        elif best is None or found.candidates[0].inliers > best[1].candidates[0].inliers:
            best = seen, found
    name = satellite.source.name
    if best is None:
        why = problems[0] if problems else "no picture of the ground from above"
        return OnMap(notes=(f"not found on {name}: {why}",))
    seen, found = best
    candidate = found.candidates[0]
    metres = scale[0] * candidate.scale
    says = f"its place on {name} ({candidate.inliers} matches, {found.needed} needed)"
    evidence = Evidence(BY_MAP, metres, found.scale_sd, says)
    note = _found_on(name, candidate)
    if source.plan is None:
        return OnMap((_with_ground(evidence, source, seen.picture.name, footing),), (note,), name=name)
    size = source.width, source.height
    return OnMap((evidence,), (note,), satellite.crs, _affine(seen, found, satellite), metres, size, name)


def _with_ground(found: Evidence, source: PosedSet, picture: str, footing: Footing) -> Evidence:
    """The evidence from the ground picture called `picture`, corrected to the ground of `footing`, with its error."""
    view = next(view for view in source.ground_pictures if view.name == picture)
    middle = view.ground(np.array([[view.width / 2, view.height / 2]]))
    lower = float(footing.at(middle)[0][0])
    return on_ground(
        replace(found, value=found.value / (1 + lower)), np.ones(1), footing.covariance(middle), footing.shared
    )


def _found_on(name: str, candidate: Candidate) -> str:
    """The note that the input was found on the map called `name`, at the place of `candidate`."""
    lon, lat = candidate.middle
    heading = round(math.degrees(candidate.heading)) % 360
    return f"found on {name} around longitude {lon:.6f}, latitude {lat:.6f}, heading {heading} degrees"


def _registered(
    seen: SeenPlan, satellite: Satellite, around: float, cache: bool, progress: Progress | None
) -> Registration:
    """`seen` matched to the map, in any orientation."""
    from ..locate.features import GradientFeatures
    from ..locate.register import Known, register

    known = Known((math.exp(-around), math.exp(around)))
    return register(seen, satellite, GradientFeatures(), known, cache, progress)


def _pictures(source: Source) -> Sequence[SeenPlan]:
    """Pictures of the ground from above, in source units: an orthophoto, or the ground pictures of a reconstruction
    that cover the largest area."""
    from ..locate.ground import SeenPlan

    if source.plan is not None:
        claimed = source.claimed
        return [SeenPlan(source, square_pixels(claimed.aspect), claimed.mirrored)]
    views = [view for view in source.ground_pictures if view.frame is not None]
    views.sort(key=lambda view: view.width * view.height * view.unit_per_pixel**2, reverse=True)
    return [SeenPlan(view, view.unit_per_pixel) for view in views[:VIEWS_TRIED]]


def _affine(seen: SeenPlan, found: Registration, satellite: Satellite) -> np.ndarray:
    """(2, 3) affine transform from the orthophoto's pixels to the map's coordinates, by the match."""
    size = np.array([seen.picture.width, seen.picture.height], float)
    corners = np.array([[0, 0], [size[0], 0], [0, size[1]]]) * seen.gsd
    if seen.mirrored:
        corners[:, 0] = seen.size[0] - corners[:, 0]
    first, right, down = satellite.coordinates(found.candidates[0].map_pixels(corners))
    return np.column_stack([(right - first) / size[0], (down - first) / size[1], first])
