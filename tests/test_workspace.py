"""Workspaces as COLMAP leaves them: several models, dense folders, a database beside them."""

from __future__ import annotations

import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from support.geometry import dense_workspace

from orthoscale.actions import workspace
from orthoscale.actions.apply import apply
from orthoscale.actions.check import check
from orthoscale.actions.fix import fix
from orthoscale.actions.workspace import estimate_all, fix_all, models_in
from orthoscale.cli.main import cli
from orthoscale.errors import InputError, TooLittleEvidence, UsageError
from orthoscale.formats.geometry.sim3 import Sim3
from orthoscale.requests import EstimateRequest, FixRequest
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.database import pose_priors
from orthoscale.system.signatures import FOLDER_MARK

EXAMPLE = Path(__file__).parent.parent / "examples" / "sheffield"
OPTIONS = {"fleet": "US", "detections": EXAMPLE / "detections.json", "mode": "planar"}  # the quickest way


@pytest.fixture
def work(tmp_path):
    """Two models of one mapper: the example, and the same in another unit."""
    work = tmp_path / "work"
    shutil.copytree(EXAMPLE / "sparse", work / "sparse" / "0")
    other = pycolmap.Reconstruction(str(EXAMPLE / "sparse"))
    other.transform(pycolmap.Sim3d(0.5, pycolmap.Rotation3d(), np.ones(3)))
    (work / "sparse" / "1").mkdir()
    other.write_binary(str(work / "sparse" / "1"))
    return work


@pytest.mark.slow
def test_each_model_has_its_own_scale(work, tmp_path):
    from click.testing import CliRunner

    out = tmp_path / "out"
    options = ["--fleet", "US", "--detections", str(EXAMPLE / "detections.json"), "--mode", "planar", "--json"]
    run = CliRunner().invoke(cli, ["fix", str(work), "--out", str(out), *options], catch_exceptions=False)
    said = json.loads(run.stdout)
    assert said == json.loads((out / "models.json").read_text())
    assert said["1"]["scale"] == pytest.approx(2 * said["0"]["scale"], rel=1e-3)
    for name in ("0", "1"):
        assert json.loads((out / name / "sim3.json").read_text())["scale"] == said[name]["scale"]
        assert (out / name / "report.json").is_file()
    metric = [pycolmap.Reconstruction(str(out / name)) for name in ("0", "1")]
    heights = [np.ptp([i.projection_center() for i in m.images.values()]) for m in metric]
    assert heights[0] == pytest.approx(heights[1], rel=1e-3)


def test_a_workspace_is_never_an_output(work, tmp_path):
    from click.testing import CliRunner

    (tmp_path / "foreign").mkdir()
    before = sorted(tmp_path.rglob("*"))
    words = ["fix", str(work), "--fleet", "US", "--detections", str(EXAMPLE / "detections.json"), "--overwrite"]
    for out in (".", "sparse", "sparse/0", "sparse/0/new", "new", "../foreign", ".."):
        run = CliRunner().invoke(cli, [*words, "--out", str(work / out)])
        assert isinstance(run.exception, UsageError), (out, run.exception)
        assert ("not written by orthoscale" if out == "../foreign" else "the input") in run.exception.message
        assert sorted(tmp_path.rglob("*")) == before
    for out in (work, work / "sparse", work / "sparse/1", work / "sparse/1/new"):
        with pytest.raises(UsageError, match="(is|contains|lies in) the input"):
            fix_all(models_in(work), out, FixRequest(overwrite=True, **OPTIONS))
        assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_a_model_without_evidence_does_not_stop_the_others(work, tmp_path):
    (work / "sparse/1/points3D.bin").write_bytes(b"\0" * 5)
    outcomes = fix_all(models_in(work), tmp_path / "out", FixRequest(**OPTIONS))
    assert [outcome.error is None for outcome in outcomes] == [True, False]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [FOLDER_MARK, "0", "models.json"]
    assert json.loads((tmp_path / "out/models.json").read_text())["1"]["exit_code"] == 5

    (tmp_path / "few.json").write_text('{"DJI_0225.jpg": []}')
    with pytest.raises(TooLittleEvidence, match="sparse/0: 0 boxes on the ground, 5 are needed"):
        fix_all(models_in(work), tmp_path / "none", FixRequest(fleet="US", detections=tmp_path / "few.json"))
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_scaled_copy_among_the_models_does_not_stop_them(work, tmp_path):
    shutil.rmtree(work / "sparse/1")
    fix(work / "sparse/0", work / "sparse/metric", **OPTIONS)
    outcomes = fix_all(models_in(work), tmp_path / "out", FixRequest(**OPTIONS))
    assert outcomes[0].error is None and "in metres already" in str(outcomes[1].error)
    assert not (tmp_path / "out/metric").exists()


@pytest.mark.parametrize("count", (1, 2))
def test_boxes_of_one_picture_are_for_several_models_only_where_they_name_it(work, tmp_path, monkeypatch, count):
    """Else models of one frame each would all be measured by the boxes of one picture, which is another's."""
    asked = []

    def refused(*args):
        asked.append(next(request for request in args if isinstance(request, EstimateRequest)).alone)
        raise TooLittleEvidence("not measured")

    monkeypatch.setattr(workspace, "measured", refused)
    monkeypatch.setattr(workspace, "written", refused)
    models = models_in(work)[:count]
    with pytest.raises(TooLittleEvidence):
        estimate_all(models, EstimateRequest(**OPTIONS))
    with pytest.raises(TooLittleEvidence):
        fix_all(models, tmp_path / "out", FixRequest(**OPTIONS))
    assert asked == [count == 1] * 2 * count


def test_a_dry_run_speaks_of_each_model(work, tmp_path):
    from click.testing import CliRunner

    words = ["--fleet", "US", "--detections", str(EXAMPLE / "detections.json"), "--dry-run"]
    run = CliRunner().invoke(cli, ["fix", str(work), "--out", str(tmp_path / "out"), *words])
    for name in ("0", "1"):
        assert f"{work}/sparse/{name}: a model" in run.stdout and f"{tmp_path}/out/{name}\n" in run.stdout
    assert run.exit_code == 0 and not (tmp_path / "out").exists()
    assert f"{work}/sparse/1: a model" in CliRunner().invoke(cli, ["estimate", str(work), *words]).stdout
    run = CliRunner().invoke(cli, ["fix", str(work), "--out", str(work / "out"), *words])
    assert isinstance(run.exception, UsageError)


def test_one_scale_is_not_applied_to_several_models(work, tmp_path):
    Sim3(2.0).save(tmp_path)
    with pytest.raises(UsageError, match="holds 2 models, each with a scale of its own: 0, 1"):
        apply(tmp_path / "sim3.json", work, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    apply(tmp_path / "sim3.json", work / "sparse/1", tmp_path / "out")


@pytest.mark.slow
def test_a_scale_is_not_applied_to_another_model(work, tmp_path):
    """Cameras of the same names stand elsewhere in a model of another run."""
    fix(work / "sparse/0", tmp_path / "scaled", **OPTIONS)
    apply(tmp_path / "scaled/sim3.json", work / "sparse/0", tmp_path / "same")
    other = pycolmap.Reconstruction(work / "sparse/1")
    other.transform(pycolmap.Sim3d(1.3, pycolmap.Rotation3d(), np.array([5.0, 0, 0])))
    other.write(work / "sparse/1")
    with pytest.raises(UsageError, match="is not the model that was scaled"):
        apply(tmp_path / "scaled/sim3.json", work / "sparse/1", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_one_model_is_no_workspace(tmp_path):
    shutil.copytree(EXAMPLE / "sparse", tmp_path / "sparse" / "0")
    assert models_in(tmp_path) == models_in(tmp_path / "sparse/0/cameras.bin") == []


@pytest.mark.slow
def test_dense_comes_along(work, tmp_path):
    dense_workspace(work / "dense" / "0")
    image = next(iter((model := pycolmap.Reconstruction(str(work / "sparse/0"))).images.values()))
    places = [model.points3D[seen.point3D_id].xyz for seen in image.points2D if seen.has_point3D()]
    depth = np.full((2, 3), np.median([(image.cam_from_world() * place)[2] for place in places]), "<f4")
    own = work / f"dense/0/stereo/depth_maps/{image.name}.geometric.bin"  # shows that they are of this model
    own.write_bytes(b"3&2&1&" + depth.tobytes())
    result = fix(work / "sparse/0", tmp_path / "out", dense=True, **OPTIONS)
    depth = np.frombuffer((tmp_path / "out/dense/stereo/depth_maps/a.jpg.geometric.bin").read_bytes()[6:], "<f4")
    assert depth[0] == pytest.approx(result.scale.value, rel=1e-6)
    assert (tmp_path / "out/dense/sparse/cameras.bin").is_file()
    assert any("depth maps" in note for note in map(str, result.source.notes))
    assert json.loads((tmp_path / "out/report.json").read_text())["remarks"]

    with pytest.raises(InputError, match="cameras stand elsewhere"):  # before anything is measured
        shutil.copytree(work / "dense/0", work / "dense/1")
        fix(work / "sparse/1", tmp_path / "other", dense=True, **OPTIONS)
    shutil.rmtree(work / "dense/0/sparse")  # then nothing shows in which units the rest is
    with pytest.raises(InputError, match="no undistorted model"):
        fix(work / "sparse/0", tmp_path / "other", dense=True, **OPTIONS)
    shutil.rmtree(work / "dense")
    with pytest.raises(UsageError, match="no dense workspace"):
        fix(work / "sparse/0", tmp_path / "other", dense=True, **OPTIONS)
    assert not (tmp_path / "other").exists()


def test_pose_priors_are_left_alone_and_said(work, monkeypatch):
    path = work / "database.db"
    with pycolmap.Database.open(str(path)) as database:
        image = pycolmap.Image(name="a.jpg", camera_id=database.write_camera(
            pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500.0, 640, 480)))  # fmt: skip
        number = database.write_image(image)
        prior = pycolmap.PosePrior(position=np.ones(3))
        prior.corr_data_id = pycolmap.data_t(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1), number)
        database.write_pose_prior(prior)
        turned = pycolmap.PosePrior(position=np.full(3, np.nan), gravity=np.array([1.0, 0, 0]))  # by EXIF's orientation
        turned.corr_data_id = pycolmap.data_t(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1), number + 1)
        database.write_pose_prior(turned)
    before = path.read_bytes()
    notes = [*map(str, ColmapSource.open(work / "sparse/0", need_images=False).notes)]
    assert any("its pose prior is not in model units" in note for note in notes)
    # Beside the model's own files, and named from the current folder, it was not found: an address must be absolute.
    monkeypatch.chdir(work)
    assert "its pose prior is not in model units" in pose_priors(Path())
    assert path.read_bytes() == before
    path.unlink()
    sqlite3.connect(path).close()
    assert not any(
        "pose prior" in note for note in map(str, ColmapSource.open(work / "sparse/0", need_images=False).notes)
    )


def test_a_sim3_beside_the_original_model_is_of_it(tmp_path):
    """It was taken for one beside the scaled model, which stands elsewhere."""
    shutil.copytree(EXAMPLE / "sparse", tmp_path / "sparse")
    Sim3(2.0).save(tmp_path)
    shutil.copy(tmp_path / "sim3.json", tmp_path / "sparse")
    apply(tmp_path / "sparse/sim3.json", tmp_path / "sparse", tmp_path / "out")
    assert (tmp_path / "out/sparse/sim3.txt").is_file()


def test_what_is_said_of_one_of_several_models_names_it(work, tmp_path):
    """`check` judges the one with the most images; its refusal named the workspace."""
    with pytest.raises(UsageError, match=f"{work}/sparse/0 claims no scale"):
        check(work, **OPTIONS)
    assert ColmapSource.open(work, need_images=False).path == work / "sparse/0"
    shutil.rmtree(work / "sparse/1")
    assert ColmapSource.open(work, need_images=False).path == work
