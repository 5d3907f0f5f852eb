"""Models that do not agree with themselves are refused, and say where; poor ones that do are not."""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from support.models import draw_points, make_model, patched, put_frames, save
from support.other_programs import LENS, bundler, nerfstudio, nvm, opensfm

from orthoscale.core.remarks import REFUSAL
from orthoscale.errors import InputError
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.opening import open_source
from orthoscale.synthetic import make_scene, write_colmap

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared/data") / "reconstructions"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A flight over a synthetic scene, 7.3 m per model unit, in a folder."""
    folder = tmp_path_factory.mktemp("whole")
    write_colmap(make_scene(1), folder, metres_per_unit=7.3, pictures=False)
    return folder


def opened(folder: Path) -> ColmapSource:
    return ColmapSource.open(folder, need_images=False)


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        opened(folder)
    assert caught.value.hint and caught.value.exit_code == 5
    return caught.value.message


def changed(whole: Path, out: Path, change) -> Path:
    """The model with what `change` does to it, in the folder `out`."""
    model = pycolmap.Reconstruction(str(opened(whole).folder))
    change(model)
    return save(model, out, "bin")


def moved(model, centre_of) -> None:
    """Every camera to the place that `centre_of` has for its own; it looks where it looked."""
    for frame in model.frames.values():
        pose = frame.rig_from_world
        centre = centre_of(-pose.rotation.matrix().T @ pose.translation)
        frame.rig_from_world = pycolmap.Rigid3d(pose.rotation, -pose.rotation.matrix() @ centre)


def focal_doubled(model) -> None:
    for camera in model.cameras.values():
        camera.focal_length = 2 * camera.focal_length


def points_grown(factor: float):
    def change(model) -> None:
        middle = np.mean([point.xyz for point in model.points3D.values()], axis=0)
        for point in model.points3D.values():
            point.xyz = middle + factor * (point.xyz - middle)

    return change


def on_a_line(centre):
    return np.array([centre[0], 0.0, 0.0])


DAMAGE = {
    "focal length doubled": focal_doubled,
    "centres doubled": lambda model: moved(model, lambda centre: 2 * centre),
    "cameras put on a line": lambda model: moved(model, on_a_line),
    "cameras put in one place": lambda model: moved(model, lambda centre: np.zeros(3)),
    "points 1.3 times as large": points_grown(1.3),
    "points 3 % too large": points_grown(1.03),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_a_damaged_model_is_refused(whole, tmp_path, what):
    said = refusal(changed(whole, tmp_path / "m", DAMAGE[what]))
    assert ("camera 1" in said or "image frame_" in said) and ("px from" in said or "nowhere near" in said)


def test_one_byte_of_a_focal_length(whole, tmp_path):
    folder = tmp_path / "m"
    shutil.copytree(opened(whole).folder, folder)
    patched(folder, "cameras.bin", 32 + 6, "B", 0xCE)
    assert struct.unpack_from("<d", (folder / "cameras.bin").read_bytes(), 32) == (15424.0,)
    assert "camera 1 (16 of 16 images" in refusal(folder)


def test_files_of_two_models(tmp_path):
    """Another flight's cameras or images, with the same numbers of points and images."""
    one = save(make_model("SIMPLE_PINHOLE", (400, 320, 240))[0], tmp_path / "one", "bin")
    other = save(make_model("SIMPLE_PINHOLE", (450, 320, 240))[0], tmp_path / "other", "bin")
    shutil.copyfile(other / "cameras.bin", tmp_path / "one/cameras.bin")
    assert "camera 1 (12 of 12 images, the first is 00.png)" in refusal(one)

    one = save(make_model("SIMPLE_PINHOLE", (400, 320, 240))[0], tmp_path / "two", "bin")
    model = make_model("SIMPLE_PINHOLE", (400, 320, 240))[0]
    moved(model, lambda centre: centre + (0.5, 0.3, 0.0))
    save(model, tmp_path / "moved", "bin")
    for table in ("images.bin", "frames.bin"):
        shutil.copyfile(tmp_path / "moved" / table, one / table)
    assert "px from where they were seen" in refusal(one)


def test_two_poses_swapped(whole, tmp_path):
    def swap(model) -> None:
        one, two = (model.frames[k] for k in sorted(model.frames)[:2])
        poses = [pycolmap.Rigid3d(frame.rig_from_world.matrix()) for frame in (one, two)]
        two.rig_from_world, one.rig_from_world = poses

    assert "image frame_0000.jpg and 1 more of 16" in refusal(changed(whole, tmp_path / "m", swap))


def test_one_of_two_cameras(tmp_path):
    model, _ = make_model(rig=True)
    assert opened(save(model, tmp_path / "sound", "txt"))
    model.cameras[2].focal_length_x, model.cameras[2].focal_length_y = 520.0, 533.0
    said = refusal(save(model, tmp_path / "m", "txt"))
    assert "camera 2 (12 of 24 images, the first is cam2/00.png)" in said


def test_half_of_the_points(tmp_path):
    model, _ = make_model()
    for number in sorted(model.points3D)[::3]:
        model.points3D[number].xyz = model.points3D[number].xyz + (0.0, 3.0, 0.0)
    assert "% of its points are not where its images saw them" in refusal(save(model, tmp_path / "m", "bin"))


def test_a_picture_of_another_size(tmp_path):
    model, _ = make_model()
    model.cameras[1].width = 320
    said = refusal(save(model, tmp_path / "m", "bin"))
    assert re.search(r"\d\d % of the observations of .* lie outside of pictures of 320 x 480 px$", said)


@pytest.mark.parametrize(
    "cropped_px, moved_along, said",
    [
        (100, False, "of the observations of camera 1 (12 of 12 images, the first is 00.png) lie outside of pictures"),
        (100, True, "of the observations of image 02.png and 3 more of 12 lie outside of pictures of 440 x 280 px"),
        (80, True, "of its observations lie outside of their pictures"),
    ],
)
def test_cropped_pictures(tmp_path, cropped_px, moved_along, said):
    """Cameras told of a crop by their sizes and principal points; the observations stay, or move along."""
    model, _ = make_model("SIMPLE_PINHOLE", (400, 320, 240))
    camera = model.cameras[1]
    camera.width, camera.height = 640 - 2 * cropped_px, 480 - 2 * cropped_px
    camera.params = [400, 320 - cropped_px, 240 - cropped_px]
    for image in model.images.values():
        for point in image.points2D:
            point.xy -= cropped_px * moved_along
    with pytest.raises(InputError) as caught:
        opened(save(model, tmp_path / "m", "bin"))
    assert said in caught.value.message and "were cropped or resized" in caught.value.hint


@pytest.mark.parametrize("noise_px", [0.5, 5.0])
def test_a_poor_model_is_taken(tmp_path, noise_px):
    """Noise of 5 px each in x and y is a median of 5.9 px apart; a twentieth of the observations are strays."""
    model, _ = make_model()
    random = np.random.default_rng(0)
    for image in model.images.values():
        for point in image.points2D:
            point.xy = np.clip(point.xy + noise_px * random.normal(size=2), 0, (640, 480))
        for k in range(0, len(image.points2D), 20):
            image.points2D[k].xy = random.uniform(0, (640, 480))
    assert opened(save(model, tmp_path / "m", "bin")).notes[:-1] == []


def test_a_strip_is_taken_and_said(tmp_path):
    model, turn = make_model()
    for image in list(model.images.values()):
        if abs((turn.T @ image.projection_center())[1]) > 1:
            model.deregister_frame(image.frame_id)
    assert any("on one straight line" in note for note in map(str, opened(save(model, tmp_path / "m", "bin")).notes))
    assert not any("line" in note for note in map(str, opened(save(make_model()[0], tmp_path / "n", "bin")).notes))


def test_one_place_is_refused_although_it_reprojects(tmp_path):
    """Pictures turned about one place: points at any distance reproject."""
    model, turn = make_model("SIMPLE_PINHOLE", (400, 320, 240))
    moved(model, lambda centre: turn @ (0, 0, 12.0) + 1e-3 * centre)
    for image in model.images.values():
        for seen in image.points2D:
            if seen.has_point3D():
                pixel = image.project_point(model.points3D[seen.point3D_id].xyz)
                inside = pixel is not None and (pixel > 0).all() and (pixel < (640, 480)).all()
                seen.xy = pixel if inside else (1.0, 1.0)
    for number in list(model.points3D):
        track = model.points3D[number].track.elements
        if any((model.image(e.image_id).points2D[e.point2D_idx].xy == 1).all() for e in track):
            model.delete_point3D(number)
    assert len(model.points3D) > 50
    assert "all 12 cameras stand in one place" in refusal(save(model, tmp_path / "m", "bin"))


def unseen(model, names, but: int = 0) -> None:
    """No observation of a point in the images `names`, or `but` a few; and those that stand alone are misplaced."""
    for image in model.images.values():
        if image.name in names:
            for k in np.flatnonzero([point.has_point3D() for point in image.points2D])[but:].tolist():
                model.delete_observation(image.image_id, k)
            if model.frames[image.frame_id].num_data_ids() == 1:
                pose = image.cam_from_world()
                model.frames[image.frame_id].rig_from_world = pycolmap.Rigid3d(pose.rotation, pose.translation + 5.0)


@pytest.mark.parametrize("but", [0, 12])
def test_images_that_hardly_any_points_hold_are_left_out(tmp_path, but):
    """As global mappers leave them: 12 observations are enough to show that their place is wrong, but not to hold it.
    The model that is written has them."""
    model, _ = make_model()
    unseen(model, ("03.png", "07.png"), but)
    put_frames(model, tmp_path / "images")
    source = ColmapSource.open(save(model, tmp_path / "m", "bin"))
    assert any("2 of 12 images are left out, the first is 03.png" in str(note) for note in source.notes)
    assert len(source.picture_names) == len(source.pictures) == 10 and "03.png" not in source.picture_names
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.0)
    assert pycolmap.Reconstruction(str(tmp_path / "out")).num_reg_images() == 12


def test_images_that_are_left_out_are_no_part(tmp_path):
    """Two such images that share points with each other alone."""
    model, _ = make_model()
    unseen(model, ("03.png", "07.png"))
    pair = [image.image_id for image in model.images.values() if image.name in ("03.png", "07.png")]
    for k in range(12):
        elements = [pycolmap.TrackElement(number, k) for number in pair]
        model.add_point3D(np.array([0.1 * k, 0.2, 0.0]), pycolmap.Track(elements), np.full(3, 99, np.uint8))
    source = opened(save(model, tmp_path / "m", "bin"))
    assert len(source.picture_names) == 10 and not list(source.parts)
    assert not any("falls into parts" in str(note) for note in source.notes)


def test_images_of_a_rig_hold_each_other(tmp_path):
    model, _ = make_model(rig=True)
    unseen(model, ("cam1/03.png",))
    source = opened(save(model, tmp_path / "m", "bin"))
    assert len(source.picture_names) == 24 and not any("left out" in str(note) for note in source.notes)


@pytest.mark.parametrize("writer", [bundler, nvm, opensfm])
def test_other_programs_leave_such_images_too(tmp_path, writer):
    model = make_model("SIMPLE_PINHOLE", (400, 320, 240))[0]
    unseen(model, ("03.png", "07.png"), 5)
    path = writer(model, tmp_path)
    put_frames(model, tmp_path / "images")
    if writer is opensfm:
        tracks(model, tmp_path / "tracks.csv")
    source = open_source(path)
    assert [str(note) for note in source.notes if "2 of 12 images are left out, the first is 03.png" in str(note)]
    assert len(source.picture_names) == len(source.pictures) == 10
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 2.0)
    assert "03.png" in (tmp_path / "out" / path.name).read_text() or writer is bundler


@pytest.mark.parametrize("writer", [bundler, nvm, opensfm])
def test_other_programs_frames_of_another_flight(tmp_path, writer):
    """Of the same names and sizes. They gave a scale without a word, as frames of COLMAP's models do not."""
    lens = ("SIMPLE_PINHOLE", (400, 320, 240)) if writer is nvm else ("RADIAL", (400, 320, 240, LENS["k1"], LENS["k2"]))
    model = make_model(*lens)[0]
    path = writer(model, tmp_path)
    tracks(model, tmp_path / "tracks.csv")
    images = list(model.images.values())
    for image, other in zip(images, images[1:] + images[:1], strict=True):
        for place, name in (("own", image.name), ("another", other.name)):
            draw_points(model, image, tmp_path / place / name)
    assert open_source(path, tmp_path / "own").notes == []
    (note,) = open_source(path, tmp_path / "another").notes
    assert note.severity == REFUSAL and "may be of another flight" in note.text
    assert open_source(path, tmp_path / "another", need_images=False).notes == [note]
    assert open_source(path, tmp_path / "another", compare_frames=False).notes == []


def unobserved(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The `model` without its observations, as programs write it that only show models."""
    bare = pycolmap.Reconstruction()
    bare.add_camera_with_trivial_rig(model.cameras[1])
    for image in model.images.values():
        image_alone = pycolmap.Image(name=image.name, camera_id=1, image_id=image.image_id)
        bare.add_image_with_trivial_frame(image_alone, image.cam_from_world())
    for point in model.points3D.values():
        bare.add_point3D(point.xyz, pycolmap.Track(), point.color)
    return bare


def colmap(model: pycolmap.Reconstruction, folder: Path) -> Path:
    return save(model, folder / "m", "bin")


@pytest.mark.parametrize("writer", [nerfstudio, opensfm, bundler, colmap])
def test_frames_are_compared_without_observations(tmp_path, writer):
    """By the points that lie in front of each camera. Turned frames gave a scale without a word."""
    model = make_model("RADIAL", (LENS["f"], 320, 240, LENS["k1"], LENS["k2"]))[0]
    path = writer(unobserved(model), tmp_path)
    for image in model.images.values():
        own = tmp_path / "own/images" / image.name
        own.parent.mkdir(parents=True, exist_ok=True)
        draw_points(model, image, own)
        turned = tmp_path / "turned/images" / image.name
        turned.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(turned), cv2.rotate(cv2.imread(str(own)), cv2.ROTATE_180))
    inner = "" if writer is nerfstudio else "images"
    unchecked, *more = open_source(path, tmp_path / "own" / inner).notes
    assert "holds no observations of its points" in unchecked.text and not more
    unchecked, note = open_source(path, tmp_path / "turned" / inner).notes
    assert note.severity == REFUSAL and "turned" in note.text
    (unchecked,) = open_source(path, tmp_path / "turned" / inner, compare_frames=False).notes


def test_another_lens_is_told_without_observations(tmp_path):
    model = make_model()[0]
    for image in model.images.values():
        draw_points(model, image, tmp_path / "frames" / image.name, 0.2)
    _, note = open_source(colmap(unobserved(model), tmp_path), tmp_path / "frames").notes
    assert "larger than the model's lens does" in note.text


@pytest.mark.parametrize("writer", [bundler, nvm, opensfm])
def test_other_programs(tmp_path, writer):
    """Sound, then with a focal length of 1.5 times; and without tracks, which is said."""
    model = make_model("RADIAL", (LENS["f"], 320, 240, LENS["k1"], LENS["k2"]))[0]
    if writer is nvm:
        model = make_model("SIMPLE_PINHOLE", (400, 320, 240))[0]
    path = writer(model, tmp_path)
    put_frames(model, tmp_path / "images")
    if writer is opensfm:
        assert any("holds no observations of its points" in note for note in map(str, open_source(path).notes))
        tracks(model, tmp_path / "tracks.csv")
    assert open_source(path).notes == []
    if writer is opensfm:
        text = json.loads(path.read_text())
        text[0]["cameras"]["c"]["focal"] *= 1.5
        path.write_text(json.dumps(text))
    else:
        path.write_text(path.read_text().replace("400.0 ", "600.0 "))
    with pytest.raises(InputError, match=r"projected [\d.]+ px from where they were seen") as caught:
        open_source(path)
    assert ".png" in caught.value.message


def tracks(model, path: Path) -> None:
    """OpenSfM's tracks: from the middle, in shares of the longer side."""
    lines = ["OPENSFM_TRACKS_VERSION_v1"]
    for image in model.images.values():
        for k, seen in enumerate(image.points2D):
            if seen.has_point3D():
                x, y = (seen.xy - (320, 240)) / 640
                lines.append(f"{image.name}\t{seen.point3D_id}\t{k}\t{x:.8f}\t{y:.8f}\t0.004\t1\t2\t3\t-1\t-1")
    path.write_text("\n".join(lines) + "\n")


def test_a_long_file_of_tracks_is_read_in_places(tmp_path, monkeypatch):
    model = make_model("RADIAL", (LENS["f"], 320, 240, LENS["k1"], LENS["k2"]))[0]
    path = opensfm(model, tmp_path)
    tracks(model, tmp_path / "tracks.csv")
    monkeypatch.setattr("orthoscale.sources.json_model.READ_WHOLE", 0)
    monkeypatch.setattr("orthoscale.sources.json_model.READ_BYTES", 512)
    notes = [str(note) for note in open_source(path, need_images=False).notes]
    assert not any("no observations" in note or "left out" in note for note in notes)
    text = json.loads(path.read_text())
    text[0]["shots"]["03.png"]["translation"][0] += 1.0
    path.write_text(json.dumps(text))
    with pytest.raises(InputError, match=r"image 03\.png are projected"):
        open_source(path, need_images=False)


def test_an_image_that_a_sample_of_the_tracks_misses_is_not_left_out(tmp_path, monkeypatch):
    """It has enough of them to hold it. Of 1,500 images a third was left out."""
    model = make_model("RADIAL", (LENS["f"], 320, 240, LENS["k1"], LENS["k2"]))[0]
    image = next(image for image in model.images.values() if image.name == "03.png")
    for k in np.flatnonzero([point.has_point3D() for point in image.points2D])[32:].tolist():
        model.delete_observation(image.image_id, k)
    path = opensfm(model, tmp_path)
    tracks(model, tmp_path / "tracks.csv")
    monkeypatch.setattr("orthoscale.sources.json_model.READ_WHOLE", 0)
    monkeypatch.setattr("orthoscale.sources.json_model.READ_AT", 1)
    monkeypatch.setattr("orthoscale.sources.json_model.READ_BYTES", 1024)
    source = open_source(path, need_images=False)
    assert len(source.picture_names) == 12 and not any("left out" in str(note) for note in source.notes)


def test_what_has_no_tracks_says_so(tmp_path):
    model = make_model("RADIAL", (LENS["f"], 320, 240, LENS["k1"], LENS["k2"]))[0]
    assert (
        "holds no observations of its points"
        in open_source(nerfstudio(model, tmp_path), need_images=False).notes[0].text
    )


def test_a_focal_length_far_from_that_of_exif_is_said(tmp_path):
    from PIL import Image

    model, _ = make_model()
    folder = save(model, tmp_path / "m", "bin")
    for focal_35mm, said in ((22, False), (35, True)):  # 800 px of the diagonal, as 43.3 mm: 406 px and 647 px
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0xA405] = focal_35mm
        for image in model.images.values():
            path = tmp_path / "images" / image.name
            path.parent.mkdir(exist_ok=True)
            Image.new("RGB", (640, 480)).save(path, "JPEG", exif=exif)
        note = ColmapSource.open(folder).focal.said
        assert ("647 px (35 mm equivalent in EXIF)" in note and "405 px" in note) == said


@pytest.mark.parametrize("scene", ["sheffield", "brighton", "boruszyn", "weedon"])
def test_real_models_agree_with_themselves(scene, tmp_path):
    if not (DATA / scene).is_dir():
        pytest.skip(f"no real data: {DATA / scene} is absent (set ORTHOSCALE_DATA)")
    source = ColmapSource.open(DATA / scene)
    assert not any("line" in note or "nothing shows" in note for note in map(str, source.notes))

    def longer(model) -> None:
        for camera in model.cameras.values():
            camera.focal_length = 1.05 * camera.focal_length

    assert "camera" in refusal(changed(DATA / scene, tmp_path / "m", longer))
