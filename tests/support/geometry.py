"""Point clouds, meshes, glTF scenes and a dense COLMAP workspace, a few points each."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path

import numpy as np

SPARSE = Path(__file__).parents[2] / "examples" / "sheffield" / "sparse"
XYZ = np.array([[1.0, 2, 3], [-4, 0.5, 6], [0, 0, -0.25]])


def ply(path: Path, form: str, fields: list[str], rows: np.ndarray, faces: bool = False) -> Path:
    header = ["ply", f"format {form} 1.0", "comment made by hand", f"element vertex {len(rows)}"]
    header += [f"property float {name}" for name in fields]
    header += ["element face 1", "property list uchar int vertex_indices"] if faces else []
    header = ("\n".join([*header, "end_header"]) + "\n").encode()
    if form == "ascii":
        body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode() + (b"3 0 1 2\n" if faces else b"")
    else:
        order = "<" if "little" in form else ">"
        body = rows.astype(order + "f4").tobytes() + (struct.pack(order + "B3i", 3, 0, 1, 2) if faces else b"")
    path.write_bytes(header + body)
    return path


def gltf(**more) -> dict:
    scene = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [1]}, {"nodes": [1, 0]}]}
    return {**scene, "nodes": [{"mesh": 0}, {"translation": [1, 0, 0], "children": [2]}, {"mesh": 0}], **more}


def glb(path: Path, text: dict, binary: bytes = b"\1\2\3\4") -> Path:
    chunk = json.dumps(text).encode()
    chunk += b" " * (-len(chunk) % 4)
    body = struct.pack("<II", len(chunk), 0x4E4F534A) + chunk + struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    return path


def dense_workspace(folder: Path) -> Path:
    (folder / "stereo" / "depth_maps").mkdir(parents=True)
    (folder / "stereo" / "normal_maps").mkdir()
    (folder / "images").mkdir()
    depth = np.array([[1, 0, 2.5], [3, 4, 5]], "<f4")
    for kind in ("geometric", "photometric"):
        (folder / "stereo/depth_maps" / f"a.jpg.{kind}.bin").write_bytes(b"3&2&1&" + depth.tobytes())
    (folder / "stereo/normal_maps/a.jpg.geometric.bin").write_bytes(b"1&1&3&" + bytes(12))
    (folder / "stereo/fusion.cfg").write_text("a.jpg\n")
    (folder / "images/a.jpg").write_bytes(b"jpeg")
    ply(folder / "fused.ply", "binary_little_endian", ["x", "y", "z", "nx", "ny", "nz"], np.hstack([XYZ, XYZ]))
    ply(folder / "meshed-poisson.ply", "ascii", ["x", "y", "z"], XYZ, faces=True)
    (folder / "fused.ply.vis").write_bytes(b"visibility")
    shutil.copytree(SPARSE, folder / "sparse")
    return folder
