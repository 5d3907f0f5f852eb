"""Access to GDAL: within the memory limit, for local files only, with its errors as messages."""

from __future__ import annotations

import html
import os
import re
import stat
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import rasterio
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from ..errors import InputError
from ..formats.reading import read_bytes, refuse_pipes_beside
from ..system.budget import memory

# GDAL's own cache limit is 5 % of the machine's memory, and was seen to grow past a gigabyte. This one is in bytes:
# rasterio does not take a small number for megabytes, as GDAL does; 256 would be no cache at all, 5 to 100 times
# slower. PAM stays enabled, because GIS programs keep the georeferencing of a JPEG in .aux.xml; GDAL writes one only
# after statistics or properties were set, and nothing here does that to an input.
_CACHE = 256 * 2**20
# No file may make GDAL call a server, however deep the address is hidden (a VRT's source, an overview named in
# .aux.xml): all of GDAL's requests go to a proxy that does not exist, and no remote file is known to it.
_OFFLINE = {
    "GDAL_HTTP_PROXY": "127.0.0.1:9",
    "GDAL_HTTPS_PROXY": "127.0.0.1:9",
    "GDAL_HTTP_CONNECTTIMEOUT": "1",
    "GDAL_HTTP_TIMEOUT": "2",
    "GDAL_HTTP_MAX_RETRY": "0",
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "/vsicurl/none",
    "GDAL_VRT_ENABLE_PYTHON": "NO",
}
# Formats whose files name a server, or files anywhere.
_SERVED = frozenset(
    [
        "DAAS", "EEDA", "EEDAI", "ESRIC", "GTI", "HTTP", "KMLSUPEROVERLAY", "NGW", "OGCAPI", "PLMOSAIC", "Rasterlite",
        "STACIT", "STACTA", "TileDB", "WCS", "WFS", "WMS", "WMTS", "Zarr",
    ]
)  # fmt: skip
IN_UTF8 = "GDAL takes names in UTF-8 only, of files and of folders"
EXPORT_AGAIN = "Export or download it again; its transfer may have been cut off."
_LONGEST_VRT = 2**28  # [byte] of a VRT's text that is searched
GDAL_ERRORS = (RasterioError, CPLE_BaseError, OSError, UnicodeError)  # the last since its texts must be UTF-8


def settings() -> dict[str, Any]:
    """GDAL's settings while this package reads or writes."""
    return {"GDAL_CACHEMAX": min(_CACHE, memory() // 4), "GDAL_TIFF_INTERNAL_MASK": True, **_OFFLINE}


@cache
def _local_drivers() -> list[str]:
    """GDAL's formats whose files hold their own pixels, or name the files that do."""
    with rasterio.Env() as env:
        return [name for name in env.drivers() if name not in _SERVED]


def open_dataset(path: Path, *formats: str, **options: Any) -> DatasetReader:
    """Open a file on this machine with GDAL. Call it, and use the result, within `guarded`, so that it calls no server.

    formats : GDAL's names of the formats that are allowed, by default all whose files are local. options : of the
    format. Raises InputError for a file that names a pipe or device, or has one beside it; GDAL's errors for one that
    it cannot open.
    """
    _require_files(path)
    return DatasetReader(path, driver=list(formats) or _local_drivers(), sharing=False, **options)


def _require_files(path: Path) -> None:
    """Raises InputError if `path` is a VRT that names a pipe or device, itself or by other VRTs, and for one beside it
    that GDAL would read with it: it would wait for it forever."""
    waiting, seen = [path.absolute()], set()
    while waiting:
        vrt = waiting.pop()
        if vrt in seen:
            continue
        seen.add(vrt)
        if not _is_vrt(vrt):
            continue
        with vrt.open("rb") as file:
            text = file.read(_LONGEST_VRT).decode(errors="replace")
        for word in re.findall(r">\s*([^<>]+?)\s*<|\"([^\"]+)\"", text):
            named = html.unescape(word[0] or word[1])
            inner = re.sub(r"^(/vsi\w+/)+", "/", named)
            for place in (Path(inner), vrt.parent / named):
                try:
                    mode = (vrt.parent / place).stat().st_mode
                except (OSError, ValueError):  # no file of that name
                    continue
                if stat.S_ISREG(mode):
                    waiting.append(vrt.parent / place)
                elif not stat.S_ISDIR(mode):
                    raise InputError(f"{path} names {named!r}, which is a pipe or device", "Name files of pixels.")
    refuse_pipes_beside(seen)


def world_files(path: Path) -> tuple[str, ...]:
    """Names of the world files that GDAL reads beside the picture `path`."""
    ending = path.suffix[1:]
    world = f"{ending[:1]}{ending[-1:]}w", f"{ending}w", "wld"
    return tuple(f"{path.stem}.{end}" for each in world for end in (each.lower(), each.upper()))


def beside(path: Path) -> tuple[str, ...]:
    """Names of the files that GDAL reads together with the picture `path`."""
    return *(f"{path.name}{ending}" for ending in (".aux.xml", ".ovr", ".msk")), *world_files(path)


def _is_vrt(path: Path) -> bool:
    with path.open("rb") as file:
        return b"<VRTDataset" in file.read(4096)


def files_of(dataset: DatasetReader) -> list[Path]:
    """The files that `dataset` is read from, its own first; GDAL itself does not name those of a VRT in a VRT. Within
    `guarded`."""
    found = dict.fromkeys(map(Path, dataset.files))
    waiting = [*found][1:] if dataset.driver == "VRT" else []
    while waiting:
        with suppress(*GDAL_ERRORS, InputError):  # what is missing or damaged is reported where it is needed
            if _is_vrt(path := waiting.pop()):
                with open_dataset(path) as part:
                    more = [each for each in map(Path, part.files) if each not in found]
                found |= dict.fromkeys(more)
                waiting += more
    return [*found]


def projection_file(picture: Path) -> Path | None:
    """The ``.prj`` beside a picture, where mapping programs write the coordinate reference system of its world file and
    which GDAL reads only for other formats. None if there is none."""
    places = (picture.with_suffix(suffix) for suffix in (".prj", ".PRJ"))
    return next((place for place in places if place.is_file()), None)


def read_projection(path: Path) -> CRS:
    """The coordinate reference system in a ``.prj``, WKT of ESRI or OGC; within `guarded`. Raises InputError."""
    hint = "Export it again."
    try:
        return CRS.from_wkt(read_bytes(path, hint).decode("utf-8-sig", "replace"), morph_from_esri_dialect=True)
    except CRSError as error:
        raise InputError(f"{path}: no coordinate reference system in WKT", hint) from error


@contextmanager
def guarded(**options: Any) -> Iterator[None]:
    """GDAL within its memory limit and offline; `options` are more of its settings."""
    with rasterio.Env(**settings(), **options), warnings.catch_warnings():
        # Images without georeferencing are normal here.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def can_find(path: Path) -> bool:
    """Whether GDAL finds the file at `path`: it takes names in UTF-8, even where the system's are in another encoding,
    such as ISO-8859-1."""
    try:
        return os.fsencode(path) == str(path).encode()
    except UnicodeEncodeError:
        return False


@contextmanager
def reading(path: Path, what: str, hint: str) -> Iterator[None]:
    """`guarded`; an error of GDAL becomes ``InputError(path what (reason), hint)``."""
    try:
        with guarded():
            yield
    except GDAL_ERRORS as error:
        if not can_find(path):
            raise InputError(f"{path}: {IN_UTF8}", "Rename it.") from error
        raise InputError(f"{path} {what} ({reason(error)})", hint) from error


def reason(error: BaseException) -> str:
    """GDAL's message, without its advice to programmers and the file's name, which the reader gets anyway. rasterio
    often keeps the message in the cause and says only "see previous exception"."""
    if isinstance(error, OSError) and error.strerror:  # Python's own, whose text has names of temporary files
        return error.strerror
    text = str(error.__cause__ or error).strip().rstrip(".")
    text = re.sub(r"^'.*' (not recognized as being in a supported file format).*", r"\1", text, flags=re.DOTALL)
    return re.sub(r" \(this error can be turned as a warning.*?\)", "", text)
