"""COLMAP's database beside a model, which is only read."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from ..system.paths import homes

FOLDERS_ABOVE = 3  # folders above a model in which its database may lie


def pose_priors(folder: Path) -> str:
    """A note on the pose priors in the database that belongs to the model in `folder`; empty if there are none.

    Priors are positions that came with the images (GPS); they are in metres or degrees already, not in model units.
    """
    for place in [folder, *(above for home in homes(folder) for above in home.parents[:FOLDERS_ABOVE])]:
        path = place / "database.db"
        if not path.is_file():
            continue
        try:
            with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro&immutable=1", uri=True)) as database:
                (count,) = database.execute("SELECT COUNT(*) FROM pose_priors").fetchone()
        except (sqlite3.Error, ValueError):  # an older database without priors, or not one of COLMAP's
            return ""
        return f"{path}: its {count} pose priors are not in model units and were left as they are" if count else ""
    return ""
