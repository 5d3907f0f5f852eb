"""Detections as map features: GeoJSON (RFC 7946), and GeoPackage in the raster's own coordinates.

Features of a picture without georeferencing have pixel coordinates; in GeoJSON, so have those of one in local metres.
They are written with negative rows as y, as QGIS shows such pictures, and read with either sign.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ...core.affine import transformed
from ...core.boxes import KINDS, Boxes
from ...core.source import Claim
from ...errors import InputError, OutputError, shown
from ..degrees import WGS_84, about_meridian, near_on_map
from ..names import first_few, json_in_utf8
from ..plain_path import readable, writable
from ..reading import EXPORT_ANEW, check_regular, checked, parsed, refuse_pipes_beside
from ..vector import crs_member
from .items import CLASS, LABEL, PICTURE, SCORE_NAMES, Item, first
from .own import measured_notes

LAYER = "vehicles"
# GeoPackage has no lists: the columns that hold the values of each list.
LISTS = {"sigma": ("length_sigma", "width_sigma"), "kinds": KINDS}
PIXELS = "pixels"
PIXEL_CRS = 'LOCAL_CS["orthoscale pixels",UNIT["pixel",1]]'  # nowhere on Earth
LENGTH_FIELD = "length_px"  # the property of a feature


@dataclass(frozen=True)
class Georeference:
    """Where a picture's pixels lie: `transform` from pixels to map coordinates, rasterio's Affine, and their CRS.

    on_earth : that CRS has longitude and latitude; that of local metres has none.
    """

    transform: Any
    crs: str
    on_earth: bool

    @classmethod
    def of(cls, claim: Claim) -> Georeference | None:
        """From the georeferencing of a picture; None if it has no coordinate reference system."""
        if claim.crs is None or claim.transform is None:
            return None
        return cls(claim.transform, claim.crs.to_wkt(), claim.usable)

    def to_map(self, pixels: np.ndarray, crs: str | None = None) -> np.ndarray:
        """(K, 2) map coordinates of (K, 2) pixels, in `crs` or the raster's own."""
        points = transformed(pixels, self.transform)
        return points if crs is None else np.column_stack(_transformer(self.crs, crs).transform(*points.T))

    def to_degrees(self, pixels: np.ndarray) -> np.ndarray:
        """(K, 2) longitudes and latitudes [deg] of one shape's (K, 2) pixels, see `about_meridian`."""
        return about_meridian(self.to_map(pixels, WGS_84))

    def to_pixels(self, points: np.ndarray, crs: str | None = None) -> np.ndarray:
        """(K, 2) pixels of (K, 2) map coordinates, in `crs` or the raster's own. Raises pyproj's errors if one cannot
        be transformed into the other; if both are local metres, they are taken to be the same."""
        if crs is not None and not (_is_local(crs) and _is_local(self.crs)):
            points = np.column_stack(_transformer(crs, self.crs).transform(*points.T))
            points = near_on_map(points, self.crs, self.transform.c)
        return transformed(points, ~self.transform)


@cache
def _transformer(source: str, target: str):
    from pyproj import Transformer

    return Transformer.from_crs(source, target, always_xy=True)


@cache
def _is_local(crs: str) -> bool:
    """Whether `crs` has no place on Earth, so that nothing can be transformed into it."""
    from pyproj import CRS

    return CRS.from_user_input(crs).type_name == "Engineering CRS"


# GeoJSON


def is_geojson(text: Any) -> bool:
    """Whether a JSON document is a collection of features."""
    return isinstance(text, dict) and text.get("type") == "FeatureCollection"


def read_geojson(text: Mapping[str, Any], origin: str, place: Georeference | None) -> list[Item]:
    """The boxes of a document. Raises InputError."""
    from ..schemas.detections import GeoCollection

    whole = checked(
        text, GeoCollection, origin, "GeoJSON that can be read", "Save it as a FeatureCollection of polygons."
    )
    # QGIS and GDAL write a CRS, though RFC 7946 has none.
    crs = whole.crs.properties.name if whole.crs is not None else WGS_84
    if whole.orthoscale is not None and whole.orthoscale.coordinates == PIXELS:
        place = None
    items = []
    for number, feature in enumerate(whole.features, 1):
        shape = feature.geometry
        kind, rings = (None, None) if shape is None else (shape.type, shape.coordinates)
        ring = _ring(kind, rings, f"{origin}: feature {number}")
        items.append(_item(_in_pixels(ring, place, crs, origin), feature.properties or {}, place is not None))
    return items


def geojson(boxes: Mapping[str, Boxes], place: Georeference | None, note: Mapping[str, Any]) -> dict:
    """A document of `boxes` by picture name, in longitude and latitude if `place` is on Earth, else in pixels."""
    if place is not None and not place.on_earth:
        place = None
    features = []
    for polygon, properties in _features(boxes, place, in_degrees=place is not None):
        digits = 3 if place is None else 9
        ring = [[round(float(v), digits) for v in point] for point in [*polygon, polygon[0]]]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    told = {**note, **({"coordinates": PIXELS} if place is None else {})}
    of_crs = {"crs": crs_member(PIXEL_CRS)} if place is None else {}
    return {"type": "FeatureCollection", **of_crs, "orthoscale": told, "features": features}


# GeoPackage


def read_geopackage(path: Path, place: Georeference | None) -> tuple[list[Item], dict[str, Any] | None]:
    """The boxes of the layer `vehicles`, or else of the only layer, and the note that `write_geopackage` added.

    Raises InputError.
    """
    import pyogrio.raw
    import shapely.geometry

    check_regular(path, "Give a detections file.")
    refuse_pipes_beside([path])
    try:
        with readable(path) as file:
            names = [str(name) for name, kind in pyogrio.list_layers(file) if kind is not None]
            layer = LAYER if LAYER in names or not names else names[0]
            info = pyogrio.read_info(file, layer=layer)
            meta, _, blobs, columns = pyogrio.raw.read(file, layer=layer)
        shapes = shapely.from_wkb(blobs)
    except Exception as error:  # GDAL's and GEOS's errors share no base
        raise InputError(f"{path}: not a GeoPackage of polygons that can be read ({error})", EXPORT_ANEW) from error
    if layer != LAYER and len(names) > 1:
        raise InputError(
            f"{path}: several layers ({first_few(names)}), and none is called {LAYER}", "Save that of the boxes alone."
        )
    told = (info.get("layer_metadata") or {}).get("orthoscale")
    note = parsed(told, str(path), "a GeoPackage that orthoscale wrote", "Save the detections again.") if told else None
    crs = meta["crs"]
    if place is not None and not crs:
        place = None
    items = []
    for number, shape in enumerate(shapes, 1):
        what = f"{path}: feature {number} of {layer}"
        there = {"type": None, "coordinates": None} if shape is None else shapely.geometry.mapping(shape)
        ring = _ring(there["type"], there.get("coordinates"), what)
        properties = {name: column[number - 1] for name, column in zip(meta["fields"], columns, strict=True)}
        items.append(_item(_in_pixels(ring, place, crs, str(path)), properties, place is not None))
    return items, note


def write_geopackage(
    path: Path, boxes: Mapping[str, Boxes], place: Georeference | None, note: Mapping[str, Any]
) -> None:
    """Write the layer `vehicles`, in the raster's own coordinates if `place` is known, else in pixels. Raises
    OutputError."""
    import warnings

    import pyogrio.raw
    import shapely.geometry

    features = list(_features(boxes, place))
    polygons = shapely.polygons([polygon for polygon, _ in features]) if features else np.empty(0, object)
    fields = ("picture", "score", "class", LENGTH_FIELD, "width_px", "angle_deg")
    columns = [np.array([properties[name] for _, properties in features]) for name in fields]
    columns = [c.astype(object) if k in (0, 2) else c.astype(float) for k, c in enumerate(columns)]
    lists = [
        np.array([said.get(of, [None] * len(names)) for _, said in features], float).reshape(-1, len(names))
        for of, names in LISTS.items()
    ]
    with warnings.catch_warnings(), writable(path) as file:
        warnings.simplefilter("ignore", UserWarning)  # pixel coordinates have no CRS, and need none
        try:
            pyogrio.raw.write(
                file,
                geometry=np.asarray(shapely.to_wkb(polygons), object),
                field_data=[*columns, *np.concatenate(lists, axis=1).T],
                fields=np.array([*fields, *chain(*LISTS.values())], object),
                geometry_type="Polygon",
                crs=None if place is None else place.crs,
                layer=LAYER,
                driver="GPKG",
                layer_metadata={"orthoscale": json_in_utf8(dict(note))},
            )
        except RuntimeError as error:  # pyogrio's errors are all RuntimeErrors
            raise OutputError(f"{path.name}: GDAL could not write it ({error})", "Check the free space.") from error


# Both


def _features(
    boxes: Mapping[str, Boxes], place: Georeference | None, in_degrees: bool = False
) -> Iterator[tuple[np.ndarray, dict[str, Any]]]:
    for picture, found in boxes.items():
        rows = zip(found.corners, found.xylwa, found.score, measured_notes(found), strict=True)
        for corners, row, score, more in rows:
            if place is None:
                polygon = corners * [1, -1]
            else:
                polygon = place.to_degrees(corners) if in_degrees else place.to_map(corners)
            yield (
                polygon,
                {
                    "picture": picture,
                    "score": round(float(score), 4),
                    "class": LABEL,
                    LENGTH_FIELD: round(float(row[2]), 3),
                    "width_px": round(float(row[3]), 3),
                    "angle_deg": round(float(np.degrees(row[4])), 3),
                    **more,
                },
            )


def _in_pixels(ring: np.ndarray, place: Georeference | None, crs: str | None, origin: str) -> np.ndarray:
    if place is None:
        return ring * [1, -1] if ring[:, 1].mean() < 0 else ring
    from pyproj.exceptions import CRSError, ProjError

    try:
        return place.to_pixels(ring, crs)
    except (CRSError, ProjError) as error:
        raise InputError(
            f"{origin}: its coordinates do not fit the raster's ({error})",
            "Save the polygons in the raster's coordinate reference system.",
        ) from error


def _ring(kind: str | None, rings: Any, what: str) -> np.ndarray:
    """(K, 2) outer ring of a polygon, or of a multipolygon with one part, without the repeated last point."""
    try:
        if kind == "MultiPolygon" and len(rings) == 1:
            rings, kind = rings[0], "Polygon"
        if kind != "Polygon":
            raise ValueError("not a polygon")
        ring = np.array([point[:2] for point in rings[0]], float).reshape(-1, 2)
    except (IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        other = "a geometry that is missing" if kind is None else "one with damaged corners"
        raise InputError(
            f"{what} is not a polygon but {other if kind in (None, 'Polygon') else shown(kind)}",
            "Boxes must be polygons with four corners.",
        ) from error
    if len(ring) and np.array_equal(ring[0], ring[-1]):
        ring = ring[:-1]
    if len(ring) < 3 or not np.isfinite(ring).all():
        raise InputError(f"{what} has {len(ring)} usable corners", "Boxes must be polygons with four corners.")
    return ring


def _item(polygon: np.ndarray, properties: Mapping[str, Any], on_map: bool) -> Item:
    label, picture = first(properties, CLASS), first(properties, PICTURE)
    told = first(properties, SCORE_NAMES)
    score = 1.0 if told is None else _number(told)
    length, width = _list(properties, "sigma")
    name = None if picture is None else str(picture)
    kinds = _list(properties, "kinds")
    return Item(
        polygon,
        score,
        None if label is None else str(label),
        name,
        (length, width),
        kinds,
        on_map=on_map,
        length_px=_number(properties.get(LENGTH_FIELD)),
    )


def _list(properties: Mapping[str, Any], of: str) -> list[float]:
    """The values of the list `of`, one of `LISTS`; NaN where they are missing."""
    values = properties.get(of)
    if isinstance(values, str):  # GDAL and QGIS turn lists into text
        values = values.strip("[] ").split(",")
    if not isinstance(values, (list, np.ndarray)) or len(values) != len(LISTS[of]):
        values = [properties.get(name) for name in LISTS[of]]
    return [_number(v) for v in values]


def _number(value: Any) -> float:
    """`value` as a float; NaN if it is not a number."""
    try:
        return float(value)
    except (OverflowError, TypeError, ValueError):
        return float("nan")
