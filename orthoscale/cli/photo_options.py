"""Options for the camera of single photos; shared by `photo` and `crop`."""

from __future__ import annotations

from collections.abc import Callable

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


def lens_options(function: Callable) -> Callable:
    """--focal-px, --lens, --pitch, --roll, in place of the photo's own tags."""
    for each in reversed(LENS):
        function = each(function)
    return function
