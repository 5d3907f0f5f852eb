"""Simulated blocks of frames: woods, few points, a focal length that is too long, and vehicles that two ways see."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from support.blocks import Conditions, fly

from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring import oblique
from orthoscale.core.measuring.in_view import frames_in_view, pictures_with_boxes
from orthoscale.core.measuring.joining import united
from orthoscale.core.measuring.judgement import judgements
from orthoscale.core.measuring.measurement import Measurement, Pooled
from orthoscale.core.measuring.method import Method
from orthoscale.core.measuring.oblique import HEIGHT_SD, FramesGeometry, shown_in_frames
from orthoscale.core.measuring.planar_sweep import TOO_COARSE, SweepGeometry
from orthoscale.core.measuring.systematic import ENDS, FITTED_ENDS, FITTED_SIDES, SIDES, Systematic
from orthoscale.core.measuring.ways import measure_source
from orthoscale.core.remarks import CAUTION, REFUSAL, SUPPORT
from orthoscale.core.ruler import Ruler
from orthoscale.core.source import FocalDoubt
from orthoscale.core.verdicts import UNUSABLE
from orthoscale.core.votes import Sightings, gather
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import load_fleet

FLEET = load_fleet("DE")


def error(conditions, seed):
    """log(scale / truth), and what was measured."""
    block = fly(np.random.default_rng(seed), FLEET, conditions, unsure=False)
    measured = measure_source(block.source, block.found, FLEET)
    return float(np.log(measured.scale.value / block.metres_per_unit)), measured, block


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nadir", "grid"])
def test_under_trees_the_vehicles_say_where_the_ground_is(kind):
    off, _, block = error(Conditions(kind, points=500, crowns=1.3, roofs=0.3, bare=0.97, vehicles=50), 3)
    assert np.abs(np.median(block.terrain_error)) > 0.025, "the sheet lies on the ground: nothing is tested"
    assert abs(off) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nadir", "oblique"])
def test_on_a_parking_deck_too(kind):
    off, _, block = error(Conditions(kind, points=300, deck=9.0, bare=0.98, vehicles=40), 7)
    assert np.median(block.terrain_error) > 0.07, "the sheet lies on the deck: nothing is tested"
    assert abs(off) < 0.02


@pytest.mark.slow
def test_vehicles_that_drive_do_not():
    off, measured, _ = error(Conditions("nadir", points=2000, speed=3.0, vehicles=60), 7)
    assert abs(off) < 0.025 and measured.scale.verdict != UNUSABLE


@pytest.mark.slow
def test_a_focal_length_that_is_too_long_leaves_footprints_alone():
    off, *_ = error(Conditions("nadir", focal=0.2, vehicles=50), 4)
    assert abs(off) < 0.02


@pytest.mark.slow
def test_vehicles_beyond_the_points_count(monkeypatch):
    monkeypatch.setattr(oblique, "VIEW_HEIGHT_SD", 0.0)  # what lasts is the ground's alone
    block = fly(np.random.default_rng(5), FLEET, Conditions("nadir", points=1500, vehicles=40), unsure=False)
    everywhere = measure_source(block.source, block.found, FLEET)
    model = block.source._model
    plan = {i: block.source.ground.plane(np.array(p.xyz)[None])[0, 0] for i, p in model.points3D.items()}
    edge = np.percentile(list(plan.values()), 30)
    for number, x in plan.items():
        if x < edge:
            model.delete_point3D(number)
    fewer = replace(block.source)  # without what it remembers of its ground
    measured = measure_source(fewer, block.found, FLEET, mode="oblique")
    assert len(measured.boxes) > 0.9 * len(everywhere.modes["oblique"].boxes)
    assert measured.scale.value == pytest.approx(block.metres_per_unit, rel=0.03)
    sheet = fewer.ground.sd(measured.votes.place)
    assert sheet.max() > 2 * np.median(sheet), "no vehicle stands beyond the points"
    assert measured.votes.lasting[:, 0].max() * fewer.camera_height < sheet.max(), "their parallax knows better"


def way(size, place, noise):
    """What a way of measuring gives that sees vehicles of `size` (N, 2) with relative `noise`."""
    count = len(size)
    votes = gather(Sightings(size, np.full(count, 0.01), place, np.ones(count)), repeated=True)
    scale = replace(_scale(), used=np.ones(count, bool), reasons=[""] * count)
    pooled = Pooled(Ruler(margin_sd=(0.0, 0.0)), Systematic(np.full(2, 0.01)), np.full((count, 2), noise))
    return Measurement(None, np.array([]), votes, scale, {}, votes.size, "exact", pooled=pooled)


def _scale():
    block = fly(np.random.default_rng(1), FLEET, Conditions("nadir", vehicles=20), unsure=False)
    return measure_source(block.source, block.found, FLEET, mode="oblique").scale


@pytest.mark.slow
def test_a_vehicle_that_both_ways_see_counts_once():
    place = 10 * np.arange(8)[:, None] * np.array([1.0, 0, 0])
    size = np.tile([4.5, 1.8], (8, 1))
    a, b = way(size[:6], place[:6], 0.02), way(1.04 * size[2:], place[2:], 0.04)
    votes, ruler, covariance = united(a, b)
    assert len(votes) == 8
    at = {int(round(p[0] / 10)): s for p, s in zip(votes.place, votes.size[:, 0], strict=True)}
    assert at[0] == pytest.approx(4.5) and at[7] == pytest.approx(1.04 * 4.5)
    own, noise_a, noise_b = 0.01**2, 0.02**2 / 4, 0.04**2 / 4  # of the mean of the four that both see
    of_b = (own + noise_a) / (2 * own + noise_a + noise_b)
    assert np.log(at[3] / 4.5) == pytest.approx(of_b * np.log(1.04))
    of_all = (2 + 4 * of_b) / 8  # two more are seen in `b` alone
    assert ruler.margin == (0.0, 0.0) and covariance == pytest.approx(np.eye(2) * own * (of_all**2 + (1 - of_all) ** 2))
    assert np.isnan(votes.kinds).all() and not ruler.kinds


@pytest.mark.slow
def test_what_a_vehicle_is_called_in_both_ways_is_their_mean():
    place = 10 * np.arange(6)[:, None] * np.array([1.0, 0, 0])
    size, table = np.tile([4.5, 1.8], (6, 1)), tuple(map(tuple, np.eye(4)))
    a, b, unknown = way(size[:4], place[:4], 0.02), way(size[1:], place[1:], 0.02), np.full(4, np.nan)
    car, pickup = np.eye(4)[:2]
    a = replace(a, votes=replace(a.votes, kinds=np.array([car, car, unknown, unknown])))
    b = replace(b, votes=replace(b.votes, kinds=np.array([pickup, pickup, unknown, pickup, unknown])))
    told = [replace(m, pooled=replace(m.pooled, ruler=replace(m.pooled.ruler, kinds=table))) for m in (a, b)]
    votes, ruler, _ = united(*told)
    order = np.argsort(votes.place[:, 0])
    expected = np.array([car, (car + pickup) / 2, pickup, unknown, pickup, unknown])
    assert votes.kinds[order] == pytest.approx(expected, nan_ok=True) and ruler.kinds == table
    assert np.isnan(united(a, told[1])[0].kinds[order[0]]).all(), "of a ruler that has no table"


@pytest.mark.slow
def test_the_answer_lies_where_the_vehicles_of_both_ways_do():
    _, measured, block = error(Conditions("nadir", vehicles=40), 6)
    values = [m.scale.value for m in measured.modes.values()]
    assert min(values) * 0.995 < measured.scale.value < max(values) * 1.005
    assert measured.scale.value == pytest.approx(block.metres_per_unit, rel=0.02)


def test_frames_that_show_a_place():
    block = fly(np.random.default_rng(7), FLEET, Conditions("nadir", vehicles=20), unsure=False)
    source, names = block.source, block.source.picture_names
    middles = np.array([[w / 2, h / 2] for w, h in map(source.image_size, names)])
    below = np.concatenate([source.views(n, m[None])[1] for n, m in zip(names, middles, strict=True)])
    one = names[0]
    assert frames_in_view(source, [one], below, 0.0, 25.0)[0] == 1
    assert frames_in_view(source, [one], below, 1e6, 25.0).sum() == 0  # a border that leaves nothing
    far = below[0] + 50 * (below[0] - below[-1])
    assert frames_in_view(source, names, far[None], 0.0, 25.0)[0] == 0
    everywhere = frames_in_view(source, names, below, 0.0, 25.0)
    assert (everywhere >= frames_in_view(source, names, below, 0.0, 89.0)).all() and everywhere.max() > 5
    assert set(pictures_with_boxes(block.found)) == {n for n, boxes in block.found.boxes.items() if len(boxes)}


@pytest.mark.slow
def test_a_mistake_that_one_frame_of_many_shows_does_not_count():
    block = fly(np.random.default_rng(8), FLEET, Conditions("nadir", vehicles=20), unsure=False)
    frames = dict(block.found.boxes)
    middle = sorted(frames)[len(frames) // 2]
    right = measure_source(block.source, block.found, FLEET, mode="oblique")
    stray = Boxes(np.array([[600.0, 450.0, 70.0, 30.0, 0.1]]), np.ones(1))
    frames[middle] = Boxes.concatenate([frames[middle], stray])
    wrong = measure_source(block.source, replace(block.found, boxes=frames), FLEET, mode="oblique")
    assert len(wrong.votes) == len(right.votes) + 1, "the mistake lies on a vehicle"
    assert wrong.votes.fleeting.sum() == right.votes.fleeting.sum() + 1
    assert wrong.votes.shown[wrong.votes.fleeting].min() >= 5
    assert wrong.scale.value == pytest.approx(right.scale.value, rel=1e-4)


@pytest.mark.slow
def test_a_mistake_in_one_picture_of_the_ground_does_not_count_where_many_frames_show_none():
    block = fly(np.random.default_rng(8), FLEET, Conditions("oblique", vehicles=20), unsure=False)
    plain, above = measure_source(block.source, block.found, FLEET), block.found.planar
    geometry = SweepGeometry.of(block.source, above)

    def strays():
        for picture in block.source.ground_pictures:
            if picture.name not in above.boxes:
                continue
            grid = np.arange(60, picture.width - 60, 40), np.arange(60, picture.height - 60, 40)
            pixels = np.stack(np.meshgrid(*grid), -1).reshape(-1, 2)
            place = picture.ground(pixels)
            lonely = np.linalg.norm(place[:, None] - plain.votes.place, axis=2).min(1) > 5 / block.metres_per_unit
            in_frames = shown_in_frames(block.source, block.found, plain.boxes, place)
            for k in np.flatnonzero(lonely & (geometry.shown(place) < 5) & (in_frames > 5)):
                stray = Boxes(np.array([[*pixels[k], 75.0, 31.0, 0.1]]), np.ones(1))
                yield {**above.boxes, picture.name: Boxes.concatenate([above.boxes[picture.name], stray])}

    whole = (
        b for b in strays() if len(SweepGeometry.of(block.source, replace(above, boxes=b)).boxes) > len(geometry.boxes)
    )
    strayed = next(whole)
    measured = measure_source(block.source, replace(block.found, planar=replace(above, boxes=strayed)), FLEET)
    planar = measured.modes["planar"].votes
    assert len(planar) == len(plain.modes["planar"].votes) + 1 and not planar.fleeting.any(), "planar alone believes it"
    assert measured.scale.value == pytest.approx(plain.scale.value, rel=1e-3)


def test_what_a_picture_of_the_ground_enlarges_does_not_count():
    block = fly(np.random.default_rng(9), FLEET, Conditions("nadir", vehicles=20), unsure=False)
    plain = SweepGeometry.of(block.source, block.found.planar)
    picture = max(block.source.ground_pictures, key=lambda p: (plain.picture == p.name).sum())
    assert plain.lost[TOO_COARSE] == 0
    whole = int((plain.picture == picture.name).sum())
    assert whole > 2
    for times, lost in ((1.3, 0), (1.5, whole)):  # as if the frame had so many times larger pixels
        coarse = copy.copy(picture)
        coarse.size = (int(picture.size[0] / times), int(picture.size[1] / times))
        coarse.seen = lambda points, times=times: (lambda at, off: (at / times, off))(*picture.seen(points))
        others = [coarse if p is picture else p for p in block.source.ground_pictures]
        found = SweepGeometry.of(_With(block.source, ground_pictures=others), block.found.planar)
        assert found.lost[TOO_COARSE] == pytest.approx(lost, abs=1)
        assert len(found.boxes) == pytest.approx(len(plain.boxes) - lost, abs=1)


@pytest.mark.slow
def test_boxes_of_ground_pictures_are_measured_by_the_bodies_that_the_frames_show():
    """With a card whose bodies are 0.6 m too high, views of all angles show that; straight down alone nothing does."""
    block = fly(np.random.default_rng(9), FLEET, Conditions("grid", vehicles=60), unsure=False)
    wrong = {"effective_height": tuple(h + 0.6 for h in block.found.effective_height)}
    found = replace(block.found, **wrong, planar=replace(block.found.planar, **wrong))
    both = measure_source(block.source, found, FLEET)
    alone = measure_source(block.source, found, FLEET, mode="planar")
    known = measure_source(block.source, block.found, FLEET).modes["planar"]
    width, by_card, right = (np.median(m.size[:, 1]) for m in (both.modes["planar"], alone, known))
    assert abs(np.log(by_card / right)) > 0.01, "bodies do not matter here: nothing is tested"
    assert abs(np.log(width / right)) < 0.3 * abs(np.log(by_card / right))
    fitted, planar = (both.modes[name].pooled.systematic for name in ("oblique", "planar"))
    assert (planar.cross(fitted) > 0.5 * np.diag(planar.covariance)).all(), (
        "an error of these bodies is one of both modes"
    )


def test_how_far_up_boxes_of_ground_pictures_reach_is_not_known_exactly():
    """By what one sigma of the height more changes the sizes of boxes away from the nadir, at least is claimed."""
    block = fly(np.random.default_rng(9), FLEET, Conditions("nadir", vehicles=40), unsure=False)
    above = block.found.planar
    plain = SweepGeometry.of(block.source, above)
    raised = replace(above, effective_height=tuple(h + HEIGHT_SD for h in above.effective_height))
    seen, less = (SweepGeometry.of(block.source, f).observe(block.metres_per_unit) for f in (above, raised))
    bodies = {k: seen.systematic.shared[k] for k in (ENDS, SIDES, FITTED_ENDS, FITTED_SIDES)}
    told = np.sqrt(np.diag(Systematic(np.zeros(2), bodies).covariance))
    change = -np.median(np.log(less.size / seen.size), axis=0)
    assert (told >= 0.8 * change).all() and change[1] > 0.001 and told[0] > 0.002
    away = np.linalg.norm(plain.offset, axis=1)
    steep, flat = away < np.quantile(away, 0.2), away > np.quantile(away, 0.7)
    lasting = np.hypot(*seen.lasting.T)
    assert lasting[steep].max() < np.median(lasting[flat]), "steep views are surer"
    wide = replace(above, ruler=replace(above.ruler, margin=(3.0, 2.0)))
    with_margin = SweepGeometry.of(block.source, wide).observe(block.metres_per_unit)
    assert np.array_equal(with_margin.size, seen.size) and with_margin.ruler.margin == (3.0, 2.0), "taken off later"


def test_where_the_focal_length_is_longer_than_in_the_model_cameras_stand_as_much_higher():
    """Above the same places, which they see in the same pictures, but more steeply."""
    block = fly(np.random.default_rng(9), FLEET, Conditions("nadir", vehicles=40), unsure=False)
    longer = _With(block.source, focal=FocalDoubt(1.1))
    plain, higher = (SweepGeometry.of(source, block.found.planar) for source in (block.source, longer))
    assert np.allclose(higher.camera, 1.1 * plain.camera)
    assert np.allclose(higher.camera * higher.offset, plain.camera * plain.offset)
    plain, higher = (FramesGeometry.of(source, block.found, FLEET, Method()) for source in (block.source, longer))
    assert np.allclose(higher.views.lens, 1.1 * plain.views.lens)
    above, more = (-(g.views.ground * g.views.normal).sum(1) for g in (plain, higher))
    assert np.allclose(more, 1.1 * above) and (higher.views.elevation > plain.views.elevation).all()


class _With:
    """A source of which some values are others."""

    def __init__(self, source, **values):
        self.__dict__.update(values, source=source)

    def __getattr__(self, name):
        return getattr(self.source, name)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.005, 0.003])
def test_boxes_that_the_margin_may_be_all_of_are_too_little_evidence(share):
    block = fly(np.random.default_rng(8), FLEET, Conditions("nadir", vehicles=20), unsure=False)
    tiny = {name: replace(b, xylwa=b.xylwa * [1, 1, share, share, 1]) for name, b in block.found.boxes.items()}
    with pytest.raises(TooLittleEvidence, match="boxes that fit a vehicle, 5 are needed"):
        measure_source(block.source, replace(block.found, boxes=tiny), FLEET, mode="oblique")


# --- Parts that share no point ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def of_two_parts():
    """A block, as if its first and its other frames shared no point."""
    block = fly(np.random.default_rng(8), FLEET, Conditions("grid", vehicles=60), unsure=False)
    names = block.source.picture_names
    halves = tuple(names[:25]), tuple(names[25:])
    return replace(block, source=replace(block.source, _parts=halves)), halves


def larger(found, names, factor):
    """`found` with boxes `factor` times as large in the frames `names`."""
    boxes = {
        name: Boxes(some.xylwa * [1, 1, factor, factor, 1], some.score) if name in names else some
        for name, some in found.boxes.items()
    }
    return replace(found, boxes=boxes, planar=None)


@pytest.mark.slow
def test_parts_of_one_scale_agree(of_two_parts):
    block, halves = of_two_parts
    measured = measure_source(block.source, block.found, FLEET)
    assert [list(part.images) for part in sorted(measured.parts.known, key=lambda p: p.images)] == sorted(
        map(list, halves)
    )
    assert all(p.scale.value == pytest.approx(block.metres_per_unit, rel=0.03) for p in measured.parts.known)
    whole = measure_source(replace(block.source, _parts=()), block.found, FLEET)
    assert measured.scale == replace(whole.scale, used=measured.scale.used) and whole.parts is None
    assert "Parts that share no point agree" in [j.what for j in judgements(measured) if j.severity == SUPPORT]


@pytest.mark.slow
def test_parts_of_different_scales_are_refused(of_two_parts):
    block, halves = of_two_parts
    measured = measure_source(block.source, larger(block.found, halves[1], 1.3), FLEET)
    assert measured.scale.verdict == UNUSABLE
    low, high = measured.scale.interval90
    assert low < block.metres_per_unit / 1.3 < block.metres_per_unit < high
    said = [(j.what, j.detail) for j in judgements(measured) if j.severity == REFUSAL and "arts" in j.what + j.detail]
    assert [what for what, _ in said] == ["Parts have different scales"] and halves[1][0] in said[0][1]
    (refusal,) = [r for r in measured.remarks if r.severity == REFUSAL and "share no point" in r.text]
    assert "image_deleter" in refusal.hint and " m/model-unit by " in refusal.text


@pytest.mark.slow
def test_a_part_without_vehicles_is_named_and_doubted(of_two_parts):
    block, halves = of_two_parts
    boxes = {name: some for name, some in block.found.boxes.items() if name in halves[0]}
    found = replace(block.found, boxes=boxes, planar=None)
    measured = measure_source(block.source, found, FLEET)
    assert len(measured.parts.unknown) == 1
    text = f"({halves[1][0]} ...) have too few vehicles"
    assert [r.severity for r in measured.remarks if text in r.text] == [CAUTION]
    parts, good = measured.parts, replace(measured.scale, verdict="good")
    assert parts.judged(good).verdict == "fair"
    assert replace(parts, unknown=(halves[1][:1],)).judged(good) == good
