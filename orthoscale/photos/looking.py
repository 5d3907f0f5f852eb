"""The boxes of photos, from a detector or a file in any format, and the fleet with which they are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from ..core.calibration import Calibration
from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.progress import Progress
from ..core.remarks import Remark
from ..detect.zoom import user_zoom
from ..errors import EvidenceDisagrees, TooLittleEvidence
from ..formats.calibration import load_calibration
from ..requests import PhotoRequest
from ..sources.country import fleet_at, named_fleet
from ..sources.location import location_in
from ..sources.picture_file import PictureFile
from .photo import Photo

WITH_GSD = "--gsd says how large a pixel is, nothing is measured"  # why options of measuring do nothing


@dataclass(frozen=True, kw_only=True)
class Looking(PhotoRequest):
    """How to look for vehicles in photos, and what to compare them with."""

    @cached_property
    def ruler(self) -> Calibration | None:
        """The detector's own ruler, if there is a `calibration`; read once. Raises InputError."""
        return None if self.calibration is None else load_calibration(Path(self.calibration))

    def ruler_fleet(self, photos: Sequence[Path]) -> tuple[Fleet, tuple[str, ...]]:
        """The fleet by which `photos` are measured, and notes on it; see `sources.country`."""
        fleet = named_fleet(self.fleet, self.ruler)
        return fleet_at(location_in(photos)) if fleet is None else (fleet, ())


@dataclass(frozen=True)
class Album:
    """Photos, with the names and sizes of their pictures as `formats.detections` needs them."""

    photos: Sequence[Photo]
    notes: list[Remark] = field(default_factory=list)
    claimed: None = None
    files: tuple[Path, ...] = ()

    @property
    def path(self) -> Path:
        """The photo, or the folder of the first one, for messages."""
        return self.photos[0].path if len(self.photos) == 1 else self.photos[0].path.parent

    @property
    def pictures(self) -> list[PictureFile]:
        """The photos' pixels, in order; each is read by windows."""
        return [photo.picture for photo in self.photos]

    @property
    def picture_names(self) -> list[str]:
        """The photos' names, which are the keys of detections."""
        return [photo.name for photo in self.photos]

    def image_size(self, name: str) -> tuple[int, int]:
        """Width and height of the photo `name` [px]."""
        return self._sizes[name]

    @cached_property
    def _sizes(self) -> dict[str, tuple[int, int]]:
        return {photo.name: (photo.picture.width, photo.picture.height) for photo in self.photos}


def boxes_of(photos: Sequence[Photo], how: Looking, fleet: Fleet, progress: Progress | None = None) -> Detections:
    """The boxes of `photos`, from a file or by the detector, which looks for vehicles as long as those of `fleet`.

    All photos share one zoom, as those of one flight do: measure flights at different heights in one run each. Notes on
    the boxes are in their `notes`.
    Raises InputError, UsageError, TooLittleEvidence, EvidenceDisagrees.
    """
    if how.detections is not None:
        from ..formats.detections import load

        album = Album(photos)
        found = load(Path(how.detections), album, how.vehicle_classes)
        found = replace(found, notes=(*found.notes, *(note.text for note in album.notes)))
    else:
        found = _detected(photos, how, fleet, progress)
    if how.ruler is not None:
        found = how.ruler.applied(found)
    return replace(found, notes=(*found.notes, *found.assumed))


def _detected(photos: Sequence[Photo], how: Looking, fleet: Fleet, progress: Progress | None) -> Detections:
    from ..detect.detector import Detector, Passes
    from ..detect.effort import Effort
    from ..detect.find import find_vehicles
    from ..detect.measurer import Measurer
    from ..detect.remeasure import MOST_IN_FRAMES, remeasured

    effort = Effort()
    path = None if how.detector is None else Path(how.detector)
    passes = Passes.TWICE_CONFIRMED if path is None else Passes.FINE_FIRST
    detector = Detector(path, how.decoder, how.vehicle_classes, effort.threads_each, passes)
    if how.ruler is not None:
        how.ruler.require_of(detector.name, detector.sha256)
    zoom = user_zoom(how.zoom, how.gsd_hint, detector.card, float(fleet.mean[0]))
    try:
        found = find_vehicles([photo.picture for photo in photos], detector, zoom, progress, effort)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        where = photos[0].name if len(photos) == 1 else f"{len(photos)} photos"
        raise type(error)(f"{where}: {error.message}", error.hint) from error
    found = replace(found, notes=(*found.notes, *detector.notes))
    if path is not None or how.ruler is not None:
        return found
    return remeasured([photo.picture for photo in photos], found, Measurer(), effort, progress, MOST_IN_FRAMES)
