"""The endings of picture files, and writing pictures. Pillow writes them: if pycolmap was imported first, OpenCV may be
bound to the wrong libraries."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

PICTURES = (".tif", ".tiff", ".jp2", ".jpg", ".jpeg", ".png", ".bmp", ".gif", ".vrt", ".webp", ".img", ".ecw", ".sid")
"""Endings by which a picture in a folder is known for one. One that is named itself may have any."""

COMPRESSION = 4  # of PNG, 0 to 9: a third of the time of zlib's usual 6, files 5 to 10 % larger


def write_png(path: Path, image: np.ndarray) -> None:
    """Write `image`, uint8 (H, W) grey or (H, W, 3) RGB, to `path`. Raises OSError."""
    path.write_bytes(_encoded(image, "PNG", compress_level=COMPRESSION))


def write_jpeg(path: Path, image: np.ndarray, quality: int) -> None:
    """Write `image`, uint8 (H, W, 3) RGB, to `path`; quality 1 to 95. Raises OSError."""
    path.write_bytes(jpeg(image, quality))


def jpeg(image: np.ndarray, quality: int) -> bytes:
    """The bytes of a JPEG file of `image`, uint8 (H, W, 3) RGB; quality 1 to 95."""
    return _encoded(image, "JPEG", quality=quality)


def _encoded(image: np.ndarray, form: str, **options: int) -> bytes:
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(image).save(data, form, **options)
    return data.getvalue()
