"""Reconstructions of OpenSfM and nerfstudio: the same model as COLMAP's, and back again in metres."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from support.flights import found_by
from support.geometry import ply
from support.models import make_model, put_frames, save
from support.other_programs import LENS, nerfstudio, opensfm, rescaled, same_views

from orthoscale.actions.estimate import estimate
from orthoscale.actions.fix import fix, rehearsed
from orthoscale.actions.workspace import models_in
from orthoscale.errors import InputError, OutputError, UsageError
from orthoscale.formats.detections.own import save_detections
from orthoscale.formats.geometry.files import scale_file
from orthoscale.requests import FixRequest
from orthoscale.sources import ground, ground_plane
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.json_model import ExchangeSource
from orthoscale.sources.opening import open_source


@pytest.fixture(scope="module")
def made():
    return make_model("RADIAL", (LENS["f"], 320, 240, LENS["k1"], LENS["k2"]))


WRITERS = {"opensfm": opensfm, "nerfstudio": nerfstudio}


@pytest.mark.parametrize("program", WRITERS)
def test_views_are_those_of_the_colmap_model(made, tmp_path, program):
    model, _ = made
    colmap = ColmapSource.open(save(model, tmp_path / "colmap", "bin"), need_images=False)
    other = open_source(WRITERS[program](model, tmp_path / "other"), need_images=False)
    same_views(colmap, other, "" if program == "opensfm" else "images/")
    assert other.camera_height == pytest.approx(colmap.camera_height, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("program", WRITERS)
def test_written_again_in_metres(made, tmp_path, program):
    path, result = rescaled(*made, WRITERS[program], tmp_path)
    assert set(result.measured.modes) == {"oblique", "planar"}
    new = open_source(tmp_path / "out" / path.name, need_images=False)
    assert isinstance(new, ExchangeSource)
    assert new.camera_height == pytest.approx(result.scale.value * result.source.camera_height, rel=1e-5)
    assert {"sim3.json", "report.json", "vehicles.png", path.name} <= {p.name for p in (tmp_path / "out").iterdir()}
    assert new.metric_already and new.content_hash() != result.source.content_hash()
    with pytest.raises(UsageError, match="in metres already"):
        fix(tmp_path / "out", tmp_path / "again", fleet="DE", detections=tmp_path / "boxes.json")
    assert models_in(path.parent) == []


@pytest.mark.parametrize(
    ("kind", "camera"),
    [
        ("brown", {"focal_x": 0.6, "focal_y": 0.62, "c_x": 0.01, "c_y": -0.02, "p1": 0.001, "p2": 0.002, "k3": 0.01}),
        ("fisheye", {"focal": 0.6}),
        ("fisheye_opencv", {"focal_x": 0.6, "focal_y": 0.6, "c_x": 0.0, "c_y": 0.0, "k3": 0.0, "k4": 0.0}),
        ("simple_radial", {"focal_x": 0.6, "focal_y": 0.61, "c_x": 0.01, "c_y": 0.0}),
        ("radial", {"focal_x": 0.6, "focal_y": 0.61, "c_x": 0.01, "c_y": 0.0}),
    ],
)
def test_lenses_of_opensfm(made, tmp_path, kind, camera):
    """Against OpenSfM's own formulas, written out here: normalised by the longer side, from the middle."""
    values = {"k1": 0.02, "k2": -0.01, **camera}
    source = open_source(opensfm(made[0], tmp_path, projection_type=kind, **values), need_images=False)
    name = source.picture_names[0]
    seen = np.array([[0.3, -0.2, 2.0], [-0.5, 0.4, 1.5], [0.05, 0.6, 3.0]])
    world = (seen - source._images[name].cam_from_world().translation) @ source.rotation(name)
    x, y = (seen[:, :2] / seen[:, 2:]).T
    k1, k2, k3 = values["k1"], values["k2"], values.get("k3", 0.0)
    if kind.startswith("fisheye"):
        r = np.hypot(x, y)
        theta = np.arctan(r)
        bend = theta / r * (1 + k1 * theta**2 + k2 * theta**4)
    else:
        r2 = x**2 + y**2
        bend = 1 + k1 * r2 + (k2 * r2**2 if kind != "simple_radial" else 0) + (k3 * r2**3 if kind == "brown" else 0)
    p1, p2 = (values.get(k, 0.0) for k in ("p1", "p2"))
    dx = 2 * p1 * x * y + p2 * (x**2 + y**2 + 2 * x**2)
    dy = p1 * (x**2 + y**2 + 2 * y**2) + 2 * p2 * x * y
    fx = values.get("focal_x", values.get("focal"))
    fy = values.get("focal_y", fx)
    u = (fx * (x * bend + dx) + values.get("c_x", 0)) * 640 + 320
    v = (fy * (y * bend + dy) + values.get("c_y", 0)) * 640 + 240
    assert np.allclose(source.project(name, world), np.column_stack([u, v]), atol=1e-6)


@pytest.mark.parametrize("place", ["file", "frames"])
def test_a_fisheye_of_instant_ngp_is_none_of_nerfstudios_perspective_lenses(made, tmp_path, place):
    """colmap2nerf.py writes `is_fisheye` and no `camera_model`; its k1 to k4 are those of OpenCV's fisheye then."""
    bend = {"k1": 0.02, "k2": -0.01, "k3": 0.003, "k4": -0.001}
    named = open_source(nerfstudio(made[0], tmp_path / "a", camera_model="OPENCV_FISHEYE", **bend), need_images=False)
    path = nerfstudio(made[0], tmp_path / "b", **bend)
    text = json.loads(path.read_text())
    text.pop("camera_model", None)
    for part in [text] if place == "file" else text["frames"]:
        part["is_fisheye"] = True
    path.write_text(json.dumps(text))
    source = open_source(path, need_images=False)
    for name in source.picture_names:
        assert np.allclose(
            source.project(name, source.sparse[0]), named.project(name, source.sparse[0]), equal_nan=True
        )


def test_several_reconstructions_and_gps(made, tmp_path):
    path = opensfm(made[0], tmp_path)
    (part,) = json.loads(path.read_text())
    few = {**part, "shots": dict(list(part["shots"].items())[:3])}
    path.write_text(json.dumps([few, part]))
    source = open_source(path, need_images=False)
    assert len(source.picture_names) == 12 and "2 reconstructions" in source.notes[0].text
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.0)
    assert len(json.loads((tmp_path / "out/reconstruction.json").read_text())) == 1
    assert not source.metric_already
    for shot in part["shots"].values():
        shot |= {"gps_position": [1, 2, 3], "gps_dop": 15.0}
    path.write_text(json.dumps([{**part, "reference_lla": {"latitude": 1, "longitude": 2, "altitude": 0}}]))
    assert "GPS" in open_source(path, need_images=False).metric_already


def test_a_cloud_that_nerfstudio_does_not_name_is_read_and_written(made, tmp_path):
    """`sparse_pc.ply` lies beside it; instant-ngp's file has none."""
    path = nerfstudio(made[0], tmp_path / "in")
    text = json.loads(path.read_text())
    del text["ply_file_path"]
    path.write_text(json.dumps(text))
    source = open_source(path, need_images=False)
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.0)
    written = open_source(tmp_path / "out" / path.name, need_images=False)
    assert np.allclose(written.sparse[0], 2 * source.sparse[0], atol=1e-4)
    (path.parent / "sparse_pc.ply").unlink()
    assert scale_file(path, tmp_path / "alone.json", 2.0) == []


def test_a_nerfstudio_model_in_a_maps_coordinates_is_metric_already(made, tmp_path):
    path = nerfstudio(made[0], tmp_path)
    assert not open_source(path, need_images=False).metric_already
    text, on_map = json.loads(path.read_text()), np.array([500_000.0, 4_000_000.0, 50.0])
    for frame in text["frames"]:
        pose = np.array(frame["transform_matrix"])
        pose[:3, 3] += on_map
        frame["transform_matrix"] = pose.tolist()
    path.write_text(json.dumps(text))
    points = np.array([p.xyz for p in made[0].points3D.values()])
    ply(tmp_path / "sparse_pc.ply", "ascii", ["x", "y", "z"], points + on_map)
    source = open_source(path, need_images=False)
    assert "as on a map" in source.metric_already
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 1.01)
    assert any("40,311 m away from its place" in note.text for note in source.notes)


def test_what_a_transforms_json_names_in_model_units_is_told(made, tmp_path):
    """As `apply` tells it: depth maps beside it are not scaled."""
    path = nerfstudio(made[0], tmp_path / "in")
    text = json.loads(path.read_text())
    text["frames"][0]["depth_file_path"] = "depth.npy"
    path.write_text(json.dumps(text))
    source = open_source(path, need_images=False)
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.0)
    said = "transforms.json: the depth maps that it names stay in model units: multiply them by 2"
    assert said in [note.text for note in source.notes]
    assert not any("with sparse_pc.ply" in note.text for note in source.notes)


def test_a_colmap_model_comes_first(made, tmp_path):
    save(made[0], tmp_path / "sparse/0", "bin")
    nerfstudio(made[0], tmp_path)
    assert not isinstance(open_source(tmp_path, need_images=False), ExchangeSource)
    assert isinstance(open_source(tmp_path / "transforms.json", need_images=False), ExchangeSource)


def test_panoramas_are_refused_unless_no_image_is_one(made, tmp_path):
    path = opensfm(made[0], tmp_path / "a")
    (part,) = json.loads(path.read_text())
    sphere = {"projection_type": "spherical", "width": 640, "height": 320}
    path.write_text(json.dumps([part | {"cameras": part["cameras"] | {"pano": sphere}}]))
    assert len(open_source(path, need_images=False).picture_names) == 12
    path.write_text(json.dumps([part | {"cameras": {"c": sphere}}]))
    for other in (path, nerfstudio(made[0], tmp_path / "b", camera_model="EQUIRECTANGULAR")):
        with pytest.raises(InputError) as caught:
            open_source(other, need_images=False)
        assert "Cut perspective views" in caught.value.hint


@pytest.mark.parametrize("program", WRITERS)
def test_pickled_as_its_path(made, tmp_path, program):
    source = open_source(WRITERS[program](made[0], tmp_path), need_images=False, ground_cloud="none")
    again = pickle.loads(pickle.dumps(source))
    assert type(again) is ExchangeSource and again.content_hash() == source.content_hash()


def test_a_cloud_outside_of_the_folder_is_refused_before_measuring(made, tmp_path):
    path = nerfstudio(made[0], tmp_path / "in")
    text = json.loads(path.read_text())
    (path.parent / text["ply_file_path"]).rename(tmp_path / "cloud.ply")
    path.write_text(json.dumps({**text, "ply_file_path": "../cloud.ply"}))
    put_frames(made[0], path.parent / "images")
    with pytest.raises(InputError, match="outside its folder"):
        rehearsed(path, tmp_path / "out", FixRequest.of({"fleet": "DE"}))


def test_damage_is_refused(made, tmp_path):
    path = opensfm(made[0], tmp_path / "a")
    whole = path.read_text()
    part = json.loads(whole)[0]

    def broken(**changes):
        return json.dumps([{**part, **changes}])

    first = next(iter(part["shots"]))
    shot = part["shots"][first]
    damaged = [whole[: len(whole) * k // 20] for k in range(20)]
    damaged += [broken(shots={}), broken(points={}), broken(cameras={}), "[]", "{}", "[{}]", "7", "null", '"a"']
    damaged += [broken(shots={first: {**shot, key: value}}) for key, value in
                [("translation", [1, 2]), ("translation", [1, 2, float("nan")]), ("translation", [1e300, 0, 0]),
                 ("rotation", "x"), ("camera", "nobody")]]  # fmt: skip
    lens = part["cameras"]["c"]
    for change in (
        {"focal": -1},
        {"focal": None},
        {"width": 0},
        {"projection_type": "spherical"},
        {"k1": float("inf")},
    ):
        damaged.append(broken(cameras={"c": {**lens, **change}}))
    for text in damaged:
        path.write_text(text)
        with pytest.raises(InputError, match=r"reconstruction\.json"):
            open_source(path, need_images=False)

    path = nerfstudio(made[0], tmp_path / "b")
    text = json.loads(path.read_text())
    frame = text["frames"][0]
    for change in (
        {"frames": []}, {"frames": [{"file_path": "a.jpg"}]}, {"frames": [frame, frame]}, {"w": None},
        {"camera_model": "EQUIRECTANGULAR"}, {"ply_file_path": "nowhere.ply"}, {"fl_x": 0},
        {"frames": [{**frame, "transform_matrix": np.full((4, 4), 2.0).tolist()}]},
    ):  # fmt: skip
        path.write_text(json.dumps({**text, **change}))
        with pytest.raises(InputError):
            open_source(path, need_images=False)


def test_a_write_that_fails_is_noticed(made, tmp_path, monkeypatch):
    source = open_source(opensfm(made[0], tmp_path / "in"), need_images=False)
    (tmp_path / "out").mkdir()
    monkeypatch.setattr("orthoscale.formats.geometry.files.scale_reconstruction",
                        lambda a, b, s: b.write_text(a.read_text()))  # fmt: skip
    with pytest.raises(OutputError, match="differs"):
        source.write(tmp_path / "out", 2.0)


@pytest.mark.slow
def test_one_model_has_one_scale_in_every_form(made, tmp_path):
    """Points in another order, pictures under other names: the boxes are the same, and so is the scale."""
    model, turn = made
    colmap = save(model, tmp_path / "colmap", "bin")
    put_frames(model, colmap / "images")
    found = found_by(colmap, turn)
    save_detections(found, tmp_path / "boxes.json")
    scales = scales_of(colmap, tmp_path / "boxes.json")

    path = opensfm(model, tmp_path / "opensfm")
    put_frames(model, path.parent / "images")
    (part,) = json.loads(path.read_text())
    part["points"] = {
        key: part["points"][key] for key in np.random.default_rng(0).permutation(list(part["points"])).tolist()
    }
    part["shots"] = dict(reversed(part["shots"].items()))
    path.write_text(json.dumps([part]))
    # Not the very same: only COLMAP's form has tracks, which tell that such a flat block leaves the focal length open,
    # and with it how much of a vehicle's height its boxes show.
    without_tracks = scales_of(path, tmp_path / "boxes.json")
    assert without_tracks == pytest.approx(scales, rel=5e-3)

    path = nerfstudio(model, tmp_path / "nerfstudio")
    put_frames(model, path.parent / "images")
    renamed = {"boxes": {f"images/{name}": boxes for name, boxes in found.boxes.items()}}
    above = {name.replace("/", "/images/"): boxes for name, boxes in found.planar.boxes.items()}
    save_detections(replace(found, **renamed, planar=replace(found.planar, boxes=above)), tmp_path / "renamed.json")
    assert scales_of(path, tmp_path / "renamed.json") == pytest.approx(without_tracks, rel=1e-3)


def scales_of(model, boxes):
    """By frames, from above, and by both together [m per unit]."""
    measured = estimate(model, fleet="DE", detections=boxes).measured
    return {"both": measured.scale.value, **{name: way.scale.value for name, way in measured.modes.items()}}


def test_the_ground_does_not_depend_on_the_order_of_points_and_images(made, tmp_path, monkeypatch):
    """Which points and cameras the fit draws follows from their order."""
    model, _ = made
    path = opensfm(model, tmp_path)
    (part,) = json.loads(path.read_text())
    asked = []
    monkeypatch.setattr(
        ground, "plane_below", lambda *given: asked.append(given[:2]) or ground_plane.plane_below(*given)
    )
    for turn in (1, -1):
        points, shots = (dict(list(part[what].items())[::turn]) for what in ("points", "shots"))
        path.write_text(json.dumps([{**part, "points": points, "shots": shots}]))
        open_source(path, need_images=False).ground  # noqa: B018
    for one, other in zip(*asked, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("project.psx", "Export Cameras"),
        ("cameras.xml", "Export Cameras"),
        ("flight.rcproj", "Export the registration"),
        ("flight.p4d", "orthophoto that it made"),
        ("cameras.sfm", "aliceVision_exportColmap"),
        ("sfm_data.bin", "openMVG_main_openMVG2Colmap"),
        ("scene.mvs", "made from"),
        ("cloud.ply", "sim3.json cloud.ply --out"),
        ("mesh.LAZ", "sim3.json mesh.LAZ --out"),
        ("cloud.e57", "As PLY"),
        ("flight.mp4", "reconstruct the frames"),
        ("database.db", "sparse/0"),
        ("ortho.zip", "unpack it"),
        ("ortho.tif.gz", "unpack it"),
        ("notes.xml", "GeoTIFF"),
    ],
)
def test_what_is_no_picture_and_no_model_is_told_its_way(tmp_path, name, said):
    """All were "no image that GDAL can open; use a GeoTIFF"."""
    text = "<?xml version='1.0'?>\n<document version='1.5.0'><chunk/></document>" if name == "cameras.xml" else "x\n"
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="GDAL") as told:
        open_source(tmp_path / name)
    assert said in told.value.hint


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("https://example.org/ortho.tif", "download"),
        ("s3://bucket/ortho.tif", "download"),
        ("/vsizip/flight.zip/ortho.tif", "unpack"),
        ("/vsicurl/https://example.org/ortho.tif", "download"),
        ("GTIFF_DIR:2:ortho.tif", "download"),
        ("C:/flight/ortho.tif", "Give an orthophoto"),
        ("vsizip/ortho.tif", "Give an orthophoto"),
    ],
)
def test_what_is_on_no_disk_is_told_its_way(name, said):
    """Addresses and GDAL's own folders only "did not exist"."""
    with pytest.raises(InputError, match="does not exist") as told:
        open_source(name)
    assert said in told.value.hint


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("sfm_data.json", {"sfm_data_version": "0.3", "views": []}, "openMVG2Colmap"),
        ("scene.json", {"version": ["1", "2"], "featuresFolders": [], "views": []}, "aliceVision_exportColmap"),
        ("sim3.json", {"scale": 2.0}, "orthoscale apply"),
        ("cameras.json", {"a.jpg": {"focal": 0.9}}, "made from"),
        ("any.json", {"a": 1}, "nerfstudio"),
        ("number.json", 3, "nerfstudio"),
    ],
)
def test_json_of_other_kinds_is_told_its_way(tmp_path, name, text, said):
    (tmp_path / name).write_text(json.dumps(text))
    with pytest.raises(InputError, match="not a transforms.json") as told:
        open_source(tmp_path / name)
    assert said in told.value.hint


@pytest.mark.parametrize("name", ["project.files", "survey/sfm_data.bin", "survey/project.psx"])
def test_folders_of_other_programs_are_told_their_way(tmp_path, name):
    place = tmp_path / name
    if place.suffix == ".files":
        place.mkdir()
    else:
        place.parent.mkdir()
        place.write_text("x")
        place = place.parent
    with pytest.raises(InputError, match="holds no COLMAP model") as told:
        open_source(place)
    assert "are not read" in told.value.hint
