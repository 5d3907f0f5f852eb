"""The lens of a photo: from a calibration file, a given focal length, or the photo's own tags."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError, UsageError, shown
from ..formats.reading import SMALL, read, read_text, reason
from ..option import positive
from .tags import Tags

if TYPE_CHECKING:
    import pycolmap

DIAGONAL_35MM = math.hypot(36.0, 24.0)  # [mm] what a 35 mm equivalent focal length refers to (CIPA DCG-001-2005)
# Sensors are 4:3 or 3:2; a wider picture is a crop, and its diagonal is not the sensor's. Most sensors of drones are
# 4:3, and a crop keeps their full width.
WIDEST_SENSOR = 1.6
SENSOR_ASPECT = 4 / 3
# Relative one-sigma of the focal length, by its source: a calibration is good to some tenths of a per cent between
# flights; nominal values and those that people type to one or two. Assumptions, but for the rounding of a 35 mm
# equivalent to whole millimetres, which is 0.29 mm.
CALIBRATED_SD, MAKERS_SD, FOCAL_TOLD_SD, NOMINAL_SD, CROP_SD, ZOOM_SD = 0.003, 0.01, 0.01, 0.02, 0.03, 0.1
ROUNDING_MM = 0.29
LENS_HINT = "Give Metashape's XML, COLMAP's cameras.txt, or JSON."
LARGEST_VALUE = 1e7  # of a camera's size and parameters [px]
FOCAL_FAR = 0.1  # relative: focal lengths of EXIF are nominal, good to some per cent
IMPLAUSIBLE = 0.25  # [log] a focal length this far from the nominal one is in another unit, or for another image size


@dataclass(frozen=True)
class Lens:
    """camera : for the photo's size. sd : relative one-sigma of its focal length. source : its origin, in words."""

    camera: pycolmap.Camera
    sd: float
    source: str

    @property
    def focal_px(self) -> float:
        """The geometric mean of both axes' focal lengths [px]."""
        return math.sqrt(self.camera.focal_length_x * self.camera.focal_length_y)

    def contradicts(self, focal_px: float) -> bool:
        """Whether another focal length [px] for the same photo is so far from this one that one of them is wrong."""
        return abs(focal_px / self.focal_px - 1) > max(FOCAL_FAR, 2 * self.sd)


def lens_of(tags: Tags, lens_file: Path | None = None, focal_px: float | None = None) -> Lens:
    """The lens of the photo with these `tags`; a calibration or a given focal length [px] takes precedence.

    Raises UsageError if both are given, InputError for a calibration that does not fit the photo, or if no focal length
    is known.
    """
    if lens_file is not None and focal_px is not None:
        raise UsageError("--lens and --focal-px set the same thing twice", "Give one of them.")
    size = tags.width, tags.height
    if lens_file is not None:
        return Lens(_resized(read_calibration(lens_file), size, lens_file), CALIBRATED_SD, f"from {lens_file}")
    if focal_px is not None:
        focal_px = positive("--focal-px", focal_px)
        return Lens(brown(size, focal_px, focal_px), FOCAL_TOLD_SD, "given")
    share, whole = _share(tags)
    nominal = _nominal(tags, share, whole)
    if tags.dewarp is not None and _plausible(tags.dewarp[0] * share, nominal):
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = tags.dewarp
        if tags.turned or size != whole:  # the direction of the turn, or what was cut off, is not known
            focal = math.sqrt(fx * fy) * share
            return Lens(brown(size, focal, focal), MAKERS_SD, "from the maker's DewarpData")
        middle = (size[0] / 2 + cx * share, size[1] / 2 + cy * share)
        bend = (0.0,) * 5 if tags.dewarped else (k1, k2, p1, p2, k3)
        return Lens(brown(size, fx * share, fy * share, middle, bend), CALIBRATED_SD, "from the maker's DewarpData")
    if tags.calibrated_px is not None and _plausible(focal := tags.calibrated_px * share, nominal):
        return Lens(brown(size, focal, focal), MAKERS_SD, "from the maker's CalibratedFocalLength")
    if nominal is None:
        raise InputError(
            f"no focal length in its EXIF or XMP ({tags.camera or 'unknown camera'})",
            "Give it in pixels (--focal-px), or a calibration file (--lens).",
        )
    return nominal


def beside_tags(given: Lens, tags: Tags) -> str:
    """What to say of a `given` lens that contradicts the photo's own `tags`, as of another camera; else empty."""
    try:
        own = lens_of(tags)
    except InputError:  # it does not say
        return ""
    if not own.contradicts(given.focal_px):
        return ""
    off = given.focal_px / own.focal_px - 1
    return (
        f"its focal length is {own.focal_px:.0f} px by its tags ({own.source}), and {given.focal_px:.0f} px is given: "
        f"if that is of another camera, the altitude is {abs(off):.0%} too {'large' if off > 0 else 'small'}"
    )


def _share(tags: Tags) -> tuple[float, tuple[int, int]]:
    """Photo pixels per pixel of the picture that the camera wrote, by its size in EXIF; and the size of that picture in
    photo pixels.

    Raises InputError for a photo that was cropped and may have been reduced as well.
    """
    size = width, height = tags.width, tags.height
    if tags.full_height is None or tags.of_shape(tags.full_width, tags.full_height):
        return width / tags.full_width, size
    if tags.turned:
        return width / tags.full_height, size
    told = tags.full_width, tags.full_height
    if width > told[0] and height > told[1]:  # EXIF has the size of a thumbnail
        return 1.0, size
    if (width == told[0] and height < told[1]) or (height == told[1] and width < told[0]):  # as 16:9 of 4:3
        return 1.0, told
    raise InputError(
        f"its {width} x {height} px are a crop of the {told[0]} x {told[1]} px in its EXIF, possibly reduced",
        "Give its focal length in pixels (--focal-px), or the photo as the camera wrote it.",
    )


def _plausible(focal_px: float, nominal: Lens | None) -> bool:
    return nominal is None or abs(math.log(focal_px / nominal.focal_px)) < IMPLAUSIBLE


def _nominal(tags: Tags, share: float, whole: tuple[int, int]) -> Lens | None:
    """The lens by the focal length in EXIF, in millimetres or as a 35 mm equivalent; `share`, `whole` : by `_share`."""
    equivalent = _equivalent(tags, whole)
    if tags.focal_mm and tags.plane_px_per_mm:
        focal = tags.focal_mm * tags.plane_px_per_mm * share * tags.digital_zoom
        if _plausible(focal, equivalent):  # some programs write a resolution in another unit than they say
            source = f"{tags.focal_mm:g} mm and the sensor's resolution in EXIF"
            sd = [NOMINAL_SD]
            if tags.digital_zoom > 1:
                sd.append(ZOOM_SD)
                source += f", times its digital zoom {tags.digital_zoom:g}"
            return Lens(brown((tags.width, tags.height), focal, focal), math.hypot(*sd), source)
    return equivalent


def _equivalent(tags: Tags, whole: tuple[int, int]) -> Lens | None:
    """The lens by the 35 mm equivalent, for a picture of size `whole` [px of the photo]."""
    if not tags.focal_35mm:
        return None
    wide, high = max(whole), min(whole)
    sd = [NOMINAL_SD, ROUNDING_MM / tags.focal_35mm]
    source = f"{tags.focal_35mm:g} mm equivalent in EXIF"
    diagonal = math.hypot(wide, high)
    if wide / high > WIDEST_SENSOR:
        diagonal = math.hypot(wide, wide / SENSOR_ASPECT)
        sd.append(CROP_SD)
        source += ", the picture assumed to have the full width of a 4:3 sensor"
    if tags.digital_zoom > 1:
        sd.append(ZOOM_SD)
        source += f", digital zoom {tags.digital_zoom:g} assumed to be in it"
    focal = tags.focal_35mm / DIAGONAL_35MM * diagonal
    return Lens(brown((tags.width, tags.height), focal, focal), math.hypot(*sd), source)


def brown(
    size: tuple[int, int],
    fx: float,
    fy: float,
    middle: tuple[float, float] | None = None,
    bend: tuple[float, ...] = (0.0,) * 5,
) -> pycolmap.Camera:
    """A camera of `size` px with Brown distortion k1, k2, p1, p2, k3 as in OpenCV; `middle` by default the image's."""
    from .colmap_library import pycolmap

    cx, cy = middle or (size[0] / 2, size[1] / 2)
    if not any(bend):
        return pycolmap.Camera(model="PINHOLE", width=size[0], height=size[1], params=[fx, fy, cx, cy])
    parameters = [fx, fy, cx, cy, *bend, 0, 0, 0]
    return pycolmap.Camera(model="FULL_OPENCV", width=size[0], height=size[1], params=parameters)


def read_calibration(path: Path) -> pycolmap.Camera:
    """The camera in a calibration file, for the image size that was calibrated.

    Three forms: COLMAP's ``cameras.txt`` with one camera; the XML that Metashape exports; JSON with ``width``,
    ``height``, ``fx`` (or ``focal_px``), and where known ``fy``, ``cx``, ``cy``, ``k1``, ``k2``, ``p1``, ``p2``,
    ``k3``, pixels and distortion as in OpenCV. Raises InputError.
    """
    readers = {".xml": _from_metashape, ".txt": _from_colmap}
    suffix = path.suffix.lower()
    if suffix == ".json":
        return _from_json(path)
    if suffix not in readers:
        raise InputError(f"{path}: not a calibration file", LENS_HINT)
    text = read_text(path, "Give a calibration file.", SMALL)
    try:
        camera = readers[suffix](text)
        largest = max(camera.width, camera.height, *map(abs, camera.params))
        if not (largest < LARGEST_VALUE and camera.mean_focal_length() > 0 and min(camera.width, camera.height) > 0):
            raise ValueError("a focal length or size that is not a positive number")
    except (KeyError, ValueError, TypeError, OverflowError, ElementTree.ParseError) as error:
        raise InputError(f"{path}: no calibration in it ({reason(error)})", LENS_HINT) from error
    return camera


def _from_metashape(text: str) -> pycolmap.Camera:
    """``<calibration>`` with width, height, f, cx, cy (from the middle), k1 to k3, p1, p2, b1, b2 (Metashape manual,
    appendix D: there p1 is what OpenCV calls p2, and the skew b2 is nil in a frame camera)."""
    root = ElementTree.fromstring(text)

    def value(name: str, default: float | None = None) -> float:
        found = root.findtext(f".//{name}", default=None)
        if found is None and default is None:
            raise KeyError(f"no <{name}>")
        try:
            return float(found if found is not None else default or 0)
        except ValueError:
            raise ValueError(f"<{name}> is not a number") from None

    size, f = (int(value("width")), int(value("height"))), value("f")
    middle = (size[0] / 2 + value("cx", 0.0), size[1] / 2 + value("cy", 0.0))
    k1, k2, k3, p1, p2 = (value(name, 0.0) for name in ("k1", "k2", "k3", "p1", "p2"))
    return brown(size, f + value("b1", 0.0), f, middle, (k1, k2, p2, p1, k3))


def _from_json(path: Path) -> pycolmap.Camera:
    from ..formats.schemas.models import LensEntry

    lens = read(path, LensEntry, "a calibration of a lens", LENS_HINT)
    fx = lens.fx or lens.focal_px or 0.0  # one of the two is there
    middle = (lens.width / 2 if lens.cx is None else lens.cx, lens.height / 2 if lens.cy is None else lens.cy)
    return brown((lens.width, lens.height), fx, lens.fy or fx, middle, (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3))


def _from_colmap(text: str) -> pycolmap.Camera:
    from .colmap_library import pycolmap

    lines = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) != 1:
        raise ValueError(f"{len(lines)} cameras, one is wanted")
    _, model, width, height, *parameters = lines[0]
    if model not in pycolmap.CameraModelId.__members__:
        raise ValueError(f"no camera model is called {shown(model)}")
    camera = pycolmap.Camera(model=model, width=int(width), height=int(height), params=[float(p) for p in parameters])
    if not camera.verify_params():
        raise ValueError(f"{len(parameters)} parameters do not make a {model}")
    return camera


def _resized(camera: pycolmap.Camera, size: tuple[int, int], path: Path) -> pycolmap.Camera:
    if abs(size[0] * camera.height - size[1] * camera.width) > 0.005 * size[0] * camera.height:
        raise InputError(
            f"{path} is for {camera.width} x {camera.height} px, the photo has {size[0]} x {size[1]}",
            "Give the calibration of this camera in this format.",
        )
    camera.rescale(*size)
    return camera
