"""One photo: its pixels, its lens, and which way it looks, from its tags or from the user."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from ..core.by_value import ByValue
from ..core.projection.level import level_axes, level_views, up_from_gimbal
from ..core.projection.view import LOWEST_ELEVATION, Views
from ..errors import InputError, UsageError
from ..sources.distortion import undistort
from ..sources.lens import Lens, beside_tags, lens_of
from ..sources.picture_file import PictureFile
from ..sources.tags import Tags, read_tags

if TYPE_CHECKING:
    from typing import Unpack

# One sigma of pitch and roll [rad]: as a gimbal reports them (it trembles by some tenths of a degree, and its zero is
# off by as much), as given by a user, and of a nadir that is only assumed. Assumptions.
GIMBAL_SD, TOLD_SD, ASSUMED_SD = np.radians([0.5, 1.0, 3.0])
TURNED_PITCH = -85.0  # [deg] a photo steeper than this keeps its pitch when its pixels are turned
RIGHT = np.array([1.0, 0.0, 0.0])  # of the camera
OUTLINE_ELEVATION = 10.0  # [deg] a corner that sees the ground at less lies too far away to mean anything


@dataclass(frozen=True, eq=False)
class Photo(ByValue):
    """One photo: its pixels, its lens, and which way it looks.

    up : (3,) the vertical in camera coordinates, as in `core.projection.level`. up_sd : one sigma of its tilt [rad].
    attitude : the angles and where they come from, in words.
    """

    name: str
    path: Path
    tags: Tags
    lens: Lens
    up: np.ndarray
    up_sd: float
    attitude: str

    @property
    def picture(self) -> PictureFile:
        """The photo's pixels, read by windows."""
        return PictureFile(self.name, self.path, self.tags.width, self.tags.height)

    @property
    def pitch(self) -> float:
        """Pitch of the optical axis [rad], -pi/2 straight down."""
        return float(np.arcsin(np.clip(self.up[2], -1, 1)))

    def gsd_from(self, altitude: float) -> float:
        """Its average ground sampling distance [m/px] from `altitude` [m]: r = s / |sin pitch|, altitude = s f
        (arXiv 2603.07535)."""
        return altitude / self.lens.focal_px / abs(float(self.up[2]))

    def altitude_of(self, gsd: float) -> float:
        """The altitude [m] from which it has the average `gsd` [m/px], as in `gsd_from`."""
        return gsd * abs(float(self.up[2])) * self.lens.focal_px

    def views(self, pixels: np.ndarray, altitude: float, lowest: float = LOWEST_ELEVATION) -> tuple[Views, np.ndarray]:
        """How level ground `altitude` below is seen at pixels (N, 2); and (N,) bool, whether it is seen there at
        `lowest` [deg] or steeper."""
        plane, lens, ok = undistort(self.lens.camera, pixels)
        views, seen = level_views(plane, lens, self.up, altitude, np.radians(lowest))
        return views, ok & seen

    def outline(self, altitude: float) -> np.ndarray | None:
        """(4, 2) its corners on level ground `altitude` below [unit of that], right and forward of the point below the
        camera, clockwise from the upper left; None if one lies above the horizon or sees the ground at less than
        OUTLINE_ELEVATION."""
        width, height = self.tags.width, self.tags.height
        corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
        views, seen = self.views(corners, altitude, OUTLINE_ELEVATION)
        return views.ground @ level_axes(self.up).T if seen.all() else None

    def turned(self, axis: np.ndarray, angle: float) -> Photo:
        """The same photo with its camera turned by `angle` [rad] about `axis` (3,), a unit vector of the camera."""
        return replace(self, up=self.up * np.cos(angle) + np.cross(axis, self.up) * np.sin(angle))

    def refocused(self, factor: float) -> Photo:
        """The same photo with `factor` times the focal length; principal point and distortion stay."""
        camera = copy(self.lens.camera)
        params = np.array(camera.params)
        params[list(camera.focal_length_idxs())] *= factor
        camera.params = params.tolist()
        return replace(self, lens=replace(self.lens, camera=camera))


class GivenCamera(TypedDict, total=False):
    """What a user says of a photo's camera, instead of its tags: keywords of `open_photo`.

    lens_file : calibration of the lens. focal_px : focal length [px]. pitch, roll : of the camera [deg].
    """

    lens_file: Path | None
    focal_px: float | None
    pitch: float | None
    roll: float | None


def open_photo(
    path: Path,
    name: str | None = None,
    *,
    lens_file: Path | None = None,
    focal_px: float | None = None,
    pitch: float | None = None,
    roll: float | None = None,
) -> Photo:
    """The photo at `path`. Given values (angles in degrees) take precedence over its tags, each angle by itself;
    without any, it is taken for nadir.

    Raises InputError for a file that is no photo or has no focal length, UsageError for an impossible pitch or roll,
    or a roll alone.
    """
    if roll is not None and not -360 <= roll <= 360:
        raise UsageError(f"--roll must lie between -360 and 360 degrees, not {roll:g}")
    tags = read_tags(path)
    try:
        lens = lens_of(tags, lens_file, focal_px)
    except InputError as error:
        raise InputError(f"{path}: {error.message}", error.hint) from error
    if doubt := beside_tags(lens, tags):
        tags = replace(tags, notes=(*tags.notes, doubt))
    if pitch is not None:
        if not -90 <= pitch < 0:
            raise UsageError(f"--pitch must lie between -90 (straight down) and 0 (the horizon), not {pitch:g}")
        kept = _roll_beside_told_pitch(tags) if roll is None else roll
        angles, sd, attitude = (pitch, kept), TOLD_SD, f"pitch {pitch:g}, given"
        if roll is None and kept:
            attitude += f"; roll {kept:g}, from XMP"
    elif tags.pitch is not None:
        if tags.turned and tags.pitch > TURNED_PITCH:
            raise InputError(
                f"{path}: it was rotated by a quarter turn after it was taken; its pitch of {tags.pitch:g} no longer "
                "applies",
                "Give its pitch and roll (--pitch, --roll), or the photo as the camera wrote it.",
            )
        angles = (tags.pitch, tags.roll or 0.0 if roll is None else roll)
        sd, attitude = GIMBAL_SD, f"pitch {tags.pitch:g}, roll {angles[1]:g}, from XMP"
    elif roll:
        raise UsageError("a roll means nothing for a photo that looks straight down", "Give its pitch too (--pitch).")
    else:
        angles, sd, attitude = (-90.0, 0.0), ASSUMED_SD, "nadir, assumed: the photo does not state its pitch"
    up = up_from_gimbal(*np.radians(angles))
    return Photo(name or path.name, path, tags, lens, up, float(sd), attitude)


def open_sound_photo(path: Path, name: str | None = None, **given: Unpack[GivenCamera]) -> Photo:
    """`open_photo`, which also reads some pixels, lest one damaged photo among many ends the search for vehicles.
    Raises InputError for a damaged one, too."""
    photo = open_photo(path, name, **given)
    photo.picture.read(0, 0, 1, 1, 1, 1)
    return photo


def _roll_beside_told_pitch(tags: Tags) -> float:
    """The roll in the tags [deg], for use with a given pitch; 0 if there is none or it does not hold. It does not for a
    photo that was turned since it was taken. Nor does a roll beyond 90 degrees, which DJI writes for some photos taken
    straight down: it only says where the top points (`Tags.heading`), and with another pitch the camera would be upside
    down."""
    if tags.roll is None or tags.turned or np.cos(np.radians(tags.roll)) <= 0:
        return 0.0
    return tags.roll
