"""Merges the views of each anchor into one vote on the ground of the source, however many pictures show it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..anchors import Anchor, AnchorVote, alike
from ..pooling.anchors import SHARED
from ..scale import Scale
from ..source import GroundView
from .footing import GROUND_SD

FRAMES_APART = 2.0  # how far frames may place one line, or one middle, apart, in GROUND_SD of the camera's height
# One sigma by which frames place one thing apart that lies on the ground, as a share of the camera's height, as if that
# had been seen PLACED_LIKE times; what more is seen decides more.
PLACED_SD, PLACED_LIKE = 0.003, 4
LEAST_HEIGHT_SD = 0.003  # of what many frames see, as a share of the camera's height: poses bend, grounds tilt


@dataclass(frozen=True)
class FoundAnchors:
    """What a search found: anchors in their pictures, and the votes that they make on the ground. without : the scale
    before any of that was known. notes : what a user should know of the search."""

    anchors: tuple[Anchor, ...] = ()
    votes: tuple[AnchorVote, ...] = ()
    without: Scale | None = None
    notes: tuple[str, ...] = ()


def votes_in_plan(anchors: Sequence[Anchor], window: float) -> list[AnchorVote]:
    """Those of an orthophoto, whose unit is its pixel. window : see `AnchorVote`."""
    return [AnchorVote(a, a.place, a.pixels, a.relative_sd, window=window) for a in anchors]


def votes_in_model(
    anchors: Sequence[Anchor], views: Mapping[str, GroundView], centre: Callable[[str], np.ndarray], window: float
) -> list[AnchorVote]:
    """Those in the pictures of the ground `views`, by their names: what lies in one place is one anchor.

    Its size is the mean of what the pictures give, each by its variance; half of that they share (`SHARED`).
    centre : (3,) of the camera of the frame of a name [model units]. Where frames see a single thing from different
    places, they tell how high it lies, which the ground does to 1 % of the camera's height only; and those that place
    it elsewhere than most took something else for a part of it.
    """
    votes = []
    for kind in dict.fromkeys(anchor.kind for anchor in anchors):
        these = [anchor for anchor in anchors if anchor.kind == kind]
        lines = [_on_ground(views[a.picture], a) for a in these]
        units = np.array([a.pixels * _unit(a, ground) for a, ground in zip(these, lines, strict=True)])
        height = np.array([views[a.picture].camera_height for a in these])
        number = alike(lines, units.tolist(), FRAMES_APART * GROUND_SD * float(np.median(height)))
        for k in np.unique(number):
            members = np.flatnonzero(number == k)
            height_sd, ground_sd = 0.0, GROUND_SD
            if all(these[m].count == 1 for m in members):  # of a row, each frame may show another part
                places = np.array([views[these[m].picture].ground(these[m].place[None])[0] for m in members])
                away = np.linalg.norm(places - np.median(places, axis=0), axis=1) / height[members]
                near = away <= max(FRAMES_APART * GROUND_SD, float(np.median(away)))
                members, places = members[near], places[near]
                cameras = np.array([centre(views[these[m].picture].image) for m in members])
                above, height_sd, ground_sd = _height_above(places, cameras, height[members])
                units[members] *= 1 - above / height[members]
            variance = np.array([these[m].relative_sd for m in members]) ** 2
            weight = 1 / variance / (1 / variance).sum()
            fit = SHARED * weight @ variance + (1 - SHARED) * weight**2 @ variance
            best = min(members.tolist(), key=lambda m: (these[m].false, these[m].relative_sd))
            votes.append(
                AnchorVote(
                    anchor=these[best],
                    place=views[these[best].picture].ground(these[best].place[None])[0],
                    units=float(np.exp(weight @ np.log(units[members]))),
                    relative_sd=float(np.sqrt(fit + height_sd**2)),
                    shared_sd=ground_sd,
                    window=window,
                    views=len(members),
                )
            )
    return votes


def _height_above(places: np.ndarray, cameras: np.ndarray, height: np.ndarray) -> tuple[float, float, float]:
    """How high above the ground something lies that frames place at `places` (N, 3) on the ground, from `cameras`
    (N, 3) at `height` (N,) above it [all in model units]; and two one-sigmas of that, as shares of the mean height:
    by the frames, and by the ground, with which all else errs that lies there.

    What lies `h` above the ground is where the rays are at that height, at places + h * ray, and there frames agree:
    least squares, with the ground's own uncertainty as a prior.
    """
    ray = (cameras - places) / height[:, None]
    mean = float(height.mean())
    ray, place = ray - ray.mean(0), (places - places.mean(0)) / mean
    spread, parallax, placed = float((ray**2).sum()), -float((ray * place).sum()), PLACED_SD**2
    for _ in range(2):
        above = parallax / (spread + placed / GROUND_SD**2)
        left = float(((place + above * ray) ** 2).sum())
        placed = (PLACED_LIKE * PLACED_SD**2 + left) / (PLACED_LIKE + 2 * (len(places) - 1))
    by_frames = spread / (spread + placed / GROUND_SD**2)
    seen_sd = float(np.hypot(np.sqrt(placed / max(spread, placed)), LEAST_HEIGHT_SD))
    return above * mean, by_frames * seen_sd, (1 - by_frames) * GROUND_SD


def _on_ground(view: GroundView, anchor: Anchor) -> np.ndarray:
    """(L, 2, 3) the anchor's lines on the ground [model units]."""
    return view.ground(anchor.lines.reshape(-1, 2)).reshape(-1, 2, 3)


def _unit(anchor: Anchor, ground: np.ndarray) -> float:
    """Model units per pixel where the anchor lies, by its lines in the picture and on the `ground`."""
    lengths = [float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()) for lines in (ground, anchor.lines)]
    return lengths[0] / lengths[1]
