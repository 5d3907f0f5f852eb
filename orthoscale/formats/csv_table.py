"""Writes tables as CSV, and texts that come from the names of files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any


def in_utf8(text: str) -> str:
    """`text` with escapes for what UTF-8 cannot say: the names of files need not be text."""
    return text.encode(errors="backslashreplace").decode()


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a header of `columns`, and a line per row, which has just these keys. Raises OSError."""
    with path.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file:
        table = csv.DictWriter(file, columns)
        table.writeheader()
        table.writerows(rows)
