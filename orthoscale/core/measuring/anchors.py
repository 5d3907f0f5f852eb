"""Anchors in pictures become votes on the ground of their source: one each, however many pictures show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..anchors import Anchor, AnchorVote, alike
from ..pooling.anchors import SHARED
from ..source import GroundView
from .surroundings import GROUND_SD

FRAMES_APART = 2.0  # how far frames may place one line apart, in GROUND_SD of the camera's height


def votes_in_plan(anchors: Sequence[Anchor], window: float) -> list[AnchorVote]:
    """Those of an orthophoto, whose unit is its pixel. window : see `AnchorVote`."""
    return [AnchorVote(a, a.place, a.pixels, a.relative_sd, window=window) for a in anchors]


def votes_in_model(anchors: Sequence[Anchor], views: Mapping[str, GroundView], window: float) -> list[AnchorVote]:
    """Those in the pictures of the ground `views`, by their names: what lies in one place is one anchor.

    Its size is the mean of what the pictures give, each by its variance; half of that they share (`SHARED`).
    """
    votes = []
    for kind in dict.fromkeys(anchor.kind for anchor in anchors):
        these = [anchor for anchor in anchors if anchor.kind == kind]
        lines = [_on_ground(views[a.picture], a) for a in these]
        units = np.array([a.pixels * _unit(a, ground) for a, ground in zip(these, lines, strict=True)])
        blur = FRAMES_APART * GROUND_SD * float(np.median([views[a.picture].camera_height for a in these]))
        number = alike(lines, units.tolist(), blur)
        for k in np.unique(number):
            members = np.flatnonzero(number == k)
            variance = np.array([these[m].relative_sd for m in members]) ** 2
            weight = 1 / variance / (1 / variance).sum()
            best = min(members.tolist(), key=lambda m: (these[m].false, these[m].relative_sd))
            votes.append(
                AnchorVote(
                    anchor=these[best],
                    place=views[these[best].picture].ground(these[best].place[None])[0],
                    units=float(np.exp(weight @ np.log(units[members]))),
                    relative_sd=float(np.sqrt(SHARED * weight @ variance + (1 - SHARED) * weight**2 @ variance)),
                    shared_sd=GROUND_SD,
                    window=window,
                    views=len(members),
                )
            )
    return votes


def _on_ground(view: GroundView, anchor: Anchor) -> np.ndarray:
    """(L, 2, 3) the anchor's lines on the ground [model units]."""
    return view.ground(anchor.lines.reshape(-1, 2)).reshape(-1, 2, 3)


def _unit(anchor: Anchor, ground: np.ndarray) -> float:
    """Model units per pixel where the anchor lies, by its lines in the picture and on the `ground`."""
    lengths = [float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()) for lines in (ground, anchor.lines)]
    return lengths[0] / lengths[1]
