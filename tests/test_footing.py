"""What lies on a reconstruction's ground, of known truth, where its sparse points lie above that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.flights import FLEET, UNIT, enclosing, found_by
from support.models import make_model, put_frames, save

from orthoscale.actions import estimate, opening
from orthoscale.actions.against import _with_ground
from orthoscale.actions.control import read_control, read_distance
from orthoscale.actions.estimate import footing_of, measured
from orthoscale.core.anchors import Anchor, Standard
from orthoscale.core.boxes import Boxes
from orthoscale.core.control import ground_shares, on_ground
from orthoscale.core.evidence import BY_MAP, Evidence
from orthoscale.core.measuring.anchors import FoundAnchors, votes_in_model
from orthoscale.core.measuring.footing import BY_POINTS, GROUND_SD, Footing
from orthoscale.core.measuring.surroundings import objects_in_model
from orthoscale.core.normal import Z90
from orthoscale.core.pooling.anchors import evidence_of
from orthoscale.formats.detections.own import save_detections
from orthoscale.formats.tables import standards
from orthoscale.requests import EstimateRequest
from orthoscale.sources.on_map import OnMap
from orthoscale.sources.opening import open_source

ENDS = np.array([[-1.5, -1.2, 0], [1.8, 1.0, 0.0]])  # on the true ground [units]
COURT = 23.77, 10.97  # [m]


class Flight:
    """A flight whose sparse points lie `lift` units above the ground, its vehicles, and the ground by them."""

    def __init__(self, folder, lift):
        model, self.turn = make_model(lift=lift)
        save(model, folder / "sparse" / "0", "bin")
        put_frames(model, folder / "images")
        self.folder, self.source = folder, open_source(folder)
        self.found = replace(found_by(folder, self.turn), planar=None)
        self.footing = footing_of(self.source, self.found, FLEET)

    def pixels(self, points, count=1):
        """(K, 2) pixels of points (K, 3) in each of the first `count` frames that show them all, by name."""
        seen = {name: self.source.project(name, points @ self.turn.T) for name in self.source.picture_names}
        whole = {name: uv for name, uv in seen.items() if (uv > 8).all() and (uv < [632, 472]).all()}
        return dict(list(whole.items())[:count])

    def words(self, points):
        """The same in words, in the first frame."""
        ((name, pixels),) = self.pixels(points).items()
        return [f"{name}@{x:.3f},{y:.3f}" for x, y in pixels]

    def distance(self):
        metres = UNIT * np.linalg.norm(ENDS[0] - ENDS[1])
        return f"{' '.join(self.words(ENDS))} {metres} {0.002 * metres}"


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    return Flight(tmp_path_factory.mktemp("level"), 0.0)


@pytest.fixture(scope="module", params=[0.4, 0.8], ids=["2 m", "4 m"])
def under_crowns(request, tmp_path_factory):
    return Flight(tmp_path_factory.mktemp("crowns"), request.param)


def holds(found, sigmas=2.0):
    """Whether it gives the truth within so many of its sigmas, and these are of a use."""
    return abs(np.log(found.value / UNIT)) < sigmas * found.relative_sd and found.relative_sd < 0.03


def test_a_lower_ground_makes_distances_in_a_picture_longer_by_its_share():
    points, camera = np.array([[0, 0, 0], [3, 0, 0.0]]), np.array([1, 2, 10.0])
    assert ground_shares(points, points - camera).sum() == pytest.approx(1)
    assert ground_shares(points, np.zeros((2, 3))).sum() == 0, "points of the model are on no ground"
    straight_down = points - points + [0, 0, -10.0]
    assert ground_shares(points, straight_down) == pytest.approx([0, 0])
    lower = 1e-6 * np.array([1, 2.0])
    rays = points - [camera, [4, -1, 12.0]]
    longer = np.linalg.norm(np.diff(points + lower[:, None] * rays, axis=0)) / 3 - 1
    assert ground_shares(points, rays) @ lower == pytest.approx(longer, rel=1e-3)


def test_the_ground_under_neighbours_errs_alike():
    """Seen from the side, a distance errs with the ground's slope, which is the same for a short one and a long one."""
    rng = np.random.default_rng(0)
    ground = Footing(rng.uniform(-9, 9, (40, 3)) * [1, 1, 0], np.full(40, 0.03), np.full(40, 0.01), 0.0, 0.0, reach=4.0)
    tape, camera = Evidence("tape", 5.0, 1e-4, "a tape"), np.array([-20, 0, 10.0])
    sds = []
    for length in (0.2, 1.0, 40.0):
        ends = np.array([[0.0, 0, 0], [length, 0, 0]])
        shares = ground_shares(ends, ends - camera)
        sds.append(on_ground(tape, shares, ground.covariance(ends), 0.0).own_sd)
    assert sds[0] == pytest.approx(sds[1], rel=0.05) and sds[2] == pytest.approx(0.01 * np.sqrt(2.5), rel=0.05)
    assert np.allclose(np.sqrt(np.diag(ground.covariance(ends))), ground.at(ends)[1])


def test_evidence_shares_the_grounds_error_as_far_as_it_has_it():
    tape = Evidence("tape", 5.0, 0.01, "a tape")
    for share, common, more in ((1.0, 0.02, 0.0), (0.5, 0.01, 0.0), (-0.5, 0.0, 0.01), (2.0, 0.02, 0.02)):
        got = on_ground(tape, np.array([share]), np.zeros((1, 1)), 0.02)
        assert got.common == pytest.approx(common) and (got.kind, got.says) == ("tape", "a tape")
        assert got.relative_sd == pytest.approx(np.linalg.norm([0.01, common, more]))
    places = on_ground(tape, np.array([0.5, 0.5]), np.diag([0.03, 0.04]) ** 2, 0.0)
    assert places.relative_sd == pytest.approx(np.linalg.norm([0.01, 0.015, 0.02]))


def test_far_from_any_vehicle_an_uneven_ground_is_less_certain():
    one = Footing(np.zeros((1, 3)), np.array([0.03]), np.array([0.002]), 0.004, uneven=0.02, reach=5.0)
    lower, each = one.at(np.array([[0, 0, 0], [2, 0, 0], [500, 0, 0.0]]))
    assert lower.tolist() == [0.03] * 3
    assert each[0] == 0.002 < each[1] < each[2] == pytest.approx(np.hypot(0.002, 0.02 * np.sqrt(2)))


def test_what_the_points_alone_say_has_the_grounds_error(level, tmp_path):
    distance = read_distance(level.distance(), level.source)
    assert distance.value == pytest.approx(UNIT, rel=0.002) and distance.common == pytest.approx(GROUND_SD)
    assert distance.relative_sd > GROUND_SD
    (tmp_path / "c.txt").write_text(
        "\n".join(f"{w} {x} {y} 0" for w, (x, y, _) in zip(level.words(ENDS), UNIT * ENDS, strict=True))
    )
    assert read_control(tmp_path / "c.txt", level.source).common == pytest.approx(GROUND_SD)
    places = [",".join(map(str, place)) for place in ENDS @ level.turn.T]
    assert read_distance(f"{' '.join(places)} 20 0.1", level.source).common == 0, "on no ground"


def test_a_distance_in_one_picture_has_all_of_the_grounds_error_however_low_it_lies(level):
    lower = Footing(np.zeros((1, 3)), np.array([0.2]), np.array([0.0]), GROUND_SD)
    found = read_distance(level.distance(), level.source, lower)
    assert found.common == pytest.approx(GROUND_SD, rel=1e-6)
    assert found.value == pytest.approx(UNIT / 1.2, rel=0.002), "all rays go a fifth further"


def test_a_distance_is_on_the_ground_on_which_the_vehicles_stand(under_crowns):
    assert not holds(read_distance(under_crowns.distance(), under_crowns.source))
    assert holds(read_distance(under_crowns.distance(), under_crowns.source, under_crowns.footing))


def test_so_is_ground_control(under_crowns, tmp_path):
    ends = np.array([[-1.5, -1.2, 0], [1.8, 1.0, 0], [1.5, -1.0, 0.0]])
    for row in (slice(3), slice(2)):  # with UP, and in the ground's plane
        places = [" ".join(map(str, end[row])) for end in UNIT * ends]
        lines = [" ".join(line) for line in zip(under_crowns.words(ends), places, strict=True)]
        (tmp_path / "c.txt").write_text("\n".join(lines))
        assert holds(read_control(tmp_path / "c.txt", under_crowns.source, under_crowns.footing))


@pytest.mark.parametrize("count", [1, 6], ids=["court", "dashes"])
def test_so_are_anchors(under_crowns, count):
    source, turn, anchors = under_crowns.source, under_crowns.turn, []
    ends = np.array([[-0.5, 0, 0], [0.5, 0, 0]]) * 12 / UNIT @ turn.T
    known = (Standard("12 m", 12.0, 0.002, ""),)
    for view in source.ground_pictures:
        centre = source.centre(view.image)
        seen = centre + (ends - centre) * source.ground.height_above(centre[None]) / (centre @ turn[:, 2])
        pixels = (source.ground.plane(seen) - view.origin) @ view.axes.T / view.unit_per_pixel
        if (pixels > 0).all() and (pixels < (view.width, view.height)).all():
            size = float(np.linalg.norm(pixels[1] - pixels[0]))
            fit = size, 0.004, np.empty(0), known, 0.01, count
            anchors.append(Anchor("line", pixels.mean(0), pixels[None], *fit, picture=view.name))
    assert len(anchors) > 2
    views = {view.name: view for view in source.ground_pictures}
    (found,) = evidence_of(votes_in_model(anchors, views, source.centre, 0.4, under_crowns.footing))
    assert holds(found)
    if count > 1:
        (by_points,) = evidence_of(votes_in_model(anchors, views, source.centre, 0.4))
        assert not holds(by_points)


def test_so_are_objects(under_crowns):
    corners = np.array([[x, y, 0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * [*COURT, 0] / UNIT
    frames = {}
    for name, pixels in under_crowns.pixels(np.r_[corners, [[-0.05, 0, 0], [0.05, 0, 0]]], 4).items():
        box = enclosing(pixels[:4], pixels[5] - pixels[4], 0.0)
        frames[name] = {"tennis-court": Boxes(np.array([box]), np.ones(1))}
    asked = under_crowns.source, frames, 1.0, UNIT, standards()
    (found,) = evidence_of(objects_in_model(*asked, under_crowns.footing))
    (by_points,) = evidence_of(objects_in_model(*asked))
    assert abs(np.log(found.value / UNIT)) < 0.5 * abs(np.log(by_points.value / UNIT))


def test_so_is_a_match_with_a_map(under_crowns):
    source, footing = under_crowns.source, under_crowns.footing
    view = source.ground_pictures[0]
    centre = source.centre(view.image)
    nearer = source.ground.height_above(centre[None])[0] / (centre @ under_crowns.turn[:, 2])
    match = Evidence(BY_MAP, UNIT / nearer, 0.005, "its place")
    assert holds(_with_ground(match, source, view.name, footing))
    by_points = _with_ground(match, source, view.name, BY_POINTS)
    assert by_points.value == pytest.approx(match.value) and by_points.common == GROUND_SD


def test_the_whole_way_takes_the_vehicles_ground(under_crowns, tmp_path):
    save_detections(under_crowns.found, tmp_path / "boxes.json")
    given = under_crowns.distance()
    asked = EstimateRequest(fleet="DE", detections=tmp_path / "boxes.json", anchors=("none",), known_distance=(given,))
    scale = measured(under_crowns.folder, asked).scale
    assert holds(scale.evidence[0]) and not scale.conflict
    low, high = scale.interval90
    assert low < UNIT < high and np.log(high / low) < 2 * Z90 * 0.015


def test_anchors_and_the_map_are_told_of_it(under_crowns, tmp_path, monkeypatch):
    save_detections(under_crowns.found, tmp_path / "boxes.json")
    told = []
    monkeypatch.setattr(opening, "_satellite", lambda path: path)
    monkeypatch.setattr(estimate, "on_map", lambda *args: told.append(args[-1]) or OnMap())
    monkeypatch.setattr(estimate, "look_for_anchors", lambda *args: told.append(args[-1].footing) or FoundAnchors())
    measured(under_crowns.folder, EstimateRequest(fleet="DE", detections=tmp_path / "boxes.json", against="map.tif"))
    assert len(told) == 2
    for footing in told:
        assert footing.lower == pytest.approx(under_crowns.footing.lower, abs=1e-3)
