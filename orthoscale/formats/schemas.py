"""Schemas of all JSON files that orthoscale reads: types, and the ranges of plausible values.

Lengths are in metres or pixels as the documents of the formats define. Fields that are not named here are allowed
unless a schema forbids them. This module is imported only when a file is read, because msgspec takes time to import.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from ..core.boxes import KINDS
from ..core.market_segments import AXES
from ..core.projection.exact import BODIES
from ..core.ruler import Ruler

Finite = Annotated[float, Meta(ge=-1e15, le=1e15)]
Positive = Annotated[float, Meta(gt=0, le=1e15)]
Share = Annotated[float, Meta(ge=0, le=1)]
Threshold = Annotated[float, Meta(gt=0, lt=1)]  # of a confidence: its log odds are finite
Count = Annotated[int, Meta(ge=0, le=10**12)]
Text = Annotated[str, Meta(max_length=10_000)]
Name = Annotated[str, Meta(max_length=1_000)]
Metres = Annotated[float, Meta(ge=0.3, le=50)]  # of a vehicle: a bicycle's width to a road train's length
Sigma = Annotated[float, Meta(gt=0, le=25)]  # [m] of that
Px = Annotated[float, Meta(ge=-1e7, le=1e7)]  # a place in a picture
PxLength = Annotated[float, Meta(gt=0, le=1e7)]
PxOfDetector = Annotated[float, Meta(ge=-50, le=50)]  # of a margin
PxSd = Annotated[float, Meta(ge=0, le=100)]
Size = Annotated[int, Meta(gt=0, lt=2**20)]  # width or height of a picture


# Detectors


Shrink = Annotated[float, Meta(ge=-1, lt=1)]  # 1 draws all vehicles alike: nothing could be measured
Height = Annotated[float, Meta(ge=0, le=20)]  # [m] up to which boxes enclose a vehicle
InputPx = Annotated[float, Meta(gt=0, le=10_000)]  # a vehicle in a network's input


class RulerEntry(Struct, forbid_unknown_fields=True):
    """`core.ruler.Ruler`."""

    margin: tuple[PxOfDetector, PxOfDetector] = Ruler.margin
    margin_sd: tuple[PxSd, PxSd] = Ruler.margin_sd
    bias_sd: tuple[Share, Share] = Ruler.bias_sd
    common_sd: Share = Ruler.common_sd
    noise: tuple[PxSd, PxSd] = Ruler.noise
    shrink: tuple[Shrink, Shrink] = Ruler.shrink
    shrink_sd: tuple[Share, Share] = Ruler.shrink_sd
    usual: tuple[Metres, Metres] = Ruler.usual
    kinds: tuple[tuple[Share, Share, Share, Share], ...] = Ruler.kinds
    kinds_vehicles: Annotated[float, Meta(ge=0.1, le=1e6)] = Ruler.kinds_vehicles

    def __post_init__(self) -> None:
        rows = len(KINDS)
        if self.kinds and (len(self.kinds) != rows or any(abs(sum(row) - 1) > 0.02 for row in self.kinds)):
            raise ValueError(f"kinds: expected {rows} rows, the sum of each 1")

    @property
    def ruler(self) -> Ruler:
        """The same as a value of the core."""
        return Ruler(**{name: getattr(self, name) for name in self.__struct_fields__})


def _check_body(name: str) -> None:
    if name not in BODIES:
        raise ValueError(f"body: expected one of {', '.join(BODIES)}")


class NormalisationEntry(Struct):
    """`detect.output_forms.Normalisation`."""

    mean: tuple[Finite, Finite, Finite]
    std: tuple[Positive, Positive, Positive]
    channels: Literal["RGB", "BGR"] = "RGB"


class CardEntry(Struct, forbid_unknown_fields=True):
    """`detect.detector.Card`."""

    name: Name
    usable_length: tuple[InputPx, InputPx]
    best_length: InputPx
    score: Threshold
    effective_height: tuple[Height, Height]
    ruler: RulerEntry
    training: Text = ""
    licence: Text = ""
    sure: Share = 0.0
    stride: Annotated[int, Meta(ge=1, le=1024)] = 32
    body: Name = "car"
    normalisation: NormalisationEntry | UnsetType = UNSET
    extra: dict[str, Any] = {}

    def __post_init__(self) -> None:
        _check_body(self.body)
        if not self.usable_length[0] < self.usable_length[1]:
            raise ValueError("usable_length: expected the shorter of two lengths first")


class EmbeddingCardEntry(Struct, forbid_unknown_fields=True):
    """`locate.retrieval.EmbeddingCard`."""

    name: Name = ""
    size: Annotated[int, Meta(ge=16, le=4096)] | None = None
    normalisation: NormalisationEntry | UnsetType = UNSET
    licence: Text = ""
    extra: dict[str, Any] = {}


class MeasurerCardEntry(Struct, forbid_unknown_fields=True):
    """`detect.measurer.MeasurerCard`."""

    name: Name
    ruler: RulerEntry
    sigma_times: tuple[Annotated[float, Meta(gt=0, le=100)], Annotated[float, Meta(gt=0, le=100)]]
    effective_height: tuple[Height, Height]
    body: Name = "car"
    inward: Annotated[float, Meta(ge=0, le=100)] = 0.0
    sure: tuple[Annotated[float, Meta(ge=0, le=1)], Annotated[float, Meta(ge=0, le=100)]] = (0.0, 0.0)
    training: Text = ""
    licence: Text = ""

    def __post_init__(self) -> None:
        _check_body(self.body)


class Task(Struct):
    """One step of MMDeploy's pipeline; among its transforms is the normalisation."""

    transforms: list[dict[str, Any]] = []


class Tasks(Struct):
    """The steps, in their order."""

    tasks: list[Task]


class Pipeline(Struct):
    """MMDeploy's ``pipeline.json``."""

    pipeline: Tasks


# Detections


BoxSigma = Annotated[float, Meta(ge=0, le=10)] | None


class BoxEntry(Struct):
    """One oriented box [px, rad]; `sigma` and `kinds` as in `core.boxes.Boxes`, null where unknown."""

    cx: Px
    cy: Px
    length: PxLength
    width: PxLength
    angle: Annotated[float, Meta(ge=-1e3, le=1e3)]
    score: Share = 1.0
    kind: Name = "vehicle"
    sigma: tuple[BoxSigma, BoxSigma] = (None, None)
    kinds: tuple[Share, Share, Share, Share] | None = None


BoxesByPicture = dict[str, list[BoxEntry]]


class NoteEntry(Struct, kw_only=True):
    """What is needed to measure with boxes, and what beside the vehicles was found (`core.detections.Detections`)."""

    zoom: Annotated[float, Meta(gt=1e-4, le=1e3)]
    effective_height: tuple[Height, Height]
    detector_sha256: Name
    detector: Text | UnsetType = UNSET
    body: Name = "car"
    ruler: RulerEntry | UnsetType = UNSET
    doubtful: BoxesByPicture = {}
    set_aside: dict[Text, BoxesByPicture] = {}
    objects: BoxesByPicture = {}
    planar: DetectionsEntry | None = None

    def __post_init__(self) -> None:
        _check_body(self.body)


class DetectionsEntry(NoteEntry, kw_only=True):
    """Orthoscale's own file of detections."""

    pictures: BoxesByPicture


class ReferenceLla(Struct):
    """OpenSfM's place of a reconstruction [degrees, WGS 84]."""

    longitude: Annotated[float, Meta(ge=-180, le=180)]
    latitude: Annotated[float, Meta(ge=-90, le=90)]


class CocoImage(Struct):
    """An entry of ``images``; its size [px] may be missing, written as 0."""

    id: int | str
    file_name: Text
    width: Annotated[float, Meta(ge=0, le=1e7)] = 0
    height: Annotated[float, Meta(ge=0, le=1e7)] = 0


class CocoCategory(Struct):
    """An entry of ``categories``: what annotations are of."""

    id: int | str
    name: Text


class CocoAnnotation(Struct):
    """A box: a ``segmentation`` of four corners (x, y, x, y ...) [px], or a ``bbox`` with an angle."""

    image_id: int | str
    category_id: int | str | None = None
    segmentation: list[list[Px]] | dict[str, Any] | None = None
    bbox: list[Px] | None = None
    score: Share = 1.0
    sigma: tuple[BoxSigma, BoxSigma] = (None, None)
    kinds: tuple[Share, Share, Share, Share] | None = None


class CocoInfo(Struct):
    """``info``, in which orthoscale keeps what COCO has no field for."""

    orthoscale: NoteEntry | None = None


class Coco(Struct):
    """COCO's detection format, https://cocodataset.org/#format-data."""

    annotations: list[CocoAnnotation]
    images: list[CocoImage] = []
    categories: list[CocoCategory] = []
    info: CocoInfo | None = None


class GeoGeometry(Struct):
    """GeoJSON's geometry (RFC 7946); coordinates are checked where they are read."""

    type: Name
    coordinates: Any = None


class GeoFeature(Struct):
    """One vehicle: its outline and its properties."""

    geometry: GeoGeometry | None
    properties: dict[str, Any] | None = None


class GeoCrsName(Struct):
    """The reference system's name, an EPSG code as a URN."""

    name: Text


class GeoCrs(Struct):
    """The member ``crs`` of GeoJSON 2008, which RFC 7946 dropped and GIS programs still write."""

    properties: GeoCrsName


class GeoNote(Struct):
    """Orthoscale's own member: whether coordinates are pixels."""

    coordinates: str | None = None


class GeoCollection(Struct):
    """A FeatureCollection of vehicles."""

    features: list[GeoFeature]
    crs: GeoCrs | None = None
    orthoscale: GeoNote | None = None


# Fleets


Sizes = tuple[Metres, Sigma]  # mean and one sigma between vehicles
Correlation = Annotated[float, Meta(gt=-1, lt=1)]
Weight = Annotated[float, Meta(ge=0, le=1e6)]


WIDEST = 0.5  # sigma of a size as a share of it: a size may not be nought


def _check_sizes(entry: FleetEntry | MixturePart) -> None:
    for axis in AXES:
        mean, sd = getattr(entry, axis)
        if sd > WIDEST * mean:
            raise ValueError(f"{axis}: expected a mean and a sigma of at most half of it")
    if entry.length[0] < entry.width[0]:
        raise ValueError("length: expected no less than the width")


class MixturePart(Struct, rename={"class_": "class"}):
    """One class of a mixture: mean and one sigma of its sizes [m], and its share of the fleet as a weight."""

    class_: Name
    length: Sizes
    width: Sizes
    height: Sizes
    weight: Weight = 1.0
    corr_LW: Correlation | UnsetType = UNSET


class FleetEntry(Struct):
    """An entry of ``data/fleets.json``, and a user's file; see `core.fleet.Fleet`."""

    name: Text
    source: Text
    length: Sizes
    width: Sizes
    height: Sizes
    mean_sd: tuple[Sigma, Sigma, Sigma]
    shares: dict[str, Weight] | UnsetType = UNSET
    mixture: list[MixturePart] | None = None
    corr_LW: Correlation | UnsetType = UNSET
    year: Annotated[int, Meta(ge=0, le=9999)] = 0
    shares_source: Text = ""

    def __post_init__(self) -> None:
        _check_sizes(self)
        for part in self.mixture or ():
            _check_sizes(part)
        for axis, sd in zip(AXES, self.mean_sd, strict=True):
            if sd > WIDEST * getattr(self, axis)[0]:
                raise ValueError(f"mean_sd: expected at most half of the {axis}")
        if self.shares is not UNSET and not sum(self.shares.values()) > 0:
            raise ValueError("expected shares of which one is greater than nought")
        if self.mixture and not sum(part.weight for part in self.mixture) > 0:
            raise ValueError("expected a mixture of which one weight is greater than nought")


class Segment(Struct, rename={"class_": "class"}):
    """A market segment: its sizes [m] over `models` models on sale."""

    class_: Name
    length: Sizes
    width: Sizes
    height: Sizes
    corr_LW: Correlation
    models: Annotated[int, Meta(ge=1)]


class FleetTable(Struct):
    """``data/fleets.json``."""

    segments: dict[str, Segment]
    fleets: dict[str, FleetEntry]


class CalibrationEntry(Struct):
    """`core.calibration.Calibration`."""

    kind: Literal["orthoscale calibration 1"]
    detector: Text
    detector_sha256: Name
    ruler: RulerEntry
    fleet: FleetEntry | None
    made_from: dict[str, Any]


# Shipped tables of what is known besides vehicles


class ObjectStandard(Struct):
    """The standard size of one kind of object [m], and who says so."""

    name: Text
    length: Sizes
    width: Sizes
    source: Text


class AnchorStandard(Struct, forbid_unknown_fields=True):
    """The size that things of one kind of anchor have somewhere, and one sigma of it [m]."""

    kind: Name
    metres: Annotated[float, Meta(gt=0, lt=1e4)]
    name: Name = "your own"
    sd: Annotated[float, Meta(gt=0, lt=1e4)] | None = None
    source: Text = ""

    def __post_init__(self) -> None:
        if self.sd is not None and self.sd >= self.metres:
            raise ValueError("sd: expected less than the metres")


class AnchorStandards(Struct):
    """A user's file of standards."""

    standards: list[AnchorStandard]


class ObjectTable(Struct):
    """``data/objects.json``."""

    objects: dict[str, list[ObjectStandard]]


class Stall(Struct):
    """The size of a country's parking stalls and what their width strays by, one sigma [m]. countries : whose they
    are, of a row whose key is no country."""

    width: Metres
    width_sd: Sigma
    length: Metres
    source: Text
    countries: list[str] = []


class StallTable(Struct):
    """``data/stalls.json``."""

    stalls: dict[str, Stall]


# Layout


Extent = Annotated[float, Meta(gt=0, le=10_000)]  # [m]
RunOff = Annotated[float, Meta(ge=0, le=10_000)]
Colour = Annotated[int, Meta(ge=0, le=255)]
Line = Annotated[list[str | Annotated[float, Meta(ge=-10_000, le=10_000)]], Meta(min_length=1, max_length=10)]


class FacilityEntry(Struct):
    """One of ``data/facilities.json`` or of a user's catalogue; see `layout.catalogue`."""

    name: Text
    source: Text
    length: Extent
    width: Extent
    ends: RunOff = 0.0
    sides: RunOff = 0.0
    north_south: bool = False
    shape: Name = ""
    lines: list[Line] = []
    both_ends: list[Line] = []
    infield: Name | None = None
    look: Text | UnsetType = UNSET
    colour: tuple[Colour, Colour, Colour] | UnsetType = UNSET

    def __post_init__(self) -> None:
        if self.length < self.width:
            raise ValueError("expected a length of no less than the width")


class Catalogue(Struct):
    """A user's facilities by their code."""

    facilities: dict[str, FacilityEntry]


class Aisle(Struct):
    """The aisle between parking bays of one country [m]."""

    aisle: Extent
    source: Text


class FacilityTable(Catalogue):
    """``data/facilities.json``."""

    parking: dict[str, Aisle]


# Lenses


Bend = Annotated[float, Meta(ge=-1e4, le=1e4)]  # a coefficient of distortion


class LensEntry(Struct):
    """A calibrated camera [px], distortion as in OpenCV; `focal_px` may stand for `fx`."""

    width: Size
    height: Size
    fx: PxLength | None = None
    focal_px: PxLength | None = None
    fy: PxLength | None = None
    cx: Px | None = None
    cy: Px | None = None
    k1: Bend = 0.0
    k2: Bend = 0.0
    p1: Bend = 0.0
    p2: Bend = 0.0
    k3: Bend = 0.0

    def __post_init__(self) -> None:
        if self.fx is None and self.focal_px is None:
            raise ValueError("fx or focal_px is missing")


# Reports


class ReportScale(Struct):
    """What of a report (`report.document`) says how long a unit is."""

    scale: Positive
    interval90: tuple[Positive, Positive]


class ReportRemark(Struct):
    """`core.remarks.Remark`."""

    severity: Literal["refusal", "caution", "support", "info"]
    text: Text


class ReportJudgement(Struct):
    """`core.remarks.Judgement`."""

    severity: Literal["refusal", "caution", "support", "info"]
    what: Text
    detail: Text


class Explained(Struct):
    """What of a report `report.explanation` needs."""

    scale: Positive
    unit: Name
    uncertainty: dict[str, Annotated[float, Meta(ge=0, le=1e3)]]
    vehicles_used: Count
    fleet: Name
    verdict: Name = ""
    remarks: list[ReportRemark] = []


class ReportInput(Struct):
    """What was measured, of which kind it is ('' in reports of older versions, whose unit tells), its content's hash,
    and the folder that relative names here and in `settings` start from."""

    path: Annotated[str, Meta(min_length=1, max_length=10_000)]
    sha256: Name
    folder: Annotated[str, Meta(max_length=10_000)] = ""
    kind: Literal["orthophoto", "reconstruction", ""] = ""


class ReportBox(Struct):
    """One box that showed a vehicle: centre, length, width [px], angle [rad]."""

    picture: Text
    xylwa_px: tuple[Px, Px, PxLength, PxLength, Finite]
    score: Share


class ReportVehicle(Struct):
    """A vehicle's size and place [m], whether it counted, and why not."""

    length: Finite
    width: Finite
    place_m: tuple[Finite, Finite]
    used: bool
    reason: Text
    boxes: list[ReportBox]


class ReportSize(Struct):
    """A fleet's mean, spread between vehicles and what the mean may be off by, one sigma each [m]."""

    mean: Metres
    sd: Sigma
    mean_sd: Sigma


class ReportClass(Struct):
    """One class of the fleet that was measured with: weight, mean and one sigma of length and width [m]."""

    name: Text
    weight: Weight
    mean: tuple[Metres, Metres]
    sd: tuple[Sigma, Sigma]


class ReportFleet(Struct):
    """The sizes [m] that a scale rests on."""

    length: ReportSize
    width: ReportSize
    classes: list[ReportClass]


class ReportEvidence(Struct):
    """What else but vehicles told a scale, with its relative one sigma."""

    kind: Text
    scale: Positive
    relative_sd: Finite
    says: Text


class ReportAnchor(Struct):
    """A thing of standard size that was found: its fitted lines in a picture [px], and what it says of the scale."""

    kind: Text
    standard: Text
    metres: Positive
    scale: Positive
    relative_sd: Finite
    counted: bool
    count: Count
    views: Count
    picture: Text
    lines_px: list[tuple[tuple[Px, Px], tuple[Px, Px]]]
    residual_cm: Finite


class Report(Explained, kw_only=True):
    """A report from which a page is drawn; findings of one kind of source, ``drift`` among them, are left open."""

    format: Literal["orthoscale report 2"]
    interval90: tuple[Positive, Positive]
    verdict: Name
    fit: Text
    judgements: list[ReportJudgement] = []
    vehicles_rejected: dict[str, Count]
    boxes_rejected: dict[str, Count]
    fleet_sizes: ReportFleet
    checks: dict[str, Finite]
    input: ReportInput
    settings: dict[str, Any]
    pictures: dict[str, tuple[Count, Count]]
    pixel_aspect: Positive = 1.0
    vehicles: list[ReportVehicle]
    evidence: list[ReportEvidence] = []
    anchors: list[ReportAnchor] = []
    without_anchors: ReportScale | None = None
    fleets: dict[str, Finite] = {}
    claim: dict[str, Any] | None = None
    drift: dict[str, Any] | None = None
    modes: dict[str, Any] | None = None
    calibration: dict[str, Any] | None = None
    agreement: dict[str, Any] | None = None


# Reconstructions


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


class Intrinsics(Struct, kw_only=True):
    """nerfstudio's, for all frames or for one; which are needed depends on where else they stand."""

    w: Annotated[float, Meta(ge=1, lt=2**20)] | UnsetType = UNSET
    h: Annotated[float, Meta(ge=1, lt=2**20)] | UnsetType = UNSET
    fl_x: PxLength | UnsetType = UNSET
    fl_y: PxLength | UnsetType = UNSET
    cx: Px | UnsetType = UNSET
    cy: Px | UnsetType = UNSET
    k1: Bend = 0.0
    k2: Bend = 0.0
    k3: Bend = 0.0
    k4: Bend = 0.0
    p1: Bend = 0.0
    p2: Bend = 0.0
    camera_angle_x: Annotated[float, Meta(gt=0, lt=3.1415)] | UnsetType = UNSET
    camera_model: Name | UnsetType = UNSET


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


class OpensfmCamera(Struct):
    """A camera of OpenSfM: size [px], focal lengths and centre as shares of the longer side."""

    width: Size
    height: Size
    projection_type: Name = "perspective"
    focal: Focal | UnsetType = UNSET
    focal_x: Focal | UnsetType = UNSET
    focal_y: Focal | UnsetType = UNSET
    c_x: Finite = 0.0
    c_y: Finite = 0.0
    k1: Bend = 0.0
    k2: Bend = 0.0
    k3: Bend = 0.0
    k4: Bend = 0.0
    p1: Bend = 0.0
    p2: Bend = 0.0


class OpensfmPlaced(Struct):
    """Something with a place; world to camera, as OpenSfM writes it."""

    translation: Vector


class OpensfmShot(OpensfmPlaced):
    """A picture: rotation from the world to the camera as an axis times its angle [rad]."""

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


class GltfAsset(Struct):
    """Metadata, in whose ``extras``, which may be anything, a scene in metres is marked."""

    extras: Any = None


class GltfNode(Struct):
    """Indices of the nodes below it."""

    children: list[Count] = []


class GltfScene(Struct):
    """Indices of the nodes at the top."""

    nodes: list[Count] = []


class GltfPart(Struct):
    """A buffer or an image."""

    uri: str | None = None


class GltfCentre(Struct):
    """What is added to all positions, after the nodes' transforms: of 3D Tiles."""

    center: tuple[Finite, Finite, Finite]


class GltfView(Struct):
    """How far a camera sees, and how much of the scene where it has no perspective."""

    xmag: float | None = None
    ymag: float | None = None
    znear: float | None = None
    zfar: float | None = None


class GltfCamera(Struct):
    """A camera of one of the two kinds."""

    orthographic: GltfView | None = None
    perspective: GltfView | None = None


class GltfLight(Struct):
    """How far it shines."""

    range: float | None = None


class GltfLights(Struct):
    """Those of KHR_lights_punctual."""

    lights: list[GltfLight] = []


class GltfVolume(Struct):
    """How far light goes in a material."""

    attenuationDistance: float | None = None


class GltfMaterialExtensions(Struct):
    """Those of a material that have a length."""

    KHR_materials_volume: GltfVolume | None = None


class GltfMaterial(Struct):
    """A material, as far as it has lengths."""

    extensions: GltfMaterialExtensions | None = None


class GltfExtensions(Struct):
    """Those of a whole scene that have a length."""

    CESIUM_RTC: GltfCentre | None = None
    KHR_lights_punctual: GltfLights | None = None


class Gltf(Struct):
    """The JSON of a glTF 2.0 scene, as far as scaling it needs."""

    asset: GltfAsset
    nodes: list[GltfNode] = []
    scenes: list[GltfScene] = []
    buffers: list[GltfPart] = []
    images: list[GltfPart] = []
    cameras: list[GltfCamera] = []
    materials: list[GltfMaterial] = []
    extensions: GltfExtensions | None = None
