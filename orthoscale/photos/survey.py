"""A set of photos: vehicles are detected in all together, each photo is measured, and on request all are pooled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.boxes import Boxes
from ..core.brief import Brief
from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.pooling.usable import MIN_VEHICLES
from ..errors import InputError, TooLittleEvidence, UsageError
from ..option import number
from ..system.paths import path_of, paths_of
from .depth.maps import Depths
from .folders import find_photos
from .looking import Album, Looking, boxes_of
from .measure import Interval90, PhotoScale, measure
from .photo import GivenCamera, Photo, open_photo, open_sound_photo
from .tables import PhotoOutcome, document

if TYPE_CHECKING:
    from typing import Unpack

    from ..core.progress import Progress
    from ..requests import PhotoOptions

LINES_SHOWN = 6  # photos that a printed survey lists
SAME_FOCAL = 0.001  # relative difference of focal lengths up to which photos are of one lens


@dataclass(frozen=True, repr=False)
class Survey(Brief):
    """outcomes : of each photo by itself. together : one scale of all of them, if requested. found : the boxes. photos
    : those that could be read. fleet : by which they were measured. why : notes on the choice of the fleet, and on
    files that were not read."""

    outcomes: list[PhotoOutcome]
    together: PhotoScale | None
    found: Detections
    photos: list[Photo]
    fleet: Fleet
    why: tuple[str, ...] = ()

    def brief(self) -> list[tuple[str, str]]:
        """A few lines: how many were measured, the pooled altitude if requested, and the first photos."""
        measured = [(outcome.name, got) for outcome in self.outcomes if (got := outcome.measured) is not None]
        head = [("photos", f"{len(measured)} of {len(self.outcomes)} measured, fleet {self.fleet.code}")]
        if self.together is not None:
            head += [("altitude", f"{self.together.altitude} m, of all together ({self.together.scale.verdict})")]
        lines = [
            (name, f"altitude {got.altitude} m, GSD {got.gsd * 100} cm/px ({got.scale.verdict})")
            for name, got in measured[:LINES_SHOWN]
        ]
        more = len(measured) - len(lines)
        return [*head, *lines, *([("...", f"{more} more; to_dict() has them all")] if more else [])]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, a row for each photo; what `orthoscale photo --json` prints."""
        notes = (*self.why, *self.found.notes)
        return document(self.outcomes, self.fleet, self.found.detector, self.together, notes)


def photo(
    paths: str | Path | Sequence[str | Path],
    *,
    focal_px: float | None = None,
    lens_file: str | Path | None = None,
    pitch: float | None = None,
    roll: float | None = None,
    together: bool = False,
    progress: Progress | None = None,
    **options: Unpack[PhotoOptions],
) -> Survey:
    """Measure single photos from a drone: scale, altitude over the ground, ground sampling distance, footprint.

    paths : photos, and folders of them. focal_px [px], lens_file, pitch and roll [deg] : replace the values of the
    photos' tags. together : also give one scale for all, which one lens must have taken from one altitude. options :
    fleet and detector as in `estimate`; depth, depth_kind, depth_factor : a metric depth, whose altitude is compared.
    Raises InputError, UsageError; TooLittleEvidence where no photo has enough vehicles.
    """
    given = paths_of(paths, "the path of a photo, or of a folder of them")
    lens = None if lens_file is None else path_of(lens_file, "the path of a calibration of the lens")
    numbers = {"--focal-px": focal_px, "--pitch": pitch, "--roll": roll}
    focal_px, pitch, roll = (None if v is None else number(name, v) for name, v in numbers.items())
    told: GivenCamera = {"lens_file": lens, "focal_px": focal_px, "pitch": pitch, "roll": roll}
    return surveyed(given, Looking.of(options), together, progress, **told)


def surveyed(
    paths: Sequence[Path],
    how: Looking,
    together: bool = False,
    progress: Progress | None = None,
    on_boxes: Callable[[Detections, Album], None] | None = None,
    on_open: Callable[[Album], None] | None = None,
    **lens: Unpack[GivenCamera],
) -> Survey:
    """Measure the photos at `paths` as `how` requests. See `photo`.

    on_boxes : called as soon as boxes are found, whether or not they are enough for a scale. on_open : called with the
    photos as soon as they are open, and may refuse them.
    """
    given = find_photos(paths)
    photos, problems = open_photos(given.paths, decode=how.detections is None, **lens)
    album = Album(photos)
    if on_open is not None:
        on_open(album)
    depths = Depths.asked(how, several=len(photos) > 1)
    fleet, why = how.ruler_fleet([photo.path for photo in photos])
    found = boxes_of(photos, how, fleet, progress)
    if on_boxes is not None:
        on_boxes(found, album)
    outcomes = measure_each(photos, problems, found, fleet)
    if depths is not None:
        outcomes = compared(outcomes, depths, found)
    pooled = measure_together(photos, found, fleet) if together else None
    if pooled is None and not any(outcome.measured for outcome in outcomes):
        most = max(outcomes, key=lambda outcome: len(found.boxes.get(outcome.name, ())))
        raise TooLittleEvidence(
            f"none of {len(outcomes)} photos has enough vehicles; the best is {most.name}: {most.problem}"
            if len(outcomes) > 1
            else f"{most.name}: {most.problem}",
            "\n".join(
                ["Give photos with more vehicles, or pool those of a level flight with --together.", *given.notes]
            ),
        )
    return Survey(outcomes, pooled, found, photos, fleet, (*given.notes, *why))


def open_photos(
    paths: dict[str, Path], decode: bool = True, **lens: Unpack[GivenCamera]
) -> tuple[list[Photo], dict[str, str]]:
    """The photos that can be used, and why the others cannot. Raises InputError if none can.

    decode : leave out damaged ones too; see `open_sound_photo`.
    """
    photos: list[Photo] = []
    errors: dict[str, InputError] = {}
    opened = open_sound_photo if decode else open_photo
    for name, path in paths.items():
        try:
            photos.append(opened(path, name, **lens))
        except InputError as error:
            if len(paths) == 1:
                raise
            errors[name] = error
    if not photos:
        first = next(iter(errors.values()))
        raise InputError(f"none of {len(errors)} photos can be used; {first.message}", first.hint)
    return photos, {name: error.message.removeprefix(f"{paths[name]}: ") for name, error in errors.items()}


def measure_each(
    photos: Sequence[Photo], problems: dict[str, str], found: Detections, fleet: Fleet
) -> list[PhotoOutcome]:
    """The outcome of each photo by itself, including those that could not be read, in the order of their names."""
    outcomes = [PhotoOutcome(name, None, None, problem) for name, problem in problems.items()]
    for photo in photos:
        boxes = len(found.boxes.get(photo.name, ()))
        try:
            outcomes.append(PhotoOutcome(photo.name, photo, measure([photo], found, fleet), boxes=boxes))
        except TooLittleEvidence as error:
            outcomes.append(PhotoOutcome(photo.name, photo, None, error.message, boxes))
    return sorted(outcomes, key=lambda outcome: outcome.name)


def compared(outcomes: Sequence[PhotoOutcome], depths: Depths, found: Detections) -> list[PhotoOutcome]:
    """`outcomes` with the altitude by the depth of each photo, or the reason why there is none.

    Raises InputError if no photo has one.
    """
    made: list[PhotoOutcome] = []
    refused: list[InputError] = []
    for outcome in outcomes:
        if outcome.photo is not None:
            by_vehicles: Interval90 | None = outcome.measured.altitude if outcome.measured else None
            try:
                boxes = found.boxes.get(outcome.name, Boxes.empty())
                outcome = replace(outcome, depth=depths.altitude(outcome.photo, boxes, by_vehicles))
            except InputError as error:
                refused.append(error)
                outcome = replace(outcome, depth_problem=error.message)
        made.append(outcome)
    if refused and not any(outcome.depth for outcome in made):
        raise refused[0]
    return made


def measure_together(photos: Sequence[Photo], found: Detections, fleet: Fleet) -> PhotoScale:
    """One scale for photos that one lens took from one height over the ground. Raises UsageError for several lenses.

    A vehicle that k photos show has k votes, and boxes alone do not show which are of the same vehicle. So the sampling
    part of the interval is that of k times fewer vehicles, where k is how many photos show a place: by where they were
    taken, or all of them if EXIF does not say. Raises TooLittleEvidence if k is known and leaves too few vehicles.
    """
    focal = np.array([p.lens.focal_px for p in photos])
    if np.ptp(focal) > SAME_FOCAL * focal.mean():
        ends = [f"{focal[k]:.0f} px ({photos[k].name})" for k in map(int, (focal.argmin(), focal.argmax()))]
        raise UsageError(
            f"--together is for photos of one lens; focal lengths go from {ends[0]} to {ends[1]}",
            "Measure them in one run each.",
        )
    alone = measure(photos, found, fleet)
    looking = [p for p in photos if len(found.boxes.get(p.name, ()))]
    overlap = photos_per_place(looking, alone)
    if overlap is not None and round(different := alone.scale.vehicles_used / overlap) < MIN_VEHICLES:
        raise TooLittleEvidence(
            f"{alone.scale.vehicles_used} boxes in {len(looking)} photos, but {overlap:.1f} photos show each place: "
            f"about {different:.0f} different vehicles, {MIN_VEHICLES} are needed",
            "Give photos of more ground.",
        )
    return alone.overlapping(len(looking) if overlap is None else overlap)


def photos_per_place(photos: Sequence[Photo], scale: PhotoScale) -> float | None:
    """How many of `photos` show a place that any of them shows, on average; None if it is not known.

    Each photo is taken for a disc of its footprint's area about the camera: headings matter little for this.
    """
    import pyproj
    import shapely

    places = [p.tags.lon_lat for p in photos]
    if any(place is None for place in places):
        return None
    lon, lat = np.array(places, float).T
    azimuth, _, distance = pyproj.Geod(ellps="WGS84").inv(
        np.full(len(lon), lon[0]), np.full(len(lat), lat[0]), lon, lat
    )
    x, y = distance * np.sin(np.radians(azimuth)), distance * np.cos(np.radians(azimuth))
    area = scale.footprint[0].value * scale.footprint[1].value
    discs = shapely.buffer(shapely.points(x, y), np.sqrt(area / np.pi))
    return float(shapely.area(discs).sum() / shapely.union_all(discs).area)
