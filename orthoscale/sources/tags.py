"""The metadata of a photo: EXIF, and the XMP that drones add. Pillow reads both; here their meanings are unified.

Makers disagree about angles. Here all are gimbal angles, as DJI writes them: pitch -90 straight down and 0 at the
horizon, roll positive with the right side down, yaw clockwise from north; degrees.

- `GimbalPitchDegree` (DJI, Autel, Teal), `CameraPitchDegree` (Parrot) and `CameraOrientationNED` (Skydio) are gimbal
  angles.
- `Camera:Pitch` (Pix4D's and senseFly's schema) is 0 straight down and 90 at the horizon, and `Camera:Roll` is the roll
  of the wings, which tilts a camera that looks straight down. Some Autel models write gimbal angles there; those are
  negative, which the schema's are not for a camera that looks forward
  (github.com/Theta-Limited/OpenAthenaIOS/issues/62).
- A DJI Mini 2 writes zeros for all three angles, whatever the gimbal does
  (github.com/dji-sdk/Mobile-SDK-Android/issues/1233): they are ignored.
"""

from __future__ import annotations

import math
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from scipy.spatial.transform import Rotation

from ..errors import InputError, shown
from ..formats.reading import check_regular

BELOW_ZERO = (1, b"\1", 3, b"\3")  # GPSAltitudeRef: below the sea, below the ellipsoid (EXIF 3.0)
SIDES_OF_EARTH = {"N": 1, "S": -1, "E": 1, "W": -1}
RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # EXIF FocalPlaneResolutionUnit: inch, cm, mm, micrometre
SAME_SHAPE = 0.005  # relative change of a picture's aspect that a reduction of its size may cause
READABLE_PHOTOS = (
    "Give photos as JPEG, TIFF or PNG; convert HEIC and raw photos with their tags, and take frames of videos."
)
# EXIF writes "unknown" as 0/0 and "infinite" as FFFFFFFF/x (CIPA DC-008, 4.6.5). COLMAP's undistorter, by OpenImageIO,
# writes such tags as 80000000/1. No real value is so large.
NO_NUMBER = 2.0**31 - 1
BACKWARDS = -30.0  # [deg] a `Camera:Pitch` below this is a gimbal angle: no survey camera looks that far backwards


@dataclass(frozen=True)
class Tags:
    """EXIF and XMP of one photo; None for missing values.

    width, height : as stored, before any EXIF rotation [px]. full_width, full_height : of the picture that the camera
    wrote [px]; full_height is None if EXIF lacks it.
    lon_lat : [deg]. relative_altitude : over the take-off point, by the drone [m]. altitude : with the position, over
    the sea or the ellipsoid [m].
    focal_mm : physical. focal_35mm : for the same field of view on 36 x 24 mm, by the diagonal (CIPA DCG-001).
    plane_px_per_mm : pixels of the full image per millimetre of the sensor.
    calibrated_px : the maker's calibrated focal length [px of the full image].
    dewarp : the maker's fx, fy, cx, cy, k1, k2, p1, p2, k3 [px of the full image; cx and cy from its middle].
    dewarped : the camera has removed the distortion already.
    pitch, roll, yaw : see above [deg], applied in the order yaw, pitch, roll. notes : what was ignored, and why.
    """

    width: int
    height: int
    full_width: int
    make: str = ""
    model: str = ""
    taken: str = ""
    lon_lat: tuple[float, float] | None = None
    relative_altitude: float | None = None
    altitude: float | None = None
    focal_mm: float | None = None
    focal_35mm: float | None = None
    plane_px_per_mm: float | None = None
    digital_zoom: float = 1.0
    calibrated_px: float | None = None
    dewarp: tuple[float, ...] | None = None
    dewarped: bool = False
    pitch: float | None = None
    roll: float | None = None
    yaw: float | None = None
    notes: tuple[str, ...] = ()
    full_height: int | None = None

    @property
    def camera(self) -> str:
        """Maker and model, with the maker's name only once; '' if the photo has neither."""
        named = self.model.lower().startswith(self.make.lower())
        return self.model if named else f"{self.make} {self.model}".strip()

    @property
    def heading(self) -> float | None:
        """Direction of forward in `level_axes`, clockwise from north [deg]: for a photo taken straight down, that of
        the picture's top, which roll turns as much as yaw (DJI writes a roll of 180 there:
        github.com/leftfield-geospatial/orthority, issue 36). Also None for a photo that was turned since it was taken,
        since the direction of the turn is unknown."""
        if self.pitch is None or self.yaw is None or self.turned:
            return None
        # Axes of the rotated camera: the optical axis, right, and down in the picture.
        north, east, _ = _rotation(self.yaw, self.pitch, self.roll or 0.0).apply([1.0, 0.0, -1.0])
        return math.degrees(math.atan2(east, north)) % 360

    @property
    def turned(self) -> bool:
        """Whether its pixels were rotated by a quarter turn since it was taken, judged by its size in EXIF."""
        return not self.of_shape(self.full_width, self.full_height) and self.of_shape(self.full_height, self.full_width)

    def of_shape(self, width: int | None, height: int | None) -> bool:
        """Whether it has the aspect of a picture of that size; False if the size is unknown."""
        if not width or not height:
            return False
        return abs(self.width * height / (self.height * width) - 1) < SAME_SHAPE


def read_tags(path: Path) -> Tags:
    """The tags of the photo at `path`; its pixels are not decoded. Raises InputError if it is not an image."""
    from PIL import Image, UnidentifiedImageError
    from PIL.ExifTags import IFD

    check_regular(path, READABLE_PHOTOS)
    try:
        with _of_any_size(), warnings.catch_warnings(record=True) as complaints, Image.open(path) as image:
            warnings.simplefilter("always")
            (width, height), packet = image.size, image.info.get("xmp", b"")
            base = image.getexif()
            if image.format == "TIFF":  # Pillow gives the size after the turn that the orientation asks for
                width, height = base[0x0100], base[0x0101]
            exif, gps = base.get_ifd(IFD.Exif), base.get_ifd(IFD.GPSInfo)
    except UnidentifiedImageError as error:
        raise InputError(f"{path}: not an image that can be read", READABLE_PHOTOS) from error
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be read ({reason})", "Check the path, or copy the file again.") from error
    except Exception as error:  # for a damaged file Pillow's readers may raise anything
        raise InputError(f"{path}: is damaged ({error})", "Copy it again from its original.") from error
    if _number(base.get(0x00FE)) == 1:  # NewSubfileType: what Pillow shows of DNG, NEF and ARW
        raise InputError(f"{path}: holds a small preview, as raw photos do", READABLE_PHOTOS)
    xmp, notes = _flat_xmp(packet)
    if complaints:
        notes.append(f"its EXIF is damaged and was only read in part ({complaints[0].message})")
    pitch, roll, yaw = _angles(xmp, notes)
    if int(_number(base.get(0x0112)) or 1) in (5, 6, 7, 8):
        notes.append("EXIF asks for a quarter turn when shown; pixels and angles are those of the sensor")
    unit = MM_PER_UNIT.get(int(_number(exif.get(0xA210)) or 2), 25.4)
    resolution = _positive(exif.get(0xA20E))
    dewarp = _dewarp(xmp.get("DewarpData", ""))
    full_width, full_height = (_positive(exif.get(tag)) for tag in (0xA002, 0xA003))
    return Tags(
        width=width,
        height=height,
        full_width=int(full_width or width),
        full_height=int(full_height) if full_width and full_height else None,
        make=str(base.get(0x010F, "")).strip("\0 "),
        model=str(base.get(0x0110, "")).strip("\0 "),
        taken=_taken(exif.get(0x9003)) or _taken(base.get(0x0132)),
        lon_lat=_lon_lat(gps),
        relative_altitude=_number(xmp.get("RelativeAltitude", xmp.get("AboveGroundAltitude"))),
        altitude=_altitude(gps),
        focal_mm=_positive(exif.get(0x920A)),
        focal_35mm=_positive(exif.get(0xA405)),
        plane_px_per_mm=resolution / unit if resolution else None,
        digital_zoom=_positive(exif.get(0xA404)) or 1.0,
        calibrated_px=_positive(xmp.get("CalibratedFocalLength")),
        dewarp=dewarp,
        dewarped=xmp.get("DewarpFlag", "0").strip() == "1",
        pitch=pitch,
        roll=roll,
        yaw=yaw,
        notes=tuple(notes),
    )


@contextmanager
def _of_any_size() -> Iterator[None]:
    """Switch off Pillow's guard against huge pictures: nothing is decoded here, and survey cameras have 150 Mpx."""
    from PIL import Image

    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _flat_xmp(packet: bytes | str) -> tuple[dict[str, str], list[str]]:
    """Properties by local name, those of a structure as ``Structure.Property``; and notes on what could not be read."""
    text = packet.encode() if isinstance(packet, str) else bytes(packet)
    for tag in (b"x:xmpmeta", b"rdf:RDF"):  # the outer one may be left out (XMP specification, part 1, 7.3.3)
        start, end = text.find(b"<" + tag), text.rfind(closing := b"</" + tag + b">")
        if 0 <= start < end:
            break
    else:
        return {}, []
    try:
        root = ElementTree.fromstring(text[start : end + len(closing)])
    except ElementTree.ParseError as error:
        return {}, [f"its XMP is damaged ({error}) and was ignored"]
    found: dict[str, str] = {}

    def collect(element: ElementTree.Element, prefix: str) -> None:
        for name, value in element.attrib.items():
            if not name.startswith(RDF):
                found.setdefault(prefix + _local(name), value)
        for child in element:
            name = prefix + _local(child.tag)
            if child.text and child.text.strip():
                found.setdefault(name, child.text.strip())
            collect(child, "" if child.tag.startswith(RDF) else name + ".")

    collect(root, "")
    return found, []


def _local(name: str) -> str:
    return name.rpartition("}")[2]


def _angles(xmp: Mapping[str, str], notes: list[str]) -> tuple[float | None, float | None, float | None]:
    """Pitch, roll, yaw [deg] from whichever schema has a pitch."""
    for form in ("Gimbal{}Degree", "Camera{}Degree", "CameraOrientationNED.{}"):
        told = [xmp.get(form.format(axis)) for axis in ("Pitch", "Roll", "Yaw")]
        pitch, roll, yaw = map(_number, told)
        if pitch is None:
            notes += _no_pitch(told[0])
            continue
        if pitch == roll == yaw == 0:
            notes.append("its gimbal angles are all exactly zero, as from a camera that does not know them: ignored")
            continue
        return pitch, roll, yaw
    pitch, roll, yaw = (_number(xmp.get(axis)) for axis in ("Pitch", "Roll", "Yaw"))
    if pitch is None:
        notes += _no_pitch(xmp.get("Pitch"))
        return None, None, None
    if pitch < BACKWARDS:
        notes.append(f"its Camera:Pitch of {pitch:g} is taken for a gimbal angle, -90 straight down")
        return pitch, roll, yaw
    return _gimbal_angles(pitch, roll, yaw) if roll else (pitch - 90.0, roll, yaw)


def _no_pitch(text: str | None) -> list[str]:
    return [] if text is None else [f"its pitch of {shown(text)!r} is not a number: ignored"]


def _rotation(yaw: float, pitch: float, roll: float) -> Rotation:
    """Rotation into north, east, down from the axes (forward, right, down) of a body with these angles [deg]."""
    return Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)


def _gimbal_angles(pitch: float, roll: float, yaw: float | None) -> tuple[float, float, float | None]:
    """Gimbal pitch, roll, yaw [deg] of a camera that looks straight down from wings with these angles [deg]."""
    turn, down, about = (_rotation(yaw or 0.0, pitch, roll) * _rotation(0, -90, 0)).as_euler("ZYX", degrees=True)
    return float(down), float(about), None if yaw is None else float(turn) % 360


def _dewarp(text: str) -> tuple[float, ...] | None:
    """DJI's ``date;fx,fy,cx,cy,k1,k2,p1,p2,k3``."""
    try:
        values = tuple(float(v) for v in text.rpartition(";")[2].split(","))
    except ValueError:
        return None
    return values if len(values) == 9 and all(map(math.isfinite, values)) and min(values[:2]) > 0 else None


def _lon_lat(gps: Mapping[int, Any]) -> tuple[float, float] | None:
    """Longitude and latitude [deg]; None also if EXIF does not say north or south, or east or west."""
    try:
        lat, lon = (
            SIDES_OF_EARTH[_letter(gps[tag - 1])] * sum(float(part) / 60**k for k, part in enumerate(gps[tag]))
            for tag in (2, 4)
        )
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    if not (abs(lat) <= 90 and abs(lon) <= 180) or (lat, lon) == (0, 0):
        return None
    return lon, lat


def _altitude(gps: Mapping[int, Any]) -> float | None:
    """Altitude [m], negative below the sea or the ellipsoid, which EXIF says by a number of its own."""
    told = _number(gps.get(6))
    return -abs(told) if told is not None and gps.get(5) in BELOW_ZERO else told


def _taken(value: Any) -> str:
    """The time that EXIF tells, as text; empty where it is not known: EXIF writes that as blanks or zeros."""
    text = "" if value is None else str(value).strip("\0 ")
    return text if any(digit in text for digit in "123456789") else ""


def _letter(value: Any) -> str:
    """The first letter of a text, which some programs write as bytes, in lower case or as a whole word."""
    text = value.decode("latin-1") if isinstance(value, bytes) else str(value)
    return text.strip("\0 ")[:1].upper()


def _number(value: Any) -> float | None:
    """A number that is neither unknown nor infinite, else None; XMP may hold EXIF's fractions as text."""
    try:
        number = float(Fraction(value) if isinstance(value, str) and "/" in value else value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if abs(number) < NO_NUMBER else None


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number and number > 0 else None
