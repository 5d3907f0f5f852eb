"""Files handed on in metres: what has a length grows, everything else stays byte for byte."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from support.geometry import PCD_ROW, SPARSE, XYZ, dense_workspace, glb, gltf, las, lzf, pcd, pcd_body, ply

from orthoscale.actions.apply import apply
from orthoscale.cli.main import cli
from orthoscale.errors import InputError, OrthoscaleError, UsageError
from orthoscale.formats.geometry.files import scale_file
from orthoscale.formats.geometry.ply import read_points
from orthoscale.formats.geometry.sim3 import Sim3
from orthoscale.sources.scaling import scale_path

SCALE = 14.157


# --- Files made here -------------------------------------------------------------------------------------------------


def read_ply(path: Path, fields: int) -> tuple[np.ndarray, bytes]:
    """Vertices of floats, and what follows them."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    count = int(head.split(b"element vertex ")[1].split()[0])
    if b"format ascii" in head:
        lines = body.splitlines(keepends=True)
        return np.array([line.split() for line in lines[:count]], float), b"".join(lines[count:])
    order = "<" if b"little" in head else ">"
    size = 4 * fields * count
    return np.frombuffer(body[:size], order + "f4").reshape(count, fields), body[size:]


def world_points(text: dict, scene: int) -> list[float]:
    """Where the origin of each mesh node of a scene ends up, along x, and its size: scale and shift only."""
    out = []

    def walk(index: int, factor: float, shift: float) -> None:
        node = text["nodes"][index]
        shift += factor * node.get("translation", [0])[0]
        factor *= node.get("scale", [1])[0]
        if "mesh" in node:
            out.append((factor, shift))
        for child in node.get("children", []):
            walk(child, factor, shift)

    for root in text["scenes"][scene]["nodes"]:
        walk(root, 1, 0)
    return out


# --- PLY -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply(tmp_path, form):
    fields = ["nx", "x", "y", "z", "red"]
    rows = np.column_stack([[0.5, 1, 0], XYZ, [10, 20, 30]])
    source = ply(tmp_path / "a.ply", form, fields, rows, faces=True)
    before = source.read_bytes()
    scale_path(source, tmp_path / "b.ply", SCALE)
    assert source.read_bytes() == before
    new, rest = read_ply(tmp_path / "b.ply", 5)
    assert np.allclose(new[:, 1:4], SCALE * XYZ, rtol=1e-6) and (new[:, [0, 4]] == rows[:, [0, 4]]).all()
    assert rest == read_ply(source, 5)[1] != b""
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "b.ply", tmp_path / "c.ply", SCALE)


@pytest.mark.parametrize("order", ["<", ">"])
def test_whole_numbers_of_64_bit_stay(tmp_path, order):
    """Such a header was "damaged or cut off"."""
    row = np.dtype([("x", order + "f4"), ("y", order + "f4"), ("z", order + "f4"), ("t", order + "u8")])
    names = "".join(f"property {'uint64' if name == 't' else 'float'} {name}\n" for name in row.names)
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    head = f"ply\nformat {form} 1.0\nelement vertex 2\n{names}end_header\n".encode()
    (tmp_path / "a.ply").write_bytes(head + np.array([(1, 2, 3, 2**63 + 1), (4, 5, 6, 7)], row).tobytes())
    scale_path(tmp_path / "a.ply", tmp_path / "b.ply", 2.0)
    new = np.frombuffer((tmp_path / "b.ply").read_bytes().split(b"end_header\n")[1], row)
    assert new["t"].tolist() == [2**63 + 1, 7] and new["z"].tolist() == [6, 12]


def test_a_splat_keeps_its_shape(tmp_path):
    fields = ["x", "y", "z", "f_dc_0", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    rows = np.random.default_rng(0).normal(size=(5, len(fields))).astype(np.float32)
    scale_path(
        ply(tmp_path / "a.ply", "binary_little_endian", fields, rows), out := tmp_path / "b.ply", SCALE
    )  # fmt: skip
    new = read_ply(out, len(fields))[0]
    assert np.allclose(new[:, :3], SCALE * rows[:, :3], rtol=1e-6)
    assert np.allclose(np.exp(new[:, 5:8]), SCALE * np.exp(rows[:, 5:8]), rtol=1e-5)
    assert (new[:, [3, 4, 8, 9, 10, 11]] == rows[:, [3, 4, 8, 9, 10, 11]]).all()


def test_a_cloud_larger_than_a_chunk(tmp_path, monkeypatch):
    monkeypatch.setattr("orthoscale.formats.geometry.ply.ROWS", 7)
    rows = np.random.default_rng(0).normal(size=(50, 3))
    scale_path(ply(tmp_path / "a.ply", "binary_little_endian", ["x", "y", "z"], rows), tmp_path / "b.ply", 2)
    assert np.allclose(read_ply(tmp_path / "b.ply", 3)[0], 2 * rows, rtol=1e-6)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_damaged_ply(tmp_path, form):
    source = ply(tmp_path / "a.ply", form, ["x", "y", "z"], XYZ, faces=form != "ascii")
    whole = source.read_bytes()
    for size in range(0, len(whole) - 20, 7):
        source.write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"a\.ply"):
            scale_path(source, tmp_path / "b.ply", SCALE)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nproperty int y\nproperty int z\n", "whole number"),
        ("ply\nformat ascii 1.0\nelement chunk 1\nproperty float min_x\n", "no vertices with x, y and z"),
        ("ply\nformat ascii 1.0\nelement vertex -1\nproperty float x\n", "negative"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\n", "not a PLY header"),
        ("ply\nformat ascii 1.0\nelement vertex one\n", r"line 3: not a PLY header \(values of a wrong kind"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar float x\n", "no vertices|lists"),
    ],
)
def test_strange_ply(tmp_path, header, said):
    (tmp_path / "a.ply").write_text(header + "end_header\n1 2 3\n")
    with pytest.raises(InputError, match=said):
        scale_path(tmp_path / "a.ply", tmp_path / "b.ply", 2)


def test_a_ply_whose_last_line_was_cut_off(tmp_path):
    source = ply(tmp_path / "a.ply", "ascii", ["x", "y", "z", "nx"], np.full((2, 4), 0.123456789))
    source.write_bytes(source.read_bytes()[:-13])
    with pytest.raises(InputError, match="vertex 1 of 2 is missing or malformed"):
        scale_path(source, tmp_path / "b.ply", 2)


@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
@pytest.mark.parametrize("first", [True, False])  # as MeshLab and as PCL order them
def test_the_camera_of_a_ply_moves_with_its_points(tmp_path, form, first):
    names = ["view_px", "view_py", "view_pz", "x_axisx", "focal"]
    parts = [("vertex", ["x", "y", "z"], XYZ), ("camera", names, np.array([[4, 5, 6, 1, 35.0]]))][:: -1 if first else 1]
    head = ["ply", f"format {form} 1.0"]
    for name, fields, rows in parts:
        head += [f"element {name} {len(rows)}", *(f"property float {field}" for field in fields)]
    rows = [row for _, _, rows in parts for row in rows]
    body = b"".join(
        " ".join(map(str, r)).encode() + b"\n" if form == "ascii" else r.astype(">f4").tobytes() for r in rows
    )
    (tmp_path / "a.ply").write_bytes("\n".join([*head, "end_header\n"]).encode() + body)
    scale_path(tmp_path / "a.ply", tmp_path / "b.ply", 2)
    body = (tmp_path / "b.ply").read_bytes().split(b"end_header\n")[1]
    values = np.array(body.split(), float) if form == "ascii" else np.frombuffer(body, ">f4")
    camera, points = (values[:5], values[5:]) if first else (values[9:], values[:9])
    assert camera == pytest.approx([8, 10, 12, 1, 35]) and points == pytest.approx(2 * XYZ.ravel())


# --- Meshes ----------------------------------------------------------------------------------------------------------


def test_obj_with_its_materials(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    source = tmp_path / "in" / "a.obj"
    source.write_text("mtllib a.mtl\nv 1 2 3 0.5 0.5 0.5\nv -1e-3 0 2\nvt 0.5 0.5\nvn 0 0 1\nf 1/1/1 2/1/1 1/1/1\n")
    (tmp_path / "in/a.mtl").write_text("newmtl a\nmap_Kd tex.png\n")
    (tmp_path / "in/tex.png").write_bytes(b"png")
    scale_path(source, tmp_path / "out/a.obj", 2.5)
    lines = (tmp_path / "out/a.obj").read_text().splitlines()
    assert lines[2] == "v 2.5 5 7.5 0.5 0.5 0.5" and lines[3] == "v -0.0025 0 5"
    assert lines[4:] == source.read_text().splitlines()[3:]
    assert (tmp_path / "out/tex.png").read_bytes() == b"png" and (tmp_path / "out/a.mtl").is_file()
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "out/a.obj", tmp_path / "b.obj", 2)
    source.write_text("v 1 2\n")
    with pytest.raises(InputError, match="line 1"):
        scale_path(source, tmp_path / "b.obj", 2)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines_of_an_obj_that_go_on_in_the_next(tmp_path, end):
    """A backslash at the end says so. A vertex of two lines was refused as malformed, and of materials in two lines the
    second was not copied."""
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    for name in ("a.mtl", "b.mtl", "tex.png"):
        (tmp_path / "in" / name).write_text(f"map_Kd -s 1 1 1 \\{end}tex.png{end}")
    lines = [
        "# of C:\\scans\\",  # goes on in no other
        "v 1 \\", "2 \\", " 3",
        "mtllib a.mtl \\", "b.mtl",
        "v 1 1 1 \\", "0.5 0.5 0.5",
        "f 1 2 \\", "2",
        "v 4 5 x",
    ]  # fmt: skip
    source = tmp_path / "in/a.obj"
    source.write_bytes(end.join(lines[:-1]).encode())
    notes = scale_path(source, tmp_path / "out/a.obj", 2)
    head, *told = (tmp_path / "out/a.obj").read_bytes().decode().split("\n")
    assert [line.rstrip("\r") for line in told] == [
        lines[0], "v 2 4 6", *lines[4:6], "v 2 2 2 0.5 0.5 0.5", *lines[8:10],
    ]  # fmt: skip
    assert sorted(notes) == ["with a.mtl", "with b.mtl", "with tex.png"]
    source.write_bytes(end.join(lines).encode())
    with pytest.raises(InputError, match="line 11"):
        scale_path(source, tmp_path / "out/b.obj", 2)


def test_glb(tmp_path):
    source = glb(tmp_path / "a.glb", gltf())
    scale_path(source, tmp_path / "b.glb", 2.5)
    data = (tmp_path / "b.glb").read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sIIII", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), 0x4E4F534A) and length % 4 == 0
    text = json.loads(data[20 : 20 + length])
    assert data[20 + length :] == struct.pack("<II", 4, 0x004E4942) + b"\1\2\3\4"
    assert world_points(gltf(), 1) == [(1, 1), (1, 0)]
    assert world_points(text, 0) == [(2.5, 2.5)] and world_points(text, 1) == [(2.5, 2.5), (2.5, 0)]
    parents = [child for node in text["nodes"] for child in node.get("children", [])]
    assert len(parents) == len(set(parents)), "no node has two parents"
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "b.glb", tmp_path / "c.glb", 2)


def test_gltf_with_its_buffer(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "in/a.bin").write_bytes(b"1234")
    (tmp_path / "in/a.gltf").write_text(json.dumps(gltf(buffers=[{"uri": "a.bin"}, {"uri": "data:,x"}])))
    scale_path(tmp_path / "in/a.gltf", tmp_path / "out/a.gltf", 3)
    assert (tmp_path / "out/a.bin").read_bytes() == b"1234"
    assert world_points(json.loads((tmp_path / "out/a.gltf").read_text()), 0) == [(3, 3)]


def test_a_glb_with_files_beside_it(tmp_path):
    """It may have its pictures, and more buffers, outside of itself."""
    home = written(tmp_path / "in", **{"tex.png": b"png", "b.bin": b"1234"})
    glb(
        home / "a.glb",
        gltf(buffers=[{"byteLength": 4}, {"uri": "b.bin"}], images=[{"uri": "tex.png"}, {"uri": "x.png"}]),
    )
    out, notes = applied(tmp_path, home / "a.glb")
    assert notes == ["with b.bin", "with tex.png", "refers to x.png, which is not beside it"]
    assert (out / "tex.png").read_bytes() == b"png" and (out / "b.bin").read_bytes() == b"1234"


def test_the_centre_of_3d_tiles_grows_as_well(tmp_path):
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(extensions={"CESIUM_RTC": {"center": [1, 2, 3]}, "other": 1})))
    scale_path(tmp_path / "a.gltf", tmp_path / "b.gltf", 2)
    assert json.loads((tmp_path / "b.gltf").read_text())["extensions"] == {
        "CESIUM_RTC": {"center": [2, 4, 6]}, "other": 1
    }  # fmt: skip


def test_what_gltf_cameras_and_lights_say_of_themselves_grows_as_well(tmp_path):
    """No node's scale acts on it."""
    views = [{"orthographic": {"xmag": 3, "ymag": 2, "znear": 0, "zfar": 50}}, {"perspective": {"yfov": 1, "znear": 1}}]
    lights = {"lights": [{"type": "spot", "range": 10, "spot": {"outerConeAngle": 1}}, {"type": "point"}]}
    text = gltf(cameras=views, extensions={"KHR_lights_punctual": lights})
    (tmp_path / "a.gltf").write_text(json.dumps(text))
    scale_path(tmp_path / "a.gltf", tmp_path / "b.gltf", 2)
    new = json.loads((tmp_path / "b.gltf").read_text())
    assert new["cameras"] == [
        {"orthographic": {"xmag": 6, "ymag": 4, "znear": 0, "zfar": 100}}, {"perspective": {"yfov": 1, "znear": 2}}
    ]  # fmt: skip
    assert new["extensions"]["KHR_lights_punctual"] == {
        "lights": [{"type": "spot", "range": 20, "spot": {"outerConeAngle": 1}}, {"type": "point"}]
    }
    (tmp_path / "e.gltf").write_text(json.dumps(gltf(cameras=[{"perspective": {"znear": 1, "zfar": 3.4028235e38}}])))
    scale_path(tmp_path / "e.gltf", tmp_path / "f.gltf", 2)
    endless = json.loads((tmp_path / "f.gltf").read_text())["cameras"][0]["perspective"]
    assert endless == {"znear": 2, "zfar": 3.4028235e38}
    (tmp_path / "c.gltf").write_text(json.dumps(gltf(cameras=[{"perspective": {"znear": "near"}}])))
    with pytest.raises(InputError, match="znear"):
        scale_path(tmp_path / "c.gltf", tmp_path / "d.gltf", 2)


def test_light_in_clear_materials_goes_as_far_as_before(tmp_path):
    """In the world's unit, where the thickness is that of the mesh."""
    clear = {"KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 3}}
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(materials=[{"extensions": clear}, {"name": "dull"}])))
    scale_path(tmp_path / "a.gltf", tmp_path / "b.gltf", 2)
    new = json.loads((tmp_path / "b.gltf").read_text())["materials"]
    assert new[0]["extensions"]["KHR_materials_volume"] == {"thicknessFactor": 1, "attenuationDistance": 6}
    assert new[1] == {"name": "dull"}
    (tmp_path / "c.gltf").write_text(json.dumps(gltf(materials=[3])))
    with pytest.raises(InputError, match="materials"):
        scale_path(tmp_path / "c.gltf", tmp_path / "d.gltf", 2)


def test_gltf_without_scenes_and_with_a_note_of_its_author(tmp_path):
    text = gltf(asset={"version": "2.0", "extras": "by hand"})
    del text["scenes"]
    (tmp_path / "a.gltf").write_text(json.dumps(text))
    scale_path(tmp_path / "a.gltf", tmp_path / "b.gltf", 2)
    new = json.loads((tmp_path / "b.gltf").read_text())
    assert new["asset"]["extras"]["extras"] == "by hand" and "scenes" not in new
    assert world_points({**new, "scenes": [{"nodes": [3, 4]}]}, 0) == [(2, 0), (2, 2)]
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "b.gltf", tmp_path / "c.gltf", 2)


def test_damaged_glb(tmp_path):
    whole = glb(tmp_path / "a.glb", gltf()).read_bytes()
    damaged = [whole[:k] for k in (0, 3, 15, 40, len(whole) - 1)] + [b"glXX" + whole[4:], whole + b"\0"]
    for text in (
        {},
        {"asset": {}, "nodes": [], "scenes": []},
        gltf(scenes=[{"nodes": [9]}]),
        gltf(nodes=None),
        gltf(extensions={"CESIUM_RTC": {"center": [1]}}),
    ):
        damaged.append(glb(tmp_path / "t.glb", text).read_bytes())
    for data in damaged:
        (tmp_path / "a.glb").write_bytes(data)
        with pytest.raises(InputError, match=r"a\.glb"):
            scale_path(tmp_path / "a.glb", tmp_path / "b.glb", 2)


STL = (
    "solid a vertex\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   VERTEX 1 0 -2e-1\n   vertex 0 1 0\n"
    "  endloop\n endfacet\nendsolid\n"
)


@pytest.mark.parametrize("head", [b"made by a program", b"solid, but binary"])
def test_stl(tmp_path, head):
    (tmp_path / "a.stl").write_text(STL)
    scale_path(tmp_path / "a.stl", tmp_path / "b.stl", 2.5)
    new = (tmp_path / "b.stl").read_text()
    assert [line.split()[1:] for line in new.splitlines() if line.startswith("vertex")] == [
        ["0", "0", "0"], ["2.5", "0", "-0.5"], ["0", "2.5", "0"]
    ]  # fmt: skip
    assert "facet normal 0 0 1" in new and new.startswith("solid a vertex\n")

    triangle = struct.pack("<12fH", 0, 0, 1, *range(9), 0xABCD)
    (tmp_path / "c.STL").write_bytes(head.ljust(80) + struct.pack("<I", 2) + 2 * triangle)
    scale_path(tmp_path / "c.STL", tmp_path / "d.stl", 2.5)
    data = (tmp_path / "d.stl").read_bytes()
    assert struct.unpack_from("<12fH", data, 134) == (0, 0, 1, *(2.5 * k for k in range(9)), 0xABCD)
    for damaged in (data[:-1], b"", b"solid\n", b"solid\nvertex 1 2\n"):
        (tmp_path / "c.STL").write_bytes(damaged)
        with pytest.raises(InputError, match=r"c\.STL"):
            scale_path(tmp_path / "c.STL", tmp_path / "e.stl", 2)


def test_off(tmp_path):
    (tmp_path / "a.off").write_text(
        "# by hand\nCOFF\n# counts\n3 1 0\n\n1 2 3 255 0 0 255\n# a comment\n4 5 6\n7 8 9\n3 0 1 2\n"
    )
    scale_path(tmp_path / "a.off", tmp_path / "b.off", 2)
    lines = (tmp_path / "b.off").read_text().splitlines()
    assert [line for line in lines if line and line[0] != "#"] == [
        "COFF", "3 1 0", "2 4 6 255 0 0 255", "8 10 12", "14 16 18", "3 0 1 2"
    ]  # fmt: skip
    (tmp_path / "a.off").write_text("OFF 1 0 0\n1 2 3\n")
    scale_path(tmp_path / "a.off", tmp_path / "b.off", 2)
    assert (tmp_path / "b.off").read_text() == "OFF 1 0 0\n2 4 6\n"
    (tmp_path / "a.off").write_text("OFF 1\n1 2 3\n")  # a cloud whose writer counts nothing but vertices
    scale_path(tmp_path / "a.off", tmp_path / "b.off", 2)
    assert (tmp_path / "b.off").read_text() == "OFF 1\n2 4 6\n"
    for damaged in (
        "4OFF\n1 0 0\n1 2 3 1\n",
        "OFF BINARY\n",
        "OFF\n2 0 0\n1 2 3\n",
        "OFF\n4 4 6\n0 0 0 1 0 0\n0 1 0 0 0 1\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n",
        "OFF\n-1 0 0\n1 2 3\n",
        "",
        "1 2 3\n",
    ):
        (tmp_path / "a.off").write_text(damaged)
        with pytest.raises(InputError, match=r"a\.off"):
            scale_path(tmp_path / "a.off", tmp_path / "c.off", 2)


@pytest.mark.parametrize(
    ("name", "text", "new"),
    [
        ("a.xyz", "1 2 3 7,8,9\n", "2 4 6 7,8,9\n"),  # commas within a word part no columns
        ("a.xyz", "1 2 3 255 0 0\n4\t5 6\r\n", "2 4 6 255 0 0\n8 10 12\n"),
        ("a.xyz", "// a, b, c\n1.5,-2,3e1,7\n", "// a, b, c\n3,-4,60,7\n"),
        ("a.xyz", "//R,G,B,X,Y,Z\n9,8,7,1,2,3\n", "//R,G,B,X,Y,Z\n9,8,7,2,4,6\n"),  # CloudCompare's names
        ("a.xyzrgb", '"ID" "X" "Y" "Z"\n5 1 2 3\n', '"ID" "X" "Y" "Z"\n5 2 4 6\n'),
        ("a.xyzn", "# made by hand\n\n1; 2; 3; 0; 0; 1\n", "# made by hand\n\n2;4;6; 0; 0; 1\n"),
        ("a.pts", "2\n1 2 3 -1200 9 9 9\n4 5 6 0 9 9 9\n", "2\n2 4 6 -1200 9 9 9\n8 10 12 0 9 9 9\n"),
    ],
)
def test_points_in_lines(tmp_path, name, text, new):
    (tmp_path / name).write_bytes(text.encode())
    scale_path(tmp_path / name, tmp_path / f"b{name}", 2)
    assert (tmp_path / f"b{name}").read_text() == new


@pytest.mark.parametrize("text", ["", "# nothing\n", "1 2\n", "3\nwater\nO 0 0 0\n", "1,5 2,5 3,5\n", "E N H\n1 2 3\n"])
def test_points_that_are_none(tmp_path, text):
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(InputError, match=r"a\.xyz"):
        scale_path(tmp_path / "a.xyz", tmp_path / "b.xyz", 2)


@pytest.mark.parametrize("text", ["1,5 2,5 3,5\n", "1,5;2;3,5\n"])
def test_decimal_commas_are_named(tmp_path, text):
    """It was said that the file is damaged."""
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(InputError, match="line 1: numbers with decimal commas"):
        scale_path(tmp_path / "a.xyz", tmp_path / "b.xyz", 2)


@pytest.mark.parametrize("first", [0, 1])
def test_points_that_are_numbered(tmp_path, first):
    lines = [f"{first + k} {k}.5 2.5 3.5" for k in range(9)]
    for many in (5, 9):  # five are enough
        (tmp_path / "a.xyz").write_text("\n".join(lines[:many]) + "\n")
        with pytest.raises(InputError, match="seems to number the points"):
            scale_path(tmp_path / "a.xyz", tmp_path / "b.xyz", 2)
    (tmp_path / "c.xyz").write_text("\n".join(["ID X Y Z", *lines]) + "\n")
    scale_path(tmp_path / "c.xyz", tmp_path / "d.xyz", 2)
    assert (tmp_path / "d.xyz").read_text().splitlines()[2] == f"{first + 1} 3 5 7"
    # Five points whose x only happen to count.
    (tmp_path / "e.xyz").write_text("\n".join(lines[:4] + ["7 4.5 2.5 3.5"]) + "\n")
    scale_path(tmp_path / "e.xyz", tmp_path / "f.xyz", 2)
    # A profile whose x counts: there is no column beside the coordinates that could be a number.
    (tmp_path / "g.xyz").write_text("\n".join(f"{first + k} 2.5 3.5" for k in range(9)) + "\n")
    scale_path(tmp_path / "g.xyz", tmp_path / "h.xyz", 2)
    assert (tmp_path / "h.xyz").read_text().splitlines()[2] == f"{2 * (first + 2)} 5 7"


def test_splats_of_32_bytes(tmp_path):
    rows = [struct.pack("<6f8B", *(k + np.arange(6)), *range(8)) for k in range(3)]
    (tmp_path / "a.splat").write_bytes(b"".join(rows))
    scale_path(tmp_path / "a.splat", tmp_path / "b.splat", 2)
    assert struct.unpack_from("<6f8B", (tmp_path / "b.splat").read_bytes(), 64) == (4, 6, 8, 10, 12, 14, *range(8))
    for damaged in (b"", rows[0][:-1]):
        (tmp_path / "a.splat").write_bytes(damaged)
        with pytest.raises(InputError, match=r"a\.splat"):
            scale_path(tmp_path / "a.splat", tmp_path / "b.splat", 2)


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path, form, monkeypatch):
    monkeypatch.setattr("orthoscale.formats.geometry.pcd.ROWS", 2)
    rows = np.zeros(3, PCD_ROW)
    rows["x"], rows["y"], rows["z"], rows["label"], rows["pad"] = [1, 2, 3], [4, 5, 6], [-7, 8, 9], [1, 65535, 2], 9
    body = pcd_body(form, rows)
    (tmp_path / "a.pcd").write_bytes(pcd(form, body))
    scale_path(tmp_path / "a.pcd", tmp_path / "b.pcd", 2)
    head, _, data = (tmp_path / "b.pcd").read_bytes().partition(b"\nDATA ")
    assert b"VIEWPOINT 2 4 6 1 0 0 0" in head
    if form == "ascii":
        numbers = [line.split() for line in data.splitlines()[1:]]
        assert [[float(n[k]) for k in (0, 5, 6)] for n in numbers] == [[2, 8, -14], [4, 10, 16], [6, 12, 18]]
        assert [n[7] for n in numbers] == [b"1", b"65535", b"2"] and numbers[0][1] == b"9"
    else:
        new = np.frombuffer(data.removeprefix(b"binary\n"), PCD_ROW)
        for name in PCD_ROW.names:
            assert (new[name] == rows[name] * (2 if name in "xyz" else 1)).all()
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "b.pcd", tmp_path / "c.pcd", 2)
    if form == "binary_compressed":
        body = b"\xff" * 4 + body[4:]  # so many bytes
    wide = pcd(form, body).replace(b"COUNT 1 4", b"COUNT 1 4000000000000")
    narrow = pcd(form, body).replace(b"COUNT 1 4 1", b"COUNT 1 4 0")
    for damaged in (
        pcd(form, body[:-9]),
        pcd(form, body, 10**7),
        pcd("zip", body),
        wide,
        narrow,
        b"# .PCD\nFIELDS x\n",
    ):
        (tmp_path / "a.pcd").write_bytes(damaged)
        with pytest.raises(InputError, match=r"a\.pcd"):
            scale_path(tmp_path / "a.pcd", tmp_path / "d.pcd", 2)


def test_a_compressed_pcd_repeats_long_pieces_of_long_before(tmp_path):
    """As PCL's files of thousands of points do: here all 80 bytes of a field are those of one 440 bytes before."""
    rows = np.zeros(20, PCD_ROW)
    for name in PCD_ROW.names[:-1]:
        rows[name] = np.random.default_rng(1).integers(0, 250, rows[name].shape)
    rows["normal_x"] = rows["x"]
    whole = b"".join(rows[name].tobytes() for name in PCD_ROW.names)
    literal, copy = lzf(whole[:440]), bytes([7 << 5 | 439 >> 8, 80 - 2 - 7, 439 & 255])

    def body(packed):
        return struct.pack("<II", len(packed), len(whole)) + packed

    (tmp_path / "a.pcd").write_bytes(pcd("binary_compressed", body(literal + copy), 20))
    scale_path(tmp_path / "a.pcd", tmp_path / "b.pcd", 2)
    data = (tmp_path / "b.pcd").read_bytes().partition(b"\nDATA binary\n")[2]
    new = np.frombuffer(data, PCD_ROW)
    assert (
        (new["normal_x"] == rows["x"]).all() and (new["x"] == 2 * rows["x"]).all() and (new["z"] == 2 * rows["z"]).all()
    )
    for damaged in (pcd("binary_compressed", body(literal), 20), pcd("binary_compressed", body(literal + copy), 21)):
        (tmp_path / "a.pcd").write_bytes(damaged)
        with pytest.raises(InputError, match=r"a\.pcd: its compressed points are damaged"):
            scale_path(tmp_path / "a.pcd", tmp_path / "c.pcd", 2)


@pytest.mark.parametrize("ending", ("ply", "pcd"))
def test_numbers_that_may_be_lengths_are_named(tmp_path, ending):
    """CloudCompare's distances to another cloud stay in model units; colours, normals and intensities are none."""
    names = ("x", "y", "z", "nx", "intensity", "scalar_C2C_absolute_distances", "f_rest_44")
    head = {
        "ply": ["ply", "format ascii 1.0", "element vertex 1", *(f"property float {n}" for n in names), "end_header"],
        "pcd": [f"FIELDS {' '.join(names)}", "SIZE" + " 4" * 7, "TYPE" + " F" * 7, "POINTS 1", "DATA ascii"],
    }[ending]
    path = tmp_path / f"cloud.{ending}"
    path.write_text("\n".join([*head, "1 2 3 1 0.5 0.25 0", ""]))
    notes = scale_file(path, tmp_path / f"metres.{ending}", 2.0)
    assert notes == ["its scalar_C2C_absolute_distances stay as they are; multiply by 2 what of these is a length"]
    assert (tmp_path / f"metres.{ending}").read_text().split()[-7:] == ["2", "4", "6", "1", "0.5", "0.25", "0"]


def extra(name, kind, options=0):
    """The description of an extra number of a LAS file's points."""
    return struct.pack("<2xBB32s156x", kind, options, name)


@pytest.mark.parametrize("extended", [False, True])
def test_extra_numbers_of_a_las_file_that_may_be_lengths_are_named(tmp_path, extended):
    """As those of PLY and PCD are; whole numbers are in a unit of their own, if they have no factor."""
    numbers = [
        (b"C2C distance", 9),
        (b"normal_x", 10),
        (b"ring", 1),
        (b"height", 4, 8),
        (b"undescribed", 0, 8),
        (b"", 10),
    ]
    content = b"".join(extra(*each) for each in numbers)
    (tmp_path / "a.las").write_bytes(las(b"LASF_Spec", 4, content, extended=extended))
    notes = scale_file(tmp_path / "a.las", tmp_path / "b.las", 2.0)
    assert notes == ["its C2C distance, height, nameless stay as they are; multiply by 2 what of these is a length"]
    (tmp_path / "a.las").write_bytes(las(b"LASF_Spec", 3, content, extended=extended))
    assert scale_file(tmp_path / "a.las", tmp_path / "c.las", 2.0) == []


def test_named_columns_of_points_that_may_be_lengths_are_named(tmp_path):
    (tmp_path / "a.xyz").write_text("//X Y Z Rf Intensity Roughness_(0.05)\n1 2 3 0.5 7 0.25\n")
    notes = scale_file(tmp_path / "a.xyz", tmp_path / "b.xyz", 2.0)
    assert notes == ["its roughness_(0.05) stay as they are; multiply by 2 what of these is a length"]
    assert (tmp_path / "b.xyz").read_text().splitlines()[1] == "2 4 6 0.5 7 0.25"
    (tmp_path / "a.pts").write_text("1\n1 2 3 0.5 7 0.25\n")
    assert scale_file(tmp_path / "a.pts", tmp_path / "b.pts", 2.0) == []


FIELD = "ply\nformat ascii 1.0\nelement vertex 1\n"
FIELD += "".join(f"property float {name}\n" for name in ("x", "y", "z", "range_m")) + "end_header\n1 2 3 4\n"


def test_numbers_of_clouds_that_come_along_are_named_too(tmp_path):
    """Those of the cloud that a transforms.json names, and of one in a dense workspace."""
    (tmp_path / "sparse_pc.ply").write_text(FIELD)
    frame = {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist()}
    (tmp_path / "a.json").write_text(json.dumps({"frames": [frame], "ply_file_path": "sparse_pc.ply"}))
    said = "its range_m stay as they are; multiply by 14.157 what of these is a length"
    assert applied(tmp_path, tmp_path / "a.json")[1] == ["with sparse_pc.ply", f"sparse_pc.ply: {said}"]
    (dense_workspace(tmp_path / "dense") / "scan.ply").write_text(FIELD)
    (tmp_path / "out").mkdir()
    assert f"scan.ply: {said}" in scale_path(tmp_path / "dense", tmp_path / "out", SCALE)


def test_surfels_of_a_pcd_grow_as_those_of_a_ply_do(tmp_path):
    head = "VERSION 0.7\nFIELDS x y z radius range curvature\nSIZE 4 4 4 4 4 4\nTYPE F F F F {} F\n"
    head += "WIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n"
    for kind, told in (("F", "8"), ("U", "4")):  # a sensor's own, in millimetres
        (tmp_path / "a.pcd").write_text(head.format(kind) + "0.1 2 3 0.5 4 0.1\n")
        scale_path(tmp_path / "a.pcd", tmp_path / "b.pcd", 2)
        assert (tmp_path / "b.pcd").read_text().splitlines()[-1] == f"0.2 4 6 1 {told} 0.1"


def test_las_and_laz_are_scaled_in_their_headers(tmp_path):
    whole = las(b"laszip encoded", 22204, b"any", form=3 | 0x80)
    (tmp_path / "a.laz").write_bytes(whole)
    scale_path(tmp_path / "a.laz", tmp_path / "b.laz", 2)
    new = (tmp_path / "b.laz").read_bytes()
    assert struct.unpack_from("<12d", new, 131) == (0.002, 0.002, 0.004, 20, 40, 60, 22, 20, 42, 40, 62, 60)
    assert new[:58] + new[90:131] + new[227:] == whole[:58] + whole[90:131] + whole[227:]
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "b.laz", tmp_path / "c.laz", 2)


@pytest.mark.parametrize(
    ("content", "error", "said"),
    [
        (las(b"LASF_Projection", 2112, b"PROJCS[...]"), UsageError, "georeferenced"),
        (las(b"LASF_Projection", 2112, b"PROJCS[...]", extended=True), UsageError, "georeferenced"),
        (las(b"LASF_Projection", 34735, struct.pack("<4H", 1, 1, 0, 1) + bytes(8)), UsageError, "georeferenced"),
        (las(b"LASF_Projection", 34735, struct.pack("<4H", 1, 1, 0, 0)), None, ""),  # keys of nothing
        (las(b"LASF_Projection", 2112, b"\0"), None, ""),
        (las(b"copc", 1, bytes(160)), InputError, "COPC"),
        (las(form=4), InputError, "waveforms"),
        (las(form=0x80 | 9), InputError, "waveforms"),  # as LAZ marks what is compressed
        (las(b"x", 1, b"y")[:400], InputError, "400 bytes"),
        (las()[:235] + b"\xff" * 12 + las()[247:], InputError, "records"),
        (las()[:200], InputError, "not a LAS file"),
        (b"LASX" + las()[4:], InputError, "not a LAS file"),
    ],
)
def test_las_that_is_not_in_model_units_or_not_known(tmp_path, content, error, said):
    (tmp_path / "a.las").write_bytes(content)
    if error is None:
        scale_path(tmp_path / "a.las", tmp_path / "b.las", 2)
        return
    with pytest.raises(error, match=said):
        scale_path(tmp_path / "a.las", tmp_path / "b.las", 2)


def test_a_dense_workspace_leaves_what_is_not_in_its_units(tmp_path):
    source = dense_workspace(tmp_path / "dense")
    (source / "geo.las").write_bytes(las(b"LASF_Projection", 2112, b"PROJCS[...]"))
    (source / "a.spz").write_bytes(b"packed")
    (source / "a.stl").write_text(STL)
    (source / "done.obj").write_text("# orthoscale: metres\nv 1 2 3\n")
    (tmp_path / "out").mkdir()
    notes = scale_path(source, tmp_path / "out", SCALE)
    assert all(name in notes[1] for name in ("geo.las", "a.spz", "done.obj")) and "a.stl" not in notes[1]
    assert sorted(p.name for p in (tmp_path / "out").iterdir() if p.is_file()) == [
        "a.stl", "fused.ply", "fused.ply.vis", "meshed-poisson.ply"
    ]  # fmt: skip


def test_what_apply_wrote_into_a_dense_workspace_is_not_scaled_again_with_it(tmp_path):
    """A mesh in a format without room for a mark was scaled twice, by `fix --dense`."""
    dense = dense_workspace(tmp_path / "dense")
    (dense / "mesh.xyz").write_text("1 2 3\n")
    Sim3(SCALE).save(tmp_path)
    depth = dense / "stereo/depth_maps/a.jpg.geometric.bin"
    apply(tmp_path / "sim3.json", dense / "mesh.xyz", dense / "metric")
    apply(tmp_path / "sim3.json", depth, dense / "depth_maps")
    (tmp_path / "out").mkdir()
    notes = scale_path(dense, tmp_path / "out", SCALE)
    assert (tmp_path / "out/mesh.xyz").exists() and not (tmp_path / "out/metric/mesh.xyz").exists()
    assert not (tmp_path / "out/depth_maps/a.jpg.geometric.bin").exists()
    assert any("metric/mesh.xyz (in metres already: orthoscale wrote it)" in note for note in notes)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_what_is_not_copied_of_a_dense_workspace_is_said(tmp_path):
    """A copy without its frames or depth maps, which may lie on another disk, seemed to be whole."""
    source = dense_workspace(tmp_path / "dense")
    (source / "stereo").rename(tmp_path / "elsewhere")
    (source / "stereo").symlink_to(tmp_path / "elsewhere")
    (source / "gone.ply").symlink_to(tmp_path / "nowhere.ply")
    (source / "linked.ply").symlink_to(source / "fused.ply")
    os.mkfifo(source / "pipe.ply")
    (source / ".settings").touch()
    (tmp_path / "out").mkdir()
    (said,) = [note for note in scale_path(source, tmp_path / "out", SCALE) if "links to folders" in note]
    assert ": .settings, gone.ply, pipe.ply, stereo (hidden files, pipes, and links to folders or" in said
    assert (tmp_path / "out" / "linked.ply").is_file() and not (tmp_path / "out" / "stereo").exists()


def test_a_folder_of_a_dense_workspace_that_cannot_be_read_is_not_left_out(tmp_path, monkeypatch):
    """The copy lacked the depth maps, and nothing was said."""
    source = dense_workspace(tmp_path / "dense")
    (tmp_path / "out").mkdir()
    scandir = os.scandir

    def forbidden(folder):
        if os.fspath(folder).endswith("depth_maps"):
            raise PermissionError(errno.EACCES, "Permission denied", os.fspath(folder))
        return scandir(folder)

    monkeypatch.setattr(os, "scandir", forbidden)
    with pytest.raises(InputError, match="stereo/depth_maps: cannot be read .Permission denied"):
        scale_path(source, tmp_path / "out", SCALE)


@pytest.mark.parametrize(
    ("mode", "ending"), [("F", "tif"), ("I", "tif"), ("I;16", "png"), ("I;16", "TIFF"), ("I", "pgm"), ("I;16", "jp2")]
)
def test_pictures_that_may_be_depth_maps_are_not_copied_unscaled(tmp_path, mode, ending):
    """A depth map as a picture was copied as it was, into a workspace in metres. Frames may have 16 bits, too."""
    source = dense_workspace(tmp_path / "dense")
    for name in (f"stereo/depth_maps/a.{ending}", f"images/thermal.{ending}"):
        Image.new(mode, (4, 3), 7).save(source / name)
    Image.new("RGB", (4, 3)).save(source / f"stereo/colours.{ending}")
    (tmp_path / "out").mkdir()
    notes = scale_path(source, tmp_path / "out", SCALE)
    assert f"stereo/depth_maps/a.{ending}" in notes[1] and "thermal" not in notes[1] and "colours" not in notes[1]
    there = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob(f"*.{ending}")}
    assert there == {f"images/thermal.{ending}", f"stereo/colours.{ending}"}


def test_nothing_with_lengths_is_copied_unscaled_with_a_dense_workspace(tmp_path):
    source = dense_workspace(tmp_path / "dense")
    for name in ("fused.pts", "c.xyzrgb", "UPPER.XYZN"):
        (source / name).write_text("1 2 3 7 8 9\n")
    unknown = ("scene.mvs", "depth0001.dmap", "mesh.fbx", "cloud.e57", "a_P.txt", "nohup.out", "depth.npy", "plain")
    for name in unknown:
        (source / name).write_text("1 2 3\n")
    (source / "stereo/consistency_graphs").mkdir()
    along = ("images/b.PNG", "stereo/patch-match.cfg", "run.sh", "stereo/consistency_graphs/a.jpg.geometric.bin")
    for name in along:
        (source / name).write_text("1 2 3\n")
    (tmp_path / "out").mkdir()
    notes = scale_path(source, tmp_path / "out", 2.0)
    for name in ("fused.pts", "c.xyzrgb", "UPPER.XYZN"):
        assert list(map(float, (tmp_path / "out" / name).read_text().split())) == [2, 4, 6, 7, 8, 9]
    for name in unknown:
        assert name in notes[1] and not (tmp_path / "out" / name).exists()
    for name in along:
        assert (tmp_path / "out" / name).read_text() == "1 2 3\n"


def test_a_note_on_many_files_that_are_left_names_the_first(tmp_path):
    source = dense_workspace(tmp_path / "dense")
    for k in range(25):
        (source / f"depth{k:04d}.dmap").write_bytes(b"DR")
    (tmp_path / "out").mkdir()
    notes = scale_path(source, tmp_path / "out", SCALE)
    assert "depth0019.dmap" in notes[1] and "depth0020.dmap" not in notes[1] and notes[1].endswith("and 5 more")


# --- Camera files ----------------------------------------------------------------------------------------------------


def test_transforms_with_their_cloud(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    pose = np.eye(4)
    pose[:3, 3] = (1, -2, 3)
    text = {"fl_x": 500.0, "frames": [{"file_path": "a.jpg", "transform_matrix": pose.tolist()}]}
    text |= {"applied_transform": pose[:3].tolist(), "ply_file_path": "sparse_pc.ply"}
    (tmp_path / "in/transforms.json").write_text(json.dumps(text))
    ply(tmp_path / "in/sparse_pc.ply", "ascii", ["x", "y", "z"], XYZ)
    scale_path(tmp_path / "in/transforms.json", tmp_path / "out/transforms.json", SCALE)
    new = json.loads((tmp_path / "out/transforms.json").read_text())
    matrix = np.array(new["frames"][0]["transform_matrix"])
    assert np.allclose(matrix[:3, 3], SCALE * pose[:3, 3]) and (matrix[:, :3] == pose[:, :3]).all()
    assert np.allclose(np.array(new["applied_transform"])[:, 3], SCALE * pose[:3, 3]) and new["fl_x"] == 500
    assert np.allclose(read_ply(tmp_path / "out/sparse_pc.ply", 3)[0], SCALE * XYZ)
    with pytest.raises(UsageError, match=r"transforms\.json is in metres already"):  # not only its cloud
        scale_path(tmp_path / "out/transforms.json", tmp_path / "b.json", SCALE)


def test_the_cameras_beside_a_splat_move_with_it(tmp_path):
    """They had no reader, and a viewer then began far off the scaled splat."""
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    view = {"id": 0, "img_name": "a", "width": 8, "position": [1, -2, 3.5], "rotation": np.eye(3).tolist(), "fy": 9.0}
    (tmp_path / "in/cameras.json").write_text(json.dumps([view, {**view, "img_name": "b"}]))
    assert scale_path(tmp_path / "in/cameras.json", tmp_path / "out/cameras.json", SCALE) == []
    first, second = json.loads((tmp_path / "out/cameras.json").read_text())
    assert np.allclose(first["position"], SCALE * np.array([1, -2, 3.5]))
    assert second["position"] == first["position"]
    assert {name: first[name] for name in view} == {**view, "position": first["position"]}
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "out/cameras.json", tmp_path / "b.json", SCALE)
    metric = {"a": np.array([1, -2, 9.0]) * SCALE, "b": np.array([1, -2, 3.5]) * SCALE}
    with pytest.raises(UsageError, match="b stands elsewhere"):
        scale_path(tmp_path / "in/cameras.json", tmp_path / "b.json", SCALE, metric=metric)
    for text in ([], {"a.jpg": {"focal": 0.9}}, [{**view, "position": [1, 2]}]):
        (tmp_path / "in/cameras.json").write_text(json.dumps(text))
        with pytest.raises(InputError, match="list of cameras"):
            scale_path(tmp_path / "in/cameras.json", tmp_path / "b.json", SCALE)


def test_all_lengths_of_instant_ngp_grow(tmp_path):
    """Poses and velocities of a rolling shutter, the box and the depths that are looked at."""
    pose = np.eye(4)
    pose[:3, 3] = (1, -2, 3)
    names = ("transform_matrix", "transform_matrix_start", "transform_matrix_end")
    frame = {"file_path": "a.jpg", "near": 0.5, **dict.fromkeys(names, pose.tolist())}
    frame |= {"camera_linear_velocity": [0.5, 0, -2], "camera_angular_velocity": [0.1, 0.2, 0.3]}
    still = {"file_path": "b.jpg", "transform_matrix": pose.tolist(), "transform_matrix_end": None}
    text = {
        "frames": [frame, still],
        "aabb": [[-1, -2, -3], [1, 2, 3]],
        "aabb_scale": 16,
        "near": 1,
        "far": None,
        "scale": 0.5,
    }
    (tmp_path / "a.json").write_text(json.dumps(text))
    notes = scale_path(tmp_path / "a.json", tmp_path / "b.json", SCALE)
    assert notes == ['its "scale", which instant-ngp multiplies positions by, is unchanged']
    new = json.loads((tmp_path / "b.json").read_text())
    for name in names:
        assert np.allclose(np.array(new["frames"][0][name])[:3, 3], SCALE * pose[:3, 3])
    assert np.allclose(new["aabb"], SCALE * np.array(text["aabb"]))
    assert (new["near"], new["far"], new["frames"][0]["near"]) == (SCALE, None, 0.5 * SCALE)
    assert (new["aabb_scale"], new["scale"]) == (16, 0.5)
    assert new["frames"][0]["camera_linear_velocity"] == pytest.approx([0.5 * SCALE, 0, -2 * SCALE])
    assert new["frames"][0]["camera_angular_velocity"] == frame["camera_angular_velocity"]


def test_all_lengths_of_opensfm_grow(tmp_path):
    """Panoramas, and what a shot may have: a mesh of what it sees, and how well its pose is known."""
    shot = {"rotation": [0.1, 0, 0], "translation": [1, 2, 3], "camera": "c", "vertices": [[1, 2, 3]], "faces": [[0]]}
    shot["covariance"] = np.arange(36.0).reshape(6, 6).tolist()
    shots = {"a": shot, "b": {**shot, "covariance": None}}
    part = {"cameras": {}, "shots": shots, "pano_shots": {"p": shot}, "points": {}}
    (tmp_path / "a.json").write_text(json.dumps([part]))
    scale_path(tmp_path / "a.json", tmp_path / "b.json", 2)
    (new,) = json.loads((tmp_path / "b.json").read_text())
    for each in (new["shots"]["a"], new["pano_shots"]["p"]):
        assert each["translation"] == [2, 4, 6] and each["vertices"] == [[2, 4, 6]] and each["faces"] == [[0]]
        grown = np.array(each["covariance"]) / np.array(shot["covariance"]).clip(1)
        assert np.allclose(grown.ravel()[1:], np.outer([1, 1, 1, 2, 2, 2], [1, 1, 1, 2, 2, 2]).ravel()[1:])


def test_reconstruction(tmp_path):
    shot = {"rotation": [0.1, 0, 0], "translation": [1, 2, 3], "camera": "c", "gps_position": [7, 8, 9]}
    part = {"cameras": {}, "shots": {"a.jpg": shot}, "points": {"1": {"coordinates": [1, 1, 1], "color": [1, 2, 3]}}}
    part |= {"rig_instances": {"a": {"translation": [4, 0, 0], "rotation": [0, 0, 0]}}}
    (tmp_path / "reconstruction.json").write_text(json.dumps([part]))
    scale_path(tmp_path / "reconstruction.json", tmp_path / "new.json", 2)
    (new,) = json.loads((tmp_path / "new.json").read_text())
    assert new["shots"]["a.jpg"] == {**shot, "translation": [2, 4, 6]}
    assert new["points"]["1"] == {"coordinates": [2, 2, 2], "color": [1, 2, 3]}
    assert new["rig_instances"]["a"]["translation"] == [8, 0, 0]
    with pytest.raises(UsageError, match="in metres already"):
        scale_path(tmp_path / "new.json", tmp_path / "b.json", 2)
    (tmp_path / "reconstruction.json").write_text(json.dumps([part, part]))
    with pytest.raises(UsageError, match="2 reconstructions, each with a scale of its own"):
        scale_path(tmp_path / "reconstruction.json", tmp_path / "c.json", 2)
    assert not (tmp_path / "c.json").exists()


@pytest.mark.parametrize(
    "text",
    ["", "{", "[1]", '[{"shots": {"a": {}}}]', "{}", "3", '{"frames": [{"transform_matrix": [[1]]}]}',
     '{"frames": [{"transform_matrix": [[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}'],
)  # fmt: skip
def test_damaged_json(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match=r"a\.json"):
        scale_path(tmp_path / "a.json", tmp_path / "b.json", 2)


# --- Dense workspaces and models -------------------------------------------------------------------------------------


def test_a_dense_workspace_of_an_undistorter_alone_is_told_as_such(tmp_path):
    """Before COLMAP's stereo: "0 depth maps ... converted" reads as a failure."""
    source = dense_workspace(tmp_path / "dense")
    for path in (*source.glob("stereo/depth_maps/*"), *source.glob("*.ply")):
        path.unlink()
    (tmp_path / "out").mkdir()
    (said,) = scale_path(source, tmp_path / "out", SCALE)
    assert "its undistorted model converted to metres; there is no depth map" in said
    assert (tmp_path / "out" / "sparse" / "points3D.bin").is_file()


def test_what_macos_leaves_beside_the_files_of_a_dense_workspace_is_none_of_them(tmp_path):
    """On disks that Windows reads too; `fix --dense` refused such a workspace as damaged."""
    source = dense_workspace(tmp_path / "dense")
    for path in [*source.rglob("*.*")]:
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X")
    (tmp_path / "out").mkdir()
    said = scale_path(source, tmp_path / "out", SCALE)
    assert "converted to metres too" in said[0] and not [note for note in said if "._" in note]
    assert not list((tmp_path / "out").rglob("._*"))


def test_dense_workspace(tmp_path):
    import pycolmap

    source = dense_workspace(tmp_path / "dense")
    (tmp_path / "out").mkdir()
    notes = scale_path(source, tmp_path / "out", SCALE)
    assert "4 depth maps, clouds and meshes" in notes[0]
    for kind in ("geometric", "photometric"):
        data = (tmp_path / f"out/stereo/depth_maps/a.jpg.{kind}.bin").read_bytes()
        assert data[:6] == b"3&2&1&"
        assert np.allclose(np.frombuffer(data[6:], "<f4"), SCALE * np.array([1, 0, 2.5, 3, 4, 5]), rtol=1e-6)
    assert np.allclose(read_ply(tmp_path / "out/fused.ply", 6)[0], np.hstack([SCALE * XYZ, XYZ]), rtol=1e-6)
    assert np.allclose(read_ply(tmp_path / "out/meshed-poisson.ply", 3)[0], SCALE * XYZ, rtol=1e-6)
    for same in ("stereo/normal_maps/a.jpg.geometric.bin", "stereo/fusion.cfg", "images/a.jpg", "fused.ply.vis"):
        assert (tmp_path / "out" / same).read_bytes() == (source / same).read_bytes()
    old, new = (pycolmap.Reconstruction(str(p)) for p in (source / "sparse", tmp_path / "out/sparse"))
    for i, point in old.points3D.items():
        assert np.allclose(new.points3D[i].xyz, SCALE * point.xyz, rtol=1e-12)


def test_damaged_depth_map(tmp_path):
    source = dense_workspace(tmp_path / "dense") / "stereo/depth_maps/a.jpg.geometric.bin"
    whole = source.read_bytes()
    for data in (b"", whole[:-1], whole + b"\0", b"x" + whole, b"9&9&1&" + whole[6:], b"-3&-2&1&" + whole[6:]):
        source.write_bytes(data)
        with pytest.raises(InputError, match=r"a\.jpg\.geometric\.bin"):
            scale_path(source, tmp_path / "b.bin", 2)


# --- The command -----------------------------------------------------------------------------------------------------


def test_apply(tmp_path):
    Sim3(SCALE).save(tmp_path)
    assert Sim3.load(tmp_path / "sim3.json") == Sim3.load(tmp_path / "sim3.txt") == Sim3(SCALE)
    (tmp_path / "SIM3.JSON").write_text((tmp_path / "sim3.json").read_text())
    assert Sim3.load(tmp_path / "SIM3.JSON") == Sim3(SCALE)
    cloud = ply(tmp_path / "a.ply", "ascii", ["x", "y", "z"], XYZ)
    dense = dense_workspace(tmp_path / "dense")
    out = tmp_path / "metric"
    run = CliRunner().invoke(cli, ["apply", *map(str, (tmp_path / "sim3.json", cloud, dense)), "--out", str(out)])
    assert run.exit_code == 0, run.output
    assert sorted(p.name for p in out.iterdir()) == [".orthoscale.json", "a.ply", "dense"]
    assert np.allclose(read_ply(out / "a.ply", 3)[0], SCALE * XYZ)

    cloud.write_bytes(cloud.read_bytes()[:-30])
    with pytest.raises(InputError):
        CliRunner().invoke(cli, ["apply", *map(str, (tmp_path / "sim3.json", dense, cloud)), "--out",
                                 str(tmp_path / "none")], catch_exceptions=False)  # fmt: skip
    assert not (tmp_path / "none").exists() and not list(tmp_path.glob(".*partial")), "all or nothing"


def test_files_without_room_for_a_mark_are_not_scaled_twice(tmp_path):
    """The folder that `apply` wrote tells, also if it was renamed or is named by a link."""
    Sim3(SCALE).save(tmp_path)
    (tmp_path / "a.xyz").write_text("1 2 3\n")
    (tmp_path / "a.stl").write_text(STL)
    depths = tmp_path / "work" / "stereo" / "depth_maps"  # a workspace without a sparse model, which would tell
    depths.mkdir(parents=True)
    (depths / "x.geometric.bin").write_bytes(b"1&1&1&" + struct.pack("<f", 2))
    sim3, names = tmp_path / "sim3.json", ("a.xyz", "a.stl", "work")
    apply(sim3, [tmp_path / name for name in names], tmp_path / "first")
    (tmp_path / "link").symlink_to(tmp_path / "first")
    for folder in ("first", "link", "renamed"):
        if folder == "renamed":
            (tmp_path / "first").rename(tmp_path / folder)
        for name in (*names, "work/stereo/depth_maps/x.geometric.bin"):
            with pytest.raises(UsageError, match="in metres already"):
                apply(sim3, tmp_path / folder / name, tmp_path / "second")
    (tmp_path / "renamed" / "b.xyz").write_text("1 2 3\n")  # a user's own file, not in the list of those in metres
    apply(sim3, tmp_path / "renamed" / "b.xyz", tmp_path / "second")
    assert (tmp_path / "second" / "b.xyz").read_text() == f"{SCALE:.10g} {2 * SCALE:.10g} {3 * SCALE:.10g}\n"


@pytest.mark.parametrize(
    ("name", "text", "error", "why"),
    [
        ("sim3.json", "{}", InputError, "scale is missing"),
        ("sim3.json", "[1]", InputError, "expected an object"),
        ("sim3.txt", "2 1 0 0", InputError, "4 numbers, 8 are needed"),
        ("sim3.txt", "2 1 0 0 0 five 0 0", InputError, "expected eight numbers"),
        ("sim3.txt", "2 1 0 0 0 5 0 0", UsageError, "turns or shifts"),
        ("sim3.txt", "2 0 1 0 0 0 0 0", UsageError, "turns or shifts"),
        ("sim3.txt", "-2 1 0 0 0 0 0 0", UsageError, "cannot scale by -2"),
        ("sim3.txt", "nan 1 0 0 0 0 0 0", UsageError, "cannot scale by nan"),
    ],
)
def test_similarities_that_are_none(tmp_path, name, text, error, why):
    (tmp_path / name).write_text(text)
    with pytest.raises(error, match=why):
        Sim3.load(tmp_path / name)


def test_unknown_and_missing_files(tmp_path):
    (tmp_path / "a.las").write_bytes(b"LASF")
    for path in (tmp_path / "a.las", tmp_path / "none.ply"):
        with pytest.raises(OrthoscaleError, match=path.name):
            scale_path(path, tmp_path / "b", 2)
    (tmp_path / "dsm.tif").write_bytes(b"II*")
    with pytest.raises(InputError) as caught:
        scale_path(tmp_path / "dsm.tif", tmp_path / "b", 2)
    assert "multiply heights" in caught.value.hint, "no other format would help"


# --- What hostile files announce, name and leave out ----------------------------------------------------------------


def announced(path: Path, *lines: str, body: str = "0 0 0\n") -> Path:
    path.write_text("\n".join(["ply", "format ascii 1.0", *lines, "end_header", body]))
    return path


XYZ_LINES = ("property float x", "property float y", "property float z")


@pytest.mark.parametrize(
    "lines",
    [
        (f"element camera {10**12}", "property float view", "element vertex 1", *XYZ_LINES),
        (f"element nothing {10**12}", "element vertex 1", *XYZ_LINES),
        (f"element vertex {10**8}", *XYZ_LINES),
        ("element vertex 1", *XYZ_LINES, "property float x"),
    ],
)
def test_a_ply_that_announces_what_it_has_not(tmp_path, lines):
    source = announced(tmp_path / "a.ply", *lines)
    with pytest.raises(InputError, match=r"a\.ply"):
        scale_path(source, tmp_path / "b.ply", 2.0)
    with pytest.raises(InputError, match=r"a\.ply"):
        read_points(source)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_of_very_many_points_some_are_read(tmp_path, monkeypatch, form):
    monkeypatch.setattr("orthoscale.formats.geometry.ply.ROWS", 7)
    rows = np.arange(150, dtype=float).reshape(50, 3)
    source = ply(tmp_path / "a.ply", form, ["x", "y", "z"], rows)
    points, colours = read_points(source)
    assert (points == rows).all() and not colours.any()
    monkeypatch.setattr("orthoscale.formats.geometry.ply.MOST_POINTS", 20)
    assert (read_points(source)[0] == rows[::3]).all()


def test_names_that_are_none(tmp_path):
    long = "n" * 300
    (tmp_path / "a.obj").write_text(f"mtllib\nmtllib {long}\nv 1 2 3\n")
    scale_path(tmp_path / "a.obj", tmp_path / "b.obj", 2.0)
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(buffers=[{"uri": long}])))
    scale_path(tmp_path / "a.gltf", tmp_path / "b.gltf", 2.0)
    with pytest.raises(InputError, match="does not exist"):
        scale_path(tmp_path / long, tmp_path / "c.ply", 2.0)


def test_uris_are_percent_encoded(tmp_path):
    home, out = tmp_path / "in", tmp_path / "out"
    for folder in (home, out):
        folder.mkdir()
    for name in ("b c.bin", "100%.png"):
        (home / name).write_bytes(b"1234")
    text = gltf(buffers=[{"uri": "b%20c.bin", "byteLength": 4}], images=[{"uri": "100%.png"}])
    (home / "a.gltf").write_text(json.dumps(text))
    scale_path(home / "a.gltf", out / "a.gltf", 2.0)
    assert {p.name for p in out.iterdir()} == {"a.gltf", "b c.bin", "100%.png"}


def test_the_matrix_of_a_similarity(tmp_path):
    Sim3(SCALE).save(tmp_path)
    assert (np.loadtxt(tmp_path / "sim3_4x4.txt") == np.diag([SCALE, SCALE, SCALE, 1])).all()


# --- Files as other programs write them ------------------------------------------------------------------------------


def written(folder: Path, **files: str | bytes) -> Path:
    """The `folder` with these files in it, by path."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return folder


def applied(tmp_path: Path, *files: Path, out: str = "metric") -> tuple[Path, list[str]]:
    """The folder that `apply` wrote, and all notes."""
    Sim3(SCALE).save(tmp_path)
    notes = apply(tmp_path / "sim3.json", files, tmp_path / out)
    return tmp_path / out, [note for of_one in notes.values() for note in of_one]


def test_materials_as_exporters_name_them(tmp_path):
    home = written(
        tmp_path / "in",
        **{
            "a.mtl": "newmtl a\n\tmap_Kd -s 1 1 1 my tex.png\nrefl -type sphere r.png\n",
            "b.mtl": "newmtl b\nmap_Kd tex\\b.png\ndisp d.png\nmap_Ks gone.png\nmap_Ka\n",
            "one name.mtl": "newmtl c\n",
            "m.obj": "mtllib a.mtl b.mtl\r\nmtllib .\\one name.mtl\r\nv 1 2 3\r\nf 1 1 1\r\n",
            **dict.fromkeys(("my tex.png", "r.png", "tex/b.png", "d.png"), b"x"),
        },
    )
    out, notes = applied(tmp_path, home / "m.obj")
    there = {path.relative_to(home).as_posix() for path in home.rglob("*") if path.is_file()}
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == {
        *there, ".orthoscale.json"
    }  # fmt: skip
    assert [note for note in notes if "refers" in note] == ["refers to gone.png, which is not beside it"]


def test_names_in_materials_need_not_be_utf_8(tmp_path):
    (home := tmp_path / "in").mkdir()
    (home / "a.obj").write_bytes(b"mtllib caf\xe9.mtl\nv 1 2 3\n")
    (home / os.fsdecode(b"caf\xe9.mtl")).write_bytes(b"newmtl a\nmap_Kd t\xe9x.png\n")
    (home / os.fsdecode(b"t\xe9x.png")).write_bytes(b"png")
    out, notes = applied(tmp_path, home / "a.obj")
    assert {os.fsencode(path.name) for path in out.glob("*.*") if path.name[0] != "."} == {
        b"a.obj", b"caf\xe9.mtl", b"t\xe9x.png"
    }  # fmt: skip
    assert not any("refers" in note for note in notes)


@pytest.mark.parametrize(
    "name, line", [("a.obj", "v {} {} 3"), ("a.xyz", "{} {} 3 255 0 0"), ("a.off", "OFF 1 0 0\n{} {} 3")]
)
def test_text_keeps_as_many_digits_as_it_has(tmp_path, name, line):
    """Far from the origin ten are not enough for millimetres."""
    words = "4649776.22482", "-500000.12345678901"
    (tmp_path / name).write_text(line.format(*words) + "\n")
    scale_path(tmp_path / name, tmp_path / f"new_{name}", 1.5)
    new = (tmp_path / f"new_{name}").read_text().splitlines()[-1].split()[-6 if "255" in line else -3 :]
    for old, word in zip(words, new, strict=False):
        assert float(word) == pytest.approx(1.5 * float(old), rel=0, abs=1e-6 if old[0] == "4" else 1e-11)


def test_an_obj_with_a_byte_order_mark_or_the_line_ends_of_old_macs(tmp_path):
    (tmp_path / "a.obj").write_bytes(b"\xef\xbb\xbfv 1 2 3\nf 1 1 1\n")
    scale_path(tmp_path / "a.obj", tmp_path / "b.obj", 2)
    assert (tmp_path / "b.obj").read_text().splitlines()[1] == "v 2 4 6"
    (tmp_path / "a.obj").write_bytes(b"v 1 2 3\rv 4 5 6\rf 1 2 1\r")
    with pytest.raises(InputError, match="line 1"):
        scale_path(tmp_path / "a.obj", tmp_path / "b.obj", 2)


@pytest.mark.parametrize(
    ("extra", "values", "new"),
    [
        (["opacity", "scale_0", "rot_0", "filter_3D"], "0.5 -1 1 0.25", [0.5, -1 + np.log(SCALE), 1, 0.25 * SCALE]),
        (["f_dc_0", "opacity", "scale_0"], "1 0.5 -1", [1, 0.5, -1 + np.log(SCALE)]),  # round: nothing to turn
        (["scale_0"], "-1", [-1]),  # of no splat
    ],
)
def test_splats_of_other_kinds(tmp_path, extra, values, new):
    lines = ["ply", "format ascii 1.0", "element vertex 1", *(f"property float {n}" for n in ("x", "y", "z", *extra))]
    (tmp_path / "a.ply").write_text("\n".join([*lines, "end_header", f"1 2 3 {values}"]) + "\n")
    scale_path(tmp_path / "a.ply", tmp_path / "b.ply", SCALE)
    row = read_ply(tmp_path / "b.ply", 0)[0][0]
    assert row == pytest.approx([SCALE, 2 * SCALE, 3 * SCALE, *new], rel=1e-8)


def test_a_ply_header_in_latin_1_with_a_texture_and_doubles(tmp_path):
    head = b"ply \nformat ascii 1.0\ncomment by Stra\xdfe\ncomment TextureFile t 1.png\nelement vertex 1\n"
    head += b"".join(b"property double %c\n" % axis for axis in b"xyz") + b"end_header\n"
    home = written(tmp_path / "in", **{"a.ply": head + b"512345.123456789 2 3\n", "t 1.png": b"x"})
    out, notes = applied(tmp_path, home / "a.ply")
    assert notes == ["with t 1.png"] and (out / "t 1.png").read_bytes() == b"x"
    text = (out / "a.ply").read_bytes()
    assert b"comment by Stra\xdfe\n" in text
    assert float(text.split(b"end_header\n")[1].split()[0]) == pytest.approx(512345.123456789 * SCALE, rel=1e-14)


def test_what_a_scene_refers_to_and_has_not_is_said(tmp_path):
    buffers = [{"uri": "gone.bin"}, {"uri": "https://example.org/a.bin"}, {"uri": "data:,x"}]
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(buffers=buffers)))
    assert applied(tmp_path, tmp_path / "a.gltf")[1] == ["refers to gone.bin, which is not beside it"]


def test_depth_maps_of_a_transforms_json(tmp_path):
    frame = {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist(), "depth_file_path": "d.npy"}
    (tmp_path / "a.json").write_text(json.dumps({"frames": [frame], "ply_file_path": "gone.ply"}))
    (tmp_path / "b.json").write_text(json.dumps({"frames": [frame], "integer_depth_scale": 0.001}))
    out, notes = applied(tmp_path, tmp_path / "a.json", tmp_path / "b.json")
    assert notes == [
        "refers to gone.ply, which is not beside it",
        "the depth maps that it names stay in model units: multiply them by 14.157",
    ]
    assert json.loads((out / "b.json").read_text())["integer_depth_scale"] == pytest.approx(0.014157)


@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("kind", ["gltf", "obj", "json", "cloud"])
def test_files_of_one_name_do_not_take_each_others_place(tmp_path, kind, same):
    for name in "ab":
        home = tmp_path / name
        home.mkdir()
        varied = "a" if same else name
        ply(home / "c.ply", "ascii", ["x", "y", "z"], XYZ * (1 + "ab".index(varied)))
        frame = {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist()}
        written(
            home,
            **{
                "s.bin": varied * 4,
                f"{name}.gltf": json.dumps(gltf(buffers=[{"uri": "s.bin"}])),
                "m.mtl": f"newmtl {varied}\n",
                f"{name}.obj": "mtllib m.mtl\nv 1 2 3\n",
                f"{name}.json": json.dumps({"frames": [frame], "ply_file_path": "c.ply"}),
            },
        )
    second = tmp_path / ("b/c.ply" if kind == "cloud" else f"b/b.{kind}")
    first = tmp_path / ("a/a.json" if kind == "cloud" else f"a/a.{kind}")
    if same:
        assert len(list(applied(tmp_path, first, second)[0].iterdir())) == (3 if kind == "cloud" else 4)
    else:
        for k, files in enumerate(((first, second), (second, first))):
            with pytest.raises(UsageError, match="would both become"):
                applied(tmp_path, *files, out=f"none{k}")
    assert not list(tmp_path.glob("none*"))


def test_links_keep_their_own_names(tmp_path):
    """As in the caches of DVC, git-annex and Hugging Face, whose files are links to blobs."""
    home = written(
        tmp_path / "blobs", **{"1": "mtllib a.mtl\nv 1 2 3\n", "2": "newmtl a\n"}
    ).parent / "snapshot"  # fmt: skip
    home.mkdir()
    (home / "m.obj").symlink_to("../blobs/1")
    (home / "a.mtl").symlink_to("../blobs/2")
    out, notes = applied(tmp_path, home / "m.obj")
    assert {path.name for path in out.iterdir()} == {"m.obj", "a.mtl", ".orthoscale.json"} and notes == ["with a.mtl"]


def test_nothing_to_apply_to(tmp_path):
    with pytest.raises(UsageError, match="an empty list"):
        applied(tmp_path)
    assert not (tmp_path / "metric").exists()
    cloud = ply(tmp_path / "a.ply", "ascii", ["x", "y", "z"], XYZ)
    with pytest.raises(UsageError, match=r"two FILEs are called a\.ply"):
        applied(tmp_path, cloud, cloud)


@pytest.mark.slow
def test_colmap_takes_one_of_both_similarities(tmp_path):
    """The real program: 3.8 wants the matrix, newer ones the line."""
    import pycolmap

    colmap = shutil.which("colmap")
    if colmap is None:
        pytest.skip("no colmap on PATH")
    said = subprocess.run(
        [colmap, "help"], capture_output=True, text=True, env={**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    )
    found = re.search(r"COLMAP (\d+)\.(\d+)", said.stdout + said.stderr)
    if found is None:
        pytest.skip("colmap does not tell its version")
    Sim3(SCALE).save(tmp_path)
    (tmp_path / "out").mkdir()
    name = "sim3_4x4.txt" if tuple(map(int, found.groups())) <= (3, 8) else "sim3.txt"
    command = [colmap, "model_transformer", "--input_path", SPARSE, "--output_path", tmp_path / "out"]
    subprocess.run(
        [*command, "--transform_path", tmp_path / name],
        check=True, capture_output=True, env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
    )  # fmt: skip
    old, new = pycolmap.Reconstruction(str(SPARSE)), pycolmap.Reconstruction(str(tmp_path / "out"))
    for number, image in old.images.items():
        assert np.allclose(new.images[number].projection_center(), SCALE * image.projection_center(), rtol=1e-6)
