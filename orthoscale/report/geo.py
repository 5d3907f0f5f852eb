"""Vehicles as a GeoPackage in metres, with a style for QGIS inside, and as GeoJSON."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
from rasterio.warp import transform

from ..core.affine import transformed
from ..core.projection.planar import footprints
from ..core.source import Placement, Plan
from ..errors import OutputError, UsageError
from ..formats.degrees import WGS_84, about_meridian
from ..formats.detections.geo import LAYER
from ..formats.names import json_in_utf8
from ..formats.vector import write_layer
from .anchors import entries, write_anchor_layer
from .pictures import REJECTED_RGB, USED_RGB
from .result import Result

# The default style, which QGIS loads from the table layer_styles: used vehicles blue, others dashed orange, as in the
# report.
STYLE = """<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis styleCategories="Symbology">
 <renderer-v2 type="categorizedSymbol" attr="used" symbollevels="0" enableorderby="0" forceraster="0">
  <categories>
   <category value="true" label="used" symbol="0" render="true"/>
   <category value="false" label="not used" symbol="1" render="true"/>
  </categories>
  <symbols>{used}{rejected}</symbols>
 </renderer-v2>
</qgis>
"""
SYMBOL = """<symbol type="fill" name="{name}" alpha="1" clip_to_extent="1" force_rhr="0">
   <layer class="SimpleFill" enabled="1" pass="0" locked="0">
    <Option type="Map">
     <Option type="QString" name="color" value="{rgb},40"/>
     <Option type="QString" name="outline_color" value="{rgb},255"/>
     <Option type="QString" name="outline_style" value="{line}"/>
     <Option type="QString" name="outline_width" value="0.5"/>
     <Option type="QString" name="outline_width_unit" value="MM"/>
     <Option type="QString" name="style" value="solid"/>
    </Option>
   </layer>
  </symbol>"""
STYLES_TABLE = """CREATE TABLE layer_styles (
 id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256), f_table_schema TEXT(256),
 f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT,
 useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30),
 update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')))"""


def table(result: Result, place: Placement) -> dict[str, np.ndarray]:
    """Columns with one value per vehicle, lengths in metres. Headings are clockwise from the grid north of `place`
    [deg, 0..180): it is not known which end is the front."""
    vehicles = result.vehicles
    a, b, _, d, e, f = place.transform[:6]
    x, y = np.cos(vehicles["angle"]), np.sin(vehicles["angle"])
    east, north = a * x + b * y, d * x + e * y
    if not isinstance(place.crs, str) and place.crs.is_geographic:  # degrees of longitude shrink towards the poles
        east = east * np.cos(np.radians(d * vehicles["x_unit"] + e * vehicles["y_unit"] + f))
    return {
        "length_m": vehicles["length"],
        "width_m": vehicles["width"],
        "score": vehicles["score"],
        "kind": vehicles["kind"],
        "used": vehicles["used"],
        "reason": vehicles["reason"],
        "heading_deg": np.degrees(np.arctan2(east, north)) % 180,
        "scale_deviation_percent": 100 * np.expm1(vehicles["scale_deviation"]),  # it is a logarithm
        "x_px": vehicles["x_unit"],
        "y_px": vehicles["y_unit"],
    }


def outlines(result: Result, place: Placement) -> np.ndarray:
    """(N, 5, 2) closed outlines of the vehicles in the coordinates of `place`."""
    assert result.source.plan is not None, "reconstructions have none"
    box = np.array([members[0] for members in result.votes.members], int)
    ring = transformed(footprints(result.boxes[box], result.source.plan.claimed.aspect), place.transform)
    return np.concatenate([ring, ring[:, :1]], 1)


def write_geopackage(result: Result, place: Placement, path: Path) -> None:
    """Write vehicles as polygons (layer ``vehicles``) and anchors as lines (``anchors``), in the scaled copy's CRS.

    Raises OutputError.
    """
    import shapely

    columns = {name: values.tolist() for name, values in table(result, place).items()}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    try:
        if rows:
            write_layer(path, LAYER, shapely.polygons(outlines(result, place)), rows, "Polygon", place.crs)
            _add_style(path)
        if result.anchors.votes:
            write_anchor_layer(entries(result.anchors.votes, result.scale.value, result.scale.parts), place, path)
    except (OSError, sqlite3.Error, RuntimeError) as error:  # pyogrio's other errors are RuntimeErrors
        raise OutputError(f"{path} could not be written ({error})", "Check the free space on its disk.") from error


def check_on_earth(source: Plan, keep_origin: bool) -> None:
    """Raise UsageError if the copy of `source` has no place on Earth, which GeoJSON needs. keep_origin : whether it
    keeps the place of `source`."""
    if _on_earth(source.place(1.0, keep_origin)):
        return
    kept = _on_earth(source.place(1.0, keep_origin=True))
    raise _nowhere(source.path, "Add --keep-origin, or use" if kept else "Use")


def _on_earth(place: Placement) -> bool:
    return not isinstance(place.crs, str) and bool(place.crs.is_geographic or place.crs.is_projected)


def _nowhere(path: Path, take: str) -> UsageError:
    return UsageError(
        f"--also geojson: the copy of {path} has no place on Earth, and GeoJSON holds longitude and latitude only",
        f"{take} --also gpkg, which keeps local metres.",
    )


def write_geojson(result: Result, place: Placement, path: Path) -> None:
    """Write vehicles as polygons in longitude and latitude (WGS 84), as RFC 7946 requires and every reader accepts.

    place : of the scaled copy. Raises UsageError if it is nowhere on Earth.
    """
    if not _on_earth(place):
        raise _nowhere(result.source.path, "Take")
    columns = {name: values.tolist() for name, values in table(result, place).items()}
    features = []
    for k, ring in enumerate(outlines(result, place)):
        east, north = transform(place.crs, WGS_84, *ring.T)
        geometry = {"type": "Polygon", "coordinates": [about_meridian(np.column_stack([east, north])).tolist()]}
        properties = {name: values[k] for name, values in columns.items()}
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    text = {"type": "FeatureCollection", "name": LAYER, "features": features}
    path.write_text(json_in_utf8(text), encoding="utf-8")


def _add_style(path: Path) -> None:
    used = SYMBOL.format(name=0, rgb=",".join(map(str, USED_RGB)), line="solid")
    rejected = SYMBOL.format(name=1, rgb=",".join(map(str, REJECTED_RGB)), line="dash")
    style = STYLE.format(used=used, rejected=rejected)
    with sqlite3.connect(path) as file:
        geometry = file.execute("SELECT column_name FROM gpkg_geometry_columns").fetchone()[0]
        file.execute(STYLES_TABLE)
        file.execute(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, styleName, "
            "styleQML, styleSLD, useAsDefault, description, owner) "
            "VALUES ('', '', ?, ?, 'orthoscale', ?, '', 1, '', '')",
            (LAYER, geometry, style),
        )
        file.execute(
            "INSERT INTO gpkg_contents (table_name, data_type, identifier) "
            "VALUES ('layer_styles', 'attributes', 'layer_styles')"
        )
    file.close()
