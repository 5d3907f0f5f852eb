"""The transaction in which a command writes its outputs: all of them whole, or none, and never over an input.

Before any work is done, an output is refused if it is, contains or lies in an input, under whatever name; if it would
belong to an input, as a world file does; if it is also another output of the command; if another run is writing it; or
if it exists, unless it may be overwritten and orthoscale wrote it under this very name. Outputs get temporary names,
and those of a command are renamed into place together: no file that appeared meanwhile is replaced, and on any error,
including SIGTERM, SIGHUP and Ctrl-C, everything is as it was. The next run removes the leftovers of a killed one.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType

from ..errors import LONGEST_MESSAGE, InputError, OrthoscaleError, OutputError, UsageError, shown
from . import stopping
from .reserved import Reserved, identity, writing
from .signatures import CHANGED, why_not_ours
from .untouched import existing, inside, refuse_input

ELSEWHERE = "Choose another place, or delete it yourself."
REPLACE = "Choose another place, or pass --overwrite to replace it."  # only of what orthoscale wrote
UNFINISHED = ("-wal", "-journal")  # of a database (GeoPackage) that is open or was left by a crash: its latest changes
DISK = (OSError, sqlite3.Error)  # errors due to a disk that is full, gone or read-only


class Outputs:
    """The outputs of one command, as a context manager: at its end they are in place; on an error, all is as before.

    overwrite : replace what orthoscale wrote before. inputs : the command's inputs, as for `existing`. dry_run : only
    check the outputs, and change nothing.
    problems : names of what `attempt` could not write, by reason.
    Raises UsageError for an output that is refused, OutputError for one that cannot be written. An OSError from the
    block becomes an InputError if it names a file that is none of the outputs, else an OutputError.
    """

    def __init__(
        self, overwrite: bool = False, inputs: str | Path | None | Sequence = (), dry_run: bool = False
    ) -> None:
        self.overwrite, self.dry_run = overwrite, dry_run
        self.problems: dict[str, list[str]] = {}
        self._inputs = existing(inputs)
        self._claims: list[Reserved] = []

    def file(self, path: Path, mine: Callable[[Path], bool] | None = None) -> Path:
        """The temporary path, with the same name, at which to write the file that will be moved to `path`.

        mine : whether orthoscale wrote the file that is there now, for formats that have no room for a `signature`.
        JSON, HTML, PNG and GeoPackage files are signed at the end; writers of TIFF and text sign them themselves.
        """
        return self._claim(path, mine, folder=False).partial

    def folder(self, path: Path, metres: bool = False) -> Path:
        """An empty temporary folder, which will be moved to `path`. metres : whether its files are scaled to metres:
        then they are not scaled again."""
        claim = self._claim(path, None, folder=True)
        claim.metres = metres
        with writing(path):
            claim.partial.mkdir()
        return claim.partial

    def retire(self, path: Path, mine: Callable[[Path], bool] | None = None) -> bool:
        """Remove at the end an older output of orthoscale at `path`, which would be taken for a part of the new one;
        files of others stay. Returns whether it will be removed. Raises UsageError for one that was edited."""
        why = why_not_ours(path, mine) if self.overwrite and os.path.lexists(path) else None
        if why == CHANGED:
            raise UsageError(f"{path} {why}, and would be taken for a part of the new output", "Move it away.")
        if why == "":
            self._claim(path, mine, folder=path.is_dir()).retired = True
        return why == ""

    def protect(self, *inputs: Path) -> None:
        """Protect more inputs, found while opening the given ones. Raises UsageError if an output touches them."""
        for path in inputs:
            for claim in self._claims:
                refuse_input(claim.path, path)

    @contextmanager
    def attempt(self, partial: Path, what: str) -> Iterator[None]:
        """A block that writes `partial`, an output or a file in one. If it fails, that is left out and noted in
        `problems`, and the other outputs are delivered all the same. what : its name for the user."""
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
        """What `attempt` could not write and why, as a part of a sentence; '' if nothing failed."""
        return "; ".join(f"{', '.join(names)} could not be written ({why})" for why, names in self.problems.items())

    @property
    def places(self) -> list[Path]:
        """The final paths of the outputs, in the order in which they were claimed."""
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
        """`text` with temporary paths of outputs replaced by the paths that the user gave."""
        for claim in self._claims:
            text = text.replace(shown(claim.partial, LONGEST_MESSAGE), shown(claim.path, LONGEST_MESSAGE))
        return text

    def _said(self, error: Exception) -> OrthoscaleError:
        """The error for a disk error: an InputError if that names a file that is none of the outputs, else an
        OutputError."""
        name, reason = getattr(error, "filename", None), getattr(error, "strerror", None) or error
        if isinstance(name, (str, bytes)) and not any(claim.concerns(name) for claim in self._claims):
            return InputError(f"{os.fsdecode(name)}: cannot be read ({reason})", "Check the file and its permissions.")
        place = self._claims[0].path if self._claims else "the output"
        return OutputError(
            f"{place}: writing failed ({reason})",
            "Nothing was left behind. Check the free space on its disk, and run again.",
        )

    def check(self, path: Path, mine: Callable[[Path], bool] | None = None) -> tuple[int, ...] | None:
        """Refuse early what `file` or `folder` would refuse; returns the identity of what will be replaced, None if
        nothing is there. Raises UsageError, OutputError."""
        for given in self._inputs:
            refuse_input(path, given)
        for other in self._claims:
            if inside(path, other.path) or inside(other.path, path):
                raise UsageError(f"{path} and {other.path} cannot both be outputs", "Give each a place of its own.")
        there = self._refuse_existing(path, mine)
        for beside in (path.with_name(path.name + ending) for ending in UNFINISHED):
            if os.path.lexists(beside):
                why = f"{beside} would be taken for a part of the new {path.name}"
                raise UsageError(why, "Close it in the program that has it open (QGIS); if none has, delete it.")
        parent = path.absolute().parent
        if not parent.is_dir():
            raise OutputError(
                f"{path}: {parent} {'is not a folder' if parent.exists() else 'does not exist'}",
                "Create that folder first, or choose another place.",
            )
        return there

    def _refuse_existing(self, path: Path, mine: Callable[[Path], bool] | None) -> tuple[int, ...] | None:
        """Raise UsageError if something is at `path` that may not be replaced; returns its identity."""
        with writing(path):
            there = identity(path)
        if there is not None:
            why = why_not_ours(path, mine)
            if not self.overwrite:
                raise UsageError(f"{path} already exists", ELSEWHERE if why else REPLACE)
            if why:
                raise UsageError(f"{path} {why}, so it is not replaced", ELSEWHERE)
        return there

    def _claim(self, path: Path, mine: Callable[[Path], bool] | None, folder: bool) -> Reserved:
        path = Path(path)
        there = self.check(path, mine)
        with stopping.held():
            claim = Reserved(path)
            self._claims.append(claim)
        if claim.before != there:  # another run ended just before the lock, or a killed one's former output came back
            self._refuse_existing(path, mine)
        if claim.before is not None and path.is_dir() != folder:
            kinds = ("file", "folder") if folder else ("folder", "file")
            raise UsageError(f"{path} is a {kinds[0]}, the output is a {kinds[1]}", ELSEWHERE)
        return claim

    def deliver(self, partial: Path) -> None:
        """Move the output written at `partial` into place now, whatever happens to the others."""
        (claim,) = (claim for claim in self._claims if claim.partial == partial)
        self._put([claim])
        with stopping.held():
            self._claims.remove(claim)
            claim.release()

    def _put(self, claims: list[Reserved]) -> None:
        """Move the outputs into place, all or none; the one claimed first, the main output, last."""
        written = [claim for claim in reversed(claims) if not (claim.retired or claim.failed)]
        for claim in written:
            claim.sign()
            claim.flush()
        stopping.check()
        # Old files that would be taken for parts of the new output are removed once that is in place.
        changes = [*written, *(claim for claim in claims if claim.retired or claim.failed)]
        done: list[Reserved] = []
        with stopping.held():
            try:
                for claim in changes:
                    claim.place()
                    done.append(claim)
            except BaseException:
                for claim in reversed(done):
                    claim.undo()
                raise
            # Outputs in another output's scratch folder are moved with that one, and are not listed.
            stopping.written.extend(str(claim.path) for claim in written if not claim.in_another)
