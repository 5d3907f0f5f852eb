"""The files that lie beside a COLMAP model's own: which of them are copied along with its scaled copy."""

from __future__ import annotations

import shutil
from collections.abc import Set
from pathlib import Path

from ..formats.geometry.lengthless import has_lengths
from ..formats.geometry.sim3 import MATRIX
from ..formats.reading import is_hidden
from .cameras import SCALED_MARK

LARGEST_COPY = 64 << 20  # [byte] largest file beside the model that is copied; a larger one is data, not settings
OURS = {SCALED_MARK, MATRIX, "sim3.json", "report.json", "report.html", "vehicles.png"}


def copy_beside(source: Path, target: Path, own: Set[str]) -> list[str]:
    """Copy small files without lengths from the folder `source` into `target`; returns notes on what was copied and
    what was not. own : names of the model's own files, which are neither, as are those that orthoscale writes and
    hidden ones."""
    copied, left, links = [], [], []
    for path in sorted(source.iterdir()):
        if not path.is_file() or path.name in own | OURS or is_hidden(path.name):
            continue
        if path.is_symlink():  # its target is not part of the model
            links.append(path.name)
        elif has_lengths(path) or path.stat().st_size > LARGEST_COPY:  # a copy would seem to be in metres
            left.append(path.name)
        else:
            shutil.copyfile(path, target / path.name)
            copied.append(path.name)
    notes = [f"copied unchanged from {source}: {', '.join(copied)}"] if copied else []
    if left:
        why = "because it may hold lengths that are not in metres (see `orthoscale apply`), or is large"
        notes.append(f"left in {source}, {why}: {', '.join(left)}")
    if links:
        notes.append(f"left in {source}, because they are symbolic links: {', '.join(links)}")
    return notes
