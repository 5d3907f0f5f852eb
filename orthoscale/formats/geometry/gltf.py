"""glTF 2.0, as .glb or .gltf: every root gets a parent node with the scale, so that no buffer is changed.

That node scales all that is below it: meshes, skins, animations, quantised or compressed geometry. It does not affect
the centre that 3D Tiles add (CESIUM_RTC), nor the lengths of cameras, lights and transparent materials (glTF 2.0,
3.10.3; KHR_lights_punctual; KHR_materials_volume): these are scaled one by one.
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
GLB_HEAD = struct.Struct("<4sIIII")  # of a .glb: of the file, then of its JSON
A_SCENE = "a glTF scene"
WITHOUT_END = 3.4e38  # a length that would exceed this stays as it is: the largest 32-bit float stands for infinity
ATTENUATION = "attenuationDistance"  # of light in a material, in the world's unit (KHR_materials_volume)
CAMERA_LENGTHS = ("xmag", "ymag", "znear", "zfar")
NOT_BESIDE = ("data:", "http:", "https:")  # beginnings of URIs that are not files beside it


def scale_glb(source: Path, target: Path, scale: float) -> Referred:
    """Write the binary glTF `source` to `target` in metres; returns the buffers and images beside it that it refers to.
    Raises InputError, UsageError."""
    size = source.stat().st_size
    with source.open("rb") as file:
        head = file.read(GLB_HEAD.size)
        if len(head) < GLB_HEAD.size:
            raise InputError(f"{source}: {size} bytes, too few for a glTF file", EXPORT_ANEW)
        magic, version, announced, length, kind = GLB_HEAD.unpack(head)
        if magic != MAGIC or version != VERSION or kind != JSON_CHUNK:
            raise InputError(f"{source}: not a binary glTF 2.0 file", "Export it as glTF 2.0.")
        if announced != size or GLB_HEAD.size + length > size:
            raise InputError(f"{source}: {size} bytes, but its header says {announced}", EXPORT_ANEW)
        if length > HUGE:
            raise InputError(f"{source}: its JSON is larger than the {HUGE // MIB} MiB that it may have", EXPORT_ANEW)
        text = parsed(file.read(length), str(source), A_SCENE, EXPORT_ANEW)
        new = json.dumps(_scaled(source, text, scale), separators=(",", ":")).encode()
        new += b" " * (-len(new) % 4)
        with target.open("wb") as out:
            out.write(GLB_HEAD.pack(MAGIC, VERSION, size - length + len(new), len(new), JSON_CHUNK) + new)
            shutil.copyfileobj(file, out, 1 << 20)
    return _referred(source, text)


def scale_gltf(source: Path, target: Path, scale: float) -> Referred:
    """The same for a .gltf text file."""
    text = read_plain(source, A_SCENE, EXPORT_ANEW, HUGE)
    target.write_text(json.dumps(_scaled(source, text, scale), indent=1), encoding="utf-8")
    return _referred(source, text)


def _referred(source: Path, text: dict[str, Any]) -> Referred:
    told = [part.get("uri") or "" for part in (*text.get("buffers", []), *text.get("images", []))]
    # Names are percent-encoded (glTF 2.0, 2.8); not all exporters do so.
    names = [uri if beside(source, uri) else unquote(uri) for uri in told if not uri.startswith(NOT_BESIDE)]
    files = Referred()
    files.add(source, names)
    return files


def _scaled(path: Path, text: Any, scale: float) -> dict[str, Any]:
    """`text` with a scaling node above each root: the root nodes of scenes, and nodes without a parent, as a file need
    not have scenes."""
    from ..schemas.gltf import Gltf

    hint = "Export the mesh as a glTF 2.0 scene."
    checked(text, Gltf, str(path), A_SCENE, hint)
    asset, nodes, scenes = text["asset"], text.get("nodes", []), text.get("scenes", [])
    extras = asset.get("extras", {})
    if not isinstance(extras, dict):  # the format allows any value
        extras = {"extras": extras}
    if MARK in extras:
        refuse_marked(path)
    begun = {root for scene in scenes for root in scene.get("nodes", [])}
    if begun and max(begun) >= len(nodes):
        raise InputError(f"{path}: a scene refers to node {max(begun)}, which does not exist", hint)
    below = {child for node in nodes for child in node.get("children", [])}
    roots = sorted(begun | (set(range(len(nodes))) - below))
    if not roots:
        raise InputError(f"{path}: it has no nodes to scale", hint)
    above = {root: len(nodes) + k for k, root in enumerate(roots)}
    for scene in scenes:
        if "nodes" in scene:  # an empty list is not allowed
            scene["nodes"] = [above[root] for root in scene["nodes"]]
    nodes += [{"name": "metres", "scale": [scale] * 3, "children": [root]} for root in roots]
    extensions = text.get("extensions") or {}
    if centre := extensions.get("CESIUM_RTC"):
        centre["center"] = [value * scale for value in centre["center"]]
    views = [camera.get(kind) for camera in text.get("cameras", []) for kind in ("orthographic", "perspective")]
    lights = (extensions.get("KHR_lights_punctual") or {}).get("lights", [])
    volumes = [(each.get("extensions") or {}).get("KHR_materials_volume") for each in text.get("materials", [])]
    for part in (*views, *lights, *volumes):
        for name in (*CAMERA_LENGTHS, "range", ATTENUATION):
            if part and part.get(name) is not None and part[name] * scale < WITHOUT_END:
                part[name] *= scale
    asset["extras"] = {**extras, MARK: mark(scale)}
    return text
