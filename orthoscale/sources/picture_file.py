"""The frames of a reconstruction: image files with the sizes that COLMAP recorded."""

from __future__ import annotations

import mmap
import struct
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from weakref import WeakValueDictionary

import cv2
import numpy as np

from ..errors import InputError
from ..formats.reading import refuse_pointer
from ..system import budget
from .fingerprint import Stamp, changed, fingerprint

LARGE_FRAME = 5e6  # [px] from which size on a frame is decoded no finer than needed
# Shares of the memory budget: what decoded pictures that are kept may take together; what those may take that threads
# use at once, where one that is made of another counts once; and from which size on one is used alone, and decoded in
# strips.
KEPT_SHARE, USED_SHARE, ALONE_SHARE = 1 / 8, 1 / 4, 1 / 16
STRIP = 256  # rows that are decoded at once
TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
ORIENTATION, TIFF_LONG = 0x0112, 4  # TIFF's and EXIF's tag of how a picture is turned; TIFF's type of 32 bits
JPEG, JPEG_SUFFIXES = b"\xff\xd8", (".jpg", ".jpeg")
REDUCED = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


@dataclass
class PictureFile:
    """A `Picture` in a JPEG, PNG or TIFF file of `width` x `height` px, decoded whole when it is first read.

    The EXIF orientation is ignored, as in COLMAP. The latest frames stay in memory, the others are dropped. A large one
    is kept at a half, a quarter or an eighth of its size if no more is needed; a JPEG is not decoded any finer.
    """

    name: str
    path: Path
    width: int
    height: int
    _keyed: Stamp | None = field(default=None, init=False, repr=False, compare=False)

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """See `Picture.read`. Raises InputError for a file that is truncated, undecodable, of another size, or larger
        than the memory budget allows."""
        with self.pixels(min(width // max(out_width, 1), height // max(out_height, 1))) as (pixels, factor):
            left, top, right, low = covering(x, y, width, height, factor)
            part = shrunk(pixels[top:low, left:right], factor, (x, y, width, height), out_width, out_height)
            return cv2.cvtColor(part, cv2.COLOR_BGR2RGB)

    @property
    def large(self) -> bool:
        """Whether it is decoded no finer than needed."""
        return self.width * self.height > LARGE_FRAME

    @property
    def _bytes(self) -> int:
        return 3 * self.width * self.height

    @contextmanager
    def pixels(self, shrink: int = 1) -> Iterator[tuple[np.ndarray, int]]:
        """The whole picture, BGR and read-only, for as long as the block lasts, and the factor by which it is reduced:
        1, or up to 8 for a large picture if it is needed at a `shrink`-th of its size only. Raises as `read`."""
        factor = next((f for f in (8, 4, 2) if f <= shrink), 1) if self.large else 1
        size = self._bytes // factor**2
        needs = size if self.path.suffix.lower() in JPEG_SUFFIXES else self._bytes
        with memory.holding((self.stamp(), factor), size, lambda: self._decoded(factor), needs) as pixels:
            yield pixels, factor

    def stamp(self) -> Stamp:
        """The stamp of its current content. Raises InputError, also if cached work is keyed by another content."""
        now = Stamp.of(self.path)
        if self._keyed is not None and not now.same_elsewhere(self._keyed):
            raise changed(self.path)
        return now

    def fingerprint(self) -> str:
        """Key of cached results for this frame. From now on its content must not change. Raises InputError."""
        self._keyed = self.stamp()
        return fingerprint([self.path])

    def check_size(self) -> None:
        """Raise InputError if the file's header has another size than this picture; pixels are not decoded."""
        size = stored_size(self.path)
        if size is not None:
            self._require(size)

    def _decoded(self, factor: int) -> np.ndarray:
        self.check_size()  # before memory is spent on it
        if self._bytes > ALONE_SHARE * budget.memory():
            if factor == 1 and (pixels := _in_strips(self.path)) is not None:
                return pixels
            whole = factor if _is_jpeg(self.path) else 1  # of other formats the whole is there twice
            budget.require(budget.LEAST_BYTES + 2 * self._bytes / whole**2, f"{self.path}")
        pixels = _decode(self.path, factor)
        size = pixels.shape[1], pixels.shape[0]
        if max(abs(size[0] - self.width / factor), abs(size[1] - self.height / factor)) >= 1:
            self._require(size)
        return pixels

    def _require(self, size: tuple[int, int]) -> None:
        if size == (self.width, self.height):
            return
        if size == (self.height, self.width):
            why = "It seems to have been rotated after COLMAP read it: give the folder of the unrotated images."
        elif abs(size[0] * self.height - size[1] * self.width) <= max(self.width, self.height, *size):
            why = "It seems to have been resized: give the images at the size COLMAP read, or undistort again."
        else:
            why = "Give the folder of the images that COLMAP read (undistorted ones for an undistorted model)."
        raise InputError(
            f"{self.path}: image is {size[0]} x {size[1]} px, but its camera {self.width} x {self.height} px", why
        )


def resized(window: np.ndarray, width: int, height: int) -> np.ndarray:
    """A copy of the pixels `window` (H, W, 3) at another size, as `Picture.read` promises."""
    if (width, height) == (window.shape[1], window.shape[0]):
        return window.copy()
    shrinks = width * height < window.shape[0] * window.shape[1]
    return cv2.resize(window, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)


def covering(x: int, y: int, width: int, height: int, factor: int) -> tuple[int, int, int, int]:
    """Left, top, right and lower end of the window in a picture that is reduced by `factor`, rounded outwards."""
    return x // factor, y // factor, -(-(x + width) // factor), -(-(y + height) // factor)


def shrunk(pixels: np.ndarray, factor: int, window: tuple[int, int, int, int], width: int, height: int) -> np.ndarray:
    """The `window` (x, y, width, height) of a picture, resampled to `width` x `height`, from `pixels` reduced by
    `factor` that cover it (`covering`). The window's exact ends may lie within one of these pixels."""
    if factor == 1:
        return resized(pixels, width, height)
    step = np.array(window[2:]) / (width, height) / factor
    first = np.array(window[:2]) % factor / factor + 0.5 * step - 0.5
    turn = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(
        pixels, np.column_stack([np.diag(step), first]), (width, height), flags=turn, borderMode=cv2.BORDER_REPLICATE
    )


class Memory:
    """Decoded pictures, the most recently used last; the first ones are dropped if all take more than KEPT_SHARE.

    Threads that want the same picture at once wait for the first of them to make it.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, np.ndarray] = OrderedDict()
        self._lock = threading.RLock()
        self._makers: WeakValueDictionary[Hashable, threading.RLock] = WeakValueDictionary()
        self._room = threading.Condition()
        self._used = 0.0  # [byte] taken by pictures in use
        self._mine = threading.local()

    @contextmanager
    def holding(self, key: Hashable, size: int, make: Callable[[], np.ndarray], needs: int = 0) -> Iterator[np.ndarray]:
        """The picture of `key`, stored or made by `make` [`size` bytes], which may hold another one. Waits until those
        that other threads hold leave room for it, or for what making it `needs` [byte]."""
        with self._room_for(max(size, needs)):
            yield self._get(key, size, make)

    @contextmanager
    def _room_for(self, size: int) -> Iterator[None]:
        if getattr(self._mine, "has_room", False):
            yield
            return
        most = USED_SHARE * budget.memory()
        taken = most if size > ALONE_SHARE * budget.memory() else min(size, most)
        with self._room:
            self._room.wait_for(lambda: self._used + taken <= most)
            self._used += taken
        self._mine.has_room = True
        try:
            yield
        finally:
            self._mine.has_room = False
            with self._room:
                self._used -= taken
                self._room.notify_all()

    def _get(self, key: Hashable, size: int, make: Callable[[], np.ndarray]) -> np.ndarray:
        with self._lock:
            maker = self._makers.setdefault(key, threading.RLock())
        with maker:
            with self._lock:
                if key in self._kept:
                    self._kept.move_to_end(key)
                    return self._kept[key]
                self._make_room(size)
            made = make()
            made.flags.writeable = False
            with self._lock:
                self._make_room(size)
                self._kept[key] = made
        return made

    def _make_room(self, size: int) -> None:
        while self._kept and sum(kept.nbytes for kept in self._kept.values()) + size > KEPT_SHARE * budget.memory():
            self._kept.popitem(last=False)


memory = Memory()


def _decode(path: Path, factor: int) -> np.ndarray:
    """BGR pixels of the file, reduced by `factor`: of a JPEG those of the decoder, of others means."""
    pixels = None
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            # OpenCV 4 silently fills the missing part of a truncated file with grey; 5 refuses it.
            if _is_complete(data):
                stored = _as_stored(data) if data[:4] in TIFFS else data
                is_jpeg = data[:2] == JPEG
                flag = REDUCED[factor] if is_jpeg else cv2.IMREAD_COLOR
                pixels = cv2.imdecode(np.frombuffer(stored, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
                if pixels is not None and not is_jpeg:
                    pixels = _reduced(pixels, factor)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check the file and its permissions.") from error
    except (ValueError, cv2.error):  # an empty file cannot be mapped
        pixels = None
    if pixels is None:
        refuse_pointer(path)
        raise InputError(f"{path}: image is truncated or cannot be decoded", "Copy it again from its original.")
    return pixels


def _reduced(pixels: np.ndarray, factor: int) -> np.ndarray:
    """The means of `factor` x `factor` pixels; the last ones of a row or column are repeated where they are fewer."""
    if factor == 1:
        return pixels
    height, width = pixels.shape[:2]
    filled = cv2.copyMakeBorder(pixels, 0, -height % factor, 0, -width % factor, cv2.BORDER_REPLICATE)
    return cv2.resize(filled, (filled.shape[1] // factor, filled.shape[0] // factor), interpolation=cv2.INTER_AREA)


def _as_stored(data: mmap.mmap) -> mmap.mmap | bytearray:
    """`data`, or a copy of a TIFF without the turn that its orientation asks for: OpenCV makes that whatever its flags
    say, and turns each tile of a tiled one."""
    with suppress(struct.error, OverflowError):  # a damaged file: the decoder will say so
        order, big = "<" if data[:2] == b"II" else ">", 43 in data[2:4]
        (start,) = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)
        (count,) = struct.unpack_from(order + ("Q" if big else "H"), data, start)
        entry, value = (20, 12) if big else (12, 8)  # [byte] size of an entry of the directory, and where its value is
        first = start + (8 if big else 2)
        for at in range(first, first + count * entry, entry):
            tag, kind = struct.unpack_from(order + "HH", data, at)
            if tag > ORIENTATION:
                break
            form = order + ("I" if kind == TIFF_LONG else "H")
            if tag == ORIENTATION and struct.unpack_from(form, data, at + value) != (1,):
                upright = bytearray(data)
                struct.pack_into(form, upright, at + value, 1)
                return upright
    return data


def _in_strips(path: Path) -> np.ndarray | None:
    """BGR pixels of a plain JPEG or PNG, decoded by GDAL some rows at a time; None for other kinds of files."""
    from rasterio.enums import ColorInterp
    from rasterio.windows import Window

    from .gdal import GDAL_ERRORS, guarded, open_dataset

    driver = "JPEG" if _is_jpeg(path) else "PNG"
    try:
        with path.open("rb") as data, mmap.mmap(data.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if not _is_complete(content):
                return None
        with guarded(GDAL_ALLOW_LARGE_LIBJPEG_MEM_ALLOC=True), open_dataset(path, driver) as file:
            if set(file.dtypes) != {"uint8"} or file.colorinterp[0] == ColorInterp.palette:
                return None
            budget.require(budget.LEAST_BYTES + 3 * file.width * file.height, f"{path}")
            pixels = np.empty((file.height, file.width, 3), np.uint8)
            bands = [3, 2, 1] if file.count >= 3 else [1, 1, 1]
            for top in range(0, file.height, STRIP):
                rows = min(STRIP, file.height - top)
                read = file.read(bands, window=Window(0, top, file.width, rows))
                pixels[top : top + rows] = read.transpose(1, 2, 0)
            return pixels
    except (*GDAL_ERRORS, ValueError):  # OpenCV will report it, or read the file
        return None


def _is_jpeg(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(2) == JPEG


def _is_complete(data: bytes | mmap.mmap) -> bool:
    """Whether a JPEG or PNG has its end marker; other formats are left to their decoder."""
    if data[:2] == JPEG:
        frame = _jpeg_marker(data, 0xDA)
        return frame is not None and data.find(b"\xff\xd9", frame) >= 0
    if data[:4] == b"\x89PNG":
        return b"IEND" in data[-65536:]
    return len(data) > 0


def stored_size(path: Path) -> tuple[int, int] | None:
    """(width, height) [px] from the header of an image, before any EXIF rotation; None for a header that is not
    understood. Raises InputError for a file that cannot be read."""
    try:
        with path.open("rb") as file:
            data = file.read(1 << 20)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check the file and its permissions.") from error
    if data.startswith(b"\x89PNG") and len(data) >= 24:
        return struct.unpack_from(">II", data, 16)
    if data.startswith(JPEG):
        frame = _jpeg_marker(data, 0xC0, 0xC1, 0xC2)
        if frame is not None and frame + 9 <= len(data):
            height, width = struct.unpack_from(">HH", data, frame + 5)
            return width, height
        return None
    return _told_by_gdal(path) if data[:4] in TIFFS else _told_by_pillow(path)


def _told_by_gdal(path: Path) -> tuple[int, int] | None:
    """Size of a TIFF, from its header; GDAL knows more kinds than Pillow."""
    from .gdal import GDAL_ERRORS, guarded, open_dataset

    try:
        with guarded(), open_dataset(path, "GTiff") as file:
            return file.width, file.height
    except GDAL_ERRORS:
        return None


def _told_by_pillow(path: Path) -> tuple[int, int] | None:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:  # of any size: nothing is decoded
                return image.size
    except Exception:  # for a damaged file Pillow's readers may raise anything
        return None


def _jpeg_marker(data: bytes | mmap.mmap, *wanted: int) -> int | None:
    """Where the first segment of a `wanted` kind starts. Others are skipped, with the thumbnails in them."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        if data[at + 1] in wanted:
            return at
        if data[at + 1] == 0xFF:  # padding
            at += 1
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None
