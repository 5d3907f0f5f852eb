"""Reads header lines, and scales the lengths in lines of text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import BinaryIO

LONGEST_HEADER = 1 << 16  # [bytes]
MOST_DIGITS = 17  # enough to distinguish any two doubles
EXPONENT = re.compile(rb"[eE].*")


def header_line(file: BinaryIO) -> str | None:
    """The next line of a header, without its line end; None at the end of the file, or if it is too long for a header.
    Comments may be in any encoding: bytes that are not UTF-8 are kept as surrogates."""
    line = file.readline(LONGEST_HEADER)
    too_long = file.tell() > LONGEST_HEADER
    return line.decode("utf-8", "surrogateescape").rstrip() if line and not too_long else None


def grown(words: Sequence[bytes], columns: Iterable[int], scale: float, digits: int = 10) -> list[bytes]:
    """The words of a line, with the numbers in `columns` times `scale`. They get `digits` significant digits, or one
    more than they had if that is more. Raises ValueError, IndexError."""
    new = list(words)
    for k in columns:
        number = float(words[k]) * scale
        # Long words have many digits: far from the origin, as in map coordinates, the last ones are centimetres.
        many = digits if len(words[k]) <= digits else min(max(digits, _counting(words[k]) + 1), MOST_DIGITS)
        new[k] = f"{number:.{many}g}".encode()
    return new


def _counting(word: bytes) -> int:
    """The number of significant digits of a number."""
    return len(EXPONENT.sub(b"", word.strip()).lstrip(b"+-0.").replace(b".", b""))
