"""The pitch of parking rows, from places and headings alone."""

import tracemalloc

import cv2
import numpy as np
import pytest

import orthoscale
from orthoscale.anchors.bays import bay_standards
from orthoscale.core.anchors import BAYS
from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNKNOWN_HEIGHT, UNKNOWN_RULER, Detections
from orthoscale.core.measuring import parking
from orthoscale.core.pooling.anchors import evidence_of
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import save_detections
from orthoscale.formats.tables import standards

GSD = 0.1


def parking_pitch(*arguments):
    """What the rows say of the scale, None for nothing."""
    found = parking.parking_pitch(*arguments)
    return None if found is None else evidence_of([found])[0]


STALLS = standards().stalls


def car_park(rng, pitch=2.5, rows=4, stalls_each=12, taken=0.7, heading=0.3, dims=2):
    """Places [px], headings and sizes [px] of vehicles in rows, each within 0.12 m of its stall's middle."""
    slot, row = np.meshgrid(np.arange(stalls_each), np.arange(rows))
    here = rng.random(slot.shape) < taken
    across, ahead = pitch * slot[here] + rng.normal(0, 0.12, here.sum()), 11.0 * row[here]
    ahead = ahead + rng.normal(0, 0.2, len(ahead))
    turn = heading + rng.normal(0, 0.03, len(ahead))
    forward, sideways = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    place = (across[:, None] * sideways + ahead[:, None] * forward) / GSD
    along = np.stack([np.cos(turn), np.sin(turn)], -1) * rng.choice([-1, 1], len(turn))[:, None]
    size = load_fleet("DE").sample(rng, len(turn))[:, :2] / GSD
    if dims == 3:  # the same ground, tilted in space
        tilt = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        place, along = (np.pad(v, ((0, 0), (0, 1))) @ tilt for v in (place, along))
    return place, along, size


@pytest.mark.parametrize("pitch, country", [(2.5, "DE"), (2.74, "US"), (2.3, "FR")])
@pytest.mark.parametrize("dims", [2, 3])
def test_the_pitch_gives_the_scale(pitch, country, dims):
    found = parking_pitch(*car_park(np.random.default_rng(0), pitch, dims=dims), STALLS, country)
    assert found is not None and found.value == pytest.approx(GSD, rel=0.02)
    assert 0.05 < found.relative_sd < 0.09


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_the_vehicles_does_not_matter(seed):
    """Headings are read to a few degrees: seen from either of two vehicles the other stands elsewhere."""
    rng = np.random.default_rng(seed)
    place, along, size = car_park(rng)
    turn = rng.normal(0, 0.06, len(place))
    c, s = np.cos(turn), np.sin(turn)
    along = np.stack([along[:, 0] * c - along[:, 1] * s, along[:, 0] * s + along[:, 1] * c], -1)
    one = parking.parking_pitch(place, along, size, STALLS, "DE")
    for order in (np.arange(len(place))[::-1], rng.permutation(len(place))):
        other = parking.parking_pitch(place[order], along[order], size[order], STALLS, "DE")
        assert other.anchor.count == one.anchor.count
        assert other.units == pytest.approx(one.units, rel=1e-9)
        assert other.relative_sd == pytest.approx(one.relative_sd, rel=1e-9)


def test_the_pitch_is_known_as_well_as_rows_agree_on_it():
    found = [
        parking.parking_pitch(*car_park(np.random.default_rng(seed), 2.5, rows=8), STALLS, "DE") for seed in range(40)
    ]
    errors = [np.log(one.units * GSD / 2.5) for one in found]
    claimed = np.sqrt(np.mean([one.relative_sd**2 for one in found]))
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) / claimed < 1.2


@pytest.mark.parametrize("turned, ahead", [(np.radians(15), 0.0), (0.0, 2.0)], ids=["turned", "one behind another"])
def test_vehicles_that_are_not_side_by_side_make_no_row(turned, ahead):
    """Every other one is turned, or stands two metres ahead: in lanes and along kerbs they have a distance, too."""
    rng = np.random.default_rng(0)
    place, along, size = car_park(rng, heading=0.0, taken=1.0, rows=2)
    odd = np.arange(len(place)) % 2 == 1
    angle = np.arctan2(along[:, 1], along[:, 0]) + turned * odd
    place = place + odd[:, None] * np.array([ahead / GSD, 0.0])
    assert parking_pitch(place, np.stack([np.cos(angle), np.sin(angle)], -1), size, STALLS, "DE") is None


def test_vehicles_without_rows_have_no_pitch():
    rng = np.random.default_rng(1)
    _, along, size = car_park(rng)
    anywhere = rng.uniform(0, 600, (len(size), 2))
    assert parking_pitch(anywhere, along, size, STALLS, "DE") is None


def test_rows_parked_without_stalls_have_no_pitch():
    rng, refused = np.random.default_rng(2), 0
    for _ in range(20):
        place, along, size = car_park(rng, heading=0.0, taken=1.0)
        gaps = rng.uniform(2.1, 3.9, (4, 12)).cumsum(1).ravel() / GSD
        refused += parking_pitch(np.stack([place[:, 0], gaps], -1), along, size, STALLS, "DE") is None
    assert refused >= 14  # uneven gaps look even by chance now and then


def test_few_vehicles_or_a_country_without_standard_say_nothing():
    place, along, size = car_park(np.random.default_rng(3))
    assert parking_pitch(place, along, size, STALLS, "NP") is None
    assert parking_pitch(place[:5], along[:5], size[:5], STALLS, "DE") is None
    assert parking_pitch(place[:0], along[:0], size[:0], STALLS, "DE") is None


@pytest.mark.parametrize("country", STALLS)
def test_every_stall_is_plausible_and_says_where_it_comes_from(country):
    stall = STALLS[country]
    assert 2.2 < stall["width"] < 2.9 and 0.05 < stall["width_sd"] < 0.25 and len(stall["source"]) > 10


def test_boxes_in_one_place_are_one_vehicle():
    """20,000 of them were two hundred million pairs before, in gigabytes."""
    place, along, size = car_park(np.random.default_rng(4))
    expected = parking_pitch(place, along, size, STALLS, "DE")
    place, along, size = (np.concatenate([v, np.repeat(v[:1], 20_000, 0)]) for v in (place, along, size))
    found = parking_pitch(place, along, np.where(size == size[0], np.median(size, axis=0), size), STALLS, "DE")
    assert found is not None and found.value == pytest.approx(expected.value, rel=0.05)


def test_fifty_thousand_vehicles_take_little_memory():
    place, along, size = car_park(np.random.default_rng(5), rows=360, stalls_each=200)
    tracemalloc.start()
    found = parking_pitch(place, along, size, STALLS, "DE")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(place) > 50_000 and found.value == pytest.approx(GSD, rel=0.02)
    assert peak < 200e6


@pytest.mark.parametrize("country, width", [("AE", 2.5), ("GCC", 2.5), ("US", 2.74), ("WORLD", None)])
def test_rows_of_the_table_hold_where_they_say(country, width):
    found = parking.parking_pitch(*car_park(np.random.default_rng(0), 2.5), STALLS, country)
    if width is None:
        assert len(found.anchor.standards) == len(STALLS)
    else:
        (standard,) = found.anchor.standards
        assert standard.metres == width and "GCC" not in standard.countries


def drawn(folder, place, along, size):
    """park.png, of one grey, and boxes.json with what `car_park` gives."""
    place = place - place.min(0) + 60
    cv2.imwrite(str(folder / "park.png"), np.full(np.ceil(place.max(0) + 60).astype(int)[::-1], 90, np.uint8))
    boxes = Boxes(np.c_[place, size, np.arctan2(along[:, 1], along[:, 0])], np.ones(len(size)))
    found = Detections({"park.png": boxes}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "drawn")
    save_detections(found, folder / "boxes.json")


def test_rows_improve_no_verdict(tmp_path):
    """Rules give the least width of stalls, and no document says what one place built."""
    drawn(tmp_path, *car_park(np.random.default_rng(4), 2.5, rows=3))
    options = {"fleet": "DE", "detections": tmp_path / "boxes.json"}
    rows = orthoscale.estimate(tmp_path / "park.png", **options).scale
    alone = orthoscale.estimate(tmp_path / "park.png", **options, anchors=["none"]).scale
    assert [e.kind for e in rows.evidence] == [BAYS] and rows.relative_sd < alone.relative_sd
    assert rows.support.unproven == pytest.approx(np.sqrt(alone.relative_sd**2 - rows.relative_sd**2), rel=0.01)
    grown = rows.with_parts({"fleet": 0.0295})
    assert rows.verdict == alone.verdict and grown.relative_sd < 0.03 and grown.verdict == "fair"


@pytest.mark.parametrize("code", ["IT", "CO", "IR", "WORLD"])
def test_bays_of_a_recalled_standard_are_less_certain_and_not_documented(code):
    ends = {standard.source: standard for standard in bay_standards() if "US" not in standard.countries}
    recalled, known = ends[STALLS[code]["source"]], ends[STALLS["DE"]["source"]]
    assert recalled.relative_sd > 0.1 > known.relative_sd and known.documented and not recalled.documented


@pytest.mark.parametrize("fleet", ["US", "Texas"])
def test_rows_count_where_a_part_of_the_country_is_named(fleet, tmp_path):
    drawn(tmp_path, *car_park(np.random.default_rng(4), 2.74, rows=6))
    result = orthoscale.estimate(tmp_path / "park.png", fleet=fleet, detections=tmp_path / "boxes.json")
    assert [each.kind for each in result.scale.evidence] == [BAYS]
    assert result.scale.value == pytest.approx(GSD, rel=0.08), "the cars are German ones"
