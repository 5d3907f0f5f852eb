"""What benchmarks, examples, hooks and training take from the package is there: nobody runs them all after a change."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from rasterio import Affine

import orthoscale
from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNKNOWN_RULER, Detections

ROOT = Path(__file__).parent.parent
TOWN = ROOT / "examples" / "town"
SCRIPTS = [
    path for folder in ("benchmarks", "examples", "colmap_hooks", "training") for path in (ROOT / folder).rglob("*.py")
]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_name_that_a_script_takes_is_there(path):
    taken = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
    missing = []
    for node in taken:
        if node.level or not node.module or node.module.split(".")[0] not in ("orthoscale", "support"):
            continue
        home = importlib.import_module(node.module)
        missing += [
            f"{node.module}.{name.name}"
            for name in node.names
            if not hasattr(home, name.name) and importlib.util.find_spec(f"{node.module}.{name.name}") is None
        ]
    assert not missing


def test_the_scripts_are_found():
    assert len(SCRIPTS) > 40


def test_examples_stay_where_the_data_that_they_are_made_of_lack(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "path", [str(ROOT / "examples"), *sys.path])
    make_examples = importlib.import_module("make_examples")
    monkeypatch.setattr(make_examples, "HERE", tmp_path)
    (tmp_path / "sheffield").mkdir()
    (tmp_path / "sheffield" / "truth.json").touch()
    with pytest.raises((OSError, ValueError, RuntimeError)):
        make_examples.make_sheffield(tmp_path / "nowhere")
    assert (tmp_path / "sheffield" / "truth.json").is_file()


@pytest.fixture
def benchmark(monkeypatch, tmp_path):
    """A benchmark's module by its name; nothing is taken from or left in the user's cache."""
    monkeypatch.setattr(sys, "path", [str(ROOT / "benchmarks"), *sys.path])
    monkeypatch.setenv("ORTHOSCALE_CACHE", str(tmp_path / "cache"))
    return importlib.import_module


def test_a_scene_that_is_not_there_is_refused(benchmark, monkeypatch, tmp_path):
    places, fix_all = benchmark("places"), benchmark("fix_all")
    some = [places.Scene(Path(f"{name}.jpg"), "PH", 0.1) for name in ("manila", "banepa")]
    assert [scene.name for scene in places.called(some, "banepa")] == ["banepa"] and places.called(some, "") == some
    with pytest.raises(SystemExit, match="no such scene: atlantis; there are manila, banepa"):
        places.called(some, "manila,atlantis")
    monkeypatch.setattr(sys, "argv", ["fix_all.py", str(tmp_path), "atlantis"])
    with pytest.raises(SystemExit, match="no such scene: atlantis; there are examples/town, examples/sheffield"):
        fix_all.main()


def test_one_place_says_nothing_of_the_margin(benchmark, monkeypatch, capsys, tmp_path):
    places = benchmark("places")
    monkeypatch.setattr(places, "measured", lambda *_: (0.01, -0.02, 0.03, 0.01))
    (tmp_path / "manila.det.json").touch()
    places.main([places.Scene(Path("manila.jpg"), "PH", 0.1)], tmp_path)
    said = capsys.readouterr().out
    assert "| manila | PH | +1.0" in said and "left out" not in said


def test_what_boxes_know_of_themselves_counts_where_shapes_are_to_tell_the_country(
    benchmark, monkeypatch, capsys, tmp_path
):
    module, picture = benchmark("country_from_shapes"), tmp_path / "manila.jpg"
    picture.touch()
    sigma = np.tile([0.03, 0.05], (6, 1))
    boxes = Boxes(np.array([[60.0 * k, 60, 44, 18, 0.1] for k in range(6)]), np.ones(6), sigma)
    found = Detections({"manila.jpg": boxes}, 1.0, UNKNOWN_RULER, (0.8, 0.8), "drawn")
    orthoscale.save_detections(found, tmp_path / "manila.det.json")
    pooled = []
    scale = SimpleNamespace(fleets={"PH": 0.5}, value=0.1, interval90=(0.09, 0.11))
    monkeypatch.setattr(module, "scenes", lambda: [benchmark("places").Scene(picture, "PH", 0.1)])
    monkeypatch.setattr(module, "robust", SimpleNamespace(pool=lambda votes, *_: (pooled.append(votes), scale)[1]))
    module.main(tmp_path)
    assert {len(votes) for votes in pooled} == {6} and pooled[0].sigma == pytest.approx(sigma)
    assert capsys.readouterr().out.count("1 of 1") == len(module.SHARES)


def test_a_mosaic_of_a_raster_of_any_name(benchmark, tmp_path):
    one, four = tmp_path / "R&D <1>.tif", tmp_path / "four.vrt"
    shape = {"width": 8, "height": 6, "count": 3, "dtype": "uint8"}
    with rasterio.open(one, "w", "GTiff", transform=Affine.scale(1, -1), **shape) as out:
        out.write(np.arange(144, dtype=np.uint8).reshape(3, 6, 8))
    benchmark("memory").mosaic(one, 2, four)
    with rasterio.open(one) as part, rasterio.open(four) as whole:
        assert (whole.read() == np.tile(part.read(), (1, 2, 2))).all()


@pytest.mark.slow
def test_a_sweep_that_stops_early_is_compared_with_one_of_all_tiles(benchmark, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["anytime.py", str(TOWN / "ortho.jpg"), "--fleet", "DE", "--seeds", "2"])
    benchmark("anytime").main()
    said = capsys.readouterr().out
    # Four tiles are too few to stop before the last one, so that both sweeps must say the same.
    assert "4 tiles, 4 to 4" in said and "mean +0.000" in said


@pytest.mark.slow
def test_boxes_of_real_scenes_are_found_once_and_kept(benchmark, monkeypatch, capsys, tmp_path):
    real_scenes = benchmark("real_scenes")
    monkeypatch.setattr(real_scenes, "DATA", TOWN)
    monkeypatch.setattr(real_scenes, "SCENES", {"ortho.jpg": "DE"})
    gsd = json.loads((TOWN / "truth.json").read_text())["gsd_m"]
    monkeypatch.setattr(real_scenes, "truth", lambda scene: gsd)
    real_scenes.main(tmp_path)
    assert (tmp_path / "ortho.jpg.det.json").is_file()
    assert capsys.readouterr().out.count("| ortho |") == 4  # two estimators, the world's fleet, the paper's
