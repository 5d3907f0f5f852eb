"""Whether a reconstruction's observations determine its focal length, and what is made of one that they leave open."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring.geometry import larger_by
from orthoscale.core.projection.exact import ground_size
from orthoscale.core.projection.level import level_views, up_from_gimbal
from orthoscale.errors import InputError
from orthoscale.sources import focal
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.focal import SYSTEMATIC, bend_sd, focal_doubt, focal_sd
from orthoscale.synthetic import make_scene, write_colmap


@pytest.fixture(scope="module")
def suburb():
    """Low houses."""
    return make_scene(3, extent_m=120.0, style="suburb")


def block(scene, tmp_path, pitch):
    """Tracks of a flight over `scene`, looking down at `pitch` degrees."""
    write_colmap(scene, tmp_path, 3.0, 12, pitch, 80.0, pictures=False)
    return pycolmap.Reconstruction(str(tmp_path / "sparse"))


def noisy_block(scene, tmp_path, pitch, seed):
    """A small one, whose observations err by 0.6 px."""
    write_colmap(scene, tmp_path, 3.0, 8, pitch, 60.0, seed=seed, n_points=400, noise_px=0.6, pictures=False)
    return pycolmap.Reconstruction(str(tmp_path / "sparse"))


def with_own_lenses(model):
    """The same model, in which each image has a camera of its own."""
    made = pycolmap.Reconstruction()
    for number, image in model.images.items():
        camera = model.cameras[image.camera_id]
        camera.camera_id = number
        made.add_camera_with_trivial_rig(camera)
        pixels = np.array([point.xy for point in image.points2D])
        new = pycolmap.Image(name=image.name, keypoints=pixels, camera_id=number, image_id=number)
        made.add_image_with_trivial_frame(new, image.cam_from_world())
    for point in model.points3D.values():
        made.add_point3D(point.xyz, point.track)
    made.update_point_3d_errors()
    return made


def adjust(model):
    """Bundle adjustment of `model` in place, its lenses with radial distortion."""
    for number, camera in model.cameras.items():
        model.cameras[number] = pycolmap.Camera(
            camera_id=number, model="RADIAL", width=camera.width, height=camera.height, params=[*camera.params, 0, 0]
        )
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    pycolmap.bundle_adjustment(model, options)


@pytest.mark.slow
def test_straight_down_leaves_it_open_and_a_slant_does_not(suburb, tmp_path):
    down, slant = (focal_sd(block(suburb, tmp_path / str(pitch), pitch)) for pitch in (90, 60))
    assert down > 4 * slant
    assert SYSTEMATIC * slant < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True])
def test_what_the_normal_equations_say_is_what_adjustment_does(suburb, tmp_path, own):
    """The focal length that bundle adjustment finds, of one camera or the mean of each image's own, scatters from noise
    to noise as much as is said."""
    found, said = [], []
    for seed in range(6):
        model = noisy_block(suburb, tmp_path / str(seed), 85, seed)
        model = with_own_lenses(model) if own else model
        adjust(model)
        said.append(focal_sd(model))
        found.append(np.mean([np.log(camera.mean_focal_length() / 900) for camera in model.cameras.values()]))
    assert 0.4 < np.sqrt(np.mean(np.square(found))) / np.mean(said) < 2.5


@pytest.mark.slow
def test_cameras_of_their_own_leave_it_more_open(suburb, tmp_path):
    """All were taken for one: 4 % (one sigma) were said where each image's focal length was 16 to 31 % too long."""
    model = noisy_block(suburb, tmp_path, 90, 0)
    assert focal_sd(with_own_lenses(model)) > 1.2 * focal_sd(model)


@pytest.mark.slow
def test_how_far_straight_views_may_bend_a_block_is_what_adjustment_does(suburb, tmp_path):
    """The spread of the cameras over that of the points, after bundle adjustment of noise, against the truth."""
    found, said = [], []
    for seed in range(6):
        model = noisy_block(suburb, tmp_path / str(seed), 90, seed)
        up = np.linalg.svd(np.cov(places(model)[1].T))[2][2]
        before = spreads(model, up)
        adjust(model)
        up = np.linalg.svd(np.cov(places(model)[1].T))[2][2]
        said.append(bend_sd(model, up) / SYSTEMATIC)
        found.append(spreads(model, up) - before)
    assert 0.4 < np.sqrt(np.mean(np.square(found))) / np.mean(said) < 2.5


def places(model):
    """(N, 3) camera centres and (P, 3) points."""
    centres = np.array([model.image(number).projection_center() for number in sorted(model.reg_image_ids())])
    return centres, np.array([model.point3D(number).xyz for number in sorted(model.point3D_ids())])


def spreads(model, up):
    """Logarithm of the spread of the points over that of the cameras, across `up`."""
    level = np.eye(3) - np.outer(up, up)
    centres, points = (np.sqrt((((p - p.mean(0)) @ level) ** 2).sum()) for p in places(model))
    return np.log(points / centres)


@pytest.mark.slow
def test_straight_down_leaves_a_bend_open_and_a_slant_less(suburb, tmp_path):
    """Also where the ground is not level, and the spread across the upward axis depends on the axis."""
    said = []
    for name, pitch, slope in (("down", 90, 0.0), ("slant", 60, 0.0), ("slope", 60, 8.0)):
        write_colmap(suburb, tmp_path / name, 3.0, 12, pitch, 80.0, slope_deg=slope, pictures=False)
        said.append(ColmapSource.open(tmp_path / name, need_images=False).bend_sd)
    assert said[0] > 3 * max(said[1:]) and 0.02 < said[0] < 0.2 and max(said[1:]) < 0.02


def test_an_image_without_long_tracks_does_not_count(suburb, tmp_path):
    """As one over water: nothing held its pose, so that a bend was open by 1e154, and no GPS position counted."""
    model = block(suburb, tmp_path, 90)
    up = np.linalg.svd(np.cov(places(model)[1].T))[2][2]
    whole, first = bend_sd(model, up), model.image(min(model.reg_image_ids()))
    seen = [k for k, place in enumerate(first.points2D) if place.has_point3D()]
    for k in seen[2:]:
        model.delete_observation(first.image_id, k)
    assert bend_sd(model, up) == pytest.approx(whole, rel=0.2)


def test_without_tracks_a_bend_is_about_as_open(suburb, tmp_path):
    """As in files of other programs: their models counted as surely flat, and so positions of their cameras as sure."""
    for pitch in (90, 60):
        model = block(suburb, tmp_path / str(pitch), pitch)
        up = np.linalg.svd(np.cov(places(model)[1].T))[2][2]
        tracked, points = bend_sd(model, up), places(model)[1]
        for number in model.point3D_ids():
            model.delete_point3D(number)
        assert bend_sd(model, up) == 0
        for place in points:
            model.add_point3D(place, pycolmap.Track(), np.zeros(3, np.uint8))
        assert bend_sd(model, up) == pytest.approx(tracked, rel=0.3) and focal_sd(model) is None


def test_the_numbers_of_images_and_points_do_not_matter(suburb, tmp_path, monkeypatch):
    """Not even where only some of many tracks that are equally long are used, and some views of each."""
    monkeypatch.setattr(focal, "MOST_TRACKS", 150)
    monkeypatch.setattr(focal, "MOST_VIEWS", 4)
    monkeypatch.setattr(focal, "MOST_IMAGES", 9)
    model = block(suburb, tmp_path, 70)
    model.write_text(str(tmp_path))
    images, points = ((tmp_path / name).read_text().splitlines() for name in ("images.txt", "points3D.txt"))
    images, points = ([line.split() for line in lines if line[:1] != "#"] for lines in (images, points))
    for pose, seen in zip(images[::2], images[1::2], strict=True):
        pose[0] = str(100 - int(pose[0]))
        seen[2::3] = [each if each == "-1" else str(10**6 - int(each)) for each in seen[2::3]]
    for point in points:
        point[0], point[8::2] = str(10**6 - int(point[0])), [str(100 - int(each)) for each in point[8::2]]
    other = tmp_path / "other"
    other.mkdir()
    (other / "cameras.txt").write_bytes((tmp_path / "cameras.txt").read_bytes())
    (other / "images.txt").write_text("".join(" ".join(line) + "\n" for line in images))
    (other / "points3D.txt").write_text("".join(" ".join(line) + "\n" for line in points))
    assert focal_sd(pycolmap.Reconstruction(str(other))) == pytest.approx(focal_sd(model), rel=1e-6)


def test_too_few_tracks_say_nothing():
    assert focal_sd(pycolmap.Reconstruction()) is None
    assert bend_sd(pycolmap.Reconstruction(), np.array([0.0, 0, 1])) == 0
    assert focal_doubt(pycolmap.Reconstruction(), []).sd == 0


@pytest.mark.parametrize("formal, said", [(0.02, "determine the focal length only to 20 %"), (0.149, "leave the")])
def test_what_may_be_anything_has_no_percentage(monkeypatch, formal, said):
    """It was "determined only to 149 %". Frames that look ahead were told that they look straight down."""
    monkeypatch.setattr(focal, "focal_sd", lambda model: formal)
    doubt = focal_doubt(pycolmap.Reconstruction(), [])
    assert "flat ground, above all from straight above:" in doubt.said
    assert said in doubt.said and "149" not in doubt.said and doubt.sd == pytest.approx(10 * formal)


@pytest.mark.slow
def test_a_focal_length_that_is_left_open_is_taken_from_exif(tmp_path):
    from PIL import Image

    write_colmap(make_scene(3, extent_m=120.0, style="park"), tmp_path, 3.0, 12, 90, 80.0, pictures=False)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse"))
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 28  # mm equivalent: 28 / 43.27 of the diagonal of 1250 px
    for image in model.images.values():
        path = tmp_path / "images" / image.name
        Image.new("RGB", (1000, 750)).save(path, "JPEG", exif=exif)
    doubt = ColmapSource.open(tmp_path).focal
    assert doubt.ratio == pytest.approx(28 / 43.27 * 1250 / 900, rel=0.03)
    assert 0.005 < doubt.sd < 0.04
    assert "measured as footprints on the ground" in doubt.said and "809 px" in doubt.said
    assert "; cameras are assumed 10 % lower, since" in doubt.said
    for camera in model.cameras.values():
        camera.params = [810.0, *camera.params[1:]]
    same = focal_doubt(model, ColmapSource.open(tmp_path).pictures)
    assert "; cameras are left where they are, since" in same.said, "not: 0 % lower"


def test_the_frames_whose_tags_are_asked_for_their_lens_are_spread_over_all(monkeypatch):
    """Fewer than two for each that is asked: not the first twelve of them."""
    frames = [SimpleNamespace(name=f"{k:02d}.jpg", path=Path(f"{k:02d}.jpg")) for k in range(23)]
    asked = []
    monkeypatch.setattr(focal, "cameras_of", lambda _: {})
    monkeypatch.setattr("orthoscale.sources.lens.lens_of", lambda path: asked.append(path.name) or _without_lens())
    monkeypatch.setattr("orthoscale.sources.tags.read_tags", lambda path: path)
    assert focal._told(None, frames) == []
    assert asked == [f"{k:02d}.jpg" for k in range(0, 23, 2)]


def _without_lens():
    raise InputError("no lens", "none")


def test_footprints_stay_and_heights_follow():
    up = up_from_gimbal(-np.pi / 2)
    views, _ = level_views(np.array([[0.3, 0.2], [0.0, 0.0]]), np.tile(900 * np.eye(2), (2, 1, 1)), up, 60.0, 0.4)
    longer = views.with_focal(1.2)
    aside = views.ground - (views.ground @ up)[:, None] * up
    assert longer.ground - (longer.ground @ up)[:, None] * up == pytest.approx(aside)
    assert longer.ground @ up == pytest.approx(1.2 * (views.ground @ up))
    boxes = Boxes(np.array([[0, 0, 70.0, 28.0, 0.3]] * 2), np.ones(2))
    before, after = (ground_size(boxes, v, 1.0) for v in (views, longer))
    assert (after[0] > before[0]).all()  # less of the box is height
    assert after == pytest.approx(before, rel=0.03)


@pytest.mark.parametrize("times, named", [(1, False), (15, True)])
def test_without_ground_a_focal_length_that_ran_away_is_named(suburb, tmp_path, times, named):
    """As of flat blocks that COLMAP drew out along the rays: a focal length of twelve widths of the picture."""
    block(suburb, tmp_path, 90)
    source = ColmapSource.open(tmp_path, need_images=False)
    for point in source._model.points3D.values():
        point.xyz = (0, 0, 0)
    camera = source._model.cameras[1]
    camera.params = np.array([times, 1, 1]) * camera.params
    with pytest.raises(InputError, match="no ground surface lies below") as caught:
        _ = source.ground
    assert ("focal length of camera 1 is 1" in caught.value.message) == named
    assert ("ba_refine_focal_length 0" in caught.value.hint) == named


def test_boxes_that_no_vehicle_gives_do_not_count_for_the_focal_length():
    size = np.array([[4.0, 1.8], [4.4, 1.9], [np.nan, np.nan], [-0.3, 0.2], [0.1, 0.1]])
    longer = np.array([[4.4, 1.8], [4.84, 1.9], [4.0, 1.8], [-0.2, 0.3], [0.1, -0.1]])
    assert larger_by(longer, size) == pytest.approx([np.log(1.1), 0])
    assert (larger_by(longer[2:], size[2:]) == 0).all()
