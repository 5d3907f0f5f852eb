"""What speaks for a scale and what against it is judged once, in the core, each with its severity."""

from dataclasses import replace

import numpy as np
import pytest
from support.reports import car_park

import orthoscale
from orthoscale.core.claims import Comparison
from orthoscale.core.evidence import Compared, Evidence, Support
from orthoscale.core.measuring.drift import Trend
from orthoscale.core.measuring.judgement import judgements
from orthoscale.core.measuring.measurement import Findings
from orthoscale.core.measuring.model_drift import FrameScale, ModelDrift
from orthoscale.core.measuring.parts import PARTS_NAMED, Parts
from orthoscale.core.pooling.agreement import Agreement
from orthoscale.core.remarks import CAUTION, INFO, ON_EVIDENCE, ON_PLACES, REFUSAL, SEVERITIES, SUPPORT, Remark, amount
from orthoscale.core.scale import PER_PIXEL
from orthoscale.core.verdicts import remark_on_shape


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A sound measurement of a car park."""
    folder = tmp_path_factory.mktemp("park")
    car_park(folder)
    options = {"fleet": "DE", "detections": folder / "detections.json", "anchors": ["none"]}
    return orthoscale.estimate(folder / "park.png", **options).measured


def scaled(measured, **changes):
    return replace(measured, scale=replace(measured.scale, **changes))


def agreement(measured, sigmas):
    other = replace(measured.scale, value=1.05 * measured.scale.value)
    apart = float(np.log(1.05))
    return Agreement({"oblique": other, "planar": measured.scale}, -apart, apart / sigmas, -apart, apart / sigmas)


def test_of_a_sound_scale_nothing_is_to_be_looked_at(measured):
    said = {j.what: j.severity for j in judgements(measured)}
    assert said["Enough vehicles"] == said["Lengths and widths agree"] == SUPPORT
    assert not {CAUTION, REFUSAL} & set(said.values())
    assert "Largest uncertainty: margin" in said or "Largest uncertainty: fleet" in said


def with_tape(measured, metres_per_pixel, conflict, rest_sd=0.04):
    tape = Evidence("known distance", metres_per_pixel, 0.01, "a tape")
    conflicts = ("vehicles: 0.1 m/px, a tape: 0.13 m/px, 5 sigmas apart",) if conflict else ()
    compared = () if conflict else (Compared(tape.kind, tape.says, tape.value, 0.1, rest_sd, PER_PIXEL),)
    return scaled(measured, evidence=(tape,), conflict=conflict, support=Support(compared, 0.0, conflicts))


AGAINST = {
    "Few vehicles": (CAUTION, lambda m: scaled(m, parts={"sampling": 0.021, "fleet": 0.02})),
    "Many rejected": (CAUTION, lambda m: scaled(m, reasons=["too large for a car"] * 70)),
    "Lengths and widths disagree": (CAUTION, lambda m: scaled(m, tension=3.9)),
    "Planar and oblique disagree": (REFUSAL, lambda m: replace(m, agreement=agreement(m, 2.7))),
    "Other evidence contradicts": (REFUSAL, lambda m: with_tape(m, 0.13, 5.0)),
    "Remark": (CAUTION, lambda m: scaled(m, remarks=(Remark(CAUTION, "something is odd"),))),
}


@pytest.mark.parametrize("what", AGAINST)
def test_what_speaks_against_a_scale_comes_first(measured, what):
    severity, changed = AGAINST[what]
    found = judgements(changed(measured))
    assert (found[0].severity, found[0].what) == (severity, what)
    order = [SEVERITIES.index(j.severity) for j in found]
    assert order == sorted(order)


@pytest.mark.parametrize("more, what", [(-1, "Enough vehicles"), (1, "Many rejected")])
def test_more_rejected_than_used_are_many(measured, more, what):
    rejected = measured.scale.vehicles_used + more
    assert what in [j.what for j in judgements(scaled(measured, reasons=["too large for a car"] * rejected))]


def test_a_contradiction_is_told_by_what_each_side_says(measured):
    contradicted = with_tape(measured, 0.13, 5.0)
    said = "vehicles: 0.1 m/px, a tape: 0.13 m/px, 5 sigmas apart"
    # In whatever words: of two modes, the remark begins with the name of the one that it is on.
    for remark in (Remark(REFUSAL, f"{begin}conflict: {said}", check=ON_EVIDENCE) for begin in ("", "oblique: ")):
        found = judgements(scaled(contradicted, remarks=(remark,)))
        assert said in [j.detail for j in found if "contradicts" in j.what]
        assert len([j for j in found if said in j.detail]) == 1, "not once more as a remark"


@pytest.mark.parametrize("severity", [CAUTION, REFUSAL])
def test_a_drift_is_told_once_and_as_gravely_as_its_remark(measured, severity):
    bent = of_a_model(measured, 12.0, 0.001)
    found = judgements(scaled(bent, remarks=(Remark(severity, "oblique: it may be bent", check=ON_PLACES),)))
    assert [(j.what, j.severity) for j in found if j.what in ("The scale drifts", "Remark")] == [
        ("The scale drifts", severity)
    ]


def test_lengths_and_widths_refuse_only_far_apart(measured):
    for tension, severity in ((2.4, SUPPORT), (2.6, CAUTION), (4.1, REFUSAL)):
        (check,) = [j for j in judgements(scaled(measured, tension=tension)) if "widths" in j.what]
        assert check.severity == severity
        if tension > 2.5:
            assert remark_on_shape(0.1, tension).severity == severity


@pytest.mark.parametrize("ratio, said", [(1.25, "lengths give"), (0.8, "widths give")])
def test_the_larger_of_two_scales_is_larger_by_what_is_said(ratio, said):
    text = remark_on_shape(float(np.log(ratio)), 3.0).text
    assert text.startswith(said) and "by 25 %" in text, "more than the smaller one"


def test_lengths_and_widths_far_apart_support_nothing_however_little_is_known(measured):
    checks = {**measured.scale.checks, "length": 0.7 * measured.scale.checks["width"]}
    (check,) = [j for j in judgements(scaled(measured, checks=checks, tension=0.1)) if "widths" in j.what]
    assert check.severity == INFO and check.detail == "lengths give −30.0 % against widths (0.1 sigma)"


def test_a_conflict_makes_no_other_check_lenient(measured):
    """Its interval spans what contradicts: a drift of 13 % was "not significant", and a tick."""
    checks = {**measured.scale.checks, "length": 0.9 * measured.scale.checks["width"]}
    wide = {"checks": checks, "tension": 0.1, "interval90": (0.5 * measured.scale.value, 2 * measured.scale.value)}
    for conflict, severity in ((0.0, SUPPORT), (9.0, INFO)):
        found = judgements(scaled(measured, conflict=conflict, **wide))
        assert [j.severity for j in found if "widths" in j.what] == [severity]


def test_no_sampling_error_is_made_up_in_a_conflict(measured):
    (check,) = [j for j in judgements(scaled(measured, parts={"conflict": 0.1})) if "vehicles" in j.what]
    assert check.severity == INFO and "sampling" not in check.detail


@pytest.mark.parametrize("value, sd, severity", [(0.1, 0.04, SUPPORT), (0.13, 0.2, INFO), (0.11, 0.04, CAUTION)])
def test_evidence_supports_only_where_it_is_near_all_else(measured, value, sd, severity):
    (check,) = [j for j in judgements(with_tape(measured, value, 0.0, sd)) if "evidence" in j.what]
    assert check.severity == severity
    assert f"known distance {100 * (value / 0.1 - 1):+.1f} % (" in check.detail, "not against its own mean"


def test_agreement_of_two_ways_is_told_as_it_was_judged(measured):
    """The page said oblique against planar, the note below it planar against oblique."""
    agreed = agreement(measured, 1.2)
    (check,) = [j for j in judgements(replace(measured, agreement=agreed)) if "Planar" in j.what]
    assert check.severity == SUPPORT and check.detail == "planar gives −4.8 % (1.2 sigma)"
    assert "planar gives" in agreed.sentence() and "-4.8 %" in agreed.sentence()


@pytest.mark.parametrize(
    "claimed, believed, severity",
    [(0.1, True, SUPPORT), (0.115, True, CAUTION), (0.3, True, CAUTION), (0.3, False, None)],
)
def test_a_claim_is_judged_where_it_is_believed(measured, claimed, believed, severity):
    claim = Comparison("its georeferencing claims", claimed, measured.scale.value, 0.04, believed)
    found = [j.severity for j in judgements(measured, claim) if "georeferencing" in j.what]
    assert found == ([] if severity is None else [severity])


@pytest.mark.parametrize(
    "truth, guess",
    [
        (0.3048, "feet were taken for metres"),
        (1 / 0.3048, "metres were taken for feet"),
        (2.0, "the image was halved and its georeferencing was not"),
        (4.0, "the image was halved twice and its georeferencing was not"),
        (0.5, "the image was enlarged and its georeferencing was not"),
        (10.0, "a decimal point is off by one place"),
        (0.1, "a decimal point is off by one place"),
        (1.5, None),
        (1.01, None),
    ],
)
def test_a_mistake_that_explains_a_claim_is_guessed(truth, guess):
    """A model's coordinates may be of another unit, but were never halved with its pictures."""
    of_picture, of_model = (Comparison("x", 1.0, 1.02 * truth, 0.02, unit=unit) for unit in (PER_PIXEL, "m/model-unit"))
    assert of_picture.guesses == ([guess] if guess else [])
    assert of_model.guesses == (of_picture.guesses if guess and "feet" in guess else [])


def of_a_model(measured, percent, chance, odd=()):
    frames = {f"DJI_{k}.jpg": FrameScale(15.0, 0.4, 8) for k in range(4)}
    drift = ModelDrift(frames, odd, [], Trend(percent / 100, chance))
    return replace(measured, findings=Findings(drift=drift), modes={"oblique": measured})


def test_frames_that_stand_out_are_named(measured):
    found = judgements(of_a_model(measured, 5.0, 0.37, [("DJI_2.jpg", 0.19)]))
    said = {j.what: j for j in found}
    assert said["1 of 4 frames stands out"].severity == CAUTION
    assert said["1 of 4 frames stands out"].detail == "DJI_2.jpg (+19.0 %)"
    assert said["No drift"].severity == SUPPORT
    assert {j.what: j.severity for j in judgements(of_a_model(measured, 5.0, 0.37))}["Frames agree"] == SUPPORT


def test_the_drift_of_a_model_is_judged_once(measured):
    said = {j.what: j.severity for j in judgements(of_a_model(measured, 12.0, 0.001))}
    assert said["The scale drifts"] == CAUTION and "Remark" not in said
    assert (
        judgements(of_a_model(measured, 20.0, 0.3))
        and {j.what: j.severity for j in judgements(of_a_model(measured, 20.0, 0.3))}[
            "Drift neither found nor excluded"
        ]
        == INFO
    )


def test_a_severity_is_one_of_four():
    with pytest.raises(ValueError, match="severity"):
        Remark("look", "odd")


def test_what_was_found_in_opening_the_source_is_a_check_too(measured):
    said = Remark(CAUTION, "all 12 cameras stand on one straight line")
    assert any(check.detail == said.text for check in judgements(measured, None, [*measured.remarks, said]))
    assert not any(check.detail == said.text for check in judgements(measured))
    assert judgements(measured, None, [*measured.remarks, Remark(INFO, "copied")]) == judgements(measured)


@pytest.mark.parametrize(
    ("number", "what", "said"),
    [
        (1, "usable vehicles", "1 usable vehicle"),
        (0, "usable vehicles", "0 usable vehicles"),
        (1, "photos", "1 photo"),
        (1, "images", "1 image"),
        (1, "boxes do not count", "1 box does not count"),
        (1234, "boxes do not count", "1,234 boxes do not count"),
    ],
)  # fmt: skip
def test_one_is_not_said_as_several(number, what, said):
    assert amount(number, what) == said


@pytest.mark.parametrize("more, said", [(0, ""), (1, "; and 1 more part"), (2, "; and 2 more parts")])
def test_of_many_parts_of_a_model_some_are_named(more, said):
    parts = Parts.of([((f"{k}.jpg", "more.jpg"), None) for k in range(PARTS_NAMED + more)])
    last = PARTS_NAMED - 1
    assert parts.said.endswith(f"2 images ({last}.jpg ...) have too few vehicles{said}")
