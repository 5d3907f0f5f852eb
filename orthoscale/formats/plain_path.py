"""Makes paths of vector files safe for pyogrio, which parses every path as a URL: it cuts ``a;b`` to ``a``, and takes
the part before an exclamation mark for an archive."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from ..system.scratch import Scratch

OF_ADDRESSES = re.compile(r"^//|[;!?\t\r\n]|[\ud800-\udfff]")  # the last are bytes that are not UTF-8


@contextmanager
def readable(path: Path) -> Iterator[Path]:
    """Yields `path`, or a link to it whose name pyogrio does not change, beside links to files of the same stem: the
    other parts of a shapefile. Raises OSError."""
    if not OF_ADDRESSES.search(str(path.absolute())):
        yield path
        return
    with closing(Scratch()) as scratch:
        for each in sorted(path.parent.iterdir()):
            if each == path or each.name.startswith(f"{path.stem}."):
                (scratch.folder / _plain(each.name)).symlink_to(each.absolute())
        yield scratch.folder / _plain(path.name)


@contextmanager
def writable(path: Path) -> Iterator[Path]:
    """Yields `path`, or a temporary path whose name pyogrio does not change, whose file is copied to `path` at the end.
    It starts as a copy of what is at `path` already. Raises OSError."""
    if not OF_ADDRESSES.search(str(path.absolute())):
        yield path
        return
    with closing(Scratch()) as scratch:
        place = scratch.folder / _plain(path.name)
        if path.exists():
            shutil.copyfile(path, place)
        yield place
        shutil.copyfile(place, path)


def _plain(name: str) -> str:
    return OF_ADDRESSES.sub("_", name)
