"""The altitude by a depth map: exact depth of drawn scenes in every form and unit; and what is no metric depth."""

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from support import in_process
from support.networks import depth_network
from support.photos import CARS

from orthoscale.core.boxes import Boxes
from orthoscale.errors import InputError, UsageError
from orthoscale.formats.detections.own import load_detections
from orthoscale.photos.depth.ground import DepthMap, depth_altitude
from orthoscale.photos.depth.maps import Depths
from orthoscale.photos.depth.rules import RULES, rule_of
from orthoscale.photos.measure import Interval90
from orthoscale.photos.photo import open_photo
from orthoscale.synthetic import NormalFleet, make_scene
from orthoscale.synthetic.folders import VISLOC_FOCAL, write_csv

PITCHES = (-90, -70, -55)
ALTITUDES = (70.0, 75.0, 80.0)  # of `write_csv`
GROUND = 0.002  # relative: what kerbs and bushes around a vehicle may do to a median


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """``photos.csv``, ``photos/``, ``depth/photos/`` and ``detections.json`` of a drawn car park; and its fleet."""
    base = tmp_path_factory.mktemp("depth")
    scene = make_scene(3, NormalFleet((4.5, 1.8, 1.5), (0.05, 0.02, 0.05)), 110.0, 90, "carpark")
    write_csv(scene, base, PITCHES, pictures=False)
    (base / "fleet.json").write_text(json.dumps(CARS))
    return base


def photo_of(folder, k, **more):
    name = f"photos/{k:03d}.jpg"
    return open_photo(folder / name, name, focal_px=VISLOC_FOCAL, pitch=float(PITCHES[k]), **more)


def boxes_of(folder, k):
    return load_detections(folder / "detections.json").boxes[f"photos/{k:03d}.jpg"]


def exact(folder, k):
    return np.load(folder / "depth" / "photos" / f"{k:03d}.npy")


def as_range(folder, k):
    """The same along the rays."""
    depth = exact(folder, k)
    y, x = np.indices(depth.shape) + 0.5
    height, width = depth.shape
    return depth * np.sqrt(1 + ((x - width / 2) ** 2 + (y - height / 2) ** 2) / VISLOC_FOCAL**2)


def altitude(folder, k, depth, kind="z"):
    return depth_altitude(photo_of(folder, k), DepthMap(depth, kind, "the map"), boxes_of(folder, k))


@pytest.mark.parametrize("k", range(3))
def test_exact_depth_gives_the_true_altitude(folder, k):
    got = altitude(folder, k, exact(folder, k))
    assert got.altitude == pytest.approx(ALTITUDES[k], rel=GROUND) and got.scatter < 0.01 and got.vehicles > 10
    along = altitude(folder, k, as_range(folder, k), "range")
    assert along.altitude == pytest.approx(ALTITUDES[k], rel=GROUND)


@pytest.mark.parametrize("k", range(3))
def test_the_vehicles_themselves_are_not_the_ground(folder, k):
    """Their roofs are 1.5 m up: with all that boxes cover lifted by 5 m the ground around is as deep as it was."""
    depth, boxes = exact(folder, k), boxes_of(folder, k)
    mask = np.zeros(depth.shape, np.uint8)
    import cv2

    for corners in boxes.corners:
        cv2.fillConvexPoly(mask, corners.round().astype(np.int32), 1)
    got = altitude(folder, k, np.where(mask, depth * 0.93, depth))
    assert got.altitude == pytest.approx(ALTITUDES[k], rel=GROUND)


def test_range_taken_for_z_is_off_where_vehicles_stand_aside(folder):
    assert altitude(folder, 0, as_range(folder, 0)).altitude > 1.01 * ALTITUDES[0]


@pytest.mark.parametrize("shrink", [2, 5])
def test_any_resolution_will_do(folder, shrink):
    got = altitude(folder, 1, exact(folder, 1)[shrink // 2 :: shrink, shrink // 2 :: shrink])
    assert got.altitude == pytest.approx(ALTITUDES[1], rel=0.01)


def test_altitude_is_over_the_ground_around_the_vehicles_and_not_elsewhere(folder):
    """A pit without vehicles in half of the picture changes nothing; their own ground lowered by 3 m does."""
    photo, boxes = photo_of(folder, 0), boxes_of(folder, 0)
    half = photo.tags.width / 2
    left = boxes[boxes.centre[:, 0] < half - 60]
    depth = exact(folder, 0)
    columns = np.arange(depth.shape[1])[None]
    pit = np.where(columns > half, depth + 3, depth)
    got = depth_altitude(photo, DepthMap(pit, "z", ""), left)
    assert got.altitude == pytest.approx(ALTITUDES[0], rel=GROUND)
    lower = np.where(columns < half, depth + 3, depth)
    assert depth_altitude(photo, DepthMap(lower, "z", ""), left).altitude == pytest.approx(ALTITUDES[0] + 3, rel=GROUND)


# What is no metric depth


@pytest.mark.parametrize("k", range(3))
def test_an_inverse_depth_is_refused(folder, k):
    with pytest.raises(InputError, match="an inverse depth"):
        altitude(folder, k, 300 * ALTITUDES[k] / exact(folder, k))


@pytest.mark.parametrize("k", range(3))
def test_a_normalised_depth_is_refused(folder, k):
    depth = exact(folder, k)
    scaled = (depth - np.nanmin(depth)) / np.nanmax(depth - np.nanmin(depth))
    scaled[scaled == 0] = np.nan
    with pytest.raises(InputError, match="a relative depth"):
        altitude(folder, k, scaled)


@pytest.mark.parametrize("shift", [-0.65, 3.0])
def test_a_depth_with_a_shift_is_refused_where_the_ground_shows_it(folder, shift):
    depth = exact(folder, 2)
    with pytest.raises(InputError, match="a relative depth, or a wrong pitch"):
        altitude(folder, 2, depth + shift * np.nanmin(depth))


def test_another_unit_is_refused_by_what_the_vehicles_say(folder):
    photo, boxes = photo_of(folder, 0), boxes_of(folder, 0)
    by_vehicles = Interval90(70.0, 65.0, 75.0)
    in_feet = DepthMap(exact(folder, 0) / 0.3048, "z", "the map")
    assert depth_altitude(photo, in_feet, boxes, by_vehicles).altitude == pytest.approx(229.7, rel=GROUND)
    in_mm = replace(in_feet, metres=exact(folder, 0) * 1000)
    with pytest.raises(InputError, match="another unit"):
        depth_altitude(photo, in_mm, boxes, by_vehicles)


def test_a_map_of_another_field_or_without_ground_is_refused(folder):
    depth = exact(folder, 0)
    with pytest.raises(InputError, match="do not cover the field"):
        altitude(folder, 0, depth.T)
    with pytest.raises(InputError, match="no depth of the ground"):
        altitude(folder, 0, np.full_like(depth, np.nan))
    with pytest.raises(InputError, match="no vehicle"):
        depth_altitude(photo_of(folder, 0), DepthMap(depth, "z", ""), Boxes.empty())


# Files and units


def save(path, depth):
    if path.suffix == ".npy":
        np.save(path, depth[None])
    elif path.suffix == ".png":
        Image.fromarray((np.nan_to_num(depth) * 100).round().astype(np.uint16)).save(path)
    else:
        import rasterio

        height, width = depth.shape
        with rasterio.open(path, "w", "GTiff", width, height, 1, dtype="float32", nodata=-1) as out:
            out.write(np.where(np.isfinite(depth), depth, -1).astype(np.float32), 1)


@pytest.mark.parametrize("name, factor", [("d.npy", None), ("d.tif", None), ("d.png", "0.01")])
def test_every_form_of_file_says_the_same(folder, tmp_path, name, factor):
    depth = exact(folder, 1)
    depth[:40] = np.nan
    save(tmp_path / name, depth)
    read = Depths(tmp_path / name, "z", factor).of(photo_of(folder, 1)).metres
    assert np.array_equal(np.isnan(read), np.isnan(depth))
    assert np.nanmax(np.abs(read - depth)) < 0.006


@pytest.mark.parametrize(
    "name, unit", [("da3", VISLOC_FOCAL / 2 / 300), ("metric3d", VISLOC_FOCAL / 2 / 1000), ("unidepth", 1)]
)
def test_the_rules_of_networks_go_with_the_focal_length_at_their_resolution(folder, tmp_path, name, unit):
    """A map of half the photo's size has half its focal length."""
    np.save(tmp_path / "d.npy", exact(folder, 1)[::2, ::2] / unit)
    got = Depths(tmp_path / "d.npy", "z", name).altitude(photo_of(folder, 1), boxes_of(folder, 1))
    assert got.altitude == pytest.approx(ALTITUDES[1], rel=0.005)


@pytest.mark.parametrize("told", ["midas", "0", "-1", "nan", "1000", ""])
def test_a_factor_that_is_none_is_refused(told):
    with pytest.raises(UsageError, match="--depth-factor"):
        rule_of(told)


def damaged(kind, path):
    if kind == "text":
        path.write_text("no array")
    elif kind == "pickle":
        np.save(path, np.array([{}]), allow_pickle=True)
    elif kind == "three layers":
        np.save(path, np.ones((4, 5, 3)))
    elif kind == "zeros":
        np.save(path, np.zeros((4, 5)))
    elif kind == "whole numbers":
        np.save(path, np.ones((4, 5), np.uint16))
    elif kind == "empty":
        np.save(path, np.zeros((0, 5)))
    elif kind == "colour":
        Image.new("RGB", (5, 4)).save(path)
    elif kind == "8 bit":
        Image.new("L", (5, 4)).save(path)


@pytest.mark.parametrize(
    "kind, name, word",
    [
        ("text", "d.npy", "not a readable NumPy array"), ("pickle", "d.npy", "not a readable NumPy array"),
        ("three layers", "d.npy", "not a depth map"), ("zeros", "d.npy", "no depth above 0"),
        ("empty", "d.npy", "no depth above 0"), ("whole numbers", "d.npy", "--depth-factor 0.001"),
        ("text", "d.tif", "cannot be read"), ("colour", "d.png", "a picture of a depth"),
        ("8 bit", "d.png", "a picture of a depth"), ("absent", "d.npy", "does not exist"),
    ],
)  # fmt: skip
def test_files_that_are_no_depth_map_are_named(folder, tmp_path, kind, name, word):
    damaged(kind, tmp_path / name)
    with pytest.raises(InputError) as error:
        Depths(tmp_path / name).of(photo_of(folder, 0))
    assert word in f"{error.value.message} {error.value.hint}" and name in error.value.message


# Networks


def painted(folder, k, path):
    """A photo whose red is its depth: 4 levels for a metre from 50 m on."""
    depth = np.nan_to_num(exact(folder, k), nan=50)
    levels = ((depth - 50) * 4).clip(0, 255).round().astype(np.uint8)
    Image.fromarray(np.stack([levels, levels // 2, levels // 3], -1)).save(path)
    return open_photo(path, focal_px=VISLOC_FOCAL, pitch=float(PITCHES[k]))


@pytest.mark.slow
@pytest.mark.parametrize("rank", [4, 5])
@pytest.mark.parametrize("size", [(None, None), (300, 504), (420, 308)])
@pytest.mark.parametrize("name", RULES)
def test_a_network_sees_the_photo_as_its_rule_says(folder, tmp_path, name, size, rank):
    """It decodes red to depth in its own unit; a size that the picture does not fill is padded, and cropped again."""
    photo = painted(folder, 1, tmp_path / "photo.png")
    rule = RULES[name]
    mean, sd = rule.normalisation.mean[0], rule.normalisation.std[0]
    wide, high = photo.tags.width, photo.tags.height
    scale = min(size[0] / high, size[1] / wide) if size[0] else rule.side / wide
    unit = rule.metres(VISLOC_FOCAL * scale)
    path = depth_network(tmp_path / "n.onnx", gain=sd / 4 / unit, offset=(50 + mean / 4) / unit, size=size, rank=rank)
    depths = Depths(path, "z", name)
    got = depths.altitude(photo, boxes_of(folder, 1))
    assert got.altitude == pytest.approx(ALTITUDES[1], rel=0.01)
    seen = depths.of(photo).metres
    assert seen.shape[1] / seen.shape[0] == pytest.approx(wide / high, rel=0.02)


@pytest.mark.parametrize(
    "more, word",
    [
        ({"inputs": 2}, "2 inputs"),
        ({"outputs": ("a", "b")}, "which of its outputs"),
        ({"size": (None, 504)}, "only one side"),
        ({"channels": 1}, "not a picture"),
        ({"flat": True}, "is not a depth map"),
    ],
)
def test_a_network_that_is_none_for_depth_is_refused(folder, tmp_path, more, word):
    photo = painted(folder, 1, tmp_path / "photo.png")
    path = depth_network(tmp_path / "n.onnx", **more)
    with pytest.raises((InputError, UsageError), match=word):
        Depths(path, "z", "da3").of(photo)


def test_the_depth_among_several_outputs_is_known_by_its_name(folder, tmp_path):
    photo = painted(folder, 1, tmp_path / "photo.png")
    path = depth_network(tmp_path / "n.onnx", outputs=("confidence", "depth"), offset=7.0, gain=0.0)
    metres = Depths(path, "z", "unidepth").of(photo).metres
    assert np.allclose(metres, 7)


def test_a_network_without_a_rule_and_no_network_are_refused(folder, tmp_path):
    with pytest.raises(UsageError, match="nothing states the unit"):
        Depths(depth_network(tmp_path / "n.onnx"))
    (tmp_path / "m.onnx").write_text("none")
    with pytest.raises(InputError, match="not an ONNX network"):
        Depths(tmp_path / "m.onnx", "z", "da3")


# The commands


def rules(folder):
    return ["--detections", folder / "detections.json", "--fleet", folder / "fleet.json", "--focal-px", VISLOC_FOCAL]


def test_photos_get_their_maps_by_name(folder, tmp_path):
    shutil.copytree(folder / "depth", tmp_path / "depth")
    (tmp_path / "depth/photos/001.npy").unlink()
    line = ["photo", folder, *rules(folder), "--depth", tmp_path / "depth", "--json"]
    done = in_process.run(*line)
    assert done.returncode == 0, done.stderr
    rows = {row["photo"]: row for row in json.loads(done.stdout)["rows"]}
    first = rows["photos/000.jpg"]
    assert first["depth_altitude_m"] == pytest.approx(70, rel=GROUND)
    assert first["depth_ratio"] == pytest.approx(first["depth_altitude_m"] / first["altitude_m"], abs=1e-4)
    assert "no depth map of photos/001.jpg" in rows["photos/001.jpg"]["depth_problem"]
    assert rows["photos/002.jpg"]["depth_altitude_m"] and not rows["photos/002.jpg"]["depth_problem"]
    said = in_process.run(*line[:-1]).stdout
    assert "by depth 70" in said and "depth: " in said


def test_one_photo_side_by_side(folder, tmp_path):
    path = tmp_path / "000.jpg"
    path.write_bytes((folder / "photos/000.jpg").read_bytes())
    found = json.loads((folder / "detections.json").read_text())
    found["pictures"] = {"000.jpg": found["pictures"]["photos/000.jpg"]}
    (tmp_path / "boxes.json").write_text(json.dumps(found))
    line = ["photo", path, "--detections", tmp_path / "boxes.json", *rules(folder)[2:]]
    plain = in_process.run(*line)
    assert plain.returncode == 0 and "compared" not in plain.stdout
    map_ = folder / "depth/photos/000.npy"
    done = in_process.run(*line, "--depth", map_)
    assert done.returncode == 0, done.stderr
    (row,) = (text.split() for text in done.stdout.splitlines() if text.strip().startswith("depth "))
    assert float(row[1]) == pytest.approx(70, abs=0.15) and float(row[2]) == pytest.approx(1, abs=0.02)
    assert row[-2:] == [f"{float(row[-2]):.1f}", "%"], "the unit set off, as everywhere"
    np.save(tmp_path / "inverse.npy", 300 / exact(folder, 0))
    refused = in_process.run(*line, "--depth", tmp_path / "inverse.npy", "--out", tmp_path / "out.csv")
    assert refused.returncode == 5 and "inverse depth" in refused.stderr and not (tmp_path / "out.csv").exists()
    several = in_process.run("photo", folder, *rules(folder), "--depth", map_)
    assert several.returncode == 2 and "depth of one photo" in several.stderr


def test_evaluate_has_depth_as_one_more_method(folder, tmp_path):
    line = ["evaluate", folder / "photos.csv", *rules(folder)[:4], "--depth-folder", folder / "depth"]
    done = in_process.run(*line, "--json", "--out", tmp_path / "out.csv")
    assert done.returncode == 0, done.stderr
    text = json.loads(done.stdout)
    (got,) = text["regions"]["depth"]
    assert got["used"] == 3 and got["worst_ape"] < 100 * GROUND and got["in_interval"] is None
    rows = list(csv.DictReader((tmp_path / "out.csv").open()))
    assert [float(row["depth_m"]) for row in rows] == pytest.approx(ALTITUDES, rel=GROUND)
    again = in_process.run(*line, "--overwrite", "--out", tmp_path / "out.csv")
    assert again.returncode == 0 and "depth" in again.stdout


def test_evaluate_says_which_photos_have_no_depth(folder, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/001.npy").write_bytes((folder / "depth/photos/001.npy").read_bytes())
    done = in_process.run("evaluate", folder / "photos.csv", *rules(folder)[:4], "--depth-folder", tmp_path, "--json")
    text = json.loads(done.stdout)
    assert text["regions"]["depth"][0]["used"] == 1
    assert any("2 of 3 photos without an altitude by depth" in note for note in text["notes"])
