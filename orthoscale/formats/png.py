"""PNG files, by Pillow: if pycolmap was imported first, OpenCV may be bound to a zlib that is not its own."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np


def write_png(path: Path, image: np.ndarray) -> None:
    """Write `image`, uint8 (H, W) grey or (H, W, 3) RGB, to `path`. Raises OSError."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(image).save(data, "PNG")
    path.write_bytes(data.getvalue())
