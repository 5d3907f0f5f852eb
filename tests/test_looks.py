"""A reconstruction measured in its frames and on its ground: exact boxes of known vehicles, so the scale is known."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from support.flights import FLEET, HEIGHT, UNIT
from support.models import make_model

from orthoscale.actions import find as find_module
from orthoscale.actions.estimate import estimate
from orthoscale.actions.fix import fix
from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring.contradiction import Cause, cause
from orthoscale.core.measuring.measure import measure
from orthoscale.core.measuring.method import Method
from orthoscale.core.measuring.oblique import ExactGeometry
from orthoscale.core.measuring.ways import measure_source
from orthoscale.core.pooling.agreement import CONTRADICTION, compare, together
from orthoscale.errors import EvidenceDisagrees, TooLittleEvidence, UsageError
from orthoscale.formats.detections.own import load_detections, save_detections
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.ground_picture import NEAR_NADIR


def test_the_scale_of_known_vehicles(measured):
    assert set(measured.modes) == {"oblique", "planar"}
    for each in (measured, *measured.modes.values()):
        assert each.scale.value == pytest.approx(UNIT, rel=0.03)
        low, high = each.scale.interval90
        assert low < UNIT < high


def test_both_looks_agree_and_are_pooled(measured):
    oblique, planar = (measured.modes[name].scale.value for name in ("oblique", "planar"))
    assert planar == pytest.approx(oblique, rel=0.02)
    assert min(oblique, planar) <= measured.scale.value <= max(oblique, planar)
    assert not measured.agreement.contradicts and "planar gives" in measured.scale.remarks[-1].text
    modes = measured.agreement.scales.values()
    # Of the geometry each look has errors of its own, and one or the other sees a vehicle from steeper above.
    for name, left in (("sampling", 0.9), ("fleet", 1), ("margin", 1)):
        assert measured.scale.parts[name] >= left * min(s.parts[name] for s in modes) - 1e-12, f"{name} got narrower"


@pytest.mark.slow
def test_both_are_each_of_them_alone_and_leave_their_source_as_it_was(flight, found, measured):
    """Ground pictures only as nearly as the bodies that the frames' views show are those of the card."""
    source = ColmapSource.open(flight[0])
    notes = list(source.notes)
    for mode, one in measured.modes.items():
        alone = measure_source(source, found, FLEET, mode=mode)
        near = 1e-12 if mode == "oblique" else 5e-3
        assert (one.scale.value, *one.scale.interval90) == pytest.approx(
            (alone.scale.value, *alone.scale.interval90), rel=near
        )
        assert set(alone.modes) == {mode}
    assert source.notes == notes


@pytest.mark.slow
@pytest.mark.parametrize(("height", "margin"), [(0.5, -1.0), (1.2, 2.0)])
def test_a_wrong_card_is_found_out_by_the_views(flight, found, height, margin):
    """The views know better than the card what the boxes are, and the trends that it leaves go away."""
    ruler = replace(found.ruler, margin=(margin, margin), margin_sd=(2.0, 2.0))
    wrong = replace(found, ruler=ruler, effective_height=(height, height), planar=None)
    measured = measure_source(ColmapSource.open(flight[0]), wrong, FLEET)
    calibration = measured.findings.calibration
    fitted = calibration.ruler.height
    assert np.abs(fitted - HEIGHT).max() < 0.5 * abs(height - HEIGHT)
    assert calibration.ruler.views > 100
    before, after = (calibration.trends[k]["percent_per_10_degrees"] for k in ("before", "after"))
    assert abs(before[0]) > 3 * before[1] and abs(after[0]) < abs(before[0]) / 3


@pytest.mark.slow
def test_looks_that_contradict_write_nothing_unless_forced(flight, found, tmp_path):
    planar = found.planar
    smaller = {n: Boxes(b.xylwa * [1, 1, 0.7, 0.7, 1], b.score) for n, b in planar.boxes.items()}
    path = tmp_path / "boxes.json"
    save_detections(replace(found, planar=replace(planar, boxes=smaller)), path)
    with pytest.raises(EvidenceDisagrees, match="planar gives .* all vehicles differ alike") as caught:
        fix(flight[0], tmp_path / "out", fleet="DE", detections=path)
    assert caught.value.exit_code == 4 and "--mode" in caught.value.hint
    assert not (tmp_path / "out").exists()
    one = fix(flight[0], tmp_path / "one", fleet="DE", detections=path, mode="oblique")
    assert one.scale.value == pytest.approx(UNIT, rel=0.03)
    both = fix(flight[0], tmp_path / "out", fleet="DE", detections=path, force=True)
    low, high = both.scale.interval90
    planar = both.measured.modes["planar"].scale.value
    assert both.scale.value in (one.scale.value, planar), "never the mean of two that contradict"
    assert low < one.scale.value < planar < high and both.scale.verdict == "unusable"


@pytest.mark.slow
def test_a_planar_sweep_alone_is_written_with_its_picture(flight, found, tmp_path):
    save_detections(found, tmp_path / "boxes.json")
    again = load_detections(tmp_path / "boxes.json")
    assert {n: len(b) for n, b in again.planar.boxes.items()} == {n: len(b) for n, b in found.planar.boxes.items()}
    fix(flight[0], tmp_path / "out", fleet="DE", detections=tmp_path / "boxes.json", mode="planar")
    assert cv2.imread(str(tmp_path / "out/vehicles.png")) is not None


def test_a_frame_of_another_scale_is_named(flight, found):
    name = "04.png"
    boxes = dict(found.boxes)
    boxes[name] = Boxes(boxes[name].xylwa * [1, 1, 0.8, 0.8, 1], boxes[name].score)
    measured = measure_source(ColmapSource.open(flight[0]), replace(found, boxes=boxes), FLEET, mode="oblique")
    assert [odd for odd, _ in measured.drift.odd] == [name]
    assert any(name in remark.text and remark.severity == "caution" for remark in measured.scale.remarks)


@pytest.mark.slow
def test_the_ruler_that_is_reported_is_the_one_that_was_measured_with(flight, found):
    """After the last round nothing is refined: no vehicle would have been measured with that."""
    geometry = ExactGeometry.of(ColmapSource.open(flight[0]), found, FLEET, Method())
    first = measure(replace(geometry, rounds=1), FLEET).findings.calibration
    later = measure(geometry, FLEET).findings.calibration
    assert first.ruler is first.card and later.ruler is not later.card


def test_one_look_answers_where_the_other_has_too_little(flight, found):
    source = ColmapSource.open(flight[0])
    before = list(source.notes)
    measured = measure_source(source, replace(found, planar=replace(found.planar, boxes={})), FLEET)
    assert set(measured.modes) == {"oblique"} and measured.agreement is None
    assert any(note.startswith("planar: 0 boxes") for note in measured.notes) and source.notes == before
    with pytest.raises(TooLittleEvidence):
        measure_source(source, replace(found, boxes={}, planar=replace(found.planar, boxes={})), FLEET)


def test_modes_that_cannot_be(flight, found, tmp_path):
    save_detections(replace(found, planar=None), tmp_path / "boxes.json")
    with pytest.raises(UsageError, match="no boxes of a planar sweep"):
        estimate(flight[0], fleet="DE", detections=tmp_path / "boxes.json", mode="both")
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((50, 50, 3), np.uint8))
    with pytest.raises(UsageError, match="--mode does nothing here: it is for COLMAP models"):
        estimate(tmp_path / "a.png", mode="planar")


def test_ground_pictures_show_what_the_frames_show(flight, tmp_path):
    """Frames are painted by position, so that every pixel of the warp tells where it came from."""
    across, down = np.meshgrid(np.arange(640) / 640 * 200 + 20, np.arange(480) / 480 * 200 + 20)
    image = np.stack([across, down, np.full_like(across, 77)], -1).astype(np.uint8)
    model, turn = make_model()
    for number in model.images:
        cv2.imwrite(str(tmp_path / model.images[number].name), image[..., ::-1])
    source = ColmapSource.open(flight[0], images=tmp_path)
    picture = source.ground_pictures[4]
    shown = picture.read(0, 0, picture.width, picture.height, picture.width, picture.height)
    points = np.random.default_rng(0).uniform(0, (picture.width, picture.height), (4000, 2))
    pixels, offset = picture.seen(points)
    elevation = np.degrees(np.arctan2(1, np.linalg.norm(offset, axis=1)))
    good = (elevation > NEAR_NADIR) & (pixels > 2).all(1) & (pixels < (638, 478)).all(1)
    assert good.mean() > 0.3
    x, y = points[good].astype(int).T
    expected = np.column_stack([pixels[good] / (640, 480) * 200 + 20, np.full(good.sum(), 77)])
    assert np.abs(shown[y, x] - expected).max() < 3
    flat = elevation < 45
    assert (shown[tuple(points[flat].astype(int).T[::-1])] == 114).all()
    # One pixel is everywhere the same length on the ground, and the plan is not mirrored.
    a, b, c = picture.ground(np.array([[100.0, 100], [110, 100], [100, 110]]))
    assert np.linalg.norm(b - a) == pytest.approx(10 * picture.unit_per_pixel, rel=0.01)
    assert np.cross(b - a, c - a) @ turn[:, 2] < 0, "x right and y down, seen from above"
    assert len({p.unit_per_pixel for p in source.ground_pictures}) == 1


def test_a_reconstruction_is_let_go_when_nobody_needs_its_ground(flight, tmp_path):
    """The memory of pictures keeps pixels only, and not those of a frame that was replaced."""

    def paint(grey):
        for image in make_model()[0].images.values():
            cv2.imwrite(str(tmp_path / image.name), np.full((480, 640, 3), grey, np.uint8))

    paint(20)
    source = ColmapSource.open(flight[0], images=tmp_path)
    picture = source.ground_pictures[4]
    whole = 0, 0, picture.width, picture.height, picture.width, picture.height
    assert (picture.read(*whole) == 20).any()
    paint(220)
    assert not (picture.read(*whole) == 20).any()
    left = weakref.ref(source)
    del source, picture
    gc.collect()
    assert left() is None


def test_agreement_of_two_scales(measured):
    scale = measured.modes["oblique"].scale
    same = compare({"oblique": scale, "planar": replace(scale, value=1.01 * scale.value)})
    assert not same.contradicts and same.difference == pytest.approx(0.01, rel=0.01)
    assert together(same).value == pytest.approx(1.005 * scale.value, rel=1e-3)
    apart = compare({"oblique": scale, "planar": replace(scale, value=1.5 * scale.value)})
    assert apart.contradicts
    assert together(apart).value == apart.scales[apart.surer].value and together(apart).verdict == "unusable"


def test_vehicles_measured_both_ways_are_compared_themselves(measured):
    """Different vehicles in the two looks part their scales, and are no contradiction."""
    agreement = measured.agreement
    assert agreement.common > 15 and agreement.difference == pytest.approx(0, abs=0.01)
    a, b = agreement.scales.values()
    by_all, by_common = 100 * (b.value / a.value - 1), 100 * np.expm1(agreement.difference)
    words = f": {by_all:+.1f} %, and {by_common:+.1f} % on the {agreement.common} vehicles measured both ways, "
    assert words in agreement.sentence()
    noise = np.random.default_rng(0).normal(0, 0.02, (20, 2))
    other = compare({"oblique": a, "planar": replace(b, value=1.06 * a.value)}, noise)
    assert other.difference == pytest.approx(0, abs=0.02) and not other.contradicts
    wrong = compare({"oblique": a, "planar": replace(b, value=1.06 * a.value)}, noise + 0.25)
    assert wrong.contradicts and wrong.common == 20
    far = np.exp(1.1 * CONTRADICTION * other.apart_sd)  # beyond what sampling explains, within what mixes do
    parted = compare({"oblique": a, "planar": replace(b, value=far * a.value)}, noise)
    assert parted.by_others and not parted.contradicts and "vehicles that only one of them counts" in parted.sentence()
    both, near = together(parted), together(other)
    assert a.value < both.value < far * a.value and both.parts["fleet"] > 1.2 * near.parts["fleet"]
    assert compare({"oblique": a, "planar": replace(b, value=1.5 * a.value)}, noise).contradicts
    few = compare({"oblique": a, "planar": replace(b, value=1.06 * a.value)}, noise[:3])
    assert few.common == 0 and few.difference == pytest.approx(np.log(1.06))


def parted(measured, apart, plan=None, height=HEIGHT):
    """The cause for which two ways that give vehicles sizes `apart` (log) contradict each other."""
    oblique, planar = (measured.modes[name].scale for name in ("oblique", "planar"))
    apart = np.asarray(apart, float)
    scales = {"oblique": oblique, "planar": replace(planar, value=1.5 * oblique.value)}
    agreement = compare(scales, np.column_stack([apart, apart]))
    plan = np.random.default_rng(1).uniform(0, 50, (len(apart), 2)) if plan is None else plan
    own = measured.findings.calibration
    value = own.ruler.value.copy()
    value[:, 0] = height
    calibration = replace(own, ruler=replace(own.ruler, value=value))
    assert calibration.ruler.views and agreement.contradicts
    return cause(agreement, apart, plan, calibration)


def test_the_cause_of_a_contradiction_is_named(measured):
    noise = np.random.default_rng(0).normal(0, 0.02, 30)
    plan = np.random.default_rng(1).uniform(0, 50, (30, 2))
    assert parted(measured, noise[:3])[0] is Cause.OTHERS, "too few in common"
    assert parted(measured, noise)[0] is Cause.OTHERS, "those in common agree"
    assert parted(measured, noise + 0.3)[0] is Cause.BOXES
    name, said = parted(measured, noise + 0.3 + 0.004 * plan[:, 0], plan)
    assert name is Cause.GROUND and "across the model" in said
    name, said = parted(measured, noise + 0.3, height=measured.findings.calibration.card.height[0] + 0.8)
    assert name is Cause.LENS and "focal length" in said


def test_what_the_cause_spares_answers(measured):
    scale = measured.modes["oblique"].scale
    vaguer = replace(scale, value=1.5 * scale.value, parts={"sampling": 0.1})
    apart = compare({"oblique": scale, "planar": vaguer})
    assert apart.surer == "oblique" and apart.contradicts
    spared = replace(apart, cause="the focal length is wrong", spared="planar")
    assert together(spared).value == vaguer.value and "the focal length is wrong" in spared.sentence()


# How the pictures of the ground are looked at


@pytest.mark.parametrize(
    "given, own, frames, zooms, number",
    [
        (None, 5, 9, [None], 5),  # enough by their own zoom
        (None, 4, 9, [None, 0.5], 9),
        (None, "none", 9, [None, 0.5], 9),
        (None, 4, 3, [None, 0.5], 4),  # no better: what they gave themselves
        (0.7, 4, 9, [0.7], 4),  # told
    ],
)
def test_the_frames_zoom_is_tried_where_the_grounds_own_shows_too_little(
    monkeypatch, given, own, frames, zooms, number
):
    asked = []

    def find(pictures, detector, zoom, progress, effort, stop, cover):
        asked.append(zoom)
        seen = frames if zoom == 0.5 else own
        if seen == "none":
            raise TooLittleEvidence("no vehicles found at any zoom")
        return seen

    monkeypatch.setattr(find_module, "find_vehicles", find)
    sampling = find_module.Sampling(from_above=lambda seen: 0.01 if seen >= 5 else np.inf)
    search = find_module.VehicleSearch(None, given, sampling=sampling)
    found = find_module._planar([], search, None, lambda: 0.5)
    assert (asked, found) == (zooms, number)


@pytest.mark.parametrize("mode", ["planar", "both"])
def test_ground_pictures_that_are_needed_and_missing_are_missed_before_frames_are_searched(monkeypatch, mode):
    monkeypatch.setattr(find_module, "find_vehicles", lambda *_: pytest.fail("frames are searched"))
    low = SimpleNamespace(path="low", pictures=[], ground_pictures=[SimpleNamespace(frame=None)])
    with pytest.raises(TooLittleEvidence, match="near the nadir"):
        find_module.find_in_model(low, mode, find_module.VehicleSearch(None))
