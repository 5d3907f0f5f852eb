"""A source seen from above: the plan on which its vehicles, and the points of a model, are drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

if TYPE_CHECKING:
    from ..sources.colmap import ColmapSource
    from ..sources.raster import RasterSource
    from ..sources.source import Source


def from_above(source: Source, place: np.ndarray) -> np.ndarray:
    """(N, 2) places on a plan, x right and y up [source units], of places in the source's own coordinates.

    An orthophoto's plan is itself, from its lower left corner; a model's looks down on its ground, and which way north
    lies is not known.
    """
    if source.unit == "m/px":
        return np.stack([place[:, 0], cast("RasterSource", source).height - place[:, 1]], -1)
    return cast("ColmapSource", source).ground.plane(place)
