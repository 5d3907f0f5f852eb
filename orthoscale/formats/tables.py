"""The tables of standard sizes other than vehicles': parking stalls, and objects for which detectors have classes.

The figures, and the source of each, are in ``data/stalls.json`` and ``data/objects.json``.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Any

from ..core.anchors import BAYS
from ..core.measuring.objects import in_words
from ..core.measuring.surroundings import Standards
from .reading import read_plain


def standards(kinds: Collection[str] | None = None) -> Standards:
    """Both tables; of them what is of the `kinds` of anchors that are named, if any are."""
    stalls, objects = _table("stalls"), _table("objects")
    if kinds is None:
        return Standards(stalls, objects)
    return Standards(stalls if BAYS in kinds else {}, {k: v for k, v in objects.items() if in_words(k) in kinds})


def known_objects() -> dict[str, list[dict[str, Any]]]:
    """Standards by class: name, length, width (value and one sigma) [m], flat, source."""
    return standards().objects


@cache
def _table(name: str) -> dict[str, Any]:
    return read_plain(Path(__file__).parents[1] / "data" / f"{name}.json", f"the table of {name}")[name]
