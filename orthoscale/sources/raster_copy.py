"""Copies of an image as GeoTIFF: the same pixels with a new georeferencing, read back and compared."""

from __future__ import annotations

import math
import os
import re
import shutil
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.enums import MaskFlags, Resampling
from rasterio.io import DatasetReader, DatasetWriter
from rasterio.shutil import copy as gdal_copy
from rasterio.windows import Window

from ..core.source import Placement
from ..errors import OutputError, shown
from ..formats.names import in_utf8
from ..system.signatures import room
from .gdal import EXPORT_AGAIN, GDAL_ERRORS, guarded, open_dataset, reading, reason

_STRIP = 256  # [px] height of the strips in which whole images are read, and side of the tiles that are written
_CLASSIC = 2**32 - 2**24  # [byte] a classic TIFF longer than this may have no room for another directory
_WHOLE = 100_000_000  # [px] copies up to this size are compared with their original in full, larger ones by samples
_PROFILE = "COLOR_PROFILE", "SOURCE_ICC_PROFILE"  # GDAL's domain and name of an ICC profile, base64
_TRANSPARENT = "NODATA_VALUES"  # GDAL's tag for a colour that means no data: a value for each band
# Domains of metadata that are not copied: GDAL's own, those of the file's structure, those of former georeferencing,
# and a profile, which is not metadata in a TIFF. Of XML domains only XMP is copied: much of the rest is former
# georeferencing.
_OWN_DOMAINS = {"", "COLOR_PROFILE", "DERIVED_SUBDATASETS", "GEOLOCATION", "IMAGE_STRUCTURE", "RPC", "SUBDATASETS"}
SCALE_TAG = "ORTHOSCALE_SCALE"  # metadata of a copy: its scale in words, which stays with the file, unlike the report
# Parts of names, without what is no letter, by which metadata tell the size of a pixel: GSD, productGSD of Maxar,
# PIXEL_SIZE, Ground_Sample_Distance, SPATIAL_RESOLUTION. The tags of TIFF and EXIF are of prints and sensors.
_SIZES = ("gsd", "groundsampl", "pixelsize", "cellsize", "groundresolution", "spatialresolution", "imageresolution")
_XMP = "xml:XMP"  # GDAL's domain and name of XMP: author, camera, rights


@dataclass(frozen=True)
class Original:
    """An open image that is copied.

    path, dataset : its file, and GDAL's dataset for it. paletted : whether its values are indices into a palette.
    lock : that all readers of the dataset take.
    """

    path: Path
    dataset: DatasetReader
    paletted: bool
    lock: threading.RLock

    def write(self, path: Path, place: Placement, cog: bool = False, said: str = "") -> None:
        """Write the copy, see `RasterSource.write`. Raises InputError for a damaged original; OutputError for a copy
        that cannot be written or does not read back the same."""
        plain = path.with_name(f"plain.{path.name[-100:]}") if cog else path  # shortened: names have a limited length
        try:
            with guarded():
                if self._can_be_copied():
                    shutil.copyfile(self.path, plain)
                else:
                    self.convert(plain, place)
                with rasterio.open(plain, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as copy:
                    self._restore_properties(copy)
                    copy.crs, copy.transform = place.crs, place.transform
                    copy.update_tags(WRITTEN_BY=room(path), **({SCALE_TAG: in_utf8(said)} if said else {}))
                if cog:
                    self._optimise(plain, path)
                # It would hold what a GeoTIFF cannot, and would be lost when the file is renamed.
                _remove(Path(f"{path}.aux.xml"))
                self._verify(path, place)
        except GDAL_ERRORS as error:
            why = f"{path} could not be written ({reason(error)})"
            raise OutputError(why, "Check the free space on its disk.") from error
        finally:
            if cog:
                for leftover in (plain, Path(f"{plain}.aux.xml")):
                    _remove(leftover)

    @property
    def is_cog(self) -> bool:
        """Whether it is a cloud-optimised GeoTIFF."""
        return self.dataset.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") == "COG"

    @property
    def images(self) -> int:
        """Number of images in its file."""
        return max(1, len(self.dataset.subdatasets))

    @property
    def has_several_nodata(self) -> bool:
        """Whether its bands have different nodata values. A GeoTIFF can hold only one, so the copy gets a mask."""
        return len(self._nodata()) > 1 and not self._has_transparent_colour

    @property
    def _has_transparent_colour(self) -> bool:
        """Whether a tag says which colour means no data, as for a PNG: GDAL makes the mask from it, also for a TIFF."""
        return _TRANSPARENT in self.dataset.tags()

    def _can_be_copied(self) -> bool:
        """Whether it is a TIFF with all its pixels in the one file, without rational polynomials or a GEOLOCATION array
        (rasterio cannot remove those) or other images (which would keep their former georeferencing), and with room for
        a new directory at its end if it is a classic one, whose offsets have 32 bits."""
        dataset = self.dataset
        in_one_file = not any(f.endswith(".msk") for f in dataset.files) and not self.has_several_nodata
        alone = not dataset.rpcs and not dataset.tags(ns="GEOLOCATION") and self.images == 1
        return dataset.driver == "GTiff" and in_one_file and alone and self._has_room()

    def sizes_told(self, cog: bool) -> list[str]:
        """Those of its metadata that come along and may tell its former scale, as "NAME=VALUE"."""
        told: dict[str, str] = {}
        for band in (0, *self.dataset.indexes):
            lost = band > 0 and cog and self._has_others
            for domain in ([] if lost else [None]) + _others(self.dataset, band):
                told |= self.dataset.tags(band, ns=domain)
        return [f"{name}={shown(value, 40)}" for name, value in told.items() if _tells_size(name)]

    @property
    def lost_in_cog(self) -> list[str]:
        """Names of its bands' own metadata, if a cloud-optimised copy lacks them (see `_optimise`)."""
        own = [name for band in self.dataset.indexes for name in self.dataset.tags(band)] if self._has_others else []
        return list(dict.fromkeys(own))

    @property
    def transparent_colours(self) -> int:
        """Number of colours in its palette that are transparent or partly so, and opaque in the copy: the palette of a
        GeoTIFF has no transparency. That of a nodata value is none of them."""
        if not self.paletted:
            return 0
        return sum(
            colour[3] < 255 for value, colour in self.dataset.colormap(1).items() if value != self.dataset.nodata
        )

    @property
    def _has_others(self) -> bool:
        """Whether there are metadata that are copied besides those of the default domain."""
        return any(_others(self.dataset, band) for band in (0, *self.dataset.indexes))

    def _has_room(self) -> bool:
        with self.path.open("rb") as file:
            big = file.read(4) in (b"II+\0", b"MM\0+")
        return big or self.path.stat().st_size < _CLASSIC

    def _nodata(self) -> set[str]:
        """The bands' different nodata values, as text, so that NaN equals NaN."""
        return {repr(v) for v in self.dataset.nodatavals}

    def _optimise(self, plain: Path, path: Path) -> None:
        """Write a cloud-optimised copy of the GeoTIFF `plain` to `path`. Always deflate: pixels that were once
        compressed as JPEG stay as they were decoded, at the cost of a larger file.

        GDAL copies either the bands' own metadata or all other domains (3.10): the latter, where there are any.
        """
        predictor = "FLOATING_POINT" if np.result_type(*self.dataset.dtypes).kind == "f" else "STANDARD"
        if "NBITS" in self.dataset.tags(1, ns="IMAGE_STRUCTURE"):  # such as 1 or 12 bits per value: no predictor exists
            predictor = "NO"
        gdal_copy(
            plain,
            path,
            driver="COG",
            COMPRESS="DEFLATE",
            PREDICTOR=predictor,
            BLOCKSIZE=512,
            BIGTIFF="IF_SAFER",
            OVERVIEWS="AUTO",
            RESAMPLING="NEAREST" if self.paletted else "AVERAGE",
            NUM_THREADS="ALL_CPUS",
            COPY_SRC_MDD="YES" if self._has_others else "AUTO",
        )

    def convert(self, path: Path, place: Placement, **options: Any) -> None:
        """Write a tiled GeoTIFF with the same pixels; `options` are additional ones of GDAL's. Raises InputError, and
        GDAL's errors."""
        source = self.dataset
        dtype = np.result_type(*source.dtypes)
        kinds = [c.name for c in source.colorinterp]
        in_file_mask = MaskFlags.per_dataset in source.mask_flag_enums[0] and "alpha" not in kinds
        explicit_mask = (in_file_mask and not self._has_transparent_colour) or self.has_several_nodata
        if kinds[:3] == ["red", "green", "blue"] and dtype.kind == "u":
            options["photometric"] = "RGB"
        elif _negative(source):
            options["photometric"] = "MINISWHITE"
        if profile := source.tags(ns=_PROFILE[0]).get(_PROFILE[1]):
            options[_PROFILE[1]] = profile
        packing = {"compress": "deflate", "predictor": 3 if dtype.kind == "f" else 2}
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            width=self.dataset.width,
            height=self.dataset.height,
            count=source.count,
            dtype=dtype.name,
            crs=place.crs,
            transform=place.transform,
            tiled=True,
            blockxsize=_STRIP,
            blockysize=_STRIP,
            interleave="pixel",
            num_threads="all_cpus",
            bigtiff="IF_SAFER",
            **{**packing, **options},
        ) as copy:
            self._restore_properties(copy)
            for window in self._strips():
                pixels, mask = self._raw(window)
                copy.write(pixels.astype(dtype, copy=False), window=window)
                if explicit_mask:
                    copy.write_mask(mask, window=window)

    def _restore_properties(self, copy: DatasetWriter) -> None:
        """Give `copy` what the original has, but a bare GeoTIFF, or a copy without its .aux.xml and .ovr, lacks."""
        source = self.dataset
        nodata_told = len(self._nodata()) == 1 and source.nodata is not None
        if nodata_told and copy.nodata is None and _fits(source.nodata, copy.dtypes[0]):
            copy.nodata = source.nodata
        if copy.colorinterp != source.colorinterp:
            copy.colorinterp = source.colorinterp
        if self.paletted and copy.dtypes[0] in ("uint8", "uint16") and not _has_palette(copy):
            copy.write_colormap(1, source.colormap(1))
        for name in ("descriptions", "scales", "offsets", "units"):
            if getattr(copy, name) != getattr(source, name):
                setattr(copy, name, getattr(source, name))
        for band in (0, *source.indexes):
            tags, had = source.tags(band), copy.tags(band)
            if tags.get("AREA_OR_POINT") == "Point":  # GDAL gives a new TIFF "Area"
                had.pop("AREA_OR_POINT", None)
            if new := {k: v for k, v in tags.items() if k not in had}:
                copy.update_tags(band, **new)
            for domain in _others(source, band):
                if domain != _XMP and not copy.tags(band, ns=domain):
                    copy.update_tags(band, ns=domain, **source.tags(band, ns=domain))
        # For such a domain GDAL takes the text "name=value", which rasterio makes of a tag, as the domain's content.
        name, equals, text = source.tags(ns=_XMP).get(_XMP, "").partition("=")
        if equals and not copy.tags(ns=_XMP):
            copy.update_tags(ns=_XMP, **{name: text})
        if copy.mode == "r+" and source.overviews(1) and not copy.overviews(1):
            resampling = Resampling.nearest if self.paletted else Resampling.average
            copy.build_overviews(source.overviews(1), resampling)

    def _strips(self) -> Iterator[Window]:
        """Windows over the whole image, in reading order, because JPEG and PNG can be decoded only from the top."""
        for y in range(0, self.dataset.height, _STRIP):
            for x in range(0, self.dataset.width, 256 * _STRIP):
                yield Window(x, y, min(256 * _STRIP, self.dataset.width - x), min(_STRIP, self.dataset.height - y))

    def _raw(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """The unchanged bands (C, H, W), and the mask (H, W) uint8."""
        with self.lock, reading(self.path, f"is damaged near y {window.row_off}", EXPORT_AGAIN):
            return self.dataset.read(window=window), self.dataset.dataset_mask(window=window)

    def _verify(self, path: Path, place: Placement) -> None:
        """Read the copy back and compare; raises OutputError."""
        source = self.dataset
        with open_dataset(path) as copy:
            told = {
                "size": (copy.width, copy.height, copy.count) == (source.width, source.height, source.count),
                "type": copy.dtypes[0] == np.result_type(*source.dtypes) or copy.dtypes == source.dtypes,
                "colours": _colours(copy) == _colours(source),
                "negative": not _negative(source) or _negative(copy) or _has_palette(copy),  # GDAL may make a palette
                "transform": np.allclose(copy.transform, place.transform, rtol=1e-9, atol=0),
                "coordinate reference system": copy.crs is not None and self._same_system(copy.crs, place.crs),
                "ground control": not copy.gcps[0] and not copy.rpcs and not copy.tags(ns="GEOLOCATION"),
            }
            wrong = [name for name, right in told.items() if not right]
            for window in [] if wrong else self._to_compare():
                pixels, mask = self._raw(window)
                floating = pixels.dtype.kind == "f"
                same = np.array_equal(pixels, copy.read(window=window), equal_nan=floating)
                if not (same and np.array_equal(mask, copy.dataset_mask(window=window))):
                    wrong = [f"pixels near x {window.col_off}, y {window.row_off}"]
                    break
        if wrong:
            raise OutputError(
                f"{path} does not read back as it was meant: {', '.join(wrong)}",
                "Check the disk; if it is sound, convert the input to a plain GeoTIFF first (gdal_translate).",
            )

    @staticmethod
    def _same_system(found: CRS, meant: str | CRS) -> bool:
        """Whether the CRS is the one that was meant. An engineering CRS does not compare equal after writing: there the
        unit must be the same."""
        meant = CRS.from_user_input(meant)
        return found == meant or (found.units_factor[1] == meant.units_factor[1] and not meant.is_projected)

    def _to_compare(self) -> Iterator[Window]:
        if self.dataset.width * self.dataset.height <= _WHOLE:
            yield from self._strips()
            return
        rng, side = np.random.default_rng(0), min(512, self.dataset.width, self.dataset.height)
        for y in np.sort(rng.integers(0, self.dataset.height - side + 1, 64)):
            yield Window(int(rng.integers(0, self.dataset.width - side + 1)), int(y), side, side)


def _others(dataset: DatasetReader, band: int) -> list[str]:
    """Domains of a band's metadata, or of the whole image's (0), that are copied besides the default one."""
    domains = [domain for domain in dataset.tag_namespaces(band) if domain not in _OWN_DOMAINS]
    return [domain for domain in domains if domain == _XMP or not domain.startswith("xml:")]


def _tells_size(name: str) -> bool:
    """Whether metadata of that name tell the size of a pixel on the ground."""
    letters = re.sub("[^a-z]", "", name.lower())
    return any(part in letters for part in _SIZES)


def _fits(value: float, dtype: str) -> bool:
    """Whether a nodata value can occur in bands of this type."""
    if np.dtype(dtype).kind == "f":
        return True
    limits = np.iinfo(dtype)
    return math.isfinite(value) and limits.min <= value <= limits.max


def _colours(dataset: DatasetReader) -> list[str]:
    """Colour interpretations of its bands; grey ones count as undefined: in a TIFF only the first is grey, and must
    be."""
    return ["undefined" if kind.name == "gray" else kind.name for kind in dataset.colorinterp]


def _negative(dataset: DatasetReader) -> bool:
    """Whether light is stored as dark."""
    return dataset.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE") == "YES"


def _remove(path: Path) -> None:
    """Remove the file `path`, if there is one; its name may be too long for a file."""
    if os.path.lexists(path):
        path.unlink()


def _has_palette(dataset: DatasetReader) -> bool:
    try:
        return bool(dataset.colormap(1))
    except ValueError:
        return False
