"""Marks what orthoscale writes, to recognise it later: a signature in each file, a mark in each folder.

Only outputs of orthoscale may be replaced, as long as nobody edited them. A signature depends on the file's own name,
so that a user's working copy under another name is not taken for an output; after it stands the CRC-32 of the rest.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import re
import sqlite3
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from functools import cache
from itertools import chain, repeat
from pathlib import Path
from typing import Any, BinaryIO

from ..version import __version__
from .paths import homes

FOLDER_MARK = ".orthoscale.json"  # in every folder that orthoscale writes: what it is, and the files as it wrote them
CHANGED = "was changed since orthoscale wrote it"
NOT_OURS = "was not written by orthoscale under this name"
OF_SYSTEMS = (".DS_Store", "Thumbs.db", "desktop.ini")  # what macOS and Windows leave in folders that were looked at
OF_ROWS = "type = 'table' AND name NOT LIKE 'rtree%' AND name NOT LIKE 'sqlite%'"  # of tables with rows of their own
NOT_SUMMED = "0" * 8  # in place of the CRC-32 [hex] while a file is written
PNG_TEXT = b"tEXtSoftware\0"  # type and keyword of the chunk that signs a PNG
BLOCK_BYTES = 1 << 20  # [byte] that are read at once


def signature(path: str | Path) -> str:
    """The text that a file written by orthoscale contains: a hash of its own name, so that a renamed copy does not pass
    for an output."""
    name = os.fsencode(Path(path).name)
    return "orthoscale output " + hashlib.blake2b(name, digest_size=8).hexdigest()


def room(path: Path) -> str:
    """The signature for a file that is being written at `path`, with room for the CRC-32, which `sign_file` adds."""
    return f"{signature(path)} {NOT_SUMMED}"


def ours(path: Path) -> bool:
    """Whether orthoscale wrote `path`: a file, or a folder with nothing else in it."""
    return not why_not_ours(path)


def ours_in_a_folder(path: Path) -> bool:
    """Whether orthoscale wrote `path`, as a single file, edited since or not, or as a part of the folder that it lies
    in."""
    return is_signed(path) or _is_as_written(path, _listed(path.absolute().parent) or {}, path.name)


def why_not_ours(path: Path, mine: Callable[[Path], bool] | None = None) -> str:
    """Why `path` must not be replaced, as the end of a sentence; '' for what orthoscale wrote."""
    if path.is_symlink():
        return "is a symbolic link"
    if not (path.is_dir() or path.is_file()):
        return "is neither a file nor a folder"
    if path.is_dir():
        return _why_not_our_folder(path)
    try:
        with path.open("rb") as file:
            sums = _sums(file, path)
            known = mine(path) if mine else bool(sums)
            changed = known and _is_edited(path, file, sums)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    other = "is another kind of output of orthoscale" if sums else f"{NOT_OURS}, or was changed" if mine else NOT_OURS
    return CHANGED if changed else "" if known else other


def was_changed(folder: Path) -> bool:
    """Whether a file that orthoscale wrote into `folder` was changed since."""
    return any(written for _, written in _not_ours(folder))


def _why_not_our_folder(folder: Path) -> str:
    if _listed(folder) is None:
        return NOT_OURS
    for name, written in _not_ours(folder):
        return f"holds {name}, which {CHANGED if written else 'orthoscale did not write'}"
    return ""


def _not_ours(folder: Path) -> Iterator[tuple[str, bool]]:
    """The files in `folder` that are not as orthoscale wrote them, by the lists of the folder and of the outputs in it:
    the name of each, and whether orthoscale wrote it and it was changed since; without those OF_SYSTEMS."""
    listed = cache(_listed)
    for name in _files_in(folder):
        path = folder / name
        if path.name in OF_SYSTEMS or path.name.startswith("._"):  # the latter too are macOS's
            continue
        lists = [(home, listed(home)) for home in path.parents[: name.count("/") + 1]]
        own = [(path.relative_to(home).as_posix(), files) for home, files in lists if files is not None]
        if any(within == FOLDER_MARK or _is_as_written(path, files, within) for within, files in own) or ours(path):
            continue
        yield name, any(within in files for within, files in own)


def _listed(folder: Path) -> dict[str, str] | None:
    """The files that the mark of `folder` lists, each with its `_state` when it was written; None if it has no mark for
    a folder of this name."""
    mark = _mark(folder)
    files = mark.get("files")
    if not isinstance(files, dict) or mark.get("written_by") != signature(folder.absolute()):
        return None
    return {name: str(state) for name, state in files.items()}


def _mark(folder: Path) -> dict[str, Any]:
    """The mark of `folder`, which may be anybody's, such as that of /tmp; {} if there is none that can be read."""
    path = folder / FOLDER_MARK
    try:
        mark = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}  # a pipe would be waited for
    except (OSError, ValueError, RecursionError):
        return {}
    return mark if isinstance(mark, dict) else {}


def _is_as_written(path: Path, files: dict[str, str], name: str) -> bool:
    """Whether `files`, of `_listed`, has the file at `path` as `name`, and it is unchanged. Its content is compared
    only if its time of change is another, as of a copied folder."""
    if name not in files or path.is_symlink() or not path.is_file():
        return False
    state, now = files[name], path.stat()
    if state.startswith(_stamp(now)):
        return True
    return state.startswith(f"{now.st_size} ") and state.split()[-1] == _state(path).split()[-1]


def _state(path: Path) -> str:
    """Size [byte], time of change [ns] and CRC-32 of a file; of a GeoPackage that of what it says, since QGIS changes
    its bytes by opening it."""
    with path.open("rb") as file:
        there, crc = os.fstat(file.fileno()), _crc(file)
    if path.suffix.lower() == ".gpkg":
        with suppress(sqlite3.Error):
            crc = _said(path)
    return f"{_stamp(there)}{crc}"


def _said(path: Path, signed: str = "", plain: str = "") -> str:
    """CRC-32 [hex] of the rows of the GeoPackage `path`, its index apart, with `plain` where they have `signed`. Raises
    sqlite3.Error."""
    crc = 0
    with closing(_opened(path)) as database:
        tables = database.execute(f"SELECT name FROM sqlite_master WHERE {OF_ROWS} ORDER BY name").fetchall()
        for (name,) in tables:
            for row in database.execute('SELECT * FROM "{}"'.format(name.replace('"', '""'))):
                crc = zlib.crc32(ascii((name, *row)).replace(signed, plain).encode(), crc)
    return f"{crc:08x}"


def _opened(path: Path) -> sqlite3.Connection:
    """The GeoPackage `path`, only to read, so that no other file is made beside it."""
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)


def _is_edited(path: Path, file: BinaryIO, sums: dict[int, str]) -> bool:
    """Whether `file`, opened at `path`, says something else than when it was signed, as far as its signatures tell,
    after which `sums` stand: it may also have former ones, as a TIFF has in former directories."""
    if path.suffix.lower() == ".gpkg":
        return _is_edited_geopackage(path)
    return bool(sums) and all(crc != _crc(file, place) for place, crc in sums.items())


def _is_edited_geopackage(path: Path) -> bool:
    """Whether the GeoPackage says something else than when it was signed, which its description tells."""
    text = signature(path)
    try:
        with closing(_opened(path)) as database:
            told = "\n".join(value or "" for (value,) in database.execute("SELECT description FROM gpkg_contents"))
        found = re.search(f"{text} ([0-9a-f]{{8}})", told)
        return found is not None and found[1] != _said(path, found[0], text)
    except sqlite3.Error:
        return False


def _stamp(there: os.stat_result) -> str:
    return f"{there.st_size} {there.st_mtime_ns} "


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
            mark = _mark(folder)
            try:
                files = [folder / name for name in mark["files"]] if mark["metres"] is True else []
            except (KeyError, TypeError):
                continue
            if any(file.is_relative_to(place) and file.exists() for file in files):
                return True
    return False


def sign_folder(folder: Path, metres: bool = False) -> None:
    """Write the mark of a folder: its signature and the list of its files, each with its `_state`. metres : whether
    these have been scaled to metres."""
    (folder / FOLDER_MARK).unlink(missing_ok=True)
    files = {name: _state(folder / name) for name in sorted(_files_in(folder))}
    text = {"written_by": signature(folder), "version": __version__, "metres": metres, "files": files}
    (folder / FOLDER_MARK).write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")


def is_signed(path: Path) -> bool:
    """Whether the file has the signature of its name, edited since or not."""
    with path.open("rb") as file:
        return bool(_sums(file, path))


def _sums(file: BinaryIO, path: Path) -> dict[int, str]:
    """The CRC-32 that stands after each signature of the name of `path`, by its place in the file [byte]."""
    text = signature(path).encode()
    places, before, content = [], file.seek(0), b""
    while block := file.read(BLOCK_BYTES):
        kept = content[len(content) - len(text) + 1 :]
        before += len(content) - len(kept)
        content = kept + block
        found = content.find(text)  # several times as fast as a regular expression
        while found >= 0:
            places.append(before + found + len(text) + 1)
            found = content.find(text, found + 1)
    sums = {}
    for place in places:
        file.seek(place)
        sums[place] = file.read(len(NOT_SUMMED)).decode("latin-1")
    return sums


def _crc(file: BinaryIO, place: int | None = None) -> str:
    """CRC-32 [hex] of a file, without the one that stands at `place`; in a PNG, nor the one of the chunk it is in."""
    start, end = 0, 0
    if place is not None:
        file.seek(0)
        start, end = place, place + len(NOT_SUMMED) + 4 * file.read(4).startswith(b"\x89PNG")
    crc, here = 0, file.seek(0)
    while block := file.read(BLOCK_BYTES):
        crc = zlib.crc32(block[max(0, end - here) :], zlib.crc32(block[: max(0, start - here)], crc))
        here += len(block)
    return f"{crc:08x}"


def sign_file(path: Path) -> None:
    """Sign a file as its format allows: a GeoPackage, PNG, JSON object or HTML, which its first bytes show, or CSV. Of
    others the writer has left `room`, or they remain unsigned."""
    text = room(path)
    if path.suffix.lower() == ".csv":
        _sign_table(path, text)
    with path.open("r+b") as file:
        start = file.read(16).lstrip()
        if start.startswith(b"SQLite format 3"):
            _sign_geopackage(path)
            return
        elif start.startswith(b"\x89PNG"):
            end = file.seek(-12, os.SEEK_END)  # before IEND
            last = file.read()
            file.seek(end)
            content = PNG_TEXT + text.encode()
            file.write((len(content) - 4).to_bytes(4, "big") + content + bytes(4) + last)
        elif start.startswith(b"{"):
            tail = file.seek(max(-64, -os.fstat(file.fileno()).st_size), os.SEEK_END)
            tail += file.read().rindex(b"}")
            file.seek(tail)
            file.write(f', "written_by": "{text}"}}\n'.encode())
        elif start.startswith(b"<"):
            file.seek(0, os.SEEK_END)
            file.write(f"<!-- {text} -->\n".encode())
        place = next((place for place, crc in _sums(file, path).items() if crc == NOT_SUMMED), None)
        if place is not None:
            crc = _crc(file, place)
            file.seek(place)
            file.write(crc.encode())
            if start.startswith(b"\x89PNG"):
                file.write(zlib.crc32(PNG_TEXT + f"{signature(path)} {crc}".encode()).to_bytes(4, "big"))


def _sign_table(path: Path, text: str) -> None:
    """Sign a CSV in a column of its own, in the first row; in a table without rows, in its header."""
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    with path.open("w", newline="", encoding="utf-8") as file:
        cells = chain(["written_by", text] if rows else [text], repeat(""))
        csv.writer(file).writerows([*row, cell] for row, cell in zip([header, *rows], cells, strict=False))


def _sign_geopackage(path: Path) -> None:
    """Append the signature, and the CRC-32 of what the file then says, to the description of the first table, which is
    free text."""
    _describe(path, signature(path))
    _describe(path, _said(path))


def _describe(path: Path, more: str) -> None:
    """Append a word to the description of the first table of a GeoPackage."""
    with closing(sqlite3.connect(path)) as file, file:
        file.execute(
            "UPDATE gpkg_contents SET description = trim(coalesce(description, '') || ' ' || ?) "
            "WHERE rowid = (SELECT min(rowid) FROM gpkg_contents)",
            (more,),
        )
