"""What a report says of its uncertainty, in words and in numbers."""

import json
import re

import numpy as np
import pytest
from support.in_process import run
from test_json import REPORT as WHOLE

from orthoscale.core.control import READING_SD, known_distance
from orthoscale.report.explanation import explain, in_words

REPORT = {
    "scale": 0.1, "unit": "m/px", "vehicles_used": 20, "fleet": "WORLD", "verdict": "poor",
    "remarks": [{"severity": "caution", "text": "a remark"}],
    "uncertainty": {"sampling": 0.03, "fleet": 0.06, "margin": 0.02, "geometry": 0.0},
}  # fmt: skip


def test_parts_are_shares_of_the_variance_largest_first():
    found = explain(REPORT)
    assert found["relative_sd"] == pytest.approx(0.07)
    assert [p["name"] for p in found["parts"]] == ["fleet", "sampling", "margin"]
    assert sum(p["share"] for p in found["parts"]) == pytest.approx(1)


def test_remedies_leave_what_they_do_not_remove_the_best_first():
    """Of 0.0049 the country takes away three quarters of 0.0036, four times the vehicles three quarters of 0.0009."""
    found = explain(REPORT)["remedies"]
    assert [one["do"].split()[0] for one in found] == ["name", "measure", "use"]
    assert [one["leaves"] for one in found] == pytest.approx(np.sqrt([0.0022, 0.004225, 0.0046]))
    few = explain({**REPORT, "fleet": "DE", "uncertainty": {"fleet": 0.05, "sampling": 0.01, "margin": 0.02}})
    assert [one["do"].split()[0] for one in few["remedies"]] == ["use"], "a thirtieth is not worth the trouble"


def test_what_is_known_to_a_centimetre_gets_no_advice_to_know_it_to_less():
    found = explain({**REPORT, "uncertainty": {"ground control": 3e-5}, "vehicles_used": 90, "fleet": "DE"})
    assert "no known distance would halve it" in found["halve"]
    assert "known to +- 0.003 % (1 sigma)" in "\n".join(in_words(found))


def test_the_distance_that_it_names_does_halve_it():
    found = explain({**REPORT, "unit": "m/model-unit"})
    assert "good to 4.0 %" in found["halve"] and "20 m known to 81 cm" in found["halve"]
    assert 1 / np.sqrt(1 / 0.07**2 + 1 / 0.0404**2) == pytest.approx(0.035, rel=1e-3)


@pytest.mark.parametrize("gsd, sd", [(0.05, 0.07), (0.3, 0.07), (0.3, 0.024), (0.1, 0.009)])
def test_the_distance_that_it_names_halves_it_where_it_is_read_in_a_picture(gsd, sd):
    """Reading 20 m in a picture of 0.3 m/px costs 1.1 %: of a scale known to 2.4 % they would leave more than half."""
    found = explain({**REPORT, "scale": gsd, "uncertainty": {"fleet": sd}})
    metres, known = map(float, re.search(r"([\d.]+) m known to (\d+) cm", found["halve"]).groups())
    ends = np.array([[0.0, 0.0], [metres / gsd, 0.0]])
    given = known_distance(ends, metres, known / 100, read_sd=np.sqrt(2) * READING_SD)
    assert 1 / np.sqrt(1 / sd**2 + 1 / given.relative_sd**2) == pytest.approx(sd / 2, rel=0.02)


def test_what_stands_below_is_spoken_of_only_where_something_does():
    found = explain({**REPORT, "fleet": "DE", "uncertainty": {"lane dashes": 0.03}})
    assert not found["remedies"] and "below" not in found["halve"]
    assert "nothing below would do so alone" in explain({**REPORT, "fleet": "DE"})["halve"]


def test_remedies_leave_what_they_say():
    found = {r["do"]: r["leaves"] for r in explain(REPORT)["remedies"]}
    assert found["measure four times as many vehicles (80 instead of 20)"] == pytest.approx(
        np.sqrt(0.0049 - 0.75 * 0.0009)
    )
    assert min(found, key=found.get) == "name the country (--fleet)"
    assert "name the country" not in "\n".join(in_words(explain({**REPORT, "fleet": "DE"})))


def test_a_conflict_comes_first():
    found = explain({**REPORT, "uncertainty": {"conflict": 0.2}})
    assert "which measurement is wrong" in found["halve"] and not found["remedies"]


def test_what_drifts_is_not_mended_by_a_known_distance():
    found = explain({**REPORT, "uncertainty": {"fleet": 0.03, "drift": 0.04}})
    assert "No known distance halves it" in found["halve"] and "straighten the input" not in found["halve"]
    little = explain({**REPORT, "uncertainty": {"fleet": 0.04, "drift": 0.01}})
    needed = float(little["halve"].split("good to ")[1].split(" %")[0]) / 100
    left = np.hypot(1 / np.sqrt(1 / 0.04**2 + 1 / needed**2), 0.01)
    assert left == pytest.approx(np.hypot(0.04, 0.01) / 2, rel=0.03)


def test_vehicles_of_one_size_leave_the_papers_estimator_nothing_to_explain():
    found = explain({**REPORT, "uncertainty": {"sampling": 0.0}})
    assert found["relative_sd"] == 0 and not found["parts"] and "all of one size" in "\n".join(in_words(found))


@pytest.mark.parametrize("report", [{}, [], {**WHOLE, "uncertainty": {}}, {**WHOLE, "uncertainty": {"fleet": "x"}},
                                    {**WHOLE, "scale": None}])  # fmt: skip
def test_what_is_no_report_is_refused(tmp_path, report):
    (tmp_path / "report.json").write_text(json.dumps(report))
    refused = run("explain", tmp_path / "report.json")
    assert refused.returncode == 5 and "report.json: not a report" in refused.stderr


def test_a_report_of_another_version_is_told_from_a_file_that_is_none(tmp_path):
    """Such as a table of photos, or a calibration, which are JSON too."""
    (tmp_path / "a.json").write_text(json.dumps({**WHOLE, "format": "orthoscale report 1"}))
    (tmp_path / "b.json").write_text(json.dumps({"photos": 3, "rows": []}))
    assert "another kind or version (format 'orthoscale report 1'" in run("explain", tmp_path / "a.json").stderr
    assert "b.json: not a report of a scale" in run("explain", tmp_path / "b.json").stderr


def test_the_command(tmp_path):
    path = tmp_path / "report.json"
    path.write_text(json.dumps(WHOLE | REPORT))
    shown = run("explain", path)
    assert shown.returncode == 0 and "73 %  fleet (6.0 %)" in shown.stdout and "a remark" in shown.stdout
    path.write_text("no json")
    refused = run("explain", path)
    assert refused.returncode == 5 and "report.json: not a report" in refused.stderr
    path.unlink()
    assert run("explain", path).returncode == 5
