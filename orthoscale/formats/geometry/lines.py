"""Points and meshes as lines of text: XYZ, PTS, OFF and the ASCII form of STL. Only lengths are changed.

These formats have no room for a mark.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from ...errors import InputError
from ..reading import EXPORT_ANEW
from .properties import left_as_they_are
from .words import grown

POINTS = (".xyz", ".xyzn", ".xyzrgb", ".pts")
COMMENTS = (b"#", b"//")
COORDINATES = ("x", "y", "z")  # the columns that are scaled
SURELY = 5  # points after which a first column that counts is not taken for coordinates
OFF_HEAD = re.compile(rb"(ST)?C?N?(4?n?)OFF(\s+BINARY)?\s*")


def scale_points(source: Path, target: Path, scale: float) -> list[str]:
    """Write the points in `source`, one per line, to `target` in metres; returns notes for the user. Their coordinates
    are the first three numbers of a line, or the columns x, y and z of a header line. Raises InputError, also if the
    first column seems to number the points."""
    count, numbered, columns = 0, True, _Columns()
    with source.open("rb") as file, target.open("wb") as out:
        for number, line, words, columns in _lines(file):
            if not words:
                out.write(line)
            else:
                numbered = numbered and not columns.names and _is_numbered(words, count)
                count += 1
                if numbered and count == SURELY:
                    raise InputError(
                        f"{source}: its first column seems to number the points",
                        "Name the columns in a first line (ID X Y Z ...), or leave the numbers out.",
                    )
                place = f"{source}, line {number}"
                out.write(_scaled(place, words, columns.coordinates, scale, columns.separator))
    if not count:
        raise InputError(f"{source}: no points in it", EXPORT_ANEW)
    return left_as_they_are([name for name in columns.names if name not in COORDINATES], scale)


def points_in_lines(path: Path) -> Iterator[list[float]]:
    """The points in the file `path`, one per line. Raises ValueError, IndexError for a malformed one."""
    with path.open("rb") as file:
        for _, _, words, columns in _lines(file):
            if words:
                yield [float(words[k]) for k in columns.coordinates]


@dataclass(frozen=True)
class _Columns:
    """Numbers of the columns x, y and z; names of all, if there is a line of them; what separates them, None for
    blanks."""

    coordinates: Sequence[int] = (0, 1, 2)
    names: Sequence[str] = ()
    separator: bytes | None = None


def _lines(file: BinaryIO) -> Iterator[tuple[int, bytes, list[bytes], _Columns]]:
    """Each line with its number, its words if it is a point (else none), and the columns."""
    columns, begun = _Columns(), False
    for number, line in enumerate(file, 1):
        words, between = _words(line, columns.separator)
        if not begun and words and set(COORDINATES) <= set(named := _named(words)):
            columns, words = _Columns([named.index(axis) for axis in COORDINATES], named, between), []
        elif not words or words[0].startswith(COMMENTS) or (len(words) == 1 and words[0].isdigit()):
            words = []  # PTS counts its points
        else:
            columns, begun = replace(columns, separator=between), True
        yield number, line, words, columns


def scale_off(source: Path, target: Path, scale: float) -> None:
    """Write the OFF mesh `source` to `target` in metres. Raises InputError."""
    with source.open("rb") as file, target.open("wb") as out:
        counts = _off_counts(source, file, out)
        for k in range(vertices := int(counts[0])):
            words = _kept(file, out).split()
            out.write(_scaled(f"{source}, vertex {k} of {vertices}", words, (0, 1, 2), scale))
        # If the file has several vertices per line, the lines scaled above included faces: then faces are missing here.
        faces = int(counts[1]) if len(counts) > 1 and counts[1].isdigit() else 0
        for k in range(faces):
            out.write(line := _kept(file, out))
            if not line:
                raise InputError(
                    f"{source}: only {k} of its {faces} faces are there", "Write one vertex or face per line."
                )
        shutil.copyfileobj(file, out, 1 << 20)


def vertices_of_off(path: Path) -> Iterator[list[float]]:
    """The vertices of the OFF mesh `path`. Raises InputError; ValueError for a malformed one."""
    with path.open("rb") as file:
        for _ in range(int(_off_counts(path, file)[0])):
            yield [float(word) for word in _kept(file).split()[:3]]


def _off_counts(path: Path, file: BinaryIO, out: BinaryIO | None = None) -> list[bytes]:
    """The numbers of vertices and faces, as the head of the OFF file `path` has them; it is copied to `out`. Raises
    InputError."""
    head = _kept(file, out)
    form = OFF_HEAD.match(head)
    if form is None or form[2] or form[3]:
        raise InputError(f"{path}: not an OFF text file in three dimensions", "Export it as plain OFF, or as PLY.")
    if out is not None:
        out.write(head)
    counts = head[form.end() :].split(b"#")[0].split()
    if not counts:
        line = _kept(file, out)
        if out is not None:
            out.write(line)
        counts = line.split()
    if not counts or not counts[0].isdigit():
        raise InputError(f"{path}: its number of vertices is missing", EXPORT_ANEW)
    return counts


def scale_ascii_stl(source: Path, target: Path, scale: float) -> None:
    """Write the STL text file `source` to `target` in metres. Raises InputError."""
    count = 0
    with source.open("rb") as file, target.open("wb") as out:
        for number, line in enumerate(file, 1):
            words = line.split()
            if words and words[0].lower() == b"vertex":
                count += 1
                line = b" ".join([b"vertex", _scaled(f"{source}, line {number}", words[1:], (0, 1, 2), scale)])
            out.write(line)
    if not count:
        raise InputError(f"{source}: no triangles in it", EXPORT_ANEW)


def corners_of_ascii_stl(path: Path) -> Iterator[list[float]]:
    """The corners of the triangles in the STL text file `path`. Raises ValueError for a malformed one."""
    with path.open("rb") as file:
        for words in map(bytes.split, file):
            if words and words[0].lower() == b"vertex":
                yield [float(word) for word in words[1:4]]


def _words(line: bytes, separator: bytes | None) -> tuple[list[bytes], bytes | None]:
    """The words of a line, and their separator: None for blanks. It is recognised if there are three words or more."""
    if separator is not None:
        return line.strip().split(separator), separator
    words = line.split()
    for mark in (b";", b","):  # a comma within a word is a decimal comma
        if line.count(mark) >= 2 and (len(words) < 3 or words[0].endswith(mark)):
            return line.strip().split(mark), mark
    return words, None


def _named(words: Sequence[bytes]) -> list[str]:
    """The names of columns, in lower case, if `words` is a line of them."""
    names = [word.strip(b'"/# \t').lower().decode("latin-1") for word in words]
    return [name for name in names if name] if words[0].strip() in COMMENTS else names


def _is_numbered(words: Sequence[bytes], count: int) -> bool:
    """Whether the line `words`, which follows `count` points, begins with the point's number instead of its x."""
    return len(words) > 3 and words[0] in (b"%d" % count, b"%d" % (count + 1)) and all(b"." in w for w in words[1:4])


def _kept(file: BinaryIO, out: BinaryIO | None = None) -> bytes:
    """The next line that is neither empty nor a comment; the lines before it are copied to `out`."""
    while line := file.readline():
        if line.strip() and not line.lstrip().startswith(b"#"):
            break
        if out is not None:
            out.write(line)
    return line


def _scaled(
    place: str, words: Sequence[bytes], columns: Sequence[int], scale: float, separator: bytes | None = None
) -> bytes:
    """A line of `words` with the lengths in `columns` times `scale`. Raises InputError."""
    try:
        return (separator or b" ").join(grown(words, columns, scale)) + b"\n"
    except (ValueError, IndexError) as error:
        if any(re.fullmatch(rb"[+-]?\d+,\d+", word) for word in words):
            raise InputError(f"{place}: numbers with decimal commas", "Export it again, with points (12.5).") from error
        raise InputError(f"{place}: three coordinates are missing or malformed", EXPORT_ANEW) from error
