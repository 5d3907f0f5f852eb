"""COLMAP's database beside a model, which is only read."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np

from ..system.paths import homes

FOLDERS_ABOVE = 3  # folders above a model in which its database may lie


def pose_priors(folder: Path) -> str:
    """A note on the pose priors in the database that belongs to the model in `folder`; empty if there are none.

    Priors are positions that came with the images (GPS); they are in metres or degrees already, not in model units.
    COLMAP 4 writes one for each image with an EXIF orientation, too: it has the direction of gravity, and NaN for a
    position.
    """
    for place in (place for home in homes(folder) for place in (home, *home.parents[:FOLDERS_ABOVE])):
        path = place / "database.db"
        if not path.is_file():
            continue
        try:
            with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro&immutable=1", uri=True)) as database:
                positions = [value for (value,) in database.execute("SELECT position FROM pose_priors")]
                count = sum(bool(value) and not np.isnan(np.frombuffer(value)).all() for value in positions)
        except (sqlite3.Error, ValueError, TypeError):  # an older database without priors, or not one of COLMAP's
            return ""
        priors = "pose prior is" if count == 1 else f"{count} pose priors are"
        return f"{path}: its {priors} not in model units and left unchanged" if count else ""
    return ""
