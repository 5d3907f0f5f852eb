"""Every option of every command is effective or refused, and is written down once."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError
from pathlib import Path
from types import SimpleNamespace
from typing import get_type_hints

import numpy as np
import pytest
from support.in_process import run
from support.reports import EXAMPLE, GSD, car_park

import orthoscale
from orthoscale import requests
from orthoscale.actions.fix import REPORT_FILES
from orthoscale.cli.main import COMMANDS, cli
from orthoscale.cli.photo_options import LENS_FLAGS
from orthoscale.core.measuring.method import VARIANTS_BY_NAME
from orthoscale.errors import TooLittleEvidence, UsageError
from orthoscale.option import flag, options_in
from orthoscale.report.extras import WRITERS
from orthoscale.requests import EstimateRequest, FixRequest, PhotoRequest, VehicleRequest

TOWN = Path(__file__).parents[1] / "examples" / "town" / "ortho.jpg"


@pytest.fixture(scope="module")
def park(tmp_path_factory):
    folder = tmp_path_factory.mktemp("park")
    car_park(folder)
    return folder


# A value that says something, for every option of `estimate` and `fix`.
SAID = {
    "fleet": "DE",
    "detections": "boxes.json",
    "detector": "d.onnx",
    "decoder": "yolo-obb",
    "vehicle_classes": ("car",),
    "calibration": "c.json",
    "measurer": "built-in",
    "zoom": 0.5,
    "gsd_hint": 0.1,
    "images": "frames",
    "refine": True,
    "fast": True,
    "mode": "planar",
    "target": 0.01,
    "exhaustive": True,
    "seed": 7,
    "workers": 1,
    "scheduler": "tcp://nobody:8786",
    "cache": False,
    "projection": "naive",
    "estimator": "iqr",
    "known_distance": ("0,0 9,9 1",),
    "ground_control": "g.txt",
    "gps": False,
    "against": "map.tif",
    "anchors": ("none",),
    "anchor": ("bay=2.5",),
    "overwrite": True,
    "override": True,
    "keep_origin": True,
    "cog": True,
    "also": ("tfw",),
    "force": True,
    "dense": True,
    "ground_cloud": "cloud.ply",
    "report": "json",
}
OF_DETECTOR = {"detector", "decoder", "zoom", "gsd_hint"} | {
    *("refine", "fast", "target", "exhaustive", "seed", "workers", "scheduler", "cache")
}
OF_MODEL = {"mode", "images", "projection", "dense", "ground_cloud", "gps"}
OF_ORTHOPHOTO = {"fast", "target", "keep_origin", "cog", "also"}


def test_the_table_has_every_option():
    assert set(SAID) == {each.name for each in options_in(FixRequest)}


@pytest.mark.parametrize("name", SAID)
def test_with_boxes_from_a_file_what_looks_for_them_is_refused(name):
    if name == "detections":
        return
    if name in OF_DETECTOR:
        with pytest.raises(UsageError, match="does nothing here: --detections takes the boxes from a file"):
            FixRequest(detections="boxes.json", **{name: SAID[name]})
    else:
        FixRequest(detections="boxes.json", **{name: SAID[name]})


@pytest.mark.parametrize("name", SAID)
@pytest.mark.parametrize("command", ["estimate", "fix"])
def test_what_is_for_the_other_kind_of_input_is_refused(park, tmp_path, name, command):
    """Each alone: on an orthophoto, on a model, by command and option. No detector runs: boxes come from a file."""
    kind = EstimateRequest if command == "estimate" else FixRequest
    if name not in {each.name for each in options_in(kind)}:
        option = flag(next(each for each in options_in(FixRequest) if each.name == name))
        assert run(command, park / "park.png", option).returncode == 2
        return
    request = kind(**{name: SAID[name]})
    for judge, refused in (
        (request._for_plan, OF_MODEL),
        (request._for_posed, OF_ORTHOPHOTO),
    ):
        if name in refused:
            with pytest.raises(UsageError):
                judge("a.tif")
        else:
            judge("a.tif")


def test_with_a_projection_of_frames_nothing_is_looked_at_from_above(flight, monkeypatch):
    """Half of the time went into ground pictures that were then not measured."""
    modes = []

    def looked(source, mode, search):
        modes.append(mode)
        raise TooLittleEvidence("nobody looks")

    monkeypatch.setattr("orthoscale.actions.boxes.find_in", looked)
    for options in ({}, {"projection": "naive"}, {"projection": "naive", "mode": "both"}):
        with pytest.raises(TooLittleEvidence):
            orthoscale.estimate(flight[0], fleet="US", anchors=["none"], **options)
    assert modes == [None, "oblique", "both"]


def test_with_a_projection_of_frames_a_measurer_is_refused():
    with pytest.raises(UsageError, match="--measurer does nothing here: by --projection the frames of"):
        EstimateRequest(projection="naive", measurer="built-in")._for_posed("sparse")
    EstimateRequest(projection="naive", mode="both", measurer="built-in")._for_posed("sparse")
    EstimateRequest(projection="planar", measurer="built-in")._for_plan("a.tif")


def with_a_court(park):
    """The boxes of the car park, and a tennis court among them."""
    found = json.loads((park / "detections.json").read_text())
    court = {"cx": 500, "cy": 350, "length": 23.77 / GSD, "width": 10.97 / GSD, "angle": 0.2, "kind": "tennis-court"}
    found["pictures"]["park.png"].append(court)
    (park / "court.json").write_text(json.dumps(found))
    return park / "court.json"


EFFECTS = {  # that a report of the car park shows, from boxes in a file
    "fleet": ("US", lambda a, b: a["scale"] != b["scale"]),
    "estimator": ("iqr", lambda a, b: a["scale"] != b["scale"]),
    "known_distance": (("100,100 600,100 50.5 0.2",), lambda a, b: [e["kind"] for e in b["evidence"]]),
    "ground_control": ("control.txt", lambda a, b: [e["kind"] for e in b["evidence"]]),
    "anchors": (["none"], lambda a, b: [e["kind"] for e in a["evidence"]] == ["tennis court"] and not b["evidence"]),
    "projection": ("planar", lambda a, b: a["method"]["projection"] == "planar" and a["scale"] == b["scale"]),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_not_refused_has_its_effect(park, name):
    (park / "control.txt").write_text("100,100 0 0\n600,100 50 0\n600,500 50 -40\n100,500 0 -40\n")
    value, effect = EFFECTS[name]
    usual = {"fleet": "DE", "detections": park / "detections.json"}
    if name == "anchors":
        usual |= {"detections": with_a_court(park), "anchors": ["tennis-court"]}
    value = park / value if name == "ground_control" else value
    before, after = (orthoscale.estimate(park / "park.png", **usual | more).to_dict() for more in ({}, {name: value}))
    assert effect(before, after)


@pytest.mark.parametrize("name", COMMANDS)
def test_no_option_of_any_command_is_unknown_to_its_function(name):
    """Each arrives under a name that the function takes, or the request that it makes of the rest."""
    command = cli.get_command(None, name)
    taken = set(command.callback.__wrapped__.__code__.co_varnames if hasattr(command.callback, "__wrapped__") else
                command.callback.__code__.co_varnames)  # fmt: skip
    known = (
        taken
        | {each.name for kind in (FixRequest, PhotoRequest) for each in options_in(kind)}
        | {"fleet", "gsd", "local_fleet"}
    )
    known |= {"paths", "summary", "jobs"}  # of `cli.many.inputs`
    known |= set(LENS_FLAGS)  # of `cli.photo_options.lens_options`
    assert {option.name for option in command.params if option.expose_value} <= known


@pytest.mark.parametrize(
    "arguments",
    [
        ["estimate", "ORTHO", "--images", "x"],
        ["estimate", "ORTHO", "--mode", "planar"],
        ["estimate", "ORTHO", "--detections", "BOXES", "--detector", "x.onnx"],
        ["estimate", "ORTHO", "--detections", "BOXES", "--zoom", "0.5"],
        ["estimate", "ORTHO", "--zoom", "0.5", "--gsd-hint", "0.1"],
        ["estimate", "ORTHO", "--zoom", "nan"],
        ["estimate", "ORTHO", "--workers", "0"],
        ["estimate", "ORTHO", "--detections", "BOXES", "--estimator", "iqr", "--known-distance", "0,0 9,9 1"],
        ["estimate", "MODEL", "--detections", "MODELBOXES", "--exhaustive"],
        ["estimate", "MODEL", "--mode", "planar", "--projection", "naive"],
        ["estimate", "MODEL", "--mode", "planar", "--refine"],
        ["fix", "ORTHO", "--out", "OUT", "--detections", "BOXES", "--dense"],
        ["fix", "MODEL", "--out", "OUT", "--detections", "MODELBOXES", "--cog"],
        ["check", "ORTHO", "--model-detections", "MODELBOXES", "--detections", "BOXES"],
        ["check", "ORTHO", "--model", "MODEL", "--save-detections", "OUT"],
        ["photo", "ORTHO", "--detections", "BOXES", "--decoder", "yolo-obb"],
        ["crop", "ORTHO", "--satellite", "ORTHO", "--gsd", "0.1", "--fleet", "DE", "--out", "OUT"],
        ["crop", "ORTHO", "--satellite", "ORTHO", "--gsd", "0.1", "--pitch", "-60", "--out", "OUT"],
    ],
    ids=" ".join,
)
def test_a_command_refuses_what_would_do_nothing(park, tmp_path, arguments):
    places = {
        "ORTHO": park / "park.png",
        "BOXES": park / "detections.json",
        "MODEL": EXAMPLE / "sparse",
        "MODELBOXES": EXAMPLE / "detections.json",
        "OUT": tmp_path / "out.json",
    }
    done = run(*(places.get(word, word) for word in arguments))
    assert done.returncode == 2 and "--" in done.stderr, done.stderr
    assert not (tmp_path / "out.json").exists()


def test_check_keeps_boxes_in_the_format_of_their_name(tmp_path):
    """As a GeoPackage that can be read back, not JSON under its name."""
    from orthoscale.formats.detections import load
    from orthoscale.sources.opening import open_source

    car_park(tmp_path)
    (tmp_path / "park.pgw").write_text("0.1\n0\n0\n-0.1\n0\n0\n")
    done = run(
        *("check", tmp_path / "park.png", "--fleet", "DE", "--detections", tmp_path / "detections.json"),
        *("--save-detections", tmp_path / "b.gpkg"),
    )
    assert (tmp_path / "b.gpkg").read_bytes()[:15] == b"SQLite format 3", done.stderr
    assert len(load(tmp_path / "b.gpkg", open_source(tmp_path / "park.png"))) == 61


@pytest.mark.parametrize(
    "options, says",
    [
        ({"exhuastive": True}, "no option is called 'exhuastive'.*Did you mean 'exhaustive'"),
        ({"flet": "US"}, "no option is called 'flet'.*Did you mean 'fleet'"),
        ({"mode": "bogus"}, "--mode bogus is not one of both, oblique, planar"),
        ({"mode": "plannar"}, "Did you mean 'planar'"),
        ({"projection": "mercator"}, "--projection mercator is not one of"),
        ({"zoom": "2"}, "--zoom takes a number, not '2'"),
        ({"zoom": -1.0}, "--zoom must be a positive number"),
        ({"zoom": 1e-308}, "--zoom must be a positive number, from 1e-12 to 1e"),
        ({"target": float("nan")}, "--target must be a positive number"),
        ({"workers": 1.5}, "--workers takes a whole number"),
        ({"seed": -1}, "--seed must be 0 or more"),
        ({"exhaustive": 1}, "--exhaustive takes True or False"),
        ({"known_distance": "0,0 9,9 1"}, "--known-distance takes a list"),
        ({"detector": 5}, "--detector takes a path"),
    ],
)
def test_a_bad_option_is_refused_before_anything_is_read(options, says):
    with pytest.raises(UsageError, match=f"(?s){says}"):
        orthoscale.estimate("there/is/no/such.tif", **options)
    with pytest.raises(UsageError, match=f"(?s){says}"):
        orthoscale.fix("there/is/no/such.tif", "out.tif", **options)


@pytest.mark.parametrize("command", ["estimate", "check", "fix", "anchors"])
def test_an_unknown_fleet_is_refused_before_the_input_is_opened(command, tmp_path):
    """`fix` and `check` opened it first, which takes long for a large model."""
    more = ["--out", tmp_path / "out.tif"] if command == "fix" else []
    done = run(command, tmp_path / "no_such.tif", "--fleet", "Absurdistan", *more)
    assert done.returncode == 2 and "no fleet is called 'Absurdistan'" in done.stderr


def test_a_value_of_any_length_is_named_in_short():
    with pytest.raises(UsageError, match=r"--fleet takes a text, not Fleet\(code='US'") as caught:
        EstimateRequest(fleet=orthoscale.load_fleet("US"))
    assert len(caught.value.message) < 120


def test_numbers_of_numpy_are_numbers():
    request = EstimateRequest(gsd_hint=np.float32(0.5), workers=np.int64(2))
    assert request == EstimateRequest(gsd_hint=0.5, workers=2)
    assert json.dumps(request.settings()) == json.dumps({"gsd_hint": 0.5, "workers": 2})
    for no_number in (np.array([0.1]), np.bool_(True), True):
        with pytest.raises(UsageError, match="--gsd-hint takes a number"):
            EstimateRequest(gsd_hint=no_number)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: orthoscale.photo("no.jpg", focal_px="900"), "--focal-px takes a number, not '900'"),
        (lambda: orthoscale.photo("no.jpg", pitch="-90"), "--pitch takes a number"),
        (lambda: orthoscale.photo("no.jpg", roll=True), "--roll takes a number"),
        (lambda: orthoscale.photo(TOWN, pitch=-60, roll=float("nan")), "--roll must lie between -360 and 360"),
        (lambda: orthoscale.calibrate("no.tif", gsd="0.1"), "--gsd takes a number"),
        (lambda: orthoscale.calibrate(TOWN, gsd=0.085, vehicle_classes="car"), "--vehicle-class takes a list"),
    ],
)
def test_other_functions_want_numbers_and_lists_as_well(call, said):
    with pytest.raises(UsageError, match=said):
        call()


def test_a_request_is_a_value():
    request = EstimateRequest(fleet="DE", known_distance=["0,0 9,9 1"])
    assert request == EstimateRequest(fleet="DE", known_distance=("0,0 9,9 1",)) and hash(request)
    assert request.settings() == {"fleet": "DE", "known_distance": ("0,0 9,9 1",)}
    with pytest.raises(FrozenInstanceError):
        request.fleet = "US"


@pytest.mark.parametrize(
    "request_type, options",
    [
        (VehicleRequest, requests.VehicleOptions),
        (EstimateRequest, requests.EstimateOptions),
        (FixRequest, requests.FixOptions),
    ],
)
def test_keywords_for_type_checkers_are_the_fields(request_type, options):
    names = vars(requests) | {"Any": object}
    hints = get_type_hints(request_type, names)
    assert get_type_hints(options, names) == {each.name: hints[each.name] for each in options_in(request_type)}


@pytest.mark.parametrize(
    "command, request_type",
    [("estimate", EstimateRequest), ("fix", FixRequest), ("check", EstimateRequest), ("photo", VehicleRequest)],
)
def test_a_commands_options_are_the_fields(command, request_type):
    options = {option.name: option for option in cli.get_command(None, command).params}
    for each in options_in(request_type):
        about = each.metadata["option"]
        made = options[each.name]
        assert made.help == about.help and made.opts[0] == flag(each)
        assert tuple(getattr(made.type, "choices", ())) == about.choices
    assert run(command, "--help").returncode == 0


def test_the_command_line_says_nothing_of_its_own(park):
    """Without options it asks for what the library asks for by default."""
    command = cli.get_command(None, "fix")
    said = command.make_context("fix", [str(park / "park.png"), "--out", "x.tif"]).params
    assert FixRequest.of({each.name: said[each.name] for each in options_in(FixRequest)}) == FixRequest()


def test_choices_are_those_that_there_is_something_for():
    assert tuple(VARIANTS_BY_NAME) == requests.PROJECTIONS
    assert tuple(WRITERS) == requests.EXTRAS and tuple(REPORT_FILES) == requests.REPORTS


def test_seed_reaches_the_search_for_the_zoom(monkeypatch):
    from orthoscale.detect import find

    told = SimpleNamespace(seed=None)

    def search(pictures, detect, card, progress, seed, workers):
        told.seed = seed
        raise InterruptedError

    monkeypatch.setattr(find, "search_zoom", search)
    with pytest.raises(InterruptedError):
        orthoscale.estimate(EXAMPLE.parent / "town" / "ortho.jpg", seed=7)
    assert told.seed == 7


def test_settings_are_plain_values(park):
    result = orthoscale.estimate(park / "park.png", fleet="DE", detections=park / "detections.json")
    assert json.loads(json.dumps(result.settings)) == {"fleet": "DE", "detections": str(park / "detections.json")}


@pytest.mark.parametrize(
    "said, confirms",
    [
        ({}, True),
        ({"measurer": "own.onnx"}, True),
        ({"fast": True}, False),
        ({"measurer": "none"}, False),
        ({"detector": "d.onnx", "measurer": "built-in"}, False),
        ({"calibration": "c.json"}, False),
        ({"detections": "boxes.json", "measurer": "built-in"}, False),
    ],
)
def test_the_finder_confirms_what_is_found_here_and_measured_once_more(said, confirms):
    assert EstimateRequest(**said).confirms is confirms


@pytest.mark.parametrize("said", [{"detector": "d.onnx"}, {"measurer": "none"}, {"detections": "boxes.json"}])
def test_fast_is_refused_where_nobody_confirms(said):
    with pytest.raises(UsageError, match="--fast does nothing here"):
        EstimateRequest(fast=True, **said)


def test_inputs_are_the_files_that_options_name_and_no_words():
    """A folder that happens to be called as a choice is, such as DE or html, is no input."""
    words = FixRequest(fleet="DE", ground_cloud="none", measurer="built-in", anchor=("bay=2.5",), report="html")
    assert words.inputs == []
    files = FixRequest(
        fleet="DE.json", detections="boxes.txt", ground_cloud="dense", measurer=Path("none"), anchor=("mine.JSON",)
    )
    assert files.inputs == [Path(name) for name in ("DE.json", "boxes.txt", "dense", "mine.JSON")]
    assert FixRequest(images="frames", against=Path("map")).inputs == [Path("frames"), Path("map")]
    of_a_class = FixRequest(fleet="own/DE.json:mini")
    assert of_a_class.inputs == [Path("own/DE.json")] and FixRequest(fleet="DE:mini").inputs == []
    assert of_a_class.with_absolute_paths().fleet == str(Path("own/DE.json:mini").absolute())
