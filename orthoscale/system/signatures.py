"""Marks what orthoscale writes, to recognise it later: a signature in each file, a mark in each folder.

Only outputs of orthoscale may be replaced. A signature depends on the file's own name, so that a user's working copy
under another name is not taken for an output.
"""

from __future__ import annotations

import csv
import hashlib
import json
import mmap
import os
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from functools import cache
from pathlib import Path

from ..version import __version__
from .paths import homes

FOLDER_MARK = ".orthoscale.json"  # in every folder that orthoscale writes: what it is, and the files that it wrote
LONGEST_CSV_HEADER = 10_000  # [characters] of a table's first line


def signature(path: str | Path) -> str:
    """The text that a file written by orthoscale contains: a hash of its own name, so that a renamed copy does not pass
    for an output."""
    name = os.fsencode(Path(path).name)
    return "orthoscale output " + hashlib.blake2b(name, digest_size=8).hexdigest()


def ours(path: Path) -> bool:
    """Whether orthoscale wrote `path`: a file, or a folder with nothing else in it."""
    return not why_not_ours(path)


def ours_in_a_folder(path: Path) -> bool:
    """Whether orthoscale wrote `path`, as a single file or as a part of the folder that it lies in."""
    return ours(path) or (path.is_file() and path.name in (_listed(path.absolute().parent) or ()))


def has_header(path: Path, columns: Iterable[str]) -> bool:
    """Whether `path` is a CSV table with exactly these columns; CSV has no room for a signature."""
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        return next(csv.reader([file.readline(LONGEST_CSV_HEADER)]), []) == list(columns)


def why_not_ours(path: Path, mine: Callable[[Path], bool] | None = None) -> str:
    """Why `path` must not be replaced, as the end of a sentence; '' for what orthoscale wrote."""
    if path.is_symlink():
        return "is a symbolic link"
    if not (path.is_dir() or path.is_file()):
        return "is neither a file nor a folder"
    if path.is_dir():
        return _why_not_our_folder(path)
    try:
        known = mine(path) if mine else _signed(path)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return "" if known else "was not written by orthoscale under this name"


def _why_not_our_folder(folder: Path) -> str:
    files = _listed(folder)
    if files is None:
        return "was not written by orthoscale under this name"
    listed = cache(_listed)

    def in_an_output(name: str) -> bool:
        """Whether it is of an output in `folder`, which lists it."""
        path = folder / name
        outputs = [(home, listed(home)) for home in path.parents[: name.count("/")]]
        return any(path.relative_to(home).as_posix() in (FOLDER_MARK, *each) for home, each in outputs if each)

    others = (name for name in _files_in(folder) if name not in files and not ours(folder / name))
    strangers = (name for name in others if not in_an_output(name))
    stranger = next(strangers, "")
    return f"holds {stranger}, which orthoscale did not write" if stranger else ""


def _listed(folder: Path) -> set[str] | None:
    """The files that the mark of `folder` lists; None if it has no mark for a folder of this name."""
    try:
        mark = json.loads((folder / FOLDER_MARK).read_text(encoding="utf-8"))
        return set(mark["files"]) if mark["written_by"] == signature(folder.absolute()) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _files_in(folder: Path) -> Iterator[str]:
    """Relative names of the files in `folder`, without its mark and without folders in it that are outputs of their
    own."""
    for root, folders, files in os.walk(folder):
        here = Path(root)
        links = [name for name in folders if (here / name).is_symlink()]
        for name in (*files, *links):
            if here != folder or name != FOLDER_MARK:
                yield (here / name).relative_to(folder).as_posix()
        folders[:] = [f for f in folders if not (here / f / FOLDER_MARK).is_file() or why_not_ours(here / f)]


def written_in_metres(path: Path) -> bool:
    """Whether the file or folder at `path` is, lies in or contains what orthoscale wrote in metres, as the mark of a
    folder says, which may have been renamed since."""
    for place in homes(path):
        for folder in (place, *place.parents):
            try:
                mark = json.loads((folder / FOLDER_MARK).read_text(encoding="utf-8"))
                files = [folder / name for name in mark["files"]] if mark["metres"] is True else []
            except (OSError, ValueError, KeyError, TypeError):
                continue
            if any(file.is_relative_to(place) and file.exists() for file in files):
                return True
    return False


def sign_folder(folder: Path, metres: bool = False) -> None:
    """Write the mark of a folder: its signature and the list of its files. metres : whether these have been scaled to
    metres."""
    text = {"written_by": signature(folder), "version": __version__, "metres": metres, "files": []}
    (folder / FOLDER_MARK).unlink(missing_ok=True)
    text["files"] = sorted(_files_in(folder))
    (folder / FOLDER_MARK).write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")


def _signed(path: Path) -> bool:
    with path.open("rb") as file:
        if not os.fstat(file.fileno()).st_size:
            return False
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return content.find(signature(path).encode()) >= 0


def sign_file(path: Path) -> None:
    """Sign a file as its format allows, which its first bytes show: a JSON object, HTML, PNG or GeoPackage."""
    text = signature(path)
    with path.open("r+b") as file:
        start = file.read(16).lstrip()
        if start.startswith(b"SQLite format 3"):
            _sign_geopackage(path, text)
        elif start.startswith(b"\x89PNG"):
            end = file.seek(-12, os.SEEK_END)  # before IEND
            last = file.read()
            file.seek(end)
            content = b"tEXtSoftware\0" + text.encode()
            crc = zlib.crc32(content).to_bytes(4, "big")
            file.write((len(content) - 4).to_bytes(4, "big") + content + crc + last)
        elif start.startswith(b"{"):
            tail = file.seek(max(-64, -os.fstat(file.fileno()).st_size), os.SEEK_END)
            tail += file.read().rindex(b"}")
            file.seek(tail)
            file.write(f', "written_by": "{text}"}}\n'.encode())
        elif start.startswith(b"<"):
            file.seek(0, os.SEEK_END)
            file.write(f"<!-- {text} -->\n".encode())


def _sign_geopackage(path: Path, text: str) -> None:
    """Append the signature to the description of the first table, which is free text."""
    with closing(sqlite3.connect(path)) as file, file:
        file.execute(
            "UPDATE gpkg_contents SET description = trim(coalesce(description, '') || ' ' || ?) "
            "WHERE rowid = (SELECT min(rowid) FROM gpkg_contents)",
            (text,),
        )
