"""Reconstructions of Bundler and VisualSFM: the same model as COLMAP's, and back again in metres."""

from __future__ import annotations

import os
import pickle
import re

import numpy as np
import pycolmap
import pytest
from support.models import make_model, put_frames, save
from support.other_programs import K1, K2, bundler, nerfstudio, nvm, opensfm, process_data, rescaled, same_views

from orthoscale.actions.apply import apply
from orthoscale.actions.fix import fix
from orthoscale.errors import InputError, OutputError, UsageError
from orthoscale.formats.geometry.files import ONE_FILE
from orthoscale.formats.geometry.sim3 import Sim3
from orthoscale.formats.geometry.text_models import FIRST_OF_MANY, read_text_model
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.exchange_files import find_exchange
from orthoscale.sources.opening import open_source
from orthoscale.sources.scaling import scale_path
from orthoscale.sources.text_model import TextSource


@pytest.fixture(scope="module")
def made():
    return make_model("RADIAL", (400.0, 320, 240, K1, K2))


@pytest.fixture(scope="module")
def pinhole():
    return make_model("SIMPLE_PINHOLE", (400.0, 320, 240))


@pytest.mark.parametrize("writer", [bundler, nvm])
def test_pickled_as_its_path(made, tmp_path, writer):
    path = writer(made[0], tmp_path)
    put_frames(made[0], path.parent / "images")
    source = open_source(path)
    again = pickle.loads(pickle.dumps(source))
    assert type(again) is TextSource and again.picture_names == source.picture_names


def test_a_file_that_was_changed_since_it_was_opened_is_neither_hashed_nor_written(made, tmp_path):
    path = bundler(made[0], tmp_path / "in")
    put_frames(made[0], path.parent / "images")
    source = open_source(path)
    (tmp_path / "out").mkdir()
    for part in source.files:
        before = part.stat().st_mtime_ns
        os.utime(part, (0, 0))
        for use in (source.content_hash, lambda: source.write(tmp_path / "out", 2.0)):
            with pytest.raises(InputError, match=f"{part.name} was changed since it was opened"):
                use()
        os.utime(part, ns=(before, before))
    source.content_hash()


@pytest.mark.slow
def test_views_are_those_of_the_colmap_model(made, pinhole, tmp_path):
    for number, (model, path) in enumerate([(made[0], bundler(made[0], tmp_path / "b")),
                                            (pinhole[0], nvm(pinhole[0], tmp_path / "n"))]):  # fmt: skip
        put_frames(model, path.parent / "images")
        colmap = ColmapSource.open(save(model, tmp_path / f"colmap{number}", "bin"), need_images=False)
        other = open_source(path)
        assert isinstance(other, TextSource) and len(other.pictures) == len(other.picture_names) == 12
        same_views(colmap, other)


def test_distortion_of_visualsfm_is_that_of_measurements(pinhole, tmp_path):
    """Its manual: where the pinhole sees p, the picture has m, (1 + r |m|^2) m = p."""
    r = 0.08
    path = nvm(pinhole[0], tmp_path, r, head="NVM_V3 FixedK 400 330 400 250 0", tracks=False)
    put_frames(pinhole[0], tmp_path / "images")
    source = open_source(path)
    name = source.picture_names[0]
    m = np.array([[0.3, -0.2], [-0.25, 0.35], [0.05, 0.3]])
    p = (1 + r * (m**2).sum(1, keepdims=True)) * m
    seen = np.column_stack([p, np.ones(3)]) * 2.5
    world = (seen - source._images[name].cam_from_world().translation) @ source.rotation(name)
    assert np.allclose(source.project(name, world), 400 * m + (330, 250), atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("writer", [bundler, nvm])
def test_written_again_in_metres(made, tmp_path, writer):
    path, result = rescaled(*made, writer, tmp_path, mode="planar")
    new = open_source(tmp_path / "out", images=tmp_path / "in/images")
    assert new.path == tmp_path / "out" / path.name
    assert new.camera_height == pytest.approx(result.scale.value * result.source.camera_height, rel=1e-6)
    assert new.metric_already
    with pytest.raises(UsageError, match="in metres already"):
        fix(tmp_path / "out", tmp_path / "again", fleet="DE", images=tmp_path / "in/images",
            detections=tmp_path / "boxes.json")  # fmt: skip


@pytest.mark.parametrize("writer", [bundler, nvm, opensfm, nerfstudio, process_data])
def test_a_scale_is_not_applied_to_another_programs_model_of_another_unit(pinhole, tmp_path, writer):
    """Only COLMAP's were compared with the one that was scaled."""
    Sim3(2.0).save(save(pinhole[0], tmp_path / "colmap", "bin"))
    metric, other = (pycolmap.Reconstruction(tmp_path / "colmap") for _ in range(2))
    metric.transform(pycolmap.Sim3d(2.0, pycolmap.Rotation3d(), np.zeros(3)))
    metric.write_binary(str(tmp_path / "colmap"))
    other.transform(pycolmap.Sim3d(1.3, pycolmap.Rotation3d(), np.zeros(3)))
    paths = []
    for name, model in (("same", pinhole[0]), ("other", other)):
        path = writer(model, tmp_path / name)
        paths.append(path or tmp_path / name / "transforms.json")
    apply(tmp_path / "colmap/sim3.json", paths[0], tmp_path / "out")
    with pytest.raises(UsageError, match=f"{paths[1]} is not the model that was scaled: .*png stands"):
        apply(tmp_path / "colmap/sim3.json", paths[1], tmp_path / "none")
    assert not (tmp_path / "none").exists()
    if writer in (opensfm, nerfstudio):  # and where the one that was scaled is no model of COLMAP's
        Sim3(2.0).save(tmp_path / "out")
        with pytest.raises(UsageError, match="is not the model"):
            apply(tmp_path / "out/sim3.json", paths[1], tmp_path / "none")
        apply(tmp_path / "out/sim3.json", save(pinhole[0], tmp_path / "sparse", "bin"), tmp_path / "more")


def test_what_macos_leaves_beside_a_model_is_not_taken_for_it(pinhole, tmp_path):
    path = nvm(pinhole[0], tmp_path)
    (tmp_path / "._scene.nvm").write_bytes(b"\0\5\x16\7")
    assert find_exchange(tmp_path) == path


def test_a_camera_number_of_hundreds_of_digits_is_damage(pinhole, tmp_path):
    path = nvm(pinhole[0], tmp_path)
    lines = path.read_text().split("\n")
    row = next(k for k, line in enumerate(lines) if len(line.split()) > 10 and line.split()[6].isdigit())  # a track
    words = lines[row].split()
    lines[row] = " ".join([*words[:7], "9" * 400, *words[8:]])
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="neither Bundler's"):
        read_text_model(path)


@pytest.mark.parametrize("writer", [bundler, nvm])
def test_only_lengths_change(pinhole, tmp_path, writer):
    path = writer(pinhole[0], tmp_path)
    scale_path(path, tmp_path / f"new{path.suffix}", 2.0)
    old, new = (read_text_model(p) for p in (path, tmp_path / f"new{path.suffix}"))
    assert np.allclose(new.points, 2 * old.points, rtol=1e-15)
    assert np.allclose(new.translation, 2 * old.translation, rtol=1e-15)
    for same in ("focal", "distortion", "rotation", "colours"):
        assert (getattr(new, same) == getattr(old, same)).all()
    lines = [p.read_text().split("\n") for p in (path, tmp_path / f"new{path.suffix}")]
    kept = [a == b for a, b in zip(*lines, strict=False)]
    assert 0.3 < np.mean(kept) < 0.9 if writer is bundler else not any(kept[3:15])


def test_rotations_as_matrices_are_not_taken_for_lengths(pinhole, tmp_path):
    """VisualSFM's other form has nine numbers of a matrix and a translation where this has a quaternion and a place."""
    path = nvm(pinhole[0], tmp_path, head="NVM_V3_R9T")
    for reads in (read_text_model, lambda p: scale_path(p, tmp_path / "new.nvm", 3.0)):
        with pytest.raises(InputError, match="NVM_V3_R9T"):
            reads(path)


def test_only_the_first_of_several_models_is_taken(pinhole, tmp_path):
    alone = nvm(pinhole[0], tmp_path / "a").read_text()
    path = nvm(pinhole[0], tmp_path / "b", more=alone.split("\n", 1)[1])
    assert scale_path(path, tmp_path / "new.nvm", 3.0) == [FIRST_OF_MANY]
    assert scale_path(tmp_path / "new.nvm", tmp_path / "again.nvm", 3.0) == []
    text = read_text_model(path)
    assert len(text.focal) == 12 and text.others and not read_text_model(tmp_path / "new.nvm").others
    assert (tmp_path / "new.nvm").read_text().endswith("\n0\n")
    assert len((tmp_path / "new.nvm").read_text()) < 1.2 * len(alone)


def test_images_that_are_in_no_model_are_no_other_model(pinhole, tmp_path):
    """VisualSFM lists them as a last model without points."""
    lost = "2\nlost 1.jpg 1000 1 0 0 0 0 0 0 0 0\nlost 2.jpg 1000 1 0 0 0 0 0 0 0 0\n0\n"
    path = nvm(pinhole[0], tmp_path, more=lost)
    assert scale_path(path, tmp_path / "new.nvm", 3.0) == []
    assert lost in (tmp_path / "new.nvm").read_text()
    assert len(read_text_model(path).focal) == len(read_text_model(tmp_path / "new.nvm").focal) == 12
    path.write_text(path.read_text().split("lost 2")[0])  # cut off
    assert read_text_model(path).others


def test_names_of_windows(made, pinhole, tmp_path):
    put_frames(made[0], tmp_path / "pics")
    for writer, (model, _) in ((bundler, made), (nvm, pinhole)):
        path = writer(model, tmp_path)
        for file in (path, tmp_path / "list.txt"):
            text = re.sub(r"^(\./)?(\d\d\.png)", r".\\pics\\\2", file.read_text(), flags=re.MULTILINE)
            file.write_text(text, newline="\r\n")
        assert open_source(path).pictures[0].name == "pics/00.png"


@pytest.mark.parametrize("folder", [r"D:\Flüge\my flight", "/home/anna/flight"])
def test_whole_paths_of_another_machine_count_from_the_folder_that_they_share(made, pinhole, tmp_path, folder):
    """As Metashape's and RealityCapture's lists have them: no frame was found, and the names were said to differ."""
    put_frames(made[0], tmp_path / "pics/a")
    sep = "\\" if "\\" in folder else "/"
    for writer, (model, _) in ((bundler, made), (nvm, pinhole)):
        path = writer(model, tmp_path, lost=0) if writer is bundler else writer(model, tmp_path)
        for file in (path, tmp_path / "list.txt"):
            there = f"{folder}{sep}a{sep}".replace("\\", "\\\\").replace(" ", '"' if file.suffix == ".nvm" else " ")
            file.write_text(re.sub(r"^(\./)?(\d\d\.png)", there + r"\2", file.read_text(), flags=re.MULTILINE))
        source = open_source(path, tmp_path / "pics/a")
        assert len(source.pictures) == len(source.picture_names) == 12 and source.picture_names[0] == "00.png"
        (tmp_path / "out").mkdir()
        source.write(tmp_path / "out", 2.0)
        (tmp_path / "out").rename(tmp_path / f"out{path.suffix}")


@pytest.mark.parametrize("name", ["flight.out.list.txt", "flight.list.txt", "flight_list.txt", "list.txt"])
def test_the_list_of_bundlers_images_by_any_programs_name(made, tmp_path, name):
    """COLMAP's window writes x.out.list.txt beside x.out."""
    path = bundler(made[0], tmp_path).rename(tmp_path / "flight.out")
    (tmp_path / "list.txt").rename(tmp_path / name)
    put_frames(made[0], tmp_path / "images")
    assert len(open_source(path).pictures) == 12


@pytest.mark.parametrize("focal", ["", " 0 401.25"])
def test_spaces_in_bundlers_list(made, tmp_path, focal):
    path = bundler(made[0], tmp_path, lost=0)
    put_frames(made[0], tmp_path / "my pics 0 7")
    names = sorted(f"my pics 0 7/{image.name}" for image in made[0].images.values())
    (tmp_path / "list.txt").write_text("".join(f"{name}{focal}\n" for name in names))
    assert open_source(path).picture_names == names


def test_what_is_missing_is_said(made, tmp_path):
    path = bundler(made[0], tmp_path)
    with pytest.raises(InputError, match="no frame of the model"):
        open_source(path, need_images=False)
    put_frames(made[0], tmp_path / "images")
    first = sorted((tmp_path / "images").iterdir())[0]
    first.unlink()
    source = open_source(tmp_path)
    assert len(source.picture_names) == 11 and "left out" in source.notes[0].text
    (tmp_path / "list.txt").write_text("a.jpg\n")
    with pytest.raises(InputError, match="names 1 images"):
        open_source(path)
    (tmp_path / "list.txt").unlink()
    with pytest.raises(InputError, match="no list"):
        open_source(path)


@pytest.mark.parametrize("writer", [bundler, nvm])
def test_damage_is_refused(pinhole, tmp_path, writer):
    path = writer(pinhole[0], tmp_path)
    put_frames(pinhole[0], tmp_path / "images")
    whole = path.read_text()
    lines = whole.split("\n")
    cut = whole.rindex("0.") if writer is nvm else len(whole)  # what follows the last point is not read
    damaged = [whole[: cut * k // 20] for k in range(20)]
    counts = 1 if writer is bundler else 2
    for words in ("99999999999 5", "-1 -1", "x", "1e9", ""):
        damaged.append("\n".join([*lines[:counts], words, *lines[counts + 1 :]]))
    camera = 9 if writer is bundler else 4
    for word in ("nan", "inf", "1e300", "abc"):
        place = slice(6, 9) if writer is nvm else slice(0, 3)
        words = lines[camera + (2 if writer is bundler else 0)].split()
        words[place] = [word] * 3
        at = camera + (2 if writer is bundler else 0)
        damaged.append("\n".join([*lines[:at], " ".join(words), *lines[at + 1 :]]))
    for text in damaged:
        path.write_text(text)
        with pytest.raises(InputError, match=path.name) as caught:
            open_source(path)
        assert not re.search("invalid literal|could not convert", caught.value.message), "no words for programmers"
    path.write_bytes(b"\xff\xfe\x00" * 100)
    with pytest.raises(InputError, match=f"{path.name}.*values of a wrong kind"):
        open_source(path)


def test_a_write_that_fails_is_noticed(pinhole, tmp_path, monkeypatch):
    path = nvm(pinhole[0], tmp_path / "in")
    put_frames(pinhole[0], tmp_path / "in/images")
    source = open_source(path)
    (tmp_path / "out").mkdir()
    monkeypatch.setitem(ONE_FILE, ".nvm", lambda a, b, s: b.write_text(a.read_text()) and None)
    with pytest.raises(OutputError, match="differs"):
        source.write(tmp_path / "out", 2.0)
