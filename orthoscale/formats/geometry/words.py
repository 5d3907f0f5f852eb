"""Lengths in lines of text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def grown(words: Sequence[bytes], columns: Iterable[int], scale: float, digits: int = 10) -> list[bytes]:
    """The words of a line, the numbers in `columns` times `scale`. Raises ValueError, IndexError."""
    new = list(words)
    for k in columns:
        new[k] = f"{float(words[k]) * scale:.{digits}g}".encode()
    return new
