"""Names of vector files for pyogrio, which takes every name for an address on the web: of ``a;b`` it leaves ``a``, and
what stands before an exclamation mark is an archive to it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..system.scratch import Scratch

OF_ADDRESSES = re.compile(r"^//|[;!?\t\r\n]|[\ud800-\udfff]")  # the last are bytes that are no UTF-8


@contextmanager
def readable(path: Path) -> Iterator[Path]:
    """`path`, or a link to it whose name pyogrio takes as it is, with links to what is called alike: the other files of
    a shapefile. Raises OSError."""
    if not OF_ADDRESSES.search(str(path.absolute())):
        yield path
        return
    with _scratch() as folder:
        for each in sorted(path.parent.iterdir()):
            if each == path or each.name.startswith(f"{path.stem}."):
                (folder / _plain(each.name)).symlink_to(each.absolute())
        yield folder / _plain(path.name)


@contextmanager
def writable(path: Path) -> Iterator[Path]:
    """`path`, or a place whose name pyogrio takes as it is, from which it is moved to `path` in the end. What is at
    `path` already is there as well. Raises OSError."""
    if not OF_ADDRESSES.search(str(path.absolute())):
        yield path
        return
    with _scratch() as folder:
        place = folder / _plain(path.name)
        if path.exists():
            shutil.copyfile(path, place)
        yield place
        shutil.copyfile(place, path)


@contextmanager
def _scratch() -> Iterator[Path]:
    scratch = Scratch()
    try:
        yield scratch.folder
    finally:
        scratch.close()


def _plain(name: str) -> str:
    return OF_ADDRESSES.sub("_", name)
