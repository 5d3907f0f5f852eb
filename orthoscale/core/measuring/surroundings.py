"""Evidence of the scale in the boxes besides vehicle sizes: rows of parked vehicles, objects of standard size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..anchors import AnchorVote
from ..boxes import Boxes
from ..pooling.anchors import evidence_of
from ..pooling.posterior import Posterior
from ..projection.exact import BODIES, FLAT, ground_axes, ground_size
from ..projection.own_ruler import SeenBoxes
from ..projection.view import Views
from ..source import PosedSet
from ..votes import Sightings, Votes, gather
from .footing import BY_POINTS, Footing
from .objects import standard_objects
from .parking import parking_pitch

CLEAR_OF_BORDER = 3.0  # [px] from a frame's border; nearer to it, an object may be cut off


@dataclass(frozen=True)
class Standards:
    """Sizes of standardised things other than vehicles. stalls : of car parks, by country, as in ``data/stalls.json``.
    objects : by class, as in ``data/objects.json``."""

    stalls: dict[str, dict[str, Any]]
    objects: dict[str, list[dict[str, Any]]]


def rows_in_plan(votes: Votes, along: np.ndarray, standards: Standards, country: str) -> list[AnchorVote]:
    """The pitch of parking rows in an orthophoto, if there are any.

    votes : of single boxes, `size` without the margin. along : (N, 2) unit vectors of their long sides. country : as
    for `parking_pitch`.
    """
    found = parking_pitch(votes.place, along, votes.size, standards.stalls, country)
    return [] if found is None else [found]


def objects_in_plan(objects: Mapping[str, Boxes], zoom: float, standards: Standards) -> list[AnchorVote]:
    """Objects of standard size in an orthophoto. objects : boxes by class. zoom : detector pixels per picture pixel."""
    return [
        vote
        for kind, boxes in objects.items()
        for vote in standard_objects(
            kind,
            standards.objects.get(kind, []),
            boxes.sides,
            np.full(len(boxes), 1 / zoom),
            boxes.centre,
        )
    ]


def rows_in_model(
    votes: Votes, along: np.ndarray, standards: Standards, country: str, footing: Footing = BY_POINTS
) -> list[AnchorVote]:
    """The pitch of parking rows on a reconstruction's ground, if there are any.

    Each vehicle counts at one place, however often it was seen. Those that most frames of their place miss are left
    out.

    votes : of vehicles, `place` (N, 3) in world coordinates, `size` without the margin. along : (M, 3) unit vectors of
    the long sides of all boxes, in world coordinates. country : as for `parking_pitch`. footing : the ground on which
    the vehicles stand.
    """
    kept = ~votes.fleeting
    members = [m for m, keep in zip(votes.members, kept, strict=True) if keep]
    axes = np.array([_mean_axis(along[m]) for m in members]).reshape(-1, 3)
    found = parking_pitch(votes.place[kept], axes, votes.size[kept], standards.stalls, country)
    return [] if found is None else [_on_ground(found, footing)]


def world_axes(source: PosedSet, names: np.ndarray, boxes: Boxes, views: Views) -> np.ndarray:
    """(N, 3) unit vectors along the long sides of boxes (N,) in the frames `names` (N,), in world coordinates."""
    along, _ = ground_axes(boxes, views)
    out = np.empty_like(along)
    for name in np.unique(names):
        here = names == name
        out[here] = along[here] @ source.rotation(str(name))
    return out


def objects_in_model(
    source: PosedSet,
    objects: Mapping[str, Mapping[str, Boxes]],
    zoom: float,
    metres_per_unit: float,
    known: Standards,
    footing: Footing = BY_POINTS,
) -> list[AnchorVote]:
    """Objects of standard size in a reconstruction's frames, one vote for each object however many frames show it.

    objects : boxes by frame and class. zoom : detector pixels per picture pixel. metres_per_unit : the current scale,
    for the heights of objects that are not flat. footing : the ground on which they stand.

    The effective height of boxes around objects has not been measured: half the object's height is assumed, and the
    range from none to all of it is part of the uncertainty.
    """
    found = []
    for kind, standards in known.objects.items():
        each = {name: kinds[kind] for name, kinds in objects.items() if kind in kinds}
        if (seen := _on_the_ground(source, each, footing)) is None:
            continue
        boxes, view, place = seen
        tall = max(s["height"][0] if "height" in s else FLAT for s in standards)
        in_frames = SeenBoxes(boxes, view, zoom, metres_per_unit)
        by_height = [_objects(kind, standards, in_frames, place, height) for height in (tall / 2, tall, FLAT)]
        middle, whole, none = by_height
        unsure = 0.0
        if tall > FLAT and all(by_height):
            # Compare the heights by this one standard, even where the box's shape would then fit another better.
            likely = evidence_of(middle)[0]
            about = Posterior.normal(float(np.log(likely.value)), likely.relative_sd)
            scales = [evidence_of(votes)[0].meant(about).value for votes in (whole, none)]
            unsure = abs(float(np.log(scales[0] / scales[1]))) / np.sqrt(12)  # uniform distribution in between
        for vote in middle:
            found.append(_on_ground(vote, footing, unsure))
    return found


def _on_the_ground(
    source: PosedSet, each: Mapping[str, Boxes], footing: Footing
) -> tuple[Boxes, Views, np.ndarray] | None:
    """The boxes of `each` frame that show whole objects on the ground of `footing`, their views and their places (N, 3)
    [source units]; None if there are none."""
    parts, views, places = [], [], []
    for name, boxes in each.items():
        boxes = boxes[boxes.inside(*source.image_size(name), CLEAR_OF_BORDER)]
        if not len(boxes):
            continue
        view, place, ok = source.views(name, boxes.centre)
        farther = 1 + footing.at(place)[0][:, None]
        parts.append(boxes[ok])
        views.append(replace(view, ground=view.ground * farther)[ok])
        places.append((source.centre(name) + (place - source.centre(name)) * farther)[ok])
    if not sum(map(len, parts)):
        return None
    return Boxes.concatenate(parts), Views.concatenate(views), np.concatenate(places)


def _on_ground(vote: AnchorVote, footing: Footing, unsure: float = 0.0) -> AnchorVote:
    """`vote` with the errors of the ground of `footing`, and with one sigma `unsure` common to all of its kind."""
    own = np.hypot(vote.relative_sd, footing.at(vote.place[None])[1][0])
    return replace(vote, relative_sd=float(own), shared_sd=footing.shared, kind_sd=unsure)


def _objects(
    kind: str, standards: Sequence[Mapping[str, Any]], seen: SeenBoxes, place: np.ndarray, height: float
) -> list[AnchorVote]:
    """The objects of class `kind` at `place` (N, 3) if all are as high as `height` [m]."""
    solid = replace(BODIES["cuboid"], height=height)
    size = ground_size(seen.boxes, seen.views, seen.metres_per_unit, solid)
    solved = np.isfinite(size).all(1)
    size = np.sort(size[solved], axis=1)[:, ::-1]  # foreshortened, the longer side may be the box's shorter one
    pixel = seen.views.unit_per_pixel[solved] / seen.zoom
    votes = gather(Sightings(size, pixel, place[solved], seen.boxes.score[solved]), repeated=True)
    return standard_objects(kind, standards, votes.size, votes.pixel, votes.place)


def _mean_axis(directions: np.ndarray) -> np.ndarray:
    """(3,) the mean axis of unit vectors (K, 3), whichever way each points along it."""
    return np.linalg.eigh(directions.T @ directions)[1][:, -1]
