"""The plugin in QGIS itself, without a window; skipped where QGIS is not installed (apt-get install qgis)."""

from __future__ import annotations

import ast
import importlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import rasterio

from orthoscale.formats.detections import check_name
from orthoscale.sources.raster import RasterSource

ROOT = Path(__file__).parent.parent
PLUGIN = ROOT / "qgis" / "orthoscale_qgis"
# Debian's wrapper puts an option first that qgis_process does not know.
PROCESS = shutil.which("qgis_process.bin") or shutil.which("qgis_process")
SYSTEM_PYTHON = "/usr/bin/python3"  # which has QGIS's bindings
needs_qgis = pytest.mark.skipif(PROCESS is None, reason="QGIS is not installed")


@pytest.fixture(scope="module")
def qgis(tmp_path_factory):
    """A function that runs an algorithm and gives its results, or what it complained of."""
    folder = tmp_path_factory.mktemp("qgis")
    folder.chmod(0o700)
    program = folder / "orthoscale"
    program.write_text(f'#!/bin/sh\nexec env PYTHONPATH={ROOT} {sys.executable} -m orthoscale "$@"\n')
    program.chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{folder}:{os.environ['PATH']}",
        "QGIS_CUSTOM_CONFIG_PATH": str(folder),
        "QGIS_PLUGINPATH": str(PLUGIN.parent),
        "QT_QPA_PLATFORM": "offscreen",
        "XDG_RUNTIME_DIR": str(folder),
        "LC_ALL": "C.UTF-8",
    }
    environment.pop("PYTHONPATH", None)

    def call(*words):
        return subprocess.run(list(map(str, words)), env=environment, capture_output=True, text=True)

    assert call(PROCESS, "plugins", "enable", PLUGIN.name).returncode == 0

    def run(algorithm, **parameters):
        words = [f"{name}={value}" for name, value in parameters.items()]
        done = call(PROCESS, "run", f"orthoscale:{algorithm}", "--", *words)
        if "Results" not in done.stdout:
            return done.stdout + done.stderr
        lines = done.stdout.split("Results\n----------------\n")[1].splitlines()
        return dict(line.split(":\t", 1) for line in lines if ":\t" in line)

    run.call, run.folder = call, folder
    return run


@needs_qgis
@pytest.mark.slow
def test_an_orthophoto_is_scaled_shown_and_built_upon(qgis, tmp_path):
    out = tmp_path / "scaled.tif"
    done = qgis("fix", INPUT=ROOT / "examples/town/ortho.jpg", FLEET="DE", OUTPUT=out)
    truth = json.loads((ROOT / "examples/town/truth.json").read_text())["gsd_m"]
    assert float(done["LOW90"]) < truth < float(done["HIGH90"]), done
    assert Path(done["REPORT"]).is_file() and done["VEHICLES"] == f"{out}.gpkg"

    picture = tmp_path / "picture.png"
    shown = qgis.call(SYSTEM_PYTHON, ROOT / "docs/make_qgis_picture.py", out, picture)
    assert shown.returncode == 0, shown.stderr
    told = json.loads(shown.stdout)
    assert told["raster"] and told["inside"] and told["style"] == "categorizedSymbol"
    assert told["units_per_pixel"] == pytest.approx(float(done["SCALE"]))
    with rasterio.open(picture) as image:  # outlines of used vehicles
        red, green, blue = image.read().astype(int)[:3]
        assert ((red < 12) & (abs(green - 214) < 12) & (blue > 243)).sum() > 500

    with rasterio.open(out) as raster:
        left, bottom, right, top = raster.bounds
    corners = [(left, bottom), (right, bottom), (right, top), (left, top), (left, bottom)]
    geometry = {"type": "Polygon", "coordinates": [corners]}
    lot = {"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, "geometry": geometry}]}
    (tmp_path / "lot.geojson").write_text(json.dumps(lot))
    place = {"INPUT": out, "LOT": tmp_path / "lot.geojson", "OUTPUT": tmp_path / "layout"}
    place["FACILITIES"] = "basketball football:2"  # there is no room for two pitches, which is a warning
    placed = qgis("layout", **place)
    assert "layername=facilities" in placed["AREAS"], placed
    facilities = json.loads((tmp_path / "layout/layout.json").read_text())
    assert "basketball" in json.dumps(facilities) and "football" in json.dumps(facilities["missing"])
    place["FACILITIES"] = "football:9"
    place["LOT"].write_text((tmp_path / "lot.geojson").read_text().replace(str(corners[2][0]), str(corners[0][0] + 9)))
    assert "Nothing fits on the lot" in qgis("layout", **place)


@needs_qgis
@pytest.mark.slow
def test_what_the_program_complains_of_is_said_in_qgis(qgis):
    said = qgis("check", INPUT=ROOT / "examples/town/ortho.jpg")
    assert "claims no scale" in said
    (qgis.folder / "orthoscale").rename(qgis.folder / "elsewhere")
    try:
        assert "is not there. Install it" in qgis("check", INPUT=ROOT / "examples/town/ortho.jpg")
    finally:
        (qgis.folder / "elsewhere").rename(qgis.folder / "orthoscale")


@pytest.mark.slow
def test_the_plugin_is_packed_whole(tmp_path):
    made = subprocess.run(["make", "qgis", f"PYTHON={sys.executable}"], cwd=ROOT, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    names = zipfile.ZipFile(ROOT / "build/orthoscale_qgis.zip").namelist()
    for needed in ("metadata.txt", "__init__.py", "provider.py", "fix.py", "check.py", "layout.py", "vehicles.py"):
        assert f"orthoscale_qgis/{needed}" in names


@pytest.fixture
def plugin(monkeypatch):
    """A function that imports a module of the plugin where QGIS is not installed: its classes are stood in for."""
    anything = type("Anything", (Exception,), {"__init__": lambda self, *_, **__: None})
    core = ModuleType("qgis.core")
    core.__getattr__ = lambda name: anything
    core.QgsProcessingException = type("QgsProcessingException", (Exception,), {})
    config = ModuleType("processing.core.ProcessingConfig")
    config.ProcessingConfig = type("ProcessingConfig", (), {"getSetting": staticmethod(lambda name: "")})
    config.Setting = type("Setting", (), {})
    package = ModuleType("orthoscale_qgis")
    package.__path__ = [str(PLUGIN)]
    stands_in = {"qgis.core": core, "processing.core.ProcessingConfig": config, "orthoscale_qgis": package}
    for name in ("qgis", "processing", "processing.core"):
        stands_in[name] = ModuleType(name)
    for name, module in stands_in.items():
        monkeypatch.setitem(sys.modules, name, module)

    def forget():
        for name in [name for name in sys.modules if name.startswith("orthoscale_qgis.")]:
            sys.modules.pop(name)

    forget()
    yield lambda name: importlib.import_module(f"orthoscale_qgis.{name}")
    forget()


def test_a_scale_that_contradicts_itself_judges_no_claim(plugin, monkeypatch):
    """The program's report has no comparison then, and ends as one that disagrees."""
    check = plugin("check")
    said = [{"severity": "refusal", "text": "vehicles and bays differ by 6 sigma"}, {"severity": "info", "text": "x"}]
    monkeypatch.setattr(check, "run", lambda *_: {"comparisons": [], "remarks": said})
    algorithm = check.Check()
    monkeypatch.setattr(check.Check, "input_words", lambda *_: ["a.tif"])
    with pytest.raises(sys.modules["qgis.core"].QgsProcessingException, match="cannot be judged.\nvehicles and bays"):
        algorithm.processAlgorithm({}, None, None)


@pytest.mark.parametrize(("module", "algorithm"), [("fix", "Fix"), ("layout", "Layout")])
@pytest.mark.parametrize("source", [None, "type=xyz&url=https://tiles.example/{z}/{x}/{y}.png"])
def test_a_layer_that_is_no_file_is_refused_in_one_sentence(plugin, monkeypatch, module, algorithm, source):
    layer = None if source is None else SimpleNamespace(source=lambda: source)
    class_ = getattr(plugin(module), algorithm)
    for name, value in {"RasterLayer": layer, "String": "", "OutputLayer": "out.tif"}.items():
        monkeypatch.setattr(class_, f"parameterAs{name}", lambda *_, value=value: value, raising=False)
    monkeypatch.setattr(class_, "invalidRasterError", lambda *_: "no such raster", raising=False)
    with pytest.raises(sys.modules["qgis.core"].QgsProcessingException, match="no such raster|is no file: export"):
        class_().processAlgorithm({}, None, None)


@pytest.mark.parametrize("writes", [True, False])
@pytest.mark.parametrize("code", [3, 4])
def test_vehicles_that_give_no_scale_are_shown_all_the_same(plugin, monkeypatch, tmp_path, code, writes):
    out = tmp_path / "vehicles.gpkg"
    out.write_text("of an earlier run")
    program = tmp_path / "orthoscale"
    saving = f"echo boxes > {out}.new; mv {out}.new {out}" if writes else "true"
    program.write_text(f"#!/bin/sh\n{saving}\necho too few >&2\nexit {code}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    vehicles = plugin("vehicles")
    algorithm = vehicles.Vehicles()
    monkeypatch.setattr(vehicles.Vehicles, "input_words", lambda *_: ["a.tif"])
    monkeypatch.setattr(vehicles.Vehicles, "parameterAsOutputLayer", lambda *_: str(out), raising=False)
    warned = []
    feedback = SimpleNamespace(
        pushCommandInfo=lambda text: None, pushInfo=lambda text: None, pushWarning=warned.append, isCanceled=lambda: 0
    )
    if writes:
        assert algorithm.processAlgorithm({}, None, feedback) == {"OUTPUT": str(out)} and warned == ["too few"]
    else:
        with pytest.raises(sys.modules["qgis.core"].QgsProcessingException, match="too few"):
            algorithm.processAlgorithm({}, None, feedback)


def test_qgis_offers_only_files_that_the_program_writes(plugin):
    """Its default may be another, such as a shapefile; an algorithm is not asked for them, only the provider."""
    provider = plugin("provider").Provider()
    for ending in provider.supportedOutputRasterLayerExtensions():
        RasterSource.check_name(Path(f"out.{ending}"))
    for ending in provider.supportedOutputVectorLayerExtensions():
        check_name(Path(f"out.{ending}"))
    assert not any("def supportedOutput" in path.read_text() for path in PLUGIN.glob("*.py") if path.stem != "provider")


def test_options_that_the_plugin_passes_exist():
    import click

    from orthoscale.cli.main import COMMANDS, cli

    known = {
        each
        for name in COMMANDS
        for option in cli.get_command(click.Context(cli), name).params
        for each in (*option.opts, *option.secondary_opts)
    }
    passed = {
        node.value: path.name
        for path in PLUGIN.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith("--")
    }
    assert {"--out", "--fleet", "--json"} <= passed.keys() and not passed.keys() - known, passed
