"""What a detector needs to know of an image, wherever its pixels lie."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Picture(Protocol):
    """An image that is read by windows: a raster, or one frame of a reconstruction."""

    name: str
    width: int  # [px]
    height: int  # [px]

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """RGB uint8 (out_height, out_width, 3) of the window at (x, y) with `width` x `height` px, resampled.

        The window lies inside the image. Pixels without data are grey (114). Shrinking averages; enlarging is bicubic.
        """
        ...
