"""The place of one output: it is locked against other runs, and filled at the end from a scratch folder beside it."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import OutputError, UsageError
from .signatures import sign_file, sign_folder, signature, why_not_ours
from .untouched import inside

fcntl: Any
try:
    import fcntl
except ImportError:  # not POSIX
    fcntl = None

FLUSHED = os.O_RDWR if os.name == "nt" else os.O_RDONLY  # mode in which a file, perhaps read-only, is opened to flush
SCRATCH = ".partial"  # ending of the scratch folder beside an output
LOCK, NEW, FORMER = "lock", "new", "former"  # names in the scratch folder

NOREPLACE, EXCHANGE = 1, 2  # flags of renameat2(2)
_AT_FDCWD = -100
_NOT_HERE = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)  # no renameat2, or not on this file system
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)  # some network drives have no locks


class Reserved:
    """One output: its place, locked against other runs, and a scratch folder beside it.

    before : identity of what will be replaced, None if nothing is there. metres : whether a folder's files are scaled
    to metres, for its mark.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.retired = self.failed = self.metres = False
        self.scratch = path.absolute().parent / f".{signature(path).replace(' ', '-')}{SCRATCH}"
        with writing(path):
            self._lock = _locked(self.scratch, path)
            self.partial, self._former = self.scratch / NEW / path.name, self.scratch / FORMER / path.name
            try:
                if self._former.exists() and not os.path.lexists(path):  # a killed run had just put it aside
                    os.rename(self._former, path)
                self._clear()
                self.before = identity(path)
                self.partial.parent.mkdir()
            except BaseException:
                self.release()
                raise

    @property
    def in_another(self) -> bool:
        """Whether it lies in the scratch folder of another output."""
        folders = self.path.absolute().parents
        return any(folder.name == NEW and folder.parent.suffix == SCRATCH for folder in folders)

    def concerns(self, name: str | bytes) -> bool:
        """Whether the file `name`, from an error, belongs to this output."""
        return inside(Path(os.fsdecode(name)), self.scratch) or inside(Path(os.fsdecode(name)), self.path)

    def sign(self) -> None:
        """Sign what was written."""
        if self.partial.is_dir():
            sign_folder(self.partial, self.metres)
        else:
            sign_file(self.partial)

    def flush(self) -> None:
        """Wait until all is on the disk: a network drive reports only then that it is full, and a former output must
        not be replaced by files that a power failure could leave incomplete."""
        within = (Path(root) / name for root, _, files in os.walk(self.partial) for name in files)
        for path in within if self.partial.is_dir() else [self.partial]:
            if path.is_symlink():
                continue
            file = os.open(path, FLUSHED)
            try:
                os.fsync(file)
            finally:
                os.close(file)

    def place(self) -> None:
        """Move what was written into place; or remove what is there, if this output is retired or failed. Raises
        UsageError if the place was changed meanwhile."""
        if identity(self.path) != self.before or (self.path.is_dir() and why_not_ours(self.path)):
            raise UsageError(f"{self.path} was changed by somebody else meanwhile", "Check it, and run again.")
        if self.retired or self.failed:
            if self.before is not None:
                self._put_former_aside()
        elif self.before is None:
            _rename_to_new(self.partial, self.path)
        elif not _renameat2(self.partial, self.path, EXCHANGE):
            self._put_former_aside()
            try:
                os.rename(self.partial, self.path)
            except BaseException:
                os.rename(self._former, self.path)
                raise

    def undo(self) -> None:
        """Restore what was there before `place`."""
        if self._former.exists():
            if os.path.lexists(self.path):
                os.rename(self.path, self.partial)
            os.rename(self._former, self.path)
        elif self.before is None:
            if not self.failed:
                os.rename(self.path, self.partial)
        else:
            _renameat2(self.partial, self.path, EXCHANGE)

    def release(self) -> None:
        """Remove the scratch folder, the lock last."""
        with suppress(OSError):
            self._clear()
            (self.scratch / LOCK).unlink()
            self.scratch.rmdir()
        os.close(self._lock)

    def _put_former_aside(self) -> None:
        self._former.parent.mkdir()
        os.rename(self.path, self._former)

    def _clear(self) -> None:
        """Empty the scratch folder, except for the lock."""
        for entry in os.scandir(self.scratch):
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            elif entry.name != LOCK:
                os.unlink(entry.path)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns an OSError in the block into an OutputError about `path`."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot write there ({error.strerror})", "Check permissions and space.") from error


def identity(path: Path) -> tuple[int, ...] | None:
    """Numbers that identify the file at `path` and its state; None if nothing is there."""
    try:
        found = os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size


def _locked(scratch: Path, path: Path) -> int:
    """Make the folder `scratch`, or take over that of a dead run; returns the descriptor of its lock, which the kernel
    releases when the process ends. Raises UsageError if another run holds it, or orthoscale did not make the folder."""
    busy = UsageError(f"{path} is being written by another run", "Wait for its end, or choose another place.")
    while True:
        made = True
        try:
            scratch.mkdir()
        except FileExistsError:
            made = False
            content = [] if scratch.is_symlink() or not scratch.is_dir() else os.listdir(scratch)
            if scratch.is_symlink() or not scratch.is_dir() or (content and LOCK not in content):
                raise UsageError(f"{scratch} is in the way", "orthoscale did not make it: move it away.") from None
        try:
            lock = os.open(scratch / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        except FileNotFoundError:  # the run that made the folder has just ended and removed it
            continue
        except OSError:
            with suppress(OSError):
                scratch.rmdir()
            raise
        try:
            if not _taken(lock, made):
                raise busy
            if os.path.samestat(os.fstat(lock), os.stat(scratch / LOCK)):
                return lock
        except FileNotFoundError:  # a run that has just ended removed the lock
            pass
        except OSError:
            os.close(lock)
            if made:
                with suppress(OSError):
                    (scratch / LOCK).unlink()
                    scratch.rmdir()
            raise
        except UsageError:
            os.close(lock)
            raise
        os.close(lock)


def _taken(lock: int, made: bool) -> bool:
    """Whether this run holds the lock now. On file systems without locks, the run that made the folder holds it."""
    if fcntl is None:
        return made
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return made
    return True


def _rename_to_new(partial: Path, path: Path) -> None:
    """Rename to a name that does not exist; raises UsageError if it does by now."""
    try:
        if _renameat2(partial, path, NOREPLACE):
            return
        # First reserve the name with an empty file or folder; this fails if it exists.
        path.mkdir() if partial.is_dir() else path.touch(exist_ok=False)
    except FileExistsError:
        raise UsageError(f"{path} was made by somebody else meanwhile", "Nothing was replaced.") from None
    try:
        os.replace(partial, path)
    except BaseException:
        path.rmdir() if path.is_dir() else path.unlink()
        raise


def _renameat2(source: Path, target: Path, flag: int) -> bool:
    """Linux's rename that replaces nothing, or exchanges both names atomically; False where it is not available."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    if rename(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), flag) == 0:
        return True
    code = ctypes.get_errno()
    if code in _NOT_HERE:
        return False
    raise OSError(code, os.strerror(code), str(target))
