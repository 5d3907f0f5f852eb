"""The transaction in which a command writes its outputs: all of them whole, or none, and never over an input.

Refused before any work is done: an output that is, contains or lies in an input, under whatever name; that belongs to
an input, as a world file does; that is also another output of the command; that another run is writing; or that exists,
unless it may be overwritten and orthoscale wrote it under this very name. Outputs are written to temporary names and
all of a command are renamed into place together: no file that appeared meanwhile is replaced, and on any error,
SIGTERM, SIGHUP and Ctrl-C included, everything is as it was. Leftovers of a killed run are removed by the next one.
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
from .signatures import why_not_ours
from .untouched import existing, inside, refuse_input

ELSEWHERE = "Choose another place, or delete it yourself."
REPLACE = "Choose another place, or pass --overwrite to replace it."  # only of what orthoscale wrote
DISK = (OSError, sqlite3.Error)  # what a disk that is full, gone or read-only raises


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
        self._claims: list[Reserved] = []

    def file(self, path: Path, mine: Callable[[Path], bool] | None = None) -> Path:
        """Where to write the file that is to be `path`; it has the same name.

        mine : whether the file that is there now is orthoscale's, for formats that have no room for a `signature`.
        JSON, HTML, PNG and GeoPackage files are signed at the end; writers of TIFF and text do it themselves.
        """
        return self._claim(path, mine, folder=False).partial

    def folder(self, path: Path) -> Path:
        """An empty folder to write what is to be in the folder `path`."""
        partial = self._claim(path, None, folder=True).partial
        with writing(path):
            partial.mkdir()
        return partial

    def retire(self, path: Path, mine: Callable[[Path], bool] | None = None) -> None:
        """Remove at the end what orthoscale wrote at `path` and what would speak for the new output; others' stays."""
        if self.overwrite and os.path.lexists(path) and not why_not_ours(path, mine):
            self._claim(path, mine, folder=path.is_dir()).retired = True

    def protect(self, *inputs: Path) -> None:
        """More inputs, found while opening those that were given. Raises UsageError."""
        for path in inputs:
            for claim in self._claims:
                refuse_input(claim.path, path)

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
            refuse_input(path, given)
        for other in self._claims:
            if inside(path, other.path) or inside(other.path, path):
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
        """Put the output written at `partial` in its place now, whatever becomes of the others."""
        (claim,) = (claim for claim in self._claims if claim.partial == partial)
        self._put([claim])
        with stopping.held():
            self._claims.remove(claim)
            claim.release()

    def _put(self, claims: list[Reserved]) -> None:
        """In their places, all or none; the one claimed first, the main output, last."""
        written = [claim for claim in reversed(claims) if not (claim.retired or claim.failed)]
        for claim in written:
            claim.sign()
            claim.flush()
        stopping.check()
        # What would speak falsely for the new output goes when that is there.
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
            # What lies in another output's scratch folder goes with that, and is there when that is.
            stopping.written.extend(str(claim.path) for claim in written if not claim.in_another)
