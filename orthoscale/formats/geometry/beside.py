"""Files that a file refers to."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Referred:
    """Files that a file refers to: those that lie beside it, and the names of those that do not. notes : on the file
    itself, for the user."""

    there: list[Path] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, path: Path, names: Iterable[str]) -> list[Path]:
        """Look for `names` as the file `path` refers to them; returns those that exist and are new."""
        found = {name: beside(path, name) for name in names if name}
        there = [place for place in found.values() if place is not None and place not in self.there]
        self.there += there
        self.absent += [name for name, place in found.items() if place is None]
        return there


def beside(path: Path, name: str) -> Path | None:
    """The file `name` as the file `path` refers to it, from its own folder; None if it does not exist."""
    return file_in(path.parent, name) if name else None


def file_in(folder: Path, name: str) -> Path | None:
    """The file `name`, a relative path, in `folder`; None if it does not exist. Programs on Windows separate folders by
    backslashes, which are ordinary characters of a name elsewhere."""
    places = (folder / name, folder / name.replace("\\", "/"))
    return next((place for place in places if os.path.isfile(place)), None)  # noqa: PTH113  pathlib's raises if too long
