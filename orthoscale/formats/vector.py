"""Writes shapes with attributes into GIS files, through GDAL."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .degrees import WGS_84
from .names import finite, in_utf8, json_in_utf8
from .plain_path import writable

DRIVERS = {".gpkg": "GPKG", ".geojson": "GeoJSON"}


def write_layer(
    path: Path, layer: str, shapes: Sequence[Any], rows: Sequence[Mapping[str, Any]], kind: str, crs: Any
) -> None:
    """Write shapely `shapes` (None for no place) of one `kind` ("Polygon" ...) with their `rows` as one layer.

    The file's ending gives the format: .gpkg (layers are added to an existing file) or .geojson (one layer only).
    All rows have the same keys; None and numbers that are not finite are missing values, and texts are escaped by
    `in_utf8`. `crs` is a text that GDAL understands, a CRS of rasterio or pyproj, or None. Raises OSError.
    """
    import pyogrio
    import shapely

    suffix, text = path.suffix.lower(), _text(crs)
    named = text if suffix == ".geojson" and text != WGS_84 else None
    columns = [_column([finite(row[name]) for row in rows]) for name in rows[0]]
    try:
        with warnings.catch_warnings(), writable(path) as place:
            warnings.filterwarnings("ignore", message="'crs' was not provided")  # local metres may have none
            pyogrio.raw.write(
                place,
                geometry=np.array([None if s is None else shapely.to_wkb(s) for s in shapes], object),
                field_data=[values for values, _ in columns],
                field_mask=[mask for _, mask in columns],
                fields=list(rows[0]),
                geometry_type=kind,
                crs=None if named else text,
                driver=DRIVERS[suffix],
                layer=layer if suffix == ".gpkg" else None,
                append=False,
            )
    except RuntimeError as error:  # pyogrio's errors are all RuntimeErrors
        raise OSError(f"GDAL could not write the layer {layer} ({error})") from error
    if named:
        whole = json.loads(path.read_text(encoding="utf-8"))
        first = {"type": whole["type"], "crs": crs_member(named)}  # before the features, where people look
        path.write_text(json_in_utf8({**first, **whole}), encoding="utf-8")


def crs_member(crs: str) -> dict[str, Any]:
    """GeoJSON's member ``crs`` (of 2008) for coordinates in the WKT `crs`. Without it, they are taken for longitudes
    and latitudes; GDAL, and so QGIS, reads a WKT in it, but writes EPSG codes only."""
    return {"type": "name", "properties": {"name": crs}}


def _text(crs: Any) -> str | None:
    return crs if crs is None or isinstance(crs, str) else crs.to_wkt() or None  # an empty one is none


def _column(values: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Values as one array of the narrowest type, and which of them are missing."""
    mask = np.array([v is None for v in values])
    known = [v for v in values if v is not None]
    if known and all(isinstance(v, bool) for v in known):
        return np.array([bool(v) for v in values]), mask
    if known and all(isinstance(v, int) for v in known):
        return np.array([0 if v is None else v for v in values], np.int64), mask
    if all(isinstance(v, int | float) for v in known):
        return np.array([np.nan if v is None else v for v in values], np.float64), mask
    return np.array(["" if v is None else in_utf8(str(v)) for v in values], object), mask
