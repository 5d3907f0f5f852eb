"""How callers are told of progress: a callback, and the same callback for one step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

Progress = Callable[[str, int, int], None]
"""Told what is done, how many of its steps are, and of how many."""


def of_step(progress: Progress | None, what: str) -> Callable[[int, int], None] | None:
    """`progress` of the step that is called `what`: it is told how many of how many are done. None without it."""
    return None if progress is None else partial(progress, what)
