"""Anchors in pictures of known truth: looked for at the vehicles' scale, found once each, and used."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from support.anchors import HALF, SIDE, SQUARE, SquareFinder, squares
from support.in_process import run
from support.reports import GSD, car_park

import orthoscale
from orthoscale.actions.anchors import own_standards
from orthoscale.anchors import kinds
from orthoscale.anchors.kinds import Kind
from orthoscale.anchors.search import ENOUGH_ANCHORS, Sought, look, search, windows_of
from orthoscale.core.anchors import Anchor, alike
from orthoscale.core.measuring.anchors import _height_above, votes_in_model
from orthoscale.detect.effort import Effort
from orthoscale.errors import InputError, TooLittleEvidence, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.requests import EstimateRequest
from orthoscale.sources.country import country_of
from orthoscale.sources.opening import open_source

MIDDLES = np.array([[1120.3, 150.7], [1300.8, 320.2], [1150.1, 520.6]])


class Sheet:
    """A picture in memory."""

    name = "sheet.png"

    def __init__(self, image):
        self.image = image
        self.height, self.width = image.shape[:2]

    def read(self, x, y, width, height, out_width, out_height):
        part = self.image[y : y + height, x : x + width]
        return cv2.resize(part, (out_width, out_height), interpolation=cv2.INTER_AREA)


@pytest.fixture
def square_finder(monkeypatch, tmp_path):
    """The table of kinds with the tests' finder alone, and an empty cache."""
    monkeypatch.setenv("ORTHOSCALE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(kinds, "ANCHOR_KINDS", {"painted square": Kind("support.anchors:SquareFinder", proven=True)})


def park_with(folder, side=SIDE):
    """A car park, and beside it squares of so many metres."""
    folder.mkdir(exist_ok=True)
    car_park(folder)
    park = cv2.imread(str(folder / "park.png"))
    park = np.minimum(park, 200)  # no vehicle is as bright as a square
    beside = squares(400, len(park), GSD, MIDDLES - [1000, 0], side)
    cv2.imwrite(str(folder / "park.png"), np.concatenate([park, beside], axis=1))
    return folder / "park.png", {"fleet": "DE", "detections": folder / "detections.json"}


def test_squares_narrow_the_scale_of_their_orthophoto(square_finder, tmp_path):
    path, options = park_with(tmp_path / "park")
    without = orthoscale.estimate(path, anchors=["none"], **options)
    found = orthoscale.estimate(path, **options)
    assert found.scale.value == pytest.approx(GSD, rel=0.004)
    assert found.scale.half_width < 0.2 * without.scale.half_width
    places = np.array([anchor.place for anchor in found.anchors.anchors])
    assert places[np.argsort(places[:, 1])] == pytest.approx(MIDDLES, abs=1.0)
    assert found.anchors.without.value == without.scale.value
    (evidence,) = [e for e in found.scale.evidence if e.kind == "painted square"]
    assert evidence.says == "3 x painted square (squares of 10 m, 10 m)"


def test_where_there_are_none_nothing_changes(square_finder, tmp_path):
    car_park(tmp_path)
    options = {"fleet": "DE", "detections": tmp_path / "detections.json"}
    a, b = (orthoscale.estimate(tmp_path / "park.png", anchors=[which], **options) for which in ("none", "all"))
    assert b.scale.value == pytest.approx(a.scale.value, rel=1e-12) and b.scale.interval90 == a.scale.interval90
    assert not b.anchors.anchors


def test_squares_that_contradict_the_vehicles_end_with_exit_code_4(square_finder, tmp_path):
    path, options = park_with(tmp_path / "park")
    alone = orthoscale.estimate(path, anchors=["none"], **options).scale
    # Such that they say 3.3 sigmas less than the vehicles: that is still looked for.
    path, options = park_with(tmp_path / "park", side=SIDE * GSD / alone.value * np.exp(3.3 * alone.relative_sd))
    words = ["--fleet", "DE", "--detections", options["detections"]]
    done = run("estimate", path, *words)
    assert done.returncode == 4 and "painted square" in done.stderr and "conflict: vehicles" in done.stderr
    assert run("estimate", path, *words, "--anchors", "none").returncode == 0


def test_a_users_own_standard_takes_the_place_of_the_finders(square_finder, tmp_path):
    path, options = park_with(tmp_path / "park", side=1.05 * SIDE)
    told = orthoscale.estimate(path, anchor=["square=10.5"], **options)
    assert told.scale.value == pytest.approx(GSD, rel=0.006)
    (tmp_path / "own.json").write_text(
        json.dumps({"standards": [{"kind": "painted square", "metres": 10.5, "sd": 0.02, "name": "ours"}]})
    )
    again = orthoscale.estimate(path, anchor=[str(tmp_path / "own.json")], **options)
    assert again.scale.value == pytest.approx(told.scale.value, rel=1e-3)
    assert "ours" in [e for e in again.scale.evidence if e.kind == "painted square"][0].says


@pytest.mark.parametrize("text", ["circle=3", "square", "square=-1", "square=1,2,3", "square=10,11", "square=nan"])
def test_a_standard_that_makes_no_sense_is_refused(square_finder, text):
    with pytest.raises(UsageError, match="--anchor"):
        own_standards([text])


def test_a_damaged_file_of_standards_is_refused(square_finder, tmp_path):
    (tmp_path / "s.json").write_text('{"standards": [{"kind": "painted square", "metres": -1}]}')
    with pytest.raises(InputError, match="metres"):
        own_standards([str(tmp_path / "s.json")])


def test_a_second_run_looks_at_nothing_again(square_finder, tmp_path, monkeypatch):
    path, options = park_with(tmp_path / "park")
    first = orthoscale.estimate(path, **options)
    monkeypatch.setattr(SquareFinder, "find", lambda *arguments: pytest.fail("looked again"))
    again = orthoscale.estimate(path, **options)
    assert again.scale.interval90 == first.scale.interval90
    (a, *_), (b, *_) = first.anchors.anchors, again.anchors.anchors
    assert a.standards == b.standards and np.array_equal(a.lines, b.lines) and a.picture == b.picture


@pytest.mark.parametrize("gsd", [0.05, 0.13, 0.3])
def test_every_anchor_is_whole_in_a_window_of_the_resolution_that_the_finder_needs(gsd):
    picture = SimpleNamespace(name="a", width=5200, height=1700)
    finder = SquareFinder()
    tiles = windows_of(picture, gsd, finder)
    reach = finder.extent / gsd
    assert {round(tile.width / tile.out_width * gsd, 2) for tile in tiles} == {max(gsd, finder.finest)}
    for x in np.linspace(0, picture.width - reach, 60):
        for y in np.linspace(0, picture.height - reach, 20):
            assert any(t.x <= x and t.y <= y and x + reach <= t.x + t.width and y + reach <= t.y + t.height
                       for t in tiles)  # fmt: skip


def test_an_anchor_of_a_window_has_the_pictures_pixels():
    sheet = Sheet(squares(900, 900, 0.1, [[640.3, 455.9]]))
    for tile in windows_of(sheet, 0.1, SquareFinder()):
        (found,) = look(SquareFinder(), sheet, tile, 0.1, 0.05)
        assert tile.out_width < tile.width and found.picture == "sheet.png"
        assert found.place == pytest.approx([640.3, 455.9], abs=0.15)
        assert found.pixels == pytest.approx(100, rel=0.01)
        assert found.lines.reshape(-1, 2).mean(0) == pytest.approx([640.3, 455.9], abs=0.6)


@pytest.mark.parametrize("kind", kinds.ANCHOR_KINDS)
def test_in_a_picture_of_a_few_pixels_there_is_none(kind):
    """Nor does a finder fail on it: pictures may be narrow, and the last windows of a picture, too."""
    rng = np.random.default_rng(0)
    for height, width in ((1, 1), (2, 3), (1, 300), (7, 8), (15, 60)):
        grey = np.full((height, width, 3), 90, np.uint8)
        striped = grey.copy()
        striped[::4] = 230
        for image in (grey, striped, rng.integers(0, 256, grey.shape, np.uint8)):
            for turned in (image, np.ascontiguousarray(image.transpose(1, 0, 2))):
                for gsd in (0.05, 0.3):
                    assert list(kinds.finder(kind, {}).find(turned, gsd, 0.1, "US")) == []


@pytest.mark.slow
def test_what_overlapping_windows_show_counts_once_and_enough_is_enough(monkeypatch):
    monkeypatch.setattr("orthoscale.anchors.search.FIRST_WINDOWS", 3)  # of nine
    x, y = np.meshgrid(np.arange(100, 2300, 160), np.arange(100, 2300, 160))
    sheet = Sheet(squares(2400, 2400, 0.2, np.stack([x, y], -1)))
    finder = SquareFinder()
    every = search([Sought(finder, [(sheet, 0.2)])], 0.05, effort=Effort(exhaustive=True, cache=False, workers=1))
    assert len(every) == x.size
    some = search([Sought(finder, [(sheet, 0.2)])], 0.05, effort=Effort(cache=False, workers=1))
    assert ENOUGH_ANCHORS <= len(some) < x.size
    again = search([Sought(finder, [(sheet, 0.2)])], 0.05, effort=Effort(cache=False, workers=3))
    assert [tuple(a.place) for a in some] == [tuple(a.place) for a in again]


def test_lines_that_lie_on_one_another_are_one_thing():
    court = np.array([[[0, 0], [24, 0]], [[0, 11], [24, 11]], [[0, 0], [0, 11]], [[24, 0], [24, 11.0]]])
    moved = [court, court + [0.5, 0.3], court + [0, 14.0], court[:1] + [0.2, 0.1]]
    number = alike(moved, [24.0] * 4)
    assert number[0] == number[1] == number[3] != number[2]


class FlatView:
    """A picture of level ground, `unit` model units a pixel, whose first pixel is at `corner`; of the frame `image`."""

    camera_height = 10.0

    def __init__(self, corner, unit, image=""):
        self.corner, self.unit, self.image = np.array(corner), unit, image

    def ground(self, points):
        return np.pad(self.corner + points * self.unit, ((0, 0), (0, 1)))


UNIT_SQUARE = np.array([[[0, 0], [1, 0]], [[1, 0], [1, 1]], [[1, 1], [0, 1]], [[0, 1], [0, 0.0]]])


def square_seen(view, name, corner, size, count=1):
    """A square of `size` at `corner` [units] as the picture `name` of the ground has it."""
    lines = (UNIT_SQUARE * size + corner - view.corner) / view.unit
    place, pixels = lines.mean((0, 1)), size / view.unit
    return Anchor("painted square", place, lines, pixels, 0.01, np.zeros(4), (SQUARE,), 0.01, count=count, picture=name)


def straight_down(name):
    """Of every frame the camera stands above the same place: no parallax."""
    return np.array([2.5, 2.5, 10.0])


def test_an_anchor_in_many_frames_is_one_vote():
    views = {"a": FlatView([0.0, 0.0], 0.02), "b": FlatView([-3.0, 1.0], 0.04), "c": FlatView([9.0, 0.0], 0.02)}
    seen = (("a", [2.0, 2.0], 1.0), ("b", [2.05, 1.98], 1.02), ("c", [11.0, 2.0], 1.0))
    anchors = [square_seen(views[name], name, corner, size) for name, corner, size in seen]
    one, two = votes_in_model(anchors, views, straight_down, 0.2)
    assert (one.views, two.views) == (2, 1)
    assert one.units == pytest.approx(np.sqrt(1.02), rel=1e-3) and two.units == pytest.approx(1.0)
    assert one.place == pytest.approx([2.5, 2.5, 0], abs=0.1)
    assert one.relative_sd == pytest.approx(0.01 * np.sqrt(0.75), rel=0.01)
    assert one.shared_sd == pytest.approx(0.01, rel=0.01) and two.shared_sd == pytest.approx(0.01)


def test_of_the_frames_of_an_anchor_the_surer_ones_count_more():
    views = {name: FlatView([0.0, 0.0], 0.02) for name in ("a", "b")}
    anchors = [
        replace(square_seen(views[name], name, [2.0, 2.0], size), relative_sd=sd, false=false)
        for name, size, sd, false in (("a", 1.0, 0.03, 0.1), ("b", 1.04, 0.01, 0.02))
    ]
    (vote,) = votes_in_model(anchors, views, straight_down, 0.2)
    assert np.log(vote.units) == pytest.approx(0.9 * np.log(1.04), rel=0.005), "inverse variances: nine to one"
    assert vote.anchor.picture == "b"
    mean = 0.5 * (0.1 * 0.03**2 + 0.9 * 0.01**2) + 0.5 * (0.1**2 * 0.03**2 + 0.9**2 * 0.01**2)
    assert vote.relative_sd == pytest.approx(np.sqrt(mean), rel=0.02)


@pytest.mark.parametrize("frames, placed", [(2, 0.003), (3, 0.003), (9, 0.01)])
def test_how_high_a_thing_lies_is_known_as_well_as_is_said(placed, frames):
    """Few frames place it as well as frames do, many show that they do worse; the ground is known to a hundredth."""
    error, claimed = [], []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        cameras = np.column_stack([rng.uniform(-4, 4, (frames, 2)), np.full(frames, 10.0)])
        above = 0.1 * rng.standard_normal()
        places = cameras + (np.array([1.0, 1.0, above]) - cameras) * (10 / (10 - above))
        places[:, :2] += rng.normal(0, 10 * placed, (frames, 2))
        found, by_frames, left = _height_above(places, cameras, np.full(frames, 10.0), 0.01)
        error.append((found - above) / 10)
        claimed.append(np.hypot(by_frames, 0.01 * left))
    assert 0.88 < np.sqrt(np.mean(np.square(error)) / np.mean(np.square(claimed))) < 1.2


@pytest.mark.parametrize("above", [0.0, 0.1, -0.15])
def test_frames_tell_how_high_a_thing_lies(above):
    """From rays to a square above or below the ground, as the ground's pictures show it, and one that is off."""
    cameras = {f"{x},{y}": np.array([x, y, 10.0]) for x in (-2.0, 2.0, 5.0) for y in (-1.0, 3.0, 6.0)}
    views = {f"ground/{name}": FlatView([-20.0, -20.0], 0.02, name) for name in cameras}
    anchors = []
    for name, view in views.items():
        foot, larger = cameras[view.image][:2], 10 / (10 - above)
        anchors.append(square_seen(view, name, foot + (np.array([2.0, 2.0]) - foot) * larger, larger))
    anchors[4] = square_seen(views["ground/2.0,3.0"], "ground/2.0,3.0", [2.25, 2.0], 1.02)
    (vote,) = votes_in_model(anchors, views, cameras.__getitem__, 0.2)
    assert vote.views == 8
    assert vote.units == pytest.approx(1.0, rel=0.0015)
    assert vote.shared_sd < 0.001
    assert 0.003 < np.sqrt(vote.relative_sd**2 - 0.01**2 * (0.5 + 0.5 / 8)) < 0.005


def test_rows_do_not_tell_how_high_they_lie():
    """Each frame may show another part of a row: that is no parallax."""
    cameras = {"a": np.array([0.0, 0, 10]), "b": np.array([4.0, 0, 10])}
    views = {name: FlatView([0.0, 0.0], 0.02, name) for name in cameras}
    anchors = [square_seen(views["a"], "a", [2.0, 2.0], 1.0, 6), square_seen(views["b"], "b", [2.08, 2.0], 1.0, 6)]
    (vote,) = votes_in_model(anchors, views, cameras.__getitem__, 0.2)
    assert vote.units == pytest.approx(1.0) and vote.shared_sd == 0.01


@pytest.fixture
def two_kinds(square_finder, monkeypatch):
    """A second kind beside it."""
    more = {"small square": Kind("support.anchors:small_squares", proven=True)}
    monkeypatch.setattr(kinds, "ANCHOR_KINDS", kinds.ANCHOR_KINDS | more)


def empty_lot(folder, small):
    """A picture without vehicles, of squares of 10 m and of 6 m or not, and a file without boxes."""
    image = squares(1500, 900, GSD, MIDDLES)
    if small:
        image = np.minimum(image, 255)
        beside = squares(1500, 900, GSD, [[300.2, 200.7], [500.4, 500.1]], 6.0)
        image[:, :800] = beside[:, :800]
    cv2.imwrite(str(folder / "lot.png"), image)
    (folder / "none.json").write_text(json.dumps({"lot.png": []}))
    return folder / "lot.png", {"fleet": "DE", "detections": folder / "none.json"}


def test_two_kinds_that_agree_give_a_scale_without_vehicles(two_kinds, tmp_path):
    path, options = empty_lot(tmp_path, small=True)
    found = orthoscale.fix(path, tmp_path / "out.tif", also=["gpkg", "tiles"], **options)
    assert found.scale.value == pytest.approx(GSD, rel=0.005) and found.scale.half_width < 0.01
    assert "no vehicles: the scale rests on" in found.remarks[0].text and "small square" in found.remarks[0].text
    assert found.scale.vehicles_used == 0 and found.scale.verdict == "good"
    page = re.sub(r"base64,[^\"]+", "", (tmp_path / "out.tif.html").read_text())
    assert "No vehicles" in page and "squares of 6 m" in page and "nan" not in page.lower()
    done = run("estimate", path, "--fleet", "DE", "--detections", options["detections"])
    assert done.returncode == 0 and "painted square" in done.stdout
    with pytest.raises(TooLittleEvidence, match="0 usable vehicles"):
        orthoscale.estimate(path, estimator="iqr", **options)  # the paper's takes vehicles only


def test_what_was_looked_for_at_some_scale_is_not_called_too_small(two_kinds, tmp_path, monkeypatch):
    monkeypatch.setattr("orthoscale.actions.anchors.LADDER", (0.03, 2.0))  # squares are sought up to 0.5 m/px
    path, options = empty_lot(tmp_path, small=True)
    found = orthoscale.estimate(path, **options)
    assert found.scale.evidence and not [r.text for r in found.remarks if "too small to be seen" in r.text]


def test_one_thing_found_at_two_scales_is_one_anchor_of_either_size(two_kinds, monkeypatch, tmp_path):
    both = {"painted square": Kind("support.anchors:squares_of_two_sizes", proven=True)}
    monkeypatch.setattr(kinds, "ANCHOR_KINDS", kinds.ANCHOR_KINDS | both)
    path, options = empty_lot(tmp_path, small=True)
    found = orthoscale.estimate(path, **options)
    assert found.scale.value == pytest.approx(GSD, rel=0.005)
    of_either = [vote for vote in found.anchors.votes if vote.anchor.kind == "painted square"]
    assert [{s.metres for s in vote.anchor.standards} for vote in of_either] == [{SQUARE.metres, HALF.metres}] * 5


@pytest.mark.slow
def test_one_kind_gives_none_without_vehicles_but_one_and_a_known_distance_do(square_finder, tmp_path):
    path, options = empty_lot(tmp_path, small=False)
    with pytest.raises(TooLittleEvidence, match="0 usable vehicles"):
        orthoscale.estimate(path, **options)
    found = orthoscale.estimate(path, known_distance=["10,20 310,420 50.2 0.4"], **options)
    assert found.scale.value == pytest.approx(GSD, rel=0.005) and found.scale.vehicles_used == 0
    assert {e.kind for e in found.scale.evidence} == {"known distance", "painted square"}
    image = np.zeros((300, 400, 3), np.uint8)
    cv2.imwrite(str(path), image)
    with pytest.raises(TooLittleEvidence, match="0 usable vehicles"):
        orthoscale.estimate(path, known_distance=["10,20 310,220 36.2 0.4"], **options)


@pytest.mark.slow
def test_what_a_scale_rests_on_is_in_the_list():
    """They were looked for at another scale than by `estimate`, and lane dashes of the example were not among them."""
    town = Path(__file__).parents[1] / "examples/town/ortho.jpg"
    used = orthoscale.estimate(town, fleet="DE").anchors.votes
    done = run("anchors", town, "--fleet", "DE", "--json")
    listed = [(a["kind"], a["standard"]) for a in json.loads(done.stdout)["anchors"]]
    assert {kind for kind, _ in listed} >= {vote.anchor.kind for vote in used} == {"zebra crossing", "lane dashes"}
    assert len(listed) >= len(used)


def test_the_command_lists_and_draws_them(two_kinds, tmp_path):
    path, _ = empty_lot(tmp_path, small=True)
    done = run("anchors", path, "--scale", "0.101", "--out", tmp_path / "list", "--json")
    told = json.loads(done.stdout)
    assert [a["kind"] for a in told["anchors"]].count("painted square") == 3
    assert all(a["scale"] == pytest.approx(GSD, rel=0.005) and a["residual_cm"] < 5 for a in told["anchors"])
    assert json.loads((tmp_path / "list" / "anchors.json").read_text()) == told
    assert cv2.imread(str(tmp_path / "list" / "anchors.png")) is not None
    layer = read_dataframe(tmp_path / "list" / "anchors.gpkg", "anchors")
    assert layer == ["painted square"] * 3 + ["small square"] * 2
    few = run("anchors", path, "--scale", "0.101", "--anchors", "all", "--json")
    assert len(json.loads(few.stdout)["anchors"]) == 5
    assert run("anchors", path, "--scale", "-1").returncode == run("anchors", path, "--scale", "1e-308").returncode == 2
    done = run("anchors", path, "--estimator", "iqr")
    assert done.returncode == 2 and "--estimator iqr" in done.stderr and "Remove --estimator." in done.stderr


@pytest.mark.parametrize("form", ["png", "json", "gpkg"])
def test_a_name_with_an_ending_is_one_file(two_kinds, tmp_path, form):
    path, _ = empty_lot(tmp_path, True)
    out = tmp_path / f"found.{form}"
    done = run("anchors", path, "--scale", "0.101", "--out", out)
    assert done.returncode == 0 and out.is_file(), done.stderr
    if form == "png":
        assert cv2.imread(str(out)) is not None
    elif form == "json":
        assert len(json.loads(out.read_text())["anchors"]) == 5
    else:
        assert len(read_dataframe(out, "anchors")) == 5
    assert run("anchors", path, "--scale", "0.101", "--anchors", "small-square", "--out", out).returncode == 2
    assert run("anchors", path, "--scale", "0.101", "--out", out, "--overwrite").returncode == 0
    none = run("anchors", path, "--scale", "0.3", "--out", tmp_path / f"nothing.{form}")
    assert none.returncode == (3 if form == "gpkg" else 0) and "Traceback" not in none.stderr


def test_a_list_of_another_form_is_refused(two_kinds, tmp_path):
    path, _ = empty_lot(tmp_path, False)
    done = run("anchors", path, "--scale", "0.101", "--out", tmp_path / "found.jpg")
    assert done.returncode == 2 and ".png" in done.stderr and not (tmp_path / "found.jpg").exists()
    assert run("anchors", path, "--scale", "0.101", "--out", tmp_path / "found.v2").returncode == 0
    assert (tmp_path / "found.v2" / "anchors.json").is_file()


def read_dataframe(path, layer):
    """The kinds of a layer's features."""
    import pyogrio

    _, _, _, (kinds_there, *_) = pyogrio.raw.read(path, layer, columns=["kind"])
    return kinds_there.tolist()


@pytest.mark.slow
def test_a_report_says_what_each_anchor_is_and_how_much_it_helps(square_finder, tmp_path):
    path, options = park_with(tmp_path / "park")
    orthoscale.fix(path, tmp_path / "out.tif", also=["gpkg"], **options)
    report = json.loads((tmp_path / "out.tif.json").read_text())
    (one, *_) = report["anchors"]
    assert (one["standard"], one["counted"], len(one["lines_px"])) == ("squares of 10 m", True, 4)
    low, high = report["without_anchors"]["interval90"]
    assert high - low > 5 * (report["interval90"][1] - report["interval90"][0])
    page = (tmp_path / "out.tif.html").read_text()
    assert "What else has a known size?" in page and "painted square: squares of 10 m" in page
    assert read_dataframe(tmp_path / "out.tif.gpkg", "anchors") == ["painted square"] * 3
    done = run("report", tmp_path / "out.tif.json", "--out", tmp_path / "again.html")
    assert done.returncode == 0 and "What else has a known size?" in (tmp_path / "again.html").read_text()


@pytest.mark.parametrize("code, country", [("US_cars", "US"), ("DE", "DE"), ("WORLD", ""), ("EU", ""), ("R_WEU", "")])
def test_the_country_is_the_fleets_where_the_picture_does_not_say(tmp_path, code, country):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((40, 40, 3), np.uint8))
    source = open_source(tmp_path / "a.png")
    assert country_of(source, replace(load_fleet("DE"), code=code)) == country
    assert country_of(source, None) == ""


def test_as_many_look_at_once_as_memory_allows(monkeypatch):
    sheet, busy, most = Sheet(squares(3000, 1500, 0.2, [[300, 300]])), [0], [0]

    class Slow(SquareFinder):
        def find(self, *arguments):
            busy[0] += 1
            most[0] = max(most[0], busy[0])
            time.sleep(0.02)
            busy[0] -= 1
            return []

    for memory, threads in ((2**30, 3), (2**26, 1)):
        monkeypatch.setattr("orthoscale.system.budget._budget", memory)
        most[0] = 0
        search([Sought(Slow(), [(sheet, 0.2)])], 0.05, effort=Effort(cache=False, workers=3))
        assert most[0] == threads


def test_none_and_a_kind_contradict_each_other():
    with pytest.raises(UsageError, match="contradict each other"):
        EstimateRequest(anchors=("none", "tennis-court"))
    with pytest.raises(UsageError, match="--anchor does nothing here: --anchors none"):
        EstimateRequest(anchors=("none",), anchor=("bay=2.5",))
    with pytest.raises(UsageError, match="for vehicles only"):
        EstimateRequest(estimator="iqr", anchors=("all",))


def test_more_windows_than_memory_has_room_for_are_refused():
    huge = SimpleNamespace(name="huge.vrt", width=2**28, height=2**28)
    with pytest.raises(InputError, match="huge.vrt"):
        windows_of(huge, 0.1, SquareFinder())
