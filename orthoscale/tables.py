"""The tables of what has a standard size beside vehicles: parking stalls, and objects that detectors know.

The figures, and the source of each, are in ``data/stalls.json`` and ``data/objects.json``.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from .core.measuring.surroundings import Standards
from .formats.reading import read_plain


@cache
def standards() -> Standards:
    """Both tables."""
    return Standards(_table("stalls"), _table("objects"))


def known_objects() -> dict[str, list[dict[str, Any]]]:
    """Standards by class: name, length, width (value and one sigma) [m], flat, source."""
    return standards().objects


def _table(name: str) -> dict[str, Any]:
    return read_plain(Path(__file__).parent / "data" / f"{name}.json", f"the table of {name}")[name]
