"""The ground under dense clouds, where its height is known; clouds of other models, and damaged ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.blocks import Conditions, fly
from support.models import make_model

from orthoscale.errors import InputError
from orthoscale.fleets import load_fleet
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.dense_cloud import DenseCloud, check_workspace, cloud_at, find_cloud

HEADER = "ply\nformat binary_little_endian 1.0\nelement vertex {}\n" + "".join(
    f"property float {axis}\n" for axis in "xyz"
)


def write_cloud(path, points):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes((HEADER.format(len(points)) + "end_header\n").encode() + points.astype("<f4").tobytes())
    return path


@pytest.fixture(scope="module")
def flight():
    """A flight over flat ground with few points, and a dense cloud of it: vehicle roofs, crowns, noise, holes, strays
    below; all on the true plane, which the block's own vehicles stand on."""
    rng = np.random.default_rng(4)
    conditions = Conditions("nadir", points=900, crowns=0.3, vehicles=30)
    source = fly(rng, load_fleet("DE"), conditions, unsure=False).source
    sheet = source.ground
    sparse = sheet.plane(source.sparse[0])
    height = sheet.camera_height
    xy = rng.uniform(*np.percentile(sparse, [1, 99], axis=0), (400_000, 2))
    place = xy / height
    over = rng.normal(0, 0.0008, len(xy))
    car = (place[:, 0] % 0.043 < 0.026) & (place[:, 1] % 0.1 < 0.06) & (place[:, 1] > 0)  # rows of 1.8 x 4.2 m
    over[car] += 0.02
    crown = np.hypot(place[:, 0] % 0.3 - 0.15, place[:, 1] % 0.3 - 0.15) < 0.04
    over[crown] += rng.uniform(0.05, 0.15, crown.sum())
    stray = rng.random(len(xy)) < 0.01
    over[stray] -= rng.uniform(0, 0.2, stray.sum())
    truth = sheet.lift(xy)
    hole = np.hypot(*(place - place.mean(0)).T) < 0.15
    return source, (truth + height * over[:, None] * sheet.up)[~hole], truth[::400]


def on(source, path, named=True):
    return replace(source, notes=[], cloud=DenseCloud(path, named))


def test_roofs_crowns_strays_and_holes_do_not_move_the_ground(flight, tmp_path):
    source, cloud, truth = flight
    dense = on(source, write_cloud(tmp_path / "a.ply", cloud))
    error = dense.ground.height_above(truth) / dense.camera_height
    assert abs(np.median(error)) < 0.001 and np.percentile(np.abs(error), 95) < 0.004
    assert np.sqrt(np.mean((error * dense.camera_height / dense.ground.sd(truth)) ** 2)) < 1.5
    assert "dense cloud" in str(dense.notes[0]) and dense.cloud.path in dense.files


def test_another_cloud_is_another_input(flight, tmp_path):
    source, cloud, _ = flight
    path = write_cloud(tmp_path / "a.ply", cloud[:1000])
    first = on(source, path).content_hash()
    assert first == on(source, path).content_hash() != source.content_hash()
    write_cloud(path, cloud[:999])
    assert on(source, path).content_hash() != first
    path.unlink()
    with pytest.raises(InputError, match=r"a\.ply cannot be read"):
        on(source, path).content_hash()


@pytest.mark.parametrize("what", ["higher", "larger", "elsewhere", "cut", "not finite"])
def test_a_cloud_that_is_not_of_the_model_is_left_out_or_refused(flight, tmp_path, what):
    source, cloud, truth = flight
    up = source.ground.up * source.ground.camera_height
    wrong = {
        "higher": cloud + 0.04 * up,
        "larger": 2 * cloud,
        "elsewhere": cloud + 100 * np.linalg.norm(up),
        "not finite": np.where(np.arange(len(cloud))[:, None] == 7, np.nan, cloud),
    }
    path = write_cloud(tmp_path / "a.ply", wrong.get(what, cloud))
    if what == "cut":
        path.write_bytes(path.read_bytes()[:-99])
    with pytest.raises(InputError, match=r"a\.ply"):
        on(source, path).ground  # noqa: B018
    found = on(source, path, named=False)
    assert (found.ground.height_above(truth) == source.ground.height_above(truth)).all()
    assert "left out" in str(found.notes[0])


@pytest.mark.parametrize(
    "model, cloud",
    [
        ("sparse/0", "dense/0/fused.ply"),
        ("sparse/0", "fused.ply"),
        ("dense/sparse", "dense/fused.ply"),
        ("opensfm", "odm_filterpoints/point_cloud.ply"),
        ("data", "data/undistorted/depthmaps/merged.ply"),
    ],
)
def test_where_clouds_lie(tmp_path, model, cloud):
    (tmp_path / model).mkdir(parents=True)
    assert find_cloud(tmp_path / model) == (None, [])
    path = write_cloud(tmp_path / cloud, np.zeros((3, 3)))
    found, _ = find_cloud(tmp_path / model)
    assert found is not None and found.path == path.resolve() and not found.named


def test_a_cloud_lies_beside_a_link_to_the_model(tmp_path):
    (tmp_path / "elsewhere/0").mkdir(parents=True)
    path = write_cloud(tmp_path / "work/dense/0/fused.ply", np.zeros((3, 3)))
    (tmp_path / "work/sparse").symlink_to(tmp_path / "elsewhere")
    found, _ = find_cloud(tmp_path / "work/sparse/0")
    assert found is not None and found.path == path


def test_a_cloud_on_the_map_is_said_to_be_left_out(tmp_path):
    (tmp_path / "opensfm").mkdir()
    (tmp_path / "odm_georeferencing").mkdir()
    (tmp_path / "odm_georeferencing/odm_georeferenced_model.laz").write_bytes(b"LASF")
    cloud, remarks = find_cloud(tmp_path / "opensfm")
    assert cloud is None and "map" in str(remarks[0])


def test_what_cannot_be_a_cloud_is_refused(tmp_path):
    (tmp_path / "a.las").write_bytes(b"LASF")
    for name, why in (
        (".", "not a dense workspace of COLMAP"),
        ("a.las", "not a PLY file"),
        ("none.ply", "does not exist"),
    ):
        with pytest.raises(InputError, match=why):
            cloud_at(tmp_path / name)


def test_depth_maps_are_points_on_the_ground(flight, tmp_path):
    """As many as their pixels that have a depth, at half the size of their images."""
    source, *_ = flight
    (tmp_path / "dense/stereo/depth_maps").mkdir(parents=True)
    (tmp_path / "dense/sparse").mkdir()
    source._model.write(tmp_path / "dense/sparse")
    for name in source.picture_names:
        column, row = np.meshgrid(2 * np.arange(60) + 1, 2 * np.arange(45) + 1)
        pixels = 10.0 * np.column_stack([column.ravel(), row.ravel()])
        views, _, ok = source.views(name, pixels)
        depth = np.where(ok, views.ground[:, 2], 0).astype("<f4")
        path = tmp_path / f"dense/stereo/depth_maps/{name}.geometric.bin"
        path.write_bytes(b"60&45&1&" + depth.tobytes())
    cloud = cloud_at(tmp_path / "dense")
    points = np.concatenate(list(cloud.blocks()))
    assert len(points) > 1000
    assert np.abs(source.ground.height_above(points)).max() < 1e-4 * source.camera_height
    assert path in cloud.files and {file.name for file in cloud.files} >= {"cameras.bin", "images.bin"}
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InputError, match="depth map of 60 x 45"):
        list(cloud.blocks())


@pytest.mark.parametrize("form", ["geometric", "photometric"])
def test_depth_maps_of_another_run_are_refused(tmp_path, form):
    """Its unit differs; they were multiplied by the model's scale, and said to be in metres."""
    model, _ = make_model()
    (tmp_path / "dense/sparse").mkdir(parents=True)
    (maps := tmp_path / "dense/stereo/depth_maps").mkdir(parents=True)
    check_workspace(tmp_path / "dense")  # there are none
    model.write(tmp_path / "dense/sparse")

    def write(factor: float, start: str = "") -> None:
        for image in model.images.values():
            depth = np.zeros((240, 320), "<f4")
            for seen in image.points2D:
                if seen.has_point3D():
                    place = image.cam_from_world() * model.points3D[seen.point3D_id].xyz
                    column, row = model.cameras[image.camera_id].img_from_cam(place) / 2
                    if 0 <= column < 320 and 0 <= row < 240:
                        depth[int(row), int(column)] = factor * place[2]
            (maps / f"{start}{image.name}.{form}.bin").write_bytes(b"320&240&1&" + depth.tobytes())

    write(1.04)
    check_workspace(tmp_path / "dense")
    write(1.0, "former_")  # images that the model has no more
    check_workspace(tmp_path / "dense")
    write(1.2)
    with pytest.raises(InputError, match=r"show its points at 1.2 times the distance"):
        check_workspace(tmp_path / "dense")
    for image in model.images.values():
        (maps / f"{image.name}.{form}.bin").unlink()
    with pytest.raises(InputError, match=r"former_00.png.* no image of .*sparse has this name"):
        check_workspace(tmp_path / "dense")


def test_a_cloud_of_another_run_is_copied_with_a_caution(tmp_path):
    model, _ = make_model()
    folder = tmp_path / "model"
    for place in (folder / "sparse", folder / "dense/sparse", tmp_path / "out", tmp_path / "again"):
        place.mkdir(parents=True)
    model.write(folder / "sparse")
    model.write(folder / "dense/sparse")
    points = np.array([point.xyz for point in model.points3D.values()])
    told = []
    for factor, out in ((1.0, "out"), (3.0, "again")):
        cloud = DenseCloud(write_cloud(folder / "dense/fused.ply", factor * points))
        source = ColmapSource.open(folder, need_images=False).on_cloud(cloud)
        assert source.camera_height > 0
        source.write_dense(tmp_path / out, 2.0)
        told.append(any("may be of another model" in note.text for note in source.notes))
        assert any("is left out" in note.text for note in source.notes), "too thin for the ground"
    assert told == [False, True]
