"""Many inputs in one command: one row each, the exit code of the worst, a summary, and nobody's fault is another's."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import nullcontext, suppress
from glob import glob
from itertools import permutations
from pathlib import Path
from unittest import mock

import pytest
from support.cluster import killing_one
from support.in_process import run
from support.reports import EXAMPLE, car_park

import orthoscale
from orthoscale.actions import finished, inputs, many, processes
from orthoscale.actions.inputs import Named, outputs_of
from orthoscale.cli.dry_run import tell_rehearsals
from orthoscale.cli.many import line
from orthoscale.errors import InputError, OutputError, UsageError
from orthoscale.formats.names import in_utf8
from orthoscale.report.summary import check_summary, inputs_in, write_summary
from orthoscale.requests import EstimateRequest, FixRequest
from orthoscale.system.paths import titles_of

SLOW = pytest.mark.slow


@pytest.fixture(scope="module")
def parks(tmp_path_factory):
    """Two car parks, something that is no picture, and a joint file of boxes."""
    folder = tmp_path_factory.mktemp("parks")
    pictures = folder / "pictures"
    pictures.mkdir()
    boxes = {}
    for seed, name in enumerate(("a.png", "b.png")):
        car_park(pictures, name, seed=seed)
        found = json.loads((pictures / "detections.json").read_text())
        boxes |= found["pictures"]
        (pictures / "detections.json").unlink()
    (folder / "boxes.json").write_text(json.dumps({**found, "pictures": boxes}))
    (pictures / "broken.tif").write_bytes(b"II*\0nonsense")
    (pictures / "readme.txt").write_text("not an input")
    return folder


def options(parks, *more):
    return ["--fleet", "DE", "--detections", parks / "boxes.json", *more]


def test_too_little_memory_is_no_bug(parks, monkeypatch):
    monkeypatch.setattr(many, "measured", mock.Mock(side_effect=MemoryError("std::bad_alloc")))
    job = {"action": "estimate", "input": str(parks / "pictures/a.png"), "out": None, "settings": {}, "alone": True}
    row = many.one(job)
    assert (
        row["exit_code"] == 5 and row["error"] == "this machine has too little memory left" and "--jobs" in row["hint"]
    )
    monkeypatch.setattr("orthoscale.actions.estimate.measured", many.measured)
    done = run("estimate", parks / "pictures/a.png")
    assert done.returncode == 5 and row["error"] in done.stderr and "bug" not in done.stderr


def test_what_failed_is_named_once_and_as_the_user_named_it(parks, monkeypatch, capsys):
    from orthoscale.cli import many as command

    monkeypatch.chdir(parks)
    job = {"action": "estimate", "input": "pictures/broken.tif", "out": None, "settings": {}, "alone": True}
    row = many.one(job)
    assert row["exit_code"] == 5 and str(parks) not in row["error"] + row["hint"]
    command._tell([row, {**row, "error": "its process died"}], set())
    lines = [line for line in capsys.readouterr().err.splitlines() if "exit code" in line]
    assert [line.count("pictures/broken.tif") for line in lines] == [1, 1]


@pytest.mark.slow
def test_a_folder_gives_a_row_each_and_the_exit_code_of_the_worst(parks, tmp_path):
    summary = tmp_path / "out.csv"
    done = run("estimate", parks / "pictures", *options(parks, "--summary", summary, "--jobs", "2"))
    assert done.returncode == 5, done.stderr
    rows = list(csv.DictReader(summary.open()))
    assert [Path(row["input"]).name for row in rows] == ["a.png", "b.png", "broken.tif"]
    assert [row["exit_code"] for row in rows] == ["0", "0", "5"] and rows[2]["error"]
    for row in rows[:2]:
        alone = json.loads(run("estimate", row["input"], *options(parks, "--json")).stdout)
        assert float(row["scale"]) == alone["scale"]
    assert len(done.stdout.splitlines()) == 3 and "1 of 3 failed" in done.stderr
    again = run("estimate", parks / "pictures", *options(parks, "--summary", summary))
    assert again.returncode == 2 and "already exists" in again.stderr
    assert (
        run("estimate", parks / "pictures/a.png", *options(parks, "--summary", summary, "--overwrite")).returncode == 0
    )
    assert len(summary.read_text().splitlines()) == 2


def test_several_summaries(parks, tmp_path):
    places = [tmp_path / "out.csv", tmp_path / "out.json"]
    words = [word for place in places for word in ("--summary", place)]
    run("estimate", parks / "pictures/a.png", *options(parks, *words))
    assert all(place.is_file() for place in places)


ODD = {"pipe.json": "", "deep.json": "[" * 100_000, "long.csv": "x" * 200_000 + "\nx"}


@pytest.mark.parametrize("name", ODD)
def test_what_is_no_summary_lists_no_inputs(tmp_path, name):
    """A pipe, JSON nested too deeply, a cell too long: hung, or ended as a bug, before the summary was refused."""
    (tmp_path / name).write_text(ODD[name]) if ODD[name] else os.mkfifo(tmp_path / name)
    assert inputs_in(tmp_path / name) is None


@pytest.mark.parametrize("ending", ["json", pytest.param("gpkg", marks=SLOW), pytest.param("html", marks=SLOW)])
def test_summaries_in_every_format(parks, tmp_path, ending):
    summary = tmp_path / f"out.{ending}"
    words = ["fix", parks / "pictures", "--out", tmp_path / "scaled", *options(parks, "--summary", summary)]
    assert run(*words).returncode == 5
    made = {path.name for path in (tmp_path / "scaled").iterdir()}
    assert made == {f"{name}.tif{end}" for name in "ab" for end in ("", ".json", ".html", ".png")}
    if ending == "json":
        rows = json.loads(summary.read_text())["inputs"]
        assert [row["output"] for row in rows] == [*(str(tmp_path / f"scaled/{name}.tif") for name in "ab"), None]
        assert all(set(row) == set(many.COLUMNS) for row in rows)
    elif ending == "gpkg":
        import pyogrio

        about, _, points, values = pyogrio.raw.read(summary)
        assert list(about["fields"]) == list(many.COLUMNS) and len(points) == 3 and about["crs"] == "EPSG:4326"
    else:
        page = summary.read_text()
        assert (
            'href="scaled/a.tif.html"' in page and "broken.tif" in page and "http:" not in page and "https:" not in page
        )


@pytest.mark.parametrize("claim, unit", [("agrees", "m/px"), ("has no unit", "per pixel")])
def test_a_claim_is_told_with_its_unit(tmp_path, claim, unit):
    row = dict.fromkeys(many.COLUMNS) | {
        "input": "a.tif", "exit_code": 0, "scale": 0.085, "unit": "m/px", "low90": 0.08, "high90": 0.09,
        "verdict": "good", "vehicles_used": 60, "fleet": "DE", "claimed": 0.0851, "claim": claim,
    }  # fmt: skip
    write_summary([row], tmp_path / "a.html", tmp_path / "a.html")
    assert f"0.0851 {unit}: {claim}" in (tmp_path / "a.html").read_text()
    assert f"its claim of 0.0851 {unit} {claim}" in line(row)


def test_inputs_of_one_name_are_told_apart_on_the_page(tmp_path):
    """All orthophotos of ODM have one name, and all models of COLMAP are called 0."""
    names = ["p/a/odm_orthophoto/o.tif", "p/b/odm_orthophoto/o.tif", "x/sparse/0", "y/sparse/0", "lone.tif", "lone.tif"]
    rows = [{**dict.fromkeys(many.COLUMNS), "input": name, "exit_code": 3, "error": "x", "hint": ""} for name in names]
    write_summary(rows, tmp_path / "out.html", tmp_path / "out.html")
    shown = re.findall(r'<td class="name"[^>]*>(.*?)<', (tmp_path / "out.html").read_text())
    assert shown == ["a/odm_orthophoto/o.tif", "b/odm_orthophoto/o.tif", "x/sparse/0", "y/sparse/0", *names[-2:]]
    assert titles_of(["a/../b.tif", "b.tif"]) == ["b.tif"] * 2


@pytest.mark.parametrize("ending", ["csv", "json", "gpkg", "html"])
def test_a_summary_tells_an_input_whose_name_is_not_utf_8(tmp_path, ending):
    """So that the same command may write it again."""
    row = {**dict.fromkeys(many.COLUMNS), "input": "caf\udce9.tif", "exit_code": 3, "error": "x", "hint": ""}
    write_summary([row], tmp_path / f"out.{ending}", tmp_path / f"out.{ending}")
    assert inputs_in(tmp_path / f"out.{ending}") == {in_utf8("caf\udce9.tif")} == {r"caf\udce9.tif"}


def test_a_summary_leads_to_a_copy_whose_name_is_not_utf_8(tmp_path):
    out = tmp_path / os.fsdecode(b"caf\xe9.tif")
    Path(f"{out}.html").touch()
    numbers = {"scale": 0.1, "low90": 0.09, "high90": 0.11, "vehicles_used": 9, "exit_code": 0}
    row = {**dict.fromkeys(many.COLUMNS), "input": "a.tif", "output": str(out), **numbers}
    write_summary([row], tmp_path / "out.html", tmp_path / "out.html")
    assert 'href="caf%E9.tif.html"' in (tmp_path / "out.html").read_text()


@pytest.mark.parametrize("codes, worst", [((0, 3, 5, 4), 5), ((5, 1, 0), 1), ((0, 0), 0), ((), 0)])
def test_a_bug_is_worse_than_any_input(codes, worst):
    assert many.worst([{"exit_code": code} for code in codes]) == worst


def test_what_is_named(parks, tmp_path):
    pictures = parks / "pictures"
    assert Named([pictures / "*.png", pictures / "a.png"]).inputs == [pictures / "a.png", pictures / "b.png"]
    with pytest.raises(InputError, match="no file fits"):
        _ = Named([tmp_path / "*.tif"]).inputs
    work = tmp_path / "work"
    for k in "01":
        shutil.copytree(EXAMPLE / "sparse", work / "sparse" / k)
    assert Named([work]).inputs == [work / "sparse/0", work / "sparse/1"]
    both = [work / "sparse/0", work / "sparse/1"]
    assert Named([tmp_path]).inputs == Named([tmp_path / "*"]).inputs == both, "a folder of models"
    shutil.copy(pictures / "a.png", tmp_path / "a.png")
    assert Named([tmp_path]).inputs == [tmp_path / "a.png", *both]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no COLMAP model"):
        _ = Named([tmp_path / "empty"]).inputs
    assert Named([tmp_path / "empty", pictures / "a.png"]).inputs == [tmp_path / "empty", pictures / "a.png"]
    assert Named([tmp_path / "*"]).inputs == [tmp_path / "a.png", tmp_path / "empty", *both], "it stopped all others"


@pytest.mark.parametrize("end", ["*.tif", "2020/*.tif", "**/b.tif", ""])
def test_a_pattern_looks_once_into_each_folder_behind_links(tmp_path, monkeypatch, end):
    """Five links up the tree make 5 to the power of 40 paths, which it went on listing for ever."""
    home, other = tmp_path / "home", tmp_path / "other [1]"
    for place in (home / "2020", home / "2021", home / ".hidden/2020", home / "@eaDir/2020", other / "2020"):
        place.mkdir(parents=True)
        for name in ("a.tif", "b.tif"):
            (place / name).touch()
    plain = {os.path.realpath(each) for each in glob(str(home / "**" / end), recursive=True) if "@" not in each}
    for k in range(5):
        (home / f"2020/up{k}").symlink_to(home if k % 2 else tmp_path)
    monkeypatch.chdir(home)
    for start in (home, Path()):
        found = [each for each in Named([start / "**" / end]).inputs if each.is_file()]
        assert {os.path.realpath(each) for each in found} == {each for each in plain if each.endswith(".tif")}
    (home / "linked").symlink_to(other)
    assert (home / "linked/2020/b.tif") in Named([home / "**" / end]).inputs


def test_folders_that_are_not_looked_into_are_said(tmp_path):
    """Of an archive with pictures and folders of pictures the latter were left out without a word."""
    shutil.copytree(EXAMPLE / "sparse", tmp_path / "model/sparse")
    for k in range(7):
        (tmp_path / f"{2020 + k}").mkdir()
        (tmp_path / f"{2020 + k}" / "a.jp2").touch()
    (tmp_path / "notes").mkdir()
    (told,) = Named([tmp_path, tmp_path / "2020", tmp_path / "model"]).not_looked_into
    assert (
        "subfolders not searched: 2020, 2021, 2022, 2023, 2024 and 2 more;" in told and f"'{tmp_path}/*/*.jp2'" in told
    )
    assert Named([tmp_path / "none", tmp_path / "*"]).not_looked_into == []


def test_folders_are_listed_once(tmp_path, monkeypatch):
    """Those of a large archive on a network drive were listed for what is in them, for whether it is one input, and
    for what is left out."""
    (tmp_path / "below").mkdir()
    for place in ("a.tif", "below/b.tif"):
        (tmp_path / place).touch()
    asked = []
    monkeypatch.setattr(inputs, "_is_model", lambda folder: asked.append(folder))
    named = inputs.Named([tmp_path])
    assert named.many and named.inputs == [tmp_path / "a.tif"] and len(named.not_looked_into) == 1
    assert asked == [tmp_path, tmp_path / "below"]


def test_folders_below_those_that_fit_a_pattern_are_said(tmp_path):
    (tmp_path / "2020/more").mkdir(parents=True)
    for place in ("2020/a.tif", "2020/more/b.tif"):
        (tmp_path / place).touch()
    (told,) = Named([tmp_path / "*"]).not_looked_into
    assert told.startswith(f"{tmp_path / '2020'}: subfolders not searched: more;")


def test_copies_of_one_name_take_that_of_their_folders(tmp_path):
    inputs = [tmp_path / place for place in ("1/odm/o.tif", "2/odm/o.tif", "x.jpg", "x.png")]
    for path in inputs:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    names = [path.name for path in outputs_of(inputs, tmp_path / "out")]
    assert names == ["1_odm_o.tif", "2_odm_o.tif", "x_jpg.tif", "x_png.tif"]
    strange = ["x_jpg.png", "x.jpg", "x.png"]  # two would be x_jpg.tif, in every folder above as well
    for path in strange:
        (tmp_path / path).touch()
    first = [path.name for path in outputs_of([tmp_path / path for path in strange], tmp_path / "out")]
    assert [name.count("_") for name in first] == [2, 2, 1] and len(set(first)) == 3
    assert all(len(name) < 24 for name in first), "no absolute path where it tells nothing apart"
    more = [tmp_path / path for path in ("a.tif", *strange)]
    assert [path.name for path in outputs_of(more, tmp_path / "out")[1:]] == first, "names do not depend on the list"
    for out in (tmp_path, tmp_path / "1", inputs[0] / "in"):
        with pytest.raises(UsageError, match="lie in each other"):
            outputs_of(inputs, out)
    with pytest.raises(UsageError, match="would be the folder of the copies of .*o.tif, .*x.jpg"):
        outputs_of(inputs, tmp_path / "scaled.tif")


@pytest.mark.parametrize("more", [[], ["--dry-run"]])
@pytest.mark.parametrize("action", ["estimate", "fix"])
def test_boxes_of_one_picture_are_not_those_of_every_other(parks, tmp_path, action, more):
    boxes = json.loads((parks / "boxes.json").read_text())
    boxes["pictures"] = {"c.png": boxes["pictures"]["a.png"]}
    (tmp_path / "c.json").write_text(json.dumps(boxes))
    pictures = [parks / "pictures/a.png", parks / "pictures/b.png"]
    words = ["--detections", tmp_path / "c.json", "--fleet", "DE", "--anchors", "none", *more]
    for several, out, code in ((pictures, "copies", 5), (pictures[:1], "copy.tif", 0)):
        done = run(action, *several, *words, *(["--out", tmp_path / out] if action == "fix" else []))
        assert done.returncode == code, done.stderr
        assert ("its only picture is not in" in done.stdout + done.stderr) == (code == 5)


def test_where_names_repeat_across_folders_each_copy_names_its_folder(tmp_path):
    """x.tif and x_tif.tif would not tell of which folder they are."""
    names = {"a/x.tif": "a_x_tif.tif", "a/x.jpg": "a_x_jpg.tif", "b/X.tif": "b_X.tif", "b/y.tif": "y.tif"}
    for path in names:
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).touch()
    for order in permutations(names):
        found = outputs_of([tmp_path / path for path in order], tmp_path / "out")
        assert [path.name for path in found] == [names[path] for path in order]


def test_a_way_up_behind_a_link_leads_to_the_same_file_in_every_process(parks, tmp_path, monkeypatch):
    """``link/..`` is where the link leads: a file of that name beside the link is another one."""
    (tmp_path / "disk/below").mkdir(parents=True)
    shutil.copy(parks / "pictures/a.png", tmp_path / "disk/a.png")
    (tmp_path / "link").symlink_to(tmp_path / "disk/below")
    (tmp_path / "a.png").write_bytes(b"no picture")
    monkeypatch.chdir(tmp_path)
    settings = EstimateRequest(fleet="DE", detections=parks / "boxes.json").settings()
    row = many.one({"action": "estimate", "input": "link/../a.png", "out": None, "settings": settings, "alone": True})
    assert row["exit_code"] == 0, row["error"]
    assert outputs_of([Path("link/../a.png"), tmp_path / "a.png"], tmp_path / "out")[0].name == "disk_a.tif"


def test_an_input_keeps_the_name_of_its_copy_and_gets_no_others(parks, tmp_path):
    """Whatever else is named the next time."""
    inputs = [tmp_path / place for place in ("1/a.png", "2/a.png", "1/a.bmp")]
    for path in inputs:
        path.parent.mkdir(exist_ok=True)
        shutil.copy(parks / "pictures/a.png", path)
    first, second, third = inputs
    out = tmp_path / "out"
    out.mkdir()

    def names(*inputs):
        return [path.name for path in outputs_of(inputs, out)]

    assert names(first) == names(second) == ["a.tif"] and names(second, first) == ["2_a.tif", "1_a.tif"]
    orthoscale.fix(first, out / "a.tif", fleet="DE", detections=parks / "boxes.json", report="json")
    assert names(second, first) == ["2_a.tif", "a.tif"] and names(second) == ["2_a.tif"]
    assert names(third, first) == ["a_bmp.tif", "a.tif"]
    first.unlink()
    assert names(second) == ["a.tif"], "it was moved"


@pytest.fixture
def batch(parks, tmp_path):
    """Runs `fix` for all pictures in a folder, of which b.png came later; its rows by their names."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    shutil.copy(parks / "pictures/a.png", folder)
    (folder / "a.pgw").write_text("0.05\n0\n0\n-0.05\n500000\n5000000\n")
    boxes = shutil.copy(parks / "boxes.json", tmp_path)

    def fixed(*more, code, summary="out.csv"):
        words = ["--out", tmp_path / "scaled", "--fleet", "DE", "--detections", boxes, "--override", *more]
        done = run("fix", folder, *words, "--summary", tmp_path / summary)
        assert done.returncode == code, done.stderr
        with suppress(FileNotFoundError):
            rows = csv.DictReader((tmp_path / summary if summary.endswith(".csv") else tmp_path / "out.csv").open())
            return done, {Path(row["input"]).name: {**row, "written_by": ""} for row in rows}
        return done, {}

    fixed.folder, fixed.out, fixed.boxes, fixed.parks = folder, tmp_path / "scaled", Path(boxes), parks
    return fixed


@pytest.mark.slow
def test_the_same_command_again_does_what_is_missing(batch):
    _, first = batch(code=0)
    before = {path: path.stat().st_mtime_ns for path in batch.out.iterdir()}
    shutil.copy(batch.parks / "pictures/b.png", batch.folder)
    done, rows = batch(code=0)
    assert rows["a.png"] == first["a.png"], "as if measured"
    assert rows["a.png"]["claim"] and rows["b.png"]["scale"] and "1 of 2 were there already" in done.stderr
    assert {path: path.stat().st_mtime_ns for path in before} == before
    done, _ = batch("--dry-run", code=0)
    assert done.stdout.count("is there") == 2
    done, rows = batch("--force", "--jobs", "2", code=0)  # neither changes a copy
    assert "2 of 2 were there already" in done.stderr
    done, rows = batch("--overwrite", code=0)
    assert "there already" not in done.stderr and (batch.out / "a.tif").stat().st_mtime_ns > before[batch.out / "a.tif"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "more", "said"),
    [
        (lambda b: None, ["--cog"], "was made with other options (--cog)"),
        (lambda b: None, ["--estimator", "iqr"], "was made with other options (--estimator)"),
        (lambda b: shutil.copy(b.parks / "pictures/b.png", b.folder / "a.png"), [], "a.png has changed since"),
        (lambda b: later(b.folder / "a.pgw"), [], "a.pgw has changed since"),
        (lambda b: later(b.boxes), [], "boxes.json has changed since"),
        (lambda b: as_of_yesterday(b.boxes), [], "its files have changed since: ../boxes.json"),
        (lambda b: as_of_yesterday(b.out / "a.tif"), [], "a.tif has changed since it was made"),
        (lambda b: (b.out / "a.tif.html").unlink(), [], "a.tif.html is missing"),
    ],
)
def test_a_copy_that_was_made_otherwise_is_refused(batch, change, more, said):
    _, first = batch(code=0)
    change(batch)
    done, rows = batch(*more, code=2)
    assert said in done.stderr and rows == first, "and the summary of what was made is kept"
    done, rows = batch(*more, summary="other.csv", code=2)
    assert said in done.stderr and said in rows["a.png"]["error"] and not rows["a.png"]["scale"]


@pytest.mark.slow
def test_a_folder_of_models_is_resumed_and_a_damaged_copy_refused(tmp_path):
    """The page and the picture of a model's report are written after the report, into the copy's own folder."""
    for name in "ab":
        shutil.copytree(EXAMPLE / "sparse", tmp_path / "models" / name)
    words = ["fix", tmp_path / "models", "--out", tmp_path / "scaled", "--fleet", "US"]
    words += ["--detections", EXAMPLE / "detections.json"]
    assert run(*words).returncode == 0
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "scaled").rglob("*")}
    done = run(*words)
    assert done.returncode == 0 and "2 of 2 were there already" in done.stderr, done.stderr
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "scaled").rglob("*")} == before
    later(tmp_path / "scaled/a/sim3.json")
    done = run(*words)
    assert done.returncode == 2 and "a/sim3.json has changed since it was made" in done.stderr
    assert "pass --overwrite" in done.stderr
    (tmp_path / "scaled/a/sim3.json").write_text("{}")  # somebody's own work, which --overwrite does not replace
    later(tmp_path / "scaled/a/sim3.json")
    done = run(*words)
    assert done.returncode == 2 and "Choose another place, or delete it yourself" in done.stderr
    assert "--overwrite" not in done.stderr


def test_what_is_called_report_is_not_all_of_the_report(tmp_path):
    """It was taken for a part of it, in which no change was seen."""
    (tmp_path / "a").mkdir()
    for name in ("report.json", "report.html", "report.txt", "vehicles.png", "points3D.bin", ".orthoscale.json"):
        (tmp_path / "a" / name).touch()
    assert sorted(path.name for path in finished._copied(tmp_path / "a")) == ["points3D.bin", "report.txt"]


@pytest.mark.slow
def test_options_that_only_write_are_remembered_too(batch):
    batch("--cog", code=0)
    done, _ = batch(code=2)
    assert "was made with other options (--cog)" in done.stderr


def test_how_many_work_on_it_makes_no_other_copy():
    """`--jobs` gives each input a share of the cores."""
    asked = FixRequest(fleet="DE", workers=2, cache=False, scheduler="tcp://localhost:1", override=True)
    assert finished._other_options(asked, {"fleet": "DE", "workers": 1}) == []
    assert finished._other_options(asked, {"fleet": "DE", "force": True, "fast": True}) == ["--fast", "--force"]


def as_of_yesterday(path):
    """Another file, with its own time, as rsync brings it."""
    path.write_bytes(path.read_bytes() + b" ")
    os.utime(path, (time.time() - 86_400,) * 2)


def later(path):
    os.utime(path, (time.time() + 60,) * 2)


@pytest.mark.parametrize(
    "name, refused",
    [
        ("out/a.tif.json", True),  # its report
        ("out/A.TIF.html", True),
        ("out/a.tif.tiles.csv", True),
        ("elsewhere/../out/a.tif.gpkg", True),
        ("out/model/more.csv", True),
        ("out/model.csv", False),
        ("out/a.json", False),
        ("a.tif.json", False),
    ],
)
def test_a_summary_where_a_part_of_a_copy_will_be_is_refused(tmp_path, name, refused):
    """Its report was said to be "written by another run", and if it was there, not by orthoscale."""
    (tmp_path / "elsewhere").mkdir()
    with pytest.raises(UsageError, match="would be taken for a part of the copy") if refused else nullcontext():
        check_summary(tmp_path / name, [tmp_path / "out/a.tif", tmp_path / "out/model"])


@pytest.mark.slow
def test_a_summary_that_could_not_be_made_again_is_not_replaced(batch):
    """And what is no summary never is."""
    _, first = batch("--report", "none", code=0)
    done, rows = batch("--report", "none", code=2)
    assert "out.csv already exists" in done.stderr and rows == first
    batch("--overwrite", code=0)
    page = (batch.out / "a.tif.json").read_bytes()
    done, _ = batch("--overwrite", summary="scaled/a.tif.json", code=2)
    assert "a part of the copy" in done.stderr
    words = ["--fleet", "DE", "--detections", batch.boxes, "--overwrite", "--summary", batch.out / "a.tif.json"]
    done = run("estimate", batch.folder, *words)
    assert done.returncode == 2 and "is another kind of output of orthoscale, so it is not replaced" in done.stderr
    assert (batch.out / "a.tif.json").read_bytes() == page
    for ending in ("json", "html", "gpkg"):
        batch(summary=f"more.{ending}", code=0)
        batch(summary=f"more.{ending}", code=0)
    (remarked := batch.out.parent / "out.csv").write_text(remarked.read_text().replace(",DE,", ",FR,"))
    done, _ = batch(code=2)
    assert "out.csv was changed since orthoscale wrote it" in done.stderr and ",FR," in remarked.read_text()
    shutil.copytree(batch.folder, other := batch.folder.parent / "others")
    for ending in ("csv", "json", "html", "gpkg"):  # another batch's would lose the rows of this one
        name = f"{'out' if ending == 'csv' else 'more'}.{ending}"
        former = (batch.out.parent / name).read_bytes()
        done = run("fix", other, "--out", batch.out.parent / "new", "--fleet", "DE", "--detections", batch.boxes,
                   "--override", "--summary", batch.out.parent / name)  # fmt: skip
        assert done.returncode == 2 and "already exists" in done.stderr
        assert (batch.out.parent / name).read_bytes() == former


@pytest.mark.slow
def test_a_copy_that_was_damaged_is_not_taken_for_made(batch):
    batch(code=0)
    copy = batch.out / "a.tif"
    copy.write_bytes(copy.read_bytes()[:1000])
    later(copy)
    done, _ = batch(code=2)
    assert "a.tif has changed since it was made" in done.stderr


def stand_in(monkeypatch, program):
    """Let the Python `program` be the process that does the jobs."""
    popen = processes.subprocess.Popen

    def instead(command, **how):
        return popen([sys.executable, "-c", program], **how)

    monkeypatch.setattr(processes.subprocess, "Popen", instead)


@pytest.mark.slow
def test_a_process_that_dies_takes_only_its_own_input(parks, monkeypatch):
    """The stand-in dies at one input, as a process does that the kernel kills for its memory."""
    program = (
        "import os, signal; from orthoscale.actions import many, processes\n"
        "processes.serve(\n"
        "    lambda job: os.kill(os.getpid(), signal.SIGKILL) if 'a.png' in job['input'] else many.one(job)\n"
        ")"
    )
    stand_in(monkeypatch, program)
    request = EstimateRequest(fleet="DE", detections=parks / "boxes.json")
    rows = many.run_many("estimate", Named([parks / "pictures/*.png"]).inputs, request)
    assert [row["exit_code"] for row in rows] == [1, 0] and "ended with -9" in rows[0]["error"]
    assert many.worst(rows) == 1


@pytest.mark.slow
def test_a_stop_ends_all_and_leaves_nothing_half_made(parks, tmp_path):
    def stop(row):
        raise KeyboardInterrupt

    out = tmp_path / "out"
    request = FixRequest(fleet="DE", detections=parks / "boxes.json")
    with pytest.raises(KeyboardInterrupt):
        many.run_many("fix", Named([parks / "pictures/*.png"]).inputs, request, out, 1, stop)
    assert not [path for path in out.iterdir() if path.name.startswith(".")]


@pytest.mark.slow
def test_a_stop_tells_of_copies_that_were_just_put_in_place(parks, tmp_path, monkeypatch):
    """Those of processes whose answers had not come yet: "nothing was written" was said of them."""
    program = (
        "import signal; from orthoscale.actions import many, processes\n"
        "def one(job):\n"
        "    row = many.one(job)\n"
        "    if 'b.png' in job['input']:\n"
        "        open(job['out'] + '.made', 'w').close()\n"
        "        signal.pause()\n"
        "    return row\n"
        "processes.serve(one)"
    )
    stand_in(monkeypatch, program)
    monkeypatch.setattr(many.stopping, "written", [])
    out = tmp_path / "out"

    def stop(row):
        until = time.monotonic() + 60
        while not (out / "b.tif.made").exists() and time.monotonic() < until:
            time.sleep(0.01)
        raise KeyboardInterrupt

    request = FixRequest(fleet="DE", detections=parks / "boxes.json")
    with pytest.raises(KeyboardInterrupt):
        many.run_many("fix", Named([parks / "pictures/*.png"]).inputs, request, out, 1, stop)
    assert many.stopping.written == [str(out / "a.tif"), str(out / "b.tif")]


def test_a_process_ends_also_if_a_library_swallows_the_stop(parks, monkeypatch):
    """It waited for a next job, and the program for its end."""
    program = (
        "import os, signal\n"
        "from orthoscale.actions import many, processes\n"
        "def one(job):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        signal.pause()\n"
        "    except KeyboardInterrupt:\n"
        "        return dict.fromkeys(many.COLUMNS) | {'input': job['input'], 'exit_code': 0}\n"
        "processes.serve(one)"
    )
    stand_in(monkeypatch, program)
    (row,) = many.run_many("estimate", [parks / "pictures/a.png"], EstimateRequest(fleet="DE"))
    assert row["exit_code"] == 1 and "was stopped" in row["error"]


def test_no_process_goes_on_after_the_command_was_killed():
    """As for want of memory: its jobs were finished nevertheless, and the next run found their outputs locked."""
    child = (
        "import os, signal, time; from orthoscale.actions import processes\n"
        "processes.serve(lambda job: (os.kill(os.getppid(), signal.SIGKILL), time.sleep(40)))"
    )
    command = (
        "import subprocess, sys\n"
        "from orthoscale.detect.foreign_worker import send\n"
        f"child = subprocess.Popen([sys.executable, '-c', {child!r}], stdin=subprocess.PIPE, stdout=subprocess.PIPE)\n"
        "send(child.stdin, {'job': {'input': 'a', 'out': None}, 'memory': 1 << 30, 'log': 30})\n"
        "child.wait()"
    )
    done = subprocess.run([sys.executable, "-c", command], stderr=subprocess.PIPE, timeout=30)  # ends with the child
    assert done.returncode == -9 and not done.stderr


def test_a_bug_in_a_process_is_one_line_of_its_row(parks, monkeypatch, capfd):
    program = (
        "from orthoscale.actions import many, processes\n"
        "many.measured = lambda *given: 1 / 0\n"
        "processes.serve(many.one)"
    )
    stand_in(monkeypatch, program)
    (row,) = many.run_many("estimate", [parks / "pictures/a.png"], EstimateRequest(fleet="DE"))
    assert row["exit_code"] == 1 and row["error"] == "ZeroDivisionError: division by zero"
    assert capfd.readouterr().err == ""


def test_what_speaks_of_one_input_is_refused(parks):
    pictures, one = parks / "pictures", parks / "pictures/a.png"
    for path, why, *more in (
        (pictures, "is about one input, without a summary", "--known-distance", "0,0 9,9 1"),
        (pictures, "keeps the boxes of one input", "--save-detections", "x.json"),
        (one, "Name one input, without --summary", "--save-detections", "x.json", "--summary", "x.csv"),
        (one, "--jobs does nothing here: there is one input", "--jobs", "2"),
        (pictures, "a summary ends in .csv", "--summary", "x.doc"),
    ):
        done = run("estimate", path, *options(parks, *more))
        assert done.returncode == 2 and why in done.stderr, done.stderr
    for more in (["--model", "x"], ["--model-detections", "x.json"]):
        done = run("check", parks / "pictures", *options(parks, *more))
        assert done.returncode == 2 and f"{more[0]} is for one input, without --summary" in done.stderr


def test_a_dry_run_in_json_tells_names_that_are_not_utf_8(capsys):
    tell_rehearsals([[("input", "caf\udce9.tif")]], as_json=True)
    (told,) = json.loads(capsys.readouterr().out)["inputs"]
    assert told == {"input": [r"caf\udce9.tif"]}


def test_a_dry_run_says_what_would_be_done_and_does_nothing(parks, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    done = run(
        "fix", parks / "pictures/a.png", "--out", tmp_path / "s.tif", *options(parks, "--also", "tfw", "--dry-run")
    )
    assert done.returncode == 0, done.stderr
    for said in ("1000 x 700 px", "DE (Germany", "61 from", f"{tmp_path}/s.tif\n", "s.tfw", "s.tif.html"):
        assert said in done.stdout, said
    done = run("fix", parks / "pictures", "--out", tmp_path, *options(parks, "--dry-run"))
    assert done.returncode == 5 and "b.tif.json" in done.stdout and sorted(tmp_path.rglob("*")) == before
    done = run("fix", parks / "pictures", "--out", tmp_path, *options(parks, "--dry-run", "--json"))
    told = json.loads(done.stdout)
    assert done.returncode == 5 and told["format"] == "orthoscale rehearsal 1"
    assert any(str(tmp_path / "b.tif.json") in one.get("to write", []) for one in told["inputs"])
    assert all(len(one["input"]) == 1 for one in told["inputs"])
    new = tmp_path / "new"
    done = run("fix", parks / "pictures", "--out", new, *options(parks, "--dry-run"))
    assert done.returncode == 5 and f"{new}/b.tif.json" in done.stdout and not new.exists()
    words = ["fix", parks / "pictures/a.png", "--out", parks / "pictures/a.png", *options(parks, "--dry-run")]
    assert run(*words).returncode == 2


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["check", "a.png"], 2, "claims no scale"),
        (["check", "a.png", "b.png"], 2, "b.png claims no scale"),
        (["check", "a.png", "--model", "nosuch"], 5, "nosuch does not exist"),
        (["check", "a.png", "--model", "b.png"], 2, "a cross-check needs an orthophoto and a model"),
        (["fix", "a.png", "--out", "NEW", "--save-detections", "NEW.foo"], 2, "not an ending of a detections format"),
        (["fix", "a.png", "--out", "NEW", "--save-detections", "NEW/b.json"], 6, "does not exist"),
        (["estimate", "a.png", "--save-detections", "NEW.foo"], 2, "not an ending of a detections format"),
        (["estimate", "a.png", "--save-detections", "boxes.json"], 2, "is the input"),
        (["estimate", "a.png", "--measurer", "nosuch.onnx"], 5, "nosuch.onnx: cannot be read"),
        (["estimate", "a.png", "b.png", "--summary", "NEW.doc"], 2, "a summary ends in"),
        (["fix", "a.png", "b.png", "--out", "NEW/gone"], 2, "is not a folder"),
    ],
)
def test_a_dry_run_refuses_what_the_command_does(parks, tmp_path, words, code, said):
    places = {name: parks / "pictures" / name for name in ("a.png", "b.png")} | {"boxes.json": parks / "boxes.json"}
    words = [places.get(word, word.replace("NEW", str(tmp_path / "new.tif"))) for word in words]
    done = run(*words, *options(parks, "--dry-run"))
    assert done.returncode == code and said in done.stderr + done.stdout, done.stderr
    assert not list(tmp_path.iterdir())


def test_a_dry_run_of_a_check_says_what_would_be_compared_and_kept(parks, tmp_path):
    shutil.copy(parks / "pictures/a.png", tmp_path)
    (tmp_path / "a.pgw").write_text("0.05\n0\n0\n-0.05\n500000\n5000000\n")
    before = sorted(tmp_path.iterdir())
    done = run("check", tmp_path / "a.png", *options(parks, "--dry-run", "--save-detections", tmp_path / "kept.json"))
    assert done.returncode == 0 and f"to write   {tmp_path}/kept.json" in done.stdout, done.stderr
    words = ["--model", EXAMPLE, "--model-detections", EXAMPLE / "detections.json", "--dry-run"]
    done = run("check", tmp_path / "a.png", *options(parks, *words))
    assert done.returncode == 0 and "1000 x 700 px" in done.stdout and "a model with" in done.stdout, done.stderr
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_on_a_cluster_a_killed_worker_loses_no_input(parks, tmp_path):
    """Each input is a task; one of two workers is killed as soon as it has something to do."""
    distributed = pytest.importorskip("distributed")
    inputs = []
    for k in range(6):
        inputs.append(tmp_path / str(k) / "a.png")
        inputs[-1].parent.mkdir()
        shutil.copy(parks / "pictures/a.png", inputs[-1])
    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster,
        distributed.Client(cluster) as client,
    ):
        killing_one(cluster, client)
        request = FixRequest(fleet="DE", detections=parks / "boxes.json", report="none")
        todo = many.jobs_of("fix", inputs, request, tmp_path / "out")
        (tmp_path / "out").mkdir()
        done = processes.on_cluster(todo, cluster.scheduler_address, many.one)
        rows = [row for _, row in sorted(done, key=lambda each: each[0])]
    assert [(row["exit_code"], row["error"]) for row in rows] == [(0, None)] * 6
    alone = orthoscale.estimate(inputs[0], fleet="DE", detections=parks / "boxes.json")
    assert {row["scale"] for row in rows} == {alone.scale.value}
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [f"{k}_a.tif" for k in range(6)]


@pytest.mark.slow
def test_a_folder_that_cannot_be_made_is_an_output_that_was_not_written(parks, tmp_path, monkeypatch):
    """It was an input that cannot be read, with another exit code."""

    def forbidden(folder, **_):
        raise PermissionError(errno.EACCES, "Permission denied", str(folder))

    monkeypatch.setattr(Path, "mkdir", forbidden)
    with pytest.raises(OutputError, match="out: cannot write there .Permission denied"):
        many.run_many("fix", [parks / "pictures/a.png", parks / "pictures/b.png"], FixRequest(), tmp_path / "out")


def test_an_empty_folder_that_was_there_stays(parks, tmp_path):
    """And one that was made for nothing goes."""
    for there in (True, False):
        out = tmp_path / f"out{there}"
        if there:
            out.mkdir()
        assert run("fix", parks / "pictures/broken.tif", parks / "pictures/readme.txt", "--out", out).returncode
        assert out.exists() == there


def test_jobs_share_the_cores_of_this_machine_and_not_of_a_cluster(tmp_path, monkeypatch):
    monkeypatch.setattr(many, "cores", lambda: 6)

    def workers(jobs, **options):
        (job,) = many.jobs_of("estimate", [tmp_path / "a.tif"], EstimateRequest(**options), jobs=jobs)
        return job["settings"].get("workers")

    assert (workers(1), workers(2), workers(9)) == (6, 3, 1)
    assert workers(1, scheduler="tcp://localhost:1") is None
    assert workers(1, scheduler="tcp://localhost:1", workers=3) == workers(2, workers=3) == 3
    monkeypatch.setattr(many, "cores", lambda: 64)
    assert workers(1) == 8, "as many as one input alone has"


def test_only_files_that_options_name_become_absolute(tmp_path, monkeypatch):
    """A file that happens to be called as a country is stays a country."""
    monkeypatch.chdir(tmp_path)
    for name in ("DE", "html", "mine.json"):
        Path(name).touch()
    Path("boxes").mkdir()
    request = FixRequest(fleet="DE", detections="./boxes/", anchor=("bay=2.5", "./mine.json"), report="json")
    (job,) = many.jobs_of("fix", [Path("a.tif")], request, tmp_path / "out")
    assert job["settings"] == {
        "fleet": "DE",
        "detections": str(tmp_path / "boxes"),
        "anchor": ("bay=2.5", str(tmp_path / "mine.json")),
        "report": "json",
    }
