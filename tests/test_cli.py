"""The command as a person or a script runs it: exit codes, one sentence per error, machine-readable output."""

import contextlib
import errno
import io
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import pytest
from support.in_process import run
from support.reports import car_park

from orthoscale.cli.main import COMMANDS, main
from orthoscale.core.claims import OF_A_COPY
from orthoscale.sources.cameras import SCALED_MARK
from orthoscale.sources.colmap import scale_model

EXAMPLE = Path(__file__).parent.parent / "examples" / "sheffield"
RULES = ["--detections", str(EXAMPLE / "detections.json"), "--fleet", "US", "--mode", "planar"]


def process(*arguments):
    """The program as it is started by a shell."""
    command = [sys.executable, "-m", "orthoscale", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(scope="module")
def estimated():
    return process("estimate", EXAMPLE / "sparse", *RULES, "--json")


@pytest.mark.slow
def test_json_is_the_report_and_nothing_else(estimated):
    assert estimated.returncode == 0, estimated.stderr
    report = json.loads(estimated.stdout)
    assert report["unit"] == "m/model-unit" and report["fleet"] == "US"
    low, high = report["interval90"]
    assert low < report["scale"] < high
    assert isinstance(report["vehicles_used"], int) and report["verdict"] in ("good", "fair", "poor", "unusable")
    assert estimated.stderr == "", "no progress bars in a pipe"


@pytest.mark.slow
def test_a_person_reads_the_answer_first(estimated):
    shown = process("estimate", EXAMPLE / "sparse", *RULES)
    assert shown.returncode == 0
    first = shown.stdout.splitlines()[0]
    assert first.startswith("scale") and f"{json.loads(estimated.stdout)['scale']:.3g}" in first


@pytest.mark.slow
def test_fix_writes_a_model_that_a_second_run_leaves_alone(tmp_path):
    done = process("fix", EXAMPLE / "sparse", *RULES, "--out", tmp_path / "scaled")
    assert done.returncode == 0, done.stderr
    assert {"cameras.bin", "images.bin", "points3D.bin", "sim3.txt", "report.json", "vehicles.png"} <= {
        p.name for p in (tmp_path / "scaled").iterdir()
    }
    again = process("fix", tmp_path / "scaled", *RULES, "--out", tmp_path / "twice")
    assert again.returncode == 2 and "in metres already" in again.stderr
    assert not (tmp_path / "twice").exists()


@pytest.mark.slow
def test_lengths_and_widths_that_contradict_each_other_are_exit_code_4(tmp_path):
    found = json.loads((EXAMPLE / "detections.json").read_text())
    for boxes in found["pictures"].values():
        for box in boxes:
            box["length"] *= 1.45  # longer than any car of that width
    (tmp_path / "stretched.json").write_text(json.dumps(found))
    job = ["fix", EXAMPLE / "sparse", "--detections", tmp_path / "stretched.json", "--out", tmp_path / "out"]
    # By default planar and oblique contradict each other as well, and that is said first.
    job += ["--fleet", "US", "--mode", "oblique"]
    done = run(*job)
    assert done.returncode == 4 and "widths give a larger scale than lengths" in done.stderr
    assert not (tmp_path / "out").exists()
    assert run(*job, "--force").returncode == 0 and (tmp_path / "out" / "sim3.txt").exists()


def grey(path, size=(300, 200)):
    cv2.imwrite(str(path), np.full((*size[::-1], 3), 120, np.uint8))
    return path


def truncated_tiff(folder):
    path = grey(folder / "ortho.tif")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def text_file(folder):
    path = folder / "notes.txt"
    path.write_text("no picture at all\n" * 20)
    return path


def empty_file(folder):
    path = folder / "empty.tif"
    path.touch()
    return path


def copy_of_example(folder):
    model = folder / "model"
    model.mkdir()
    for part in (EXAMPLE / "sparse").iterdir():
        (model / part.name).write_bytes(part.read_bytes())
    return model


def model_with_nan(folder):
    model = copy_of_example(folder)
    points = bytearray((model / "points3D.bin").read_bytes())
    points[16:24] = np.array([np.nan]).tobytes()  # x of the first point, behind the count and its id
    (model / "points3D.bin").write_bytes(points)
    return model


def truncated_model(folder):
    model = copy_of_example(folder)
    images = (model / "images.bin").read_bytes()
    (model / "images.bin").write_bytes(images[: len(images) // 2])
    return model


def empty_folder(folder):
    (folder / "nothing").mkdir()
    return folder / "nothing"


@pytest.mark.parametrize(
    "make, exit_code, word",
    [
        (lambda folder: folder / "nowhere", 5, "does not exist"),
        (text_file, 5, "notes.txt"),
        (empty_file, 5, "empty"),
        (truncated_tiff, 5, "ortho.tif"),
        (empty_folder, 5, "nothing"),
        (copy_of_example, 5, "no frame"),
        (model_with_nan, 5, "points3D.bin"),
        (truncated_model, 5, "images.bin"),
        (lambda folder: grey(folder / "flat.png"), 3, "no vehicles"),
    ],
)
def test_bad_input_ends_in_one_sentence_the_right_code_and_nothing_written(tmp_path, make, exit_code, word):
    source = make(tmp_path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    out = tmp_path / ("scaled.tif" if source.suffix else "scaled")
    done = run("fix", source, "--out", out)
    assert done.returncode == exit_code, done.stderr
    assert done.stderr.startswith("error: ") and word in done.stderr
    assert "Traceback" not in done.stderr and done.stdout == ""
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize(
    "arguments, word",
    [
        (["fix", "x.tif"], "--out"),
        (["estimate"], "INPUT"),
        (["estimate", "x.tif", "--fleet", "atlantis"], "`orthoscale fleets` lists them"),
        (["estimate", "x.tif", "--zoom", "-1"], "positive"),
        (["estimate", "x.tif", "--zoom", "1", "--gsd-hint", "0.1"], "twice"),
        (["measure"], "measure"),
        (["estimate", "-v", "x.tif"], "It goes before the command: orthoscale -v COMMAND"),
    ],
)
def test_usage_errors_are_exit_code_2(tmp_path, monkeypatch, arguments, word):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert done.returncode == 2 and word in done.stderr and "Traceback" not in done.stderr


@pytest.mark.slow
def test_debug_shows_the_traceback_as_well(tmp_path):
    done = process("estimate", tmp_path / "nowhere", "--debug")
    assert done.returncode == 5 and "Traceback" in done.stderr and "does not exist" in done.stderr


def test_a_current_folder_that_is_gone_is_said(tmp_path, monkeypatch):
    """It was "the output: writing failed (No such file or directory)", of a command that writes nothing."""
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    done = run("estimate", "park.png")
    monkeypatch.chdir(tmp_path)  # pytest needs one
    assert done.returncode == 5 and "The current folder has been removed: enter one that exists" in done.stderr


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_has_examples_and_exit_codes(command):
    """Those that the command can end with: `apply` measures nothing, and only `fix` has --force."""
    shown = run(*command.split(), "--help").stdout
    assert "orthoscale estimate" in shown or f"  orthoscale {command} " in shown
    codes = shown[shown.index("  Exit codes: ") :]
    assert all(f"{code} " in codes for code in (0, 2, 5, 6)) and all(len(line) <= 80 for line in codes.splitlines())
    assert ("--force" in codes) == (command in ("", "fix"))
    assert ("3 " in codes) == (command not in ("apply", "explain", "report"))


def test_fleets_are_listed():
    rows = json.loads(run("fleets", "--json").stdout)
    assert [row["code"] for row in rows] == sorted(row["code"] for row in rows), "a code is found without a search"
    assert {"US", "DE", "JP", "WORLD"} <= {row["code"] for row in rows}
    japan = next(row for row in rows if row["code"] == "JP")
    assert [c["class"][:3] for c in japan["classes"]] == ["kei", "sma", "ord"] and japan["shares_source"]
    short, full = run("fleets").stdout, run("fleets", "JP").stdout
    assert "SUV" in short and "one class: unknown" in short
    assert "kei" in full and "shares: counted" in full
    assert run("fleets", "atlantis").returncode == 2


def test_a_fleet_of_no_year_is_listed_without_one(tmp_path):
    """A register tells none."""
    (tmp_path / "register.csv").write_text("make,model,count\nFord,F-150,3000\n")
    made = run("fleets", "--registrations", tmp_path / "register.csv", "--out", tmp_path / "district.json")
    assert made.returncode == 0, made.stderr
    assert run("fleets", tmp_path / "district.json").stdout.startswith("district: vehicles of register.csv\n")
    assert run("fleets", "JP").stdout.startswith("JP: Japan, passenger cars, 2022\n")


@pytest.mark.slow
def test_importing_costs_nothing():
    code = (
        "import sys, orthoscale; "
        "heavy = {'open3d', 'cv2', 'rasterio', 'pycolmap', 'onnxruntime', 'numpy', 'scipy'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


class Full(io.StringIO):
    """A stream on a disk without room."""

    error = errno.ENOSPC

    def write(self, text):
        raise OSError(self.error, os.strerror(self.error))


class Unread(Full):
    """A pipe that nobody reads."""

    error = errno.EPIPE


def into(stdout, *words, stderr=None):
    """The exit code of the command with these streams, and what it printed on standard error."""
    told = stderr or io.StringIO()
    arguments = mock.patch.object(sys, "argv", ["orthoscale", *map(str, words)])
    streams = contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(told)
    with arguments, streams[0], streams[1], pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, told.getvalue()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_what_cannot_be_printed_is_an_output_that_was_not_written():
    with open("/dev/full", "wb", buffering=0) as full:
        code, told = into(io.TextIOWrapper(full, write_through=True), "fleets")
    assert code == 6
    assert told.startswith("error: standard output cannot be written (No space left on device)\nNothing was written. ")


@pytest.fixture
def park(tmp_path, monkeypatch):
    """Words for a picture of a car park and its boxes, in the current folder."""
    car_park(tmp_path)
    monkeypatch.chdir(tmp_path)
    return ["park.png", "--detections", "detections.json", "--anchors", "none", "--fleet", "DE"]


@pytest.mark.parametrize(
    "command, written",
    [
        (["fix", "--out", "a.tif", "--report", "json", "--json"], "a.tif.png, a.tif.json, a.tif"),
        (["fix", "--out", "a.tif", "--report", "none"], "a.tif"),
        (["estimate", "--save-detections", "boxes.json"], "boxes.json"),
    ],
)
def test_outputs_stay_and_are_named_if_standard_output_is_full(command, written, park):
    """To run again would fail: they are there. It said that, and to make room for temporary files."""
    code, told = into(Full(), *command, *park)
    said = f"In place and complete: {written}. What was to be printed is lost.\n"
    assert (code, told) == (6, f"error: standard output cannot be written (No space left on device)\n{said}")
    assert all(Path(name).is_file() for name in written.split(", "))


def test_standard_output_is_not_taken_for_the_summary_of_several_inputs(park):
    """Its error was that of the summary, of which "nothing was left behind", while the copy stayed."""
    shutil.copy("park.png", "again.png")
    code, told = into(Full(), "fix", *park, "again.png", "--summary", "rows.csv", "--out", "many", "--report", "none")
    assert code == 6 and "standard output cannot be written" in told and "rows.csv" not in told
    assert f"In place and complete: {Path('many/park.tif').absolute()}." in told
    assert not Path("rows.csv").exists() and Path("many/park.tif").is_file()


def test_a_reader_that_leaves_ends_the_command_as_shells_expect(park, monkeypatch):
    """141, not the exit code of a bug, by which click would end it."""
    assert into(Unread(), "estimate", *park) == (141, "")
    for words in (["fleets"], ["fleets", "--help"], ["--help"], ["--version"]):
        assert into(Unread(), *words) == (141, "")
    monkeypatch.setenv("_ORTHOSCALE_COMPLETE", "bash_source")  # prints the script for completion
    monkeypatch.setattr("click.core._detect_program_name", lambda: "orthoscale")
    assert into(Unread()) == (141, "")


@pytest.mark.parametrize("stdout", [io.StringIO, Full])
def test_exit_codes_do_not_depend_on_standard_error(stdout, park):
    assert into(stdout(), "estimate", "gone.png", stderr=Full())[0] == 5
    assert into(stdout(), "estimate", stderr=Full())[0] == 2


@pytest.mark.parametrize("command", ["estimate", "fix", "check"])
@pytest.mark.parametrize("refused, code", [("too few", 3), ("contradicted", 4)])
def test_boxes_are_saved_where_they_give_no_scale(command, refused, code, tmp_path):
    car_park(tmp_path)
    (tmp_path / "park.pgw").write_text("0.1\n0\n0\n-0.1\n5\n5\n")
    found = json.loads((tmp_path / "detections.json").read_text())
    rows = found["pictures"]["park.png"]
    more = []
    if refused == "too few":
        del rows[3:]
    else:
        more = ["--known-distance", "100,100 500,100 400"]  # ten times as long
    (tmp_path / "given.json").write_text(json.dumps(found))
    words = ["--detections", tmp_path / "given.json", "--anchors", "none", "--fleet", "DE", *more]
    words += ["--out", tmp_path / "out.tif"] if command == "fix" else []
    saved = tmp_path / "saved.coco.json"
    done = run(command, tmp_path / "park.png", *words, "--save-detections", saved)
    assert done.returncode == code and not (tmp_path / "out.tif").exists()
    assert f"the boxes are saved in {saved}" in done.stderr
    assert len(json.loads(saved.read_text())["annotations"]) == len(rows)
    again = run(command, tmp_path / "park.png", *words, "--save-detections", saved)
    assert again.returncode == 2 and "already exists" in again.stderr


def test_of_boxes_that_nobody_measured_it_is_said_what_is_assumed(tmp_path):
    car_park(tmp_path)
    own = json.loads((tmp_path / "detections.json").read_text())
    (tmp_path / "bare.json").write_text(json.dumps(own["pictures"]))
    bare, measured = (
        run("estimate", tmp_path / "park.png", "--fleet", "DE", "--detections", tmp_path / name).stdout
        for name in ("bare.json", "detections.json")
    )
    note = "vehicles is not known: 0 +- 1.5 and 0 +- 1.2 detector pixels are assumed (orthoscale calibrate measures it)"
    assert note in bare and "is not known" not in measured


def test_likely_fleets_are_called_fleets(tmp_path):
    car_park(tmp_path)
    done = run("estimate", tmp_path / "park.png", "--fleet", "world", "--detections", tmp_path / "detections.json")
    assert re.search(r"^likely +the vehicles' fleet is [A-Z]+ \d+ %, ", done.stdout, re.MULTILINE)


def test_no_boxes_are_not_saved(tmp_path):
    car_park(tmp_path)
    (tmp_path / "none.json").write_text('{"park.png": []}')
    words = ["--detections", tmp_path / "none.json", "--anchors", "none"]
    done = run("estimate", tmp_path / "park.png", *words, "--save-detections", tmp_path / "saved.json")
    assert done.returncode == 3 and "are saved" not in done.stderr and not (tmp_path / "saved.json").exists()


@pytest.mark.parametrize("more", [[], ["--overwrite"], ["--dry-run"]])
def test_a_folder_is_no_place_for_the_copy_of_a_picture(more, tmp_path):
    car_park(tmp_path)
    (tmp_path / "out").mkdir()
    done = run("fix", tmp_path / "park.png", "--out", tmp_path / "out", *more)
    assert done.returncode == 2 and "written as GeoTIFF" in done.stderr and "end in .tif" in done.stderr


@pytest.mark.slow
def test_a_metric_model_claims_a_metre_per_unit(tmp_path):
    right, wrong = tmp_path / "right", tmp_path / "wrong"
    for folder, scale in ((right, 14.157), (wrong, 20.0)):
        folder.mkdir()
        scale_model(EXAMPLE / "sparse", folder, scale)
    agrees = run("check", right, *RULES)
    assert agrees.returncode == 0 and "agrees: vehicles give" in agrees.stdout
    assert "1 m/model-unit: its coordinates are metres: orthoscale wrote it (sim3.txt lies in it)" in agrees.stdout
    assert "orthoscale gave it its scale: agreement with vehicles does not confirm it" in agrees.stdout
    disagrees = run("check", wrong, *RULES, "--json")
    (comparison,) = json.loads(disagrees.stdout)["comparisons"]
    assert disagrees.returncode == 4 and comparison["verdict"] == "disagrees" and comparison["claimed"] == 1
    assert comparison["guesses"] == []
    assert "its coordinates are metres" in run("check", wrong, *RULES, "--dry-run").stdout
    several = run("check", right, wrong, *RULES, "--summary", tmp_path / "claims.json")
    rows = json.loads((tmp_path / "claims.json").read_text())["inputs"]
    assert several.returncode == 4 and [row["claim"] for row in rows] == [OF_A_COPY, "disagrees"]
    assert [row["claimed"] for row in rows] == [1, 1]


@pytest.mark.slow
def test_a_model_that_claims_no_scale_is_told_which_it_has():
    done = run("check", EXAMPLE / "sparse", *RULES)
    assert done.returncode == 2 and "claims no scale: nothing says that its coordinates are metres; it h" in done.stderr
    assert "m/model-unit, 90 % 1" in done.stderr and "fix" in done.stderr
    done = run("check", EXAMPLE / "sparse", *RULES, "--dry-run")
    assert done.returncode == 0 and "nothing says that its coordinates are metres" in done.stdout


@pytest.mark.slow
def test_a_model_that_looks_metric_is_compared_with_a_metre(tmp_path):
    """Aligned with GPS, say, by a program that leaves no word of it. It was refused: it claims no scale."""
    scale_model(EXAMPLE / "sparse", tmp_path, 14.157)
    (tmp_path / SCALED_MARK).unlink()
    done = run("check", tmp_path, *RULES)
    assert done.returncode == 0 and "agrees: vehicles give" in done.stdout, done.stderr
    assert "nothing says that its coordinates are metres, but its unit is nearly one" in done.stdout
    for again in ("the claim itself is not tied to the ground", "seems to be in metres"):
        assert again not in done.stdout
