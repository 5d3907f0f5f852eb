"""Temporary folders of the running program. Those of a killed run are removed by the next one."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import weakref
from pathlib import Path
from typing import BinaryIO

if sys.platform != "win32":  # Windows does not delete open files, which serves as a lock
    import fcntl

PREFIX = "orthoscale-scratch-"
IN_USE = "in-use"


class Scratch:
    """A new folder in the system's temporary folder (``TMPDIR``). It is removed with this object, at exit or, after a
    kill, when the next one is made. Its lock is held while it is in use, so that it is not taken for a leftover."""

    def __init__(self) -> None:
        _remove_leftovers(Path(tempfile.gettempdir()))
        self.folder, lock = _new()
        self._end = weakref.finalize(self, _remove, self.folder, lock)

    def close(self) -> None:
        """Remove the folder now."""
        self._end()


def _new() -> tuple[Path, BinaryIO]:
    """A new folder and its lock, which this process holds."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        lock = (folder / IN_USE).open("wb")
        if _locked(lock) is not False and (folder / IN_USE).exists():
            return folder, lock
        lock.close()  # before it was locked, another run took it for a leftover


def _remove(folder: Path, lock: BinaryIO) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    lock.close()


def _locked(lock: BinaryIO) -> bool | None:
    """Whether this process could take the lock; False if another holds it, None if the file system has no locks."""
    if sys.platform != "win32":
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            return None
    return True


def _remove_leftovers(parent: Path) -> None:
    for folder in parent.glob(f"{PREFIX}*"):
        try:
            if hasattr(os, "getuid") and folder.lstat().st_uid != os.getuid():
                continue
            lock = (folder / IN_USE).open("rb")
        except OSError:  # gone meanwhile, or just being made
            continue
        if _locked(lock):
            _remove(folder, lock)
        else:
            lock.close()
