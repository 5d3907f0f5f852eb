"""Cache of the detections in tiles: an interrupted sweep continues where it was, a repeated one needs no detection."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..core.boxes import Boxes
from ..core.detections import Tile
from ..core.source import Picture
from ..formats.names import in_utf8
from .detector import CUT, OVERLAP, Detector
from .tiles import CONFIRMING_ZOOM, TILE, Looks

BROKEN = (sqlite3.Error, UnicodeDecodeError)  # what a damaged file raises; SQLite's message may quote its bytes
KEPT_SECONDS = 90 * 86_400.0  # [s] caches that nobody used for so long are deleted
PACKAGE = Path(__file__).parent.parent
RASTER_CODE = ("sources/gdal.py", "sources/raster*.py")  # on which the pixels of a raster depend
# Files of detect/ on which it depends what is seen in a tile, or measured of a vehicle: `tiles`, `measurer`, and what
# they import.
LOOKING = (
    "decoders",
    "detector",
    "enlarged",
    "filled",
    "foreign",
    "foreign_worker",
    "measurer",
    "order",
    "output_forms",
    "shade",
    "tiles",
)
CODE = (
    "core/angles.py",
    "core/boxes.py",
    "core/source.py",  # the grey of pixels without data
    *(f"detect/{name}.py" for name in LOOKING),
    *RASTER_CODE,
    "sources/picture_file.py",
    "sources/ground_picture.py",
)


def cache_folder() -> Path:
    """The folder of the caches: ``ORTHOSCALE_CACHE``, or the user's cache folder."""
    if told := os.environ.get("ORTHOSCALE_CACHE"):
        return Path(told)
    from platformdirs import user_cache_path

    return user_cache_path("orthoscale", appauthor=False)


def cache_key(pictures: Sequence[Picture], detector: Detector, zoom: float) -> str | None:
    """SHA-256 over the pictures' content and all else that the boxes found in them depend on; None if a picture has no
    fingerprint of its content."""
    detectors = [detector, detector.confirming] if detector.confirming else [detector]
    settings = {
        "detector": [[each.sha256, repr(each.card), repr(each.layout)] for each in detectors],
        "zoom": [zoom, CONFIRMING_ZOOM],
        "passes": detector.passes,
        "tiles": [TILE, OVERLAP, CUT],
    }
    return content_key(pictures, settings)


def content_key(pictures: Sequence[Picture], settings: Mapping[str, Any], code: tuple[str, ...] = CODE) -> str | None:
    """SHA-256 over the pictures' content, `settings` as JSON, and the files of the package that match the patterns
    `code`; None if a picture has no fingerprint of its content."""
    prints = [getattr(picture, "fingerprint", None) for picture in pictures]
    if None in prints:
        return None
    content = [[picture.name, of()] for picture, of in zip(pictures, prints, strict=True) if of]
    return hashlib.sha256(json.dumps({"pictures": content, **settings, "code": code_hash(code)}).encode()).hexdigest()


@lru_cache
def code_hash(code: tuple[str, ...], package: Path = PACKAGE) -> str:
    """SHA-256 in hex over the files of `package` that match the patterns `code`."""
    digest = hashlib.sha256()
    for pattern in code:
        for path in sorted(package.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()


class Kept:
    """Results of looks at one input with one choice of settings, in an SQLite file that survives a kill at any time.

    Each result has a name and a checksum; a damaged one is computed again. A file that SQLite cannot read is replaced
    by a new one. If none can be written, or without a `key`, nothing is stored, and the work goes on without it.
    """

    def __init__(self, key: str | None, folder: Path | None = None):
        self._file: sqlite3.Connection | None = None
        if key is None:
            return
        folder = (folder or cache_folder()) / "tiles"
        self.path = folder / f"{key}.sqlite"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _forget_old(folder)
        except OSError:
            return
        try:
            self._file = _open(self.path)
        except BROKEN:
            self._begin_anew()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._close()

    def content(self, name: str) -> bytes | None:
        """What was stored under `name`; None if nothing was, or if the entry is damaged. Raises nothing."""
        if self._file is None:
            return None
        try:
            row = self._file.execute("SELECT content, checksum FROM looks WHERE tile = ?", (name,)).fetchone()
        except BROKEN:
            self._begin_anew()
            return None
        if row is None or not isinstance(row[0], bytes) or row[1] != _checksum(name, row[0]):
            return None
        return row[0]

    def keep(self, name: str, content: bytes) -> None:
        """Store `content` under `name`. Raises nothing: what cannot be written is computed again next time."""
        if self._file is None:
            return
        try:
            with self._file:
                row = (name, content, _checksum(name, content))
                self._file.execute("INSERT OR REPLACE INTO looks VALUES (?, ?, ?)", row)
        except BROKEN:  # such as a full disk
            self._close()

    def _begin_anew(self) -> None:
        self._close()
        try:
            for path in (self.path, *(self.path.with_name(self.path.name + end) for end in ("-wal", "-shm"))):
                path.unlink(missing_ok=True)
            self._file = _open(self.path)
        except (OSError, *BROKEN):
            self._file = None

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            with suppress(*BROKEN):
                file.close()


class TileCache(Kept):
    """The detections in tiles."""

    def get(self, picture: Picture, tile: Tile) -> Looks | None:
        """What was detected in `tile` before, or None. Raises nothing."""
        content = self.content(tile_name(picture, tile))
        return None if content is None else _looks(content)

    def put(self, picture: Picture, tile: Tile, looks: Looks) -> None:
        """Store what was detected in `tile`. Raises nothing."""
        self.keep(tile_name(picture, tile), _content(looks))


def _open(path: Path) -> sqlite3.Connection:
    file = sqlite3.connect(path, timeout=30)
    try:
        # A write-ahead log makes a commit per tile cheap; after a crash the last tiles may be missing, but none is half
        # stored.
        file.execute("PRAGMA journal_mode = WAL")
        file.execute("PRAGMA synchronous = NORMAL")
        columns = "tile TEXT PRIMARY KEY, content BLOB NOT NULL, checksum BLOB NOT NULL"
        file.execute(f"CREATE TABLE IF NOT EXISTS looks ({columns})")
        with suppress(PermissionError):  # another user's file, which can still be read
            os.utime(path)
    except BaseException:
        file.close()
        raise
    return file


@lru_cache
def _forget_old(folder: Path) -> None:
    """Delete the caches that nobody used for KEPT_SECONDS; once in a process, for there may be thousands to look at."""
    for path in folder.glob("*.sqlite"):
        with suppress(OSError):  # another user's file, or one that is gone meanwhile
            if time.time() - path.stat().st_mtime > KEPT_SECONDS:
                path.unlink()


def tile_name(picture: Picture, tile: Tile) -> str:
    """The key under which a look at `tile` is stored."""
    return f"{as_text(picture)}:{tile.x},{tile.y},{tile.width},{tile.height}"


def as_text(picture: Picture) -> str:
    """A picture's name in a form that SQLite can store: file names need not be UTF-8."""
    return in_utf8(picture.name)


def _checksum(name: str, content: bytes) -> bytes:
    """Checksum over the content and the name that it belongs to."""
    return hashlib.blake2b(content, digest_size=16, key=hashlib.sha256(name.encode()).digest()).digest()


def _content(looks: Looks) -> bytes:
    """Serialised: one line of JSON, (kind, fine boxes, coarse boxes) for each kind, then six numbers per box."""
    parts = [("", looks.fine, looks.coarse), *((kind, *pair) for kind, pair in looks.objects.items())]
    head = json.dumps([(kind, len(fine), len(coarse)) for kind, fine, coarse in parts])
    rows = [np.column_stack([boxes.xylwa, boxes.score]) for _, *pair in parts for boxes in pair]
    return head.encode() + b"\n" + np.concatenate(rows).astype("<f8").tobytes()


def _looks(content: bytes) -> Looks:
    head, _, body = content.partition(b"\n")
    rows = np.frombuffer(body, "<f8").reshape(-1, 6)
    pairs, at = {}, 0
    for kind, *counts in json.loads(head):
        boxes = []
        for count in counts:
            boxes.append(Boxes(rows[at : at + count, :5], rows[at : at + count, 5]))
            at += count
        pairs[kind] = (boxes[0], boxes[1])
    fine, coarse = pairs.pop("")
    return Looks(fine, coarse, pairs)
