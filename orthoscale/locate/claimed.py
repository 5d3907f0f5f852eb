"""The size of a photo's ground before the search, from its vehicles or from a given GSD."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.normal import Z90
from ..core.progress import Progress
from ..errors import InputError, OrthoscaleError, TooLittleEvidence
from ..option import positive
from ..photos.looking import Looking, boxes_of
from ..photos.measure import Interval90, PhotoScale, measure
from ..photos.photo import GivenCamera, Photo, open_photo, open_sound_photo
from ..sources.lens import lens_of
from ..sources.tags import read_tags
from .level import LevelledPhoto

if TYPE_CHECKING:
    from typing import Unpack

GSD_TOLD_SD = 0.03  # relative one sigma of a given GSD: maps and terrain are no better. An assumption.
NADIR_WITHIN = 1.0  # [deg] off nadir: a wrong focal length moves the foot by 2 % of the altitude at most
BY_VEHICLES, BY_WORD = "vehicles", "given"


@dataclass(frozen=True)
class ClaimedScale:
    """A photo with its average ground sampling distance [m/px] and 90 % interval.

    by : BY_VEHICLES or BY_WORD. measured : the vehicles' scale, None where the GSD was given. focal_known : whether the
    photo's focal length is known; without it, the altitude is not. notes : on the fleet and on the vehicles' boxes."""

    photo: Photo
    gsd: Interval90
    by: str
    measured: PhotoScale | None = None
    focal_known: bool = True
    notes: tuple[str, ...] = ()

    @property
    def sd(self) -> float:
        """Relative one sigma of the GSD."""
        return float(np.log(self.gsd.high / self.gsd.low) / (2 * Z90))

    @property
    def levelled(self) -> LevelledPhoto:
        """The ground that the photo shows if the GSD is right."""
        return LevelledPhoto(self.photo, self.photo.altitude_of(self.gsd.value))

    @property
    def factors(self) -> tuple[float, float]:
        """The ends of the interval, as multiples of the GSD."""
        return self.gsd.low / self.gsd.value, self.gsd.high / self.gsd.value

    def times(self, factor: float) -> ClaimedScale:
        """The same with a wrong scale, for trials."""
        return replace(self, gsd=self.gsd * factor)


def told_scale(path: Path, name: str, gsd: float, **lens: Unpack[GivenCamera]) -> ClaimedScale:
    """The photo at `path` with a given `gsd` [m/px]. Within NADIR_WITHIN of nadir the GSD alone determines the ground,
    so the focal length may be missing. Raises InputError, UsageError.
    """
    told, tags = Interval90.log_normal(gsd, GSD_TOLD_SD), read_tags(path)
    if lens.get("lens_file") is None and lens.get("focal_px") is None:
        try:
            lens_of(tags)
        except InputError:
            any_focal = float(np.hypot(tags.width, tags.height))  # any leads to the same ground
            photo = open_photo(path, name, **lens | {"focal_px": any_focal})
            if -photo.up[2] >= np.cos(np.radians(NADIR_WITHIN)):
                return ClaimedScale(photo, told, BY_WORD, None, focal_known=False)
    return ClaimedScale(open_photo(path, name, **lens), told, BY_WORD)


def claimed_scales(
    paths: Mapping[str, Path],
    gsd: float | None,
    how: Looking,
    progress: Progress | None = None,
    **lens: Unpack[GivenCamera],
) -> dict[str, ClaimedScale | OrthoscaleError]:
    """The scale of each photo of `paths`, or the error why it has none; from `gsd` [m/px] for all, if given.

    Raises UsageError; InputError where none of the photos can be read.
    """
    gsd = None if gsd is None else positive("--gsd", gsd)
    photos: list[Photo] = []
    found: dict[str, ClaimedScale | OrthoscaleError] = {}
    for name, path in paths.items():
        try:
            if gsd is None:
                photos.append(open_sound_photo(path, name, **lens))
            else:
                found[name] = told_scale(path, name, gsd, **lens)
        except InputError as error:
            if len(paths) == 1:
                raise
            found[name] = error
    return found | (_by_vehicles(photos, how, progress) if photos else {})


def _by_vehicles(
    photos: Sequence[Photo], how: Looking, progress: Progress | None
) -> dict[str, ClaimedScale | OrthoscaleError]:
    fleet, why = how.ruler_fleet([photo.path for photo in photos])
    hint = "Give the metres per pixel of the photo (--gsd), if known."
    try:
        boxes = boxes_of(photos, how, fleet, progress)
    except TooLittleEvidence as error:
        return {photo.name: TooLittleEvidence(f"no scale: {error.message}", hint) for photo in photos}
    found: dict[str, ClaimedScale | OrthoscaleError] = {}
    for photo in photos:
        try:
            got = measure([photo], boxes, fleet)
            found[photo.name] = ClaimedScale(photo, got.gsd, BY_VEHICLES, got, notes=(*why, *boxes.notes))
        except TooLittleEvidence as error:
            found[photo.name] = TooLittleEvidence(f"no scale: {error.message}", hint)
    return found
