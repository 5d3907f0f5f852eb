"""The drop-in steps, run as a pipeline runs them, with stand-ins for the programs that are not there."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation
from support.geometry import dense_workspace

from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.opening import open_source

pytestmark = pytest.mark.slow  # each starts shells, and Python in them
ROOT = Path(__file__).parent.parent
HOOKS = ROOT / "colmap_hooks"
EXAMPLE = ROOT / "examples" / "sheffield"
FOUND = EXAMPLE / "detections.json"
OPTIONS = ["--fleet", "US", "--detections", str(FOUND), "--mode", "planar"]  # the quickest way to measure it


class Bench:
    """A workspace, a PATH with stand-ins, and a log of what they were called with."""

    def __init__(self, folder: Path):
        self.log = folder / "calls.log"
        self.log.touch()
        self.bin = folder / "bin"
        self.bin.mkdir()
        self.work = folder / "work"
        (self.work / "images").mkdir(parents=True)
        self.environment = {**os.environ, "PATH": f"{self.bin}:{os.environ['PATH']}", "PYTHON": sys.executable}
        self.program("orthoscale", f'exec {sys.executable} -m orthoscale "$@"')

    def program(self, name: str, body: str) -> None:
        path = self.bin / name
        path.write_text(f'#!/bin/sh\necho "{name} $*" >> {self.log}\n{body}\n')
        path.chmod(0o755)

    def sparse(self, name: str = "0") -> None:
        shutil.copytree(EXAMPLE / "sparse", self.work / "sparse" / name)

    def frames(self) -> None:
        """Grey frames of the example's names and size; its vehicles come from a file."""
        whole = cv2.imencode(".jpg", np.full((600, 800, 3), 90, np.uint8))[1].tobytes()
        for name in json.loads(FOUND.read_text())["pictures"]:
            (self.work / "images" / name).write_bytes(whole)

    def run(self, hook: str, *arguments: object, **environment: str) -> str:
        done = subprocess.run(
            [HOOKS / hook, *map(str, arguments)],
            env={**self.environment, **environment},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def calls(self, name: str) -> list[str]:
        return [line for line in self.log.read_text().splitlines() if line.split()[0] == name]

    def stamps(self) -> dict[str, int]:
        return {str(p): p.stat().st_mtime_ns for p in sorted(self.work.rglob("*"))}


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_post_sparse_writes_a_metric_model_once(bench):
    bench.sparse()
    bench.run("post_sparse.sh", bench.work, *OPTIONS)
    assert (bench.work / "sparse_metric/sim3.json").is_file()
    before = bench.stamps()
    assert "nothing to do" in bench.run("post_sparse.sh", bench.work, *OPTIONS)
    assert bench.stamps() == before


def later(path: Path) -> None:
    """Make `path` newer than all that was written."""
    then = time.time() + 5
    os.utime(path, (then, then))


def test_a_model_that_was_changed_is_not_taken_for_done(bench):
    """Its gauge is another: what was made of the old one must not stand for it."""
    bench.sparse()
    (bench.work / "dense").mkdir()
    bench.run("post_sparse.sh", bench.work, *OPTIONS)
    bench.run("post_sparse.sh", bench.work, *OPTIONS)
    later(bench.work / "sparse/0/images.bin")
    before = bench.stamps()
    for command in (
        [HOOKS / "post_sparse.sh", bench.work, *OPTIONS],
        [HOOKS / "post_dense.sh", bench.work, *OPTIONS],
        [HOOKS / "automatic_reconstructor.sh", "--workspace_path", bench.work, "--image_path", bench.work],
        [sys.executable, HOOKS / "pycolmap_hook.py", bench.work / "sparse", bench.work / "sparse_metric"],
    ):
        done = subprocess.run(command, env=bench.environment, capture_output=True, text=True)
        assert done.returncode == 2 and "was changed after" in done.stderr, command
        assert bench.stamps() == before
    bench.run("post_sparse.sh", bench.work, *OPTIONS, "--overwrite")
    assert bench.stamps() != before


def test_a_dense_workspace_that_was_changed_is_not_taken_for_done(bench):
    bench.sparse()
    dense_workspace(bench.work / "dense")
    bench.run("post_dense.sh", bench.work, *OPTIONS)
    later(bench.work / "dense/fused.ply")
    command = [HOOKS / "post_dense.sh", bench.work, *OPTIONS]

    def refused(*more):
        done = subprocess.run([*command, *more], env=bench.environment, capture_output=True, text=True)
        return done.returncode == 2 and "another now" in done.stderr

    assert refused()
    shutil.rmtree(bench.work / "dense_metric")
    bench.run("post_dense.sh", bench.work, *OPTIONS)
    assert refused("--overwrite"), "it would measure the sparse model anew, and leave this"
    later(bench.work / "sparse_metric/sim3.json")
    assert refused()


def test_a_link_to_a_model_that_was_changed(bench):
    bench.sparse()
    (bench.work / "sparse").rename(bench.work / "elsewhere")
    (bench.work / "sparse").symlink_to(bench.work / "elsewhere")
    bench.run("post_sparse.sh", bench.work, *OPTIONS)
    later(bench.work / "elsewhere/0/images.bin")
    command = [HOOKS / "post_sparse.sh", bench.work, *OPTIONS]
    done = subprocess.run(command, env=bench.environment, capture_output=True, text=True)
    assert done.returncode == 2 and "was changed after" in done.stderr


def test_post_dense_follows_the_layout(bench):
    for name in ("0", "1"):
        bench.sparse(name)
        dense_workspace(bench.work / "dense" / name)
    said = bench.run("post_dense.sh", bench.work, *OPTIONS)
    assert f"{bench.work}/dense_metric/0" in said and "partial" not in said
    for name in ("0", "1"):
        assert (bench.work / "sparse_metric" / name / "sim3.json").is_file()
        assert (bench.work / "dense_metric" / name / "stereo/depth_maps/a.jpg.geometric.bin").is_file()
    before = bench.stamps()
    assert "nothing to do" in bench.run("post_dense.sh", bench.work, *OPTIONS)
    assert bench.stamps() == before and not list(bench.work.glob(".*"))


@pytest.mark.parametrize("workspace", [".", "./", "../work/"])
def test_post_dense_names_what_it_wrote_wherever_it_is_called(bench, workspace):
    """orthoscale says `./x` as `x`: the folder for the time being stood in the message."""
    bench.sparse()
    dense_workspace(bench.work / "dense")
    command = [HOOKS / "post_dense.sh", workspace, *OPTIONS]
    done = subprocess.run(command, env=bench.environment, capture_output=True, text=True, cwd=bench.work)
    assert f"written    {workspace}/dense_metric\n" in done.stdout and "partial" not in done.stdout, done.stderr


def test_post_dense_knows_a_dead_run_from_a_living_one(bench):
    bench.sparse()
    dense_workspace(bench.work / "dense")
    partial = bench.work / ".dense_metric.partial"
    partial.mkdir()
    (partial / "half").touch()

    def refused():
        bench.run("post_sparse.sh", bench.work, *OPTIONS)
        before = bench.stamps()
        command = [HOOKS / "post_dense.sh", bench.work]
        done = subprocess.run(command, env=bench.environment, capture_output=True, text=True)
        assert done.returncode == 2 and bench.stamps() == before
        return done.stderr

    assert "in the way" in refused()
    (partial / ".writer").write_text(str(os.getpid()))
    assert "being written" in refused()
    with subprocess.Popen(["true"]) as dead:
        pass
    (partial / ".writer").write_text(str(dead.pid))
    bench.run("post_dense.sh", bench.work)
    assert (bench.work / "dense_metric/fused.ply").is_file() and not list(bench.work.glob(".*"))
    assert not (bench.work / "dense_metric/.writer").exists()


def test_automatic_reconstructor_then_metres(bench):
    """The stand-in leaves what colmap would: sparse/0 and dense/0; the hook brings both to metres, once."""
    made = dense_workspace(bench.work.parent / "made")
    copy = f"cp -r {EXAMPLE}/sparse {bench.work}/sparse/0 && cp -r {made} {bench.work}/dense/0"
    bench.program("colmap", f"mkdir -p {bench.work}/sparse {bench.work}/dense && {copy}")
    bench.frames()
    arguments = ["--workspace_path", bench.work, f"--image_path={bench.work / 'images'}", "--quality", "low"]
    bench.run("automatic_reconstructor.sh", *arguments, ORTHOSCALE_OPTIONS=" ".join(OPTIONS))
    assert bench.calls("colmap") == ["colmap automatic_reconstructor " + " ".join(map(str, arguments))]
    assert (bench.work / "sparse_metric/sim3.json").is_file()
    assert (bench.work / "dense_metric/0/fused.ply").is_file()
    before = bench.stamps()
    assert "nothing to do" in bench.run("automatic_reconstructor.sh", *arguments)
    assert bench.stamps() == before and len(bench.calls("colmap")) == 1


@pytest.mark.parametrize(
    "hook", ["post_sparse", "post_dense", "automatic_reconstructor", "nerfstudio", "gsplat", "odm"]
)
def test_a_hook_says_how_it_is_used(bench, hook):
    assert subprocess.run([HOOKS / f"{hook}.sh"], env=bench.environment, capture_output=True).returncode == 2
    assert bench.log.read_text() == ""


@pytest.mark.parametrize(
    "hook", ["post_sparse", "post_dense", "automatic_reconstructor", "nerfstudio", "gsplat", "odm"]
)
def test_a_hook_helps(bench, hook):
    said = bench.run(f"{hook}.sh", "--help")
    assert f"{hook}.sh " in said and "set -eu" not in said and bench.log.read_text() == ""


def test_what_is_missing_is_named(bench):
    bench.program("colmap", "")
    for hook, missing, arguments in (
        ("odm.sh", "missing/opensfm/reconstruction.json", ["missing"]),
        ("post_dense.sh", "./dense does not exist", ["."]),
        ("automatic_reconstructor.sh", "nowhere", ["--workspace_path", "nowhere", "--image_path", bench.work]),
    ):
        command = [HOOKS / hook, *map(str, arguments)]
        done = subprocess.run(command, env=bench.environment, capture_output=True, text=True, cwd=bench.work)
        assert done.returncode == 5 and missing in done.stderr and len(done.stderr.splitlines()) == 1
    assert bench.log.read_text() == ""


@pytest.mark.parametrize(
    ("hook", "missing", "arguments"),
    [
        ("post_sparse.sh", "orthoscale", ["W"]),
        ("odm.sh", "orthoscale", ["W"]),
        ("automatic_reconstructor.sh", "colmap", ["--workspace_path", "W", "--image_path", "W"]),
        ("nerfstudio.sh", "ns-process-data", ["W", "OUT"]),
        ("gsplat.sh", "simple_trainer.py", ["W", "OUT"]),
    ],
)
def test_a_program_that_is_not_there_is_named(bench, hook, missing, arguments):
    """On a PATH with nothing but what every system has."""
    for name in ("sh", "dirname", "sed"):
        (bench.bin / name).symlink_to(shutil.which(name))
    (bench.bin / "orthoscale").unlink()
    words = [str(bench.work) if word == "W" else word for word in arguments]
    environment = {"PATH": str(bench.bin), "GSPLAT": str(bench.work)}
    done = subprocess.run([HOOKS / hook, *words], env=environment, capture_output=True, text=True)
    assert done.returncode == 127 and f"{missing} is not there" in done.stderr, done.stderr
    assert len(done.stderr.splitlines()) == 1 and not (bench.work / "sparse_metric").exists()


@pytest.mark.parametrize("there", ["images", "sparse/0"])
def test_the_trainer_never_gets_a_folder_that_was_there_before(bench, there):
    """The link to the metric model was made in it, and the former model trained on."""
    (bench.work.parent / "out/data" / there).mkdir(parents=True)
    done = subprocess.run(
        [HOOKS / "gsplat.sh", bench.work, bench.work.parent / "out"],
        env=bench.environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and f"data/{there} is in the way" in done.stderr and bench.log.read_text() == ""


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP is not installed (apt-get install colmap)")
def test_colmap_itself_reads_the_metric_model(bench):
    """The real program; that it takes the similarity transform is in test_rescale."""
    bench.sparse()
    bench.run("post_sparse.sh", bench.work, *OPTIONS)
    metric, text = bench.work / "sparse_metric", bench.work / "text"
    text.mkdir()
    command = ["colmap", "model_converter", "--input_path", metric, "--output_path", text, "--output_type", "TXT"]
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(list(map(str, command)), env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    scale = json.loads((metric / "sim3.json").read_text())["scale"]
    images = pycolmap.Reconstruction(str(text)).images
    for number, old in pycolmap.Reconstruction(str(bench.work / "sparse/0")).images.items():
        assert np.allclose(images[number].projection_center(), scale * old.projection_center(), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("hook", ["post_sparse", "post_dense", "nerfstudio", "gsplat"])
def test_a_hook_hands_the_exit_code_on(bench, hook):
    bench.sparse()
    (bench.work / "dense").mkdir()
    bench.program("ns-process-data", "")
    (bench.work / "sparse/0/points3D.bin").write_bytes(b"cut")
    end = [bench.work.parent / "out"] if hook in ("nerfstudio", "gsplat") else []
    run = subprocess.run([HOOKS / f"{hook}.sh", bench.work, *end], env=bench.environment, capture_output=True)
    assert run.returncode == 5
    assert not (bench.work / "sparse_metric").exists() and not (bench.work / "dense_metric").exists()


@pytest.mark.parametrize("hook", ["post_sparse", "post_dense", "nerfstudio", "gsplat"])
def test_a_rehearsal_ends_where_nothing_was_written(bench, hook):
    bench.sparse()
    (bench.work / "dense").mkdir()
    bench.program("ns-process-data", "")
    end = [bench.work.parent / "out", "--"] if hook in ("nerfstudio", "gsplat") else []
    said = bench.run(f"{hook}.sh", bench.work, *end, *OPTIONS, "--dry-run")
    assert "to write" in said and "sparse_metric" in said
    assert not list(bench.work.glob("*_metric")) and not bench.calls("ns-process-data")
    assert not (bench.work.parent / "out").exists()


def test_a_rehearsal_of_all_of_colmap_ends_there_too(bench):
    bench.program("colmap", f"mkdir -p {bench.work}/dense/0")
    bench.sparse()
    bench.frames()
    arguments = ["--workspace_path", bench.work, "--image_path", bench.work / "images"]
    said = bench.run("automatic_reconstructor.sh", *arguments, ORTHOSCALE_OPTIONS=" ".join([*OPTIONS, "--dry-run"]))
    assert "to write" in said and not list(bench.work.glob("*_metric"))


@pytest.mark.parametrize(
    ("hook", "more"),
    [("gsplat", ["--dry-run"]), ("nerfstudio", ["--dry-run"]), ("nerfstudio", ["splatfacto", "--dry-run"])],
)
def test_options_without_the_dashes_before_them_are_refused(bench, hook, more):
    """They would be lost, and a rehearsal be none."""
    for program in ("ns-process-data", "ns-train"):
        bench.program(program, "")
    words = [HOOKS / f"{hook}.sh", bench.work, bench.work.parent / "out", *more]
    run = subprocess.run(words, env=bench.environment, capture_output=True, text=True)
    assert run.returncode == 2 and "[-- orthoscale options]" in run.stderr
    assert not bench.log.read_text()


def test_a_dense_workspace_in_a_folder_whose_name_is_no_pattern(bench):
    bench.work = bench.work.rename(bench.work.parent / "R&D | lot [1]")
    bench.sparse()
    shutil.copytree(dense_workspace(bench.work.parent / "made"), bench.work / "dense/0")
    said = bench.run("post_dense.sh", bench.work, *OPTIONS)
    assert f"{bench.work}/dense_metric/0" in said and ".partial" not in said
    assert (bench.work / "dense_metric/0/fused.ply").is_file()


def test_what_nerfstudio_makes_of_the_metric_model_is_in_metres(bench):
    """A stand-in that writes what the real ns-process-data does; read back, and nothing is scaled twice by hand."""
    bench.sparse()
    code = "import sys, pycolmap; from pathlib import Path; from support.other_programs import process_data; "
    code += "a = sys.argv; model = pycolmap.Reconstruction(a[a.index('--colmap-model-path') + 1]); "
    code += "process_data(model, Path(a[a.index('--output-dir') + 1]))"
    tests = os.pathsep.join([str(ROOT / "tests"), str(ROOT)])
    bench.program("ns-process-data", f'PYTHONPATH={tests} exec {sys.executable} -c "{code}" "$@"')
    bench.run("nerfstudio.sh", bench.work, bench.work / "ns", "--", *OPTIONS)
    scale = json.loads((bench.work / "sparse_metric/sim3.json").read_text())["scale"]
    text = json.loads((bench.work / "ns/transforms.json").read_text())
    old = pycolmap.Reconstruction(str(bench.work / "sparse/0"))
    turn = np.array(text["applied_transform"])[:, :3]
    assert len(text["frames"]) == len(old.images)
    for frame in text["frames"]:
        place = np.array(frame["transform_matrix"])[:3, 3]
        assert place == pytest.approx(scale * turn @ old.images[frame["colmap_im_id"]].projection_center(), rel=1e-6)
    before = ColmapSource.open(bench.work / "sparse/0", need_images=False)
    after = open_source(bench.work / "ns", need_images=False)
    assert after.camera_height == pytest.approx(scale * before.camera_height, rel=0.01)
    assert len(after.picture_names) == len(before.picture_names)


def test_nerfstudio_keeps_metres(bench):
    bench.sparse()
    bench.program("ns-process-data", f"mkdir -p {bench.work}/ns && touch {bench.work}/ns/transforms.json")
    bench.program("ns-train", "")
    said = bench.run("nerfstudio.sh", bench.work, bench.work / "ns", "--", *OPTIONS)
    (processed,) = bench.calls("ns-process-data")
    assert f"--skip-colmap --colmap-model-path {bench.work}/sparse_metric" in processed
    assert "--auto-scale-poses False" in said and not bench.calls("ns-train")
    bench.run("nerfstudio.sh", bench.work, bench.work / "ns", "nerfacto", "--", *OPTIONS)
    assert len(bench.calls("ns-process-data")) == 1
    (trained,) = bench.calls("ns-train")
    assert trained.startswith("ns-train nerfacto ") and trained.endswith(
        "nerfstudio-data --auto-scale-poses False --orientation-method none --center-method none"
    )


def test_the_first_of_several_models_in_a_folder_with_spaces(bench):
    bench.work = bench.work.rename(bench.work.parent / "my own work")
    bench.sparse("0")
    bench.sparse("1")
    bench.program("ns-process-data", "")
    bench.run("nerfstudio.sh", bench.work, bench.work / "ns", "--", *OPTIONS)
    (processed,) = bench.calls("ns-process-data")
    assert processed.endswith(f"--colmap-model-path {bench.work}/sparse_metric/0")
    bench.run("gsplat.sh", bench.work, bench.work / "gs", "--", *OPTIONS)
    assert (bench.work / "gs/data/sparse/0/sim3.json").is_file() and (bench.work / "gs/data/images").is_dir()


def test_gsplat_keeps_metres(bench):
    bench.sparse()
    assert "--no-normalize-world-space" in bench.run("gsplat.sh", bench.work, bench.work / "gs", "--", *OPTIONS)
    assert (bench.work / "gs/data/sparse/0/sim3.json").is_file() and (bench.work / "gs/data/images").is_dir()
    trainer = bench.work / "gsplat/examples/simple_trainer.py"
    trainer.parent.mkdir(parents=True)
    trainer.write_text("import sys; print(sys.argv[1:])")
    said = bench.run("gsplat.sh", bench.work, bench.work / "gs", GSPLAT=str(bench.work / "gsplat"))
    assert "'--no-normalize-world-space'" in said


@pytest.fixture
def hooks(monkeypatch):
    monkeypatch.syspath_prepend(str(HOOKS))
    importlib.invalidate_caches()
    yield importlib.import_module("pycolmap_hook"), importlib.import_module("hloc_hook")
    for name in ("pycolmap_hook", "hloc_hook"):
        sys.modules.pop(name, None)


def test_pycolmap_on_disk_and_in_memory(bench, hooks):
    bench.sparse()
    options = {"fleet": "US", "detections": FOUND, "mode": "planar"}
    assert hooks[0].write_metric(bench.work / "sparse", bench.work / "metric", **options)
    before = bench.stamps()
    assert not hooks[0].write_metric(bench.work / "sparse", bench.work / "metric", **options)
    assert bench.stamps() == before
    model = pycolmap.Reconstruction(str(EXAMPLE / "sparse"))
    old = model.image(1).projection_center()
    result = hooks[0].to_metric(model, **options)
    written = pycolmap.Reconstruction(str(bench.work / "metric"))
    assert np.allclose(model.image(1).projection_center(), result.scale.value * old)
    assert np.allclose(model.image(1).projection_center(), written.image(1).projection_center(), rtol=1e-6)


def test_hloc(bench, hooks, monkeypatch):
    """hloc's reconstruction stands in by a copy; it runs once."""
    (bench.work / "hloc").mkdir()
    (bench.work / "hloc/__init__.py").touch()
    copy = f"shutil.copytree({str(EXAMPLE / 'sparse')!r}, sfm_dir)"
    (bench.work / "hloc/reconstruction.py").write_text(
        f"import shutil\ndef main(sfm_dir, image_dir, pairs):\n    {copy}\n"
    )
    monkeypatch.syspath_prepend(str(bench.work))
    bench.frames()
    options = {"fleet": "US", "detections": FOUND}
    metric = hooks[1].main(bench.work / "sfm", bench.work / "images", Path("pairs.txt"), **options)
    before = bench.stamps()
    again = hooks[1].main(bench.work / "sfm", bench.work / "images", Path("pairs.txt"), **options)
    assert bench.stamps() == before
    assert np.allclose(metric.image(1).projection_center(), again.image(1).projection_center())
    assert (bench.work / "sfm_metric/sim3.json").is_file()
    later(bench.work / "sfm/images.bin")
    with pytest.raises(hooks[0].UsageError, match="was changed after"):
        hooks[1].main(bench.work / "sfm", bench.work / "images", Path("pairs.txt"), **options)


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_a_kill_leaves_nothing(bench, how):
    """Killed while it writes: the stand-in for a slow disk stops in the middle of the model."""
    bench.sparse()
    slow = bench.work / "slow.py"
    slow.write_text(
        "import pathlib, sys, time, pycolmap\n"
        "there = sys.argv.pop()\n"
        "def stuck(model, folder):\n"
        "    (pathlib.Path(folder) / 'points3D.bin').write_bytes(b'half')\n"
        "    pathlib.Path(there).touch()\n"
        "    time.sleep(60)\n"
        "pycolmap.Reconstruction.write_binary = stuck\n"
        "from orthoscale.cli import main\n"
        "main()\n"
    )
    there = bench.work / "there"
    command = [sys.executable, slow, "fix", bench.work / "sparse/0", "--out", bench.work / "out", *OPTIONS, there]
    # A shell's background jobs, this test among them, start with Ctrl-C ignored, and hand that on.
    listening = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    pipes = {"stderr": subprocess.PIPE, "env": bench.environment}
    with subprocess.Popen(list(map(str, command)), **pipes, **listening) as process:
        for _ in range(600):
            if there.exists():
                break
            time.sleep(0.1)
        process.send_signal(how)
        assert b"nothing was written" in process.communicate()[1]
    assert process.returncode == 128 + how
    assert sorted(p.name for p in bench.work.iterdir()) == ["images", "slow.py", "sparse", "there"]


def test_odm(bench):
    """ODM's reconstruction stands in by the example in OpenSfM's words."""
    model = pycolmap.Reconstruction(str(EXAMPLE / "sparse"))
    (camera,) = model.cameras.values()
    side = max(camera.width, camera.height)
    lens = {"projection_type": "simple_radial", "width": camera.width, "height": camera.height}
    lens |= {"focal_x": camera.params[0] / side, "focal_y": camera.params[0] / side, "c_x": 0.0, "c_y": 0.0}
    lens["k1"] = float(camera.params[3]) if len(camera.params) > 3 else 0.0
    shots = {
        image.name: {
            "camera": "c",
            "rotation": Rotation.from_matrix(image.cam_from_world().rotation.matrix()).as_rotvec().tolist(),
            "translation": image.cam_from_world().translation.tolist(),
        }
        for image in model.images.values()
    }
    points = {str(k): {"coordinates": p.xyz.tolist(), "color": [1, 2, 3]} for k, p in model.points3D.items()}
    (bench.work / "opensfm").mkdir()
    text = json.dumps([{"cameras": {"c": lens}, "shots": shots, "points": points}])
    (bench.work / "opensfm/reconstruction.json").write_text(text)
    mesh = bench.work / "odm_texturing/odm_textured_model_geo.obj"
    mesh.parent.mkdir()
    mesh.write_text("v 1 0 0\n")
    bench.frames()
    bench.run("odm.sh", bench.work, *OPTIONS, "--dry-run")
    assert not list(bench.work.glob("*_metric"))
    bench.run("odm.sh", bench.work, *OPTIONS)
    scale = json.loads((bench.work / "opensfm_metric/sim3.json").read_text())["scale"]
    truth = json.loads((EXAMPLE / "truth.json").read_text())["metres_per_model_unit"]
    assert scale == pytest.approx(truth, rel=0.08)
    assert (bench.work / "odm_metric/odm_textured_model_geo.obj").read_text().split()[-3] == f"{scale:.10g}"
    before = bench.stamps()
    assert "nothing to do" in bench.run("odm.sh", bench.work, *OPTIONS)
    assert bench.stamps() == before
    later(bench.work / "opensfm/reconstruction.json")
    command = [HOOKS / "odm.sh", bench.work, *OPTIONS]
    done = subprocess.run(command, env=bench.environment, capture_output=True, text=True)
    assert done.returncode == 2 and "was changed after" in done.stderr
