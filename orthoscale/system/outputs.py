"""The transaction in which a command writes its outputs: all of them whole, or none, and never over an input.

Refused before any work is done: an output that is, contains or lies in an input, under whatever name; that belongs to
an input, as a world file does; that is also another output of the command; that another run is writing; or that exists,
unless it may be overwritten and orthoscale wrote it under this very name. Outputs are written to temporary names and
all of a command are renamed into place together: no file that appeared meanwhile is replaced, and on any error,
SIGTERM, SIGHUP and Ctrl-C included, everything is as it was. Leftovers of a killed run are removed by the next one.
"""

from __future__ import annotations

import csv
import ctypes
import errno
import hashlib
import json
import mmap
import os
import shutil
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from ..errors import LONGEST_MESSAGE, InputError, OrthoscaleError, OutputError, UsageError, shown
from ..version import __version__
from . import stopping

fcntl: Any
try:
    import fcntl
except ImportError:  # not POSIX
    fcntl = None

FOLDER_MARK = ".orthoscale.json"  # in every folder that orthoscale writes: what it is, and the files that it wrote
ELSEWHERE = "Choose another place, or delete it yourself."
DISK = (OSError, sqlite3.Error)  # what a disk that is full, gone or read-only raises
SCRATCH = ".partial"  # ending of the scratch folder beside an output
LOCK, NEW, FORMER = "lock", "new", "former"  # in that folder

# What GDAL reads beside a file: the file's name and this, or its stem and this. World files come on top.
BESIDE_NAME = (".aux.xml", ".ovr", ".msk", ".xml", "-wal", "-shm", "-journal")
BESIDE_STEM = (".aux.xml", ".aux", ".rrd", ".prj", ".qpj", ".rpb", "_rpc.txt", ".imd", ".tab", ".wld", ".shx", ".dbf",
               ".cpg", ".sbn", ".sbx")  # fmt: skip

NOREPLACE, EXCHANGE = 1, 2  # flags of renameat2(2)
_AT_FDCWD = -100
_NOT_HERE = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)  # no renameat2, or not on this file system
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)  # some network drives have none


def signature(path: str | Path) -> str:
    """What a file that orthoscale writes has somewhere inside: its own name's hash, so that a copy elsewhere, on which
    somebody works on, does not pass for it."""
    name = os.fsencode(Path(path).name)
    return "orthoscale output " + hashlib.blake2b(name, digest_size=8).hexdigest()


LONGEST_CSV_HEADER = 10_000  # [characters] of a table's first line


def ours(path: Path) -> bool:
    """Whether orthoscale wrote `path`, a file or a folder with nothing else in it."""
    return not _why_not_ours(path)


def ours_in_a_folder(path: Path) -> bool:
    """Whether orthoscale wrote `path`, alone or together with the folder that it lies in."""
    return ours(path) or (path.is_file() and path.name in (_listed(path.absolute().parent) or ()))


def existing(given: str | Path | None | Sequence) -> list[Path]:
    """The files and folders among `given`, a path, None or a list of such, that exist: a command's inputs."""
    if isinstance(given, (str, Path)):
        return [Path(given)] if os.path.lexists(given) else []
    assert given is None or isinstance(given, (list, tuple)), "an input that is overlooked is not protected"
    return [path for one in given or () for path in existing(one)]


def has_header(path: Path, columns: Iterable[str]) -> bool:
    """Whether `path` is a table with just these columns: how a CSV, which has no room for a signature, is known."""
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        return next(csv.reader([file.readline(LONGEST_CSV_HEADER)]), []) == list(columns)


class Outputs:
    """The outputs of one command, as a context: in their places at its end, or on an error as if it had not run.

    overwrite : replace what orthoscale wrote before. inputs : what `existing` takes. dry_run : only check the outputs,
    and leave all as it was.
    problems : what `attempt` could not write, by the reason.
    Raises UsageError for an output that is refused, OutputError for one that cannot be written. An OSError from the
    block becomes an InputError if it names a file that is none of the outputs, else an OutputError.
    """

    def __init__(
        self, overwrite: bool = False, inputs: str | Path | None | Sequence = (), dry_run: bool = False
    ) -> None:
        self.overwrite, self.dry_run = overwrite, dry_run
        self.problems: dict[str, list[str]] = {}
        self._inputs = existing(inputs)
        self._claims: list[_Reserved] = []

    def file(self, path: Path, mine: Callable[[Path], bool] | None = None) -> Path:
        """Where to write the file that is to be `path`; it has the same name.

        mine : whether the file that is there now is orthoscale's, for formats that have no room for a `signature`.
        JSON, HTML, PNG and GeoPackage files are signed at the end; writers of TIFF and text do it themselves.
        """
        return self._claim(path, mine, folder=False).partial

    def folder(self, path: Path) -> Path:
        """An empty folder to write what is to be in the folder `path`."""
        partial = self._claim(path, None, folder=True).partial
        with _writing(path):
            partial.mkdir()
        return partial

    def retire(self, path: Path, mine: Callable[[Path], bool] | None = None) -> None:
        """Remove at the end what orthoscale wrote at `path` and what would speak for the new output; others' stays."""
        if self.overwrite and os.path.lexists(path) and not _why_not_ours(path, mine):
            self._claim(path, mine, folder=path.is_dir()).retired = True

    def protect(self, *inputs: Path) -> None:
        """More inputs, found while opening those that were given. Raises UsageError."""
        for path in inputs:
            for claim in self._claims:
                _refuse_input(claim.path, path)

    @contextmanager
    def attempt(self, partial: Path, what: str) -> Iterator[None]:
        """Write `partial`, an output or a file in one. If that fails it is left out, said in `problems`, and the other
        outputs are delivered all the same."""
        try:
            yield
        except Exception as error:
            if isinstance(error, OrthoscaleError):
                why = self._named_by_place(error.message)
            else:
                why = (error.strerror if isinstance(error, OSError) else "") or f"{type(error).__name__}: {error}"
            self.problems.setdefault(why, []).append(what)
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            for claim in self._claims:
                claim.failed |= claim.partial == partial

    def missing(self) -> str:
        """What `attempt` could not write and why, as a part of a sentence; '' where all is there."""
        return "; ".join(f"{', '.join(names)} could not be written ({why})" for why, names in self.problems.items())

    @property
    def places(self) -> list[Path]:
        """Where the outputs are to be that were claimed, in that order."""
        return [claim.path for claim in self._claims if not claim.retired]

    def __enter__(self) -> Outputs:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None and not self.dry_run:
                self._put(self._claims)
            elif isinstance(error, OrthoscaleError):
                error.reword(self._named_by_place)
            elif isinstance(error, DISK):
                raise error
        except BrokenPipeError:
            raise
        except DISK as disk:
            raise self._said(disk) from disk
        finally:
            with stopping.held():
                for claim in self._claims:
                    claim.release()

    def _named_by_place(self, text: str) -> str:
        """`text` with the outputs that are not in their places yet named as the user named them."""
        for claim in self._claims:
            text = text.replace(shown(claim.partial, LONGEST_MESSAGE), shown(claim.path, LONGEST_MESSAGE))
        return text

    def _said(self, error: Exception) -> OrthoscaleError:
        """An error of a disk in our words: about an input, if it names a file that is none of the outputs."""
        name, reason = getattr(error, "filename", None), getattr(error, "strerror", None) or error
        if isinstance(name, (str, bytes)) and not any(claim.concerns(name) for claim in self._claims):
            return InputError(f"{os.fsdecode(name)}: cannot be read ({reason})", "Check the file and its permissions.")
        place = self._claims[0].path if self._claims else "the output"
        return OutputError(f"{place}: writing failed ({reason})", "Nothing was left behind.")

    def check(self, path: Path, mine: Callable[[Path], bool] | None = None) -> tuple[int, ...] | None:
        """Refuse early what `file` or `folder` would refuse; returns the identity of what is to be replaced, None where
        there is nothing. Raises UsageError, OutputError."""
        for given in self._inputs:
            _refuse_input(path, given)
        for other in self._claims:
            if _inside(path, other.path) or _inside(other.path, path):
                raise UsageError(f"{path} and {other.path} cannot both be outputs", "Give each a place of its own.")
        there = self._refuse_existing(path, mine)
        parent = path.absolute().parent
        if not parent.is_dir():
            raise OutputError(
                f"{path}: {parent} {'is not a folder' if parent.exists() else 'does not exist'}",
                "Create that folder first, or choose another place.",
            )
        return there

    def _refuse_existing(self, path: Path, mine: Callable[[Path], bool] | None) -> tuple[int, ...] | None:
        """Raise UsageError if something is at `path` that may not be replaced; returns its identity."""
        with _writing(path):
            there = _identity(path)
        if there is not None:
            if not self.overwrite:
                raise UsageError(f"{path} already exists", "Choose another place, or pass --overwrite to replace it.")
            if why := _why_not_ours(path, mine):
                raise UsageError(f"{path} {why}, so it is not replaced", ELSEWHERE)
        return there

    def _claim(self, path: Path, mine: Callable[[Path], bool] | None, folder: bool) -> _Reserved:
        path = Path(path)
        there = self.check(path, mine)
        with stopping.held():
            claim = _Reserved(path)
            self._claims.append(claim)
        if claim.before != there:  # another run ended just before the lock, or a killed one's former output came back
            self._refuse_existing(path, mine)
        if claim.before is not None and path.is_dir() != folder:
            kinds = ("file", "folder") if folder else ("folder", "file")
            raise UsageError(f"{path} is a {kinds[0]}, the output is a {kinds[1]}", ELSEWHERE)
        return claim

    def deliver(self, partial: Path) -> None:
        """Put the output written at `partial` in its place now, whatever becomes of the others."""
        (claim,) = (claim for claim in self._claims if claim.partial == partial)
        self._put([claim])
        with stopping.held():
            self._claims.remove(claim)
            claim.release()

    def _put(self, claims: list[_Reserved]) -> None:
        """In their places, all or none; the one claimed first, the main output, last."""
        written = [claim for claim in reversed(claims) if not (claim.retired or claim.failed)]
        for claim in written:
            claim.sign()
            claim.flush()
        stopping.check()
        # What would speak falsely for the new output goes when that is there.
        changes = [*written, *(claim for claim in claims if claim.retired or claim.failed)]
        done: list[_Reserved] = []
        with stopping.held():
            try:
                for claim in changes:
                    claim.place()
                    done.append(claim)
            except BaseException:
                for claim in reversed(done):
                    claim.undo()
                raise
            # What lies in another output's scratch folder goes with that, and is there when that is.
            stopping.written.extend(str(claim.path) for claim in written if not claim.in_another)


class _Reserved:
    """One output: its place, locked against other runs, and a scratch folder beside it.

    before : identity of what is to be replaced, None where there is nothing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.retired = self.failed = False
        self.scratch = path.absolute().parent / f".{signature(path).replace(' ', '-')}{SCRATCH}"
        with _writing(path):
            self._lock = _locked(self.scratch, path)
            self.partial, self._former = self.scratch / NEW / path.name, self.scratch / FORMER / path.name
            try:
                if self._former.exists() and not os.path.lexists(path):  # a killed run had just put it aside
                    os.rename(self._former, path)
                self._clear()
                self.before = _identity(path)
                self.partial.parent.mkdir()
            except BaseException:
                self.release()
                raise

    @property
    def in_another(self) -> bool:
        """Whether it is written as a part of another output, which is not in its place yet."""
        folders = self.path.absolute().parents
        return any(folder.name == NEW and folder.parent.suffix == SCRATCH for folder in folders)

    def concerns(self, name: str | bytes) -> bool:
        """Whether an error about the file `name` is one about this output."""
        return _inside(Path(os.fsdecode(name)), self.scratch) or _inside(Path(os.fsdecode(name)), self.path)

    def sign(self) -> None:
        if self.partial.is_dir():
            _sign_folder(self.partial)
        else:
            _sign_file(self.partial)

    def flush(self) -> None:
        """Wait until all is on the disk: only then a network drive says that it is full, and what takes the place of a
        former output is whole after a failure of the power."""
        inside = (Path(root) / name for root, _, files in os.walk(self.partial) for name in files)
        for path in inside if self.partial.is_dir() else [self.partial]:
            if path.is_symlink():
                continue
            file = os.open(path, os.O_RDWR)
            try:
                os.fsync(file)
            finally:
                os.close(file)

    def place(self) -> None:
        if _identity(self.path) != self.before or (self.path.is_dir() and _why_not_ours(self.path)):
            raise UsageError(f"{self.path} was changed by somebody else meanwhile", "Look at it, and run again.")
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
        """Empty the scratch folder but for the lock."""
        for entry in os.scandir(self.scratch):
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            elif entry.name != LOCK:
                os.unlink(entry.path)


# Inputs


def _refuse_input(out: Path, given: Path) -> None:
    """Raise UsageError if writing `out` could change the input `given`."""
    hint = "Inputs are never touched: choose another place."
    if _same(out, given):
        raise UsageError(f"{out} is the input {given}", hint)
    places_of_out, places_of_given = _places(out), _places(given)
    folder = os.path.realpath(out)
    if any(_within(place, folder) for place in places_of_given):
        raise UsageError(f"{out} contains the input {given}", hint)
    if given.is_dir():
        folder = os.path.realpath(given)
        if any(_within(place, folder) for place in places_of_out):
            raise UsageError(f"{out} lies in the input {given}", hint)
    else:
        for mine in places_of_out:
            for theirs in places_of_given:
                if os.path.dirname(mine) == os.path.dirname(theirs) and Path(mine).name.lower() in _sidecars(theirs):
                    raise UsageError(f"{out} would be taken for a part of the input {given}", hint)


def _places(path: Path) -> set[str]:
    """Where `path` leads, and where the name itself is, which a symbolic link keeps apart."""
    parent = os.path.realpath(path.absolute().parent)
    return {os.path.realpath(path), os.path.join(parent, path.name)}


def _same(one: Path, other: Path) -> bool:
    try:
        return bool(_places(one) & _places(other)) or os.path.samefile(one, other)
    except OSError:
        return False


def _within(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def _inside(path: Path, folder: Path) -> bool:
    return _within(os.path.realpath(path), os.path.realpath(folder)) or _same(path, folder)


def _sidecars(place: str) -> set[str]:
    """Names, in lower case, of what programs read together with the file `place`."""
    path = Path(place.lower())
    ending = path.suffix[1:]
    world = (f".{ending}w", f".{ending[0]}{ending[-1]}w") if ending else ()
    return {path.name + more for more in BESIDE_NAME} | {path.stem + more for more in (*BESIDE_STEM, *world)}


# Marks


def _why_not_ours(path: Path, mine: Callable[[Path], bool] | None = None) -> str:
    """Why `path` must not be replaced, as the end of a sentence; '' for what orthoscale wrote."""
    if path.is_symlink():
        return "is a symbolic link"
    if not (path.is_dir() or path.is_file()):
        return "is neither a file nor a folder"
    if path.is_dir():
        return _why_not_our_folder(path)
    try:
        known = mine(path) if mine else _signed(path)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return "" if known else "was not written by orthoscale under this name"


def _why_not_our_folder(folder: Path) -> str:
    files = _listed(folder)
    if files is None:
        return "was not written by orthoscale under this name"
    strangers = (name for name in _files_in(folder) if name not in files and not ours(folder / name))
    stranger = next(strangers, "")
    return f"holds {stranger}, which orthoscale did not write" if stranger else ""


def _listed(folder: Path) -> set[str] | None:
    """The files that the mark of `folder` lists; None where there is no mark for a folder of this name."""
    try:
        mark = json.loads((folder / FOLDER_MARK).read_text(encoding="utf-8"))
        return set(mark["files"]) if mark["written_by"] == signature(folder.absolute()) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _files_in(folder: Path) -> Iterator[str]:
    """Relative names of the files in `folder` but for its mark; a folder inside that is ours itself has none."""
    for root, folders, files in os.walk(folder):
        here = Path(root)
        links = [name for name in folders if (here / name).is_symlink()]
        for name in (*files, *links):
            if here != folder or name != FOLDER_MARK:
                yield (here / name).relative_to(folder).as_posix()
        folders[:] = [f for f in folders if not (here / f / FOLDER_MARK).is_file() or _why_not_ours(here / f)]


def _sign_folder(folder: Path) -> None:
    text = {"written_by": signature(folder), "version": __version__, "files": []}
    (folder / FOLDER_MARK).unlink(missing_ok=True)
    text["files"] = sorted(_files_in(folder))
    (folder / FOLDER_MARK).write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")


def _signed(path: Path) -> bool:
    with path.open("rb") as file:
        if not os.fstat(file.fileno()).st_size:
            return False
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return content.find(signature(path).encode()) >= 0


def _sign_file(path: Path) -> None:
    """Sign a file in the way of its format, which its first bytes tell: a JSON object, a page, a PNG, a GeoPackage."""
    text = signature(path)
    with path.open("r+b") as file:
        start = file.read(16).lstrip()
        if start.startswith(b"SQLite format 3"):
            _sign_geopackage(path, text)
        elif start.startswith(b"\x89PNG"):
            end = file.seek(-12, os.SEEK_END)  # before IEND
            last = file.read()
            file.seek(end)
            content = b"tEXtSoftware\0" + text.encode()
            crc = zlib.crc32(content).to_bytes(4, "big")
            file.write((len(content) - 4).to_bytes(4, "big") + content + crc + last)
        elif start.startswith(b"{"):
            tail = file.seek(max(-64, -os.fstat(file.fileno()).st_size), os.SEEK_END)
            tail += file.read().rindex(b"}")
            file.seek(tail)
            file.write(f', "written_by": "{text}"}}\n'.encode())
        elif start.startswith(b"<"):
            file.seek(0, os.SEEK_END)
            file.write(f"<!-- {text} -->\n".encode())


def _sign_geopackage(path: Path, text: str) -> None:
    """In the description of its first table, which is free text."""
    with closing(sqlite3.connect(path)) as file, file:
        file.execute(
            "UPDATE gpkg_contents SET description = trim(coalesce(description, '') || ' ' || ?) "
            "WHERE rowid = (SELECT min(rowid) FROM gpkg_contents)",
            (text,),
        )


# Places


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot write there ({error.strerror})", "Check permissions and space.") from error


def _identity(path: Path) -> tuple[int, ...] | None:
    """By which to know what lies at `path` again; None for nothing."""
    try:
        found = os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size


def _locked(scratch: Path, path: Path) -> int:
    """Make the folder `scratch`, or take over that of a dead run; returns the lock, which the kernel lets go when its
    process ends. Raises UsageError while another run has it, and for a folder of that name which no run made."""
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
        except FileNotFoundError:  # its run has just ended
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
        except FileNotFoundError:  # the lock of a run that has just ended
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
    """Whether this run has the lock now. Where there are no locks, it is that of the run that made its folder."""
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
        # The name is taken by something empty first, which fails if it exists.
        path.mkdir() if partial.is_dir() else path.touch(exist_ok=False)
    except FileExistsError:
        raise UsageError(f"{path} was made by somebody else meanwhile", "Nothing was replaced.") from None
    try:
        os.replace(partial, path)
    except BaseException:
        path.rmdir() if path.is_dir() else path.unlink()
        raise


def _renameat2(source: Path, target: Path, flag: int) -> bool:
    """Linux's rename that replaces nothing, or exchanges both names at once; False where there is no such thing."""
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
