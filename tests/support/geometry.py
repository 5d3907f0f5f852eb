"""Point clouds, meshes, glTF scenes and a dense COLMAP workspace, a few points each."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pycolmap

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


def dense_workspace(folder: Path, model: pycolmap.Reconstruction | None = None) -> Path:
    """With the undistorted `model`, or the example's, whose first image becomes ``a.jpg`` without points."""
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
    model = pycolmap.Reconstruction(SPARSE if model is None else model)
    image = model.image(min(model.reg_image_ids()))
    for seen in [k for k, point in enumerate(image.points2D) if point.has_point3D()]:
        model.delete_observation(image.image_id, seen)
    image.name = "a.jpg"  # which sees none of the points, so that any depths may be its
    (folder / "sparse").mkdir()
    model.write(folder / "sparse")
    return folder


PCD_ROW = np.dtype([("x", "<f4"), ("pad", "u1", 4), ("y", "<f8"), ("z", "<f4"), ("label", "<u2"), ("normal_x", "<f4")])


def pcd(form: str, body: bytes, points: int = 3) -> bytes:
    head = (
        "# .PCD v0.7 - Point Cloud Data\nVERSION 0.7\nFIELDS x _ y z label normal_x\nSIZE 4 1 8 4 2 4\n"
        "TYPE F U F F U F\n"
        f"COUNT 1 4 1 1 1 1\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {points}\nDATA {form}\n"
    )
    return head.encode() + body


def lzf(data: bytes, repeat: int = 0) -> bytes:
    """`data` compressed by LZF: as literals, its last `repeat` bytes (3 to 8) as a copy of the byte before them."""
    plain = data[: len(data) - repeat]
    out = b"".join(bytes([len(part) - 1]) + part for k in range(0, len(plain), 32) for part in [plain[k : k + 32]])
    return out + (bytes([(repeat - 2) << 5, 0]) if repeat else b"")


def pcd_body(form: str, rows: np.ndarray) -> bytes:
    """The data after the header of `pcd` for `rows` of PCD_ROW; in the compressed form the last 8 bytes are equal."""
    if form == "ascii":
        lines = [(r["x"], *r["pad"], r["y"], r["z"], r["label"], r["normal_x"]) for r in rows]
        return b"".join(b" ".join(str(v).encode() for v in line) + b"\n" for line in lines)
    if form == "binary":
        return rows.tobytes()
    packed = lzf(whole := b"".join(rows[name].tobytes() for name in PCD_ROW.names), repeat=8)
    return struct.pack("<II", len(packed), len(whole)) + packed


def las(user: bytes = b"", record: int = 0, content: bytes = b"", form: int = 3, extended: bool = False) -> bytes:
    """A LAS 1.4 file of one point, with one variable length record."""
    head = bytearray(375)
    head[:4], head[24:26], head[104] = b"LASF", b"\1\4", form
    struct.pack_into("<H", head, 94, 375)
    struct.pack_into("<I", head, 96, 1000)
    struct.pack_into("<12d", head, 131, 0.001, 0.001, 0.002, 10, 20, 30, *(11, 10, 21, 20, 31, 30))
    if extended:
        struct.pack_into("<QI", head, 235, 375, 1)
        return bytes(head) + struct.pack("<H16sHQ32x", 0, user, record, len(content)) + content + b"points"
    struct.pack_into("<I", head, 100, int(bool(user)))
    return (
        bytes(head) + (struct.pack("<H16sHH32x", 0, user, record, len(content)) + content if user else b"") + b"points"
    )
