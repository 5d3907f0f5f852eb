"""The mark in a rescaled file that prevents scaling it twice."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

from ...errors import UsageError

MARK = "orthoscale"


def mark(scale: float) -> str:
    """The mark, as one line for a comment: it says what was done to the file."""
    return f"{MARK}: metres, scaled by {scale:.17g} about the origin"


def refuse_marked(path: Path) -> NoReturn:
    """Raise UsageError: `path` carries the mark."""
    raise UsageError(f"{path} is in metres already: orthoscale wrote it", "Apply a similarity to the original file.")
