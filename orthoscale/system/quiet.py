"""Standard streams: suppresses what C libraries print of their own accord (libpng, libjpeg, COLMAP's log)."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def open_streams() -> None:
    """Streams that a scheduler or shell closed (``>&-``) lead nowhere from now on. Python has None for them, and the
    next files to be opened would get their descriptors, with what C libraries print in them."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest that is free: this one
            os.set_inheritable(descriptor, True)
    sys.stdin = sys.stdin or open(os.devnull, encoding="utf-8")  # noqa: SIM115
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115


@contextmanager
def unheard() -> Iterator[None]:
    """In the block the descriptor of standard error leads nowhere; Python's `sys.stderr` goes where it always went.

    For the command line: the descriptor is the whole process's. Redirecting it around single calls would lose what
    other threads say meanwhile.
    """
    try:
        kept = os.dup(2)
    except OSError:  # there is none to be heard on
        yield
        return
    python, unraisable = sys.stderr, sys.unraisablehook
    sys.unraisablehook = lambda _: None  # of a library's callback, such as rasterio's for GDAL's log
    if _is_the_descriptor(python):
        # Not closed at the end: handlers of logs keep it.
        sys.stderr = open(kept, "w", buffering=1, encoding=python.encoding, errors=python.errors)  # noqa: SIM115
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        sys.unraisablehook = unraisable
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
