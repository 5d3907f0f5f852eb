"""Standard streams: opens closed ones, and suppresses what C libraries print (libpng, libjpeg, COLMAP's log)."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def open_streams() -> None:
    """Connect standard streams that a scheduler or shell closed (``>&-``) to the null device. Otherwise Python has None
    for them, and the next files opened would get their descriptors, and in them what C libraries print. Letters that
    standard output cannot encode are escaped."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor: this one
            os.set_inheritable(descriptor, True)
    sys.stdin = sys.stdin or open(os.devnull, encoding="utf-8")  # noqa: SIM115
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        # As standard error does: a name that its encoding lacks (Latin-1, Windows' pages) must not end a run.
        sys.stdout.reconfigure(errors="backslashreplace")


@contextmanager
def unheard() -> Iterator[None]:
    """In the block, standard error's descriptor leads to the null device, but Python's `sys.stderr` still works.

    For the command line, where it covers the whole run: the descriptor is shared by the process, so that redirecting it
    around single calls would lose what other threads print meanwhile.
    """
    try:
        kept = os.dup(2)
    except OSError:  # standard error is closed
        yield
        return
    python, unraisable, uncaught = sys.stderr, sys.unraisablehook, sys.excepthook
    # Of a library's callback, such as rasterio's for GDAL's log: Cython calls both. What else is raised here is caught.
    sys.unraisablehook, sys.excepthook = lambda _: None, lambda *_: None
    if _is_the_descriptor(python):
        # Not closed at the end: logging handlers keep a reference to it.
        sys.stderr = open(kept, "w", buffering=1, encoding=python.encoding, errors=python.errors)  # noqa: SIM115
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        sys.unraisablehook, sys.excepthook = unraisable, uncaught
        if sys.stderr is python:
            os.close(kept)
        else:
            sys.stderr.flush()
            sys.stderr = python


def _is_the_descriptor(stream: object) -> bool:
    try:
        return stream.fileno() == 2  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return False
