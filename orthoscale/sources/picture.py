"""What a detector needs to know of an image, wherever its pixels lie."""

from __future__ import annotations

from typing import Protocol

import numpy as np

NO_DATA_GREY = 114
"""Of 255, in every channel: what stands where a picture has no data or ends. Ultralytics' YOLO pads its images with
it, and so does the training here, so that networks know it."""


class Picture(Protocol):
    """An image that is read by windows: a raster, or one frame of a reconstruction."""

    name: str
    width: int  # [px]
    height: int  # [px]

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """RGB uint8 (out_height, out_width, 3) of the window at (x, y) with `width` x `height` px, resampled.

        The window lies inside the image. What has no data is NO_DATA_GREY. Shrinking averages; enlarging is bicubic.
        """
        ...
