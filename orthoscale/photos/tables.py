"""Photos and their measurements as rows: CSV, JSON, and a GeoPackage with places and footprints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.fleet import Fleet
from ..errors import UsageError
from ..formats.csv_table import write_csv
from ..formats.degrees import WGS_84, about_meridian
from ..formats.names import write_json
from ..formats.vector import write_layer
from .depth.ground import DepthAltitude
from .measure import PhotoScale
from .photo import Photo

PHOTOS_FORMAT = "orthoscale photo 1"
TABLE_SUFFIXES = (".csv", ".json", ".gpkg")
ALL_TOGETHER = "all together"  # in place of a photo's name, in the row for all
OF_ONE_PHOTO = ("xmp_", "depth_")  # prefixes of columns that concern a single photo
MEASURES = ("scale_m_per_px", "altitude_m", "gsd_m", "footprint_width_m", "footprint_height_m")


@dataclass(frozen=True)
class PhotoOutcome:
    """One photo: what was measured, or why nothing was. `photo` is None where it could not even be read.

    boxes : how many were found in it. depth : the altitude by its depth map, if one was given. depth_problem : why
    there is none.
    """

    name: str
    photo: Photo | None
    measured: PhotoScale | None
    problem: str = ""
    boxes: int = 0
    depth: DepthAltitude | None = None
    depth_problem: str = ""

    def ratio(self, altitude: float | None) -> float | None:
        """Ratio of another `altitude` [m] to the one by vehicles; None if either is missing, or the other is not
        positive."""
        return altitude / self.measured.altitude.value if altitude and altitude > 0 and self.measured else None


def row(outcome: PhotoOutcome) -> dict[str, Any]:
    """The photo's row of plain values; lengths in metres, angles in degrees, each measure with its 90 % interval."""
    photo, got, depth = outcome.photo, outcome.measured, outcome.depth
    measures: dict[str, Any] = {}
    values = [None] * len(MEASURES) if got is None else [got.nadir_gsd, got.altitude, got.gsd, *got.footprint]
    for name, value in zip(MEASURES, values, strict=True):
        for suffix, part in (("", "value"), ("_low", "low"), ("_high", "high")):
            measures[name + suffix] = None if value is None else round(float(getattr(value, part)), 6)
    tags = photo.tags if photo else None
    return {
        "photo": outcome.name,
        "measured": got is not None,
        "problem": outcome.problem,
        "verdict": got.scale.verdict if got else "",
        "vehicles_used": got.scale.vehicles_used if got else None,  # 0 would mean that no vehicle was usable
        "boxes": outcome.boxes,
        **measures,
        "focal_px": round(photo.lens.focal_px, 2) if photo else None,
        "focal_source": photo.lens.source if photo else "",
        "pitch_deg": round(float(np.degrees(photo.pitch)), 2) if photo else None,
        "attitude": photo.attitude if photo else "",
        "xmp_relative_altitude_m": tags.relative_altitude if tags else None,
        "xmp_ratio": _rounded(outcome.ratio(tags.relative_altitude if tags else None)),
        "depth_altitude_m": _rounded(depth.altitude) if depth else None,
        "depth_ratio": _rounded(outcome.ratio(depth.altitude if depth else None)),
        "depth_scatter": _rounded(depth.scatter) if depth else None,
        "depth_vehicles": depth.vehicles if depth else None,
        "depth_problem": outcome.depth_problem,
        "longitude": tags.lon_lat[0] if tags and tags.lon_lat else None,
        "latitude": tags.lon_lat[1] if tags and tags.lon_lat else None,
        "taken": tags.taken if tags else "",
        "camera": tags.camera if tags else "",
        "notes": "; ".join(tags.notes) if tags else "",
    }


def document(
    outcomes: Sequence[PhotoOutcome],
    fleet: Fleet,
    detector: str,
    together: PhotoScale | None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """All rows, the share of photos that had enough vehicles, and the scale of all `together` if requested.

    fleet : by which they were measured. notes : for the user.
    """
    used = sum(outcome.measured is not None for outcome in outcomes)
    text: dict[str, Any] = {
        "format": PHOTOS_FORMAT,
        "photos": len(outcomes),
        "measured": used,
        "used_ratio": used / len(outcomes) if outcomes else 0.0,
        "fleet": fleet.code,
        "fleet_name": fleet.name,
        "detector": detector,
        "interval_level": 0.9,
        "notes": list(notes),
    }
    if together is not None:
        boxes = sum(outcome.boxes for outcome in outcomes)
        pooled = row(PhotoOutcome(ALL_TOGETHER, together.photo, together, boxes=boxes))
        own = ("photo", "taken", "longitude", "latitude", "notes", "problem")
        text["together"] = {k: v for k, v in pooled.items() if k not in own and not k.startswith(OF_ONE_PHOTO)} | {
            "photos_per_place": round(together.overlap, 2),
            "uncertainty": together.scale.parts,
            "remarks": [remark.document() for remark in together.scale.remarks],
        }
    return text | {"rows": [row(outcome) for outcome in outcomes]}


def check_ending(path: Path, formats: Sequence[str] = TABLE_SUFFIXES) -> None:
    """Raises UsageError for a name whose ending is none of `formats`."""
    if path.suffix.lower() not in formats:
        raise UsageError(f"{path.name} is not one of {', '.join(formats)}", "The file's ending sets its format.")


def write(outcomes: Sequence[PhotoOutcome], text: Mapping[str, Any], path: Path) -> None:
    """Write `text`, the `document` of `outcomes`, to `path`, in the format of its ending; in a table the scale of all
    together is the last row."""
    if path.suffix.lower() == ".json":
        write_json(text, path)
        return
    pooled = text.get("together")
    rows = [*text["rows"], *([] if pooled is None else [_row_of_all(pooled)])]
    if path.suffix.lower() == ".csv":
        write_csv(path, list(rows[0]), rows)
    else:
        _write_geopackage(outcomes, rows, path)


def _row_of_all(pooled: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of `document` for all together as a row; columns of a single photo are empty."""
    return {name: pooled.get(name) for name in row(PhotoOutcome("", None, None))} | {"photo": ALL_TOGETHER}


def _write_geopackage(outcomes: Sequence[PhotoOutcome], rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Layer ``photos``: all rows, each photo at the camera's place if EXIF has it. Layer ``footprints``: the ground
    that each measured photo shows, if place and heading are known. Both are in longitude and latitude."""
    import shapely

    places = [
        shapely.Point(o.photo.tags.lon_lat) if o.photo is not None and o.photo.tags.lon_lat else None for o in outcomes
    ]
    places += [None] * (len(rows) - len(places))  # the row of all has no place
    write_layer(path, "photos", places, rows, "Point", WGS_84)
    outlines = [
        (r, shape) for o, r in zip(outcomes, rows, strict=False) if (shape := footprint_on_earth(o)) is not None
    ]
    if outlines:
        write_layer(path, "footprints", [s for _, s in outlines], [r for r, _ in outlines], "Polygon", WGS_84)


def footprint_on_earth(outcome: PhotoOutcome) -> Any:
    """The ground that the photo shows, as a polygon of longitudes and latitudes; None if it is not known."""
    import pyproj
    import shapely

    photo, got = outcome.photo, outcome.measured
    if photo is None or got is None or photo.tags.lon_lat is None or photo.tags.heading is None:
        return None
    outline = got.outline()
    if outline is None:
        return None
    right, ahead = outline.T
    lon, lat = photo.tags.lon_lat
    bearing = photo.tags.heading + np.degrees(np.arctan2(right, ahead))
    ones = np.ones(len(outline))
    x, y, _ = pyproj.Geod(ellps="WGS84").fwd(lon * ones, lat * ones, bearing, np.hypot(right, ahead))
    return shapely.Polygon(about_meridian(np.column_stack([x, y])))


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 4)
