"""Wavefront OBJ: vertices are scaled; faces, normals, textures and colours are unchanged."""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from ...errors import InputError
from ..reading import EXPORT_ANEW, read_bytes
from .beside import Referred, beside
from .mark import MARK, mark, refuse_marked
from .words import grown

TEXTURES = ("map_", "bump", "norm", "disp", "decal", "refl")  # beginnings of lines that name a picture, in materials
GOES_ON = re.compile(rb"\\\r?\n")  # the end of a line that is continued in the next one


def scale_obj(source: Path, target: Path, scale: float) -> Referred:
    """Write the OBJ file `source` to `target` in metres; returns the files that it refers to (materials, textures).

    Raises InputError for a malformed vertex or a file without any, UsageError for one in metres already.
    """
    materials: list[str] = []
    count = 0
    with source.open("rb") as file, target.open("wb") as out:
        out.write(f"# {mark(scale)}\n".encode())
        for number, line in _statements(file):
            if line.startswith(b"# " + MARK.encode()):
                refuse_marked(source)
            if number == 1:
                line = line.removeprefix(codecs.BOM_UTF8)
            whole = GOES_ON.sub(b" ", line)
            words = whole.split()
            if words[:1] == [b"v"]:
                count += 1
                try:
                    if b"\r" in whole.strip():
                        raise ValueError("several lines, as old Macs end them")
                    line = b" ".join(grown(words, (1, 2, 3), scale)) + b"\n"
                except (ValueError, IndexError) as error:
                    raise InputError(f"{source}, line {number}: a vertex is malformed", EXPORT_ANEW) from error
            elif words[:1] == [b"mtllib"] and len(words) > 1:
                materials += _libraries(source, os.fsdecode(whole.split(maxsplit=1)[1]).strip())
            out.write(line)
    if not count:
        raise InputError(f"{source}: no vertices (lines that start with v)", "Is this an OBJ file?")
    files = Referred()
    for material in files.add(source, materials):
        files.add(material, _textures(material))
    return files


def vertices_of_obj(path: Path) -> Iterator[list[float]]:
    """The vertices of the OBJ file `path`. Raises ValueError for a malformed one."""
    with path.open("rb") as file:
        for _, line in _statements(file):
            words = GOES_ON.sub(b" ", line).split()
            if words[:1] == [b"v"]:
                yield [float(word) for word in words[1:4]]


def _statements(file: Iterable[bytes]) -> Iterator[tuple[int, bytes]]:
    """Each statement of a file with the number of its first line. A backslash at the end of a line continues it, except
    in comments, which may end with a Windows path."""
    begun: list[bytes] = []
    number = 0
    for number, line in enumerate(file, 1):
        begun.append(line)
        if not GOES_ON.search(line) or begun[0].lstrip().startswith(b"#"):
            yield number + 1 - len(begun), b"".join(begun)
            begun = []
    if begun:
        yield number + 1 - len(begun), b"".join(begun)


def _libraries(source: Path, names: str) -> list[str]:
    """The names of material files: several on a line, or one that contains spaces."""
    return [names] if beside(source, names) else names.split()


def _textures(material: Path) -> list[str]:
    """The names of the pictures in a material file."""
    whole = GOES_ON.sub(b" ", read_bytes(material, "It is a list of materials."))
    text = os.fsdecode(whole)  # names need not be UTF-8
    return [_texture(material, line) for line in text.splitlines() if line.strip().lower().startswith(TEXTURES)]


def _texture(material: Path, line: str) -> str:
    """The name at the end of `line`, after options such as ``-s 1 1 1``; it may contain spaces."""
    ends = [line.split(maxsplit=k)[-1].strip() for k in range(1, len(line.split()))]
    return next((name for name in ends if beside(material, name)), ends[-1] if ends else "")
