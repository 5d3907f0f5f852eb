"""Dense clouds: cropped, cleaned and foreign ones are told apart; what else is wrong with a dense workspace is said."""

from __future__ import annotations

import base64
import json
import shutil
import struct

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation
from support.geometry import PCD_ROW, XYZ, glb, pcd, pcd_body
from support.models import make_model
from support.other_programs import opensfm
from test_dense_ground import write_cloud

from orthoscale.actions.apply import apply
from orthoscale.errors import InputError
from orthoscale.formats.geometry.dense import visibility_fault
from orthoscale.formats.geometry.records import GAUSSIAN, STL_TRIANGLE
from orthoscale.formats.geometry.vertices import vertices_in
from orthoscale.sources.cloud_fit import cloud_fit
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.dense_cloud import check_workspace
from orthoscale.sources.opening import open_source
from orthoscale.sources.scaling import scale_path

HEIGHT = 5.0  # of the cameras, in model units


def hills(rng, count, noise):
    """(count, 3) points of ground with hills, about as far from the cameras as those of a COLMAP model."""
    xy = rng.uniform(-8, 8, (count, 2))
    z = 0.4 * np.sin(xy[:, 0]) * np.cos(0.7 * xy[:, 1]) - HEIGHT + rng.normal(0, noise * HEIGHT, count)
    return np.column_stack([xy, z])


@pytest.fixture(scope="module")
def scene():
    """Sparse points, cameras, and the dense cloud."""
    rng = np.random.default_rng(1)
    centres = np.column_stack([rng.uniform(-6, 6, (30, 2)), rng.normal(0, 0.1, 30)])
    return hills(rng, 4000, 0.002), centres, hills(rng, 800_000, 0.001)


def turned(cloud, degrees):
    return Rotation.from_euler("xyz", [degrees, degrees / 2, degrees], degrees=True).apply(cloud)


@pytest.mark.parametrize(
    "cut",
    [
        lambda cloud: cloud,
        lambda cloud: cloud[::4],
        lambda cloud: cloud[(np.abs(cloud[:, :2]) < 1.25).all(1)],
        lambda cloud: cloud[cloud[:, 0] > 3],
        lambda cloud: cloud[cloud[:, 2] > -HEIGHT],  # the hills alone
        lambda cloud: 1.002 * cloud,  # the model was adjusted once more
    ],
)
def test_a_part_of_its_cloud_is_the_models_own(scene, cut):
    sparse, centres, cloud = scene
    fit = cloud_fit(sparse, centres, np.array_split(cut(cloud), 3))
    assert fit.own and not fit.another and "too few" not in fit.said, fit


def test_a_thin_cloud_that_lies_on_the_points_is_the_models_own(scene):
    """It was called doubtful although every point lay on it: thinned by a grid, say."""
    sparse, centres, _ = scene
    rng = np.random.default_rng(3)
    fit = cloud_fit(sparse, centres, [sparse[::2] + rng.normal(0, 0.001 * HEIGHT, (len(sparse[::2]), 3))])
    assert fit.own and not fit.another and "too few" not in fit.said, fit
    assert not cloud_fit(sparse, centres, [1.05 * sparse[::2]]).own


@pytest.mark.parametrize(
    "change",
    [
        lambda cloud: 1.05 * cloud,
        lambda cloud: 0.97 * cloud,
        lambda cloud: 14.2 * cloud,
        lambda cloud: turned(cloud, 5),
        lambda cloud: turned(cloud, 70),
        lambda cloud: cloud + (0, 0, 0.3),
        lambda cloud: cloud + (5e5, 5e6, 100),  # in coordinates of a map
        lambda cloud: 1e307 * cloud,
        lambda cloud: 14.2 * cloud[(np.abs(cloud[:, :2]) < 1.25).all(1)],
    ],
)
def test_a_cloud_of_another_run_is_none_of_the_model(scene, change):
    sparse, centres, cloud = scene
    fit = cloud_fit(sparse, centres, [change(cloud)])
    assert fit.another and not fit.own, fit


@pytest.mark.parametrize("few", [lambda cloud: cloud[:100], lambda cloud: cloud[::400], lambda cloud: cloud[:0]])
def test_of_few_points_nothing_is_said(scene, few):
    sparse, centres, cloud = scene
    for points in (few(cloud), 3 * few(cloud)[:900]):
        fit = cloud_fit(sparse, centres, [points])
        assert not fit.another and not fit.own, fit
        assert not fit.near or fit.said.endswith("too few points to tell"), "not: of 3125, 3125 lie on it"


@pytest.fixture
def workspace(tmp_path):
    """A model, and its dense workspace with a cloud: (folder of the model, cloud)."""
    model, _ = make_model()
    for place in (tmp_path / "model/sparse", tmp_path / "model/dense/sparse"):
        place.mkdir(parents=True)
        model.write(place)
    (tmp_path / "model/dense/stereo").mkdir()
    axes = np.linalg.svd(np.array([p.xyz for p in model.points3D.values()]))[2]  # the last is up
    places = np.random.default_rng(0).uniform(-12, 12, (200_000, 3)) * (1, 1, 0.001)
    return tmp_path / "model", places @ axes


@pytest.mark.parametrize("name", ["fused.ply", "meshed-poisson.ply"])
def test_what_is_not_of_the_model_is_not_said_to_be_in_metres(workspace, tmp_path, name):
    folder, cloud = workspace
    up = np.linalg.svd(cloud[:1000])[2][2]
    write_cloud(folder / "dense" / name, cloud)
    assert check_workspace(folder / "dense") == []
    write_cloud(folder / "dense" / name, cloud[cloud[:, 0] > 0])
    assert check_workspace(folder / "dense") == []
    write_cloud(folder / "dense" / name, 2 * cloud + cloud.std() * up)
    with pytest.raises(InputError, match=f"{name} is not of the model"):
        _ = ColmapSource.open(folder, need_images=False).dense
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match=f"{name} is not of the model"):
        scale_path(folder / "dense", tmp_path / "out", 2.0)


def test_depth_maps_that_are_missing_are_said(workspace):
    folder, cloud = workspace
    source = ColmapSource.open(folder, need_images=False)
    write_cloud(folder / "dense/fused.ply", cloud)
    (maps := folder / "dense/stereo/depth_maps").mkdir(parents=True)
    for name in source.picture_names:
        (maps / f"{name}.photometric.bin").write_bytes(b"1&1&1&" + bytes(4))
        (maps / f"{name}.geometric.bin").write_bytes(b"1&1&1&" + bytes(4))
    assert check_workspace(folder / "dense") == []
    for name in source.picture_names[:5]:
        (maps / f"{name}.geometric.bin").unlink()
    (remark,) = check_workspace(folder / "dense")
    said = "has no geometric depth maps of 5 of 12 images: 00.png, 01.png, 02.png and 2 more"
    assert remark.text == f"{folder / 'dense'} {said}" and remark.severity == "caution"
    _ = source.dense
    assert remark in source.notes


def test_a_list_of_visible_images_that_does_not_fit_its_cloud_is_said(workspace):
    folder, cloud = workspace
    path = write_cloud(folder / "dense/fused.ply", cloud[:2000])
    seen = path.with_name("fused.ply.vis")
    rows = [np.arange(k % 5 + 1) for k in range(2000)]
    whole = b"".join(np.array([len(row), *row], "<u4").tobytes() for row in rows)
    fine = (2000).to_bytes(8, "little") + whole
    for data, why in (
        (fine, ""),
        (fine[:-2], "cut off"),
        (fine[:-4], "cut off"),
        (fine[:8], "cut off"),
        (fine[:5], "cut off"),
        (b"", "cut off"),
        (fine + bytes(4), "cut off"),
        ((1999).to_bytes(8, "little") + whole, "lists 1,999 points, but fused.ply has 2,000"),
        (fine[:-4] + (12_000).to_bytes(4, "little"), "names images that the undistorted model lacks"),
    ):
        seen.write_bytes(data)
        assert (why in visibility_fault(path, 12)) if why else not visibility_fault(path, 12), why
    assert any("fused.ply.vis names images" in remark.text for remark in check_workspace(folder / "dense"))


@pytest.mark.parametrize("program", ["colmap", "opensfm"])
def test_a_cloud_that_is_applied_to_lies_on_the_model_that_was_scaled(workspace, tmp_path, program):
    folder, cloud = workspace
    if program == "opensfm":
        folder = opensfm(pycolmap.Reconstruction(folder / "sparse"), tmp_path / "opensfm")
    source = open_source(folder, need_images=False, ground_cloud="none")
    (tmp_path / "metric").mkdir()
    source.write(tmp_path / "metric", 2.5)
    paths = {}
    for name, points in (("own", cloud), ("part", cloud[cloud[:, 0] > 0]), ("other", 40 + cloud)):
        paths[name] = write_cloud(tmp_path / f"{name}.ply", points)
    said = apply(tmp_path / "metric/sim3.json", list(paths.values()), tmp_path / "out")
    assert {path.name for path, notes in said.items() if notes} == {"other.ply"}
    assert "does not lie on the sparse points" in said[tmp_path / "out/other.ply"][0]
    (tmp_path / "alone").mkdir()
    shutil.copy(tmp_path / "metric/sim3.json", tmp_path / "alone")
    assert not apply(tmp_path / "alone/sim3.json", paths["other"], tmp_path / "again")[tmp_path / "again/other.ply"]


def written(path, points):
    """`points` at `path`, in the format of its ending."""
    if path.suffix == ".las":
        head = bytearray(375)
        head[:4], head[24:26], head[104] = b"LASF", b"\1\4", 6
        struct.pack_into("<H", head, 94, 375)
        struct.pack_into("<I", head, 96, 375)
        struct.pack_into("<HI", head, 105, 30, 0)
        struct.pack_into("<6d", head, 131, *[1e-4] * 3, *points[0])
        struct.pack_into("<Q", head, 247, len(points))
        rows = np.zeros(len(points), np.dtype({"names": ["xyz"], "formats": ["3<i4"], "itemsize": 30}))
        rows["xyz"] = np.round((points - points[0]) / 1e-4)
        path.write_bytes(bytes(head) + rows.tobytes() + b"more records, after the points")
    elif path.suffix == ".laz":
        pytest.importorskip("lazrs")
        laspy = pytest.importorskip("laspy")
        cloud = laspy.create(point_format=3)
        cloud.header.scales, cloud.header.offsets = [1e-4] * 3, points[0]
        cloud.x, cloud.y, cloud.z = points.T
        cloud.write(path)
    elif path.suffix in (".glb", ".gltf"):  # placed twice below a turned and shifted node: there, and far away
        turn = Rotation.from_euler("xyz", [1, 2, 3])
        inside = turn.inv().apply((points - [1, 2, 3]) / 2).astype("<f4")
        rows = np.zeros((len(points), 5), "<f4")  # other numbers between the vertices
        rows[:, 1:4] = inside
        binary = bytes(8) + rows.tobytes()
        scene = {
            "asset": {"version": "2.0"},
            "nodes": [
                {"children": [1], "translation": [1, 2, 3], "rotation": turn.as_quat().tolist(), "scale": [2, 2, 2]},
                {"mesh": 0, "matrix": np.eye(4).ravel().tolist()},
                {"mesh": 1},
            ],
            "meshes": [
                {"primitives": [{"attributes": {"POSITION": 0}}]},
                {"primitives": [{"attributes": {"POSITION": 0}, "extensions": {"KHR_draco_mesh_compression": {}}}]},
            ],
            "accessors": [
                {"bufferView": 0, "byteOffset": 4, "componentType": 5126, "count": len(points), "type": "VEC3"}
            ],
            "bufferViews": [{"buffer": 0, "byteOffset": 8, "byteStride": 20, "byteLength": rows.nbytes}],
            "buffers": [{"byteLength": len(binary)}],
        }
        if path.suffix == ".glb":
            return glb(path, scene, binary)
        path.with_suffix(".bin").write_bytes(binary)
        scene["buffers"][0]["uri"] = path.with_suffix(".bin").name
        path.write_text(json.dumps(scene))
    elif path.suffix == ".pcd":
        rows = np.zeros(len(points) + 1, PCD_ROW)
        for axis, values in zip("xyz", np.vstack([points, [np.nan] * 3]).T, strict=True):  # a beam that hit nothing
            rows[axis] = values
        path.write_bytes(pcd("binary", rows.tobytes(), len(rows)))
    elif path.suffix == ".stl":
        rows = np.zeros(len(points) // 3, STL_TRIANGLE)
        rows["length"] = points[: 3 * len(rows)].reshape(-1, 9)
        path.write_bytes(bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes())
    elif path.suffix == ".off":
        path.write_text(f"OFF # by hand\n\n{len(points)} 0 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in points))
    elif path.suffix == ".splat":
        rows = np.zeros(len(points), GAUSSIAN)
        rows["length"][:, :3] = points
        path.write_bytes(rows.tobytes())
    else:
        first, before, between = ("", "v ", " ") if path.suffix == ".obj" else ("range,x,y,z\n", "0.5,", ",")
        lines = (before + between.join(f"{value:.5f}" for value in point) + "\n" for point in points)
        path.write_text(first + "".join(lines))
    return path


@pytest.mark.parametrize("ending", ["glb", "gltf", "las", "laz", "obj", "off", "pcd", "splat", "stl", "xyz"])
def test_meshes_and_clouds_in_other_formats_are_compared_too(workspace, tmp_path, ending):
    """Of PLY alone it was said: a mesh of another model got this one's scale, and nothing told so."""
    folder, cloud = workspace
    (tmp_path / "metric").mkdir()
    ColmapSource.open(folder, need_images=False).write(tmp_path / "metric", 2.5)
    own, other = (written(tmp_path / f"{k}.{ending}", cloud[::4] + 40 * k) for k in range(2))
    said = apply(tmp_path / "metric/sim3.json", [own, other], tmp_path / "out")
    told = [any("does not lie on the sparse points" in note for note in notes) for notes in said.values()]
    assert told == [False, True]


def test_a_mesh_that_was_turned_to_have_y_up_is_of_its_model(workspace, tmp_path):
    """As glTF wants it, and Blender exports it: it was said to be of another."""
    folder, cloud = workspace
    (tmp_path / "metric").mkdir()
    ColmapSource.open(folder, need_images=False).write(tmp_path / "metric", 2.5)
    mesh = written(tmp_path / "turned.glb", cloud[:, [0, 2, 1]] * [1, 1, -1])
    assert apply(tmp_path / "metric/sim3.json", mesh, tmp_path / "out") == {tmp_path / "out/turned.glb": []}


def vertices(path):
    return np.concatenate([np.empty((0, 3)), *vertices_in(path, 100)]).tolist()


def test_vertices_of_text_files_and_of_scenes(tmp_path):
    rows = np.zeros(3, PCD_ROW)
    for axis, values in zip("xyz", XYZ.T, strict=True):
        rows[axis] = values
    (tmp_path / "a.pcd").write_bytes(pcd("ascii", pcd_body("ascii", rows)))
    corners = "".join(f"  vertex {x} {y} {z}\n" for x, y, z in XYZ)
    (tmp_path / "a.stl").write_text(f"solid a\nfacet normal 0 0 1\n outer loop\n{corners} endloop\nendfacet\n")
    data = base64.b64encode(XYZ.astype("<f4").tobytes()).decode()
    scene = {
        "nodes": [{"mesh": 0, "children": [1]}, {"mesh": 0, "skin": 0, "children": [0]}, {"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}, {"attributes": {}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3}],
        "bufferViews": [{"buffer": 0}],
        "buffers": [{"uri": f"data:application/octet-stream;base64,{data}"}],
        "extensions": {"CESIUM_RTC": {"center": [0, 0, 1]}},
    }
    (tmp_path / "a.gltf").write_text(json.dumps(scene))
    assert vertices(tmp_path / "a.pcd") == vertices(tmp_path / "a.stl") == XYZ.tolist()
    assert vertices(tmp_path / "a.gltf") == (XYZ + [0, 0, 1]).tolist(), "of the third node: the others have no root"
    for change in ({"componentType": 5122}, {"sparse": {}}, {"bufferView": None}):
        changed = {**scene, "accessors": [{**scene["accessors"][0], **change}]}
        (tmp_path / "a.gltf").write_text(json.dumps(changed))
        assert not vertices(tmp_path / "a.gltf")
    for accessors in ([], [{**scene["accessors"][0], "count": 4}]):
        (tmp_path / "a.gltf").write_text(json.dumps({**scene, "accessors": accessors}))
        with pytest.raises(InputError, match="a vertex is missing or malformed"):
            vertices(tmp_path / "a.gltf")
    (tmp_path / "a.gltf").write_text(json.dumps({**scene, "buffers": [{"uri": "gone.bin"}]}))
    with pytest.raises(InputError, match=r"its buffer gone\.bin is not beside it"):
        vertices(tmp_path / "a.gltf")


@pytest.mark.parametrize("what", ["points", "centres"])
def test_without_points_or_cameras_nothing_can_be_told(scene, what):
    points, centres, cloud = scene
    none = np.empty((0, 3))
    given = (none, centres) if what == "points" else (points, none)
    fit = cloud_fit(*given, [cloud[:5000]])
    assert not fit.another and not fit.own
