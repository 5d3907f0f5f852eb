"""The vertices of a glTF 2.0 scene, where its nodes place them."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from scipy.spatial.transform import Rotation

from ...errors import InputError
from ..reading import EXPORT_ANEW, HUGE, decoded, read_bytes
from ..schemas.gltf import GltfGeometry, GltfPlacedNode
from .beside import beside
from .gltf import A_SCENE, GLB_HEAD
from .ply import ROWS

CHUNK_HEAD = 8  # [bytes] of the buffer that follows
FLOAT = 5126  # type of 32-bit numbers
ROW = 12  # [bytes] of three of these
DATA = "data:"


def vertices_of_gltf(path: Path) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the vertices of the meshes in the .glb or .gltf file `path`, each as often as it is placed;
    without compressed and quantised ones, and those that bones move. Raises InputError; ValueError, IndexError for a
    damaged one."""
    if path.suffix.lower() == ".glb":
        with path.open("rb") as file:
            *_, length, _ = GLB_HEAD.unpack(file.read(GLB_HEAD.size))
            text, start = file.read(length), GLB_HEAD.size + length + CHUNK_HEAD
    else:
        text, start = read_bytes(path, EXPORT_ANEW, HUGE), 0
    scene = decoded(text, GltfGeometry, str(path), A_SCENE, EXPORT_ANEW)
    for mesh, transform in _placed(scene):
        for primitive in scene.meshes[mesh].primitives:
            if (accessor := primitive.attributes.get("POSITION")) is not None and not primitive.extensions:
                rows = _rows(path, scene, accessor, start)
                for first in range(0, len(rows), ROWS):
                    yield rows[first : first + ROWS].astype(float) @ transform[:3, :3].T + transform[:3, 3]


def _placed(scene: GltfGeometry) -> Iterator[tuple[int, np.ndarray]]:
    """Each mesh with its (4, 4) transform to the scene, by the nodes above it."""
    root = np.eye(4)
    if scene.extensions is not None and scene.extensions.CESIUM_RTC is not None:
        root[:3, 3] = scene.extensions.CESIUM_RTC.center
    below = {child for node in scene.nodes for child in node.children}
    left = [(k, root) for k in range(len(scene.nodes)) if k not in below]
    seen: set[int] = set()
    while left:
        k, above = left.pop()
        if k in seen:  # a node has one place; a damaged file may have it below itself
            continue
        seen.add(k)
        node = scene.nodes[k]
        transform = above @ _own(node)
        left += [(child, transform) for child in node.children]
        if node.mesh is not None and node.skin is None:
            yield node.mesh, transform


def _own(node: GltfPlacedNode) -> np.ndarray:
    """(4, 4) transform of a node, from its own coordinates to those of the node above."""
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T
    own = np.eye(4)
    own[:3, :3] = Rotation.from_quat(node.rotation).as_matrix() * node.scale
    own[:3, 3] = node.translation
    return own


def _rows(path: Path, scene: GltfGeometry, number: int, embedded: int) -> np.ndarray:
    """(N, 3) numbers of the accessor `number`; none of one that is compressed or quantised. embedded : where the buffer
    in a .glb file begins [bytes]."""
    accessor = scene.accessors[number]
    view = None if accessor.bufferView is None else scene.bufferViews[accessor.bufferView]
    if view is None or view.extensions or accessor.sparse is not None or accessor.componentType != FLOAT:
        return np.empty((0, 3), "<f4")
    uri = scene.buffers[view.buffer].uri
    data: np.ndarray
    if uri is None:
        data = np.memmap(path, np.uint8, "r", embedded)
    elif uri.startswith(DATA):
        data = np.frombuffer(base64.b64decode(uri.partition(",")[2]), np.uint8)
    elif (file := beside(path, uri) or beside(path, unquote(uri))) is not None:
        data = np.memmap(file, np.uint8, "r")
    else:
        raise InputError(f"{path}: its buffer {uri} is not beside it", EXPORT_ANEW)
    strides = (view.byteStride or ROW, ROW // 3)
    return np.ndarray((accessor.count, 3), "<f4", data, view.byteOffset + accessor.byteOffset, strides)
