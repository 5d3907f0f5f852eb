"""Models as the mapping programs leave them today: COLMAP's binary, pycolmap's incremental and its global mapper.

The frames are real, a quarter of their pixels, without a GPU: about a minute of one core each.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from orthoscale.actions.estimate import estimate
from orthoscale.actions.fix import fix
from orthoscale.formats.detections.own import save_detections
from orthoscale.sources.opening import open_source

pytestmark = [pytest.mark.real, pytest.mark.slow]
SCENE, SIZE = "brighton", (1000, 562)
FEATURES = 1000
THREADS = 2


@pytest.fixture(scope="module")
def frames(data, tmp_path_factory) -> Path:
    """The small frames."""
    folder = tmp_path_factory.mktemp("frames")
    for path in sorted((data / "reconstructions" / SCENE / "images").iterdir()):
        cv2.imwrite(str(folder / path.name), cv2.resize(cv2.imread(str(path)), SIZE, interpolation=cv2.INTER_AREA))
    return folder


@pytest.fixture(scope="module")
def database(frames, tmp_path_factory) -> Path:
    """Features and matches, by pycolmap."""
    path = tmp_path_factory.mktemp("matched") / "database.db"
    cpu = {"device": pycolmap.Device.cpu}
    reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.use_gpu = matching.use_gpu = False
    extraction.num_threads = matching.num_threads = THREADS
    extraction.sift.max_num_features = FEATURES
    pycolmap.extract_features(
        path,
        frames,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        **cpu,
    )
    pycolmap.match_exhaustive(path, matching_options=matching, **cpu)
    return path


@pytest.fixture(scope="module")
def incremental(frames, database, tmp_path_factory) -> Path:
    """The model of `pycolmap.incremental_mapping`."""
    out = tmp_path_factory.mktemp("incremental")
    pycolmap.incremental_mapping(database, frames, out)
    return out / "0"


@pytest.fixture(scope="module")
def boxes(frames, incremental, tmp_path_factory) -> Path:
    """The vehicles in the frames, found once for all models."""
    path = tmp_path_factory.mktemp("found") / "boxes.json"
    save_detections(estimate(incremental, images=frames, fleet="US", mode="oblique").detections, path)
    return path


def by_global_mapping(frames: Path, database: Path, out: Path) -> Path:
    """`pycolmap.global_mapping`, which was GLOMAP."""
    pycolmap.global_mapping(database, frames, out)
    return out / "0"


def binary() -> str:
    """COLMAP's program, or a skip that says so."""
    found = shutil.which("colmap")
    if found is None:
        pytest.skip("no colmap on the PATH (apt-get install colmap)")
    return found


def run(command: str, **options: object) -> str:
    words = [binary(), command, *(word for name, value in options.items() for word in (f"--{name}", str(value)))]
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def version() -> tuple[int, int]:
    """Of COLMAP's program."""
    said = subprocess.run([binary(), "help"], capture_output=True, text=True).stdout
    found = re.search(r"COLMAP (\d+)\.(\d+)", said)
    assert found is not None, said[:200]
    return int(found[1]), int(found[2])


def by_binary(frames: Path, _: Path, out: Path) -> Path:
    """`colmap mapper`, with features and matches of its own: another version's database is not read."""
    own = out / "own.db"
    old = version() < (3, 12)
    extraction, matching = ("SiftExtraction", "SiftMatching") if old else ("FeatureExtraction", "FeatureMatching")
    run("feature_extractor", database_path=own, image_path=frames, **{
        "ImageReader.single_camera": 1, "ImageReader.camera_model": "SIMPLE_RADIAL", f"{extraction}.use_gpu": 0,
        f"{extraction}.num_threads": THREADS, "SiftExtraction.max_num_features": FEATURES})  # fmt: skip
    run("exhaustive_matcher", database_path=own, **{f"{matching}.use_gpu": 0, f"{matching}.num_threads": THREADS})
    run("mapper", database_path=own, image_path=frames, output_path=out, **{"Mapper.num_threads": THREADS})
    return out / "0"


def stands(model: pycolmap.Reconstruction) -> dict[str, np.ndarray]:
    """Where the cameras stand, by the names of their images."""
    return {image.name: image.projection_center() for image in model.images.values() if image.has_pose}


def times_as_large(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> float:
    """Distances of the cameras in `b` over those in `a`."""
    names = sorted(set(a) & set(b))
    assert len(names) >= 16, "a mapper finds nearly all of the 18 frames"
    extents = [
        np.linalg.norm(np.array([each[n] for n in names]) - np.mean([each[n] for n in names], 0)) for each in (a, b)
    ]
    return float(extents[1] / extents[0])


@pytest.fixture(scope="module", params=[None, by_global_mapping, by_binary])
def mapped(request, frames, database, incremental, boxes, data, tmp_path_factory):
    """A mapper's model, the folder in which `fix` wrote it in metres, the result, and true metres per unit."""
    folder = tmp_path_factory.mktemp("mapped")
    model = request.param(frames, database, folder) if request.param else incremental
    result = fix(model, folder / "metric", images=frames, fleet="US", detections=boxes, force=True)
    scene = data / "reconstructions" / SCENE
    given = json.loads((scene / "truth.json").read_text())["metres_per_model_unit"]
    theirs = stands(pycolmap.Reconstruction(scene / "sparse"))
    return model, folder / "metric", result, given * times_as_large(stands(pycolmap.Reconstruction(model)), theirs)


def test_its_model_is_scaled(mapped):
    model, metric, result, truth = mapped
    assert result.scale.value == pytest.approx(truth, rel=0.15)  # six vehicles, 90 % within 10 %
    assert result.scale.interval90[0] < truth < result.scale.interval90[1]
    before, after = (stands(pycolmap.Reconstruction(folder)) for folder in (model, metric))
    assert times_as_large(before, after) == pytest.approx(result.scale.value, rel=1e-9)
    assert open_source(metric, need_images=False).metric_already


def test_pycolmap_reads_sim3_txt(mapped):
    """As COLMAP's Sim3d::FromFile does: scale, quaternion w x y z, translation."""
    model, metric, _, _ = mapped
    scale, w, x, y, z, *shift = map(float, (metric / "sim3.txt").read_text().split())
    moved = pycolmap.Reconstruction(model)
    moved.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d([x, y, z, w]), shift))
    assert_same(moved, pycolmap.Reconstruction(metric))


def test_the_binary_reads_the_form_of_its_version(mapped, tmp_path):
    model, metric, _, _ = mapped
    form = "sim3_4x4.txt" if version() < (3, 9) else "sim3.txt"
    run("model_transformer", input_path=model, output_path=tmp_path, transform_path=metric / form)
    assert_same(pycolmap.Reconstruction(tmp_path), pycolmap.Reconstruction(metric))


def assert_same(a: pycolmap.Reconstruction, b: pycolmap.Reconstruction) -> None:
    one, other = stands(a), stands(b)
    assert set(one) == set(other)
    size = max(np.abs(place).max() for place in other.values())
    assert max(np.abs(one[name] - other[name]).max() for name in one) < 1e-9 * size
    for number, point in a.points3D.items():
        assert np.abs(point.xyz - b.points3D[number].xyz).max() < 1e-9 * max(size, np.abs(point.xyz).max())
