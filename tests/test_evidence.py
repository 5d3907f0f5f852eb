"""Evidence besides vehicles: combined where it agrees, reported where it does not."""

from dataclasses import replace
from functools import partial
from itertools import permutations

import numpy as np
import pytest
from scipy.stats import t

from orthoscale.core.control import ground_control, known_distance
from orthoscale.core.evidence import BY_GPS, Evidence
from orthoscale.core.measuring.objects import EDGE_SD, standard_objects
from orthoscale.core.measuring.without_vehicles import measured_without_vehicles
from orthoscale.core.normal import Z90
from orthoscale.core.pooling import combining
from orthoscale.core.pooling.anchors import evidence_of
from orthoscale.core.pooling.posterior import Posterior
from orthoscale.core.scale import PER_PIXEL
from orthoscale.errors import TooLittleEvidence
from orthoscale.formats.tables import known_objects

VEHICLES = Posterior.normal(np.log(0.10), 0.05)
PARTS = {"sampling": 0.03, "fleet": 0.04}
combined = partial(combining.combined, unit=PER_PIXEL)


def test_two_measurements_that_agree_are_weighed_by_their_precision():
    together = combined(VEHICLES, PARTS, [Evidence("tape", 0.11, 0.05, "a tape")])
    value, low, high = together.summary
    assert value == pytest.approx(np.sqrt(0.10 * 0.11)) and together.conflict == 0
    sd = 0.05 / np.sqrt(2)
    assert np.log(high / low) == pytest.approx(2 * 1.6449 * sd, rel=1e-3)
    assert sum(v**2 for v in together.parts.values()) == pytest.approx(sd**2)
    assert together.parts["tape"] == pytest.approx(0.025)


def test_two_that_contradict_each_other_are_reported_and_not_averaged():
    together = combined(VEHICLES, PARTS, [Evidence("tape", 0.14, 0.01, "a tape")])
    value, low, high = together.summary
    assert value == pytest.approx(0.14) and low < 0.10 and high > 0.14
    assert together.conflict == pytest.approx(np.log(1.4) / np.hypot(0.05, 0.01))
    refusal, whose = together.remarks
    assert (
        refusal.text == "conflict: vehicles: 0.1 m/px, a tape: 0.14 m/px, 6.6 sigmas apart"
        and refusal.severity == "refusal"
    )
    assert together.support.conflicts == ("vehicles: 0.1 m/px, a tape: 0.14 m/px, 6.6 sigmas apart",)
    assert "that of the most certain side alone, a tape" in whose.text, "nobody takes the figure for the vehicles'"


def test_the_worst_of_several_contradictions_comes_first():
    """It is the one that an error states."""
    far = Evidence("a", 0.3, 0.02, "a tape")
    near = Evidence("b", 0.2, 0.02, "a court")
    for given in ([near, far], [far, near]):
        together = combined(VEHICLES, PARTS, given)
        sigmas = [float(said.split(", ")[-1].split()[0]) for said in together.support.conflicts]
        assert len(sigmas) == 3 and sigmas == sorted(sigmas, reverse=True)
        assert together.conflict == pytest.approx(sigmas[0], abs=0.05)
        assert together.support.conflicts[0].startswith("vehicles") and "a tape" in together.remarks[0].text


def test_a_contradiction_says_what_to_check():
    """Only what there is: whoever gave no distance has none to check."""
    flown = Evidence(BY_GPS, 0.14, 0.01, "GPS positions of 10 frames")
    taped = known_distance(np.array([(0.0, 0.0), (1000.0, 0.0)]), 140.0)
    court = Evidence("court", 0.2, 0.01, "a court")
    hint = combined(VEHICLES, PARTS, [flown]).remarks[0].hint
    assert hint == (
        "Check the GPS positions (they may be from another flight; --no-gps leaves them out) and the boxes "
        "(--save-detections)"
    )
    assert "mistyped" in combined(VEHICLES, PARTS, [taped]).remarks[0].hint
    assert "(--anchors) and the boxes" in combined(VEHICLES, PARTS, [flown, court]).remarks[0].hint
    assert "boxes" not in combined(None, {}, [flown, court]).remarks[0].hint


def test_what_contradicts_is_said_once():
    """And what only does not count beside it, as what it is."""
    court = Evidence.mixed("court", Posterior.normal(np.log(0.14), 0.01), ["a court"], doubt=0.01)
    dashes = Evidence.mixed("dashes", Posterior.normal(np.log(0.07), 0.01), ["dashes"], doubt=0.3)
    refusal, whose, beside = combined(VEHICLES, PARTS, [court, dashes]).remarks
    assert (
        refusal.text.startswith("conflict: vehicles: 0.1 m/px, a court: 0.14 m/px")
        and "the most certain side alone, vehicles" in whose.text
    )
    assert beside.text.startswith("dashes: would give 0.07 m/px, outside") and beside.text.endswith("it does not count")


@pytest.mark.slow
def test_many_that_err_as_they_say_are_seldom_taken_for_contradictions():
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(200):
        vehicles = Posterior.normal(rng.normal(0, 0.05), 0.05)
        tapes = [Evidence("tape", float(np.exp(rng.normal(0, 0.01))), 0.01, f"tape {k}") for k in range(20)]
        refused += combined(vehicles, PARTS, tapes).conflict > 0
    assert refused < 5, "one in a hundred; 45 where each pair is judged as if it were the only one"
    tapes[3] = Evidence("tape", 1.08, 0.01, "a wrong tape")
    assert combined(vehicles, PARTS, tapes).conflict > 5, "and one that is wrong is still found"


def test_an_error_that_two_share_hides_no_contradiction_between_them():
    sd = float(np.hypot(0.003, 0.01))
    one, other = (Evidence(kind, value, sd, kind, common=0.01) for kind, value in (("court", 1.0), ("lane", 1.04)))
    vehicles = Posterior.normal(0.0, 0.05)
    together = combined(vehicles, PARTS, [one, other])
    assert together.conflict == pytest.approx(np.log(1.04) / (0.003 * np.sqrt(2)), rel=0.01)
    surer = Evidence("tape", 1.02, 0.003, "tape")  # shares nothing: what the court may be off counts
    assert combined(vehicles, PARTS, [one, surer]).conflict == 0


def test_the_common_error_is_a_part_of_the_error_however_evidence_is_made():
    by_modes = Evidence.mixed("court", Posterior.normal(np.log(1.1), 0.03), ["a court"], common=0.04)
    by_hand = Evidence("court", 1.1, 0.05, "a court", common=0.04)
    assert by_hand.relative_sd == pytest.approx(by_modes.relative_sd) == pytest.approx(by_hand.posterior.spread)
    assert by_hand.own_sd == pytest.approx(by_modes.own_sd) == pytest.approx(by_hand.own.spread)
    one, other = (combined(VEHICLES, PARTS, [e, Evidence("tape", 0.1, 0.02, "")]) for e in (by_modes, by_hand))
    assert one.summary == pytest.approx(other.summary)
    assert [c.sd for c in one.support.compared] == pytest.approx([c.sd for c in other.support.compared])
    with pytest.raises(ValueError, match="not less than"):
        Evidence("court", 1.1, 0.01, "a court", common=0.01)


def test_an_error_that_vehicles_share_hides_no_contradiction_with_them():
    """Vehicles are known to 5 %, of which 4 % are the ground's: without it 3 % are left."""
    court = Evidence.mixed("court", Posterior.normal(0.12, 0.005), ["a court"], common=0.04)
    found = combined(Posterior.normal(0.0, 0.05), PARTS, [court]).conflict
    assert found == pytest.approx(0.12 / np.hypot(0.03, 0.005))


def test_positions_of_which_some_are_mistakes_count_by_their_doubt():
    """As those of any flight do where a receiver lost its fix for a while."""
    vehicles, gps = Posterior.normal(0.0, 0.04), Evidence(BY_GPS, 1.03, 0.01, "GPS positions of 18 frames", doubt=0.1)
    got = combined(vehicles, {"sampling": 0.04}, [gps])
    assert 1.02 < got.summary[0] < 1.03 and [e.kind for e in got.evidence] == [BY_GPS]
    assert combined(vehicles, {"sampling": 0.04}, [replace(gps, doubt=0.0)]).posterior.spread < got.posterior.spread
    (far,) = combined(vehicles, {"sampling": 0.04}, [replace(gps, value=1.5)]).remarks
    assert "does not count" in far.text


@pytest.mark.parametrize("off, helps", [(0.019, True), (0.026, False)])
def test_what_the_vehicles_exclude_counts_where_something_lies_within_two_sigmas_of_it(off, helps):
    """An anchor with one sigma of 1 %, just out of the vehicles' reach, and a tape as good as exact, within it."""
    court = Evidence("court", np.exp(0.365), 0.01, "a court", doubt=0.1)
    tape = Evidence("tape", np.exp(0.365 - off), 1e-4, "a tape")
    got = combined(Posterior.normal(0.0, 0.12), {"sampling": 0.12}, [court, tape])
    assert not got.conflict and any("does not count" in remark.text for remark in got.remarks) != helps


def test_a_doubtful_measurement_counts_as_bayes_has_it():
    """A mixture of what the two say together and of the first alone, by numerical integration."""
    log = np.linspace(-0.5, 0.5, 200_001)
    for off, doubt, window in ((0.0, 0.3, 0.4), (0.08, 0.1, 0.4), (0.1, 0.1, 2.0)):
        first, second = Posterior.normal(0.0, 0.05), Posterior.normal(off, 0.01)
        bell = np.exp(-0.5 * ((log - off) / 0.01) ** 2) / 0.01 / np.sqrt(2 * np.pi)
        density = np.exp(-0.5 * (log / 0.05) ** 2) * ((1 - doubt) * bell + doubt / window)
        found = first.times_doubted(second, doubt, window)
        assert found.centre == pytest.approx(density @ log / density.sum(), abs=1e-6)


def test_a_conflict_of_what_has_two_humps_is_as_wide_as_they_are():
    """Two kinds of anchors, each of one of two standards, that agree in neither."""
    half, sd = np.array([0.5, 0.5]), np.array([0.001, 0.001])
    kinds = [
        Evidence.mixed(kind, Posterior(half, off * np.array([-1, 1]), sd), "ab")
        for kind, off in (("a", 0.1), ("b", 0.11))
    ]
    got = combined(None, {}, kinds)
    assert got.conflict and got.posterior.spread >= kinds[0].posterior.spread


def test_what_errs_in_common_alone_is_known_no_better_than_that():
    """Vehicles may be said to be surer than the ground that they stand on."""
    assert 0 < Posterior.normal(0.0, 0.005).blurred(-(0.01**2)).spread < 0.005


def test_in_which_order_evidence_comes_does_not_matter():
    """What has most in common with the vehicles is combined with them first, wherever it stands."""
    court = Evidence.mixed("court", Posterior.normal(np.log(0.104), 0.01), ["a court"], common=0.04)
    dashes = Evidence.mixed("dashes", Posterior.normal(np.log(0.103), 0.01), ["dashes"], common=0.02)
    tape = Evidence("tape", 0.102, 0.02, "a tape")
    first, *others = (combined(VEHICLES, PARTS, some).summary for some in permutations((court, dashes, tape)))
    assert len(others) == 5 and all(other == pytest.approx(first, rel=1e-12) for other in others)


def test_evidence_does_not_support_a_scale_of_its_own_that_nothing_else_does():
    """Of two that bays may mean, the one four sigmas from the vehicles does not count at all."""
    both = Posterior(np.array([0.5, 0.5]), np.log([0.1, 0.1 * np.exp(0.2)]), np.array([0.01, 0.01]))
    bays = Evidence.mixed("bays", both, ["near", "far"], doubt=0.01)
    near = Evidence.mixed("bays", Posterior.normal(np.log(0.1), 0.01), ["near"], doubt=0.01)
    two, one = (combined(VEHICLES, PARTS, [each]) for each in (bays, near))
    assert two.summary == pytest.approx(one.summary, rel=1e-12)


def test_of_two_scales_about_as_near_the_sharper_one_is_meant():
    """By its density, not by its sigmas alone: those that say little are never far."""
    either = Posterior(np.array([0.5, 0.5]), np.log([0.1, 0.1]) + 0.03, np.array([0.01, 0.2]))
    bays = Evidence.mixed("bays", either, ["sharp", "vague"])
    assert bays.meant(VEHICLES).says == "sharp"


def test_without_vehicles_two_pieces_of_one_kind_are_too_little():
    two = [Evidence("tape", 0.1, 0.01, f"tape {k}") for k in "ab"]
    with pytest.raises(TooLittleEvidence, match="two kinds of evidence that agree .*; given: tape a, tape b"):
        measured_without_vehicles(two, "m/px", "DE", 2, {})
    court = Evidence("court", 0.1, 0.01, "a court")
    assert measured_without_vehicles([two[0], court], "m/px", "DE", 2, {}).scale.value == pytest.approx(0.1)
    # A court that is off agrees with neither: what is left is one kind.
    with pytest.raises(TooLittleEvidence, match="two kinds of evidence that agree"):
        measured_without_vehicles([*two, Evidence("court", 0.108, 0.03, "a court")], "m/px", "DE", 2, {})


def test_two_pieces_of_one_kind_are_one_part_of_the_uncertainty():
    tapes = [Evidence("tape", 0.10, 0.05, f"tape {k}") for k in "ab"]
    parts = combined(VEHICLES, PARTS, tapes).parts
    assert parts["tape"] == pytest.approx(0.05 * np.sqrt(2) / 3)
    assert np.hypot(parts["sampling"], parts["fleet"]) == pytest.approx(0.05 / 3)


def test_each_is_compared_with_all_the_rest_and_not_with_what_it_dominates():
    tape, court = Evidence("known distance", 0.106, 0.001, "a tape"), Evidence("court", 0.101, 0.02, "a court")
    together = combined(VEHICLES, PARTS, [tape, court])
    first, second = together.support.compared
    rest = combined(VEHICLES, PARTS, [court])
    assert together.summary[0] == pytest.approx(0.106, rel=1e-3), "which the tape alone makes"
    assert first.rest == pytest.approx(rest.summary[0]) and first.value == pytest.approx(0.106)
    assert first.sigmas == pytest.approx(np.log(0.106 / first.rest) / np.hypot(rest.posterior.spread, 0.001))
    assert second.rest == pytest.approx(0.106, rel=1e-3)
    assert second.difference == pytest.approx(0.101 / 0.106 - 1, abs=2e-3)


@pytest.mark.parametrize("off, doubtful", [(1.9, False), (2.1, True), (2.9, True)])
def test_a_distance_that_does_not_fit_the_vehicles_is_a_caution(off, doubtful):
    tape = Evidence("known distance", float(0.1 * np.exp(off * np.hypot(0.05, 0.001))), 0.001, "a tape")
    together = combined(VEHICLES, PARTS, [tape])
    assert not together.conflict and together.support.compared[0].sigmas == pytest.approx(off)
    assert [r.severity for r in together.remarks] == ["caution"] * doubtful
    assert all("may be mistyped, or not on the ground" in r.text for r in together.remarks)
    assert all(" m/px, " in r.text for r in together.remarks)


def test_what_two_share_is_no_part_of_the_difference_between_them():
    vehicles = Posterior.normal(0.0, 0.05)
    court = Evidence.mixed("court", Posterior.normal(0.08, 0.01), ["a court"], common=0.04)
    (found,) = combined(vehicles, PARTS, [court]).support.compared
    assert found.sigmas == pytest.approx(0.08 / np.hypot(0.03, 0.01)), "0.05 less 0.04 leaves 0.03"


def test_one_piece_without_vehicles_has_nothing_to_be_compared_with():
    tape, court = Evidence("known distance", 0.1, 0.001, "a tape"), Evidence("court", 0.105, 0.02, "a court")
    assert not combined(None, {}, [tape]).support.compared
    sigmas = [one.sigmas for one in combined(None, {}, [tape, court]).support.compared]
    assert sigmas == pytest.approx([np.log(1.05) / np.hypot(0.001, 0.02)] * 2, rel=0.01)


def test_what_is_not_documented_counts_and_is_not_judged_by():
    bays, court = Evidence("bays", 0.1, 0.03, "bays", documented=False), Evidence("court", 0.1, 0.05, "a court")
    with_it, without = combined(VEHICLES, PARTS, [bays, court]), combined(VEHICLES, PARTS, [court])
    assert with_it.posterior.spread < 0.8 * without.posterior.spread
    judged, alone = (one.support.judged(one.posterior.spread) for one in (with_it, without))
    assert judged == pytest.approx(without.posterior.spread) == pytest.approx(alone)
    far = combined(VEHICLES, PARTS, [Evidence("bays", 0.115, 0.01, "bays", documented=False)])
    assert not far.support.doubted and [r.severity for r in far.remarks] == ["caution"], "said, but the verdict stays"


def test_evidence_chooses_between_two_possibilities():
    either = Posterior(np.array([0.5, 0.5]), np.log([0.08, 0.12]), np.array([0.02, 0.02]))
    together = combined(either, {"fleet": either.spread}, [Evidence("tape", 0.12, 0.03, "a tape")])
    assert together.summary[0] == pytest.approx(0.12, rel=0.01) and together.posterior.spread < 0.025


def test_quantiles_of_a_normal_and_of_a_mixture():
    assert VEHICLES.quantile(0.95) == pytest.approx(np.log(0.10) + 1.64485 * 0.05, abs=1e-5)
    lopsided = Posterior(np.array([0.9, 0.1]), np.array([0.0, 1.0]), np.array([0.1, 0.1]))
    assert lopsided.quantile(0.95) == pytest.approx(1.0, abs=1e-3)
    assert lopsided.centre == pytest.approx(0.1) and lopsided.spread == pytest.approx(np.sqrt(0.01 + 0.09))


def test_a_known_distance():
    found = known_distance(np.array([[0, 0], [300, 400.0]]), 50.0, 0.25)
    assert (found.value, found.relative_sd) == pytest.approx((0.1, 0.005))
    assert known_distance(np.array([[0, 0, 0], [0, 0, 2.0]]), 30.0).relative_sd == pytest.approx(0.01)
    short = known_distance(np.array([[0, 0], [3, 0]]), 0.27, 0.001, read_sd=0.7)
    assert short.relative_sd == pytest.approx(0.7 / 3, rel=0.01), "three pixels are no ruler"


def test_two_control_points_are_as_good_as_is_assumed_of_them():
    """10 m and 100 px apart, so 5 m and 50 px from their middle; one sigma of 0.05 m, and of half a pixel."""
    pixels, metres = np.array([[0, 0], [60, 80.0]]), np.array([[0, 0], [6, 8.0]])
    found, exact = (ground_control(pixels, metres, read_sd) for read_sd in (0.5, 0.0))
    assert found.value == exact.value == pytest.approx(0.1)
    assert exact.says == "ground control (2 points, assumed good to 0.05 m, as two do not check each other)"
    assert exact.relative_sd == pytest.approx(0.05 / np.sqrt(50))
    assert found.relative_sd == pytest.approx(np.hypot(0.05 / np.sqrt(50), 0.5 / np.sqrt(5000)))


def test_what_control_points_leave_tells_how_good_they_are():
    """A similarity of the plane has four unknowns; here it is a factor of complex numbers."""
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 1000, (5, 2))
    metres = pixels @ (0.1 * np.array([[0.6, 0.8], [-0.8, 0.6]])) + rng.normal(0, 2.0, (5, 2))
    x, y = ((p - p.mean(0)) @ (1, 1j) for p in (pixels, metres))
    left = y - x * np.vdot(x, y) / np.vdot(x, x)
    sd = np.sqrt((np.abs(left) ** 2).sum() / (np.abs(y) ** 2).sum() / 6) * t.ppf(0.95, 6) / 1.6449
    assert ground_control(pixels, metres).relative_sd == pytest.approx(sd, rel=1e-3)


@pytest.mark.parametrize(
    "points, metres, sd, why",
    [
        ([[1, 1], [1, 1]], 5, 1, "points must differ"), ([[0, 0], [np.nan, 1]], 5, 1, "points must differ"),
        ([[0, 0], [1, 1]], -5, 1, "the distance must be"), ([[0, 0], [1, 1]], 1e300, 1e299, "the distance must be"),
        *(([[0, 0], [1, 1]], 5, sd, "the sigma must be") for sd in (0, 4e-6, 6, 1e300, np.nan)),
    ],
)  # fmt: skip
def test_a_distance_that_makes_no_sense(points, metres, sd, why):
    with pytest.raises(ValueError, match=why):
        known_distance(np.array(points, float), metres, sd)


def test_points_that_lie_close_in_the_picture_are_no_ruler():
    units, metres = np.array([[0, 0], [3.0, 0]]), np.array([[0, 0], [0.27, 0]])
    assert ground_control(units, 100 * metres, 0.5).relative_sd == pytest.approx(0.5 / (3 / np.sqrt(2)), rel=0.01)
    assert ground_control(1000 * units, 1000 * metres, 0.5).relative_sd < 0.001


def test_ground_control_is_a_similarity_wherever_its_axes_point():
    rng = np.random.default_rng(0)
    units = rng.uniform(0, 10, (6, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    metres = 7.3 * units @ turn + [400_000, 5_800_000, 90]
    exact = ground_control(units, metres)
    assert exact.value == pytest.approx(7.3, rel=1e-9)
    noisy = ground_control(units, metres + rng.normal(0, 0.5, metres.shape))
    assert abs(np.log(noisy.value / 7.3)) < 3 * noisy.relative_sd and noisy.relative_sd > 2 * exact.relative_sd
    with pytest.raises(ValueError, match="two points"):
        ground_control(units[:1], metres[:1])


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_the_interval_by_few_points_holds(count, dims):
    """Points good to 1 m over 200 m: nothing but their residuals tells that they are no better."""
    rng, hits = np.random.default_rng(0), 0
    for _ in range(2000):
        metres = rng.uniform(0, 200, (count, dims))
        units = metres @ np.linalg.qr(rng.normal(size=(dims, dims)))[0] / 14
        found = ground_control(units, metres + rng.normal(0, 1, metres.shape))
        hits += abs(np.log(found.value / 14)) < Z90 * found.relative_sd
    assert hits / 2000 == pytest.approx(0.9, abs=0.02)


def test_what_residuals_show_of_the_reading_does_not_count_twice():
    rng, sigmas = np.random.default_rng(0), []
    for _ in range(1000):
        metres = rng.uniform(0, 2000, (20, 2))
        found = ground_control(metres + rng.normal(0, 0.5, metres.shape), metres, 0.5)
        sigmas.append(np.log(found.value) / found.relative_sd)
    assert 0.88 < np.sqrt(np.mean(np.square(sigmas))) < 1.05


def test_each_point_is_read_as_well_as_it_can_be():
    ends = np.array([[0, 0], [100.0, 0]])
    one, both = (ground_control(ends, 1000 * ends, np.array(sd)).relative_sd for sd in ([0.5, 0], [0.5, 0.5]))
    assert (one, both) == pytest.approx((0.005, 0.005 * np.sqrt(2)), rel=1e-3)
    square = 100 * np.array([[0, 0], [1.0, 0], [1, 1], [0, 1]])
    some = ground_control(square, 1000 * square, np.array([0.5, 0, 0, 0])).relative_sd
    assert some == pytest.approx(ground_control(square, 1000 * square, 0.5).relative_sd / 2, rel=1e-3)


def test_two_points_have_no_residuals_and_that_is_said():
    ends = np.array([[0, 0], [100.0, 0], [0, 70]])
    assert (
        ground_control(ends[:2], ends[:2]).says
        == "ground control (2 points, assumed good to 0.05 m, as two do not check each other)"
    )
    assert ground_control(ends, ends).says == "ground control (3 points)"


def scale_by(kind, size, pixel, country=""):
    place = 1000.0 * np.arange(2 * len(size)).reshape(-1, 2)
    found = evidence_of(standard_objects(kind, known_objects().get(kind, []), size, pixel, place), country)
    return found[0] if found else None


def test_courts_and_containers_are_told_apart_by_their_shape():
    pixel = np.full(2, 1.0)
    court = scale_by("tennis-court", np.array([[237.7, 109.7], [238.5, 110.0]]), pixel)
    assert court.value == pytest.approx(0.1, rel=0.01) and court.relative_sd < 0.02
    boxes = np.array([[121.9, 24.4], [60.6, 24.4]])  # 40 and 20 feet
    assert scale_by("container", boxes, pixel).value == pytest.approx(0.1, rel=0.01)
    assert scale_by("tennis-court", np.array([[100.0, 95.0]]), pixel[:1]) is None  # no court is square
    assert scale_by("swimming-pool", boxes, pixel) is None


@pytest.mark.parametrize("stretched, found", [(1.0, 400), (1.12, 0)])
def test_the_diagonal_of_a_box_errs_as_it_says_and_one_of_another_shape_is_no_court(stretched, found):
    """Half of the variance of an edge is that of its box's other edges, too."""
    court, rng = np.array([237.7, 109.7]), np.random.default_rng(0)
    alike, own = rng.standard_normal((400, 1)), rng.standard_normal((400, 2))
    size = court * (1, stretched) + EDGE_SD * np.sqrt(0.5) * (alike + own)
    votes = standard_objects(
        "tennis-court", known_objects()["tennis-court"][:1], size, np.ones(400), np.zeros((400, 2))
    )
    assert found * 0.98 <= len(votes) <= found
    if votes:
        error = np.log([vote.units / np.hypot(*court) for vote in votes])
        assert np.std(error) == pytest.approx(np.mean([vote.relative_sd for vote in votes]), rel=0.1)


@pytest.mark.parametrize("kind, built", [("container", 3), ("basketball-court", 3), ("tennis-court", 1)])
def test_boxes_that_may_be_of_several_standards_are_as_good_as_they_say(kind, built):
    """Objects of any of the first `built` standards, boxed to EDGE_SD at 0.1 m/px, beside vehicles good to 5 %."""
    rng, standards = np.random.default_rng(1), known_objects()[kind]
    inside, pulls = [], []
    for _ in range(300):
        true = standards[rng.integers(built)]
        sides = np.array([rng.normal(*true["length"]), rng.normal(*true["width"])])
        found = scale_by(kind, sides[None] / 0.1 + rng.normal(0, EDGE_SD, (1, 2)), np.ones(1))
        vehicles = Posterior.normal(np.log(0.1) + rng.normal(0, 0.05), 0.05)
        together = combined(vehicles, PARTS, [found] if found else [])
        value, low, high = together.summary
        inside.append(low < 0.1 < high)
        pulls.append(np.log(value / 0.1) / together.posterior.spread)
    assert np.mean(inside) > 0.87 and np.std(pulls) < 1.3


def test_boxes_of_one_standard_count_together_whatever_their_shapes_say():
    boxes = np.array([[121.9, 24.4], [121.9, 23.8], [121.9, 22.8]])  # of 40 feet; the last are like those of 45, too
    found = scale_by("container", boxes, np.ones(3))
    assert found.says == "3 x container (diagonal of container 40ft, 12.43 m)"
    assert found.value == pytest.approx(0.1, rel=0.01)
    share = sum(w for w, words in zip(found.own.weight, found.words, strict=True) if "40ft" in words)
    assert 0.5 < share < 0.95


def test_american_containers_are_hardly_looked_for_elsewhere():
    box = np.array([[150.0, 25.0]])  # between 45 and 53 feet
    domestic = [
        sum(w for w, words in zip(found.own.weight, found.words, strict=True) if "53ft" in words)
        for found in (scale_by("container", box, np.ones(1), country) for country in ("US", "DE"))
    ]
    assert domestic[0] > 0.3 and domestic[1] < 0.1


def test_a_box_of_an_object_that_contradicts_the_vehicles_is_said_to_and_does_not_move_them():
    box = np.array([[300.0, 138.4]])  # a tennis court, were a pixel 7.9 cm
    found = scale_by("tennis-court", box, np.ones(1))
    together = combined(VEHICLES, PARTS, [found])
    assert found.value < 0.08 and together.summary[0] == pytest.approx(0.1) and together.summary[2] > 0.108
    assert together.conflict > 3 and together.remarks[0].severity == "refusal"
    assert "the most certain side alone, vehicles" in together.remarks[1].text


def test_every_standard_says_where_it_comes_from():
    for standards in known_objects().values():
        for s in standards:
            assert s["source"] and s["length"][0] > s["width"][0] > 2 and min(s["length"][1], s["width"][1]) > 0
