"""What vehicles are called (car, pickup, van, larger) says which class they are of, as far as the card's table goes."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from support.simulate import Vans, car_park

from orthoscale.core.boxes import KINDS
from orthoscale.core.detections import Detections
from orthoscale.core.pooling.beside_fleet import LARGER, LORRIES, left_out
from orthoscale.core.pooling.by_kind import country_likelihoods
from orthoscale.core.pooling.observed import Confusion
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.detect.measurer import MeasurerCard
from orthoscale.errors import InputError
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import load_detections, save_detections
from orthoscale.report.wording import counted_kinds
from training.measurer.confusion import card_entries

TABLE = ((0.93, 0.03, 0.03, 0.01), (0.15, 0.8, 0.03, 0.02), (0.2, 0.03, 0.72, 0.05), (0.05, 0.05, 0.1, 0.8))
SILENT = Ruler(margin=(1.0, 1.5), margin_sd=(0.5, 0.5), bias_sd=(0.015, 0.02), common_sd=0.02, noise=(1.5, 1.0))
RULER = replace(SILENT, kinds=TABLE)
GSD = 0.12


def errors(fleet, seen, places=36, n=60, **odd):
    """(P,) log errors, (P,) claimed sigmas and (P,) bool, whether the interval holds, with kinds `seen` or not."""
    rows = []
    for k in range(places):
        votes = car_park(np.random.default_rng([8, k]), fleet, n, GSD, RULER, **odd)
        scale = pool(votes if seen else replace(votes, kinds=np.nan), fleet, RULER, "m/px")
        low, high = scale.interval90
        rows.append((np.log(scale.value / GSD), scale.relative_sd, low <= GSD <= high))
    return np.array(rows).T


def rms(values):
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize(
    ("code", "odd"),
    [("PH", {"most": ("pickup", 0.8)}), ("TH", {"most": ("pickup", 0.0)}), ("DE", {"vans": Vans(0.6)})],
    ids=["a street of pickups in the Philippines", "one without in Thailand", "a lot of vans in Germany"],
)
def test_an_odd_place_is_known_by_what_stands_there(code, odd):
    fleet = load_fleet(code)
    without, with_ = (errors(fleet, seen, **odd) for seen in (False, True))
    assert rms(with_[0]) < 0.85 * rms(without[0])
    assert with_[2].sum() >= without[2].sum()


@pytest.mark.slow
@pytest.mark.parametrize("code", ["US", "PH"])
def test_intervals_keep_their_word_where_kinds_are_seen(code):
    fleet = load_fleet(code)
    error, sd, held = errors(fleet, True, 60, false=0.1, vans=Vans(0.1))
    assert held.mean() >= 0.9 - 2.7 * np.sqrt(0.09 / 60)
    assert rms(error) < 1.3 * rms(sd)
    assert rms(error) < 1.1 * rms(errors(fleet, False, 60, false=0.1, vans=Vans(0.1))[0])


def test_kinds_are_counted_in_words():
    assert counted_kinds(["van", "car", "larger", "car", "", "larger"]) == "2 cars, 1 van, 2 larger, 1 of unknown kind"
    assert counted_kinds(["", ""]) == counted_kinds([]) == ""


def test_without_a_table_or_a_look_kinds_change_nothing():
    fleet = load_fleet("US")
    votes = car_park(np.random.default_rng(1), fleet, 60, GSD, RULER)
    unseen = replace(votes, kinds=np.nan)
    plain = pool(unseen, fleet, SILENT, "m/px")
    for some, ruler in ((votes, SILENT), (unseen, RULER)):
        other = pool(some, fleet, ruler, "m/px")
        assert other.value == plain.value and other.interval90 == plain.interval90 and other.parts == plain.parts
    assert pool(votes, fleet, RULER, "m/px").value != plain.value


def test_half_of_the_vehicles_looked_at_tells_as_much_as_they_know():
    """Vehicles that nobody looked at count by their sizes alone."""
    fleet = load_fleet("US")
    votes = car_park(np.random.default_rng(3), fleet, 80, GSD, RULER, most=("pickup", 0.8))
    half = votes.kinds.copy()
    half[::2] = np.nan
    none, some, every = (
        np.log(pool(replace(votes, kinds=kinds), fleet, RULER, "m/px").value / GSD)
        for kinds in (None, half, votes.kinds)
    )
    assert abs(some - every) < abs(some - none)


def test_one_vehicle_looked_at_says_nothing_of_the_others():
    fleet = load_fleet("JP")  # all cars: the classes are the same with kinds
    votes = car_park(np.random.default_rng(3), fleet, 60, GSD, RULER, vans=Vans(0.1))
    one = np.where(np.arange(60)[:, None] == 0, votes.kinds, np.nan)
    plain, told = (pool(replace(votes, kinds=kinds), fleet, RULER, "m/px") for kinds in (None, one))
    assert told.value != plain.value and told.value == pytest.approx(plain.value, rel=0.002)


def test_mistakes_that_all_vehicles_of_a_place_share_do_not_carry_the_scale_away():
    """Cars of which a third are called pickups, where the table has a thirtieth: the more vehicles, the surer it would
    be, were each a mistake of its own."""
    fleet = load_fleet("US")
    moved = []
    for k in range(12):
        rng = np.random.default_rng([9, k])
        votes = car_park(rng, fleet, 200, GSD, SILENT, most=("pickup", 0.02))
        kinds = np.eye(4)[(rng.random(200) < 0.33).astype(int)]
        plain, misled, sure = (
            np.log(pool(replace(votes, kinds=some), fleet, ruler, "m/px").value / GSD)
            for some, ruler in ((None, RULER), (kinds, RULER), (kinds, replace(RULER, kinds_vehicles=1e5)))
        )
        moved.append((abs(misled - plain), abs(sure - plain)))
    misled, sure = np.mean(moved, axis=0)
    assert misled < 0.02 and misled < 0.7 * sure


@pytest.mark.parametrize(("code", "more"), [("US", 1.5), ("DE", 0.7)])
def test_pickups_tell_the_country(code, more):
    """A fifth of America's vehicles are pickups, of Germany's none. `more` : times as probable, that it is America."""
    some = tuple(load_fleet(each) for each in ("US", "CN", "DE", "JP"))
    unknown = replace(load_fleet("world"), candidates=some, prior=(0.25,) * 4)
    votes = [car_park(np.random.default_rng([9, k]), load_fleet(code), 60, GSD, RULER) for k in range(4)]
    with_kinds, without = (
        np.mean([pool(v, unknown, RULER, "m/px").fleets.get("US", 0.0) for v in seen])
        for seen in (votes, [replace(v, kinds=np.nan) for v in votes])
    )
    assert (with_kinds / without > more) == (more > 1) and without > 0.1


def test_how_far_kinds_tell_the_country():
    """One place strays from its country, and the measurer there: many vehicles say little more than some do."""
    fleets = [load_fleet(code) for code in ("US", "CN", "TH", "world")]
    prior = np.array([0.4, 0.4, 0.1, 0.1])
    confusion = Confusion(np.array(TABLE), 12.0)

    def of(n, pickups):
        called = np.tile([0.84 - pickups, pickups, 0.13, 0.03], (n, 1))
        return country_likelihoods(called, fleets, prior, confusion)

    for pickups in (0.03, 0.2, 0.45):
        each = of(60, pickups)
        assert prior @ each == pytest.approx(1) and each[3] == 1  # of the average's mix nothing is known
        assert int(np.argmax(each)) == {0.03: 1, 0.2: 0, 0.45: 2}[pickups]
    ratio = [of(n, 0.2)[0] / of(n, 0.2)[1] for n in (10, 100, 1000)]
    assert ratio[0] < ratio[1] < ratio[2] < 1.5 * ratio[1] < 30
    assert min(of(1000, 0.6)) > 0.099, "one place in ten, a depot say, tells nothing"
    assert np.allclose(country_likelihoods(np.zeros((5, 4)), fleets, prior, confusion), 1)


def as_simulated(counts, fleet, confusion, places=20_000):
    """Log probability of `counts` (4,) at places that stray from their country, and so do the measurer's mistakes."""
    rng, classes = np.random.default_rng(0), fleet.told_apart_by_kind
    own = np.array([c.weight for c in classes]) / sum(c.weight for c in classes)
    larger, kinds = left_out(classes), np.array([c.kinds for c in (*classes, LARGER, LORRIES)])
    each = []
    for place in fleet.place_vehicles:
        some = round(places * place.probability)
        cars, others = 0.97 * (1 - larger) * place.shares(own), (0.97 * larger, 0.03)
        standing = rng.dirichlet(place.vehicles * np.array([*cars, *others]) + 1e-9, some)
        names = np.stack([rng.dirichlet(confusion.vehicles * row, some) for row in confusion.shares], 1)
        called = 0.9 * np.einsum("nc,ck,nkj->nj", standing, kinds, names) + 0.1 / 4
        each.append(np.log(called) @ counts)
    return float(np.logaddexp.reduce(np.concatenate(each)))


@pytest.mark.parametrize("pickups", [0.03, 0.2, 0.45])
def test_kinds_are_as_likely_in_a_country_as_simulated_places_have_them(pickups):
    fleets = [load_fleet(code) for code in ("US", "CN", "TH", "DE")]
    confusion, prior = Confusion(np.array(TABLE), 12.0), np.full(4, 0.25)
    shares = np.array([0.84 - pickups, pickups, 0.13, 0.03])
    found = country_likelihoods(np.tile(shares, (20, 1)), fleets, prior, confusion)
    simulated = np.array([as_simulated(20 * shares, fleet, confusion) for fleet in fleets])
    expected = np.exp(simulated - simulated.max())
    expected = 0.1 + 0.9 * expected / expected.mean()
    assert np.abs(np.log(found / expected)).max() < 0.25


def test_what_a_class_is_called_follows_its_kinds():
    fleet = load_fleet("US")
    confusion = Confusion(np.array(TABLE), 10.0)
    called = dict(zip([c.name for c in fleet.classes], confusion.called(fleet.classes), strict=True))
    assert called["pickup"] / 10 == pytest.approx(0.98 * np.array(TABLE[1]) + 0.005)
    assert called["SUV"] / 10 == pytest.approx(0.98 * np.array(TABLE[0]) + 0.005)
    assert TABLE[0][2] < called["van"][2] / 10 < TABLE[2][2], "people carriers, of which some look like vans"
    assert confusion.called(fleet.classes).sum(1) == pytest.approx(10)


def test_classes_of_different_kinds_stay_apart_where_kinds_are_seen():
    fleet = load_fleet("US")
    alike = [replace(c, kinds=np.array([0.0, 1, 0, 0]) if c.name == "large" else c.kinds) for c in fleet.classes]
    blind, seeing = (
        [c.name for c in classes]
        for classes in (replace(fleet, classes=alike).told_apart, replace(fleet, classes=alike).told_apart_by_kind)
    )
    assert any("large" in name and "mid" in name for name in blind)
    assert not any("large" in name and "mid" in name for name in seeing)
    for classes in (fleet.told_apart, fleet.told_apart_by_kind):
        whole = sum(c.weight * c.kinds for c in classes)
        assert whole == pytest.approx(sum(c.weight * c.kinds for c in fleet.classes)), "none is lost in a merger"


def test_the_table_travels_with_card_and_boxes(tmp_path):
    entry = {
        "name": "m", "ruler": {"kinds": TABLE, "kinds_vehicles": 7.0}, "sigma_times": [1, 1],
        "effective_height": [0.5, 0.5],
    }  # fmt: skip
    card = MeasurerCard.from_json(json.dumps(entry), "a card")
    assert card.ruler.kinds == TABLE and card.ruler.confusion.vehicles == 7.0
    save_detections(Detections({}, 1.0, card.ruler, (0.5, 0.5), "d"), tmp_path / "boxes.json")
    assert load_detections(tmp_path / "boxes.json").ruler == card.ruler
    assert MeasurerCard.from_json(json.dumps(entry | {"ruler": asdict(Ruler())}), "a card").ruler.confusion is None


def _told(counts, sure=1.0):
    """A place for `card_entries` with `counts` (4, 4) of vehicles by kind and by what they are likeliest."""
    kind, name = (np.repeat(index.ravel(), counts.ravel().astype(int)) for index in np.indices(counts.shape))
    return kind, sure * np.eye(len(KINDS))[name] + (1 - sure) / len(KINDS)


def test_the_entries_of_a_card_follow_from_places():
    rng = np.random.default_rng(2)
    for vehicles in (5.0, 40.0):
        rows = np.array([[rng.dirichlet(vehicles * np.array(row)) for row in TABLE] for _ in range(60)])
        numbers = rng.integers(1, [200, 40, 30, 2], (60, 4))
        places = [
            np.array([rng.multinomial(n, row) for n, row in zip(*place, strict=True)])
            for place in zip(numbers, rows, strict=True)
        ]
        entries = card_entries([_told(place) for place in places])
        assert np.array(entries["kinds"]) == pytest.approx(np.array(TABLE), abs=0.2)
        assert np.array(entries["kinds"])[:2] == pytest.approx(np.array(TABLE)[:2], abs=0.05)
        assert entries["kinds_vehicles"] == pytest.approx(vehicles, rel=0.4)
        assert replace(RULER, **entries).confusion.called(load_fleet("US").classes).min() > 0
        unsure = card_entries([_told(place, 0.6) for place in places])
        assert unsure["kinds_vehicles"] == entries["kinds_vehicles"], "a measurer's doubts make no two places alike"
        assert np.array(unsure["kinds"])[:2] == pytest.approx(0.6 * np.array(TABLE)[:2] + 0.1, abs=0.05)
    large_and_easy, small_and_hard = np.diag([20_000.0, 9000, 0, 0]), np.diag([100.0, 10, 0, 0])
    small_and_hard[1, 0] = 10.0
    recall = card_entries([_told(place) for place in (large_and_easy, *[small_and_hard] * 9)])["kinds"][1][1]
    assert 0.5 < recall < 0.65, "places count, not their vehicles"
    never_seen = card_entries([_told(np.diag([9.0, 3.0, 0.0, 0.0]))])
    assert never_seen["kinds"][3] == [0.25] * 4


@pytest.mark.parametrize("table", [TABLE[:3], ((0.5, 0.1, 0.1, 0.1), *TABLE[1:]), ((1.2, -0.2, 0, 0), *TABLE[1:])])
def test_a_table_that_is_none_is_said(table):
    entry = {"name": "m", "ruler": {"kinds": table}, "sigma_times": [1, 1], "effective_height": [0.5, 0.5]}
    with pytest.raises(InputError, match="a card"):
        MeasurerCard.from_json(json.dumps(entry), "a card")
    assert len(TABLE) == len(KINDS)
