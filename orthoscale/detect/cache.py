"""Looks that were had before: a sweep that was killed goes on where it stopped, a second run is over at once."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..boxes import Boxes
from ..sources.picture import Picture
from .detector import Detector
from .tiles import BORDER, CONFIRMING_ZOOM, OVERLAP, TILE, Looks, Tile

KEPT = 90 * 86_400.0  # [s] caches that nobody used for so long are deleted
CODE = ("boxes.py", "detect/*.py", "sources/raster.py", "sources/picture_file.py")  # what decides over the looks
NO_MATTER = {"cache.py", "find.py", "order.py", "promise.py", "sweep.py", "workers.py", "zoom.py"}  # what does not


def cache_folder() -> Path:
    """Where caches lie: ``ORTHOSCALE_CACHE``, or the user's cache folder."""
    if told := os.environ.get("ORTHOSCALE_CACHE"):
        return Path(told)
    from platformdirs import user_cache_path

    return user_cache_path("orthoscale", appauthor=False)


def cache_key(pictures: Sequence[Picture], detector: Detector, zoom: float) -> str | None:
    """SHA-256 over the pictures' content and all that decides over the boxes found in them; None when a picture cannot
    say what its content is."""
    prints = [getattr(picture, "fingerprint", None) for picture in pictures]
    if None in prints:
        return None
    settings = {
        "pictures": [[picture.name, of()] for picture, of in zip(pictures, prints, strict=True) if of],
        "detector": [detector.sha256, repr(detector.card), repr(detector.layout)],
        "zoom": [zoom, CONFIRMING_ZOOM],
        "tiles": [TILE, OVERLAP, BORDER],
        "code": _code_hash(),
    }
    return hashlib.sha256(json.dumps(settings).encode()).hexdigest()


@lru_cache
def _code_hash() -> str:
    package = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for pattern in CODE:
        for path in sorted(package.glob(pattern)):
            if path.name not in NO_MATTER:
                digest.update(path.read_bytes())
    return digest.hexdigest()


class TileCache:
    """The looks at tiles of one input with one choice of settings, in an SQLite file that survives a kill at any time.

    A file that is damaged is begun anew; where none can be written, nothing is kept, and the sweep does not suffer.
    """

    def __init__(self, key: str, folder: Path | None = None):
        folder = (folder or cache_folder()) / "tiles"
        self.path = folder / f"{key}.sqlite"
        self._file: sqlite3.Connection | None = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _forget_old(folder)
            try:
                self._file = _open(self.path)
            except sqlite3.DatabaseError:
                self.path.unlink()
                self._file = _open(self.path)
        except (OSError, sqlite3.Error):
            self._file = None

    def __enter__(self) -> TileCache:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._file is not None:
            self._file.close()

    def get(self, picture: Picture, tile: Tile) -> Looks | None:
        if self._file is None:
            return None
        name = (_name(picture, tile),)
        row = self._file.execute("SELECT fine, coarse FROM looks WHERE tile = ?", name).fetchone()
        objects = self._file.execute("SELECT kind, fine, coarse FROM objects WHERE tile = ?", name).fetchall()
        if row is None:
            return None
        others = {kind: (_boxes(fine), _boxes(coarse)) for kind, fine, coarse in objects}
        return Looks(_boxes(row[0]), _boxes(row[1]), others)

    def put(self, picture: Picture, tile: Tile, looks: Looks) -> None:
        if self._file is None:
            return
        try:
            with self._file:
                row = (_name(picture, tile), _bytes(looks.fine), _bytes(looks.coarse))
                self._file.execute("INSERT OR REPLACE INTO looks VALUES (?, ?, ?)", row)
                for kind, pair in looks.objects.items():
                    more = (row[0], kind, *map(_bytes, pair))
                    self._file.execute("INSERT OR REPLACE INTO objects VALUES (?, ?, ?, ?)", more)
        except sqlite3.Error:  # a full disk: what cannot be kept is looked at again another time
            self._file.close()
            self._file = None


def _open(path: Path) -> sqlite3.Connection:
    file = sqlite3.connect(path, timeout=30)
    # A write-ahead log makes a commit per tile cheap; after a crash the last ones may be missing, never half there.
    file.execute("PRAGMA journal_mode = WAL")
    file.execute("PRAGMA synchronous = NORMAL")
    file.execute("CREATE TABLE IF NOT EXISTS looks (tile TEXT PRIMARY KEY, fine BLOB NOT NULL, coarse BLOB NOT NULL)")
    columns = "tile TEXT, kind TEXT, fine BLOB NOT NULL, coarse BLOB NOT NULL, PRIMARY KEY (tile, kind)"
    file.execute(f"CREATE TABLE IF NOT EXISTS objects ({columns})")
    os.utime(path)
    return file


def _forget_old(folder: Path) -> None:
    for path in folder.glob("*.sqlite"):
        if time.time() - path.stat().st_mtime > KEPT:
            path.unlink(missing_ok=True)


def _name(picture: Picture, tile: Tile) -> str:
    return f"{picture.name}:{tile.x},{tile.y},{tile.width},{tile.height}"


def _bytes(boxes: Boxes) -> bytes:
    return np.column_stack([boxes.xylwa, boxes.score]).astype("<f8").tobytes()


def _boxes(content: bytes) -> Boxes:
    rows = np.frombuffer(content, "<f8").reshape(-1, 6)
    return Boxes(rows[:, :5], rows[:, 5])
