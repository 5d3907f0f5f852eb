"""How the values of a raster become RGB pixels: which bands, which colours, which range of values."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rasterio.enums import MaskFlags
from rasterio.io import DatasetReader
from rasterio.windows import Window

from ..core.remarks import INFO, Remark
from ..core.source import NO_DATA_GREY
from ..errors import InputError

EXPORT_BITS = "Export it with 8 or 16 bit per band."

MOST_BETWEEN = 0.5
"""Share of an alpha band's values that are neither nothing nor all, above which it masks nothing. Of masks it is the
share of their edges, of a near infrared band nearly all."""

MOST_SPOTS = 1e-3
"""Share of a picture, in spots with picture all around them, that may have the value of no data. The roofs of a tenth
of the cars of a car park are more; holes of a mosaic are larger than spots, or few."""

SHOWN = (0.5, 99.5)
"""Percentiles of the values that become 0 and 255, where they are not of 8 bit."""

OF_8_BIT = (257, 256)
"""Factors by which programs make 16 bits of 8: 255 becomes 65535, or a byte moves up."""

SAMPLE_SIDE, SAMPLES_ACROSS = 128, 8
"""Side of a sample of an image's values [px], and number of samples across and down."""

Damage = Callable[[str], AbstractContextManager[None]]
"""Turns GDAL's errors within it into what is told of damage; given where that is."""


@dataclass(frozen=True)
class Display:
    """How a raster is shown.

    bands : numbers, from 1, of the red, green and blue bands, or of the grey one.
    palette : (K, 3) uint8 colours of a paletted image, transparent ones grey; None for others.
    stretch : the values that become 0 and 255; None for plain 8 bit. All bands share them, which keeps the hues.
    negative : whether light is stored as dark.
    masks : whether an alpha band or a nodata value, if there is one, really says where there is data.
    notes : what the user should know about it.
    """

    bands: list[int]
    palette: np.ndarray | None = None
    stretch: tuple[float, float] | None = None
    negative: bool = False
    masks: bool = True
    notes: list[Remark] = field(default_factory=list)

    @classmethod
    def of(cls, path: Path, dataset: DatasetReader, in_order: bool, damage: Damage) -> Display:
        """The display for an open image, by samples of its values.

        in_order : whether it can be decoded only from the top. Raises InputError for an image that has no colour band
        or none of real numbers, or is damaged.
        """
        bands = _colour_bands(path, dataset)
        palette = _palette(dataset)
        unmasked = None if in_order else _no_alpha(dataset, bands, damage) or _no_nodata(dataset, bands, damage)
        stretch, shown = (None, None) if palette is not None else _stretch(dataset, bands, damage)
        negative = palette is None and dataset.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE") == "YES"
        notes = [Remark(INFO, text) for text in (unmasked, shown) if text]
        return cls(bands, palette, stretch, negative, unmasked is None, notes)

    @property
    def unmixed(self) -> bool:
        """Whether GDAL must not resample the values. Indices into a palette have no average. For negatives GDAL would
        search a palette with as many colours as the type has values, for minutes. And it would mask bands by an alpha
        band or nodata value that is not a mask."""
        return self.palette is not None or self.negative or not self.masks

    def rgb(self, values: np.ndarray) -> np.ndarray:
        """(H, W, 3 or 1) uint8 of the bands' `values` (C, H, W) of any real type; NaN becomes grey."""
        if self.palette is not None:
            return self.palette[np.clip(values[0], 0, len(self.palette) - 1)]
        rgb = cv2.merge(list(self._to_8_bit(values)))  # far faster than transposing in NumPy
        return (255 - rgb if self.negative else rgb).reshape(*values.shape[1:], -1)

    def _to_8_bit(self, values: np.ndarray) -> np.ndarray:
        if self.stretch is None:
            return values
        low, high = self.stretch
        with np.errstate(over="ignore"):  # fill values of borders may be 1e38 and more
            scaled = (values.astype(np.float32) - low) * (255 / (high - low))
        scaled = np.nan_to_num(scaled, nan=NO_DATA_GREY, posinf=255, neginf=0)
        return np.clip(np.floor(scaled + 0.5), 0, 255).astype(np.uint8)  # halves upwards, as GDAL rounds averages


def _colour_bands(path: Path, dataset: DatasetReader) -> list[int]:
    """The bands (from 1) to show: red, green and blue if they are named, by their descriptions (as those of
    multispectral cameras) or GDAL's colour interpretation; else the first three, else one grey."""
    kinds = [c.name for c in dataset.colorinterp]
    described = [(text or "").strip().lower() for text in dataset.descriptions]
    named = next((names for names in (described, kinds) if {"red", "green", "blue"} <= set(names)), None)
    if named is not None:
        bands = [named.index(k) + 1 for k in ("red", "green", "blue")]
    else:
        bands = [i for i, k in enumerate(kinds, 1) if k != "alpha"]
        bands = bands[:3] if len(bands) >= 3 else bands[:1]
    if not bands:
        raise InputError(f"{path} has nothing but an alpha band", "Export the colour bands too.")
    kind = np.result_type(*(dataset.dtypes[b - 1] for b in bands))
    if kind.kind not in "uif":
        raise InputError(f"{path} holds {kind} values", EXPORT_BITS)
    return bands


def _palette(dataset: DatasetReader) -> np.ndarray | None:
    if dataset.colorinterp[0].name != "palette":
        return None
    entries = dataset.colormap(1)
    table = np.full((max(entries) + 1, 3), NO_DATA_GREY, np.uint8)
    for index, (*rgb, alpha) in entries.items():
        if alpha >= 128:
            table[index] = rgb
    return table


def _samples(dataset: DatasetReader, damage: Damage, read: Callable[[Window], np.ndarray]) -> Iterator[np.ndarray]:
    """What `read` gives for windows in an even grid: a decimated read of a file without overviews reads all of it."""
    for y in np.unique(np.linspace(0, max(dataset.height - SAMPLE_SIDE, 0), SAMPLES_ACROSS).astype(int)):
        for x in np.unique(np.linspace(0, max(dataset.width - SAMPLE_SIDE, 0), SAMPLES_ACROSS).astype(int)):
            with damage(f"near x {x}, y {y}"):
                values = read(Window(x, y, min(SAMPLE_SIDE, dataset.width), min(SAMPLE_SIDE, dataset.height)))
            yield values


def _no_alpha(dataset: DatasetReader, bands: list[int], damage: Damage) -> str | None:
    """Why an alpha band does not say where there is data, as it does if nearly all its values are 0 or the largest;
    None if it does, or there is none.

    GDAL calls the last of four 8 bit bands alpha unless the file says otherwise. Often it is near infrared, and dark
    asphalt and water would be masked; or, by its description, it is one of the `bands` that are shown. Formats that are
    decoded in order have a real alpha.
    """
    alpha = next((k for k, c in enumerate(dataset.colorinterp, 1) if c.name == "alpha"), None)
    if alpha is None:
        return None
    if alpha in bands:
        return f"band {alpha} is tagged alpha, but described as a colour: used as that"
    sample = np.concatenate([*_samples(dataset, damage, lambda window: dataset.read(alpha, window=window).ravel())])
    between = float(np.mean((sample != 0) & (sample < sample.max())))
    if between <= MOST_BETWEEN:
        return None
    return f"band {alpha} is tagged alpha, but is a picture of its own, such as near infrared: not used"


def _no_nodata(dataset: DatasetReader, bands: list[int], damage: Damage) -> str | None:
    """Why a nodata value does not say where there is data: it is one of the picture's colours. None if it does, or
    there is none.

    Exports with white borders declare 255 as nodata. Blown-out roofs of white cars have that value, too, and would
    become grey holes.
    """
    by_value = all(dataset.mask_flag_enums[band - 1] == [MaskFlags.nodata] for band in bands)
    if not by_value or np.result_type(*(dataset.dtypes[band - 1] for band in bands)).kind == "f":
        return None
    spots, seen = 0, 0
    for nothing in _samples(dataset, damage, lambda window: dataset.dataset_mask(window=window) == 0):
        left, top, width, height, area = cv2.connectedComponentsWithStats(nothing.astype(np.uint8))[2][1:].T
        inside = (left > 0) & (top > 0) & (left + width < nothing.shape[1]) & (top + height < nothing.shape[0])
        spots += int(area[inside].sum())
        seen += nothing.size - int(area[~inside].sum())
    if spots <= MOST_SPOTS * seen:
        return None
    return f"the nodata value ({dataset.nodata:g}) is a colour of the picture too, as of white roofs: shown as it is"


def _stretch(dataset: DatasetReader, bands: list[int], damage: Damage) -> tuple[tuple[float, float] | None, str | None]:
    """The values to show as 0 and 255, and what to say of that: percentiles SHOWN of samples of the `bands`; or, if all
    are 8 bit values times one of OF_8_BIT, what 0 and 255 became, since such pictures, if stretched, were measured
    differently from their originals. None for plain 8 bit."""
    dtypes = {dataset.dtypes[b - 1] for b in bands}
    bits = dataset.tags(bands[0], "IMAGE_STRUCTURE").get("NBITS", "8")
    if dtypes == {"uint8"} and int(bits) == 8:
        return None, None

    def known(window: Window) -> np.ndarray:
        pixels = dataset.read(bands, window=window)
        return pixels[:, dataset.dataset_mask(window=window) > 0].ravel()

    sample = np.concatenate([*_samples(dataset, damage, known)])
    sample = _without_fill(sample[np.isfinite(sample)])
    if dtypes == {"uint16"} and sample.any():
        for factor in OF_8_BIT:
            if not (sample % factor).any():
                return (0.0, 255.0 * factor), f"uint16 values are 8-bit values times {factor}: shown as such"
    low, high = (float(v) for v in np.percentile(sample, SHOWN)) if len(sample) else (0.0, 1.0)
    high = high if high > low else low + 1
    return (low, high), f"{'/'.join(sorted(dtypes))} values from {low:g} to {high:g} are shown as 0 to 255"


def _without_fill(sample: np.ndarray) -> np.ndarray:
    """`sample` (N,) without undeclared fill values of an image's borders, such as -9999: an extreme value that is
    farther from all others than these are from one another."""
    for end in (np.min, np.max):
        rest = sample[sample != end(sample)] if len(sample) else sample
        if len(rest) and abs(float(end(sample)) - float(end(rest))) > float(rest.max()) - float(rest.min()) > 0:
            sample = rest
    return sample
