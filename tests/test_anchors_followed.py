"""Railway tracks, running tracks and yard lines: followed over drawn pictures of exact truth, and not elsewhere."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.courts import court_picture, tennis
from support.gridiron import YARD, field_picture
from support.markings import PAINT, picture, stroke
from support.pictures import ODD_PICTURES
from support.rails import RUST, SLAB, railway, track
from support.running import LAWN, RED, running_track

from orthoscale.anchors.combs import Block, Comb, _of_true_lines, comb_anchor
from orthoscale.anchors.gridiron import Gridirons
from orthoscale.anchors.ovals import KERB, TrackOvals
from orthoscale.anchors.periods import fit_row
from orthoscale.anchors.rails import HEAD, RailTracks, Track
from orthoscale.anchors.repeated import LOCAL_STRETCH
from orthoscale.anchors.running import RunningTracks
from orthoscale.core.anchors import holding
from orthoscale.core.normal import Z90

FINDERS = (RailTracks(), RunningTracks(), TrackOvals(), Gridirons())


def one(found, metres):
    """The only anchor, which can be of `metres`."""
    assert len(found) == 1
    assert any(abs(each.metres - metres) < 1e-6 for each in found[0].standards)
    return found[0]


@pytest.mark.slow
@pytest.mark.parametrize("turn", (0.0, 0.4, 2.5))
@pytest.mark.parametrize("gsd", (0.05, 0.1))
def test_the_gauge_of_a_track(gsd, turn):
    anchor = one(RailTracks().find(railway(track(y=0.3), gsd, 50, turn), gsd * 1.06, 0.06, "DE"), 1.435 + HEAD)
    assert anchor.pixels * gsd == pytest.approx(1.435 + HEAD, rel=0.005)
    assert anchor.false < 0.1  # sleepers are seen
    # both rails from one edge of the picture to the other, but for a block
    assert np.linalg.norm(np.ptp(anchor.lines.reshape(-1, 2), axis=0)) * gsd > 42


@pytest.mark.parametrize("gauge, country", ((1.067, "JP"), (1.520, "EE"), (1.668, "ES")))
def test_the_country_says_which_gauge(gauge, country):
    anchor = one(RailTracks().find(railway(track(gauge=gauge), 0.08, 50), 0.08 * 0.95, 0.06, country), gauge + HEAD)
    assert anchor.pixels * 0.08 == pytest.approx(gauge + HEAD, rel=0.005)
    assert LOCAL_STRETCH < anchor.relative_sd < 2 * LOCAL_STRETCH, "pictures are stretched here and there"


@pytest.mark.parametrize(
    "country, gauges", (("AU", (1.067, 1.435, 1.6)), ("BD", (1.0, 1.676)), ("VN", (1.0, 1.435)), ("FR", (1.435,)))
)
def test_a_country_may_have_several_gauges(country, gauges):
    standards = holding(RailTracks().standards, country)
    assert sorted(standard.metres - HEAD for standard in standards) == pytest.approx(gauges)
    assert all(0.007 < standard.relative_sd < 0.016 for standard in standards), "rails are seen to a centimetre or two"


def test_the_middle_of_the_blocks_is_known_as_well_as_is_said():
    """Its 90 % interval holds the truth nine times in ten, though twelve blocks may scatter too little by chance."""
    rng = np.random.default_rng(0)
    found = {"rails": [], "lanes": []}
    middle = np.column_stack([30.0 * np.arange(12), np.zeros(12)])
    for _ in range(1000):
        apart = 15 + 0.2 * rng.normal(size=12)
        tracks = Track(middle, np.tile([1.0, 0.0], (12, 1)), apart, np.zeros((12, 2)), np.zeros((12, 3)), 12)
        found["rails"].append((tracks.distance, tracks.distance_sd))
        rows = [fit_row(pitch * np.arange(6.0), np.arange(6)) for pitch in apart]
        blocks = [Block(place, 0.0, row, 1.0) for place, row in zip(middle, rows, strict=True)]
        lanes = comb_anchor(blocks, "lanes", (), 0.1)
        found["lanes"].append((lanes.pixels, np.sqrt(lanes.relative_sd**2 - LOCAL_STRETCH**2)))
    for pixels, sd in (np.transpose(each) for each in found.values()):
        assert np.mean(np.abs(np.log(pixels / 15)) < Z90 * sd) == pytest.approx(0.9, abs=0.025)


@pytest.mark.parametrize("askew", [-0.2, 0.0, 0.1])
def test_a_pitch_is_square_to_the_way_of_the_lines_however_they_are_crossed(askew):
    row = fit_row(15 / np.cos(askew) * np.arange(6), np.arange(6))
    blocks = [Block(np.array([30.0 * k, 0.0]), askew, row, 1.0) for k in range(12)]
    assert comb_anchor(blocks, "lanes", (), 0.1).pixels == pytest.approx(15)


def test_where_bright_ground_begins_there_is_no_line():
    """Six lines, and an edge where the seventh would be, which drew the pitch to itself."""
    at = np.array([20.0, 35, 50, 65, 80, 95, 111])
    light = np.full((140, 400), 100, np.float32)
    light[np.abs(np.arange(140)[:, None] - at[:6]).min(1) <= 1] = 200
    light[110:] = 200
    row = fit_row(at - 20, np.arange(7))
    blocks = [Block(np.array([20.0 + 30 * k, 20.0]), 0.0, row, 1.0) for k in range(12)]
    true = _of_true_lines(light, blocks, Comb(12.0, 18.0, 5, 12, 30.0, 120.0, 3.0))
    assert len(true) == 12 and all(len(block.row.number) == 6 for block in true)
    assert comb_anchor(true, "lanes", (), 0.1).pixels == pytest.approx(15) != pytest.approx(row.period)


@pytest.mark.slow
def test_a_bent_track_and_one_with_dark_rails():
    bent = one(RailTracks().find(railway(track(), 0.07, 50, bend=1 / 600), 0.07, 0.06, "DE"), 1.435 + HEAD)
    assert bent.pixels * 0.07 == pytest.approx(1.435 + HEAD, rel=0.005)
    dark = one(RailTracks().find(railway(track(bright=RUST), 0.07, 50), 0.07, 0.06, "DE"), 1.435 + HEAD)
    assert dark.pixels * 0.07 == pytest.approx(1.435 + HEAD, rel=0.005)


@pytest.mark.slow
def test_rails_in_a_slab_count_only_beside_a_second_track():
    def seen(*places):
        boxes = [box for y in places for box in track(y=y, sleeper=0)]
        return RailTracks().find(railway(boxes, 0.07, 50, ground=SLAB), 0.07, 0.06, "DE")

    assert not seen(0.0)
    pair = seen(-1.7, 1.7)
    assert len(pair) == 2 and all(anchor.false > 0.1 for anchor in pair)
    assert not seen(-0.78, 0.78)  # four lines, too near each other for two tracks


@pytest.mark.parametrize("gsd", (0.1, 0.2, 0.3))
@pytest.mark.parametrize("turn, middle", ((0.0, (0, 40)), (0.4, (60, 20)), (1.9, (-20, -40))))
def test_the_lanes_of_a_running_track(gsd, turn, middle):
    anchor = one(RunningTracks().find(running_track(gsd, 70, middle, turn), gsd * 1.06, 0.06, "DE"), 1.22)
    assert anchor.pixels * gsd == pytest.approx(1.22, rel=0.004)
    assert anchor.count == 9 and (anchor.false < 0.05) == (middle == (60, 20))  # the bend tells


@pytest.mark.parametrize(
    "lane, country, name",
    ((1.25, "DE", "lanes of 1.25 m"), (1.22, "US", "lanes of 1.22 m, US"), (1.0668, "US", "lanes of 42 in")),
)
def test_lanes_of_other_rules(lane, country, name):
    """To within their scale, which is not known well enough to tell rules from each other that are as near as these."""
    anchor = one(RunningTracks().find(running_track(0.15, 70, (0, 40), lane=lane), 0.15, 0.06, country), lane)
    assert anchor.pixels * 0.15 == pytest.approx(lane, rel=0.004)
    assert name in {standard.name for standard in anchor.standards}


def test_lanes_that_end_on_bright_ground_are_measured_by_their_lines():
    """Four lanes between bright edges, as in `tartu_b`, are too few to be told; six are enough."""
    found = [RunningTracks().find(running_track(0.15, 60, (0, 40), lanes=n), 0.15, 0.06, "EE") for n in (4, 6)]
    assert not found[0]
    assert one(found[1], 1.22).pixels * 0.15 == pytest.approx(1.22, rel=0.004)


@pytest.mark.slow
@pytest.mark.parametrize("gsd", (0.3, 0.6))
@pytest.mark.parametrize("turn, lanes, surface", ((0.0, 8, RED), (0.4, 6, (70, 95, 150)), (1.9, 4, (120, 120, 118))))
def test_a_running_track_as_a_whole(gsd, turn, lanes, surface):
    image = running_track(gsd, 230, (5, -7), turn, lanes=lanes, surface=surface, drawn_at=0.2)
    anchor = one(TrackOvals().find(image, gsd * 1.06, 0.08, ""), KERB)
    assert anchor.pixels * gsd == pytest.approx(KERB, rel=0.004)
    middle = (230 / 2 + np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ (-5, 7)) / gsd - 0.5
    assert np.abs(anchor.place - middle).max() < 2


@pytest.mark.parametrize(
    "looks, off",
    [({}, 0.75), ({}, 1.35), ({"lanes": 0}, 1.0), ({"surface": LAWN}, 1.0), ({"lanes": 14}, 1.0)],
    ids=["too small", "too large", "a path", "a line on a lawn", "a road"],
)
def test_ovals_that_are_no_tracks(looks, off):
    assert not TrackOvals().find(running_track(0.5, 230, drawn_at=0.25, **looks), 0.5 * off, 0.08, "")


def test_half_a_track_is_no_oval():
    assert not TrackOvals().find(running_track(0.5, 150, (60, 0), drawn_at=0.25), 0.5, 0.08, "")


@pytest.mark.parametrize("gsd, angle", ((0.2, 0.4), (0.3, 0.0), (0.45, 1.24)))
def test_yard_lines(gsd, angle):
    anchor = one(Gridirons().find(field_picture(gsd, angle), gsd * 1.06, 0.08, "US"), 5 * YARD)
    assert anchor.pixels * gsd == pytest.approx(5 * YARD, rel=0.003)
    assert anchor.count >= 20


def rows(pitch, count, length, width=0.12):
    return [(stroke(30, 4 + pitch * k, length, width), PAINT) for k in range(count)]


@pytest.mark.parametrize("finder", FINDERS, ids=lambda finder: finder.kind)
@pytest.mark.parametrize(
    "shapes",
    [rows(1.22, 30, 50), rows(4.572, 9, 30), rows(1.507, 2, 50), rows(2.5, 15, 5), rows(3.5, 4, 55)],
    ids=["a field's rows", "short lines", "two lines", "bays", "lanes of a road"],
)
def test_other_lines_are_none(finder, shapes):
    assert not finder.find(picture(shapes, 0.12, (60, 45), 20), 0.12, 0.1, "US")


def test_a_tennis_court_is_none():
    image = court_picture([(tennis(), (20, 20), 0.4)], 0.12, (330, 330))
    assert not [a for finder in FINDERS for a in finder.find(image, 0.12, 0.1, "US")]


@pytest.mark.parametrize("finder", FINDERS, ids=lambda finder: finder.kind)
@pytest.mark.parametrize("image", ODD_PICTURES.values(), ids=ODD_PICTURES)
@pytest.mark.parametrize("gsd", (0.05, 0.3))
def test_an_odd_picture_has_none(finder, image, gsd):
    assert list(finder.find(image, gsd, 0.1, "US")) == []


@pytest.mark.slow
@pytest.mark.real
def test_no_rails_lanes_or_yards_in_a_town(data):
    image = cv2.imread(str(data / "orthophotos" / "banepa.jpg"))[:1000, :1000, ::-1]
    assert not [a for finder in FINDERS for a in finder.find(image, 0.132, 0.1, "")]
