"""The anchors of a report: as plain values, and as a layer for GIS."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.affine import transformed
from ..core.anchors import AnchorVote, size_in_words
from ..core.source import Placement
from ..formats.vector import write_layer

COLUMNS_OF_LAYER = ("kind", "standard", "metres", "scale", "relative_sd", "count", "residual_cm")
FITS = 3.0  # an anchor within this many sigmas of the scale counts as one of those that gave it


def entries(votes: Sequence[AnchorVote], metres_per_unit: float, counted: Collection[str] = ()) -> list[dict[str, Any]]:
    """One object for each anchor, at the scale `metres_per_unit`. counted : the kinds that entered that scale.

    ``standard`` is the likeliest at that scale, ``standards`` are all that are possible; ``scale`` is what the anchor
    alone would give, ``relative_sd`` its one sigma, the standard's included. ``lines_px`` are line segments, each from
    end to end, in ``picture``.
    """
    return [_entry(vote, metres_per_unit, vote.anchor.kind in counted) for vote in votes]


def size_of(entry: Mapping[str, Any]) -> str:
    """The standard of one of the `entries` and its size, for people."""
    rows = f"{entry['count']} in a row" if entry["count"] > 1 else ""
    return size_in_words(entry["standard"], entry["metres"], rows)


def _entry(vote: AnchorVote, metres_per_unit: float, of_use: bool) -> dict[str, Any]:
    anchor = vote.anchor
    metres = np.array([standard.metres for standard in anchor.standards])
    rule = np.array([standard.relative_sd for standard in anchor.standards])
    sd = np.sqrt(vote.relative_sd**2 + vote.shared_sd**2 + vote.kind_sd**2 + rule**2)
    off = np.log(metres / vote.units / metres_per_unit) / sd
    share = np.array([standard.prior for standard in anchor.standards]) * np.exp(-0.5 * (off**2 - (off**2).min())) / sd
    best = int(np.argmax(share))
    centimetres = 100 * anchor.residual * vote.units / anchor.pixels * metres_per_unit
    return {
        "kind": anchor.kind,
        "standard": anchor.standards[best].name,
        "source": anchor.standards[best].source,
        "metres": float(metres[best]),
        "standards": [
            {"name": s.name, "metres": s.metres, "share": float(p)}
            for s, p in zip(anchor.standards, share / share.sum(), strict=True)
        ],
        "scale": float(metres[best] / vote.units),
        "relative_sd": float(sd[best]),
        "false": anchor.false,
        "counted": of_use and not anchor.unlike and bool(abs(off[best]) <= FITS),
        "count": anchor.count,
        "views": vote.views,
        "picture": anchor.picture,
        "place_px": [round(float(v), 2) for v in anchor.place],
        "pixels": float(anchor.pixels),
        "lines_px": np.round(anchor.lines, 2).tolist(),
        "residual_cm": float(np.sqrt(np.mean(centimetres**2))) if len(centimetres) else 0.0,
        "place_unit": [float(v) for v in vote.place],
    }


def write_anchor_layer(anchors: Sequence[Mapping[str, Any]], place: Placement, path: Path) -> None:
    """Write a report's `anchors` of an orthophoto as lines in the coordinates of `place`: the layer ``anchors`` of the
    GeoPackage at `path`, which may have other layers. Raises OSError."""
    import shapely

    shapes, rows = [], []
    for anchor in anchors:
        lines = transformed(np.array(anchor["lines_px"]).reshape(-1, 2, 2), place.transform)
        shapes.append(shapely.multilinestrings(shapely.linestrings(lines)))
        rows.append({name: anchor[name] for name in COLUMNS_OF_LAYER})
    write_layer(path, "anchors", shapes, rows, "MultiLineString", place.crs)
