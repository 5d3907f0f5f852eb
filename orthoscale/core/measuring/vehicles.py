"""The measured vehicles as a table, one row each: the only place where their sizes in metres are computed."""

from __future__ import annotations

import numpy as np

from ..boxes import KINDS, Boxes
from ..scale import Scale
from ..votes import Votes

# One row of `vehicle_table`. Everything that shows a vehicle (JSON, page, GeoPackage, drift) reads these fields.
VEHICLE = np.dtype(
    [
        ("length", float),  # [m], without the detector's margin
        ("width", float),
        ("length_unit", float),  # the same in units of the source: pixels of an orthophoto, a model's own
        ("width_unit", float),
        ("x_unit", float),  # where it stands, in the source's own coordinates; z is 0 in an orthophoto
        ("y_unit", float),
        ("z_unit", float),
        ("scale_deviation", float),  # log scale by it alone, less the mean of those that count
        ("views", int),  # number of boxes that show it
        ("score", float),  # of its best box
        ("kind", object),  # the likeliest of `boxes.KINDS`, '' if unknown
        ("used", bool),
        ("reason", object),  # why it does not count, '' where it does
        ("picture", object),  # name of the picture of its best box
        ("cx_px", float),  # the best box: centre, sides (with margin), angle of the long side [rad], as in `Boxes`
        ("cy_px", float),
        ("box_length_px", float),
        ("box_width_px", float),
        ("angle", float),
    ]
)


def vehicle_table(votes: Votes, size: np.ndarray, scale: Scale, boxes: Boxes, picture: np.ndarray) -> np.ndarray:
    """(N,) structured array of VEHICLE, in the order of the `votes`.

    size : (N, 2) length and width of the votes' vehicles, the margin taken off [source units]. boxes : all M, which
    `votes.members` are indices of. picture : (M,) name of the picture of each.
    """
    table = np.zeros(len(votes), VEHICLE)
    table["length_unit"], table["width_unit"] = size.T
    table["length"], table["width"] = (size * scale.value).T
    for name, column in zip(("x_unit", "y_unit", "z_unit"), votes.place.T, strict=False):
        table[name] = column
    table["scale_deviation"] = _deviation(size, scale)
    table["views"], table["score"] = votes.views, votes.score
    table["used"], table["reason"] = scale.used, scale.reasons
    table["kind"] = _kind(votes)
    if len(votes):
        best = np.array([members[np.argmax(boxes.score[members])] for members in votes.members])
        table["picture"] = picture[best]
        fields = ["cx_px", "cy_px", "box_length_px", "box_width_px", "angle"]
        for name, column in zip(fields, boxes.xylwa[best].T, strict=True):
            table[name] = column
    return table


def _kind(votes: Votes) -> list[str]:
    return [KINDS[int(np.argmax(one))] if np.isfinite(one).all() else "" for one in votes.kinds]


def _deviation(size: np.ndarray, scale: Scale) -> np.ndarray:
    """(N,) log scale by each vehicle of `size` (N, 2) alone, less the mean of those that count."""
    log_scale = -np.log(size) @ np.asarray(scale.weights)
    return log_scale - log_scale[scale.used].mean() if scale.used.any() else log_scale
