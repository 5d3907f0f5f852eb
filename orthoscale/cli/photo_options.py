"""Options for the camera of single photos, which `photo`, `crop` and `locate` share."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from .options import PATH, option

LENS = (
    option("--focal-px", type=float, metavar="PX", group="Input", help="Focal length, instead of EXIF's and XMP's."),
    option(
        "--lens",
        "lens_file",
        type=PATH,
        group="Input",
        help="Camera calibration: Metashape's XML, COLMAP's cameras.txt with one camera, or JSON.",
    ),
    option(
        "--pitch",
        type=float,
        metavar="DEG",
        group="Input",
        help="Pitch of the optical axis, -90 for nadir, instead of XMP's.",
    ),
    option(
        "--roll",
        type=float,
        metavar="DEG",
        group="Input",
        help="Roll about the optical axis, right side down, instead of XMP's.",
    ),
)


LENS_FLAGS = {"focal_px": "--focal-px", "lens_file": "--lens", "pitch": "--pitch", "roll": "--roll"}


def lens_options(function: Callable) -> Callable:
    """Adds --focal-px, --lens, --pitch and --roll, which replace the photo's own tags. The command gets them as one
    mapping `lens` (`photos.photo.GivenCamera`)."""

    @wraps(function)
    def gathered(**given: Any) -> Any:
        return function(lens={name: given.pop(name) for name in LENS_FLAGS}, **given)

    for each in reversed(LENS):
        gathered = each(gathered)
    return gathered
