"""Merges all views of an anchor into one vote on the ground of the source."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from ..anchors import Anchor, AnchorVote, alike
from ..pooling.anchors import SHARED
from ..scale import Scale
from ..source import GroundView
from .footing import BY_POINTS, GROUND_SD, Footing

# How far two frames may place one line, or one centre, apart, in units of GROUND_SD times the camera's height.
FRAMES_APART = 2.0
# Prior of how far frames scatter in placing one thing on the ground: one sigma as a share of the camera's height, with
# the weight of PLACED_LIKE observations.
PLACED_SD, PLACED_LIKE = 0.003, 4
# Least one sigma of the height of a thing that many frames see, as a share of the camera's height: models are bent, and
# the ground is tilted.
LEAST_HEIGHT_SD = 0.003


@dataclass(frozen=True)
class FoundAnchors:
    """What a search found: the anchors in their pictures, and their votes on the ground. without : the scale before the
    search. notes : what a user should know about the search."""

    anchors: tuple[Anchor, ...] = ()
    votes: tuple[AnchorVote, ...] = ()
    without: Scale | None = None
    notes: tuple[str, ...] = ()


def votes_in_plan(anchors: Sequence[Anchor], window: float) -> list[AnchorVote]:
    """The votes of the anchors in an orthophoto, whose unit is its pixel. window : see `AnchorVote`."""
    return [AnchorVote(a, a.place, a.pixels, a.relative_sd, window=window) for a in anchors]


def votes_in_model(
    anchors: Sequence[Anchor],
    views: Mapping[str, GroundView],
    centre: Callable[[str], np.ndarray],
    window: float,
    footing: Footing = BY_POINTS,
) -> list[AnchorVote]:
    """The votes of anchors in ground pictures; those of one kind that lie in one place are one anchor.

    views : the ground pictures, by name. centre : gives the (3,) camera centre of the frame of a name [model units].
    footing : the ground on which the anchors lie. window : see `AnchorVote`.

    An anchor's size is the mean over its pictures, weighted by their inverse variances; half of the variance is common
    to all of them (`SHARED`). Where frames see a single thing from different places, they also give its height, which
    the ground alone gives to 1 % of the camera's height only. Frames that place it elsewhere than most do are left out:
    they took something else for a part of it.
    """
    votes = []
    for kind in dict.fromkeys(anchor.kind for anchor in anchors):
        these = [_OnGround.of(a, views[a.picture], centre, footing) for a in anchors if a.kind == kind]
        blur = FRAMES_APART * GROUND_SD * float(np.median([one.height for one in these]))
        number = alike([one.lines for one in these], [one.units for one in these], blur)
        votes += [_vote([these[m] for m in np.flatnonzero(number == k)], footing, window) for k in np.unique(number)]
    return votes


@dataclass(frozen=True)
class _OnGround:
    """An anchor on the ground, as one frame shows it. lines : (L, 2, 3), place : (3,) its centre, units : its reference
    length, camera : (3,) the frame's camera centre, height : of the camera above the ground; all [model units].
    ground_sd : one sigma of the ground's height there, as from `Footing.at`."""

    anchor: Anchor
    lines: np.ndarray
    place: np.ndarray
    units: float
    camera: np.ndarray
    height: float
    ground_sd: float

    @classmethod
    def of(cls, anchor: Anchor, view: GroundView, centre: Callable[[str], np.ndarray], footing: Footing) -> _OnGround:
        """`anchor` in the picture `view`, where the ground is that of `footing`."""
        camera, place = centre(view.image), view.ground(anchor.place[None])
        lower, each = (float(v[0]) for v in footing.at(place))
        lines, place = (camera + (p - camera) * (1 + lower) for p in (_lines(view, anchor), place[0]))
        units = anchor.pixels * _unit(anchor, lines)
        return cls(anchor, lines, place, units, camera, view.camera_height * (1 + lower), each)


def _vote(seen: Sequence[_OnGround], footing: Footing, window: float) -> AnchorVote:
    """The vote of one anchor that was `seen` in one frame or several."""
    height_sd, ground_sd = float(np.median([one.ground_sd for one in seen])), footing.shared
    larger = np.ones(len(seen))
    if all(one.anchor.count == 1 for one in seen):  # no rows: each frame may show another part of a row
        places, height = np.array([one.place for one in seen]), np.array([one.height for one in seen])
        away = np.linalg.norm(places - np.median(places, axis=0), axis=1) / height
        near = away <= max(FRAMES_APART * GROUND_SD, float(np.median(away)))
        seen, places, height = list(compress(seen, near)), places[near], height[near]
        cameras = np.array([one.camera for one in seen])
        above, seen_sd, by_ground = _height_above(places, cameras, height, float(np.hypot(height_sd, ground_sd)))
        height_sd, ground_sd = float(np.hypot(seen_sd, by_ground * height_sd)), by_ground * ground_sd
        larger = 1 - above / height
    variance = np.array([one.anchor.relative_sd for one in seen]) ** 2
    weight = 1 / variance / (1 / variance).sum()
    fit = SHARED * weight @ variance + (1 - SHARED) * weight**2 @ variance
    best = min(seen, key=lambda one: (one.anchor.false, one.anchor.relative_sd))
    return AnchorVote(
        anchor=best.anchor,
        place=best.place,
        units=float(np.exp(weight @ np.log([one.units for one in seen] * larger))),
        relative_sd=float(np.sqrt(fit + height_sd**2)),
        shared_sd=ground_sd,
        window=window,
        views=len(seen),
    )


def _height_above(
    places: np.ndarray, cameras: np.ndarray, height: np.ndarray, ground_sd: float
) -> tuple[float, float, float]:
    """How high above the ground a thing lies [model units]; one sigma of that by the frames, as a share of the mean
    camera height; and the share of the ground's error that is left in it.

    places : (N, 3) where the frames place it on the ground. cameras : (N, 3) their camera centres. height : (N,) these
    above the ground; all [model units]. ground_sd : one sigma of the ground, as a share of the height.

    A thing that is `h` above the ground is at places + h * ray, where all frames agree. So `h` is found by least
    squares, with the ground's own uncertainty as a prior.
    """
    ray = (cameras - places) / height[:, None]
    mean = float(height.mean())
    ray, place = ray - ray.mean(0), (places - places.mean(0)) / mean
    spread, parallax, placed = float((ray**2).sum()), -float((ray * place).sum()), PLACED_SD**2
    for _ in range(2):
        above = parallax / (spread + placed / ground_sd**2)
        left = float(((place + above * ray) ** 2).sum())
        placed = (PLACED_LIKE * PLACED_SD**2 + left) / (PLACED_LIKE + 2 * (len(places) - 1))
    by_frames = spread / (spread + placed / ground_sd**2)
    seen_sd = float(np.hypot(np.sqrt(placed / max(spread, placed)), LEAST_HEIGHT_SD))
    return above * mean, by_frames * seen_sd, 1 - by_frames


def _lines(view: GroundView, anchor: Anchor) -> np.ndarray:
    """(L, 2, 3) the anchor's lines on the surface below the sparse points [model units]."""
    return view.ground(anchor.lines.reshape(-1, 2)).reshape(-1, 2, 3)


def _unit(anchor: Anchor, ground: np.ndarray) -> float:
    """Model units per pixel at the anchor, by its lines in the picture and on the `ground` (L, 2, 3)."""
    lengths = [float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()) for lines in (ground, anchor.lines)]
    return lengths[0] / lengths[1]
