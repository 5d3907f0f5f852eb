"""The tables of standard sizes besides those of vehicles: parking stalls, and objects that detectors have classes for.

The figures and their sources are in ``data/stalls.json`` and ``data/objects.json``.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from ..core.anchors import BAYS
from ..core.measuring.objects import in_words
from ..core.measuring.surroundings import Standards
from .reading import shipped


def standards(kinds: Collection[str] | None = None) -> Standards:
    """Both tables, restricted to these `kinds` of anchors unless that is None."""
    stalls, objects = shipped("stalls")["stalls"], shipped("objects")["objects"]
    if kinds is None:
        return Standards(stalls, objects)
    return Standards(stalls if BAYS in kinds else {}, {k: v for k, v in objects.items() if in_words(k) in kinds})


def known_objects() -> dict[str, list[dict[str, Any]]]:
    """Standards by class: name, length, width (value and one sigma) [m], flat, source."""
    return standards().objects
