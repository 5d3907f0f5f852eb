"""Orthophotos and other single images, through GDAL: reading by windows, and writing a copy in metres."""

from __future__ import annotations

import hashlib
import math
import shutil
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from rasterio.enums import Interleaving, MaskFlags, Resampling
from rasterio.io import DatasetReader
from rasterio.transform import Affine
from rasterio.windows import Window

from ..core.evidence import READING_SD
from ..core.remarks import CAUTION, INFO, Remark, informing
from ..core.scale import PER_PIXEL
from ..core.source import NO_DATA_GREY, Picture, Placement
from ..errors import InputError, UsageError
from ..formats.points import pixel
from ..system.budget import in_words, require
from ..system.scratch import Scratch
from .fingerprint import fingerprint
from .gdal import EXPORT_AGAIN, open_dataset, reading, settings
from .georeference import Place, claim_of, kept_place, local_place
from .raster_copy import Original
from .tiff_blocks import blocks_of

USE_ANOTHER = "Use a GeoTIFF, JPEG, PNG, JPEG 2000 or VRT file; of a reconstruction, the folder of its model."
OF_OTHERS = "A file that it refers to is missing or damaged: copy all of them along, or write the VRT anew."

SMALLEST = 32
"""[px] An image narrower or lower than this holds no vehicle that could be measured."""

LONGEST_SIDE = 10_000_000
"""[px] A side longer than this no map has, 1,000 km at 0.1 m. A VRT promises it in a few words; copying never ends."""

SQUEEZED = 0.05
"""Width over height of a pixel, as a logarithm, from which its user is cautioned: what it leaves open of the scale is
about a per cent then (`core.measuring.plan.SQUEEZED_SD`)."""

MOST_BETWEEN = 0.5
"""Share of an alpha band's values that are neither nothing nor all, above which it masks nothing. Of masks it is the
share of their edges, of a near infrared band nearly all."""

# Formats that can be decoded from the top only.
_IN_ORDER = frozenset(["AVIF", "BIGGIF", "GIF", "HEIF", "JPEG", "JPEGXL", "PNG", "WEBP"])


class RasterSource:
    """One image that GDAL reads, as a source of pixels and as something to write in metres.

    It is its own only `Picture` (`name`, `width`, `height`, `read`). The file is opened read-only and nothing is
    ever written beside it. Reads take a lock, so that a reader thread may share it with the thread that opened it.

    path : the file.
    unit : ``"m/px"``, what a scale of this source means.
    notes : what the user should know about how the image is read or was written.
    claimed : what its georeferencing says; see `georeference.Claim`.
    """

    unit = PER_PIXEL

    def __init__(self, path: Path, dataset: DatasetReader):
        """Use `RasterSource.open`."""
        self.path = path
        self.name = path.name
        self.notes: list[Remark] = []
        self._dataset = dataset
        self._lock = threading.RLock()
        self.width, self.height = dataset.width, dataset.height
        self._check_size()
        self._bands = self._colour_bands()
        self._probe()
        self._palette = self._palette_table()
        self._overviews = dataset.overviews(self._bands[0])
        masks = self._alpha_masks()
        self._masked = masks and any(MaskFlags.all_valid not in flags for flags in dataset.mask_flag_enums)
        self._stretch = self._stretch_limits()
        self._negative = self._palette is None and dataset.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE") == "YES"
        self._unmixed = self._palette is not None or self._negative or not masks
        self._scratch: Scratch | None = None
        self._blocks = dataset  # or, from the first look on, a copy of it in blocks
        self.claimed = claim_of(dataset)
        if (turned := dataset.tags().get("EXIF_Orientation", "1")) not in ("0", "1"):
            text = (
                f"the camera noted how the picture is to be turned (EXIF orientation {turned}): coordinates and boxes "
                "are those of the pixels as they are stored"
            )
            self.notes.append(Remark(INFO, text))
        if (aspect := self.claimed.aspect) != 1:
            squeezed = abs(math.log(aspect)) > SQUEEZED
            text = (
                f"pixels are {aspect:.3g} times as wide as high on the ground, and vehicles look it: the scale, the "
                "geometric mean of both sides, is less certain (warp it to UTM first)"
            )
            self.notes.append(Remark(CAUTION if squeezed else INFO, text))

    @classmethod
    def open(cls, path: str | Path) -> RasterSource:
        """Open an image: GeoTIFF, COG, JPEG, PNG, JPEG 2000, VRT, or whatever else this GDAL reads.

        Its last block is read too, because a truncated file often opens well.

        Raises InputError when the file is missing, a folder, empty, no image, damaged, or useless (no colour band,
        complex numbers, less than 32 px wide).
        """
        path = Path(path)
        if path.is_dir():
            raise InputError(f"{path} is a folder, not an image", "Name one image file inside it.")
        if not path.is_file():
            raise InputError(f"{path} does not exist", "Check the path.")
        try:
            with path.open("rb") as file:
                empty = not file.read(1)
        except OSError as error:
            raise InputError(f"{path} cannot be read ({error.strerror})", "Check its permissions.") from error
        if empty:
            raise InputError(f"{path} is empty", "Export or download it again.")
        with reading(path, "is not an image that GDAL can open", USE_ANOTHER):
            dataset = open_dataset(path)
        try:
            with reading(path, "is damaged", EXPORT_AGAIN):
                return cls(path, dataset)
        except BaseException:
            dataset.close()
            raise

    @staticmethod
    def check_name(out: Path) -> None:
        """Raise UsageError for a name that `write` would refuse."""
        if out.suffix.lower() not in (".tif", ".tiff"):
            raise UsageError(f"{out.name} would be a GeoTIFF", "Let its name end in .tif.")
        try:
            str(out).encode()
        except UnicodeEncodeError as error:
            raise UsageError(f"{out}: GDAL takes names in UTF-8 only", "Choose another name.") from error

    @property
    def pictures(self) -> list[Picture]:
        """The one image, this source itself."""
        return [self]

    @property
    def picture_names(self) -> list[str]:
        """The one image's name."""
        return [self.name]

    @property
    def plan(self) -> RasterSource:
        """This source itself."""
        return self

    @property
    def posed(self) -> None:
        """An image by itself has no pose."""
        return None

    def from_above(self, place: np.ndarray) -> np.ndarray:
        """(N, 2) places [px], x right and y up from the lower left corner, of pixels (N, 2)."""
        return np.stack([place[:, 0], self.height - place[:, 1]], -1)

    def locate(self, point: str) -> np.ndarray:
        """(2,) where the pixel that ``X,Y`` means would be if pixels were square. Raises ValueError."""
        wide = math.sqrt(self.claimed.aspect)
        return pixel(point, self.width, self.height, "a point of an orthophoto") * (wide, 1 / wide)

    def reading_sd(self, point: str) -> float:
        """One sigma of how well `point` can be read along a line [px]."""
        return READING_SD

    def ray(self, point: str) -> np.ndarray:
        """(2,) 0: an orthophoto has no ground beside itself."""
        return np.zeros(2)

    @property
    def metric_already(self) -> str:
        """Why this image counts as metric, empty if it does not: georeferencing that may be believed."""
        if not self.claimed.usable:
            return ""
        return f"its georeferencing says {self.claimed.gsd_m:.4g} m/px ({self.claimed.why})"

    def __enter__(self) -> RasterSource:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file. Also done at the end of a ``with`` block."""
        self._blocks.close()
        self._dataset.close()
        if self._scratch is not None:
            self._scratch.close()

    def content_hash(self) -> str:
        """SHA-256 of the file as it lies on disk, in hex; of a VRT, not of what it refers to."""
        try:
            with self.path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise InputError(f"{self.path} cannot be read ({error.strerror})", "Was it moved meanwhile?") from error

    @property
    def files(self) -> list[Path]:
        """The image's file and what GDAL reads with it: world file, overviews, the parts of a VRT."""
        return [Path(file) for file in self._dataset.files]

    def fingerprint(self) -> str:
        """What cached work on this image is keyed by: the content of all its files, sampled where it is large."""
        return fingerprint(self.files)

    def __reduce__(self) -> tuple:
        """Pickled as its path: another process opens it anew, once for all its tiles."""
        return _shared, (str(self.path.absolute()),)

    # Reading

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """RGB uint8 (out_height, out_width, 3) of the window at (x, y) with `width` x `height` px, resampled.

        Shrinking averages (overviews are used where the file has them), enlarging is bicubic; pixels without data
        (nodata, alpha or mask) are grey (114). Other depths than 8 bit are stretched, see `notes`.

        Raises ValueError for a window that is not inside the image, InputError when the file is damaged there.
        """
        if min(x, y) < 0 or x + width > self.width or y + height > self.height:
            raise ValueError(f"window {width} x {height} at ({x}, {y}) is not inside {self.width} x {self.height} px")
        if min(width, height, out_width, out_height) < 1:
            raise ValueError(f"empty window: {width} x {height} to {out_width} x {out_height} px")
        window, out = Window(x, y, width, height), (out_height, out_width)
        resampling = Resampling.average if out_width * out_height < width * height else Resampling.cubic
        with self._lock, self._damage(f"at x {x}..{x + width}, y {y}..{y + height}"):
            if self._needs_blocks:
                self._copy_into_blocks()
            if self._unmixed:
                rgb = self._read_unmixed(window, out)
            else:
                pixels = self._blocks.read(
                    self._bands, window=window, out_shape=(len(self._bands), *out), resampling=resampling
                )
                rgb = cv2.merge(list(self._to_8_bit(pixels))).reshape(*out, -1)  # far faster than numpy's transposing
            if self._masked:
                how = Resampling.average if resampling == Resampling.average else Resampling.nearest
                known = self._blocks.dataset_mask(window=window, out_shape=out, resampling=how)
                rgb = np.where((known >= 128)[..., None], rgb, np.uint8(NO_DATA_GREY))
            if self._written is not None:
                rgb = np.where(self._written_at(window, out)[..., None], rgb, np.uint8(NO_DATA_GREY))
        return np.ascontiguousarray(np.broadcast_to(rgb, (*out, 3)))

    def decoded_px(self, width: int, height: int, out_width: int, out_height: int) -> float:
        """How many pixels `read` decodes for such a window: fewer where an overview is coarse enough already."""
        shrink = min(width / out_width, height / out_height)
        factor = max([f for f in self._overviews if f <= shrink], default=1)
        return width * height / factor**2

    def _read_unmixed(self, window: Window, out: tuple[int, int]) -> np.ndarray:
        """What GDAL must not resample: numbers of colours, which have no average; negatives, whose averages it seeks
        among as many colours as their type has values, for minutes; bands beside one that it takes for their mask.
        Up to 4 x 4 pixels per result are averaged."""
        shape = min(window.height, 4 * out[0]), min(window.width, 4 * out[1])
        values = self._blocks.read(
            self._bands, window=window, out_shape=(len(self._bands), *shape), resampling=Resampling.nearest
        )
        if self._palette is not None:
            rgb = self._palette[np.clip(values[0], 0, len(self._palette) - 1)]
        else:
            rgb = cv2.merge(list(self._to_8_bit(values)))
        if self._negative:
            rgb = 255 - rgb
        if shape != out:
            shrinking = out[0] * out[1] < shape[0] * shape[1]
            rgb = cv2.resize(rgb, out[::-1], interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_CUBIC)
        return rgb.reshape(*out, -1)

    def _to_8_bit(self, pixels: np.ndarray) -> np.ndarray:
        """(C, H, W) of any real type to uint8; NaN becomes grey."""
        if self._stretch is None:
            return pixels
        low, high = self._stretch
        with np.errstate(over="ignore"):  # of what fills borders: 1e38 and more
            scaled = (pixels.astype(np.float32) - low) * (255 / (high - low))
        scaled = np.nan_to_num(scaled, nan=NO_DATA_GREY, posinf=255, neginf=0)
        return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)

    @property
    def _needs_blocks(self) -> bool:
        """Whether each window would be decoded from the image's top again: it has no blocks, and is too large for GDAL
        to keep it decoded."""
        return self._in_order and self._blocks is self._dataset and self._decoded_size > settings()["GDAL_CACHEMAX"]

    @property
    def _decoded_size(self) -> int:
        """[byte] of the whole image."""
        return self.width * self.height * sum(np.dtype(kind).itemsize for kind in self._dataset.dtypes)

    def _copy_into_blocks(self) -> None:
        """Decode the image once, from top to bottom, into tiles in a temporary file. Raises InputError."""
        scratch = Scratch()
        free = shutil.disk_usage(scratch.folder).free
        if free < self._decoded_size:
            raise InputError(
                f"{self.path} cannot be read by parts, and {scratch.folder.parent} has no room for a copy of it that "
                f"can ({in_words(self._decoded_size)} needed, {in_words(free)} free)",
                "Let TMPDIR name a folder with more room, or convert it to a tiled GeoTIFF.",
            )
        copy = scratch.folder / "blocks.tif"
        # Fast to write and to read; its place on Earth does not matter there.
        self._original.convert(copy, Place(None, Affine.identity(), ""), compress="zstd", zstd_level=1, predictor=1)
        self._blocks = open_dataset(copy)
        self._scratch = scratch

    def _written_at(self, window: Window, out: tuple[int, int]) -> np.ndarray:
        """(out) bool: where the window of a sparse TIFF, resampled to `out`, shows blocks that were ever written."""
        assert self._written is not None
        rows, columns = self._block
        y = window.row_off + (np.arange(out[0]) + 0.5) * window.height / out[0]
        x = window.col_off + (np.arange(out[1]) + 0.5) * window.width / out[1]
        return self._written[(y / rows).astype(int)[:, None], (x / columns).astype(int)]

    # What is looked at once, at opening

    def _check_size(self) -> None:
        dataset = self._dataset
        if dataset.count == 0:
            inside = "; ".join(dataset.subdatasets[:3])
            raise InputError(
                f"{self.path} has no bands" + (f", only subdatasets: {inside}" if inside else ""),
                "Export one image as GeoTIFF, for example with gdal_translate.",
            )
        if min(self.width, self.height) < SMALLEST:
            raise InputError(
                f"{self.path} is only {self.width} x {self.height} px",
                f"No vehicle could be measured in it; an image needs at least {SMALLEST} px on each side.",
            )
        if max(self.width, self.height) > LONGEST_SIDE:
            raise InputError(f"{self.path} says that it is {self.width} x {self.height} px", EXPORT_AGAIN)
        if len(dataset.subdatasets) > 1:
            self.notes.append(Remark(INFO, f"{self.name} holds {len(dataset.subdatasets)} images; the first is read"))

    def _colour_bands(self) -> list[int]:
        """The bands (from 1) to show: red, green, blue where they are named, by what they mean to GDAL or, as those of
        multispectral cameras are, by their descriptions; else the first three, else one grey."""
        kinds = [c.name for c in self._dataset.colorinterp]
        described = [(text or "").strip().lower() for text in self._dataset.descriptions]
        named = next((names for names in (described, kinds) if {"red", "green", "blue"} <= set(names)), None)
        if named is not None:
            bands = [named.index(k) + 1 for k in ("red", "green", "blue")]
        else:
            bands = [i for i, k in enumerate(kinds, 1) if k != "alpha"]
            bands = bands[:3] if len(bands) >= 3 else bands[:1]
        if not bands:
            raise InputError(f"{self.path} has nothing but an alpha band", "Export the colour bands too.")
        kind = np.result_type(*(self._dataset.dtypes[b - 1] for b in bands))
        if kind.kind not in "uif":
            raise InputError(f"{self.path} holds {kind} values", "Export it with 8 or 16 bit per band.")
        return bands

    def _probe(self) -> None:
        """Find damage without reading everything: the blocks a TIFF says it has, and any format's last block."""
        self._written: np.ndarray | None = None
        self._in_order = self._dataset.driver in _IN_ORDER
        if self._dataset.driver == "GTiff":
            self._check_blocks()
        # One pixel decodes its whole block; asked for a whole PNG at once, GDAL takes a way that tolerates truncation.
        with self._damage("at its end"):
            self._dataset.read(window=Window(self.width - 1, self.height - 1, 1, 1))

    def _check_blocks(self) -> None:
        """Raises InputError for a TIFF whose directory does not say where all its pixels are, or whose blocks are too
        large for the memory budget. Blocks that were never written (GDAL's SPARSE_OK) are no damage, but show nothing.
        """
        dataset, lists = self._dataset, blocks_of(self.path)
        rows, columns = dataset.block_shapes[0]
        apart = dataset.interleaving == Interleaving.band
        size = rows * columns * np.dtype(dataset.dtypes[0]).itemsize * (1 if apart else dataset.count)
        require(2 * size, f"{self.path}, whose pixels are in blocks of {columns} x {rows} px,")
        if lists is None:
            return
        if lists.strip is not None:
            rows = min(lists.strip, self.height)
        shape = (dataset.count if apart else 1, math.ceil(self.height / rows), math.ceil(self.width / columns))
        self._in_order = shape[1:] == (1, 1) and dataset.compression is not None
        wanted = math.prod(shape)
        listed = min(len(values) for values in (lists.offset, lists.count) if values is not None)
        if listed < wanted:
            raise InputError(f"{self.path} is damaged: its directory lists {listed} of {wanted} blocks", EXPORT_AGAIN)
        offset = lists.offset[:wanted]
        count = (offset > 0).astype(np.uint64) if lists.count is None else lists.count[:wanted]
        lost = np.flatnonzero((offset == 0) != (count == 0))
        if len(lost):
            raise InputError(f"{self.path} is damaged: block {lost[0]} has no address", EXPORT_AGAIN)
        end, length = int((offset + count).max(initial=0)), self.path.stat().st_size
        if end > length or int(offset.max(initial=0)) > length:
            raise InputError(
                f"{self.path} is truncated: it has {length} bytes, but its pixels end at byte {end}", EXPORT_AGAIN
            )
        if not offset.all():
            self._written = np.asarray((offset > 0).reshape(shape).any(0))
            self._block = rows, columns

    def _palette_table(self) -> np.ndarray | None:
        """(K, 3) uint8 colours of a paletted image, transparent ones grey, or None."""
        if self._dataset.colorinterp[0].name != "palette":
            return None
        entries = self._dataset.colormap(1)
        table = np.full((max(entries) + 1, 3), NO_DATA_GREY, np.uint8)
        for index, (*rgb, alpha) in entries.items():
            if alpha >= 128:
                table[index] = rgb
        return table

    def _samples(self, side: int = 128) -> Iterator[Window]:
        """Windows of `side` px in an even grid: a decimated read of a file without overviews reads all of it."""
        for y in np.unique(np.linspace(0, max(self.height - side, 0), 8).astype(int)):
            for x in np.unique(np.linspace(0, max(self.width - side, 0), 8).astype(int)):
                yield Window(x, y, min(side, self.width), min(side, self.height))

    def _alpha_masks(self) -> bool:
        """Whether an alpha band, if there is one, says where there is data: its values are nearly all nothing or all.

        Of four bands of 8 bit GDAL calls the last one alpha where nobody told it otherwise. Often it is near infrared:
        dark asphalt and water would show nothing. Formats that are decoded in order know their alpha themselves.
        """
        alpha = next((k for k, c in enumerate(self._dataset.colorinterp, 1) if c.name == "alpha"), None)
        if alpha is None or self._in_order:
            return True
        values = []
        for window in self._samples():
            with self._damage(f"near x {window.col_off}, y {window.row_off}"):
                values.append(self._dataset.read(alpha, window=window).ravel())
        sample = np.concatenate(values)
        between = float(np.mean((sample != 0) & (sample < sample.max())))
        if between <= MOST_BETWEEN:
            return True
        self.notes.append(
            Remark(INFO, f"band {alpha} is called alpha, but is a picture of its own, such as near infrared: not used")
        )
        return False

    def _stretch_limits(self) -> tuple[float, float] | None:
        """The values that become 0 and 255: percentiles 0.5 and 99.5 of samples, or None for plain 8 bit.

        All bands share the limits, which keeps the hues.
        """
        dtypes = {self._dataset.dtypes[b - 1] for b in self._bands}
        bits = self._dataset.tags(self._bands[0], "IMAGE_STRUCTURE").get("NBITS", "8")
        if self._palette is not None or (dtypes == {"uint8"} and int(bits) == 8):
            return None
        values = []
        for window in self._samples():
            with self._damage(f"near x {window.col_off}, y {window.row_off}"):
                pixels = self._dataset.read(self._bands, window=window)
                known = self._dataset.dataset_mask(window=window) > 0
            sample = pixels[:, known].ravel()
            values.append(sample[np.isfinite(sample)])
        sample = _without_fill(np.concatenate(values))
        low, high = (float(v) for v in np.percentile(sample, [0.5, 99.5])) if len(sample) else (0.0, 1.0)
        high = high if high > low else low + 1
        text = f"{'/'.join(sorted(dtypes))} values from {low:g} to {high:g} are shown as 0 to 255"
        self.notes.append(Remark(INFO, text))
        return low, high

    def _damage(self, where: str) -> AbstractContextManager[None]:
        if self._dataset.driver == "VRT":  # it has no pixels of its own
            return reading(self.path, f"cannot be read {where}", OF_OTHERS)
        return reading(self.path, f"is damaged {where}", EXPORT_AGAIN)

    # Writing

    @property
    def _original(self) -> Original:
        return Original(self.path, self._dataset, self._palette is not None, self._lock)

    def place(self, metres_per_pixel: float, keep_origin: bool = False) -> Place:
        """The georeferencing that a copy of this scale gets: local metres, or the input's own place and direction."""
        return (kept_place if keep_origin else local_place)(self.claimed, self.height, metres_per_pixel)

    def write(self, path: Path, metres_per_pixel: float, place: Placement | None = None, cog: bool = False) -> None:
        """Write a GeoTIFF with the same pixels and the measured scale.

        A TIFF is copied and only its georeferencing is replaced; any other format is written losslessly (deflate,
        tiles, BigTIFF by need). Bands, type, nodata, alpha, mask, palette, tags and overviews stay. Former
        georeferencing, ground control points and rational polynomials do not; `notes` says so.
        The result is read back and compared with the original: all of it up to 100 Mpx, else 64 windows.

        path : where to write; an existing file is replaced. Use `orthoscale.system.outputs` around it.
        metres_per_pixel : [m/px] the measured scale.
        place : the georeferencing that it gets; by default local metres, north up, origin at the lower left corner.
        cog : write a cloud-optimised GeoTIFF (lossless, deflate), with overviews.

        Raises UsageError for a scale that is not a positive number or a path not named .tif or .tiff; InputError when
        the input turns out to be damaged; OutputError when the copy cannot be written or does not read back alike.
        """
        path = Path(path)
        if not (math.isfinite(metres_per_pixel) and metres_per_pixel > 0):
            raise UsageError(f"a scale of {metres_per_pixel} m/px makes no sense", "It must be a positive number.")
        self.check_name(path)
        if path.exists() and path.samefile(self.path):
            raise UsageError(f"{path} is the input itself", "Choose another name for the output.")
        place = place or self.place(metres_per_pixel)
        original = self._original
        original.write(path, place, cog)
        notes = [f"{path.name}: {place.said}"]
        if original.is_cog and not cog:
            notes.append(f"{path.name} is no longer cloud-optimised as {self.name} is (--cog makes it so)")
        self.notes += [note for note in informing(notes) if note not in self.notes]


def _without_fill(sample: np.ndarray) -> np.ndarray:
    """`sample` (N,) without what fills an image's borders although it is not declared as nodata, such as -9999: one
    value at an end, farther from all others than these are from one another."""
    for end in (np.min, np.max):
        rest = sample[sample != end(sample)] if len(sample) else sample
        if len(rest) and abs(float(end(sample)) - float(end(rest))) > float(rest.max()) - float(rest.min()) > 0:
            sample = rest
    return sample


@lru_cache(maxsize=4)
def _shared(path: str) -> RasterSource:
    return RasterSource.open(path)
