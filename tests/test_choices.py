"""Choices that a scale rests on, each against a truth worked out by hand, so that changing one is noticed."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from support.models import make_model, save

from orthoscale.core.boxes import Boxes, suppress
from orthoscale.core.detections import Tile
from orthoscale.core.evidence import Support
from orthoscale.core.measuring.drift import Drift, Trend
from orthoscale.core.measuring.model_drift import ModelDrift
from orthoscale.core.measuring.oblique import height_share
from orthoscale.core.measuring.parallax import standing
from orthoscale.core.measuring.systematic import Systematic
from orthoscale.core.pooling.agreement import compare, together
from orthoscale.core.projection.exact import Hull
from orthoscale.core.scale import Scale
from orthoscale.core.verdicts import UNUSABLE, reasons, remark_on_shape, verdict
from orthoscale.detect.effort import Effort
from orthoscale.detect.sweep import sweep_twice
from orthoscale.detect.tiles import Looks
from orthoscale.fleets import load_fleet
from orthoscale.photos.photo import Photo
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.tags import Tags


def side_by_side(overlap_share):
    """Two level boxes of 10 x 4 px whose overlap (intersection over union) is `overlap_share`."""
    shift = 10 * (1 - 2 * overlap_share / (1 + overlap_share))
    return Boxes(np.array([[0, 0, 10, 4, 0.0], [shift, 0, 10, 4, 0.0]]), np.array([0.9, 0.8]))


@pytest.mark.parametrize("share, left", [(0.05, 2), (0.2, 2), (0.28, 2), (0.32, 1), (0.5, 1), (0.65, 1)])
def test_suppression_leaves_neighbours_and_takes_second_boxes_of_one_vehicle(share, left):
    assert len(suppress(side_by_side(share))) == left


def one_tile(fine, coarse):
    class Page:
        name = "page"

    tile = Tile(0, 0, 100, 100, 100, 100)
    return sweep_twice([(Page(), tile)], np.arange(1), lambda some: ((n, Looks(fine, coarse)) for n in some))


def test_a_vehicles_box_is_the_geometric_mean_of_both_passes():
    fine = Boxes(np.array([[50, 50, 40, 16, 0.2]]), np.array([0.9]))
    coarse = Boxes(np.array([[50, 50, 44, 18, 0.2]]), np.array([0.5]))
    (box,) = one_tile(fine, coarse).boxes["page"].xylwa
    assert box[2:4] == pytest.approx([np.sqrt(40 * 44), np.sqrt(16 * 18)])
    assert one_tile(fine, coarse).boxes["page"].score == pytest.approx([0.7])


@pytest.mark.parametrize("share, believed", [(0.2, 0), (0.45, 0), (0.55, 1), (0.8, 1)])
def test_two_passes_show_one_vehicle_only_where_their_boxes_overlap_by_half(share, believed):
    pair = side_by_side(share)
    found = one_tile(pair[[0]], pair[[1]])
    assert (len(found.boxes["page"]), len(found.doubtful["page"])) == (believed, 1 - believed)


def scale(value, sampling):
    parts = {"sampling": sampling, "fleet": 0.03}
    used = np.ones(8, bool)
    return Scale(value, "m/px", (value * 0.9, value * 1.1), parts, {}, (0.5, 0.5), 0.0, "DE", "fair", used, [""] * 8)


def test_of_two_measurements_the_more_certain_one_counts_more():
    sure, unsure = scale(0.100, 0.01), scale(0.102, 0.03)
    both = together(compare({"oblique": sure, "planar": unsure}))
    # Inverse variances: nine to one.
    assert np.log(both.value / 0.1) == pytest.approx(0.1 * np.log(1.02), rel=1e-6)
    assert both.parts["fleet"] == pytest.approx(0.03)  # what both share does not shrink


def with_parts(value, **parts):
    return replace(scale(value, 0.0), parts=parts)


def test_what_two_measurements_of_the_same_vehicles_may_differ_by():
    """Each its own geometry and 1.5 % of its margin, and how well a median of their differences is known."""
    first, second = with_parts(0.1, geometry=0.01, fleet=0.03), with_parts(0.1, geometry=0.02, fleet=0.03)
    each = 0.05 * np.array([-2.0, -1.0, -1.0, 0.0, 1.0, 1.0, 2.0])  # half of them lie within 0.05 of the middle
    found = compare({"oblique": first, "planar": second}, np.column_stack([each, each]))
    own = 0.01**2 + 0.02**2 + 2 * 0.015**2
    assert found.sd == pytest.approx(np.sqrt(own + 1.598**2 * 0.21045 * (1.4826 * 0.05) ** 2), rel=1e-3)
    assert found.apart_sd == pytest.approx(np.sqrt(own)) and found.difference == 0
    assert found.mixes_sd == pytest.approx(0.03 * np.sqrt(2)), "where they agree, others may be of another mix"
    off = compare({"oblique": first, "planar": second}, np.column_stack([each, each]) + 0.5)
    assert off.contradicts and off.mixes_sd == 0, "where they do not, a mix is no excuse"


def test_boxes_of_two_networks_differ_by_the_margins_of_both():
    """One network's margin is in both scales; a scale that hardly rests on its own is as far off at least."""
    first, second = with_parts(0.1, margin=0.03), with_parts(0.1, margin=0.001)
    one, two = (compare({"oblique": first, "planar": second}, one_network=same) for same in (True, False))
    assert one.sd == pytest.approx(np.sqrt(2 * 0.015**2 + 0.029**2))
    assert two.sd == pytest.approx(np.sqrt(0.03**2 + 0.015**2))
    both = compare({"oblique": first, "planar": first}, np.zeros((9, 2)), one_network=False)
    assert both.sd == pytest.approx(0.03 * np.sqrt(2))


def test_sizes_err_by_all_their_geometry_though_anchors_tell_the_scales():
    """`sheffield`: a tennis court told both scales to 0.4 %, and left 0.02 % of the uncertainty to the ground pictures'
    geometry. Their eight vehicles were 9 % larger than in the frames, and the two were said to contradict."""
    first = replace(with_parts(0.1, geometry=2e-4, court=4e-3), by_vehicles={"geometry": 0.02, "margin": 0.01})
    second = replace(with_parts(0.1, geometry=1e-4, court=4e-3), by_vehicles={"geometry": 0.03, "margin": 0.04})
    apart = np.full((8, 2), 0.09)
    for one_network, margins in ((True, 2 * 0.015**2), (False, 0.015**2 + 0.04**2)):
        found = compare({"oblique": first, "planar": second}, apart, one_network)
        assert found.sd == pytest.approx(np.sqrt(0.02**2 + 0.03**2 + margins)) and not found.contradicts
        assert found.apart_sd < 0.03, "of the scales no more is open than before"


def test_a_scale_by_a_distance_may_differ_by_all_that_is_not_known_of_the_fleet():
    by_distance, by_vehicles = with_parts(0.1, **{"known distance": 0.01}), with_parts(0.1, fleet=0.04)
    found = compare({"oblique": by_distance, "planar": by_vehicles})
    assert found.sd == pytest.approx(np.sqrt(0.01**2 + 0.04**2 + 2 * 0.015**2))


def test_the_same_vehicles_are_no_more_alike_for_being_as_many():
    """Sampling is each one's own: none of it cancels, and none counts twice."""
    first, second = (with_parts(0.1, sampling=sampling, fleet=0.03) for sampling in (0.02, 0.03))
    found = compare({"a": first, "b": second})
    assert found.sd == pytest.approx(np.sqrt(0.02**2 + 0.03**2 + 2 * 0.015**2))


def test_sizes_differ_as_both_scales_weigh_lengths_and_widths():
    first, second = (replace(scale(0.1, 0.01), weights=weights) for weights in ((1.0, 0.0), (0.6, 0.4)))
    found = compare({"a": first, "b": second}, np.tile([0.01, 0.06], (9, 1)))
    assert found.difference == pytest.approx(0.8 * 0.01 + 0.2 * 0.06)


def test_of_two_that_contradict_each_other_the_part_is_as_wide_as_the_interval():
    first, second = scale(0.1, 0.01), scale(0.2, 0.02)
    both = together(compare({"a": first, "b": second}))
    assert both.value == 0.1 and both.interval90 == (first.interval90[0], second.interval90[1])
    assert both.parts == {"conflict": pytest.approx(np.log(both.interval90[1] / both.interval90[0]) / 2 / 1.6449)}


def test_of_two_that_rest_on_what_is_not_documented_the_worse_one_is_judged():
    first, second = (replace(scale(0.1, 0.01), support=Support(unproven=u)) for u in (0.0, 0.05))
    assert together(compare({"a": first, "b": second})).support.unproven == 0.05
    assert together(compare({"a": second, "b": first})).verdict == "fair"


def test_a_difference_that_is_not_explained_is_the_mixs():
    """DerSimonian and Laird: of what exceeds its own variance, a quarter where both weigh the same."""
    first, second = (with_parts(value, sampling=0.01, fleet=0.03) for value in (0.1, 0.1 * np.exp(0.06)))
    agreement = compare({"oblique": first, "planar": second})
    more = (0.06**2 - (2 * 0.01**2 + 2 * 0.015**2)) / 4
    assert together(agreement).parts["fleet"] == pytest.approx(np.sqrt(0.03**2 + more))


def test_what_other_evidence_contradicts_stands_alone_though_the_other_is_surer():
    sure, unsure = scale(0.1, 0.01), replace(scale(0.2, 0.05), conflict=4.0, verdict=UNUSABLE)
    for first, second in ((sure, unsure), (unsure, sure)):
        both = together(compare({"oblique": first, "planar": second}))
        assert both.value == 0.2 and both.interval90 == unsure.interval90


def test_the_pooled_verdict_does_not_depend_on_which_measurement_comes_first():
    unsure, sure = replace(scale(0.100, 0.16), verdict=UNUSABLE), scale(0.101, 0.01)
    odd = replace(scale(0.101, 0.02), tension=2.6, remarks=(remark_on_shape(0.1, 2.6),))
    for pair, word in (((unsure, sure), "fair"), ((odd, sure), "poor")):
        for modes in (("oblique", "planar"), ("planar", "oblique")):
            named = dict(zip(modes, pair, strict=True))
            both = together(compare({mode: named[mode] for mode in ("oblique", "planar")}))
            assert both.verdict == word and both.tension == max(one.tension for one in pair)
            assert [r.text for r in both.remarks] == [f"{modes[0]}: {r.text}" for r in pair[0].remarks]


@pytest.mark.parametrize(
    "sd, word", [(0.029, "good"), (0.031, "fair"), (0.059, "fair"), (0.061, "poor"), (0.149, "poor")]
)
def test_the_words_for_a_scale_follow_its_uncertainty(sd, word):
    assert verdict(sd, odd_shape=False, conflict=False) == word
    assert verdict(0.151, odd_shape=False, conflict=False) == verdict(sd, odd_shape=False, conflict=True) != word


def test_odd_shapes_lower_a_verdict_by_one_step_and_a_doubt_to_fair():
    assert [verdict(sd, True, False) for sd in (0.02, 0.05, 0.1, 0.2)] == ["fair", "poor", "poor", UNUSABLE]
    assert [verdict(sd, False, False, True) for sd in (0.02, 0.05, 0.1)] == ["fair", "fair", "poor"]


def test_what_is_too_small_for_a_car_and_what_too_large():
    """Sizes as logarithms, less the mean of those that count: boxes of half a car, of two, and of a square."""
    off = np.log([[1.0, 1.0], [0.5, 0.6], [2.0, 1.5], [0.6, 1.5]])
    told = reasons(np.array([True, False, False, False]), np.arange(4), np.zeros(4, bool), off, np.zeros(2))
    assert told == ["", "too small for a car", "too large for a car", "wrong shape for a car"]


def test_the_ground_of_a_model_is_known_to_a_hundredth_however_many_vehicles_stand_on_it():
    """One frame: no parallax says more of the ground."""
    size, place = np.tile([4.5, 1.8], (1000, 1)), np.random.default_rng(0).uniform(-30, 30, (1000, 2))
    frame = np.full(1000, "a.jpg")
    stands = standing(
        place, np.zeros((1000, 2)), np.full(1000, 60.0), frame, (4.5, 1.8), np.full(1000, 0.1), np.ones(1000)
    )
    nadir = height_share(size, np.zeros((1000, 2)), 0.25)  # from there vehicles show nothing of their height
    shared = Systematic(nadir, {"ground": np.full(2, stands.shared)}).covariance
    assert shared == pytest.approx(np.full((2, 2), 0.01**2))


def test_vehicles_of_one_place_stray_from_their_countrys_mean():
    fleet = replace(load_fleet("DE"), shares_sd=0.0)
    national = (fleet.mean_sd / fleet.mean)[:2]
    local = np.sqrt(np.diag(fleet.log_mean_covariance) - national**2)
    assert local == pytest.approx([0.029, 0.0167], abs=0.001)
    of_classes = np.sqrt(np.diag(fleet.class_mean_covariance(fleet.told_apart)) - national**2)
    assert (of_classes < 0.7 * local).all(), "most of it is the mix, which the pooling finds"


def test_a_photo_counts_vehicles_down_to_an_elevation_of_25_degrees(tmp_path):
    from orthoscale.sources.lens import Lens, brown

    camera = brown((1000, 4000), 1000.0, 1000.0, (500, 500))
    tags = Tags(1000, 4000, 1000)
    photo = Photo("a", tmp_path / "a.jpg", tags, Lens(camera, 0.0, "given"), np.array([0, 0, -1.0]), 0.0, "nadir")
    away = np.tan(np.radians([64, 66])) * 1000  # from the nadir; the camera looks straight down
    seen = photo.views(np.column_stack([np.full(2, 500.0), 500 + away]), 50.0)[1]
    assert seen.tolist() == [True, False]


def test_a_frame_counts_vehicles_down_to_an_elevation_of_25_degrees(tmp_path):
    model, _ = make_model()
    source = ColmapSource.open(save(model, tmp_path / "m", "txt"), need_images=False)
    camera = source._model.cameras[1]
    camera.model, camera.params = pycolmap.CameraModelId.PINHOLE, [400.0, 400, 320, 240]
    name = source.picture_names[0]
    axis = source.rotation(name)[2]

    class LevelGround:  # ten units ahead of the camera, which looks straight down on it
        camera_height = 10.0

        def intersect(self, centres, rays):
            return centres + rays * (10 / (rays @ axis))[:, None], np.broadcast_to(-axis, rays.shape), rays @ axis > 0

    vars(source)["ground"] = LevelGround()
    away = 400 * np.tan(np.radians([0, 64, 66, 80]))
    counted = source.views(name, np.column_stack([320 + away, np.full(4, 240.0)]))[2]
    assert counted.tolist() == [True, True, False, False]


def corners_at(level, **body):
    """Distinct points of a hull's outline at `level` [m], of a vehicle of 4.5 x 1.8 m."""
    plan, heights = Hull(**body).outline()
    return {tuple(np.round(p * (4.5, 1.8), 3)) for p in plan[np.isclose(heights, level)]}


def test_the_body_of_a_car_in_metres():
    """Full footprint up to the bumpers, corners cut by 0.45 m; from there ends lean in by 0.45 m for each metre. The
    roof is drawn in by 1.35, 0.54 and 0.18 m besides."""

    def ring(front, rear, side):
        points = [(x, y) for x in (front, rear) for y in (side - 0.45, 0.45 - side)]
        points += [(x, y) for x in (front - 0.46875, rear + 0.46875) for y in (side, -side)]
        return {tuple(np.round(p, 3)) for p in points}

    assert corners_at(0.0, height=1.5) == corners_at(0.4, height=1.5) == ring(2.25, -2.25, 0.9)
    assert corners_at(0.85, height=1.5) == ring(2.0475, -2.0475, 0.9)
    assert corners_at(1.5, height=1.5) == ring(0.405, -1.215, 0.72)


def test_walls_that_lean_do_so_from_the_bumpers_up():
    plan, heights = Hull(height=0.8).outline()
    front = {round(float(h), 3): float(plan[np.isclose(heights, h), 0].max()) for h in np.unique(heights)}
    assert front == pytest.approx({0.0: 0.5, 0.4: 0.5, 0.8: 0.46})


@pytest.mark.parametrize("chance, tilt, drifts", [
    (0.004, 0.02, True), (0.006, 0.02, False), (0.1, 0.2, False), (1e-6, 0.009, False), (1e-6, 0.011, True),
])  # fmt: skip
def test_a_drift_is_reported_from_half_a_per_cent_of_chance_and_one_per_cent_of_the_scale(chance, tilt, drifts):
    trends = Trend(tilt, chance), Trend(0.0, 1.0, tilt, chance)
    tilted, bent = (Drift(trend, np.empty((0, 5)), (1.0, 1.0), 0.0) for trend in trends)
    assert tilted.drifts == bent.drifts == bool(tilted.warnings) == bool(bent.warnings) == drifts
    models = [ModelDrift({}, [], [], trend) for trend in trends]
    assert [model.drifts for model in models] == [bool(model.warnings) for model in models] == [drifts] * 2


@pytest.mark.parametrize("cores, asked, workers, each", [
    (1, None, 1, 1), (2, None, 2, 1), (8, None, 8, 1), (32, None, 8, 4), (32, 4, 4, 8), (2, 16, 16, 1),
])  # fmt: skip
def test_threads_share_the_cores_among_them(monkeypatch, cores, asked, workers, each):
    for module in ("workers", "effort"):
        monkeypatch.setattr(f"orthoscale.detect.{module}.cores", lambda: cores)
    assert Effort(workers=asked).threads == workers and Effort(workers=asked).threads_each == each
