"""How large a photo's ground is before it is looked for: from its vehicles, or from a GSD that is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.pooling.posterior import Z90
from ..detect.find import Progress
from ..errors import InputError, OrthoscaleError, TooLittleEvidence, UsageError
from ..photos.lens import lens_of
from ..photos.looking import Looking, boxes_of
from ..photos.measure import Measure, Photo, PhotoScale, measure, open_photo
from ..photos.tags import read_tags
from .level import LevelledPhoto

GSD_TOLD_SD = 0.03  # relative one-sigma of a GSD that is told: maps and terrain are not better. An assumption.
BY_VEHICLES, BY_WORD = "vehicles", "given"


@dataclass(frozen=True)
class ClaimedScale:
    """A photo with its average ground sampling distance [m/px] and 90 % interval.

    by : BY_VEHICLES or BY_WORD. measured : the vehicles' scale, None where it was told."""

    photo: Photo
    gsd: Measure
    by: str
    measured: PhotoScale | None = None

    @property
    def sd(self) -> float:
        """Relative one-sigma of the GSD."""
        return float(np.log(self.gsd.high / self.gsd.low) / (2 * Z90))

    @property
    def levelled(self) -> LevelledPhoto:
        """The ground that the photo shows if the GSD is right."""
        return LevelledPhoto(self.photo, altitude_of(self.photo, self.gsd.value))

    @property
    def factors(self) -> tuple[float, float]:
        """The ends of the interval, in GSDs."""
        return self.gsd.low / self.gsd.value, self.gsd.high / self.gsd.value

    def times(self, factor: float) -> ClaimedScale:
        """The same with a wrong scale, for trials."""
        return ClaimedScale(self.photo, self.gsd * factor, self.by, self.measured)


def altitude_of(photo: Photo, gsd: float) -> float:
    """The altitude [m] from which `photo` has the average `gsd` [m/px]: r = s / |sin pitch|, altitude = s f
    (arXiv 2603.07535)."""
    return gsd * abs(float(photo.up[2])) * photo.lens.focal_px


def open_for_gsd(path: Path, name: str, **lens: Any) -> Photo:
    """The photo at `path`, whose GSD is told; `lens` as for `open_photo`. From straight above a GSD says all, so there
    a focal length may be missing. Raises InputError, UsageError."""
    tags = read_tags(path)
    told = any(value is not None for value in lens.values())
    if not told and tags.pitch is None:
        try:
            lens_of(tags)
        except InputError:
            lens = {**lens, "focal_px": float(np.hypot(tags.width, tags.height))}
    return open_photo(path, name, **lens)


def claimed_scales(
    paths: Mapping[str, Path], gsd: float | None, how: Looking, progress: Progress | None = None, **lens: Any
) -> dict[str, ClaimedScale | OrthoscaleError]:
    """The scale of each photo of `paths`, or why it has none; from `gsd` [m/px] for all, where that is told.

    Raises UsageError; InputError where none of the photos can be read.
    """
    if gsd is not None and not (np.isfinite(gsd) and gsd > 0):
        raise UsageError(f"--gsd must be a positive number of metres per pixel, not {gsd:g}")
    photos: dict[str, Photo] = {}
    found: dict[str, ClaimedScale | OrthoscaleError] = {}
    for name, path in paths.items():
        try:
            photo = open_photo(path, name, **lens) if gsd is None else open_for_gsd(path, name, **lens)
            photo.picture.read(0, 0, 1, 1, 1, 1)
            photos[name] = photo
        except InputError as error:
            if len(paths) == 1:
                raise
            found[name] = error
    if gsd is not None:
        told = Measure.log_normal(gsd, GSD_TOLD_SD)
        return found | {name: ClaimedScale(photo, told, BY_WORD) for name, photo in photos.items()}
    return found | (_by_vehicles(list(photos.values()), how, progress) if photos else {})


def _by_vehicles(
    photos: Sequence[Photo], how: Looking, progress: Progress | None
) -> dict[str, ClaimedScale | OrthoscaleError]:
    fleet, _ = how.ruler_fleet([photo.path for photo in photos])
    hint = "Give the metres per pixel of the photo (--gsd), if known."
    try:
        boxes = boxes_of(photos, how, progress)
    except TooLittleEvidence as error:
        return {photo.name: TooLittleEvidence(f"no scale: {error.message}", hint) for photo in photos}
    found: dict[str, ClaimedScale | OrthoscaleError] = {}
    for photo in photos:
        try:
            got = measure([photo], boxes, fleet)
            found[photo.name] = ClaimedScale(photo, got.gsd, BY_VEHICLES, got)
        except TooLittleEvidence as error:
            found[photo.name] = TooLittleEvidence(f"no scale: {error.message}", hint)
    return found
