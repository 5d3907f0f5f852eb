"""Files that a file refers to."""

from __future__ import annotations

import os
from pathlib import Path


def beside(path: Path, name: str) -> Path | None:
    """The file `name` as the file `path` refers to it, from its own folder; None where there is none."""
    place = path.parent / name
    return place if name and os.path.isfile(place) else None  # noqa: PTH113  pathlib's raises for names that are too long
