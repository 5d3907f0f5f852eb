"""The protocols of sources, pictures of unknown scale: `Plan` (an orthophoto), `PosedSet` (frames with poses)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from .evidence import Evidence
from .projection.view import LOWEST_ELEVATION, Views
from .remarks import Remark

NEAR_NADIR = 60.0  # [deg] elevation of the viewing ray from which a frame may pass for an orthophoto
GROUND_FOLDER = "ground/"  # a ground picture has the name of its frame with this before it
NO_DATA_GREY = 114  # value of pixels without data that `Picture.read` returns


class Picture(Protocol):
    """An image that is read by windows: a raster, one frame of a reconstruction, or that frame warped onto the ground.

    name : unique within its source. width, height : [px].
    """

    @property
    def name(self) -> str: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """RGB uint8 (out_height, out_width, 3) of the window at (x, y) with `width` x `height` px, resampled.

        The window lies inside the image. Pixels without data are grey (114). Shrinking averages; enlarging is bicubic.
        """
        ...


@runtime_checkable
class FilePicture(Picture, Protocol):
    """A picture that is the whole of an image file, whose tags are then its own. path : of the file."""

    @property
    def path(self) -> Path: ...


class Claim(Protocol):
    """The scale that a source claims for itself. gsd_m : metres per pixel, None without any. usable : whether to trust
    it. unit_known : False if nothing says in what unit `gsd_m` is. why : the reason, for people. crs, transform : the
    georeferencing behind it, None without any. aspect : width over height of a pixel on the ground, 1 if that is not
    known. mirrored : whether the picture shows the ground mirrored: its rows go north, or its columns west. mistakes :
    that its georeferencing invites, with truth over `gsd_m` where they were made."""

    @property
    def gsd_m(self) -> float | None: ...
    @property
    def usable(self) -> bool: ...
    @property
    def unit_known(self) -> bool: ...
    @property
    def why(self) -> str: ...
    @property
    def crs(self) -> Any: ...
    @property
    def transform(self) -> Any: ...
    @property
    def aspect(self) -> float: ...
    @property
    def mirrored(self) -> bool: ...
    @property
    def mistakes(self) -> Sequence[tuple[float, str]]: ...


class Pictures(Protocol):
    """Something that has pictures.

    path : of its file or folder. notes : remarks for the user on how it was read or written.
    claimed : the scale and the place that it claims, None if it cannot claim any.
    """

    @property
    def path(self) -> Path: ...
    @property
    def notes(self) -> list[Remark]: ...
    @property
    def files(self) -> Sequence[Path]:
        """The files that it was read from, except its pictures; none of them is ever written to."""
        ...

    @property
    def pictures(self) -> Sequence[Picture]: ...
    @property
    def picture_names(self) -> list[str]:
        """Names of all its pictures, including those whose pixels are not available."""
        ...

    def image_size(self, name: str) -> tuple[int, int]:
        """Width and height of the picture `name` [px]."""
        ...

    @property
    def claimed(self) -> Claim | None: ...


@dataclass(frozen=True)
class Located:
    """A point of a source. place : (2,) or (3,) its position [source units]. read_sd : one sigma of reading it, along a
    line [source units]. ray : (2,) or (3,) from the camera that shows it to its place on the ground [source units]; 0
    for a point that was not seen on a ground."""

    place: np.ndarray
    read_sd: float
    ray: np.ndarray


class OffGround(ValueError):
    """A pixel to be located does not see the ground, or sees it at too low an elevation to be measured there."""


class Measurable(Pictures, Protocol):
    """What both kinds of source offer.

    unit : what its scale is measured in, "m/px", "m/model-unit" ...
    metric_already : why the source counts as metric already, as a sentence; empty if it does not. by_orthoscale :
    whether it says that orthoscale gave it its scale.
    """

    @property
    def unit(self) -> str: ...
    @property
    def metric_already(self) -> str: ...
    @property
    def by_orthoscale(self) -> bool: ...
    def content_hash(self) -> str:
        """SHA-256 of its files."""
        ...

    def from_above(self, place: np.ndarray) -> np.ndarray:
        """(N, 2) positions, x right and y up [source units], of places (N, D) in its own coordinates: the ground as
        seen from above, never mirrored."""
        ...

    def locate(self, point: str) -> Located:
        """The place of a point that a user gave as text. Raises ValueError, and `OffGround` for a pixel without
        ground."""
        ...


class Placement(Protocol):
    """Georeferencing of a plan. crs : its coordinate reference system. transform : the affine transform from its pixels
    to that. said : in words, how the input's own georeferencing was changed."""

    @property
    def crs(self) -> Any: ...
    @property
    def transform(self) -> Any: ...
    @property
    def said(self) -> str: ...


class Plan(Measurable, Picture, Protocol):
    """An orthophoto: one picture of the ground from straight above, and itself its only `Picture`. Its unit is the
    pixel.

    plan, posed : itself, and None; see `Source`. claimed : the scale by its georeferencing.
    """

    @property
    def plan(self) -> Plan: ...
    @property
    def posed(self) -> None: ...
    @property
    def claimed(self) -> Claim: ...

    def place(self, metres_per_pixel: float, keep_origin: bool = False) -> Placement:
        """The georeferencing of a copy with this scale: local metres or, if `keep_origin`, the input's place and
        direction."""
        ...

    def check_name(self, out: Path) -> None:
        """Raise UsageError for a file name that `write` would refuse."""
        ...

    def write(
        self, path: Path, metres_per_pixel: float, place: Placement | None = None, cog: bool = False, said: str = ""
    ) -> None:
        """Write a GeoTIFF of the same pixels in metres, at `place` (by default in local metres), with the text `said`
        on the scale in it. Remarks on the writing go to `notes`."""
        ...


@dataclass(frozen=True)
class FocalDoubt:
    """The uncertainty of a reconstruction's focal length. ratio : its most likely value over that in the model. sd :
    relative one-sigma of that. said : a remark for people, or ''."""

    ratio: float = 1.0
    sd: float = 0.0
    said: str = ""


@dataclass(frozen=True)
class GpsScale:
    """The scale of a reconstruction by the GPS positions of its frames. evidence : one piece, or none if there are no
    positions or they tell nothing. notes : why they tell nothing."""

    evidence: tuple[Evidence, ...] = ()
    notes: tuple[str, ...] = ()


class Ground(Protocol):
    """The ground under a reconstruction's cameras, and a plane that follows it [model units].

    up : (3,) unit vector away from it.
    """

    @property
    def up(self) -> np.ndarray: ...

    def plane(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) places on the plane, of points (N, 3)."""
        ...

    def lift(self, plane: np.ndarray) -> np.ndarray:
        """(N, 3) points on the ground, of places (N, 2) on the plane."""
        ...

    def height_above(self, points: np.ndarray) -> np.ndarray:
        """(N,) heights of points (N, 3) above the ground."""
        ...

    def sd(self, points: np.ndarray) -> np.ndarray:
        """(N,) one sigma of the ground's height straight below points (N, 3)."""
        ...


class GroundView(Picture, Protocol):
    """What one frame shows of the ground, warped to a plan of `unit_per_pixel` model units per pixel.

    image : the frame's name. size : (2,) its width and height [px]. camera_height : above the ground [model units].
    """

    @property
    def image(self) -> str: ...
    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def unit_per_pixel(self) -> float: ...
    @property
    def camera_height(self) -> float: ...
    @property
    def frame(self) -> Picture | None:
        """The frame, None if its pixels are not available."""
        ...

    def ground(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) pixels of this picture to (N, 3) points on the ground [model units, world]."""
        ...

    def seen(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the frame shows what this picture shows at `points` (N, 2): frame pixels (N, 2), NaN behind the camera;
        and (N, 2) vectors in the plane from the camera's foot to the points, in this picture's axes [camera heights].
        """
        ...


class PosedSet(Measurable, Protocol):
    """A reconstruction: pictures whose poses are known up to a scale. Lengths are in model units.

    plan, posed : None, and itself; see `Source`. ground : under its cameras. focal : how far its focal length can be
    trusted. parts : those that share no point with each other, each as a reconstruction of its own, the largest first;
    none if it holds together. Each is made when its turn comes, since it may hold a copy of the whole.
    """

    @property
    def plan(self) -> None: ...
    @property
    def posed(self) -> PosedSet: ...
    @property
    def ground(self) -> Ground: ...
    @property
    def parts(self) -> Iterator[PosedSet]: ...
    @property
    def focal(self) -> FocalDoubt: ...
    @property
    def bend_sd(self) -> float:
        """Relative one-sigma of the scale at its cameras over that on the ground, as far as its tracks leave open
        whether it is bent."""
        ...

    @property
    def gps(self) -> GpsScale:
        """The scale by the GPS positions of its frames."""
        ...

    @property
    def ground_pictures(self) -> Sequence[GroundView]:
        """The near-nadir parts of the frames, warped onto the ground."""
        ...

    @property
    def sparse(self) -> tuple[np.ndarray, np.ndarray]:
        """The sparse points: (M, 3) positions [model units] and (M, 3) uint8 RGB colours."""
        ...

    def views(
        self, name: str, points: np.ndarray, lowest_elevation: float = LOWEST_ELEVATION
    ) -> tuple[Views, np.ndarray, np.ndarray]:
        """How the picture `name` sees the ground at its pixels `points` (N, 2): the `Views`, the ground points (N, 3)
        in the world, and (N,) bool whether the ray meets known ground at `lowest_elevation` degrees or steeper."""
        ...

    def centre(self, name: str) -> np.ndarray:
        """(3,) the camera centre of the picture `name` [model units, world]."""
        ...

    def rotation(self, name: str) -> np.ndarray:
        """(3, 3) `camera_from_world` of the picture `name`: its rows are the camera's x, y and z in the world."""
        ...

    def project(self, name: str, world: np.ndarray) -> np.ndarray:
        """(N, 2) pixels of the picture `name` at which the points `world` (N, 3) lie; NaN where it cannot show them."""
        ...

    @property
    def dense(self) -> Path:
        """The dense workspace that belongs to it. Raises UsageError where there is none."""
        ...

    def check_writable(self) -> None:
        """Raise InputError if `write` could not write everything that belongs to it."""
        ...

    def write(self, folder: Path, metres_per_unit: float) -> None:
        """Write it in metres into the empty `folder`. Remarks on the writing go to `notes`."""
        ...

    def write_dense(self, folder: Path, metres_per_unit: float) -> None:
        """Write the dense workspace in metres into the empty `folder`; raises as `dense` does."""
        ...


Source: TypeAlias = Plan | PosedSet
"""The input whose scale is sought. One of its `plan` and `posed` is itself, the other None; that tells which it is."""
