"""Simple orthophotos, and files with the outlines of lots in them."""

from __future__ import annotations

import json

import cv2

from orthoscale.sources.raster import RasterSource

from .pictures import squares


def orthophoto(folder, gsd=0.1, size=(700, 500), report=None):
    """A picture in local metres, as `orthoscale fix` writes it."""
    cv2.imwrite(str(folder / "plain.png"), squares(*size, 90, 150))
    path = folder / "scaled.tif"
    with RasterSource.open(folder / "plain.png") as source:
        source.write(path, gsd)
    if report:
        (folder / "scaled.tif.json").write_text(json.dumps(report))
    return path


def lot_file(path, ring, crs=None):
    text = {"type": "Polygon", "coordinates": [[list(map(float, p)) for p in [*ring, ring[0]]]]}
    path.write_text(json.dumps(text))
    return path
