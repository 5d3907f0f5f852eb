"""COLMAP models: reading guarded, views exact, writing verified."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import pickle
import shutil
import struct
import subprocess
import sys
import weakref
from dataclasses import replace
from pathlib import Path
from unicodedata import normalize

import cv2
import numpy as np
import pycolmap
import pytest
import rasterio
from support.models import draw_points, make_model, patched, put_frames, save

from orthoscale.actions.opening import source_of
from orthoscale.core.remarks import CAUTION, INFO, REFUSAL, Remark
from orthoscale.errors import InputError, OrthoscaleError, OutputError, UsageError
from orthoscale.requests import EstimateRequest
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.colmap_check import open_model
from orthoscale.sources.colmap_tables import CAMERA_MODELS
from orthoscale.sources.dense_cloud import DenseCloud
from orthoscale.sources.distortion import project, undistort
from orthoscale.sources.opening import open_source
from orthoscale.sources.picture_file import PictureFile, stored_size
from orthoscale.sources.tags import read_tags

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared/data") / "reconstructions"


# --- Models made here ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["plain", "rig"])
def made(request):
    return make_model(rig=request.param == "rig")


@pytest.fixture(scope="module")
def plain():
    return make_model()[0]


@pytest.fixture
def model_bin(plain, tmp_path):
    return save(plain, tmp_path / "model", "bin")


@pytest.fixture
def model_txt(plain, tmp_path):
    return save(plain, tmp_path / "model", "txt")


# --- Views -----------------------------------------------------------------------------------------------------------

LENSES = {
    "SIMPLE_PINHOLE": (400, 320, 240),
    "SIMPLE_RADIAL": (400, 320, 240, 0.03),
    "OPENCV": (400, 410, 320, 240, 0.05, -0.02, 0.001, -0.001),
    "OPENCV_FISHEYE": (400, 410, 320, 240, 0.05, -0.02, 0.001, -0.001),
    "FULL_OPENCV": (400, 410, 320, 240, 0.05, -0.02, 0.001, -0.001, 0.002, 0, 0, 0),
}


@pytest.mark.parametrize("lens", LENSES)
def test_views_against_pycolmap(lens, tmp_path):
    model, turn = make_model(lens, LENSES[lens])
    source = ColmapSource.open(save(model, tmp_path / "m", "bin"), need_images=False)
    image = next(i for i in model.images.values() if i.name == "04.png")
    random = np.random.default_rng(2)
    pixels = random.uniform([40, 40], [600, 440], (300, 2))
    views, world, ok = source.views("04.png", pixels)
    assert ok.mean() > 0.9
    pose = image.cam_from_world()
    up = turn[:, 2]
    for view, place, pixel in zip(range(300), world, pixels, strict=True):
        if not ok[view]:
            continue
        assert np.abs(image.project_point(place) - pixel).max() < 1e-6
        assert np.allclose(views.ground[view], pose * place, atol=1e-9)
        # A step on the plane z = 1 moves the pixel by the lens.
        plane = views.ground[view, :2] / views.ground[view, 2]
        step = 1e-6 * random.normal(size=2)
        moved = image.camera.img_from_cam(np.array([*(plane + step), 1.0])) - pixel
        assert np.abs(moved - views.lens[view] @ step).max() < 1e-6
    assert np.abs(world[ok] @ up).max() < 0.005 * 12
    assert np.degrees(np.arccos((views.normal[ok] @ (pose.rotation.matrix() @ up)).min())) < 1
    assert np.median(views.unit_per_pixel[ok]) == pytest.approx(12 / 400, rel=0.3)
    assert source.camera_height == pytest.approx(12, rel=0.005)


def test_views_in_a_rig(tmp_path):
    model, turn = make_model(rig=True)
    source = ColmapSource.open(save(model, tmp_path / "m", "txt"), need_images=False)
    pixels = np.array([[320.0, 240], [100, 400]])
    for image in model.images.values():
        views, world, ok = source.views(image.name, pixels)
        assert ok[0], "the middle of each looks down on the ground"
        for k in np.flatnonzero(ok):
            assert np.abs(image.project_point(world[k]) - pixels[k]).max() < 1e-6
            assert abs(world[k] @ turn[:, 2]) < 0.06


def test_views_that_fail_are_finite(model_bin):
    source = ColmapSource.open(model_bin, need_images=False)
    pixels = np.array([[np.nan, 3], [np.inf, 0], [1e9, 1e9], [-1e4, 1e4], [320, 240]])
    views, world, ok = source.views("04.png", pixels)
    assert ok.tolist() == [False] * 4 + [True]
    for values in (views.ground, views.normal, views.lens, views.elevation, views.unit_per_pixel, world):
        assert np.isfinite(values).all()
    steep = source.views("04.png", pixels[4:], lowest_elevation=89)[2]
    assert not steep.any()
    assert len(source.views("04.png", np.empty((0, 2)))[0]) == 0
    with pytest.raises(UsageError, match="nobody"):
        source.views("nobody.png", pixels)


# --- Writing ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_write(made, form, tmp_path):
    model, _ = made
    folder = save(model, tmp_path / "m", form)
    (folder / "project.ini").write_text("log_level=0\n")
    unscaled = ("points3D.ply", "mesh.off", "splat.spz", "cloud.laz", "depth.npz", "c.pts", "m.fbx")  # in the old units
    for name in unscaled:
        (folder / name).write_text("ply\n")
    (folder / "notes.txt").symlink_to(Path(__file__))
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    out = tmp_path / "out"
    out.mkdir()
    source = ColmapSource.open(folder, need_images=False)
    assert source.input_format == form and not source.metric_already
    source.write(out, 14.157)
    assert any("project.ini" in n for n in map(str, source.notes))
    assert all(any(name in n and "left in" in n for n in map(str, source.notes)) for name in unscaled)
    assert any("notes.txt" in n and "symbolic links" in n for n in map(str, source.notes))
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before

    tables = {f"{t}.{form}" for t in ("cameras", "images", "points3D", "rigs", "frames")}
    assert {p.name for p in out.iterdir()} == tables | {"sim3.json", "sim3.txt", "sim3_4x4.txt", "project.ini"}
    sim3 = [float(word) for word in (out / "sim3.txt").read_text().split()]
    assert sim3 == [14.157, 1, 0, 0, 0, 0, 0, 0]
    written = pycolmap.Reconstruction(str(out))
    for number, point in model.points3D.items():
        assert np.allclose(written.points3D[number].xyz, 14.157 * point.xyz, rtol=1e-12, atol=1e-12)
        assert (written.points3D[number].color == point.color).all()
    for number, image in model.images.items():
        assert np.allclose(written.images[number].projection_center(), 14.157 * image.projection_center(), atol=1e-10)
        for observed in image.points2D[:20]:
            if observed.has_point3D():
                i = observed.point3D_id
                before = image.project_point(model.points3D[i].xyz)
                after = written.images[number].project_point(written.points3D[i].xyz)
                assert np.abs(before - after).max() < 1e-9
    (out / "report.json").write_text(json.dumps({}))
    again = ColmapSource.open(out, need_images=False)
    assert again.metric_already
    assert again.camera_height == pytest.approx(14.157 * source.camera_height, rel=1e-6)
    assert again.content_hash() != source.content_hash()


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_every_sensor_of_a_rig_moves(tmp_path, monkeypatch, form):
    """Those that took no image too, whose places no projection shows: they were not compared."""
    model, _ = make_model(rig=True)
    rig = model.rigs[1]
    idle = pycolmap.sensor_t(pycolmap.SensorType.IMU, 7)
    rig.add_sensor(idle, pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.1, 0.2, 0.3])))
    source = ColmapSource.open(save(model, tmp_path / "m", form), need_images=False)
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.5)
    written = pycolmap.Reconstruction(str(tmp_path / "out")).rigs[1]
    for sensor, pose in rig.non_ref_sensors.items():
        assert np.allclose(written.non_ref_sensors[sensor].translation, 2.5 * pose.translation, rtol=1e-14)
        assert np.allclose(written.non_ref_sensors[sensor].rotation.quat, pose.rotation.quat, atol=1e-15)

    kind = {"bin": "write_binary", "txt": "write_text"}[form]
    honest = getattr(pycolmap.Reconstruction, kind)

    def forgetful(model, folder):
        model.rigs[1].set_sensor_from_rig(idle, rig.sensor_from_rig(idle))
        honest(model, folder)

    monkeypatch.setattr(pycolmap.Reconstruction, kind, forgetful)
    (tmp_path / "again").mkdir()
    with pytest.raises(OutputError, match="sensor of a rig is 0.45 off"):
        source.write(tmp_path / "again", 2.5)


def test_write_a_model_without_rigs(model_bin, tmp_path):
    (model_bin / "rigs.bin").unlink()
    (model_bin / "frames.bin").unlink()
    (tmp_path / "out").mkdir()
    ColmapSource.open(model_bin, need_images=False).write(tmp_path / "out", 0.5)
    assert open_model(tmp_path / "out").format == "bin"


def test_write_a_model_of_few_digits(made, tmp_path):
    folder = save(made[0], tmp_path / "m", "bin")
    for name, offset in (("frames.bin", 16), ("images.bin", 12)):
        quaternion = struct.unpack_from("<4d", (folder / name).read_bytes(), offset)
        patched(folder, name, offset, "4d", *(1.0001 * q for q in quaternion))
    (tmp_path / "out").mkdir()
    ColmapSource.open(folder, need_images=False).write(tmp_path / "out", 3)


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf")])
def test_impossible_scales(model_bin, tmp_path, scale):
    with pytest.raises(UsageError):
        ColmapSource.open(model_bin, need_images=False).write(tmp_path, scale)


def test_a_write_that_fails_is_noticed(model_bin, tmp_path, monkeypatch):
    source = ColmapSource.open(model_bin, need_images=False)
    with pytest.raises(OutputError):
        source.write(tmp_path / "nowhere", 2)
    honest = pycolmap.Reconstruction.write_binary

    def full_disk(model, folder):
        honest(model, folder)
        points = Path(folder) / "points3D.bin"
        points.write_bytes(points.read_bytes()[:-100])

    def forgetful(model, folder):
        model.transform(pycolmap.Sim3d(1 + 1e-7, pycolmap.Rotation3d(), np.zeros(3)))
        honest(model, folder)

    for number, wrong in enumerate((full_disk, forgetful)):
        monkeypatch.setattr(pycolmap.Reconstruction, "write_binary", wrong)
        (tmp_path / str(number)).mkdir()
        with pytest.raises(OutputError):
            source.write(tmp_path / str(number), 2)


def test_content_hash(model_bin):
    source = ColmapSource.open(model_bin, need_images=False)
    first = source.content_hash()
    assert len(first) == 64 and first == source.content_hash()
    assert ColmapSource.open(model_bin.parent / "model", need_images=False).content_hash() == first


# --- Finding the model and its frames --------------------------------------------------------------------------------


def test_workspaces(plain, tmp_path):
    save(plain, tmp_path / "one/sparse", "bin")
    assert open_model(tmp_path / "one").folder.name == "sparse"
    save(plain, tmp_path / "two/sparse/0", "txt")
    files = open_model(tmp_path / "two")
    assert files.folder.name == "0" and not files.notes
    save(plain, tmp_path / "stray", "txt")
    shutil.copy(tmp_path / "one/sparse/points3D.bin", tmp_path / "stray")
    (note,) = open_model(tmp_path / "stray").notes
    assert "reading the .txt files; points3D.bin without the rest ignored" in note
    small = make_model()[0]
    for frame in list(small.reg_frame_ids())[4:]:
        small.deregister_frame(frame)
    save(small, tmp_path / "many/sparse/0", "bin")
    save(plain, tmp_path / "many/sparse/1", "bin")
    for path in (tmp_path / "many", tmp_path / "many/sparse"):
        files = open_model(path)
        assert files.folder.name == "1" and "most images (12; 0: 4)" in files.notes[0]


def test_missing_models(tmp_path, model_bin):
    with pytest.raises(InputError, match="does not exist"):
        open_model(tmp_path / "nowhere")
    with pytest.raises(InputError, match="is a file"):
        open_model(model_bin / "cameras.bin")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no COLMAP model"):
        open_model(tmp_path / "empty")
    (model_bin / "rigs.bin").unlink()
    with pytest.raises(InputError, match="rigs.bin is missing"):
        open_model(model_bin)
    (model_bin / "frames.bin").unlink()
    (model_bin / "points3D.bin").unlink()
    with pytest.raises(InputError, match="points3D.bin missing"):
        open_model(model_bin)


def test_both_formats(plain, tmp_path):
    folder = save(plain, save(plain, tmp_path / "m", "bin"), "txt")
    files = open_model(folder)
    assert files.format == "bin" and "agree" in files.notes[0]
    images = folder / "images.txt"
    lines = images.read_text().splitlines()
    lines[4] = lines[4].replace(" 12 1 ", " 24 1 ") if " 12 1 " in lines[4] else _with_word(lines[4], 7, "99.5")
    images.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="two different models"):
        open_model(folder)


def _with_word(line: str, index: int, word: str) -> str:
    words = line.split(" ")
    words[index] = word
    return " ".join(words)


@pytest.mark.parametrize("place", ["m/images", "images", "input"])
def test_frames_are_found(plain, tmp_path, place):
    folder = save(plain, tmp_path / "work/m/sparse/0" if place != "m/images" else tmp_path / "work/m", "bin")
    put_frames(plain, tmp_path / "work" / place)
    source = ColmapSource.open(folder)
    assert [p.name for p in source.pictures] == source.picture_names == sorted(i.name for i in plain.images.values())
    assert source.notes == []
    assert source.pictures[0].read(0, 0, 640, 480, 64, 48).shape == (48, 64, 3)


def test_missing_frames(plain, model_bin, tmp_path):
    with pytest.raises(InputError, match=r"first is 00.png; looked in .*images"):
        ColmapSource.open(model_bin)
    (note,) = ColmapSource.open(model_bin, need_images=False).notes
    assert "no anchors are searched for" in note.text, "what follows from it"
    with pytest.raises(InputError, match=r"--images .*elsewhere does not exist"):
        ColmapSource.open(model_bin, images=tmp_path / "elsewhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"first is 00.png; looked in .*empty"):
        ColmapSource.open(model_bin, images=tmp_path / "empty")
    bare = ColmapSource.open(model_bin, need_images=False)
    assert bare.pictures == [] and len(bare.picture_names) == 12 and "no frame" in bare.notes[0].text
    put_frames(plain, tmp_path / "frames")
    (tmp_path / "frames/03.png").unlink()
    source = ColmapSource.open(model_bin)
    assert len(source.pictures) == 11 and len(source.picture_names) == 12
    assert "1 of 12 frames" in source.notes[0].text and "03.png" in source.notes[0].text


def test_the_folder_that_names_start_from_is_told(plain, tmp_path):
    folder = renamed(plain, tmp_path / "m", "bin", lambda name: f"a/b/{name}")
    put_frames(plain, tmp_path / "images/a/b")
    for given in ("images/a", "images/a/b"):
        with pytest.raises(InputError, match=rf"(?s)a/b/00.png, .*begins above .*{given}.*--images .*/images: the"):
            ColmapSource.open(folder, images=tmp_path / given)


@pytest.mark.parametrize("below", ["flight", "2024/flight"])
def test_the_folder_below_that_has_the_frames_is_told(plain, model_bin, tmp_path, below):
    put_frames(plain, tmp_path / "photos" / below)
    with pytest.raises(InputError, match=rf"(?s)00.png, and it lies in .*--images .*photos/{below}\."):
        ColmapSource.open(model_bin, images=tmp_path / "photos")
    (tmp_path / "photos").rename(tmp_path / "images")
    with pytest.raises(InputError, match=rf"(?s)00.png, and it lies in .*--images .*images/{below}\."):
        ColmapSource.open(model_bin)


def test_frames_and_database_beside_a_link(plain, tmp_path):
    folder = save(plain, tmp_path / "disk/of/many/projects/sparse/0", "bin")
    put_frames(plain, tmp_path / "work/images")
    (tmp_path / "work/sparse").symlink_to(folder.parent)
    assert len(ColmapSource.open(tmp_path / "work").pictures) == 12
    put_frames(plain, folder.parent.parent / "images")
    shutil.rmtree(tmp_path / "work/images")
    assert len(ColmapSource.open(tmp_path / "work").pictures) == 12


def test_a_way_up_leads_out_of_the_folder_behind_a_link(plain, tmp_path):
    """``link/..`` is where the link leads, not where it lies."""
    save(plain, tmp_path / "disk/project/sparse/0", "bin")
    put_frames(plain, tmp_path / "disk/images")
    (tmp_path / "disk/project/other").mkdir()
    (tmp_path / "here").mkdir()
    (tmp_path / "here/link").symlink_to(tmp_path / "disk/project/other")
    source = ColmapSource.open(tmp_path / "here/link/../sparse")
    assert len(source.pictures) == 12 and source.content_hash()
    (tmp_path / "metric").mkdir()
    source.write(tmp_path / "metric", 2.0)
    assert ColmapSource.open(tmp_path / "metric", need_images=False).by_orthoscale


def renamed(plain, folder, form, change):
    """The model `plain` in `folder`, its images called `change` of their names."""
    model = pycolmap.Reconstruction(plain)
    for image in model.images.values():
        image.name = change(image.name)
    return save(model, folder, form)


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_names_of_windows(plain, tmp_path, form):
    folder = renamed(plain, tmp_path / "m", form, lambda name: f"flight 1\\{name}".replace(" ", "_"))
    put_frames(plain, tmp_path / "images/flight_1")
    source = ColmapSource.open(folder)
    assert [p.name for p in source.pictures] == source.picture_names and source.picture_names[0] == "flight_1\\00.png"
    assert source.pictures[0].read(0, 0, 640, 480, 64, 48).any()


@pytest.mark.parametrize("start", ["C:\\Users\\me\\", "/home/someone/", "\\\\nas\\share\\"])
def test_absolute_names_of_another_machine(plain, tmp_path, start):
    """Their frames are found below the folder that all of them share; the copy's names stay as they are."""
    folder = renamed(plain, tmp_path / "m", "bin", lambda n: f"{start}{'ab'[int(n[:2]) % 2]}/{n}")
    for name in "ab":
        put_frames(plain, tmp_path / "images" / name)
    source = ColmapSource.open(folder)
    place_of = {picture.name: picture.path for picture in source.pictures}
    assert source.notes == [] and place_of[f"{start}b/01.png"] == tmp_path / "images/b/01.png"
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.0)
    assert ColmapSource.open(tmp_path / "out").picture_names == source.picture_names
    for name in "ab":
        (tmp_path / "images" / name).rename(tmp_path / "images" / name.upper())
    with pytest.raises(InputError, match=r"the first is a/00.png, but .*images/A/00.png has another name"):
        ColmapSource.open(folder)


@pytest.mark.parametrize("change", [str.upper, lambda n: f"a/{n}", lambda n: f"b\\{n}", lambda n: n[:-3] + "jpg"])
def test_a_file_of_nearly_the_name_is_told(plain, tmp_path, change):
    folder = renamed(plain, tmp_path / "m", "bin", change)
    put_frames(plain, tmp_path / "images")
    (tmp_path / "images/00.json").write_text("{}")
    with pytest.raises(InputError, match=r"images/00.png has another name"):
        ColmapSource.open(folder)
    with pytest.raises(InputError, match=r"cameras.bin is not a folder"):
        ColmapSource.open(folder, folder / "cameras.bin")


@pytest.mark.parametrize("folder", ["", "Flug über/Köln/"])
def test_names_with_letters_of_two_characters_are_told(plain, tmp_path, folder):
    """The model has each marked letter as one character, the disk as two, or the other way: they look alike."""
    for model, disk in (("NFC", "NFD"), ("NFD", "NFC")):
        place = tmp_path / model
        where = renamed(plain, place / "m", "bin", lambda name, form=model: normalize(form, f"{folder}ä {name}"))
        put_frames(plain, place / "plain")
        for frame in sorted((place / "plain").iterdir()):
            target = place / "images" / normalize(disk, f"{folder}ä {frame.name}")
            target.parent.mkdir(parents=True, exist_ok=True)
            frame.rename(target)
        with pytest.raises(InputError, match=r"00.png has another name") as caught:
            ColmapSource.open(where)
        assert "as two characters" in caught.value.hint


def test_a_folder_of_frames_that_cannot_be_read_is_told(model_bin, tmp_path, monkeypatch):
    """It was said that the frames are not there."""
    (tmp_path / "images").mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path / "images")  # root may read it
    for given in (None, tmp_path / "images"):
        with pytest.raises(InputError, match=r"the first is 00.png, and .*images cannot be read"):
            ColmapSource.open(model_bin, given)


def test_a_folder_of_another_case_is_told(plain, tmp_path):
    folder = renamed(plain, tmp_path / "m", "bin", lambda name: f"flight/{name}")
    put_frames(plain, tmp_path / "images/Flight")
    with pytest.raises(InputError, match=r"images/Flight/00.png has another name") as caught:
        ColmapSource.open(folder)
    assert "case" in caught.value.hint


@pytest.mark.parametrize(
    ("size", "hint"), [((480, 640), "rotated"), ((320, 240), "resized"), ((500, 480), "that COLMAP read")]
)
def test_frames_of_another_size(plain, model_bin, tmp_path, size, hint):
    put_frames(plain, tmp_path / "images", size)
    with pytest.raises(InputError, match=hint):
        ColmapSource.open(model_bin)


@pytest.mark.parametrize(
    ("lens", "values"),
    [
        ("SIMPLE_RADIAL", [400, 320, 240, -0.25]),  # 56 to 67 degrees off the axis came back into the picture
        ("SIMPLE_RADIAL", [400, 320, 240, -0.05]),
        ("RADIAL", [400, 320, 240, -0.3, 0.03]),
        ("OPENCV", [400, 400, 320, 240, -0.3, 0.08, 0, 0]),
        ("PINHOLE", [400, 400, 320, 240]),
        ("OPENCV_FISHEYE", [200, 200, 320, 240, 0.01, 0, 0, 0]),
    ],
)
def test_a_picture_shows_no_direction_beside_another(lens, values):
    """What a lens maps into the picture is seen there: the pixel's ray is the point's."""
    camera = pycolmap.Camera(model=lens, width=640, height=480, params=values)
    away, around = np.meshgrid(np.linspace(0, 8, 200), np.linspace(0, 2 * np.pi, 24))
    plane = (away * [np.cos(around), np.sin(around)]).reshape(2, -1).T
    pixels = project(camera, 3.0 * np.column_stack([plane, np.ones(len(plane))]))
    inside = ((pixels >= 0) & (pixels <= (640, 480))).all(1)
    back, _, usable = undistort(camera, pixels[inside])
    assert inside.sum() > 300 and usable.mean() > 0.95
    assert np.allclose(back[usable], plane[inside][usable], atol=1e-3)
    assert np.isnan(project(camera, np.array([[0.0, 0.0, -1.0]]))).all()


@pytest.mark.parametrize(("k1", "said"), [(0.05, None), (-0.05, "smaller than the model's"), (0.2, "larger than")])
def test_frames_of_another_lens(plain, model_bin, tmp_path, k1, said):
    """Undistorted since, say: of the same size, but things are larger or smaller away from the middle."""
    for image in plain.images.values():
        draw_points(plain, image, tmp_path / "frames" / image.name, k1)
    notes = ColmapSource.open(model_bin, tmp_path / "frames").notes
    assert [note.severity for note in notes] == [CAUTION] * bool(said)
    assert not said or said in notes[0].text and "undistorted" in notes[0].text


def test_frames_of_another_flight(plain, tmp_path):
    """Of the same names and sizes: they do not show the points in their colours."""
    folder = save(plain, tmp_path / "m", "bin")
    images = sorted(plain.images.values(), key=lambda image: image.name)
    for image, other in zip(images, images[1:] + images[:1], strict=True):
        for place, name in (("own", image.name), ("another", other.name)):
            draw_points(plain, image, tmp_path / place / name)
    assert ColmapSource.open(folder, tmp_path / "own").notes == []
    (note,) = ColmapSource.open(folder, tmp_path / "another").notes
    assert note.severity == REFUSAL and "may be of another flight" in note.text and "--images" in note.hint
    (same,) = ColmapSource.open(folder, tmp_path / "another", need_images=False).notes  # as where boxes are given
    assert same == note
    assert ColmapSource.open(folder, tmp_path / "another", compare_frames=False).notes == []
    black = pycolmap.Reconstruction(plain)
    for point in black.points3D.values():
        point.color = np.zeros(3, np.uint8)
    assert ColmapSource.open(save(black, tmp_path / "black", "bin"), tmp_path / "another").notes == []


def test_frames_are_compared_where_boxes_are_given(plain, tmp_path):
    """They were not, so frames of another flight went unnoticed; without frames it goes on, as a copy is only found."""
    folder = save(plain, tmp_path / "m", "bin")
    request = EstimateRequest(detections=tmp_path / "boxes.json")
    assert [note.severity for note in source_of(folder, request).notes] == [INFO]
    images = sorted(plain.images.values(), key=lambda image: image.name)
    for image, other in zip(images, images[1:] + images[:1], strict=True):
        draw_points(plain, image, tmp_path / "images" / other.name)
    (note,) = source_of(folder, request).notes
    assert note.severity == REFUSAL and "may be of another flight" in note.text
    assert source_of(folder, request, to_measure=False).notes == []


def test_files_of_another_flight_among_the_frames(plain, tmp_path):
    """Two flights copied into one folder: a vehicle counted several times, at wrong places, without a word."""
    folder = save(plain, tmp_path / "m", "bin")
    images = sorted(plain.images.values(), key=lambda image: image.name)
    for image in images:
        draw_points(plain, image, tmp_path / "frames" / image.name)
    draw_points(plain, images[1], tmp_path / "frames" / images[4].name)
    draw_points(plain, images[2], tmp_path / "frames" / images[7].name)
    (note,) = ColmapSource.open(folder, tmp_path / "frames").notes
    assert note.severity == CAUTION and note.text.startswith("2 of 12 frames that were compared do not show")
    assert f"the first is {tmp_path / 'frames' / images[4].name}" in note.text


def test_points_without_a_colour_do_not_count(tmp_path):
    """COLMAP's mapper leaves points black that it makes after it has read the colours of their images."""
    model, _ = make_model()
    for image in model.images.values():
        draw_points(model, image, tmp_path / "frames" / image.name)
    for number in sorted(model.points3D)[::3]:
        model.points3D[number].color = np.zeros(3, np.uint8)
    assert ColmapSource.open(save(model, tmp_path / "m", "bin"), tmp_path / "frames").notes == []


def test_a_point_of_a_frame_is_read_to_a_pixel_and_lies_in_it(plain, model_bin, tmp_path):
    put_frames(plain, tmp_path / "frames")
    source = ColmapSource.open(model_bin, tmp_path / "frames")
    name = source.picture_names[0]
    a, b = (source.locate(f"{name}@{x},240") for x in (320, 321))
    step = np.linalg.norm(a.place - b.place)
    assert a.read_sd == pytest.approx(0.5 * step, rel=0.1)
    assert source.locate("1,2,3").read_sd == 0
    with pytest.raises(UsageError, match="no registered image is named nosuch.jpg"):
        source.locate("nosuch.jpg@10,10")
    for beyond in ("641,240", "-1,240", "320,480.5"):
        with pytest.raises(ValueError, match="outside of the picture, which is 640 x 480"):
            source.locate(f"{name}@{beyond}")


def test_pickled_as_its_path(plain, model_bin, tmp_path, monkeypatch):
    put_frames(plain, tmp_path / "frames")
    monkeypatch.chdir(tmp_path)
    source = ColmapSource.open("model", "frames")
    source.notes.append(Remark(CAUTION, "said"))
    source = replace(source, cloud=DenseCloud(tmp_path / "a.ply", progress=lambda *_: None))
    data = pickle.dumps(source)
    monkeypatch.chdir("/")
    again = pickle.loads(data)
    assert again.notes == source.notes and again.cloud == replace(source.cloud, progress=None)
    assert [picture.path for picture in again.pictures] == [tmp_path / picture.path for picture in source.pictures]
    assert again.picture_names == source.picture_names


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_parts_that_share_no_point(plain, tmp_path, form):
    two = pycolmap.Reconstruction(plain)
    assert [len(part) for part in open_model(save(two, tmp_path / "one", form)).parts] == [12]
    other = make_model()[0]
    other.transform(pycolmap.Sim3d(3.0, pycolmap.Rotation3d(), np.array([500.0, 300, 0])))
    for image in other.images.values():
        new = pycolmap.Image(name=f"b{image.name}", camera_id=1, image_id=100 + image.image_id)
        new.points2D = pycolmap.Point2DList([pycolmap.Point2D(seen.xy) for seen in image.points2D])
        two.add_image_with_trivial_frame(new, image.cam_from_world())
    for point in other.points3D.values():
        track = [pycolmap.TrackElement(100 + e.image_id, e.point2D_idx) for e in point.track.elements]
        two.add_point3D(point.xyz, pycolmap.Track(track), point.color)
    source = ColmapSource.open(save(two, tmp_path / "two", form), need_images=False)
    first, second = sorted(source.parts, key=lambda part: part.picture_names)
    assert {*first.picture_names, *second.picture_names} == set(source.picture_names)
    assert all(
        name.startswith("b") != other.startswith("b") for name in first.picture_names for other in second.picture_names
    )
    assert np.ptp(second.sparse[0], axis=0) in (
        pytest.approx(3 * np.ptp(first.sparse[0], axis=0)),
        pytest.approx(np.ptp(first.sparse[0], axis=0) / 3),
    )
    assert not list(first.parts) and not list(ColmapSource.open(tmp_path / "one", need_images=False).parts)
    parts = source.parts
    gone = weakref.ref(next(parts))
    assert next(parts) and gone() is None, "each is a copy of the model, and there may be many"
    notes = source.notes
    assert [note.severity for note in notes if "share no point (12 and 12 images)" in note.text] == [CAUTION]


def test_images_of_one_frame_of_a_rig_are_one_part(tmp_path):
    model, _ = make_model(rig=True)
    camera = {number: image.camera_id for number, image in model.images.items()}
    for number, point in list(model.points3D.items()):
        for image, index in [(seen.image_id, seen.point2D_idx) for seen in point.track.elements]:
            aside = image in (1, 2) or camera[image] != 1 + number % 2
            if aside and number in model.points3D:
                model.delete_observation(image, index)
    assert {len({camera[e.image_id] for e in p.track.elements}) for p in model.points3D.values()} == {1}
    (part,) = open_model(save(model, tmp_path, "bin")).parts
    assert len(part) == 22 and {name[:4] for name in part} == {"cam1", "cam2"}, "without the pair that sees no point"


# --- Pictures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_picture_file(tmp_path, suffix):
    pixels = np.zeros((40, 60, 3), np.uint8)
    pixels[:, :30], pixels[:20, 30:] = (200, 0, 0), (0, 0, 200)
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])
    picture = PictureFile("a", path, 60, 40)
    picture.check_size()
    assert stored_size(path) in ((60, 40), None if suffix == "tif" else (60, 40))
    whole = picture.read(0, 0, 60, 40, 60, 40)
    assert whole.dtype == np.uint8 and np.abs(whole[5, 5].astype(int) - (200, 0, 0)).max() < 12
    assert np.abs(picture.read(30, 0, 20, 20, 5, 5)[2, 3].astype(int) - (0, 0, 200)).max() < 12
    assert picture.read(30, 0, 20, 20, 50, 40).shape == (40, 50, 3)
    whole[:] = 0
    assert picture.read(0, 0, 60, 40, 60, 40).any()


def test_a_model_that_was_changed_since_it_was_opened_is_neither_hashed_nor_written(model_bin, tmp_path):
    """Its hash would be that of what nobody measured."""
    source = ColmapSource.open(model_bin, need_images=False)
    former = source.content_hash()
    os.utime(model_bin / "points3D.bin", (0, 0))
    (folder := tmp_path / "out").mkdir()
    with pytest.raises(InputError, match=r"points3D\.bin was changed since it was opened"):
        source.content_hash()
    with pytest.raises(InputError, match=r"points3D\.bin was changed since it was opened"):
        source.write(folder, 2.0)
    assert not list(folder.iterdir())
    assert ColmapSource.open(model_bin, need_images=False).content_hash() == former


def test_a_cloud_that_was_changed_since_the_model_was_opened_is_not_hashed(model_bin, tmp_path):
    (tmp_path / "fused.ply").write_bytes(b"ply")
    source = open_source(model_bin, need_images=False, ground_cloud=tmp_path / "fused.ply")
    source.content_hash()
    (tmp_path / "fused.ply").write_bytes(b"another")
    with pytest.raises(InputError, match=r"fused\.ply was changed since it was opened"):
        source.content_hash()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes here")
def test_a_pipe_among_depth_maps_is_not_waited_for(model_bin, tmp_path):
    """Nobody named them: the ground is found from the sparse points."""
    (maps := tmp_path / "stereo/depth_maps").mkdir(parents=True)
    os.mkfifo(maps / "a.png.geometric.bin")
    source = open_source(model_bin, need_images=False)
    assert source.cloud is None
    assert any("left out" in note.text and "pipe" in note.text for note in source.notes)


def test_a_picture_that_was_replaced_shows_its_new_pixels(tmp_path, monkeypatch):
    """Also under a name that meant another file before."""
    (tmp_path / "other").mkdir()
    for folder, grey in ((".", 10), (".", 200), ("other", 77)):
        monkeypatch.chdir(tmp_path / folder)
        cv2.imwrite("a.png", np.full((40, 60, 3), grey, np.uint8))
        assert (PictureFile("a", Path("a.png"), 60, 40).read(0, 0, 60, 40, 60, 40) == grey).all()


def test_a_picture_is_not_changed_while_work_on_it_is_cached(tmp_path):
    """Neither here nor on another machine, where its boxes would be kept under the former content."""
    path = tmp_path / "a.bmp"
    cv2.imwrite(str(path), np.zeros((40, 60, 3), np.uint8))
    picture = PictureFile("a", path, 60, 40)
    former = picture.fingerprint()
    other = pickle.loads(pickle.dumps(picture))
    os.utime(path, (0, 0))
    for each in (picture, other):
        with pytest.raises(InputError, match=r"a\.bmp was changed since"):
            each.read(0, 0, 60, 40, 60, 40)
    with pytest.raises(InputError, match=r"a\.bmp was changed since"):
        picture.fingerprint()
    assert PictureFile("a", path, 60, 40).fingerprint() == former


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_truncated_pictures(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8))
    data = path.read_bytes()
    for k, part in enumerate((0, 0.001, 0.1, 0.5, 0.99)):
        damaged = tmp_path / f"{k}.{suffix}"
        damaged.write_bytes(data[: int(part * len(data))])
        with pytest.raises(InputError, match=f"{k}.{suffix}: image is truncated"):
            PictureFile("a", damaged, 80, 60).read(0, 0, 80, 60, 80, 60)
    with pytest.raises(InputError, match="cannot be read"):
        PictureFile("a", tmp_path / "none.jpg", 80, 60).read(0, 0, 80, 60, 80, 60)


def test_exif_orientation_is_ignored(tmp_path):
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), np.zeros((40, 60, 3), np.uint8))
    data = path.read_bytes()
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    exif = b"Exif\0\0" + tiff
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:])
    assert cv2.imread(str(path)).shape == (60, 40, 3)
    assert PictureFile("a", path, 60, 40).read(0, 0, 60, 40, 60, 40).shape == (40, 60, 3)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("turned", range(1, 9))
@pytest.mark.parametrize("form", [{}, {"tiled": True}, {"bigtiff": "YES"}, {"endianness": "BIG"}])
def test_the_orientation_of_a_tiff_is_ignored(tmp_path, form, turned):
    """COLMAP reads its pixels as they are stored. OpenCV turns them whatever it is told, tiled ones wrongly."""
    path, pixels = tmp_path / "a.tif", np.random.default_rng(0).integers(0, 255, (3, 300, 400), dtype=np.uint8)
    with rasterio.open(path, "w", driver="GTiff", width=400, height=300, count=3, dtype="uint8", **form) as file:
        file.write(pixels)
    turn_tiff(path, turned)
    assert stored_size(path) == (400, 300)
    assert np.array_equal(PictureFile("a", path, 400, 300).read(0, 0, 400, 300, 400, 300), pixels.transpose(1, 2, 0))
    assert (read_tags(path).width, read_tags(path).height) == (400, 300)


def turn_tiff(path: Path, turned: int) -> None:
    """Set the orientation of a TIFF, by a directory at its end that has it, too."""
    data = bytearray(path.read_bytes())
    order, big = "<" if data[:2] == b"II" else ">", 43 in data[2:4]
    place, count, entry = (order + "Q", order + "Q", 20) if big else (order + "I", order + "H", 12)
    (start,) = struct.unpack_from(place, data, 8 if big else 4)
    (number,) = struct.unpack_from(count, data, start)
    first = start + struct.calcsize(count)
    entries = {
        struct.unpack_from(order + "H", data, at)[0]: bytes(data[at : at + entry])
        for at in range(first, first + number * entry, entry)
    }
    one = struct.pack(order + "Q", 1) if big else struct.pack(order + "I", 1)
    entries[0x0112] = (struct.pack(order + "HH", 0x0112, 3) + one + struct.pack(order + "H", turned)).ljust(
        entry, b"\0"
    )
    struct.pack_into(place, data, 8 if big else 4, len(data))
    data += struct.pack(count, len(entries)) + b"".join(entries[tag] for tag in sorted(entries)) + struct.pack(place, 0)
    path.write_bytes(data)


# --- Damage ----------------------------------------------------------------------------------------------------------


def refused(folder: Path) -> InputError:
    """The InputError that opening `folder` raises."""
    with pytest.raises(InputError) as caught:
        ColmapSource.open(folder, need_images=False)
    assert str(folder) in caught.value.message and caught.value.hint
    return caught.value


BINARY = ("cameras", "images", "points3D", "rigs", "frames")


def cuts(size: int) -> list[int]:
    """Twenty lengths that a file of `size` bytes may be cut to."""
    return sorted({int(k * (size - 1) / 19) for k in range(20)})


@pytest.mark.slow
def test_damaged_models_cost_little_memory_and_time(plain, tmp_path):
    """150 models, in a process of their own: cut, with forged counts, with random bytes, with files swapped."""
    random = np.random.default_rng(0)
    whole = save(plain, tmp_path / "whole", "bin")
    folders = []
    for table in BINARY:
        data = (whole / f"{table}.bin").read_bytes()
        damaged = [data[:size] for size in cuts(len(data))]
        damaged += [struct.pack("<Q", count) + data[8:] for count in (0, 2**32, 2**40, 2**63, 2**64 - 1)]
        damaged += [random.bytes(len(data)), b"", struct.pack("<Q", 10**9) * 1000]
        damaged += [(whole / f"{other}.bin").read_bytes() for other in BINARY if other != table]
        for content in damaged:
            folder = tmp_path / str(len(folders))
            folder.mkdir()
            for other in BINARY:
                (folder / f"{other}.bin").symlink_to(whole / f"{other}.bin")
            (folder / f"{table}.bin").unlink()
            (folder / f"{table}.bin").write_bytes(content)
            folders.append(str(folder))
    assert len(folders) >= 150
    done = subprocess.run([sys.executable, "-c", OPEN_ALL, *folders], capture_output=True, text=True, check=True)
    refused, slowest, peak = json.loads(done.stdout)
    assert refused == len(folders)
    assert slowest < 10, "seconds of the processor: the machine may be shared"
    assert peak < 2**30


OPEN_ALL = """
import json, sys, time
from pathlib import Path
from orthoscale.errors import InputError
from orthoscale.requests import EstimateRequest
from orthoscale.sources.colmap import ColmapSource
refused, slowest = 0, 0.0
for folder in sys.argv[1:]:
    start = time.process_time()
    try:
        ColmapSource.open(folder, need_images=False)
    except InputError as error:
        refused += folder in error.message and bool(error.hint)
    slowest = max(slowest, time.process_time() - start)
# Not the peak that getrusage tells: Linux counts there what the parent had when it started this process.
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(json.dumps([refused, slowest, 1024 * int(status["VmHWM"].split()[0])]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("form", ["bin", "txt"])
@pytest.mark.parametrize("table", BINARY)
def test_truncated_and_foreign_files(made, form, table, tmp_path):
    folder = save(made[0], tmp_path / "m", form)
    path = folder / f"{table}.{form}"
    whole = path.read_bytes()
    if form == "bin":
        for size in sorted({*cuts(len(whole)), 0, 1, 7, 8, 9, 12, 20}):
            if size < len(whole):
                path.write_bytes(whole[:size])
                assert path.name in refused(folder).message
        path.write_bytes(whole + b"\0")
        assert "more than" in refused(folder).message
        for count in (2**63, 2**64 - 1, 2**32, struct.unpack_from("<Q", whole)[0] + 1):
            path.write_bytes(struct.pack("<Q", count) + whole[8:])
            refused(folder)
        path.write_bytes(np.random.default_rng(0).bytes(len(whole)))
        refused(folder)
    else:
        for size in cuts(len(whole)):
            path.write_bytes(whole[:size])
            refused(folder)
        for damage in (b"", b"\xff\xfe\x00", b"1 2 3\n", b"a b c d e f g h i j k\n", b"\0" * 100):
            path.write_bytes(damage)
            refused(folder)
    for other in BINARY:
        if other != table:
            path.write_bytes((folder / f"{other}.{form}").read_bytes())
            refused(folder)


# In a plain model: one camera record at 8; the first image's record, point and frame also start at 8.
FORGED = {
    "camera model": ("cameras.bin", 12, "i", 99, "unknown model 99"),
    "spherical camera": ("cameras.bin", 12, "i", 17, "spherical"),
    "camera width": ("cameras.bin", 16, "Q", 0, "impossible size"),
    "camera height": ("cameras.bin", 24, "Q", 2**40, "impossible size"),
    "focal length NaN": ("cameras.bin", 32, "d", np.nan, "not a finite number"),
    "focal length 0": ("cameras.bin", 32, "d", 0.0, "impossible focal length"),
    "focal length negative": ("cameras.bin", 40, "d", -400.0, "impossible focal length"),
    "distortion infinite": ("cameras.bin", 64, "d", np.inf, "not a finite number"),
    "camera id": ("cameras.bin", 8, "I", 7, "camera 1, which does not exist"),
    "rotation NaN": ("images.bin", 12, "d", np.nan, "not a finite number"),
    "rotation zero": ("images.bin", 12, "4d", (0, 0, 0, 0), "not a unit quaternion"),
    "translation infinite": ("images.bin", 44, "d", np.inf, "not a finite number"),
    "image's camera": ("images.bin", 68, "I", 5, "camera 5, which does not exist"),
    "image name": ("images.bin", 72, "6B", (0xFF,) * 6, "not UTF-8"),
    "observation count": ("images.bin", 79, "Q", 2**60, "announced"),
    "observation NaN": ("images.bin", 87, "d", np.nan, "not a finite number"),
    "observed point": ("images.bin", 103, "Q", 10**9, "which is not in points3D.bin"),
    "point id": ("points3D.bin", 8, "Q", 10**9, "not in points3D.bin"),
    "point NaN": ("points3D.bin", 16, "d", np.nan, "not a finite number"),
    "point infinite": ("points3D.bin", 32, "d", -np.inf, "not a finite number"),
    "point's error NaN": ("points3D.bin", 43, "d", np.nan, "not a finite number"),
    "track length": ("points3D.bin", 51, "Q", 2**62, "file ends"),
    "track image": ("points3D.bin", 59, "I", 999, "image 999, which does not exist"),
    "track observation": ("points3D.bin", 63, "I", 10**6, "observation 1000000 of image"),
    "rig sensors": ("rigs.bin", 12, "I", 2**31, "file ends"),
    "rig sensor type": ("rigs.bin", 16, "i", 9, "unknown type 9"),
    "rig camera": ("rigs.bin", 20, "I", 9, "camera 9, which does not exist"),
    "frame's rig": ("frames.bin", 12, "I", 9, "rig 9, which does not exist"),
    "frame NaN": ("frames.bin", 16, "d", np.nan, "not a finite number"),
    "frame's data": ("frames.bin", 72, "I", 2**31, "file ends"),
    "frame's sensor": ("frames.bin", 80, "I", 9, "sensor 9"),
    "frame's image": ("frames.bin", 84, "Q", 999, "image 999, which does not exist"),
}


@pytest.mark.parametrize("what", FORGED)
def test_forged_values(model_bin, what):
    name, offset, form, value, said = FORGED[what]
    patched(model_bin, name, offset, form, *(value if isinstance(value, tuple) else (value,)))
    error = refused(model_bin)
    assert said in error.message
    if name == "images.bin" and "name" not in what:
        assert "00.png" in error.message or "image 1" in error.message


def test_a_lone_spherical_camera_is_no_damage(model_bin):
    """Its record is the shortest, with two parameters: the file was called damaged."""
    (model_bin / "cameras.bin").write_bytes(struct.pack("<QIiQQ2d", 1, 1, 17, 640, 320, 640, 320))
    assert "spherical (EQUIRECTANGULAR)" in refused(model_bin).message


@pytest.mark.parametrize("form", ["bin", "txt"])
@pytest.mark.parametrize("stored", [1.3e154, -1.0])
def test_the_error_of_a_point_may_be_any_number(plain, tmp_path, form, stored):
    """COLMAP gives a point behind a camera the root of the largest double, or a share of it; -1 is unknown."""
    model = pycolmap.Reconstruction(plain)
    for number in sorted(model.points3D)[::5]:
        model.points3D[number].error = stored
    source = ColmapSource.open(save(model, tmp_path / "model", form), need_images=False)
    other = ColmapSource.open(save(plain, tmp_path / "plain", form), need_images=False)
    assert source.camera_height == other.camera_height
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.0)
    written = pycolmap.Reconstruction(str(tmp_path / "out")).points3D
    assert written[min(written)].error == stored


def test_empty_tables(model_bin):
    for table in BINARY:
        path = model_bin / f"{table}.bin"
        whole = path.read_bytes()
        path.write_bytes(struct.pack("<Q", 0))
        refused(model_bin)
        path.write_bytes(whole)
    assert ColmapSource.open(model_bin, need_images=False).picture_names


FORGED_TEXT = {
    "camera model": ("cameras.txt", r"OPENCV", "NOKIA", "unknown model NOKIA"),
    "parameters": ("cameras.txt", r" 410 ", " ", "has 8 parameters"),
    "focal length": ("cameras.txt", r" 400 ", " -400 ", "impossible focal length"),
    "not a number": ("cameras.txt", r" 480 ", " tall ", "malformed"),
    "name with a space": ("images.txt", r"00.png", "00 a.png", "has a space"),
    "name twice": ("images.txt", r"00.png", "01.png", "appears twice"),
    "observations": ("images.txt", r" -1", "", "not triples"),
    "point id": ("images.txt", r" -1", " -7", "out of range"),
    "track": ("points3D.txt", r" 11 0 ", " 11 0 0 ", "is not pairs"),
    "frame sensor": ("frames.txt", r"CAMERA 1 1", "LIDAR 1 1", "unknown sensor type 'LIDAR'"),
    "frame count": ("frames.txt", r"1 CAMERA 1 1", "7 CAMERA 1 1", "announces 7 data"),
    "rig count": ("rigs.txt", r"1 1 CAMERA", "1 3 CAMERA", "announces 3 sensors"),
}


@pytest.mark.parametrize("what", FORGED_TEXT)
def test_forged_text(model_txt, what):
    name, old, new, said = FORGED_TEXT[what]
    path = model_txt / name
    lines = path.read_text().split("\n")
    first = next(k for k, line in enumerate(lines) if not line.startswith("#") and old in line)
    lines[first] = lines[first].replace(old, new, 1)
    path.write_text("\n".join(lines))
    error = refused(model_txt)
    assert said in error.message and f"{name}, line " in error.message


@pytest.mark.slow
def test_random_damage_never_escapes(plain, tmp_path):
    """Bytes flipped anywhere: either the model is refused, or it still is one that pycolmap reads."""
    random = np.random.default_rng(0)
    for form in ("bin", "txt"):
        folder = save(plain, tmp_path / form, form)
        for table in BINARY:
            path = folder / f"{table}.{form}"
            whole = path.read_bytes()
            for _ in range(8):
                data = bytearray(whole)
                for at in random.integers(0, len(data), 3):
                    data[at] = random.integers(0, 256)
                path.write_bytes(data)
                with contextlib.suppress(OrthoscaleError):
                    assert ColmapSource.open(folder, need_images=False).camera_height > 0
            path.write_bytes(whole)


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_pointers_of_git_lfs(plain, tmp_path, form):
    folder = save(plain, tmp_path / "m", form)
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:12\nsize 12\n"
    (folder / f"images.{form}").write_bytes(pointer)
    assert f"images.{form}: only a pointer of Git LFS" in refused(folder).message
    (tmp_path / "a.jpg").write_bytes(pointer)
    with pytest.raises(InputError, match="Git LFS"):
        PictureFile("a", tmp_path / "a.jpg", 8, 8).read(0, 0, 8, 8, 8, 8)
    with pytest.raises(InputError, match="Git LFS"):
        open_source(tmp_path / "a.jpg")


def test_one_file_of_a_model_is_not_called_an_image(model_bin):
    with pytest.raises(InputError, match="one file of a COLMAP model") as caught:
        open_source(model_bin / "points3D.bin")
    assert str(model_bin) in caught.value.hint


def test_byte_order_mark(model_txt):
    path = model_txt / "images.txt"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert "line 1: begins with a byte order mark" in refused(model_txt).message


def test_poses_that_disagree(model_bin):
    patched(model_bin, "images.bin", 44, "d", 3.5)
    assert "another pose than its frame" in refused(model_bin).message


def test_rig_with_an_unknown_pose(tmp_path):
    folder = save(make_model(rig=True)[0], tmp_path / "m", "txt")
    (folder / "rigs.txt").write_text("1 2 CAMERA 1 CAMERA 2 0\n")
    assert "camera 2 of rig 1 has images, but no pose" in refused(folder).message


def test_camera_models_are_those_of_pycolmap():
    for number, (name, params, focals) in CAMERA_MODELS.items():
        camera = pycolmap.Camera.create_from_model_id(1, getattr(pycolmap.CameraModelId, name), 500.0, 1000, 800)
        assert getattr(pycolmap.CameraModelId, name).value == number
        assert len(camera.params) == params
        assert list(camera.focal_length_idxs()) == list(range(focals))


# --- Real flights ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["sheffield", "brighton"])
def test_real_reconstruction(scene, tmp_path):
    folder = DATA / scene
    if not folder.is_dir():
        pytest.skip(f"no real data: {folder} is absent (set ORTHOSCALE_DATA)")
    source = ColmapSource.open(folder)
    assert len(source.pictures) == len(source.picture_names)
    assert all("focal length" in note for note in map(str, source.notes))
    metres = json.loads((folder / "truth.json").read_text())["metres_per_model_unit"]
    # Both places are flat, and all flights are level: the ground must not wander, nor the cameras' heights.
    centres = np.array([image.projection_center() for image in source._images.values()])
    heights = source.ground.height_above(centres) * metres
    assert heights.std() < 0.03 * heights.mean()
    assert source.ground.noise < 0.005 * source.camera_height
    name = source.picture_names[len(source.picture_names) // 2]
    picture = next(p for p in source.pictures if p.name == name)
    pixels = np.random.default_rng(0).uniform((0.1, 0.3), (0.9, 0.9), (200, 2)) * (picture.width, picture.height)
    views, world, ok = source.views(name, pixels)
    assert ok.mean() > 0.5
    assert np.abs([source._images[name].project_point(w) for w in world[ok]] - pixels[ok]).max() < 1e-6
    digest = hashlib.sha256((source.folder / "images.bin").read_bytes()).hexdigest()
    source.write(tmp_path, metres)
    assert digest == hashlib.sha256((source.folder / "images.bin").read_bytes()).hexdigest()
    shutil.rmtree(tmp_path)
