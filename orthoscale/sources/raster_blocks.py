"""The blocks of a raster in its file: which of them exist, and whether one can be read by itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rasterio.enums import Interleaving
from rasterio.io import DatasetReader
from rasterio.windows import Window

from ..errors import InputError
from ..system.budget import require
from .gdal import EXPORT_AGAIN
from .tiff_blocks import blocks_of

# Formats that can be decoded only from the top.
_IN_ORDER = frozenset(["AVIF", "BIGGIF", "GIF", "HEIF", "JPEG", "JPEGXL", "PNG", "WEBP"])


@dataclass(frozen=True)
class RasterBlocks:
    """in_order : whether each window is decoded from the image's top.

    written : (rows, columns) bool, which blocks of a sparse TIFF were ever written; None if all were. shape : of one of
    these blocks, rows and columns [px].
    """

    in_order: bool
    written: np.ndarray | None = None
    shape: tuple[int, int] = (1, 1)

    @classmethod
    def of(cls, path: Path, dataset: DatasetReader) -> RasterBlocks:
        """The blocks of an open image.

        Raises InputError for a TIFF whose directory does not locate all its pixels, or whose blocks are too large for
        the memory budget. Blocks that were never written (GDAL's SPARSE_OK) are not damage, but show nothing.
        """
        if dataset.driver != "GTiff":
            return cls(dataset.driver in _IN_ORDER)
        lists = blocks_of(path)
        rows, columns = dataset.block_shapes[0]
        apart = dataset.interleaving == Interleaving.band
        size = rows * columns * np.dtype(dataset.dtypes[0]).itemsize * (1 if apart else dataset.count)
        require(2 * size, f"{path}, whose pixels are in blocks of {columns} x {rows} px,")
        if lists is None:
            return cls(False)
        if lists.strip is not None:
            rows = min(lists.strip, dataset.height)
        shape = (dataset.count if apart else 1, math.ceil(dataset.height / rows), math.ceil(dataset.width / columns))
        in_order = shape[1:] == (1, 1) and dataset.compression is not None
        wanted = math.prod(shape)
        listed = min(len(values) for values in (lists.offset, lists.count) if values is not None)
        if listed < wanted:
            raise InputError(f"{path} is damaged: its directory lists {listed} of {wanted} blocks", EXPORT_AGAIN)
        offset = lists.offset[:wanted]
        count = (offset > 0).astype(np.uint64) if lists.count is None else lists.count[:wanted]
        lost = np.flatnonzero((offset == 0) != (count == 0))
        if len(lost):
            raise InputError(f"{path} is damaged: block {lost[0]} has no address", EXPORT_AGAIN)
        end, length = int((offset + count).max(initial=0)), path.stat().st_size
        if end > length or int(offset.max(initial=0)) > length:
            raise InputError(
                f"{path} is truncated: it has {length} bytes, but its pixels end at byte {end}", EXPORT_AGAIN
            )
        if offset.all():
            return cls(in_order)
        return cls(in_order, np.asarray((offset > 0).reshape(shape).any(0)), (rows, columns))

    def written_at(self, window: Window, out: tuple[int, int]) -> np.ndarray:
        """Bool of shape `out`: where the `window`, resampled to that shape, shows blocks that were ever written."""
        assert self.written is not None, "asked before"
        rows, columns = self.shape
        y = window.row_off + (np.arange(out[0]) + 0.5) * window.height / out[0]
        x = window.col_off + (np.arange(out[1]) + 0.5) * window.width / out[1]
        return self.written[(y / rows).astype(int)[:, None], (x / columns).astype(int)]
