"""Prints on standard output, and says what has been written if that fails."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from ..errors import OutputError
from . import stopping


@contextmanager
def printing() -> Iterator[None]:
    """A block that prints on standard output. Raises OutputError if that cannot be written; BrokenPipeError if nobody
    reads it any more."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        there = f"In place and complete: {', '.join(stopping.written)}." if stopping.written else "Nothing was written."
        hint = "What was to be printed is lost." if stopping.written else "Print to a place with room, and run again."
        raise OutputError(f"standard output cannot be written ({error.strerror})", f"{there} {hint}") from error


def echo(text: str) -> None:
    """Print `text` and a line break on standard output; see `printing`."""
    with printing():
        click.echo(text)
