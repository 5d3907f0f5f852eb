"""Ensures that no output touches an input.

No output may be, contain or lie in an input, under whatever name, or be a file that programs read together with one.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from ..errors import UsageError

# Endings of files that GDAL reads together with a file, appended to its name or to its stem; and world files.
BESIDE_NAME = (".aux.xml", ".ovr", ".msk", ".xml", "-wal", "-shm", "-journal")
BESIDE_STEM = (".aux.xml", ".aux", ".rrd", ".prj", ".qpj", ".rpb", "_rpc.txt", ".imd", ".tab", ".wld", ".shx", ".dbf",
               ".cpg", ".sbn", ".sbx")  # fmt: skip


def existing(given: str | Path | None | Sequence) -> list[Path]:
    """The files and folders among `given`, a path, None or a list of such, that exist: a command's inputs."""
    if isinstance(given, (str, Path)):
        return [Path(given)] if os.path.lexists(given) else []
    assert given is None or isinstance(given, (list, tuple)), "an input that is overlooked is not protected"
    return [path for one in given or () for path in existing(one)]


def refuse_input(out: Path, given: Path) -> None:
    """Raise UsageError if writing `out` could change the input `given`."""
    hint = "Inputs are never touched: choose another place."
    if _same(out, given):
        raise UsageError(f"{out} is the input {given}", hint)
    places_of_out, places_of_given = _places(out), _places(given)
    folder = os.path.realpath(out)
    if any(_within(place, folder) for place in places_of_given):
        raise UsageError(f"{out} contains the input {given}", hint)
    if given.is_dir():
        folder = os.path.realpath(given)
        if any(_within(place, folder) for place in places_of_out):
            raise UsageError(f"{out} lies in the input {given}", hint)
    elif any(_is_sidecar(mine, theirs) for mine, theirs in product(places_of_out, places_of_given)):
        raise UsageError(f"{out} would be taken for a part of the input {given}", hint)


def _places(path: Path) -> set[str]:
    """The real paths of the file behind `path` and of the name itself; they differ for a symbolic link."""
    parent = os.path.realpath(path.absolute().parent)
    return {os.path.realpath(path), os.path.join(parent, path.name)}


def _same(one: Path, other: Path) -> bool:
    try:
        return bool(_places(one) & _places(other)) or os.path.samefile(one, other)
    except OSError:
        return False


def _within(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def inside(path: Path, folder: Path) -> bool:
    """Whether `path` is `folder` or lies in it, with links resolved."""
    return _within(os.path.realpath(path), os.path.realpath(folder)) or _same(path, folder)


def _is_sidecar(mine: str, theirs: str) -> bool:
    """Whether programs read the file `mine` together with the file `theirs`: by place and, in any case, name."""
    path = Path(theirs.lower())
    ending = path.suffix[1:]
    world = (f".{ending}w", f".{ending[0]}{ending[-1]}w") if ending else ()
    names = {path.name + more for more in BESIDE_NAME} | {path.stem + more for more in (*BESIDE_STEM, *world)}
    return os.path.dirname(mine) == os.path.dirname(theirs) and Path(mine).name.lower() in names
