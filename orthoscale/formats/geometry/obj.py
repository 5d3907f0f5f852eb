"""Wavefront OBJ: vertices are scaled; faces, normals, textures and colours are unchanged."""

from __future__ import annotations

from pathlib import Path

from ...errors import InputError
from ..reading import read_bytes
from .beside import beside
from .mark import MARK, mark, refuse_marked


def scale_obj(source: Path, target: Path, scale: float) -> list[Path]:
    """Write the OBJ file `source` to `target` in metres; returns the files that it refers to (materials, textures).

    Raises InputError for a malformed vertex or a file without any, UsageError for one in metres already.
    """
    materials: list[str] = []
    count = 0
    with source.open("rb") as file, target.open("wb") as out:
        out.write(f"# {mark(scale)}\n".encode())
        for number, line in enumerate(file, 1):
            if line.startswith(b"# " + MARK.encode()):
                refuse_marked(source)
            words = line.split()
            if words[:1] == [b"v"]:
                count += 1
                try:
                    xyz = [f"{float(words[k]) * scale:.10g}".encode() for k in (1, 2, 3)]
                except (ValueError, IndexError) as error:
                    raise InputError(
                        f"{source}, line {number}: a vertex is malformed", "Copy the file again, or export it anew."
                    ) from error
                line = b" ".join([b"v", *xyz, *words[4:]]) + b"\n"
            elif words[:1] == [b"mtllib"] and len(words) > 1:
                materials.append(line.split(maxsplit=1)[1].decode("utf-8", "replace").strip())
            out.write(line)
    if not count:
        raise InputError(f"{source}: no vertices (lines that start with v)", "Is this an OBJ file?")
    found = [path for name in materials if (path := beside(source, name)) is not None]
    return found + [texture for material in found for texture in _textures(material)]


def _textures(material: Path) -> list[Path]:
    lines = (
        line.split()
        for line in read_bytes(material, "It is a list of materials.").decode("utf-8", "replace").splitlines()
    )
    names = [words[-1] for words in lines if len(words) > 1 and words[0].lower().startswith(("map_", "bump", "norm"))]
    return [path for name in dict.fromkeys(names) if (path := beside(material, name)) is not None]
