"""Parking rows and objects of standard size in the frames of a model, whose metres are known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.bodies import body
from support.flights import enclosing, found_by
from support.models import make_model, put_frames, save

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import Detections
from orthoscale.core.evidence import Evidence
from orthoscale.core.measuring.footing import GROUND_SD, Footing
from orthoscale.core.measuring.in_view import frames_in_view
from orthoscale.core.measuring.method import Method
from orthoscale.core.measuring.surroundings import objects_in_model, rows_in_model
from orthoscale.core.measuring.ways import measure_source
from orthoscale.core.pooling.agreement import compare, together
from orthoscale.core.pooling.anchors import evidence_of
from orthoscale.core.remarks import CAUTION, INFO, REFUSAL, Remark
from orthoscale.core.ruler import Ruler
from orthoscale.core.scale import Scale
from orthoscale.core.votes import Sightings, gather
from orthoscale.fleets import load_fleet
from orthoscale.formats.tables import standards
from orthoscale.sources.colmap import ColmapSource

UNIT, STALL = 5.0, 2.5  # [m]
FLEET = load_fleet("DE")
HEIGHT = 0.5  # of the vehicles' boxes [m]
COURT, CONTAINER = (23.77, 10.97, 0.01), (12.192, 2.438, 2.591)


def block(size, place, heading):
    """(8, 3) corners of a block [units], and (2, 3) two points along it, on the plane z = 0."""
    axes = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    flat = np.array([[x, y] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * size[:2] @ axes / UNIT + place
    body = np.concatenate([np.pad(flat, ((0, 0), (0, 1)), constant_values=z) for z in (0, size[2] / UNIT)])
    return body, np.pad(place + np.array([[-0.05], [0.05]]) * axes[0], ((0, 0), (0, 1)))


def car(size, place, heading):
    """The same of a vehicle of `size` (2,) [m]."""
    plan, heights = body(top=HEIGHT)
    axes = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    points = np.column_stack([plan * size @ axes / UNIT + place, heights / UNIT])
    return points, np.pad(place + np.array([[-0.05], [0.05]]) * axes[0], ((0, 0), (0, 1)))


def car_park(stall=STALL):
    """36 vehicles in three rows, each within 0.1 m of its stall's middle."""
    rng = np.random.default_rng(0)
    sizes = FLEET.sample(rng, 36)[:, :2]
    slots = np.array([[stall * (k % 12 - 6), 11.0 * (k // 12 - 1)] for k in range(36)])
    slots = (slots + rng.normal(0, 0.1, slots.shape)) / UNIT
    return [car(s, p, np.pi / 2 + rng.normal(0, 0.02)) for s, p in zip(sizes, slots, strict=True)]


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A model's source, and how its world is turned."""
    folder = tmp_path_factory.mktemp("flight")
    built, turn = make_model()
    save(built, folder / "sparse" / "0", "bin")
    put_frames(built, folder / "images")
    return ColmapSource.open(folder), turn


def boxes_of(model, bodies, noise=0.3):
    """Boxes by frame of those bodies that it shows whole."""
    source, turn = model
    rng, out = np.random.default_rng(1), {}
    for name in source.picture_names:
        width, height = source.image_size(name)
        rows = []
        for points, ends in bodies:
            points, heading = source.project(name, points @ turn.T), source.project(name, ends @ turn.T)
            if np.isfinite(points).all() and (points > 6).all() and (points < (width - 6, height - 6)).all():
                rows.append(enclosing(points, heading[1] - heading[0], rng.normal(0, noise, 2)))
        out[name] = Boxes(np.array(rows).reshape(-1, 5), np.full(len(rows), 0.9))
    return out


def found_in(model, stall=STALL):
    ruler = Ruler(margin=(0.0, 0.0), margin_sd=(0.5, 0.5), noise=(0.3, 0.3))
    return Detections(boxes_of(model, car_park(stall)), 1.0, ruler, (HEIGHT, HEIGHT), "perfect")


@pytest.fixture(scope="module")
def scales(model):
    """The scale with the rows, and without."""
    return tuple(
        measure_source(model[0], found_in(model), FLEET, Method(standards=s)).scale for s in (standards(), None)
    )


def test_rows_seen_in_many_frames_are_one_measurement(scales):
    scale, without = scales
    (pitch,) = scale.evidence
    assert pitch.kind == "parking bays" and pitch.value == pytest.approx(UNIT, rel=0.02)
    assert 0.05 < pitch.relative_sd < 0.09, "as sure as the standard, however many frames there are"
    assert "36 in a row" in pitch.says and scale.parts["parking bays"] > 0 and scale.conflict == 0
    low, high = scale.interval90
    assert low < UNIT < high
    assert not without.evidence and without.relative_sd > scale.relative_sd


@pytest.mark.parametrize("shared", [0.003, 0.04])
def test_rows_err_with_the_ground_on_which_their_vehicles_stand(shared):
    """As objects and anchors do: better known where vehicles tell it, worse where trees hide it."""
    stalls = np.array([[2.5 * k, 6.0 * row, 0.0] for row in range(3) for k in range(12)]) / UNIT
    size = np.full((len(stalls), 2), (4.5, 1.8)) / UNIT
    votes = gather(Sightings(size, np.full(len(stalls), 0.01), stalls, np.ones(len(stalls))), repeated=False)
    along = np.tile([0.0, 1.0, 0.0], (len(stalls), 1))
    footing = Footing(stalls, np.zeros(len(stalls)), np.full(len(stalls), 0.02), shared)
    (vote,), (alone,) = (rows_in_model(votes, along, standards(), "DE", *more) for more in ((footing,), ()))
    assert vote.shared_sd == pytest.approx(shared) and alone.shared_sd == GROUND_SD
    assert vote.relative_sd == pytest.approx(np.hypot(alone.relative_sd, 0.02))


def test_vehicles_that_only_one_of_many_frames_shows_make_no_row():
    stalls = np.array([[2.5 * k, 6.0 * row, 0.0] for row in range(3) for k in range(12)]) / UNIT
    size, along = np.full((len(stalls), 2), (4.5, 1.8)) / UNIT, np.tile([0.0, 1.0, 0.0], (len(stalls), 1))
    votes = gather(Sightings(size, np.full(len(stalls), 0.01), stalls, np.ones(len(stalls))), repeated=False)
    (row,) = rows_in_model(replace(votes, shown=np.full(len(stalls), 2)), along, standards(), "DE")
    assert row.anchor.count == len(stalls)
    assert not rows_in_model(replace(votes, shown=np.full(len(stalls), 9)), along, standards(), "DE")


@pytest.mark.parametrize("lowest, count", [(0, 2), (40, 1), (80, 0)])
def test_a_frame_that_sees_a_place_from_too_low_does_not_count(lowest, count):
    """From one side at 45 degrees, and from the other at 26; a third camera looks elsewhere."""
    centres = {"near": np.array([1.0, 0, 1]), "far": np.array([-2.0, 0, 1]), "away": np.array([0.0, 0, 1])}
    source = SimpleNamespace(
        ground=SimpleNamespace(up=np.array([0.0, 0, 1])),
        centre=centres.__getitem__,
        image_size=lambda name: (100, 80),
        project=lambda name, place: np.full((len(place), 2), np.nan if name == "away" else 40.0),
    )
    assert frames_in_view(source, centres, np.zeros((1, 3)), 5.0, lowest).tolist() == [count]
    assert frames_in_view(source, centres, np.zeros((1, 3)), 45.0, lowest).tolist() == [0], "cut off"


@pytest.mark.parametrize(("kind", "size"), [("tennis-court", COURT), ("container", CONTAINER)])
def test_an_object_seen_in_many_frames_is_one_measurement(model, kind, size):
    places = [(-3.0, 1.0, 0.3), (2.0, -4.0, 1.4)]
    bodies = [block(size, np.array([x, y]), heading) for x, y, heading in places]
    frames = {name: {kind: boxes} for name, boxes in boxes_of(model, bodies).items()}
    assert sum(len(kinds[kind]) for kinds in frames.values()) > 5
    (found,) = evidence_of(objects_in_model(model[0], frames, 1.0, UNIT, standards()))
    assert found.kind == kind.replace("-", " ") and "2 x" in found.says
    assert abs(np.log(found.value / UNIT)) < (0.01 if kind == "tennis-court" else 1.5 * found.relative_sd)
    assert found.relative_sd < (0.02 if kind == "tennis-court" else 0.12)


@pytest.mark.parametrize("size", [CONTAINER, (13.716, 2.438, 2.591), (16.154, 2.591, 2.591)])
def test_what_a_boxs_height_leaves_open_is_not_what_its_standard_does(model, size):
    """Boxes that reach higher look like those of shorter containers; heights alone change the scale by some 8 %."""
    bodies = [block(size, np.array([-3.0, 1.0]), 0.3)]
    frames = {name: {"container": boxes} for name, boxes in boxes_of(model, bodies).items()}
    (vote,) = objects_in_model(model[0], frames, 1.0, UNIT, standards())
    assert vote.kind_sd == pytest.approx(0.08 / np.sqrt(12), rel=0.2)
    assert vote.shared_sd == GROUND_SD, "vehicles do not err by how high containers are"


def test_an_object_cut_by_the_frame_or_of_another_shape_says_nothing(model):
    name = model[0].picture_names[0]
    width, height = model[0].image_size(name)
    cut = Boxes(np.array([[60.0, height / 2, 130, 60, 0.0]]), np.ones(1))
    square = Boxes(np.array([[width / 2, height / 2, 100, 99, 0.0]]), np.ones(1))
    assert objects_in_model(model[0], {name: {"tennis-court": cut}}, 1.0, UNIT, standards()) == []
    assert objects_in_model(model[0], {name: {"tennis-court": square}}, 1.0, UNIT, standards()) == []


def test_a_court_that_contradicts_the_vehicles_is_a_conflict(model, scales):
    wrong = [block((1.5 * COURT[0], 1.5 * COURT[1], 0.01), np.array([-1.0, 5.5]), 0.0)]
    objects = {name: {"tennis-court": boxes} for name, boxes in boxes_of(model, wrong).items()}
    scale = measure_source(
        model[0], replace(found_in(model), objects=objects), FLEET, Method(standards=standards())
    ).scale
    assert scale.conflict > 3 and scale.verdict == "unusable"
    assert any("conflict" in remark.text and "tennis court" in remark.text for remark in scale.remarks)
    low, high = scale.interval90
    assert low < UNIT / 1.5 and high > UNIT
    for pair in ((scale, scales[0]), (scales[0], scale)):
        both = together(compare(dict(zip(("oblique", "planar"), pair, strict=True))))
        assert both.interval90 == scale.interval90 and both.verdict == "unusable", "a conflict is never averaged away"


def test_a_distance_that_contradicts_one_mode_stands_with_the_vehicles_of_that_mode(tmp_path):
    """The one is less sure, since it has boxes of two frames only: it allows what the other does not."""
    built, turn = make_model()
    save(built, tmp_path / "sparse" / "0", "bin")
    put_frames(built, tmp_path / "images")
    source, found = ColmapSource.open(tmp_path), found_by(tmp_path, turn)
    found = replace(found, boxes=dict(list(found.boxes.items())[:2]))
    planar = measure_source(source, found, FLEET).modes["planar"].scale
    one_sided = 0
    for sigmas in (-4.0, -3.5, 3.5, 4.0):
        value = float(planar.value * np.exp(sigmas * planar.relative_sd))
        method = Method(evidence=(Evidence("known distance", value, 0.002, "a distance"),))
        measured = measure_source(source, found, FLEET, method)
        contradicted = [name for name, mode in measured.modes.items() if mode.scale.conflict]
        if contradicted == ["planar"]:
            one_sided += 1
            assert measured.scale.conflict > 3 and measured.scale.verdict == "unusable"
            assert len(measured.scale.used) == len(measured.votes) == len(measured.modes["planar"].votes)
            assert len(measured.vehicles) == len(measured.votes)
    assert one_sided


def test_a_distance_that_only_one_of_two_has_is_no_contradiction():
    """One scale rests on a distance and the other on the fleet: they differ by the fleet's error."""
    rng, contradicting = np.random.default_rng(0), 0
    parts = {"sampling": 0.01, "fleet": 0.035, "margin": 0.03}
    told = {"sampling": 0.0003, "fleet": 0.0005, "margin": 0.0005, "known distance": 0.003}

    def scale(value, parts):
        every = np.ones(50, bool)
        return Scale(value, "m/px", (0.9, 1.1), parts, {}, (0.6, 0.4), 0.0, "DE", "fair", every, [""] * 50)

    for _ in range(400):
        by_vehicles = np.exp(rng.normal(0, np.sqrt(sum(sd**2 for sd in parts.values()))))
        by_distance = np.exp(rng.normal(0, 0.003))
        contradicting += compare({"a": scale(by_distance, told), "b": scale(by_vehicles, parts)}).contradicts
    assert contradicting < 12, "chance makes 4; 75 where the fleet is taken to cancel"
    assert compare({"a": scale(1.0, told), "b": scale(1.2, parts)}).contradicts


@pytest.mark.parametrize("apart", [1.0, 1.5], ids=["pooled", "alone"])
def test_what_is_remarked_on_one_mode_names_it(apart):
    """What is remarked on both needs no name."""
    shared, one, other = (Remark(severity, text) for severity, text in ((INFO, "s"), (CAUTION, "a"), (REFUSAL, "b")))
    every = np.ones(50, bool)

    def scale(value, sd, *remarks):
        low, high = value * (1 - 1.6 * sd), value * (1 + 1.6 * sd)
        parts = {"sampling": sd}
        made = Scale(value, "m/px", (low, high), parts, {}, (0.6, 0.4), 0.0, "DE", "fair", every, [""] * 50)
        return replace(made, remarks=remarks)

    both = {"oblique": scale(1.0, 0.01, shared, one), "planar": scale(apart, 0.02, shared, other)}
    said = [(remark.severity, remark.text) for remark in together(compare(both)).remarks]
    wanted = [(INFO, "s"), (CAUTION, "oblique: a"), (REFUSAL, "planar: b")]
    assert said == (wanted if apart == 1 else wanted[:2])


def test_looks_of_which_one_sees_rows_are_pooled(scales):
    for pair in (scales, scales[::-1]):
        both = together(compare(dict(zip(("oblique", "planar"), pair, strict=True))))
        assert 0 < both.parts["parking bays"] < scales[0].parts["parking bays"] and len(both.evidence) == 1
        low, high = both.interval90
        assert low < UNIT < high
