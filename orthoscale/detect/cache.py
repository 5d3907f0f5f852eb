"""Looks that were had before: a sweep that was killed goes on where it stopped, a second run is over at once."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import numpy as np

from ..core.boxes import Boxes
from ..core.detections import Tile
from ..core.source import Picture
from .detector import OVERLAP, Detector
from .tiles import CONFIRMING_ZOOM, TILE, TILE_BORDER, Looks

Look = TypeVar("Look")
KEPT_SECONDS = 90 * 86_400.0  # [s] caches that nobody used for so long are deleted
CODE = ("boxes.py", "detect/*.py", "sources/raster.py", "sources/picture_file.py")  # what decides over the looks
NO_MATTER = {"cache.py", "find.py", "order.py", "promise.py", "sweep.py", "workers.py", "zoom.py"}  # what does not


def cache_folder() -> Path:
    """Where caches lie: ``ORTHOSCALE_CACHE``, or the user's cache folder."""
    if told := os.environ.get("ORTHOSCALE_CACHE"):
        return Path(told)
    from platformdirs import user_cache_path

    return user_cache_path("orthoscale", appauthor=False)


def cache_key(pictures: Sequence[Picture], detector: Detector, zoom: float) -> str | None:
    """The `key_of` all that decides over the boxes found in `pictures`."""
    settings = {
        "detector": [detector.sha256, repr(detector.card), repr(detector.layout)],
        "zoom": [zoom, CONFIRMING_ZOOM],
        "tiles": [TILE, OVERLAP, TILE_BORDER],
    }
    return key_of(pictures, settings, CODE)


def key_of(pictures: Sequence[Picture], settings: Mapping[str, Any], code: tuple[str, ...]) -> str | None:
    """SHA-256 over the pictures' content, `settings` as JSON, and the files of the package that match the patterns
    `code`; None when a picture cannot say what its content is."""
    prints = [getattr(picture, "fingerprint", None) for picture in pictures]
    if None in prints:
        return None
    shown = [[picture.name, of()] for picture, of in zip(pictures, prints, strict=True) if of]
    everything = {"pictures": shown, **settings, "code": _code_hash(code)}
    return hashlib.sha256(json.dumps(everything).encode()).hexdigest()


@lru_cache
def _code_hash(code: tuple[str, ...]) -> str:
    package = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for pattern in code:
        for path in sorted(package.glob(pattern)):
            if path.name not in NO_MATTER:
                digest.update(path.read_bytes())
    return digest.hexdigest()


class Kept(ABC, Generic[Look]):
    """The looks at tiles of one input with one choice of settings, in an SQLite file that survives a kill at any time.

    Each look carries a checksum: what is damaged is looked at again. A file that SQLite cannot read is begun anew;
    where none can be written, nothing is kept, and the sweep does not suffer.
    """

    @staticmethod
    @abstractmethod
    def encode(look: Look) -> bytes:
        """What a look gave as bytes."""

    @staticmethod
    @abstractmethod
    def decode(content: bytes) -> Look:
        """What `encode` made bytes of."""

    def __init__(self, key: str, folder: Path | None = None):
        folder = (folder or cache_folder()) / "tiles"
        self.path = folder / f"{key}.sqlite"
        self._file: sqlite3.Connection | None = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _forget_old(folder)
        except OSError:
            return
        try:
            self._file = _open(self.path)
        except sqlite3.Error:
            self._begin_anew()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._close()

    def get(self, picture: Picture, tile: Tile) -> Look | None:
        """What was seen of `tile` before, or None: never looked at, or the entry is damaged. Raises nothing."""
        if self._file is None:
            return None
        name = _name(picture, tile)
        try:
            row = self._file.execute("SELECT content, checksum FROM looks WHERE tile = ?", (name,)).fetchone()
        except sqlite3.Error:
            self._begin_anew()
            return None
        if row is None or not isinstance(row[0], bytes) or row[1] != _checksum(name, row[0]):
            return None
        return self.decode(row[0])

    def put(self, picture: Picture, tile: Tile, looks: Look) -> None:
        """Keep what was seen of `tile`. Raises nothing: what cannot be written is looked at again next time."""
        if self._file is None:
            return
        name, content = _name(picture, tile), self.encode(looks)
        try:
            with self._file:
                row = (name, content, _checksum(name, content))
                self._file.execute("INSERT OR REPLACE INTO looks VALUES (?, ?, ?)", row)
        except sqlite3.Error:  # a full disk: what cannot be kept is looked at again another time
            self._close()

    def _begin_anew(self) -> None:
        self._close()
        try:
            for path in (self.path, *(self.path.with_name(self.path.name + end) for end in ("-wal", "-shm"))):
                path.unlink(missing_ok=True)
            self._file = _open(self.path)
        except (OSError, sqlite3.Error):
            self._file = None

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            with suppress(sqlite3.Error):
                file.close()


def _open(path: Path) -> sqlite3.Connection:
    file = sqlite3.connect(path, timeout=30)
    try:
        # A write-ahead log makes a commit per tile cheap; after a crash the last ones may be missing, never half there.
        file.execute("PRAGMA journal_mode = WAL")
        file.execute("PRAGMA synchronous = NORMAL")
        columns = "tile TEXT PRIMARY KEY, content BLOB NOT NULL, checksum BLOB NOT NULL"
        file.execute(f"CREATE TABLE IF NOT EXISTS looks ({columns})")
        os.utime(path)
    except BaseException:
        file.close()
        raise
    return file


def _forget_old(folder: Path) -> None:
    for path in folder.glob("*.sqlite"):
        if time.time() - path.stat().st_mtime > KEPT_SECONDS:
            path.unlink(missing_ok=True)


def _name(picture: Picture, tile: Tile) -> str:
    name = picture.name.encode(errors="backslashreplace").decode()  # file names need not be UTF-8; SQLite's text must
    return f"{name}:{tile.x},{tile.y},{tile.width},{tile.height}"


def _checksum(name: str, content: bytes) -> bytes:
    """Of one look and the tile that it belongs to."""
    return hashlib.blake2b(content, digest_size=16, key=hashlib.sha256(name.encode()).digest()).digest()


class TileCache(Kept[Looks]):
    """Vehicles that were seen in tiles."""

    @staticmethod
    def encode(look: Looks) -> bytes:
        """One line of JSON that says whose boxes follow, and how many, then six numbers a box."""
        return _content(look)

    @staticmethod
    def decode(content: bytes) -> Looks:
        """The looks that `encode` made bytes of."""
        return _looks(content)


def _content(looks: Looks) -> bytes:
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
