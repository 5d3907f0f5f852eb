"""Orthophotos and other single images, through GDAL: reading by windows, and writing a copy in metres."""

from __future__ import annotations

import math
import shutil
import threading
from contextlib import AbstractContextManager, suppress
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from rasterio.enums import MaskFlags, Resampling
from rasterio.io import DatasetReader
from rasterio.transform import Affine
from rasterio.windows import Window

from ..core.control import READING_SD
from ..core.projection.planar import square_pixels
from ..core.remarks import INFO, Remark, informing
from ..core.scale import PER_PIXEL
from ..core.source import NO_DATA_GREY, Located, Picture, Placement
from ..errors import InputError, UsageError
from ..formats.other_programs import what_instead
from ..formats.points import pixel
from ..formats.reading import absent
from ..system.budget import in_words
from ..system.scratch import Scratch
from .fingerprint import Stamp, another, file_hash, fingerprint, require_unchanged
from .gdal import EXPORT_AGAIN, IN_UTF8, can_find, files_of, open_dataset, projection_file, reading, settings
from .georeference import CopyGeoreference, claim_of, kept_place, local_place, other_claims
from .raster_blocks import RasterBlocks
from .raster_copy import SCALE_TAG, Original
from .raster_display import EXPORT_BITS, Display
from .raster_margin import margin_of
from .raster_notes import of_copy, of_image, of_margin

USE_ANOTHER = "Use a GeoTIFF, JPEG, PNG, JPEG 2000 or VRT file; of a reconstruction, the folder of its model."
OF_OTHERS = "A file that it refers to is missing or damaged: copy all of them too, or write the VRT again."

STATISTICS = ".aux.xml"  # GDAL and QGIS may write it at any time; it holds no pixels

COMPLEX_INTEGERS = "complex_int16"  # rasterio's name of a type

SMALLEST = 32
"""[px] An image narrower or lower than this holds no vehicle that could be measured."""

LONGEST_SIDE = 10_000_000
"""[px] A side longer than this no map has, 1,000 km at 0.1 m. A VRT promises it in a few words; copying never ends."""


class RasterSource:
    """One image that GDAL reads, as a source of pixels and as something to write in metres.

    It is its own only `Picture` (`name`, `width`, `height`, `read`). The file is opened read-only and nothing is
    ever written beside it. Reads take a lock, so that a reader thread may share it with the thread that opened it.

    path : the file.
    unit : ``"m/px"``, of a scale of this source.
    files : the image's file and what is read with it: world file and ``.prj``, overviews, the parts of a VRT.
    notes : what the user should know about how the image is read or was written.
    claimed : the scale that its georeferencing states; see `georeference.Claim`.
    by_orthoscale : whether its metadata say that orthoscale gave it its scale.
    """

    unit = PER_PIXEL

    def __init__(self, path: Path, dataset: DatasetReader, stamp: Stamp):
        """Use `RasterSource.open`. stamp : of the file before it was opened."""
        self.path = path
        self.name = path.name
        self.notes: list[Remark] = []
        self._dataset = dataset
        projection = projection_file(path) if dataset.crs is None else None
        self.files = [*files_of(dataset), *([] if projection is None else [projection])]
        self._stamps = {path: stamp}
        for file in self.files:
            if not file.name.endswith(STATISTICS):
                with suppress(InputError):  # a missing file is reported where it is needed
                    self._stamps[file] = Stamp.of(file)
        self._lock = threading.RLock()
        self.width, self.height = dataset.width, dataset.height
        self._check_size()
        self._blocks = RasterBlocks.of(path, dataset)
        if not self._blocks.in_order:  # else it is decoded to its end where its margin is looked for
            self._read_last()
        self._display = Display.of(path, dataset, self._blocks.in_order, self._damage)
        self.notes += self._display.notes
        self._overviews = dataset.overviews(self._display.bands[0])
        without = any(MaskFlags.all_valid not in flags for flags in dataset.mask_flag_enums)
        self._masked = self._display.masks and without
        self._scratch: Scratch | None = None
        self._read_from = dataset  # or, after the first read, a copy of it in blocks
        self._margin = margin_of(self.width, self.height, self._read)
        self.claimed = claim_of(dataset, projection)
        self.by_orthoscale = SCALE_TAG in dataset.tags()
        self.notes += of_image(dataset, self.claimed, other_claims(path, dataset, self.claimed))
        if self._margin is not None:
            self.notes.append(of_margin(self._margin))

    @classmethod
    def open(cls, path: str | Path) -> RasterSource:
        """Open an image: GeoTIFF, COG, JPEG, PNG, JPEG 2000, VRT, or whatever else this GDAL reads.

        Blocks along its sides are read too, because a truncated file often opens well.

        Raises InputError when the file is missing, a folder, empty, no image, damaged, or useless (no colour band,
        complex numbers, less than 32 px wide).
        """
        path = Path(path)
        if path.is_dir():
            raise InputError(f"{path} is a folder, not an image", "Name one image file inside it.")
        if not path.is_file():
            raise absent(path, "Check the path.")
        try:
            with path.open("rb") as file:
                empty = not file.read(1)
        except OSError as error:
            raise InputError(f"{path} cannot be read ({error.strerror})", "Check its permissions.") from error
        if empty:
            raise InputError(f"{path} is empty", "Export or download it again.")
        stamp = Stamp.of(path)
        with reading(path, "is not an image that GDAL can open", what_instead(path) or USE_ANOTHER):
            dataset = open_dataset(path)
        try:
            with reading(path, "is damaged", EXPORT_AGAIN):
                return cls(path, dataset, stamp)
        except BaseException:
            dataset.close()
            raise

    @staticmethod
    def check_name(out: Path) -> None:
        """Raise UsageError for a name that `write` would refuse."""
        if out.suffix.lower() not in (".tif", ".tiff"):
            raise UsageError(
                f"{out}: an orthophoto is written as GeoTIFF, and its name must say so", "Let it end in .tif or .tiff."
            )
        if not can_find(out.absolute()):  # as its temporary name is
            raise UsageError(f"{out}: {IN_UTF8}", "Choose another place.")

    @property
    def pictures(self) -> list[Picture]:
        """The one image, this source itself."""
        return [self]

    @property
    def picture_names(self) -> list[str]:
        """The one image's name."""
        return [self.name]

    def image_size(self, name: str) -> tuple[int, int]:
        """Width and height [px] of the one image, `name`."""
        return self.width, self.height

    @property
    def plan(self) -> RasterSource:
        """This source itself."""
        return self

    @property
    def posed(self) -> None:
        """None: an image by itself has no pose."""
        return None

    def from_above(self, place: np.ndarray) -> np.ndarray:
        """(N, 2) places of pixels (N, 2), x right and y up from the lower left corner [px, as if they were square]. If
        the picture shows the ground mirrored, that corner is in its first row, as in a copy in local metres."""
        up = place[:, 1] if self.claimed.mirrored else self.height - place[:, 1]
        return np.stack([place[:, 0], up], -1) * self._square

    def locate(self, point: str) -> Located:
        """The place of the pixel ``X,Y`` if pixels were square. A point cannot be off the ground here. Raises
        ValueError."""
        place = pixel(point, self.width, self.height, "a point of an orthophoto") * self._square
        return Located(place, READING_SD, np.zeros(2))

    @property
    def _square(self) -> np.ndarray:
        """(2,) width and height of a pixel, relative to a square one of the same area."""
        return square_pixels(self.claimed.aspect)

    @property
    def metric_already(self) -> str:
        """Why this image counts as metric, empty if it does not: it has georeferencing that can be trusted."""
        if not self.claimed.usable:
            return ""
        return f"its georeferencing says {self.claimed.gsd_m:.4g} m/px ({self.claimed.why})"

    def __enter__(self) -> RasterSource:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file. Also done at the end of a ``with`` block."""
        self._read_from.close()
        self._dataset.close()
        if self._scratch is not None:
            self._scratch.close()

    def content_hash(self) -> str:
        """SHA-256 of the file on disk, in hex; of a VRT, not of the files that it refers to. Raises InputError if one
        of its files was changed since it was opened: the hash would be that of data that was not used."""
        self._require_unchanged()
        digest = file_hash(self.path)
        self._require_unchanged()
        return digest

    def fingerprint(self) -> str:
        """Key of cached results for this image: of the content of all its files, sampled in large ones.

        Raises InputError if one was changed since it was opened: `read` may still give the former pixels.
        """
        self._require_unchanged()
        return fingerprint(self.files)

    def _require_unchanged(self) -> None:
        """Raise InputError if one of its files was changed since it was opened."""
        require_unchanged(self._stamps.values())

    def __reduce__(self) -> tuple:
        """Pickled as its path: another process opens it anew, once for all its tiles."""
        return _shared, (str(self.path.absolute()), self._stamps[self.path])

    # Reading

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """RGB uint8 (out_height, out_width, 3) of the window at (x, y) with `width` x `height` px, resampled.

        Shrinking averages (overviews are used where the file has them), enlarging is bicubic; pixels without data
        (nodata, alpha or mask, and the margin of a map sheet) are grey (114). Other depths than 8 bit are stretched,
        see `notes`.

        Raises ValueError for a window that is not inside the image, InputError when the file is damaged there.
        """
        if min(x, y) < 0 or x + width > self.width or y + height > self.height:
            raise ValueError(f"window {width} x {height} at ({x}, {y}) is not inside {self.width} x {self.height} px")
        if min(width, height, out_width, out_height) < 1:
            raise ValueError(f"empty window: {width} x {height} to {out_width} x {out_height} px")
        window, out = Window(x, y, width, height), (out_height, out_width)
        with self._lock:
            if self._needs_blocks:
                self._copy_into_blocks()
            rgb = self._read(window, out)
        if self._margin is not None:
            rgb = np.where(self._margin.at(window, out)[..., None], np.uint8(NO_DATA_GREY), rgb)
        return np.ascontiguousarray(rgb)

    def decoded_px(self, width: int, height: int, out_width: int, out_height: int) -> float:
        """How many pixels `read` decodes for such a window: fewer where an overview is coarse enough already."""
        shrink = min(width / out_width, height / out_height)
        factor = max([f for f in self._overviews if f <= shrink], default=1)
        return width * height / factor**2

    def _read(self, window: Window, out: tuple[int, int]) -> np.ndarray:
        """`read`, of a sheet's margin too."""
        shrinking = out[0] * out[1] < window.width * window.height
        resampling = Resampling.average if shrinking else Resampling.cubic
        (top, bottom), (left, right) = window.toranges()
        with self._damage(f"at x {left}..{right}, y {top}..{bottom}"):
            rgb = self._read_unmixed(window, out) if self._display.unmixed else self._shown(window, out, resampling)
            if self._masked:
                how = Resampling.average if shrinking else Resampling.nearest
                known = self._read_from.dataset_mask(window=window, out_shape=out, resampling=how)
                rgb = np.where((known >= 128)[..., None], rgb, np.uint8(NO_DATA_GREY))
            if self._blocks.written is not None:
                rgb = np.where(self._blocks.written_at(window, out)[..., None], rgb, np.uint8(NO_DATA_GREY))
        return np.broadcast_to(rgb, (*out, 3))

    def _shown(self, window: Window, out: tuple[int, int], resampling: Resampling) -> np.ndarray:
        """(*out, 3 or 1) uint8 of the window."""
        bands = self._display.bands
        shape = (len(bands), *out)
        return self._display.rgb(self._read_from.read(bands, window=window, out_shape=shape, resampling=resampling))

    def _read_unmixed(self, window: Window, out: tuple[int, int]) -> np.ndarray:
        """The same for values that GDAL must not resample: up to 4 x 4 pixels per result are averaged."""
        shape = min(window.height, 4 * out[0]), min(window.width, 4 * out[1])
        rgb = self._shown(window, shape, Resampling.nearest)
        if shape != out:
            shrinking = out[0] * out[1] < shape[0] * shape[1]
            rgb = cv2.resize(rgb, out[::-1], interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_CUBIC)
        return rgb.reshape(*out, -1)

    @property
    def _needs_blocks(self) -> bool:
        """Whether each window would be decoded from the image's top again, since it has no blocks and is too large for
        GDAL's cache."""
        return (
            self._blocks.in_order
            and self._read_from is self._dataset
            and self._decoded_size > settings()["GDAL_CACHEMAX"]
        )

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
                "Set TMPDIR to a folder with more room, or convert it to a tiled GeoTIFF.",
            )
        copy = scratch.folder / "blocks.tif"
        # Fast to write and to read; its georeferencing does not matter.
        nowhere = CopyGeoreference(None, Affine.identity(), "")
        with reading(self.path, "cannot be decoded into a temporary file", EXPORT_AGAIN):
            self._original.convert(copy, nowhere, compress="zstd", zstd_level=1, predictor=1)
        self._read_from = open_dataset(copy)
        self._scratch = scratch

    # Checks at opening

    def _check_size(self) -> None:
        dataset = self._dataset
        if dataset.count == 0:
            inside = "; ".join(dataset.subdatasets[:3])
            raise InputError(
                f"{self.path} has no bands" + (f", only subdatasets: {inside}" if inside else ""),
                "Export one image as GeoTIFF, for example with gdal_translate.",
            )
        if COMPLEX_INTEGERS in dataset.dtypes:  # which NumPy lacks; other complex numbers are refused where they count
            raise InputError(f"{self.path} holds {COMPLEX_INTEGERS} values", EXPORT_BITS)
        if min(self.width, self.height) < SMALLEST:
            raise InputError(
                f"{self.path} is only {self.width} x {self.height} px",
                f"No vehicle could be measured in it; an image needs at least {SMALLEST} px on each side.",
            )
        if max(self.width, self.height) > LONGEST_SIDE:
            raise InputError(f"{self.path} says that it is {self.width} x {self.height} px", EXPORT_AGAIN)
        if len(dataset.subdatasets) > 1:
            self.notes.append(Remark(INFO, f"{self.name} holds {len(dataset.subdatasets)} images; the first is read"))

    def _read_last(self) -> None:
        """Find damage without reading everything: decode the last block."""
        # One pixel decodes its whole block. For a whole PNG at once, GDAL would use code that tolerates truncation.
        with self._damage("at its end"):
            self._dataset.read(window=Window(self.width - 1, self.height - 1, 1, 1))

    def _damage(self, where: str) -> AbstractContextManager[None]:
        if self._dataset.driver == "VRT":  # it has no pixels of its own
            return reading(self.path, f"cannot be read {where}", OF_OTHERS)
        return reading(self.path, f"is damaged {where}", EXPORT_AGAIN)

    # Writing

    @property
    def _original(self) -> Original:
        return Original(self.path, self._dataset, self._display.palette is not None, self._lock)

    def place(self, metres_per_pixel: float, keep_origin: bool = False) -> CopyGeoreference:
        """The georeferencing that a copy of this scale gets: local metres, or the input's own place and direction."""
        return (kept_place if keep_origin else local_place)(self.claimed, self.height, metres_per_pixel)

    def write(
        self, path: Path, metres_per_pixel: float, place: Placement | None = None, cog: bool = False, said: str = ""
    ) -> None:
        """Write a GeoTIFF with the same pixels and the measured scale.

        A TIFF of one image is copied, and only its georeferencing is replaced. Anything else is written losslessly
        (deflate, tiles, BigTIFF if needed); of several images only the first. Bands, type, nodata, alpha, mask,
        palette, tags and overviews stay. Former georeferencing, ground control points and rational polynomials do not;
        `notes` says so.
        The result is read back and compared with the original: all of it up to 100 Mpx, else 64 windows.

        path : where to write; an existing file is replaced. Use `orthoscale.system.outputs` around it.
        metres_per_pixel : [m/px] the measured scale.
        place : the georeferencing that it gets; by default local metres, north up, origin at the lower left corner.
        cog : write a cloud-optimised GeoTIFF (lossless, deflate), with overviews.
        said : a line on the scale for whoever gets the file without its report: its metadata ORTHOSCALE_SCALE.

        Raises UsageError for a scale that is not a positive number or a path not named .tif or .tiff; InputError if the
        input turns out to be damaged, or was changed since it was opened; OutputError if the copy cannot be written or
        does not read back the same.
        """
        path = Path(path)
        if not (math.isfinite(metres_per_pixel) and metres_per_pixel > 0):
            raise UsageError(f"a scale of {metres_per_pixel} m/px makes no sense", "It must be a positive number.")
        self.check_name(path)
        if path.exists() and path.samefile(self.path):
            raise UsageError(f"{path} is the input itself", "Choose another name for the output.")
        place = place or self.place(metres_per_pixel)
        original = self._original
        self._require_unchanged()
        original.write(path, place, cog, said)
        self._require_unchanged()
        self.notes += [note for note in informing(of_copy(path.name, original, place, cog)) if note not in self.notes]


@lru_cache(maxsize=4)
def _shared(path: str, stamp: Stamp) -> RasterSource:
    """The image at `path`. Raises InputError if its content is not that of `stamp`."""
    source = RasterSource.open(path)
    if not source._stamps[source.path].same_elsewhere(stamp):
        source.close()
        raise another(source.path)
    return source
