"""Reconstructions and cameras: nerfstudio, OpenSfM, similarity transforms, lenses."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from .values import Finite, Name, Px, PxLength, Size, Text

Bend = Annotated[float, Meta(ge=-1e4, le=1e4)]  # a coefficient of distortion


class Distortion(Struct, kw_only=True):
    """Radial (k) and tangential (p) coefficients, as in OpenCV."""

    k1: Bend = 0.0
    k2: Bend = 0.0
    k3: Bend = 0.0
    p1: Bend = 0.0
    p2: Bend = 0.0


class LensEntry(Distortion, kw_only=True):
    """A calibrated camera [px]; `focal_px` may stand for `fx`."""

    width: Size
    height: Size
    fx: PxLength | None = None
    focal_px: PxLength | None = None
    fy: PxLength | None = None
    cx: Px | None = None
    cy: Px | None = None

    def __post_init__(self) -> None:
        if self.fx is None and self.focal_px is None:
            raise ValueError("fx or focal_px is missing")


Focal = Annotated[float, Meta(gt=0, le=1e4)]  # as a share of a picture's longer side
Vector = tuple[Finite, Finite, Finite]
Row = tuple[Finite, Finite, Finite, Finite]
Pose = tuple[Row, Row, Row, Row]
Six = tuple[Finite, Finite, Finite, Finite, Finite, Finite]


class Sim3Entry(Struct):
    """`formats.geometry.sim3.Sim3`."""

    scale: Finite
    rotation_wxyz: Row
    translation: Vector


class Intrinsics(Distortion, kw_only=True):
    """nerfstudio's intrinsics, for all frames or for one: each may be given in either place."""

    w: Annotated[float, Meta(ge=1, lt=2**20)] | UnsetType = UNSET
    h: Annotated[float, Meta(ge=1, lt=2**20)] | UnsetType = UNSET
    fl_x: PxLength | UnsetType = UNSET
    fl_y: PxLength | UnsetType = UNSET
    cx: Px | UnsetType = UNSET
    cy: Px | UnsetType = UNSET
    k4: Bend = 0.0
    camera_angle_x: Annotated[float, Meta(gt=0, lt=3.1415)] | UnsetType = UNSET
    camera_model: Name | UnsetType = UNSET
    is_fisheye: bool = False  # instant-ngp's


class TransformsFrame(Intrinsics, kw_only=True):
    """A picture of ``transforms.json``: camera to world (4, 4), OpenGL's axes (y up, z backwards)."""

    file_path: Text
    transform_matrix: Pose
    transform_matrix_start: Pose | None = None
    transform_matrix_end: Pose | None = None


class Transforms(Intrinsics, kw_only=True):
    """nerfstudio's and instant-ngp's ``transforms.json``."""

    frames: list[TransformsFrame]
    applied_transform: tuple[Row, Row, Row] | UnsetType = UNSET
    ply_file_path: Text | UnsetType = UNSET
    integer_depth_scale: Finite | UnsetType = UNSET


class OpensfmCamera(Distortion, kw_only=True):
    """A camera of OpenSfM: size [px], focal lengths and centre as shares of the longer side."""

    width: Size
    height: Size
    projection_type: Name = "perspective"
    focal: Focal | UnsetType = UNSET
    focal_x: Focal | UnsetType = UNSET
    focal_y: Focal | UnsetType = UNSET
    c_x: Finite = 0.0
    c_y: Finite = 0.0
    k4: Bend = 0.0


class OpensfmPlaced(Struct):
    """Anything with a position: the translation from world to camera, as in OpenSfM."""

    translation: Vector


class OpensfmShot(OpensfmPlaced):
    """A picture: rotation from world to camera, as axis times angle [rad]."""

    rotation: Vector
    camera: Text
    gps_dop: Finite | UnsetType = UNSET
    covariance: tuple[Six, Six, Six, Six, Six, Six] | None = None


class OpensfmPoint(Struct):
    """A point of the cloud [units of the model], its colour 0 to 255."""

    coordinates: Vector
    color: Vector = (128.0, 128.0, 128.0)


class OpensfmPart(Struct):
    """One of the reconstructions in OpenSfM's ``reconstruction.json``."""

    shots: dict[str, OpensfmShot]
    cameras: dict[str, OpensfmCamera] = {}
    points: dict[str, OpensfmPoint] = {}
    pano_shots: dict[str, OpensfmShot] = {}
    rig_instances: dict[str, OpensfmPlaced] = {}
    rig_cameras: dict[str, OpensfmPlaced] = {}


class SplatCamera(Struct):
    """A view in the ``cameras.json`` beside a Gaussian splat: its position [units of the model, world]."""

    img_name: Text
    position: Vector


class ReferenceLla(Struct):
    """The place of a reconstruction in OpenSfM [degrees, WGS 84]."""

    longitude: Annotated[float, Meta(ge=-180, le=180)]
    latitude: Annotated[float, Meta(ge=-90, le=90)]
