"""glTF 2.0, as .glb or .gltf: every scene gets a root node with the scale, so that no buffer is changed.

The root node applies to all that is below it: meshes, skins, animations, quantised or compressed geometry. Only the
centre that 3D Tiles add (CESIUM_RTC) is not below it.
"""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ...errors import InputError
from ..reading import EXPORT_ANEW, HUGE, MIB, checked, parsed, read_plain
from .beside import Referred, beside
from .mark import MARK, mark, refuse_marked

MAGIC, VERSION, JSON_CHUNK = b"glTF", 2, 0x4E4F534A
A_SCENE = "a glTF scene"
NOT_BESIDE = ("data:", "http:", "https:")  # how addresses begin that are of no file beside it


def scale_glb(source: Path, target: Path, scale: float) -> None:
    """Write the binary glTF `source` to `target` in metres. Raises InputError, UsageError."""
    size = source.stat().st_size
    with source.open("rb") as file:
        head = file.read(20)
        if len(head) < 20:
            raise InputError(f"{source}: {size} bytes are no glTF file", EXPORT_ANEW)
        magic, version, announced, length, kind = struct.unpack("<4sIIII", head)
        if magic != MAGIC or version != VERSION or kind != JSON_CHUNK:
            raise InputError(f"{source}: not a binary glTF 2.0 file", "Export it as glTF 2.0.")
        if announced != size or 20 + length > size:
            raise InputError(f"{source}: {size} bytes, but its header says {announced}", EXPORT_ANEW)
        if length > HUGE:
            raise InputError(f"{source}: its JSON is larger than the {HUGE // MIB} MiB that it may have", EXPORT_ANEW)
        text = parsed(file.read(length), str(source), A_SCENE, EXPORT_ANEW)
        new = json.dumps(_scaled(source, text, scale), separators=(",", ":")).encode()
        new += b" " * (-len(new) % 4)
        with target.open("wb") as out:
            out.write(struct.pack("<4sIIII", MAGIC, VERSION, size - length + len(new), len(new), JSON_CHUNK) + new)
            shutil.copyfileobj(file, out, 1 << 20)


def scale_gltf(source: Path, target: Path, scale: float) -> Referred:
    """The same for a .gltf text file; returns the buffers and images beside it that it refers to."""
    text = read_plain(source, A_SCENE, EXPORT_ANEW, HUGE)
    target.write_text(json.dumps(_scaled(source, text, scale), indent=1), encoding="utf-8")
    told = [part.get("uri") or "" for part in (*text.get("buffers", []), *text.get("images", []))]
    # Names are percent-encoded (glTF 2.0, 2.8); not all exporters do so.
    names = [uri if beside(source, uri) else unquote(uri) for uri in told if not uri.startswith(NOT_BESIDE)]
    files = Referred()
    files.add(source, names)
    return files


def _scaled(path: Path, text: Any, scale: float) -> dict[str, Any]:
    """`text` with one scaling node above each root node of its scenes."""
    from ..schemas import Gltf

    hint = "Export the mesh as a glTF 2.0 scene."
    checked(text, Gltf, str(path), A_SCENE, hint)
    asset, nodes, scenes = text["asset"], text["nodes"], text["scenes"]
    if MARK in (asset.get("extras") or {}):
        refuse_marked(path)
    above: dict[int, int] = {}
    for scene in scenes:
        for k, root in enumerate(scene.get("nodes", [])):
            if root >= len(nodes):
                raise InputError(f"{path}: a scene refers to node {root}, which does not exist", hint)
            if root not in above:  # a root that two scenes share stays shared
                above[root] = len(nodes) + len(above)
            scene["nodes"][k] = above[root]
    if not above:
        raise InputError(f"{path}: its scenes are empty", hint)
    nodes += [{"name": "metres", "scale": [scale] * 3, "children": [root]} for root in above]
    if centre := (text.get("extensions") or {}).get("CESIUM_RTC"):  # outside of all nodes
        centre["center"] = [value * scale for value in centre["center"]]
    asset["extras"] = {**(asset.get("extras") or {}), MARK: mark(scale)}
    return text
