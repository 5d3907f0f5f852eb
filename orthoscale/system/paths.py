"""Checks the paths that callers of the library give, and resolves names and links."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..errors import UsageError, shown


def path_of(value: object, what: str) -> Path:
    """`value` as a path. what : what was expected, for the message ("the path of a fleet").

    Raises UsageError for anything but text or a path: a number, which the system would take for an open file, or None;
    for an empty text, which would mean the current folder; and for a zero byte.
    """
    if isinstance(value, (str, os.PathLike)):
        text = os.fspath(value)
        if isinstance(text, str) and text and "\0" not in text:
            return Path(text)
    raise UsageError(f"expected {what}, not {shown(repr(value))}", "Give it as text or as a pathlib.Path.")


def paths_of(values: object, what: str) -> list[Path]:
    """One path or several as a list, at least one; see `path_of`."""
    if isinstance(values, Iterable) and not isinstance(values, (str, bytes, os.PathLike)):
        if paths := [path_of(each, what) for each in values]:
            return paths
        raise UsageError(f"expected {what}, not an empty list", "Give one path or several.")
    return [path_of(values, what)]


def homes(folder: Path) -> list[Path]:
    """The absolute paths of `folder`, as given and with links resolved, if they differ. Files that belong to it may lie
    beside either."""
    return list(dict.fromkeys((absolute(folder), Path(os.path.realpath(folder)))))


def name_of(path: str | Path, folder: str | Path = "") -> str:
    """The name of the file or folder at `path`, relative to `folder`, even if it is given as ``.`` or ``..``."""
    name = Path(path).name
    return name if name not in ("", os.pardir) else absolute(Path(folder, path)).name or str(path)


def title_of(path: str | Path, folder: str | Path = "") -> str:
    """The name for a heading: as `name_of`, and with the folder above where it is only a number, as COLMAP's
    ``sparse/0``."""
    name = name_of(path, folder)
    return "/".join(absolute(Path(folder, path)).parts[-2:]) if name.isdecimal() else name


def titles_of(paths: Sequence[str | Path]) -> list[str]:
    """A title for each of `paths`, in their order, with as many of the folders above as tell it from the others."""
    whole = [absolute(path) for path in paths]
    titles = {path: title_of(path) for path in whole}
    depth = 2
    while alike := {title for title, count in Counter(titles.values()).items() if count > 1}:
        titles |= {path: "/".join(path.parts[-depth:]) for path, title in titles.items() if title in alike}
        depth += 1
    return [titles[path] for path in whole]


def absolute(path: str | Path) -> Path:
    """`path` as an absolute path without ``..``. Links are kept, except before a ``..``, where they are resolved: it
    leads to the parent of the folder behind the link, not of the link itself."""
    parts = Path(path).absolute().parts
    if os.pardir not in parts:
        return Path(*parts)
    end = len(parts) - parts[::-1].index(os.pardir)
    return Path(os.path.realpath(Path(*parts[:end])), *parts[end:])
