"""Outputs that appear whole or not at all: written beside their place, then renamed into it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import OutputError, UsageError


def check_free(path: Path, overwrite: bool) -> None:
    """Refuse early, before any work is done: `path` exists and may not be replaced, or its parent is missing."""
    if path.exists() and not overwrite:
        raise UsageError(f"{path} already exists", "Choose another --out, or pass --overwrite to replace it.")
    if not path.absolute().parent.is_dir():
        raise OutputError(f"{path.absolute().parent} is not a folder", "Create it first, or choose another --out.")


@contextmanager
def new_file(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """A temporary path beside `path` (same suffix) that becomes `path` when the block ends without an error.

    Raises OutputError when the disk refuses; then, and on any other error (Ctrl-C included), nothing is left behind.
    """
    check_free(path, overwrite)
    with _beside(path) as scratch:
        partial = scratch / path.name
        yield partial
        os.replace(partial, path)


@contextmanager
def new_folder(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """A temporary folder beside `path` that becomes `path` when the block ends without an error; see `new_file`."""
    check_free(path, overwrite)
    with _beside(path) as scratch:
        partial = scratch / path.name
        partial.mkdir()
        yield partial
        former = scratch / f"{path.name}.former"
        if path.exists():
            os.replace(path, former)
        try:
            os.replace(partial, path)
        except BaseException:
            if former.exists():
                os.replace(former, path)
            raise


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    try:
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=path.absolute().parent))
    except OSError as error:
        raise OutputError(f"{path}: cannot write there ({error.strerror})", "Check permissions and space.") from error
    try:
        yield scratch
    except OSError as error:
        raise OutputError(f"{path}: writing failed ({error.strerror or error})", "Nothing was left behind.") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
