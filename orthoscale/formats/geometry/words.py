"""Lines of text: those of a header, and those with lengths in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import BinaryIO

LONGEST_HEADER = 1 << 16  # [bytes]


def header_line(file: BinaryIO) -> str | None:
    """The next line of a header, without what ends it; None where the file ends, or is too long for a header. Comments
    may be in any coding: bytes that are not UTF-8 survive as surrogates."""
    line = file.readline(LONGEST_HEADER)
    too_long = file.tell() > LONGEST_HEADER
    return line.decode("utf-8", "surrogateescape").rstrip() if line and not too_long else None


def grown(words: Sequence[bytes], columns: Iterable[int], scale: float, digits: int = 10) -> list[bytes]:
    """The words of a line, the numbers in `columns` times `scale`. Raises ValueError, IndexError."""
    new = list(words)
    for k in columns:
        new[k] = f"{float(words[k]) * scale:.{digits}g}".encode()
    return new
