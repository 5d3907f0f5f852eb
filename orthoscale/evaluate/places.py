"""Photos with a known place: from DenseUAV's ``Dense_GPS_*.txt``, columns of a CSV, or the photos' own GPS tags."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError, shown
from ..formats.reading import read_table, read_text, refuse_repeated
from .readers import Sample

GPS_FILES = "Dense_GPS_*.txt"
GPS_LINE = re.compile(r"^(\S+)\s+E(-?\d+(?:\.\d+)?)\s+N(-?\d+(?:\.\d+)?)\s+(-?\d+(?:\.\d+)?)\s*$")
GPS_HINT = "Lines are: path E<longitude> N<latitude> height."
GPS_FOLDERS_ABOVE = 3  # folders above that of the photos in which the file of their places is searched
NAME_PARTS = 2  # last parts of a path, such as 000001/H80.JPG: DenseUAV's files have the paths of its authors' disk


@dataclass(frozen=True)
class PlacedSample:
    """A photo, and the longitude and latitude below its camera [deg]."""

    sample: Sample
    lon_lat: tuple[float, float]


def placed(path: Path, samples: Sequence[Sample]) -> tuple[list[PlacedSample], list[str]]:
    """The `samples` of the data set at `path` whose place is known, and notes on the others.

    Raises InputError for a damaged file of places, and if no place is known.
    """
    of_table = path.is_file()
    told = places_of_csv(path) if of_table else places_of_denseuav(path)
    found = []
    for sample in samples:
        photo = sample.photo
        # If the folder that is evaluated is the photos' own, their names do not contain it.
        names = [photo.name] if of_table else [_short(str(photo.path.absolute())), _short(photo.name)]
        place = next((told[name] for name in names if name in told), photo.tags.lon_lat)
        if place is not None:
            found.append(PlacedSample(sample, place))
    if not found:
        raise InputError(
            f"{path}: no photo with a known place",
            f"Give {GPS_FILES} beside the photos, columns longitude and latitude, or photos with GPS tags.",
        )
    missing = len(samples) - len(found)
    return found, [f"{missing} photos without a known place left out"] if missing else []


def places_of_denseuav(folder: Path) -> dict[str, tuple[float, float]]:
    """Longitude and latitude by the last two parts of a photo's path, from all ``Dense_GPS_*.txt`` in `folder` or the
    first folder above it that has any; empty without such a file. Raises InputError, also if one photo has two
    places."""
    for place in (folder, *folder.absolute().parents[:GPS_FOLDERS_ABOVE]):
        files = sorted(place.glob(GPS_FILES))
        if files:
            places: dict[str, tuple[float, float]] = {}
            for file in files:
                _add_gps_lines(places, file)
            return places
    return {}


def _add_gps_lines(places: dict[str, tuple[float, float]], path: Path) -> None:
    for number, line in enumerate(read_text(path, GPS_HINT).splitlines(), 1):
        if not line.strip():
            continue
        match = GPS_LINE.match(line.strip())
        lon, lat = (float(match[2]), float(match[3])) if match else (math.nan, math.nan)
        if match is None or not (abs(lon) <= 180 and abs(lat) <= 90):
            raise InputError(f"{path}, line {number}: {line.strip()[:80]!r} is not the place of a photo", GPS_HINT)
        _add(places, _short(match[1]), (lon, lat), f"{path}, line {number}")


def places_of_csv(path: Path) -> dict[str, tuple[float, float]]:
    """Longitude and latitude by a photo's name in the column image, from the columns longitude and latitude; empty if
    the table has no such columns. Raises InputError, also if one photo has two places."""
    table = read_table(path, "Give the CSV file.")
    columns = {"image", "longitude", "latitude"}
    if not columns <= set(table.fieldnames or ()):
        return {}
    refuse_repeated(path, table, sorted(columns), "Keep one of them.")
    places: dict[str, tuple[float, float]] = {}
    for row in table:
        lon, lat = (table.number(row, name, "Correct or remove the line.") for name in ("longitude", "latitude"))
        if lon is None or lat is None:
            continue
        if not (abs(lon) <= 180 and abs(lat) <= 90):
            raise InputError(
                f"{path}, line {table.line_num}: {lon:g}, {lat:g} is not a longitude and latitude",
                "Correct or remove the line.",
            )
        _add(places, (row["image"] or "").strip(), (lon, lat), f"{path}, line {table.line_num}")
    return places


def _add(places: dict[str, tuple[float, float]], name: str, lon_lat: tuple[float, float], where: str) -> None:
    if places.setdefault(name, lon_lat) != lon_lat:
        raise InputError(f"{where}: {shown(name)} has another place already", "Correct or remove one of the lines.")


def _short(name: str) -> str:
    return "/".join(name.replace("\\", "/").split("/")[-NAME_PARTS:])
