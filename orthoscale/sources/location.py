"""Where on Earth an input lies, by its own metadata; the fleet is chosen by it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.affine import transformed
from ..core.source import Claim, FilePicture, Source
from ..errors import InputError
from ..formats.degrees import to_degrees

REFERENCE = "reference_lla.json"  # OpenSfM's and OpenDroneMap's, beside the reconstruction
PICTURES_ASKED = 5  # pictures whose EXIF is read; a flight is in one country


@dataclass(frozen=True)
class Location:
    """longitude, latitude : [degrees, WGS 84]. told_by : the source of the position, in words."""

    longitude: float
    latitude: float
    told_by: str


def location_of(source: Source) -> Location | None:
    """The place of an orthophoto or a reconstruction: by its georeferencing or ground control points if they can be
    trusted (`georeference.Claim.usable`), by OpenSfM's reference beside it, or by the GPS position in a picture's EXIF;
    None if there is none of these."""
    if (plan := source.plan) is not None and (place := _of_claim(plan.claimed, plan.width, plan.height)) is not None:
        return place
    folder = source.path if source.path.is_dir() else source.path.parent
    if (place := _of_reference(folder / REFERENCE)) is not None:
        return place
    asked = source.pictures[:PICTURES_ASKED]
    return location_in(picture.path for picture in asked if isinstance(picture, FilePicture))


def location_in(pictures: Iterable[Path]) -> Location | None:
    """The GPS position in the EXIF of the first of `pictures` that has one."""
    from .tags import read_tags

    for path in pictures:
        try:
            place = read_tags(path).lon_lat
        except InputError:
            continue
        if place is not None:
            return Location(*place, f"the GPS position in {path.name}")
    return None


def _of_claim(claimed: Claim, width: int, height: int) -> Location | None:
    if not claimed.usable or claimed.crs is None or claimed.transform is None:
        return None
    middle = transformed(np.array([width / 2, height / 2]), claimed.transform)
    longitude, latitude = to_degrees(claimed.crs).transform(*middle)
    if not (math.isfinite(longitude) and math.isfinite(latitude)):
        return None
    return Location((longitude + 180) % 360 - 180, latitude, "its georeferencing")  # rasters may go on beyond 180


def _of_reference(path: Path) -> Location | None:
    from ..formats.reading import is_there, read
    from ..formats.schemas.models import ReferenceLla

    if not is_there(path):
        return None
    try:
        reference = read(path, ReferenceLla, "OpenSfM's reference", "Delete it, or name the country by --fleet.")
    except InputError:
        return None
    return Location(reference.longitude, reference.latitude, path.name)
