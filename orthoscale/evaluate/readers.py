"""Reads photos with known altitude, in three forms.

DenseUAV: photos with their altitude in their name (``000001/H80.JPG``, ``000001_H80.jpg``), nadir, from one camera.
UAV-VisLoc+: a folder per region with ``drone/``, ``reference.txt`` (poses), ``camera.xml``, ``*_dsm.tif``.
CSV: ``image,altitude_m`` and optionally ``region,focal_px,pitch_deg,roll_deg``; images relative to the file.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.projection.level import up_from_survey
from ..errors import InputError, shown
from ..formats.names import first_few
from ..formats.points import decimal_commas
from ..formats.reading import Table, absent, files_below, is_hidden, read_table, read_text, refuse_repeated
from ..photos.folders import IMAGE_SUFFIXES
from ..photos.photo import GIMBAL_SD, RIGHT, Photo, open_photo
from ..sources.tags import read_tags
from ..system.paths import name_of
from .surface import Surface

NAMED_ALTITUDE = re.compile(r"(?:^|[_/ -])H_?(\d+(?:\.\d+)?)(?=\.|_|/|$)", re.IGNORECASE)
# Focal length as a share of the picture's diagonal. DenseUAV's camera: 8.8 mm on a diagonal of 14.667 mm, 1080 px for
# 1440 x 1080 px, as in the paper's program.
DENSEUAV_FOCAL = 8.8 / 14.667
PHOTO_COLUMNS = ("image", "altitude_m", "region", "focal_px", "pitch_deg", "roll_deg")  # of a table of photos
DSM_ENDINGS = ("dsm.tif", "dsm.tiff")  # of names in lower case


@dataclass(frozen=True)
class Sample:
    """One photo, its true altitude over the ground [m], and the region to which it belongs."""

    photo: Photo
    altitude: float
    region: str


def read_samples(
    path: Path, form: str | None = None, lens_file: Path | None = None, focal_px: float | None = None
) -> tuple[list[Sample], list[str]]:
    """The photos of the data set at `path`, and notes on what was left out.

    form : "denseuav", "visloc" or "csv"; by default what `path` looks like. lens_file, focal_px [px] : take precedence
    over those of the data set. Raises InputError.
    """
    if not path.exists():
        raise absent(path, "Give a folder, or a CSV file.")
    form = form or _looks_like(path)
    readers: dict[str, Callable[..., tuple[list[Sample], list[str]]]] = {
        "denseuav": read_denseuav,
        "visloc": read_visloc,
        "csv": read_csv,
    }
    samples, notes = readers[form](path, lens_file, focal_px)
    if not samples:
        raise InputError(f"{path}: no photo with a known altitude", "; ".join(notes) or "See --help for the forms.")
    return samples, notes


def _looks_like(path: Path) -> str:
    if path.is_file():
        return "csv"
    return "visloc" if any(map(_has_photos, _regions(path))) else "denseuav"


def _photos_in(folder: Path) -> list[Path]:
    return files_below(folder, IMAGE_SUFFIXES)


# DenseUAV


def read_denseuav(folder: Path, lens_file: Path | None, focal_px: float | None) -> tuple[list[Sample], list[str]]:
    """Photos with their altitude in their name, or in that of their folder; nadir, one fixed camera."""
    samples, nameless = [], []
    for path in _photos_in(folder):
        name = path.relative_to(folder).as_posix()
        told = NAMED_ALTITUDE.findall(name)
        if not told or float(told[-1]) <= 0:
            nameless.append(name)
            continue
        focal = focal_px
        if lens_file is None and focal is None:
            tags = read_tags(path)
            focal = DENSEUAV_FOCAL * math.hypot(tags.width, tags.height)
        photo = open_photo(path, name, lens_file=lens_file, focal_px=focal, pitch=-90.0)
        samples.append(Sample(photo, float(told[-1]), name_of(folder)))
    notes = (
        [f"{len(nameless)} photos without an altitude in their name, the first is {nameless[0]}"] if nameless else []
    )
    return samples, notes


# UAV-VisLoc+


def _regions(folder: Path) -> list[Path]:
    """Those of the folder and its subfolders that have poses."""
    candidates = [folder, *sorted(p for p in folder.iterdir() if p.is_dir())]
    return [p for p in candidates if (p / "reference.txt").is_file()]


def _has_photos(region: Path) -> bool:
    return (region / "drone").is_dir()


def read_visloc(folder: Path, lens_file: Path | None, focal_px: float | None) -> tuple[list[Sample], list[str]]:
    """Photos with reference poses over a surface model: the altitude is the pose's height minus that of the ground.
    Raises InputError."""
    samples: list[Sample] = []
    regions = _regions(folder)
    if not any(map(_has_photos, regions)):
        raise InputError(f"{folder}: no region with reference.txt and drone/", "Give the folder of the regions.")
    notes = [
        f"region {name_of(region)}: no photos, for it has no drone/" for region in regions if not _has_photos(region)
    ]
    for region in filter(_has_photos, regions):
        own_lens = lens_file
        if lens_file is None and focal_px is None:
            own_lens = region / "camera.xml"
            if not own_lens.is_file():
                raise InputError(f"{region}: no camera.xml", "Give --lens or --focal-px.")
        models = [p for p in sorted(region.iterdir()) if _is_surface_model(p.name)]
        if not models:
            raise InputError(f"{region}: no surface model (*_dsm.tif)", "Without it the altitude is not known.")
        if len(models) > 1:
            several = first_few([p.name for p in models])
            raise InputError(f"{region}: several surface models: {several}", "Leave one, or join them.")
        poses = _read_poses(region / "reference.txt")
        unposed = off_map = 0
        with Surface.open(models[0]) as surface:
            if surface.note:
                notes.append(f"{models[0]}: {surface.note}")
            for path in _photos_in(region / "drone"):
                pose = poses.get(path.name) or poses.get(path.stem)
                if pose is None:
                    unposed += 1
                    continue
                lon, lat, height, _, pitch, roll = pose
                ground = surface.ground(lon, lat)
                if ground is None or height <= ground:
                    off_map += 1
                    continue
                name = path.relative_to(folder).as_posix()
                photo = open_photo(path, name, lens_file=own_lens, focal_px=focal_px, pitch=-90.0)
                up = up_from_survey(*np.radians([pitch, roll]))
                photo = replace(photo, up=up, up_sd=float(GIMBAL_SD), attitude="of the reference pose")
                samples.append(Sample(photo, height - ground, name_of(region)))
        for count, what in ((unposed, "without a pose"), (off_map, "without ground below them")):
            notes += [f"region {name_of(region)}: {count} photos {what}"] * (count > 0)
    return samples, notes


def _is_surface_model(name: str) -> bool:
    return name.lower().endswith(DSM_ENDINGS) and not is_hidden(name)


def _read_poses(path: Path) -> dict[str, tuple[float, ...]]:
    """Longitude, latitude, height [m], yaw, pitch, roll [deg] by label: the last six columns of each line.

    Angles as Metashape exports them: 0, 0, 0 looks straight down with the picture's top to the north. Commas are
    decimal ones if the numbers show it; otherwise they separate columns, as blanks, tabs and semicolons do.
    """
    poses: dict[str, tuple[float, ...]] = {}
    text = read_text(path, "It is a table of poses.")
    commas = decimal_commas(re.split(r"[;\s]+", text))
    for number, line in enumerate(text.splitlines(), 1):
        parts = (line.replace(",", ".") if commas else line.replace(",", " ")).replace(";", " ").split()
        if len(parts) < 7 or line.startswith("#"):
            continue
        try:
            values = tuple(float(v) for v in parts[-6:])
        except ValueError:
            continue  # Metashape's line of column names
        if not (all(map(math.isfinite, values)) and abs(values[0]) <= 180 and abs(values[1]) <= 90):
            raise InputError(
                f"{path}, line {number}: {values[0]:g}, {values[1]:g} is not a longitude and latitude",
                "The last six columns are longitude, latitude, height, yaw, pitch, roll.",
            )
        if poses.setdefault(parts[0], values) != values:
            raise InputError(
                f"{path}, line {number}: {shown(parts[0])} has another pose already",
                "Correct or remove one of the lines.",
            )
    if not poses:
        raise InputError(f"{path}: no pose in it", "Lines are: label ... longitude latitude height yaw pitch roll.")
    return poses


# CSV


def read_csv(path: Path, lens_file: Path | None, focal_px: float | None) -> tuple[list[Sample], list[str]]:
    """The photos of a table. Focal length and angles come from it, or else from the photos' own tags. Raises
    InputError."""
    if path.is_dir():
        raise InputError(f"{path} is a folder", "Give the CSV file.")
    samples: dict[str, Sample] = {}
    try:
        table = read_table(path, "Give the CSV file.")
        missing = {"image", "altitude_m"} - set(table.fieldnames or ())
        if missing:
            raise InputError(
                f"{path}: no column {' and '.join(sorted(missing))}",
                "Columns: image, altitude_m; where wanted region, focal_px, pitch_deg, roll_deg.",
            )
        refuse_repeated(path, table, PHOTO_COLUMNS, "Keep one of them.")
        for row in table:
            sample = _row(row, table, lens_file, focal_px)
            if samples.setdefault(name := sample.photo.name, sample) is not sample:
                raise InputError(
                    f"{path}, line {table.line_num}: {shown(name)} is in a line before", "Keep one of the lines."
                )
    except csv.Error as error:
        raise InputError(f"{path}: not a CSV table", "Save it as comma-separated UTF-8 text.") from error
    return list(samples.values()), []


def _row(row: dict[str, str], table: Table, lens_file: Path | None, focal_px: float | None) -> Sample:
    path, line = table.path, table.line_num

    def number(name: str) -> float | None:
        return table.number(row, name, "Correct or remove the line.")

    altitude = number("altitude_m")
    if altitude is None or altitude <= 0:
        raise InputError(f"{path}, line {line}: altitude_m must be a positive number", "Correct or remove the line.")
    pitch = number("pitch_deg")
    if pitch is not None and not -90 <= pitch < 0:
        raise InputError(
            f"{path}, line {line}: pitch_deg is {pitch:g}, not between -90 (straight down) and 0 (the horizon)",
            "Correct the column, or leave it out: then the photos' own tags count.",
        )
    roll = number("roll_deg")
    if roll is not None and not -360 <= roll <= 360:
        raise InputError(f"{path}, line {line}: roll_deg is {roll:g}, not between -360 and 360", "Correct the column.")
    name = (row["image"] or "").strip()
    if focal_px is None and lens_file is None:
        focal_px = number("focal_px")
    photo = open_photo(path.parent / name, name, lens_file=lens_file, focal_px=focal_px, pitch=pitch, roll=roll)
    return Sample(photo, altitude, (row.get("region") or "").strip() or path.stem)


def changed(samples: Sequence[Sample], pitch_deg: float = 0.0, focal: float = 1.0) -> list[Sample]:
    """The samples with a pitch that is wrong by `pitch_deg` (positive towards the horizon) or a focal length that is
    wrong by the factor `focal`, and an unchanged truth."""
    if not pitch_deg and focal == 1:
        return list(samples)
    angle = -np.radians(pitch_deg)  # about the camera's right, a positive angle would lower its view
    return [replace(s, photo=s.photo.turned(RIGHT, angle).refocused(focal)) for s in samples]
