"""Correlation of the dense features of a picture with those of a map, by FFT, block by block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft

from .ground import GroundImage
from .maps import MapFeatures

# Side of a block of the map, in sides of the largest template: larger blocks take more memory and save no time.
FFT_BLOCK = 2.5
GROUP_BYTES = 2**27  # of templates that are correlated in one pass over the map


@dataclass(frozen=True)
class Template:
    """A picture turned and scaled in one way. features : (K, h, w) unit vectors, zero where there is no picture.
    middle : (2,) row and column of its reference point [cells]. image : its pixels."""

    features: np.ndarray
    middle: np.ndarray
    image: GroundImage

    @property
    def cells(self) -> int:
        """Number of cells with a picture."""
        return int(np.count_nonzero(np.abs(self.features).sum(0)))

    def mirrored(self, mapped: MapFeatures) -> Template:
        """The template of the picture's mirror image, with features as those of `mapped`."""
        image = self.image.mirrored()
        features = mapped.usual.of_features(mapped.features.of(image.pixels, image.valid))
        return Template(features, self.middle, image)


@dataclass(frozen=True)
class Peak:
    """A place on the map that matches: mean cosine `score`, index of the `template`, and `row`, `column` of its middle
    [cells]."""

    score: float
    template: int
    row: int
    column: int


def search(
    templates: Sequence[Template],
    window: Callable[[int, int, int, int], np.ndarray],
    area: tuple[int, int, int, int],
    apart: float,
    most: int,
    step: Callable[[int, int], None] | None = None,
) -> list[Peak]:
    """The `most` best places of `templates` with their middles in `area` (row, column, height, width) [cells], best
    first, no two nearer than `apart` [cells].

    window : returns (K, height, width) features of a window of the map (row, column, height, width).
    """
    best, which = correlated(templates, window, area, step)
    return peaks(best, which, area[:2], apart, most)


def correlated(
    templates: Sequence[Template],
    window: Callable[[int, int, int, int], np.ndarray],
    area: tuple[int, int, int, int],
    step: Callable[[int, int], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """(height, width) mean cosine of the best template with its middle at each cell of `area`, and that one's index."""
    top, left, height, width = area
    pad = np.max([np.rint(t.middle) for t in templates], axis=0).astype(int)
    # Each template is shifted so that its middle lies at `pad`; then the same cell is the same place for all.
    starts = [pad - np.rint(t.middle).astype(int) for t in templates]
    reach = np.max([s + t.features.shape[1:] for s, t in zip(starts, templates, strict=True)], axis=0)
    size = [scipy.fft.next_fast_len(int(min(FFT_BLOCK * r, r + extent)), real=True)
            for r, extent in zip(reach, (height, width), strict=True)]  # fmt: skip
    inner = [size[k] - int(reach[k]) + 1 for k in (0, 1)]
    best = np.full((height, width), -1.0, np.float32)
    which = np.zeros((height, width), np.int32)
    channels = len(templates[0].features)
    spectrum_bytes = channels * size[0] * (size[1] // 2 + 1) * 8
    group = max(1, GROUP_BYTES // spectrum_bytes)
    corners = [(r, c) for r in range(0, height, inner[0]) for c in range(0, width, inner[1])]
    total = len(corners) * -(-len(templates) // group)
    done = 0
    for first in range(0, len(templates), group):
        some = range(first, min(first + group, len(templates)))
        spectra = [_spectrum(templates[k], starts[k], size) for k in some]
        for r, c in corners:
            part = window(top + r - int(pad[0]), left + c - int(pad[1]), *size)
            spectrum = scipy.fft.rfft2(part)
            high, wide = min(inner[0], height - r), min(inner[1], width - c)
            here = best[r : r + high, c : c + wide]
            for k, template in zip(some, spectra, strict=True):
                product = np.einsum("kij,kij->ij", spectrum, template)
                score = scipy.fft.irfft2(product, s=size)[:high, :wide]
                better = score > here
                here[better] = score[better]
                which[r : r + high, c : c + wide][better] = k
            done += 1
            if step:
                step(done, total)
    return best, which


def peaks(best: np.ndarray, which: np.ndarray, corner: Sequence[int], apart: float, most: int) -> list[Peak]:
    """The `most` highest local maxima of `best`, no two nearer than `apart` [cells]."""
    highest = cv2.dilate(best, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero((best == highest) & (best > 0))
    order = np.argsort(-best[rows, columns], kind="stable")
    found: list[Peak] = []
    places = np.empty((0, 2))
    for k in order:
        place = np.array([rows[k], columns[k]], float)
        if len(places) and np.hypot(*(places - place).T).min() < apart:
            continue
        places = np.vstack([places, place])
        row, column = int(rows[k]), int(columns[k])
        found.append(Peak(float(best[row, column]), int(which[row, column]), row + corner[0], column + corner[1]))
        if len(found) == most:
            break
    return found


def _spectrum(template: Template, start: np.ndarray, size: Sequence[int]) -> np.ndarray:
    """(K, *) conjugate spectrum of a template, divided by the number of its cells."""
    channels, high, wide = template.features.shape
    padded = np.zeros((channels, *size), np.float32)
    padded[:, start[0] : start[0] + high, start[1] : start[1] + wide] = template.features / max(template.cells, 1)
    return np.conj(scipy.fft.rfft2(padded))
