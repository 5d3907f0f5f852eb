"""What anchors do to a scale: right ones narrow it honestly, wrong ones never move it far, contradictions are said."""

from dataclasses import replace

import numpy as np
import pytest
from support.anchors import vote
from support.simulate import car_park
from test_enlarged import Pixels

from orthoscale.core.anchors import Standard
from orthoscale.core.evidence import Evidence
from orthoscale.core.pooling.anchors import NO_RULE, SHARED, country_agreement, evidence_of, tells_country
from orthoscale.core.pooling.combining import combined
from orthoscale.core.pooling.posterior import Posterior
from orthoscale.core.pooling.robust import pool
from orthoscale.core.remarks import INFO, REFUSAL
from orthoscale.core.ruler import Ruler
from orthoscale.core.scale import PER_PIXEL
from orthoscale.fleets import load_fleet
from orthoscale.report.anchors import size_of
from orthoscale.report.scene import _crop

SD = 0.05  # of the vehicles
RULER = Ruler(margin=(1.0, 1.5), margin_sd=(0.5, 0.5), bias_sd=(0.015, 0.02), common_sd=0.02, noise=(1.5, 1.0))
COURT = (Standard("court", 23.77, 0.003, "written here"),)
BAYS = tuple(Standard(f"bays of {m} m", m, 0.01, "written here", p) for m, p in ((2.3, 0.2), (2.5, 0.5), (2.7, 0.3)))
REACH = 3.0


def together(votes, centre=0.0, country="", **more):
    return combined(
        Posterior.normal(centre, SD), {"sampling": SD}, [*evidence_of(votes, country), *more.values()], PER_PIXEL
    )


def seen(rng, kind, standards, count, sd, false, centre):
    """Anchors of one kind that err as they say: all of them are none with probability `false`, and half of their
    variance is common to them. The truth is 0."""
    prior = np.array([s.prior for s in standards])
    meant = int(rng.choice(len(standards), p=prior / prior.sum()))
    wrong = rng.random() < false
    middle = centre + rng.uniform(-0.2, 0.2) if wrong else rng.normal(0, standards[meant].relative_sd)
    middle += rng.normal(0, sd * np.sqrt(SHARED))
    each = middle + rng.normal(0, sd * np.sqrt(1 - SHARED), count)
    return [vote(kind, x, sd, standards, meant, false, at=1e4 * k) for k, x in enumerate(each)]


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("court",), ("bays",), ("court", "bays")])
@pytest.mark.parametrize("false", [0.001, 0.03, 0.2])
def test_nine_intervals_of_ten_hold_the_truth_and_no_answer_leaves_the_vehicles(kinds, false):
    rng, inside, beyond = np.random.default_rng(4), [], 0
    for _ in range(400):
        centre = rng.normal(0, SD)
        votes = []
        if "court" in kinds:
            votes += seen(rng, "tennis court", COURT, rng.integers(1, 7), 0.004, false, centre)
        if "bays" in kinds:
            votes += seen(rng, "parking bays", BAYS, rng.integers(1, 5), 0.006, false, centre)
        got = together(votes, centre)
        value, low, high = np.log(got.summary)
        beyond += abs(value - centre) > REACH * SD
        if not got.conflict:
            inside.append(low <= 0 <= high)
    assert len(inside) > 370, "true anchors seldom contradict"
    assert 0.87 - 0.015 <= np.mean(inside) <= 0.93 + 0.015  # one sigma of the draws is 0.015
    assert beyond <= (4 if len(kinds) == 2 else 0), "only two kinds that agree may leave the vehicles' 99.7 %"


def test_a_court_narrows_the_interval_and_says_how_much_of_it_is_left():
    got = together([vote("tennis court", 0.03, 0.004, COURT)])
    value, low, high = np.log(got.summary)
    assert value == pytest.approx(0.03, abs=0.002) and high - low < 0.2 * 2 * 1.645 * SD
    assert max(got.parts, key=got.parts.get) == "tennis court" and not got.remarks


@pytest.mark.parametrize("off", [-0.19, -0.16, 0.16, 0.19])
@pytest.mark.parametrize("false", [0.001, 0.05, 0.3])
@pytest.mark.parametrize("count", [1, 30])
def test_a_wrong_kind_never_moves_the_answer_out_of_the_vehicles_interval(off, false, count):
    votes = [vote("tennis court", off, 0.004, COURT, false=false, at=1e4 * k) for k in range(count)]
    got = together(votes)
    assert abs(np.log(got.summary[0])) < REACH * SD
    if abs(off) > 3.02 * SD and false <= 0.05:
        assert got.conflict > 3 and got.remarks[0].text.startswith("conflict: vehicles: 1")
    else:
        assert not got.conflict and "it does not count" in got.remarks[0].text
        assert got.summary == pytest.approx(together([]).summary, rel=1e-12)


@pytest.mark.parametrize("off", [-0.135, 0.135])
def test_a_doubtful_kind_that_does_not_contradict_the_vehicles_gives_an_answer_of_two_humps(off):
    """2.7 sigmas off: neither said to contradict them nor left out, but counted as much as its doubt leaves it."""
    got = together([vote("zebra crossing", off, 0.01, COURT, false=0.2)])
    low, high = sorted(np.log(got.summary[1:]) * np.sign(off))
    assert not got.conflict and [r.severity for r in got.remarks] == ["caution"]
    assert low < 0 and high > abs(off) - 0.02
    surer = together([vote("zebra crossing", off, 0.01, COURT, false=0.01)])
    assert abs(np.log(got.summary[0])) < abs(np.log(surer.summary[0]))


def test_two_kinds_that_contradict_each_other_are_said_and_not_averaged():
    got = together([vote("tennis court", 0.04, 0.004, COURT), vote("lane dashes", -0.04, 0.004, COURT)])
    assert got.conflict > 3 and got.remarks[0].severity == REFUSAL
    assert "tennis court" in got.remarks[0].text and "lane dashes" in got.remarks[0].text
    assert got.summary[1] < np.exp(-0.04) and got.summary[2] > np.exp(0.04)
    weak = together([vote("tennis court", 0.04, 0.004, COURT), vote("lane dashes", -0.04, 0.004, COURT, false=0.4)])
    assert not weak.conflict and np.log(weak.summary[0]) == pytest.approx(0.04, abs=0.004)


def test_kinds_that_contradict_each_other_without_vehicles_span_what_they_say_and_no_more():
    court, dashes = (vote(kind, off, 0.004, COURT) for kind, off in (("tennis court", 0.05), ("lane dashes", -0.05)))
    value, low, high = np.log(combined(None, {}, evidence_of([court, dashes]), PER_PIXEL).summary)
    assert -0.07 < low < -0.05 and 0.05 < high < 0.07 and min(abs(value - 0.05), abs(value + 0.05)) < 1e-6


def test_two_kinds_that_agree_are_believed_where_one_alone_is_not():
    dashes, court = (
        vote(kind, off, 0.004, COURT, false=0.4) for kind, off in (("lane dashes", 0.14), ("tennis court", 0.142))
    )
    assert abs(np.log(together([court]).summary[0])) < 0.02
    both = together([court, dashes])
    assert not both.conflict and np.log(both.summary[0]) == pytest.approx(0.141, abs=0.003)


def test_the_vehicles_tell_which_standard_it_is():
    for meant, standard in enumerate(BAYS):
        alone = evidence_of([vote("parking bays", 0.0, 0.003, BAYS, meant)])[0]
        assert len(alone.posterior.mean) == 3 and alone.value == pytest.approx(2.5 / standard.metres)
        known = combined(Posterior.normal(0.0, 0.02), {"sampling": 0.02}, [alone], PER_PIXEL)
        assert np.log(known.summary[0]) == pytest.approx(0.0, abs=0.01)
        (told,) = known.evidence
        assert told.value == pytest.approx(1.0) and standard.name in told.says


def test_standards_of_the_country_come_first():
    there = (Standard("ours", 2.5, 0.001, "s", countries=("DE",)), Standard("theirs", 2.7, 0.001, "s", 3.0, ("US",)))
    bays = [vote("parking bays", 0.0, 0.003, there)]
    assert evidence_of(bays)[0].value == pytest.approx(2.7 / 2.5)
    assert evidence_of(bays, "DE")[0].value == pytest.approx(1.0)


def test_many_of_a_kind_are_not_independent():
    sds = [evidence_of([vote("c", 0.0, 0.01, COURT, at=1e4 * k) for k in range(n)])[0].relative_sd for n in (1, 4, 400)]
    assert sds[0] == pytest.approx(np.hypot(0.01, 0.003))
    assert sds[1] == pytest.approx(np.sqrt(0.01**2 * (SHARED + (1 - SHARED) / 4) + 0.003**2), rel=0.01)
    assert sds[2] == pytest.approx(np.sqrt(0.01**2 * SHARED + 0.003**2), rel=0.01)


@pytest.mark.parametrize("sds", [(0.004, 0.004), (0.002, 0.02), (0.004, 0.004, 0.004, *4 * (0.03,)), (0.01, 0.05)])
def test_a_kind_of_sure_and_of_vague_anchors_errs_as_it_says(sds):
    """Half of each one's variance is its own; what the others are off by besides is nobody's."""
    rng, sd = np.random.default_rng(1), np.array(sds)
    sigmas = []
    for _ in range(150):
        off = sd * (np.sqrt(SHARED) * rng.normal() + np.sqrt(1 - SHARED) * rng.normal(size=len(sd)))
        off += COURT[0].relative_sd * rng.normal()
        (found,) = evidence_of([vote("c", off[k], sd[k], COURT, at=1e4 * k) for k in range(len(sd))])
        sigmas.append(np.log(found.value) / found.relative_sd)
    assert 0.85 < np.sqrt(np.mean(np.square(sigmas))) < 1.15


def test_what_only_a_kind_has_in_common_is_no_error_of_the_vehicles():
    """How high containers are boxed makes them all wrong alike, and leaves the vehicles as sure as they are."""
    votes = [replace(vote("container", 0.0, 0.004, COURT, at=1e4 * k), kind_sd=0.1) for k in range(9)]
    (found,) = evidence_of(votes)
    assert found.relative_sd == pytest.approx(0.1, rel=0.01), "however many there are"
    assert together(votes).posterior.spread == pytest.approx((SD**-2 + found.relative_sd**-2) ** -0.5, rel=0.02)


def test_what_all_on_one_ground_have_in_common_stays_however_many_kinds_there_are():
    """Vehicles and anchors of a model err alike by its ground, by 1 %; a tape does not."""
    kinds = [replace(vote(kind, 0.01, 0.002, COURT), shared_sd=0.01) for kind in ("court", "dashes", "bays")]
    (one, *_) = evidence_of(kinds)
    assert one.relative_sd == pytest.approx(np.sqrt(0.002**2 + 0.003**2 + 0.01**2))
    got = together(kinds)
    assert 0.01 < got.posterior.spread < 0.0105 and np.log(got.summary[0]) == pytest.approx(0.01, abs=0.0003)
    assert got.parts["geometry"] == pytest.approx(0.01, rel=0.01) and sum(v**2 for v in got.parts.values()) == (
        pytest.approx(got.posterior.spread**2)
    )
    taped = together(kinds, tape=Evidence("known distance", 1.0, 0.001, "a tape"))
    assert taped.posterior.spread < 0.001 and np.log(taped.summary[0]) == pytest.approx(0.0, abs=0.0003)


def test_what_is_in_a_row_is_told_as_how_many_of_what_length():
    """A zebra crossing was one of "stripes 0.50 m, gaps 0.50 m, 1 m"."""
    one = vote("crossing", 0.0, 0.004, [Standard("stripes 0.50 m, gaps 0.50 m", 1.0, 0.01, "")])
    row = replace(one, anchor=replace(one.anchor, count=7))
    for votes, said in (
        ([one], "crossing (stripes 0.50 m, gaps 0.50 m, 1 m)"),
        ([row], "crossing (7 in a row, each 1 m: stripes 0.50 m, gaps 0.50 m)"),
        ([row, row], "2 x crossing (14 in rows, each 1 m: stripes 0.50 m, gaps 0.50 m)"),
    ):
        assert evidence_of(votes)[0].says == said


def test_a_picture_of_a_row_has_the_words_of_the_report():
    """The picture's title was still "stripes 0.50 m, gaps 0.50 m, 1 m, 7 in a row"."""
    crossing = {"kind": "crossing", "standard": "stripes 0.50 m, gaps 0.50 m", "metres": 1.0, "counted": True}
    crossing["lines_px"] = [[[2, 2], [9, 2]]]
    picture = Pixels(np.zeros((20, 20, 3), np.uint8))
    for count, said in (
        (1, "stripes 0.50 m, gaps 0.50 m, 1 m"),
        (7, "7 in a row, each 1 m: stripes 0.50 m, gaps 0.50 m"),
    ):
        assert size_of({**crossing, "count": count}) == said
        assert _crop({**crossing, "count": count}, picture).title == f"crossing: {said}"


def test_an_odd_one_among_many_does_not_count():
    votes = [vote("tennis court", x, 0.004, COURT, at=1e4 * k) for k, x in enumerate([0.0, 0.002, -0.001, 0.08])]
    (found,) = evidence_of(votes)
    assert abs(np.log(found.value)) < 0.002 and found.says.startswith("3 x tennis court")
    value, low, high = np.log(together(votes).summary)
    assert abs(value) < 0.003 and high < 0.06


def test_an_odd_one_does_not_count_however_sure_it_is_to_be_one():
    votes = [vote("court", x, 0.004, COURT, false=0.0, at=1e4 * k) for k, x in enumerate([0.0, 0.002, -0.001, 0.08])]
    assert abs(np.log(evidence_of(votes)[0].value)) < 0.002


def test_a_likely_mistake_counts_less_in_the_mean_and_a_kind_is_as_sure_as_its_surest():
    sure, unsure = vote("court", 0.0, 0.01, COURT, false=0.02), vote("court", 0.012, 0.01, COURT, false=0.97, at=1e4)
    (found,) = evidence_of([sure, unsure])
    assert 0 < np.log(found.value) < 0.3 * 0.012 and found.doubt == 0.02
    (found,) = evidence_of([replace(sure, anchor=replace(sure.anchor, false=false)) for false in (0.2, 0.02)])
    assert found.doubt == 0.02


def test_an_anchor_that_is_likely_a_mistake_is_no_vaguer_for_it():
    (found,) = evidence_of([vote("court", 0.0, 0.02, COURT, false=0.95)])
    assert found.doubt == 0.95 and found.relative_sd == pytest.approx(np.hypot(0.02, COURT[0].relative_sd))


def test_what_is_built_abroad_is_copied_seldom():
    both = tuple(Standard(f"of {c}", m, 0.001, "s", countries=(c,)) for c, m in (("DE", 2.5), ("US", 2.7)))
    for country, own in (("DE", 0), ("US", 1)):
        weight = evidence_of([vote("court", 0.0, 0.003, both)], country)[0].posterior.weight
        assert weight[own] > 0.9


def test_a_rule_that_a_country_seldom_follows_tells_it_as_seldom():
    """Of the bays there three in ten are as these; the finds that are mistakes tell nothing."""
    rare, usual = (
        vote("parking bays", 0.0, 0.003, (Standard("ours", 2.5, 0.001, "s", prior, ("DE",)),)) for prior in (0.3, 1.0)
    )
    cars = {"DE": Posterior.normal(0.0, 0.02)}
    share = country_agreement([rare], cars)["DE"] / country_agreement([usual], cars)["DE"]
    assert share == pytest.approx(0.3, abs=0.03)


def test_what_is_drawn_stands_for_what_is_only_boxed():
    drawn, boxed = vote("tennis court", 0.0, 0.004, COURT), vote("tennis court", 0.05, 0.001, COURT, false=0.0)
    boxed.anchor.lines.resize((0, 2, 2), refcheck=False)
    (found,) = evidence_of([drawn, boxed])
    assert abs(np.log(found.value)) < 1e-9


def test_without_anchors_nothing_changes():
    """What was computed before there were anchors: a product of normal distributions."""
    tape = Evidence("tape", 1.02, 0.01, "a tape")
    value, low, high = np.log(together([], tape=tape).summary)
    precision = SD**-2 + 0.01**-2
    mean, sd = np.log(1.02) * 0.01**-2 / precision, precision**-0.5
    assert [value, low, high] == pytest.approx([mean, mean - 1.6448536 * sd, mean + 1.6448536 * sd], abs=1e-9)


def test_a_known_distance_that_agrees_with_a_far_court_makes_it_count():
    tape = Evidence("known distance", np.exp(0.135), 0.01, "a tape")
    got = together([vote("tennis court", 0.14, 0.004, COURT)], tape=tape)
    assert np.log(got.summary[0]) == pytest.approx(0.14, abs=0.006) and not got.remarks


CARS = {"US": 4.87, "JP": 4.00, "CN": 4.53}  # [m] mean lengths
WIDE = {"US": 2.74, "JP": 2.50, "CN": 2.40}  # [m] bays
NATIONAL = tuple(Standard(f"bays of {m} m", m, 0.04, "written here", 1.0, (c,)) for c, m in WIDE.items())


def by_cars(truly):
    """The scale by American, Japanese and Chinese cars where those of `truly` stand; the true one is 0."""
    return {code: Posterior.normal(np.log(length / CARS[truly]), 0.03) for code, length in CARS.items()}


@pytest.mark.parametrize("truly", ["US", "JP"])
def test_bays_suit_the_cars_of_their_country(truly):
    """American cars are 1.78 m long for each metre of their bays' width, Japanese ones 1.6 m."""
    bays = [vote("parking bays", 0.0, 0.005, NATIONAL, list(WIDE).index(truly))]
    assert all(tells_country(each) for each in bays)
    likely = country_agreement(bays, by_cars(truly))
    assert likely[truly] == max(likely.values())
    other = "JP" if truly == "US" else "US"
    assert likely[truly] > 2.5 * likely[other]


def test_lines_are_of_a_country_that_has_such_a_rule():
    """America has it, Japan's lines look otherwise, and of China's nothing is known here: one of four may be alike."""
    rule = (Standard("ten feet of forty", 12.192, 0.01, "written here", 1.0, ("US",)),)
    plain = vote("lane dashes", 0.0, 0.005, rule, false=0.07)
    line = replace(plain, anchor=replace(plain.anchor, unlike=("JP", "DE", "KR")))
    assert tells_country(line) and not tells_country(plain) and not evidence_of([line])
    likely = country_agreement([line], dict.fromkeys(CARS, Posterior.normal(0.0, 0.03)))
    assert likely["US"] > 2 * likely["CN"] and likely["CN"] > 1.5 * likely["JP"]
    assert likely["JP"] == pytest.approx((1 - 0.93 * (1 - NO_RULE)) / line.window)  # a mistake, or by no rule


def line_of(countries, unlike, log_scale=0.0, at=0.0):
    rule = tuple(Standard(f"of {code}", 12.0, 0.01, "written here", 1.0, (code,)) for code in countries)
    plain = vote("lane dashes", log_scale, 0.005, rule, false=0.07, at=at)
    return replace(plain, anchor=replace(plain.anchor, unlike=unlike))


def test_bays_and_lines_share_the_vehicles_error():
    """Both 10 % off by Japanese cars: once the bays have shown the cars to be off, lines that agree add hardly more."""
    vehicles = {"US": Posterior.normal(0.0, 0.05), "JP": Posterior.normal(-0.1, 0.05)}
    same = tuple(replace(standard, metres=2.5) for standard in NATIONAL)
    bays, line = vote("parking bays", 0.0, 0.005, same), line_of(("US", "JP"), ())
    line = replace(line, anchor=replace(line.anchor, unlike=("DE",)))
    likely = [country_agreement(votes, vehicles) for votes in ([bays], [line], [bays, line], [line, bays])]
    alone, lines, both, turned = (each["US"] / each["JP"] for each in likely)
    assert max(alone, lines) < both < 0.8 * alone * lines
    assert turned == pytest.approx(both, rel=0.1)


def test_lines_that_a_country_cannot_have_do_not_speak_for_it():
    vehicles = {code: Posterior.normal(0.0, 0.03) for code in ("US", "JP")}
    own = country_agreement([line_of(("JP",), ("US",), 0.15)], vehicles)["JP"]
    others = [line_of(("US",), ("JP",), at=100.0 * k) for k in range(1, 6)]
    assert country_agreement([line_of(("JP",), ("US",), 0.15), *others], vehicles)["JP"] <= own


def test_boxed_bays_beside_drawn_ones_tell_no_country_either():
    drawn = vote("parking bays", 0.0, 0.005, NATIONAL)
    boxed = replace(drawn, anchor=replace(drawn.anchor, lines=np.empty((0, 2, 2))))
    assert country_agreement([drawn, boxed], by_cars("US")) == country_agreement([drawn], by_cars("US"))


def test_bays_of_a_known_country_are_its_own():
    """The fleet may be the world's where the place is known."""
    (there,) = evidence_of([vote("parking bays", 0.0, 0.005, NATIONAL)], "US")
    assert len(there.posterior.mean) == 1 and there.value == pytest.approx(1.0)
    everywhere = Standard("bays of 2.48 m", 2.48, 0.06, "written here")
    (unknown,) = evidence_of([vote("parking bays", 0.0, 0.005, (*NATIONAL, everywhere))])
    assert len(unknown.posterior.mean) == 1 and unknown.value == pytest.approx(2.48 / 2.74)


def test_what_is_alike_everywhere_tells_no_country():
    court = vote("tennis court", 0.0, 0.004, COURT)
    rails = vote("rails", 0.0, 0.004, NATIONAL)  # a gauge measures, whichever it is
    assert not tells_country(court) and not tells_country(rails)
    assert not tells_country(vote("parking bays", 0.0, 0.004, BAYS))
    assert set(country_agreement([], by_cars("US")).values()) == {1.0}


def test_where_the_country_is_not_known_bays_tell_it_and_do_not_measure():
    """They are wide where cars are long: beside cars of an unknown country they are no second measure."""
    some = tuple(load_fleet(code) for code in WIDE)
    unknown = replace(load_fleet("world"), candidates=some, prior=(1 / 3,) * 3)
    bays = [vote("parking bays", np.log(0.12), 0.005, NATIONAL, 0, at=100 * k) for k in range(3)]
    court = [vote("tennis court", np.log(0.12), 0.01, COURT)]
    errors = []
    for k in range(6):
        votes = car_park(np.random.default_rng([7, k]), load_fleet("US"), 60, 0.12, RULER)
        plain, told, known = (
            pool(votes, fleet, RULER, "m/px", anchors=anchors, country=country)
            for fleet, anchors, country in ((unknown, [], ""), (unknown, bays, ""), (some[0], bays, "US"))
        )
        assert told.fleets["US"] > plain.fleets["US"]
        assert not told.evidence and [r.severity for r in told.remarks].count(INFO) == 1
        assert [e.kind for e in known.evidence] == ["parking bays"]
        errors.append([abs(np.log(scale.value / 0.12)) for scale in (plain, told)])
    assert np.mean(errors, axis=0)[1] < 0.9 * np.mean(errors, axis=0)[0]
    measured = pool(votes, unknown, RULER, "m/px", anchors=[*bays, *court])
    assert [e.kind for e in measured.evidence] == ["tennis court"]
