"""The library's own doors: what a notebook or a script sees."""

import copy
import importlib
import json
import pickle
import pkgutil
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from datetime import timedelta

import numpy as np
import pytest
from rasterio.crs import CRS
from support.photos import CARS, FOCAL, boxes_in, detections_of, view_from, write_photo
from support.reports import car_park, fixed, fixed_model

import orthoscale
from orthoscale.core.boxes import Boxes
from orthoscale.core.by_value import ByValue
from orthoscale.errors import EvidenceDisagrees
from orthoscale.formats.detections.own import save_detections
from orthoscale.requests import EstimateOptions, FixOptions


@pytest.mark.parametrize(
    "told, options",
    [
        (orthoscale.estimate.__doc__, EstimateOptions.__annotations__),
        (orthoscale.fix.__doc__, FixOptions.__annotations__.keys() - EstimateOptions.__annotations__.keys()),
    ],
)
def test_each_option_is_told_in_the_functions_own_words(told, options):
    assert [name for name in options if not re.search(rf"\b{name}\b", told)] == []


def test_the_default_fleet_is_told_as_it_is_chosen():
    """`estimate --help` says the same; see `sources.country.fleet_at`."""
    assert "where the input lies, else ``world``" in orthoscale.estimate.__doc__


@pytest.fixture(scope="module")
def park(tmp_path_factory):
    folder = tmp_path_factory.mktemp("park")
    car_park(folder)
    return folder


@pytest.fixture(scope="module")
def result(park):
    return orthoscale.estimate(park / "park.png", fleet="DE", detections=park / "detections.json")


@pytest.mark.slow
def test_public_names_are_there_and_cost_nothing_until_used():
    """Also after the modules beside them were imported, whose names must not hide theirs."""
    code = (
        "import sys, orthoscale; heavy = {'numpy', 'cv2', 'scipy', 'rasterio'} & set(sys.modules); "
        "import orthoscale.photos.survey, orthoscale.actions.check, orthoscale.cli.main; "
        "print(sorted(heavy), [n for n in orthoscale.__all__ if not callable(getattr(orthoscale, n))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[] []", done.stderr


def test_a_result_prints_in_under_ten_lines_the_answer_first(result):
    lines = str(result).splitlines()
    assert len(lines) < 10 and lines[0].startswith(
        f"scale      {result.scale.value:.4f} m/px ({100 * result.scale.value:.2f} cm)"
    )
    assert repr(result) == str(result) and "DE (" in str(result)
    assert str(result).startswith(f"{result.scale}\n") and str(result.scale).count("\n") == 2
    boxes = Boxes(np.array([[5, 5, 40, 18, 0.1], [9, 9, 50, 20, 0.1]]), np.array([0.5, 0.9]))
    assert str(boxes).splitlines()[:2] == ["boxes      2", "length     45 px (40 to 50)"]
    assert str(Boxes.empty()) == "boxes      0"
    html = result._repr_html_()
    assert html.startswith("<table>") and "<th>scale</th>" in html


def test_the_vehicles_are_a_table(result):
    table = result.vehicles
    assert len(table) == 61 and table["used"].sum() == result.scale.vehicles_used
    assert table["reason"][60] == "too large for a car" and table["picture"][0] == "park.png"
    assert np.allclose(table["length"], table["length_unit"] * result.scale.value)
    assert (table["box_length_px"] > table["length_unit"]).all(), "the margin is the box's"


@pytest.mark.parametrize("part", ["scale", "boxes", "fleet", "detections", "votes", "measured"])
def test_parts_of_a_result_are_equal_where_their_values_are(result, part):
    """The arrays in them have no truth value of their own; NaN, as in `Boxes.sigma`, is not less equal to itself."""
    value = getattr(result, part)
    for same in (copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value))):
        assert value == same
    assert value != 1
    with pytest.raises(TypeError, match="unhashable"):
        hash(value)


def test_parts_of_a_result_differ_where_one_value_does(result):
    boxes, votes, scale = result.boxes, result.votes, result.scale
    assert boxes != boxes[1:] and boxes != replace(boxes, score=boxes.score / 2)
    assert boxes != replace(boxes, sigma=np.full((len(boxes), 2), 0.1))
    assert votes != replace(votes, members=[*votes.members[1:], votes.members[0]])
    assert scale != replace(scale, used=~scale.used) and scale != replace(scale, value=2 * scale.value)
    systematic = result.measured.pooled.systematic
    assert systematic != replace(systematic, shared={**systematic.shared, "tilt": np.zeros(2)})


def test_no_part_of_a_result_is_left_to_compare_its_arrays_as_if_they_were_numbers():
    """Every dataclass that can be reached from a public one by the types of its fields."""
    modules = (importlib.import_module(each.name) for each in pkgutil.walk_packages(orthoscale.__path__, "orthoscale."))
    named: dict[str, set[type]] = {}
    for module in modules:
        for name, value in vars(module).items():
            if is_dataclass(value) and isinstance(value, type):
                named.setdefault(name, set()).add(value)
    waiting = [each for name in ("Result", "Checked", "Survey", "Calibration") for each in named[name]]
    reached: set[type] = set()
    while waiting:
        kind = waiting.pop()
        if kind not in reached:
            reached.add(kind)
            words = {word for each in fields(kind) for word in re.findall(r"\w+", str(each.type))}
            waiting += [other for word in words for other in named.get(word, ())]
    holds = {kind for kind in reached if any("ndarray" in str(each.type) for each in fields(kind))}
    assert len(holds) > 12 and [kind for kind in holds if not issubclass(kind, ByValue)] == []
    assert [kind for kind in holds if kind.__eq__ is not ByValue.__eq__] == []


def test_a_result_as_plain_values_is_the_report(park, result):
    fixed(park)
    written = json.loads((park / "scaled.tif.json").read_text())
    told = json.loads(json.dumps(result.to_dict()))
    assert told["vehicles"] == written["vehicles"] and told["scale"] == written["scale"]


def test_all_reports_of_a_result_say_the_same_time(result):
    """That of the measurement, not that of each report."""
    earlier = replace(result, created=result.created - timedelta(days=1))
    assert result.to_dict()["created"] == result.created.isoformat(timespec="seconds")
    assert earlier.to_dict()["created"] == earlier.created.isoformat(timespec="seconds")


def test_check_is_public(park):
    (park / "park.pgw").write_text("0.2\n0\n0\n-0.2\n500000\n5600000\n")
    wkt = CRS.from_epsg(32632).to_wkt()
    (park / "park.png.aux.xml").write_text(f"<PAMDataset><SRS>{wkt.replace('&', '&amp;')}</SRS></PAMDataset>")
    checked = orthoscale.check(park / "park.png", fleet="DE", detections=park / "detections.json")
    assert checked.disagrees and checked.comparisons[0].claimed == pytest.approx(0.2, rel=1e-3)
    shown = str(checked).splitlines()
    assert len(shown) < 10 and shown[0].startswith("claim      disagrees") and "<td>disagrees" in checked._repr_html_()
    assert json.loads(json.dumps(checked.to_dict()))["comparisons"][0]["verdict"] == "disagrees"
    with pytest.raises(EvidenceDisagrees, match="disagrees: vehicles give 0.1"):
        checked.require_agreement()
    (park / "park.pgw").unlink()
    (park / "park.png.aux.xml").unlink()


def test_photos_are_public(tmp_path):
    boxes = {f"{k}.jpg": boxes_in(view_from(-90), seed=k) for k in range(9)}
    for name in boxes:
        write_photo(tmp_path / name)
    save_detections(detections_of(boxes), tmp_path / "boxes.json")
    (tmp_path / "fleet.json").write_text(json.dumps(CARS))
    options = {"fleet": tmp_path / "fleet.json", "detections": tmp_path / "boxes.json", "focal_px": FOCAL}
    one = orthoscale.photo(tmp_path / "0.jpg", **options)
    assert len(str(one).splitlines()) == 2 and "0.jpg      altitude " in str(one)
    many = orthoscale.photo(sorted(tmp_path.glob("*.jpg")), together=True, **options)
    assert len(str(many).splitlines()) < 10 and "9 of 9 measured" in str(many) and "3 more" in str(many)
    assert many._repr_html_().startswith("<table>")
    assert len(json.loads(json.dumps(many.to_dict()))["rows"]) == 9


@pytest.mark.slow
def test_apply_takes_one_file_or_several(tmp_path):
    fixed_model(tmp_path, report="none", mode="planar")
    (tmp_path / "a.obj").write_text("v 1 2 3\n")
    scale = json.loads((tmp_path / "scaled/sim3.json").read_text())["scale"]
    for k, files in enumerate((tmp_path / "a.obj", [tmp_path / "a.obj"])):
        written = orthoscale.apply(tmp_path / "scaled/sim3.json", files, tmp_path / f"metric{k}")
        (target,) = written
        (vertex,) = [line for line in target.read_text().splitlines() if line.startswith("v ")]
        assert float(vertex.split()[1]) == pytest.approx(scale, rel=1e-6)


@pytest.mark.slow
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


def path_arguments(folder):
    """Every path that a public function takes: a call with it, and what it names, which need not be there."""
    found = orthoscale.load_detections(folder / "detections.json")
    ruler = orthoscale.Calibration("d", "0", found.ruler, None, {})
    image, boxes = folder / "park.png", {"fleet": "DE", "detections": folder / "detections.json"}
    return {
        "estimate": (lambda path: orthoscale.estimate(path, **boxes), image),
        "check": (lambda path: orthoscale.check(path, **boxes), folder / "none.tif"),
        "fix": (lambda path: orthoscale.fix(path, folder / "a.tif", report="none", **boxes), image),
        "fix, out": (lambda path: orthoscale.fix(image, path, report="none", **boxes), folder / "b.tif"),
        "fix, save_detections": (
            lambda path: orthoscale.fix(image, folder / "c.tif", report="none", save_detections=path, **boxes),
            folder / "c.json",
        ),
        "apply": (lambda path: orthoscale.apply(path, image, folder / "m"), folder / "none.json"),
        "apply, files": (lambda path: orthoscale.apply(folder / "none.json", path, folder / "m"), image),
        "apply, one of files": (lambda path: orthoscale.apply(folder / "none.json", [path], folder / "m"), image),
        "apply, out": (lambda path: orthoscale.apply(folder / "none.json", image, path), folder / "m"),
        "calibrate": (lambda path: orthoscale.calibrate(path, gsd=0.1), folder / "none.tif"),
        "calibrate, detector": (lambda path: orthoscale.calibrate(image, gsd=0.1, detector=path), folder / "n.onnx"),
        "calibrate, fleet": (lambda path: orthoscale.calibrate(image, gsd=0.1, fleet=path), folder / "none.json"),
        "photo": (lambda path: orthoscale.photo(path, focal_px=1000.0, **boxes), image),
        "photo, one of paths": (lambda path: orthoscale.photo([path], focal_px=1000.0, **boxes), image),
        "photo, lens_file": (lambda path: orthoscale.photo(image, lens_file=path, **boxes), folder / "none.xml"),
        "load_fleet": (orthoscale.load_fleet, folder / "none.json"),
        "save_detections": (lambda path: orthoscale.save_detections(found, path), folder / "kept.json"),
        "load_detections": (orthoscale.load_detections, folder / "kept.json"),
        "save_calibration": (lambda path: orthoscale.save_calibration(ruler, path), folder / "ruler.json"),
        "load_calibration": (orthoscale.load_calibration, folder / "ruler.json"),
    }


@pytest.mark.slow
def test_every_path_may_be_text_and_nothing_else_passes_for_one(tmp_path):
    """Text does what a path does, be it an error; a number would be an open file, an empty text the current folder."""
    car_park(tmp_path)
    done = {}
    for kind in (str, tmp_path.__class__):
        for name, (call, path) in path_arguments(tmp_path).items():
            try:
                done.setdefault(name, []).append(type(call(kind(path))).__name__)
            except orthoscale.OrthoscaleError as error:
                done.setdefault(name, []).append(str(error))
        for made in "abc":
            (tmp_path / f"{made}.tif").unlink()
        (tmp_path / "c.json").unlink()
    assert {name: said for name, said in done.items() if said[0] != said[1]} == {}
    assert done["load_detections"] == ["Detections"] * 2 and done["load_calibration"] == ["Calibration"] * 2
    public = {name for name in orthoscale.__all__ if name[0].islower()}
    assert {name.split(",")[0] for name in done} == public
    for name, (call, _) in path_arguments(tmp_path).items():
        for wrong in (5, b"x.json", 0.5, object(), "", "a\0b", [None], *([] if "," in name else [None])):
            with pytest.raises(orthoscale.OrthoscaleError, match="expected|fleet is called") as error:
                call(wrong)
            assert error.value.exit_code == 2, (name, wrong)
