"""Dense features: descriptions of places that are stable under changes of light, season and camera.

A feature map has one vector for each cell of `stride` x `stride` px. Vectors of cells without a picture are zero.
"""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np

ORIENTATION_BINS = 8  # over half a turn: an edge keeps its orientation where light and shade change sides
GRADIENT_CELL = 8  # px
NEARBY = 31  # [px] window in which contrast is normalised: sunlit roofs and shaded yards have equal weight
TRIANGLE = (1 / 8, 3 / 8, 3 / 8, 1 / 8)  # weights of four half cells
FLAT_GRADIENT = 4.0  # [grey levels per px] gradient of noise and compression, which counts as none


class Features(Protocol):
    """A way to describe pictures from above by dense features.

    name : of the method. key : everything that determines the features, for caches. stride : side of a cell [px].
    border : how far beyond a cell the picture matters [px]. block : side of the blocks that are matched [cells]: 1
    where a vector describes its surroundings, more where it describes its cell alone.
    """

    @property
    def name(self) -> str: ...
    @property
    def key(self) -> str: ...
    @property
    def stride(self) -> int: ...
    @property
    def border(self) -> int: ...
    @property
    def block(self) -> int: ...

    def of(self, pixels: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """(C, H // stride, W // stride) float32 features of `pixels` (H, W, 3) uint8 RGB, `valid` (H, W) bool."""
        ...


class GradientFeatures:
    """Histograms of the gradient's orientation in cells, with normalised contrast (after Dalal and Triggs, Histograms
    of oriented gradients for human detection, CVPR 2005); they need no weights and are always available."""

    name = "gradient"
    key = f"gradient:{ORIENTATION_BINS}:{GRADIENT_CELL}:{NEARBY}:{FLAT_GRADIENT}"
    stride = GRADIENT_CELL
    border = 2 * GRADIENT_CELL + NEARBY // 2
    block = 5

    def of(self, pixels: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """See `Features.of`; C is ORIENTATION_BINS."""
        grey = cv2.GaussianBlur(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), (0, 0), 1.0).astype(np.float32)
        across, down = (cv2.Sobel(grey, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
        strength, angle = cv2.cartToPolar(across, down)
        inside = cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1)
        strength *= inside  # the edge of the picture is not an edge on the ground
        strength /= cv2.blur(strength, (NEARBY, NEARBY)) + FLAT_GRADIENT
        height, width = (side // GRADIENT_CELL for side in valid.shape)
        whole = slice(height * GRADIENT_CELL), slice(width * GRADIENT_CELL)
        halves = _histograms(strength[whole], angle[whole], GRADIENT_CELL // 2)
        # A triangle two cells wide, so that a shift by part of a cell changes little.
        halves = np.pad(halves, ((0, 0), (1, 1), (1, 1)))
        lower = np.sum([w * halves[:, k : k + 2 * height : 2] for k, w in enumerate(TRIANGLE)], axis=0)
        cells = np.sum([w * lower[:, :, k : k + 2 * width : 2] for k, w in enumerate(TRIANGLE)], axis=0)
        return np.sqrt(cells).astype(np.float32) * whole_cells(valid, GRADIENT_CELL)


def _histograms(strength: np.ndarray, angle: np.ndarray, side: int) -> np.ndarray:
    """(ORIENTATION_BINS, H / side, W / side) mean `strength` by `angle` [rad] modulo half a turn, each shared between
    its two nearest bins."""
    height, width = strength.shape
    rows, columns = height // side, width // side
    position = (angle % np.pi) * (ORIENTATION_BINS / np.pi)
    lower = np.minimum(position.astype(np.int64), ORIENTATION_BINS - 1)
    share = position - lower
    square = (np.arange(height)[:, None] // side * columns + np.arange(width) // side) * ORIENTATION_BINS
    size = rows * columns * ORIENTATION_BINS
    sums = np.bincount((square + lower).ravel(), (strength * (1 - share)).ravel(), size)
    sums += np.bincount((square + (lower + 1) % ORIENTATION_BINS).ravel(), (strength * share).ravel(), size)
    return sums.reshape(rows, columns, ORIENTATION_BINS).transpose(2, 0, 1) / side**2


def whole_cells(valid: np.ndarray, stride: int) -> np.ndarray:
    """(H // stride, W // stride) bool: whether all of a cell is `valid`, (H, W) bool."""
    height, width = (side // stride for side in valid.shape)
    parts = valid[: height * stride, : width * stride].reshape(height, stride, width, stride)
    return np.asarray(parts.all((1, 3)))
