"""Options that say how single photos are seen and measured; shared by `photo`, `crop` and `evaluate`."""

from __future__ import annotations

from collections.abc import Callable

import click

from .options import PATH


def lens_options(command: Callable) -> Callable:
    """--focal-px, --lens, --pitch, --roll: what the photo's own tags say otherwise."""
    for option in reversed(
        [
            click.option("--focal-px", type=float, metavar="PX", help="Focal length, instead of EXIF's and XMP's."),
            click.option(
                "--lens",
                "lens_file",
                type=PATH,
                help="Calibration of the camera: Metashape's XML, COLMAP's cameras.txt with one camera, or JSON.",
            ),
            click.option(
                "--pitch", type=float, metavar="DEG", help="Of the optical axis: -90 straight down, instead of XMP's."
            ),
            click.option(
                "--roll",
                type=float,
                metavar="DEG",
                help="About the optical axis, right side down, instead of XMP's.",
            ),
        ]
    ):
        command = option(command)
    return command
