"""Every option of every command is effective or refused, found from the commands themselves.

A new option without a case fails `test_every_option_has_a_case`. What a request's options do once they have arrived is
tested with `estimate` (`test_requests`); what a command's own options do is tested here, by what it prints and writes.
"""

from __future__ import annotations

import csv
import hashlib
import json
import re
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import click
import cv2
import numpy as np
import pytest
import rasterio
from support.aerial import Shot, town
from support.in_process import run
from support.lots import lot_file, orthophoto
from support.photos import ALTITUDE, CARS, FOCAL, SIZE, boxes_in, detections_of, view_from, write_photo
from support.reports import EXAMPLE, GSD, car_park, fixed, fixed_model

from orthoscale.cli.main import COMMANDS, cli
from orthoscale.core.calibration import Calibration
from orthoscale.core.ruler import Ruler
from orthoscale.errors import UsageError
from orthoscale.formats.calibration import save_calibration
from orthoscale.formats.detections.own import save_detections

# The options of requests, each with a value that says something, and the word for it on the command line.
ASKED = {
    "fleet": ("--fleet", "JP"),
    "detections": ("--detections", "BOXES"),
    "detector": ("--detector", "d.onnx"),
    "decoder": ("--decoder", "yolo-obb"),
    "vehicle_classes": ("--vehicle-class", "bus"),
    "calibration": ("--calibration", "CALIBRATION"),
    "zoom": ("--zoom", "0.5"),
    "gsd_hint": ("--gsd-hint", "0.2"),
    "depth": ("--depth", "DEPTH"),
    "depth_kind": ("--depth-kind", "range"),
    "depth_factor": ("--depth-factor", "2"),
    "images": ("--images", "frames"),
    "ground_cloud": ("--ground-cloud", "none"),
    "refine": ("--refine",),
    "measurer": ("--measurer", "none"),
    "fast": ("--fast",),
    "mode": ("--mode", "planar"),
    "target": ("--target", "0.02"),
    "exhaustive": ("--exhaustive",),
    "seed": ("--seed", "7"),
    "workers": ("--workers", "1"),
    "scheduler": ("--scheduler", "tcp://nobody:8786"),
    "cache": ("--no-cache",),
    "projection": ("--projection", "naive"),
    "estimator": ("--estimator", "iqr"),
    "known_distance": ("--known-distance", "0,0 9,9 1"),
    "ground_control": ("--ground-control", "g.txt"),
    "gps": ("--no-gps",),
    "against": ("--against", "SATELLITE"),
    "anchors": ("--anchors", "none"),
    "anchor": ("--anchor", "bay=2.5"),
    "override": ("--override",),
    "keep_origin": ("--keep-origin",),
    "cog": ("--cog",),
    "also": ("--also", "tfw"),
    "force": ("--force",),
    "dense": ("--dense",),
    "report": ("--report", "none"),
}
# Where the request of a command arrives, with the positional and named arguments that it comes with.
ACTIONS = {
    "estimate": ("orthoscale.actions.estimate.measured", ("ORTHO",)),
    "fix": ("orthoscale.actions.fix.written", ("ORTHO", "--out", "NEW.tif")),
    "check": ("orthoscale.actions.check.checked", ("ORTHO",)),
    "anchors": ("orthoscale.actions.list_anchors.list_anchors", ("ORTHO",)),
    "photo": ("orthoscale.photos.survey.surveyed", ("PHOTO",)),
    "crop": ("orthoscale.photos.footprint.footprint_of", ("PHOTO", "--satellite", "SATELLITE", "--out", "NEW")),
    "evaluate": ("orthoscale.photos.looking.boxes_of", ("TABLE",)),
    "locate": ("orthoscale.actions.locate.claimed_scales", ("VIEW", "--satellite", "TOWN", "--out", "NEW")),
    "calibrate": ("orthoscale.actions.calibrate.calibrate", ("ORTHO",)),
}
# A command line of each command that works, and for its own options more words with what comes of them: another
# outcome, or a refusal that says so. A case with a line of its own has it in front.
MEASURED = ("--detections", "PHOTOBOXES", "--fleet", "CARS")
PHOTOS = ("photo", "PHOTO", "--focal-px", f"{FOCAL:g}", *MEASURED)
CROP = ("crop", "PHOTO", "--satellite", "SATELLITE", "--size", "90", "--out", "NEW")
GIVEN_GSD = (*CROP, "--gsd", "0.08")
LOCATE = ("locate", "VIEW", "--satellite", "TOWN", "--gsd", "0.2", "--heading", "0", "--out", "NEW")
LAYOUT = ("layout", "GROUND", "--lot", "LOT", "--facility", "badminton:2")
LINES = {
    "estimate": ("estimate", "ORTHO", "--detections", "BOXES", "--fleet", "DE"),
    "fix": ("fix", "PARK", "--detections", "PARKBOXES", "--fleet", "DE", "--report", "none", "--out", "NEW.tif"),
    "explain": ("explain", "REPORT"),
    "check": ("check", "ORTHO", "--detections", "BOXES", "--fleet", "DE"),
    "anchors": ("anchors", "ORTHO", "--scale", "0.1"),
    "apply": ("apply", "SIM3", "MESH", "--out", "NEW"),
    "photo": PHOTOS,
    "crop": GIVEN_GSD,
    "locate": LOCATE,
    "layout": LAYOUT,
    "evaluate": ("evaluate", "TABLE", *MEASURED),
    "report": ("report", "REPORT", "--out", "NEW.html"),
    "fleets": ("fleets", "DE"),
}
OTHER, REFUSED = "another outcome", "refused"
CASES = {
    ("fleets", "registrations"): (("--registrations", "REGISTER", "--out", "NEW.json"), OTHER, ("fleets",)),
    ("fleets", "out"): (("--out", "NEW.json"), REFUSED),
    ("report", "schema"): (("--schema",), OTHER),
    **{(name, "dry_run"): (("--dry-run",), OTHER) for name in ("estimate", "fix", "check")},
    **{(name, "summary"): (("--summary", "NEW.csv"), OTHER) for name in ("estimate", "fix", "check")},
    **{(name, "jobs"): (("--jobs", "2"), REFUSED) for name in ("estimate", "fix", "check")},
    ("check", "images"): (("--images", "FOLDER"), REFUSED),
    ("check", "model"): (("--model", "MODEL", "--save-detections", "NEW.json"), REFUSED),
    ("check", "model_detections"): (("--model-detections", "BOXES"), REFUSED),
    ("anchors", "scale"): (("--scale", "0.2"), OTHER),
    ("anchors", "out"): (("--out", "NEW"), OTHER),
    ("photo", "focal_px"): (("--focal-px", "1100"), OTHER),
    ("photo", "lens_file"): (("--lens", "LENS"), OTHER, ("photo", "PHOTO", *MEASURED)),
    ("photo", "pitch"): (("--pitch", "-80"), OTHER),
    ("photo", "roll"): (("--roll", "8"), OTHER, (*PHOTOS, "--pitch", "-70")),
    ("photo", "together"): (("--together",), OTHER),
    **{
        (command, name): (("--depth", "DEPTH", *words), OTHER, (*line, *before))
        for command, line in (("photo", PHOTOS), ("evaluate", ("evaluate", "TABLE", *MEASURED)))
        for name, words, before in (
            ("depth", (), ()),
            ("depth_kind", ("--depth-kind", "range"), ("--depth", "DEPTH")),
            ("depth_factor", ("--depth-factor", "1.1"), ("--depth", "DEPTH")),
        )
    },
    ("photo", "outputs"): (("--out", "NEW.csv"), OTHER),
    ("crop", "satellite"): (("--satellite", "COARSER"), OTHER),
    ("crop", "at"): (("--at", "9.0,60.0"), OTHER),
    ("crop", "radius"): (("--radius", "25"), OTHER, (*GIVEN_GSD, "--at", "9.0,60.0")),
    ("crop", "gsd"): (("--gsd", "0.05"), OTHER),
    ("crop", "out"): (("--out", "ELSEWHERE"), OTHER),
    ("crop", "square"): (("--square",), OTHER),
    ("crop", "stride"): (("--stride", "0.8"), OTHER),
    ("crop", "size"): (("--size", "60"), OTHER),
    ("crop", "focal_px"): (("--focal-px", "1100"), OTHER, (*CROP, *MEASURED, "--focal-px", "900")),
    ("crop", "lens_file"): (("--lens", "LENS"), REFUSED, (*CROP, *MEASURED, "--focal-px", "900")),
    ("crop", "pitch"): (("--pitch", "-80"), OTHER, (*CROP, *MEASURED, "--focal-px", "900")),
    ("crop", "roll"): (("--roll", "8"), OTHER, (*CROP, *MEASURED, "--focal-px", "900", "--pitch", "-70")),
    ("locate", "satellite"): (("--satellite", "SATELLITE"), OTHER),
    ("locate", "prior"): (("--prior", "500095,6651411,9"), OTHER),
    ("locate", "heading"): (("--heading", "180"), OTHER),
    ("locate", "gsd"): (("--gsd", "0.21"), OTHER),
    ("locate", "method"): (("--method", "retrieval"), REFUSED),
    ("locate", "embedding"): (("--embedding", "LENS", "--method", "gradient"), REFUSED),
    ("locate", "embedding_map"): (("--embedding-map", "LENS"), REFUSED),
    ("locate", "top"): (("--top", "1"), OTHER),
    ("locate", "out"): (("--out", "ELSEWHERE"), OTHER),
    ("locate", "focal_px"): (("--focal-px", "1100"), OTHER, (*LOCATE, "--focal-px", "600", "--pitch", "-85")),
    ("locate", "lens_file"): (("--lens", "LENS"), REFUSED, (*LOCATE, "--focal-px", "600")),
    ("locate", "pitch"): (("--pitch", "-80"), OTHER, (*LOCATE, "--focal-px", "600")),
    ("locate", "roll"): (("--roll", "8"), OTHER, (*LOCATE, "--focal-px", "600", "--pitch", "-85")),
    ("layout", "lot"): (("--lot", "SMALLER"), OTHER),
    ("layout", "lot_pixels"): (("--lot-pixels",), OTHER),
    ("layout", "facilities"): (("--facility", "tennis"), OTHER),
    ("layout", "avoid"): (("--avoid", "SMALLER", "--json"), OTHER, (*LAYOUT, "--json")),
    ("layout", "catalogue"): (("--catalogue", "CATALOGUE", "--facility", "shed"), OTHER),
    ("layout", "clearance"): (("--clearance", "6", "--json"), OTHER, (*LAYOUT, "--json")),
    ("layout", "scale_error"): (("--scale-error", "9"), OTHER),
    ("layout", "out"): (("--out", "NEW"), OTHER),
    ("layout", "list_them"): (("--list",), OTHER, ("layout",)),
    ("evaluate", "form"): (("--form", "denseuav"), OTHER),
    ("evaluate", "focal_px"): (("--focal-px", "1100"), OTHER),
    ("evaluate", "lens_file"): (("--lens", "LENS"), OTHER),
    ("evaluate", "max_pitch"): (("--max-pitch", "-80"), OTHER),
    ("evaluate", "ablations"): (("--ablations", "--json"), OTHER, ("evaluate", "TABLE", *MEASURED, "--json")),
    ("evaluate", "sensitivity"): (("--sensitivity", "--json"), OTHER, ("evaluate", "TABLE", *MEASURED, "--json")),
    ("evaluate", "outputs"): (("--out", "NEW.csv"), OTHER),
    ("evaluate", "locate"): (("--locate",), REFUSED),
    ("evaluate", "satellite"): (("--satellite", "SATELLITE"), REFUSED),
    ("evaluate", "method"): (("--method", "gradient"), REFUSED),
    ("evaluate", "scale_errors"): (("--scale-errors", "-.1,.1"), REFUSED),
    ("report", "images"): (("--images", "FOLDER"), REFUSED),
    ("report", "out"): (("--out", "NEW.png"), OTHER),
    ("apply", "out"): (("--out", "ELSEWHERE"), OTHER),
    ("fix", "out"): (("--out", "ELSEWHERE.tif"), OTHER),
}
IDLE = {  # said beside what makes them idle
    "nothing is written": [
        (*LINES[name], "--overwrite")
        for name in ("estimate", "check", "anchors", "photo", "layout", "evaluate", "fleets")
    ],
    "--list only lists": [("layout", "--list", *words) for words in (("--out", "NEW"), ("--facility", "tennis"))],
    "no vehicles are measured": [(*LINES["anchors"], "--zoom", "0.5"), (*LINES["anchors"], "--exhaustive")],
    "twice": [(*PHOTOS, "--lens", "LENS")],
    "looks straight down": [(*PHOTOS, "--roll", "8")],
    "there is no --depth": [(*PHOTOS, "--depth-kind", "range"), (*PHOTOS, "--depth-factor", "2")],
    "is one crop": [(*GIVEN_GSD, "--at", "9.0,60.0", "--stride", "0.3")],
}


def words_of(command: str) -> dict[str, object]:
    """The options of a command by the names of their values, its arguments left out."""
    options = cli.get_command(None, command).params
    return {each.name: each for each in options if each.param_type_name == "option"}


GRID = [(command, name) for command in COMMANDS for name in words_of(command)]
EVERYWHERE = {"as_json", "debug", "memory", "overwrite", "save_detections"}  # one meaning in all commands


@pytest.mark.parametrize("command, name", GRID)
def test_every_option_has_a_case(command, name):
    of_request = command in ACTIONS and name in ASKED
    own = command == "calibrate" and name in OF_CALIBRATE
    assert (command, name) in CASES or of_request or own or name in EVERYWHERE


def test_every_case_is_of_an_option_that_there_is():
    """Else its line would be refused for that, as it may be meant to be."""
    assert not set(CASES) - set(GRID) and not set(ASKED) - {name for _, name in GRID}


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """Small inputs of every command, by the words that stand for them."""
    folder = tmp_path_factory.mktemp("grid")
    car_park(folder)
    found = json.loads((folder / "detections.json").read_text())
    found["pictures"] = {"ortho.tif": found["pictures"]["park.png"]}
    (folder / "ortho.json").write_text(json.dumps(found))
    georeferenced(folder / "ortho.tif", GSD, cv2.imread(str(folder / "park.png")))
    grey = np.full((260, 260, 3), 120, np.uint8)
    georeferenced(folder / "satellite.tif", 0.5, grey)
    georeferenced(folder / "coarser.tif", 0.7, grey)
    ground = town(1, 900)
    georeferenced(folder / "town.tif", 0.5, np.ascontiguousarray(ground[::2, ::2]))
    cv2.imwrite(str(folder / "view.png"), Shot((105.0, 115.0), altitude=120.0, size=(600, 450)).of(ground, 0.25))
    (folder / "photos").mkdir()
    write_photo(folder / "photos/a.jpg")
    boxes = boxes_in(view_from(-90))
    save_detections(detections_of({"a.jpg": boxes}), folder / "photo.json")
    (folder / "fleet.json").write_text(json.dumps(CARS))
    np.save(folder / "depth.npy", np.full(SIZE[::-1], ALTITUDE, np.float32))
    (folder / "lens.json").write_text(json.dumps({"width": SIZE[0], "height": SIZE[1], "focal_px": 700}))
    with (folder / "photos/table.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["image", "altitude_m", "focal_px", "pitch_deg"])
        writer.writerow(["a.jpg", ALTITUDE, FOCAL, -75])
    (folder / "register.csv").write_text("Make;Model;Count\nFiat;Panda;6000\nFord;F-150;3000\n")
    (folder / "mesh.obj").write_text("v 1 2 3\nv 4 5 6\nv 7 8 1\nf 1 2 3\n")
    (folder / "lot").mkdir()
    shed = {"name": "Shed", "source": "made for this test", "length": 8, "width": 5}
    (folder / "catalogue.json").write_text(json.dumps({"facilities": {"shed": shed}}))
    report = fixed(folder).with_suffix(".json")
    save_calibration(calibrated(), folder / "calibration.json")
    return {
        "REGISTER": folder / "register.csv",
        "CALIBRATION": folder / "calibration.json",
        "ORTHO": folder / "ortho.tif",
        "BOXES": folder / "ortho.json",
        "PARK": folder / "park.png",
        "PARKBOXES": folder / "detections.json",
        "REPORT": report,
        "MODEL": EXAMPLE / "sparse",
        "FOLDER": folder,
        "SATELLITE": folder / "satellite.tif",
        "COARSER": folder / "coarser.tif",
        "TOWN": folder / "town.tif",
        "VIEW": folder / "view.png",
        "PHOTO": folder / "photos/a.jpg",
        "PHOTOBOXES": folder / "photo.json",
        "DEPTH": folder / "depth.npy",
        "CARS": folder / "fleet.json",
        "LENS": folder / "lens.json",
        "TABLE": folder / "photos/table.csv",
        "MESH": folder / "mesh.obj",
        "SIM3": fixed_model(folder / "lot", report="none", mode="planar").parent / "sim3.json",
        "GROUND": orthophoto(folder / "lot"),
        "LOT": lot_file(folder / "lot.geojson", [(2, 2), (66, 2), (66, 46), (2, 46)]),
        "SMALLER": lot_file(folder / "smaller.geojson", [(2, 2), (40, 2), (40, 30), (2, 30)]),
        "CATALOGUE": folder / "catalogue.json",
    }


def calibrated() -> Calibration:
    made = {"size_m": [4.4, 1.8], "size_sd_m": [0.1, 0.1], "vehicles": 9, "gsd_m": 0.1, "fleet": "DE", "notes": []}
    return Calibration("made for this test", "", Ruler(), None, made)


def georeferenced(path: Path, gsd: float, bgr: np.ndarray) -> None:
    """A GeoTIFF in UTM zone 32 with its middle at 9 degrees east, 60 degrees north."""
    height, width = bgr.shape[:2]
    corner = 500_000 - width / 2 * gsd, 6_651_411 + height / 2 * gsd
    transform = rasterio.transform.from_origin(*corner, gsd, gsd)
    with rasterio.open(
        path, "w", "GTiff", width, height, 3, "EPSG:32632", transform, "uint8", photometric="RGB"
    ) as out:
        out.write(np.moveaxis(bgr[..., ::-1], -1, 0))


NEW = ("NEW", "ELSEWHERE")


def outcome(words, places, folder):
    """What a command line says and writes, without the name of the folder that it writes into, and without the time
    that it took: twice the same gives the same."""
    folder.mkdir()

    def place(word):
        if word in places:
            return places[word]
        return folder / word.lower() if word.startswith(NEW) else word

    done = run(*map(place, words))
    files = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    said = re.sub(r"\b[\d.]+ s\b", "", done.stdout.replace(str(folder), ""))
    return SimpleNamespace(code=done.returncode, said=said, error=done.stderr, files=files, folder=folder)


@pytest.fixture(scope="module", autouse=True)
def one_date():
    """GeoPackages say when they were written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OGR_CURRENT_DATE", "2026-01-01T00:00:00.000Z")
        yield


@pytest.fixture(scope="module")
def usual(places, tmp_path_factory):
    """What comes of a command line, found once for all options that are added to it."""

    @cache
    def of(line):
        return outcome(line, places, tmp_path_factory.mktemp("usual") / "before")

    return of


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]} {case[1]}")
def test_a_commands_own_option_changes_the_outcome_or_is_refused(case, places, usual, tmp_path):
    words, comes, *own = CASES[case]
    line = own[0] if own else LINES[case[0]]
    after = outcome((*line, *words), places, tmp_path / "after")
    if comes == REFUSED:
        assert after.code == 2 and words[0] in after.error and not after.files, after.error
        return
    before = usual(line)
    assert 1 not in (before.code, after.code), before.error + after.error
    assert (after.code, after.said, after.files) != (before.code, before.said, before.files)
    assert 0 in (before.code, after.code), before.error + after.error


@pytest.mark.parametrize("why, line", [(why, line) for why, lines in IDLE.items() for line in lines])
def test_what_would_do_nothing_is_refused(why, line, places, tmp_path):
    done = outcome(line, places, tmp_path / "out")
    assert done.code == 2 and not done.files and why in done.error, done.error


@pytest.mark.parametrize(
    "command, name",
    [case for case in GRID if case[0] in ACTIONS and case[1] in ASKED and case not in {*CASES, ("calibrate", "fleet")}],
)
def test_an_option_of_a_request_arrives(command, name, places, tmp_path, monkeypatch):
    """As it was said, in the request that the action is given; and not when it was not said."""
    target, line = ACTIONS[command]
    given = []

    def action(*arguments, **named):
        given.append([*arguments, *named.values(), SimpleNamespace(**named)])
        raise UsageError("as far as this")

    monkeypatch.setattr(target, action)
    for words in ((), ASKED[name]):
        done = outcome((command, *line, *words), places, tmp_path / f"out{len(given)}")
        assert "as far as this" in done.error, done.error
    (unsaid, said) = (
        [vars(each)[name] for each in some if hasattr(each, "__dict__") and name in vars(each)] for some in given
    )
    assert said and unsaid != said


OF_CALIBRATE = {"gsd": ("--gsd", "0.2"), "fleet": ("--fleet", "JP"), "local_fleet": ("--local-fleet",), "out": ()}


@pytest.mark.parametrize("name", ["gsd", "fleet", "local_fleet"])
def test_an_option_of_calibrate_arrives(name, places, monkeypatch):
    given = []

    def action(*arguments, **named):
        given.append(named)
        raise UsageError("as far as this")

    monkeypatch.setattr("orthoscale.actions.calibrate.calibrate", action)
    for words in ((), OF_CALIBRATE[name]):
        run("calibrate", places["ORTHO"], *words)
    assert given[0][name] != given[1][name]


WITH_NUMBER = [
    (command, name)
    for command, name in GRID
    if isinstance(words_of(command)[name].type, (click.types.FloatParamType, click.types.IntParamType))
]


@pytest.mark.slow
@pytest.mark.parametrize("command, name", WITH_NUMBER)
def test_what_is_no_number_is_a_usage_error_that_names_the_option(command, name, places, tmp_path):
    """`crop --radius inf` took the whole picture, `evaluate --max-pitch nan` left out all photos."""
    words = (command, *ACTIONS[command][1]) if command in ACTIONS else ()
    if (command, name) in CASES:
        _, _, *line = CASES[command, name]
        words = line[0] if line else LINES[command]
    flag = words_of(command)[name].opts[-1]
    for k, value in enumerate(("1,5", "5 cm", "", "nan", "inf", "-1e400")):
        done = outcome((*words, f"{flag}={value}"), places, tmp_path / str(k))
        assert done.code == 2 and flag in done.error and done.files == {}, (value, done)


def test_a_map_that_is_nothing_beside_the_photo_is_refused(places, tmp_path):
    """`locate --gsd 1e12` ended as a bug: a division by zero."""
    done = outcome((*LOCATE, "--gsd", "1e12"), places, tmp_path / "out")
    assert done.code == 3 and "all of town.tif less than a 320th of that" in done.error


NAMED = {"estimate": "report", "fix": "report", "calibrate": "calibration"}  # what is printed, if not as the command


@pytest.mark.slow
@pytest.mark.parametrize("command", LINES)
def test_json_is_printed_where_it_is_asked_for(command, places, tmp_path):
    if "as_json" not in words_of(command):
        pytest.skip("prints no figures")
    done = outcome((*LINES[command], "--json"), places, tmp_path / "out")
    assert done.code == 0, done.error
    told = json.loads(done.said)
    if command != "fleets":  # a list
        assert told.get("format", told.get("kind")).startswith(f"orthoscale {NAMED.get(command, command)} ")


def test_the_list_of_facilities_is_printed_as_json():
    assert {each["code"] for each in json.loads(run("layout", "--list", "--json").stdout)} > {"tennis", "basketball"}


@pytest.mark.parametrize("command", [name for name in COMMANDS if "debug" in words_of(name)])
def test_debug_shows_where_an_error_comes_from(command):
    more = {
        "apply": ("x.obj", "--out", "y"),
        "fix": ("--out", "y.tif"),
        "crop": ("--satellite", "no.tif", "--out", "y"),
        "locate": ("--satellite", "no.tif", "--out", "y"),
        "layout": ("--lot", "no.json", "--facility", "tennis"),
    }
    line = (command, "no_such_thing", *more.get(command, ()))
    quiet, loud = run(*line), run(*line, "--debug")
    assert quiet.returncode == loud.returncode != 0
    assert "Traceback" in loud.stderr and "Traceback" not in quiet.stderr


@pytest.mark.parametrize("command", [name for name in COMMANDS if "memory" in words_of(name)])
def test_a_budget_is_set_or_refused(command, monkeypatch):
    from orthoscale.system import budget

    monkeypatch.setattr(budget, "_budget", budget._budget)
    assert run(command, "--memory", "10M", "no_such_thing").returncode == 2
    run(command, "--memory", "3G", "no_such_thing")
    assert budget._budget == 3 * 2**30


TO_WRITE = {  # what of each command may replace what an earlier run wrote
    "estimate": (*LINES["estimate"], "--save-detections", "NEW.json"),
    "fix": (*LINES["fix"], "--save-detections", "NEW.json"),
    "check": (*LINES["check"], "--save-detections", "NEW.json"),
    "anchors": (*LINES["anchors"], "--out", "NEW"),
    "apply": LINES["apply"],
    "photo": (*PHOTOS, "--save-detections", "NEW.json", "--out", "NEW.csv"),
    "crop": GIVEN_GSD,
    "locate": LOCATE,
    "layout": (*LAYOUT, "--out", "NEW"),
    "evaluate": (*LINES["evaluate"], "--save-detections", "NEW.json"),
    "report": LINES["report"],
    "fleets": ("fleets", "--registrations", "REGISTER", "--out", "NEW.json"),
}


@pytest.mark.slow
@pytest.mark.parametrize("command", TO_WRITE)
def test_what_an_earlier_run_wrote_is_replaced_on_demand_only(command, places, tmp_path):
    assert {name for name in COMMANDS if "overwrite" in words_of(name)} == {*TO_WRITE, "calibrate"}

    def again(*words):
        return run(
            *(places.get(w, tmp_path / w.lower() if w.startswith(NEW) else w) for w in (*TO_WRITE[command], *words))
        )

    first = again()
    assert (first.returncode, again().returncode, again("--overwrite").returncode) == (0, 2, 0)
    written = [str(tmp_path / word.lower()) for word in TO_WRITE[command] if word.startswith(NEW)]
    assert [name for name in written if name not in first.stdout] == [], "each file is named"
    assert not any(word.startswith("NEW.json") for word in TO_WRITE[command]) or (tmp_path / "new.json").is_file()


def test_calibrate_writes_and_replaces_on_demand_only(places, tmp_path, monkeypatch):
    monkeypatch.setattr("orthoscale.actions.calibrate.calibrate", lambda *_, **__: calibrated())
    line = ("calibrate", places["ORTHO"], "--out", tmp_path / "c.json")
    assert [run(*line).returncode, run(*line).returncode, run(*line, "--overwrite").returncode] == [0, 2, 0]
    assert run("calibrate", places["ORTHO"], "--overwrite").returncode == 2
    assert json.loads(run("calibrate", places["ORTHO"], "--json").stdout)
