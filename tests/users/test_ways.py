"""The way of each user through the documentation: the commands that its page shows, run as they stand there.

Each page of docs/howto names files of its reader (``sparse/0``, ``ortho.tif``); here they are made of the examples.
ODM, nerfstudio and COLMAP are in test_hooks, QGIS in test_qgis, a cluster in test_many.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import rasterio
import shapely

from orthoscale.formats.vector import write_layer

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TOWN, SHEFFIELD = ROOT / "examples/town/ortho.jpg", ROOT / "examples/sheffield"
COMMAND = re.compile(r"^((?:colmap_hooks/\w+\.sh|orthoscale) .*)$", re.MULTILINE)

pytestmark = pytest.mark.slow


@pytest.fixture
def desk(tmp_path):
    """A folder with the program on PATH, where commands of a page are run."""
    program = tmp_path / "bin" / "orthoscale"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m orthoscale "$@"\n')
    program.chmod(0o755)
    place = tmp_path / "desk"
    place.mkdir()
    (place / "examples").symlink_to(ROOT / "examples")
    (place / "colmap_hooks").symlink_to(ROOT / "colmap_hooks")
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}", "PYTHONPATH": path}

    def run(command: str, code: int = 0) -> str:
        done = subprocess.run(command, shell=True, cwd=place, env=environment, capture_output=True, text=True)
        assert done.returncode == code, f"{command}\n{done.stdout}{done.stderr}"
        return done.stdout

    run.place = place
    return run


def commands(page: str) -> list[str]:
    """Those in the fenced blocks of a page, continued lines joined."""
    blocks = re.findall(
        r"^```(?:sh)?\n(.*?)^```", (DOCS / page).read_text().replace("\\\n", ""), re.MULTILINE | re.DOTALL
    )
    return [re.sub(r"\s+#.*", "", line) for block in blocks for line in COMMAND.findall(block)]


def test_the_tour(desk):
    """A newcomer types every command of the tour; what it prints is, nearly, what the page shows."""
    shown = (DOCS / "index.md").read_text()
    said = [desk(command) for command in commands("index.md")]
    assert len(said) == 5
    figures = re.compile(r"^scale +([\d.]+) m/px .*90 % within (?:\+-|\S+ to \+)([\d.]+) %", re.MULTILINE)
    told, printed = (tuple(map(float, figures.search(text).groups())) for text in (shown, said[0]))
    assert printed[0] == pytest.approx(told[0], rel=0.02) and printed[1] == pytest.approx(told[1], abs=1.5)
    with rasterio.open(desk.place / "scaled.tif") as raster:
        assert raster.transform.a == pytest.approx(0.085, rel=0.07) and raster.crs is not None
    assert (desk.place / "scaled.tif.html").is_file() and (desk.place / "metric/sim3.json").is_file()


def test_a_photogrammetrist(desk):
    """The COLMAP page: a model in metres, and a mesh made from it. The frames are at hand as boxes in a file."""
    place = desk.place
    shutil.copytree(SHEFFIELD / "sparse", place / "sparse/0")
    (place / "mesh.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        b"end_header\n1 2 3\n"
    )
    (fix,) = commands("howto/colmap.md")
    desk(f"{fix.replace(' --images images/', '')} --detections {SHEFFIELD}/detections.json")
    desk("mkdir metric && orthoscale apply sparse_metric/sim3.json mesh.ply --out metric/again")
    scale = json.loads((place / "sparse_metric/sim3.json").read_text())["scale"]
    assert scale == pytest.approx(14.157, rel=0.08)
    point = (place / "metric/again/mesh.ply").read_text().split("end_header\n")[1].split()
    assert [float(v) for v in point] == pytest.approx([scale, 2 * scale, 3 * scale], rel=1e-5)


def test_a_planner(desk):
    """The planning page: a lot in the scaled orthophoto, a court in it, at its true size."""
    place = desk.place
    fix, layout = commands("howto/planner.md")
    desk(fix.replace("ortho.tif", str(TOWN)))
    with rasterio.open(place / "scaled.tif") as raster:
        drawn = shapely.box(*raster.bounds)
        write_layer(place / "lot.gpkg", "lot", [drawn], [{"name": "lot"}], "Polygon", raster.crs)
    desk(layout)
    text = json.loads((place / "layout/layout.json").read_text())
    assert "basketball" in json.dumps(text) and (place / "layout/layout.dxf").is_file()


def test_a_gis_analyst(desk):
    """The pages on GIS and on many inputs: an archive with a right claim, a wrong one and a broken file."""
    archive = desk.place / "archive"
    archive.mkdir()
    desk(f"orthoscale fix {TOWN} --out archive/right.tif --fleet DE --report none")
    with rasterio.open(archive / "right.tif") as right:
        about, pixels = right.profile, right.read()
    wrong = about["transform"] * rasterio.Affine.scale(2)
    with rasterio.open(archive / "wrong.tif", "w", **{**about, "transform": wrong}) as file:
        file.write(pixels)
    (archive / "broken.tif").write_bytes(b"II*\0")
    check = next(each for each in commands("howto/many.md") if " check " in each)
    desk(f"{check} --fleet DE", code=5)
    rows = {Path(line.split(",")[0]).name: line for line in (desk.place / "claims.csv").read_text().splitlines()[1:]}
    assert ",agrees (orthoscale gave it)," in rows["right.tif"] and ",disagrees," in rows["wrong.tif"]
    assert rows["broken.tif"].split(",")[1] == "5"


def test_a_developer(desk):
    """The page on developing: its Python, on files of those names; the schema holds for the report."""
    import jsonschema

    place = desk.place
    shutil.copy(TOWN, place / "ortho.tif")
    shutil.copytree(SHEFFIELD / "sparse", place / "model/sparse")
    blocks = re.findall(r"^```python\n(.*?)^```", (DOCS / "howto/developer.md").read_text(), re.MULTILINE | re.DOTALL)
    (place / "page.py").write_text("\n".join(blocks) + "\nimport json\nprint(json.dumps(report))\n")
    code = (
        (place / "page.py")
        .read_text()
        .replace('"metric/", fleet', f'"metric/", detections="{SHEFFIELD}/detections.json", fleet')
    )
    (place / "page.py").write_text(code)
    schema = json.loads(desk("orthoscale report --schema"))
    jsonschema.validate(json.loads(desk(f"{shlex.quote(sys.executable)} page.py")), schema)
    jsonschema.validate(json.loads((place / "metric/report.json").read_text()), schema)
