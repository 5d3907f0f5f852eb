"""Files of detections: orthoscale's own, COCO and GeoJSON."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

from .networks import Height, RulerEntry, check_body
from .values import Name, Px, PxLength, Share, Size, Text

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
    """What is needed to measure with boxes, and what was found besides the vehicles (`core.detections.Detections`)."""

    zoom: Annotated[float, Meta(gt=1e-4, le=1e3)]
    effective_height: tuple[Height, Height]
    undercut: tuple[Height, Height] = (0.0, 0.0)
    detector_sha256: Name
    detector: Text | UnsetType = UNSET
    body: Name = "car"
    ruler: RulerEntry | UnsetType = UNSET
    doubtful: BoxesByPicture = {}
    set_aside: dict[Text, BoxesByPicture] = {}
    objects: BoxesByPicture = {}
    planar: DetectionsEntry | None = None
    picture_sizes: dict[Text, tuple[Size, Size]] = {}
    zoom_given: bool = False

    def __post_init__(self) -> None:
        check_body(self.body)


class DetectionsEntry(NoteEntry, kw_only=True):
    """Orthoscale's own file of detections."""

    pictures: BoxesByPicture


class CocoImage(Struct):
    """An entry of ``images``; a missing size [px] is 0."""

    id: int | str
    file_name: Text
    width: Annotated[float, Meta(ge=0, le=1e7)] = 0
    height: Annotated[float, Meta(ge=0, le=1e7)] = 0


class CocoCategory(Struct):
    """An entry of ``categories``: a class of annotations."""

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
