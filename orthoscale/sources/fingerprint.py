"""Identifies files: by a hash of all their content for the report, by a quick fingerprint for cache keys, and by a
stamp within one run."""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from ..errors import InputError
from ..formats.reading import check_regular
from ..system.paths import absolute

WHOLE = 4 * 2**20  # [byte] files up to this size are read whole
PIECES, PIECE_BYTES = 64, 16 * 2**10  # number and size [byte] of the pieces that are read of larger files
TIME_STEP_NS = 2_000_000_000  # [ns] of the coarsest file system, FAT: two machines' times of a file may differ by it
MOVED = "Check its permissions, and whether it was moved meanwhile."  # of a file that cannot be read


class Stamp(NamedTuple):
    """Identifies the content of a file without reading it. path : absolute. inode : of its file system. changed : time
    of the last change [ns]. size : [byte]."""

    path: str
    inode: int
    changed: int
    size: int

    @classmethod
    def of(cls, path: Path) -> Stamp:
        """The stamp of the file as it is now. Raises InputError, also for a pipe."""
        check_regular(path, MOVED)  # opening a pipe would wait for its other end
        with _reading(path), path.open("rb") as file:  # a network drive has current values only for an open file
            there = os.fstat(file.fileno())
        return cls(str(absolute(path)), there.st_ino, there.st_mtime_ns, there.st_size)

    def same(self, other: Stamp) -> bool:
        """Whether the content is the same, by size and time; not by inode, which network drives make up."""
        return (self.size, self.changed) == (other.size, other.changed)

    def same_elsewhere(self, other: Stamp) -> bool:
        """Whether the content is the same on another machine, which may round times."""
        return self.size == other.size and abs(self.changed - other.changed) <= TIME_STEP_NS


def require_unchanged(stamps: Iterable[Stamp]) -> None:
    """Raise InputError if a file has changed since its stamp was taken, before it was read."""
    for stamp in stamps:
        if not Stamp.of(path := Path(stamp.path)).same(stamp):
            raise changed(path)


def changed(path: Path) -> InputError:
    """The error for a file whose content changed while it was in use."""
    return InputError(f"{path} was changed since it was opened", "Make sure that nothing writes it, and run again.")


def another(path: Path) -> InputError:
    """The error of a worker whose file is not the one that its task is about."""
    return InputError(
        f"{path} differs here from the file where the run was started, in size or time of change",
        "Give all machines the same files, with their times (cp -p, rsync -t), and make sure that nothing writes them.",
    )


def content_hash(paths: Iterable[Path]) -> str:
    """SHA-256 in hex over the names and the whole contents of the files, in this order. Raises InputError."""
    digest = hashlib.sha256()
    for path in paths:
        with _reading(path), path.open("rb") as file:
            digest.update(os.fsencode(path.name) + b"\0" + os.fstat(file.fileno()).st_size.to_bytes(8, "little"))
            hashlib.file_digest(file, lambda: digest)  # updates `digest`, without ever holding the whole file
    return digest.hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 in hex of the whole content of a file. Raises InputError."""
    with _reading(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def fingerprint(paths: Iterable[Path]) -> str:
    """SHA-256 in hex of the files' contents; for a file above 4 MiB, of its size, its time of change and 64 pieces.

    Names are not part of it, so a file that was moved keeps its fingerprint. Raises InputError.
    """
    digest = hashlib.sha256()
    for path in paths:
        with _reading(path), path.open("rb") as file:
            size = path.stat().st_size
            digest.update(f"{size};".encode())
            if size <= WHOLE:
                digest.update(file.read())
                continue
            digest.update(f"{path.stat().st_mtime_ns};".encode())
            for k in range(PIECES):
                file.seek(k * (size - PIECE_BYTES) // (PIECES - 1))
                digest.update(file.read(PIECE_BYTES))
    return digest.hexdigest()


def glance(path: Path) -> tuple[int, int]:
    """The size of a file [byte], and the CRC-32 of pieces at its start, in its middle and at its end: quick, and other
    for another picture of the same size, as uncompressed ones of one camera are. Raises InputError."""
    check_regular(path, MOVED)
    with _reading(path), path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        crc = 0
        for place in (0, size // 2, max(0, size - PIECE_BYTES)):
            file.seek(place)
            crc = zlib.crc32(file.read(PIECE_BYTES), crc)
        return size, crc


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})", MOVED) from error
