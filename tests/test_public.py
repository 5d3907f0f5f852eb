"""The library's own doors: what a notebook or a script sees."""

import json
import subprocess
import sys

import numpy as np
import pytest
from reports import car_park, fixed

import orthoscale


@pytest.fixture(scope="module")
def park(tmp_path_factory):
    folder = tmp_path_factory.mktemp("park")
    car_park(folder)
    return folder


@pytest.fixture(scope="module")
def result(park):
    return orthoscale.estimate(park / "park.png", fleet="DE", detections=park / "detections.json")


def test_public_names_are_there_and_cost_nothing_until_used():
    """Also after the modules beside them were imported, whose names must not hide theirs."""
    code = (
        "import sys, orthoscale; heavy = {'numpy', 'cv2', 'scipy', 'rasterio'} & set(sys.modules); "
        "import orthoscale.photos.survey, orthoscale.actions.check, orthoscale.cli.main; "
        "print(sorted(heavy), [n for n in orthoscale.__all__ if not callable(getattr(orthoscale, n))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[] ['__version__']", done.stderr


def test_a_result_prints_in_under_ten_lines_the_answer_first(result):
    lines = str(result).splitlines()
    assert len(lines) < 10 and lines[0].startswith(
        f"scale      {result.scale.value:.4f} m/px ({100 * result.scale.value:.2f} cm)"
    )
    assert repr(result) == str(result) and "DE (" in str(result)
    html = result._repr_html_()
    assert html.startswith("<table>") and "<th>scale</th>" in html


def test_the_vehicles_are_a_table(result):
    table = result.vehicles
    assert len(table) == 61 and table["used"].sum() == result.scale.vehicles_used
    assert table["reason"][60] == "too large for a car" and table["picture"][0] == "park.png"
    assert np.allclose(table["length"], table["length_unit"] * result.scale.value)
    assert (table["box_length_px"] > table["length_unit"]).all(), "the margin is the box's"


def test_a_result_as_plain_values_is_the_report(park, result):
    fixed(park)
    written = json.loads((park / "scaled.tif.json").read_text())
    told = json.loads(json.dumps(result.to_dict()))
    assert told["vehicles"] == written["vehicles"] and told["scale"] == written["scale"]


def test_check_is_public(park):
    (park / "park.pgw").write_text("0.2\n0\n0\n-0.2\n0\n0\n")
    checked = orthoscale.check(park / "park.png", fleet="DE", detections=park / "detections.json")
    assert checked.disagrees and checked.comparisons[0].claimed == pytest.approx(0.2)
    (park / "park.pgw").unlink()


def test_what_is_done_is_told_to_the_logger_and_on_demand_to_the_terminal(park, caplog):
    with caplog.at_level("INFO", "orthoscale"):
        orthoscale.estimate(park / "park.png", fleet="DE", detections=park / "detections.json")
    assert "61 boxes" in caplog.text
    words = ["estimate", str(park / "park.png"), "--fleet", "DE", "--detections", str(park / "detections.json")]
    said = [
        subprocess.run([sys.executable, "-m", "orthoscale", *how, *words], capture_output=True, text=True).stderr
        for how in ([], ["-v"], ["-q"])
    ]
    assert "61 boxes" not in said[0] and "61 boxes" in said[1] and said[2] == ""
