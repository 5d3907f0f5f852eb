"""The paper's projection against values worked out by hand, its variants, and its simplified camera."""

from dataclasses import replace

import numpy as np
import pytest
from support.camera import simple_views

from orthoscale.core.boxes import Boxes
from orthoscale.core.projection import decoupled
from orthoscale.core.projection.decoupled import NAIVE, PROGRAM, TEXT

SIZE, FOCAL = (1440, 1080), 1000.0
MIDDLE = [720.0, 540.0]
L, W, H = decoupled.PRIORS
ROOT = np.sqrt(0.5)


def box(length, width, angle=0.0, at=MIDDLE):
    return Boxes(np.array([[*at, length, width, angle]]), np.ones(1))


def views(pitch_deg, at=MIDDLE, altitude=1.0):
    return simple_views(np.array([at]), SIZE, FOCAL, np.radians(pitch_deg), altitude)


@pytest.mark.parametrize("angle", [0.0, 0.7, -1.5])
def test_straight_below_every_formula_is_length_over_length(angle):
    for variant in (TEXT, NAIVE, replace(PROGRAM, factor=1.0)):
        s = decoupled.focal_plane_scale(box(44, 19, angle), views(-90), variant=variant)
        assert s == pytest.approx(np.array([[0.1, 0.1]]))


@pytest.mark.parametrize(
    "angle, long_side, short_side",
    [
        (np.pi / 2, (L + H) * ROOT, W),  # radial: the length is foreshortened and the height adds to it
        (0.0, L, (W + H) * ROOT),  # tangential: the width is
        (None, np.hypot((L + H) / 2, L * ROOT), np.hypot((W + H) / 2, W * ROOT)),  # halfway, on the ground
    ],
)
def test_effective_extents_at_45_degrees(angle, long_side, short_side):
    # Halfway on the ground is not halfway in the image, where the radial direction is foreshortened.
    angle = np.arctan(ROOT) if angle is None else angle
    s = decoupled.focal_plane_scale(box(50, 20, angle), views(-45))
    assert s == pytest.approx(np.array([[long_side * ROOT / 50, short_side * ROOT / 20]]))


@pytest.mark.parametrize("angle, expected", [(np.pi / 2, 0.0), (0.0, np.pi / 2), (np.arctan(ROOT), np.pi / 4)])
def test_relative_orientation_is_measured_on_the_ground(angle, expected):
    assert decoupled.relative_orientation(box(50, 20, angle), views(-45)) == pytest.approx(expected, abs=1e-6)


def test_the_program_has_the_length_of_the_ray_and_five_percent_more():
    at = [720 + 600.0, 540.0]
    boxes, geometry = box(50, 20, 0.3, at), views(-70, at)
    text, program = (decoupled.paper_scale(boxes, geometry, variant=v) for v in (TEXT, PROGRAM))
    assert program / text == pytest.approx(1.05 * np.hypot(1000, 600) / 1000)
    assert decoupled.paper_scale(boxes, geometry, variant=replace(PROGRAM, factor=1.0)) == pytest.approx(program / 1.05)
    assert replace(PROGRAM, factor=1.0, ray_length=False) == TEXT


def test_naive_takes_the_edges_for_the_vehicle():
    scale = decoupled.paper_scale(box(40, 20), views(-45), variant=NAIVE)
    metres_per_pixel = (L / 40 + W / 20) / 2
    assert scale == pytest.approx(metres_per_pixel * FOCAL / np.sqrt(2))  # the ground is sqrt(2) altitudes away


def test_metres_per_altitude_are_the_altitude():
    boxes, geometry = box(50, 20, 0.4), views(-60)
    s = decoupled.focal_plane_scale(boxes, geometry).mean()
    assert decoupled.paper_scale(boxes, geometry) == pytest.approx(s * FOCAL)


def test_the_unit_changes_the_scale_but_not_s():
    boxes, one, forty = box(50, 20, 0.4), views(-60), views(-60, altitude=40.0)
    assert decoupled.paper_scale(boxes, one) == pytest.approx(40 * decoupled.paper_scale(boxes, forty))
    assert decoupled.focal_plane_scale(boxes, one) == pytest.approx(decoupled.focal_plane_scale(boxes, forty))


def test_size_on_the_ground_and_scale_are_two_sides_of_one_thing():
    boxes, geometry = box(50, 20, 0.4), views(-60)
    by_length, by_width = (np.array([L, W]) / decoupled.ground_size(boxes, geometry))[0]
    assert decoupled.paper_scale(boxes, geometry) == pytest.approx((by_length + by_width) / 2)


@pytest.mark.parametrize("variant", [TEXT, PROGRAM, NAIVE], ids=["text", "program", "naive"])
def test_roll_and_lens_are_geometry_like_any_other(variant):
    rng = np.random.default_rng(0)
    pixels = rng.uniform((100, 100), (1340, 980), (50, 2))
    boxes = Boxes(np.column_stack([pixels, np.full(50, 50), np.full(50, 20), rng.uniform(-1.5, 1.5, 50)]), np.ones(50))
    simple = simple_views(pixels, SIZE, FOCAL, np.radians(-60))
    # The same camera turned about its axis by a quarter: x to y, y to -x.
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned_boxes = Boxes(boxes.xylwa + [0, 0, 0, 0, np.pi / 2], boxes.score)
    turned = replace(simple, ground=simple.ground @ turn.T, normal=simple.normal @ turn.T)
    expected = decoupled.paper_scale(boxes, simple, variant=variant)
    assert decoupled.paper_scale(turned_boxes, turned, variant=variant) == pytest.approx(expected)
    # A lens of twice the focal length makes everything half as large.
    longer = replace(simple, lens=2 * simple.lens)
    assert decoupled.paper_scale(boxes, longer, variant=variant) == pytest.approx(2 * expected)


def test_simple_views_against_general_geometry():
    pixels = np.array([[720.0, 540.0], [1000.0, 300.0], [200.0, 1000.0]])
    pitch, height = np.radians(-50), 80.0
    geometry = simple_views(pixels, SIZE, FOCAL, pitch, height)
    # World: x right, y ahead, z up; the camera at (0, 0, height).
    world_from_camera = np.array(
        [[1, 0, 0], [0, np.sin(pitch), np.cos(pitch)], [0, -np.cos(pitch), np.sin(pitch)]], float
    )
    assert np.linalg.det(world_from_camera) == pytest.approx(1)
    world = geometry.ground @ world_from_camera.T + [0, 0, height]
    assert world[:, 2] == pytest.approx(0, abs=1e-9)
    assert world[0] == pytest.approx([0, height / np.tan(-pitch), 0])
    assert geometry.normal @ world_from_camera.T == pytest.approx(np.tile([0.0, 0, 1], (3, 1)))
    seen = geometry.ground[:, :2] / geometry.ground[:, 2:] * FOCAL + MIDDLE
    assert seen == pytest.approx(pixels)
    assert geometry.elevation[0] == pytest.approx(-pitch)


def test_the_sky_has_no_scale():
    geometry = simple_views(np.array([[720.0, 0.0], [720.0, 1079.0]]), SIZE, FOCAL, np.radians(-10))
    boxes = Boxes(np.array([[720.0, 0, 50, 20, 0], [720.0, 1079, 50, 20, 0]]), np.ones(2))
    assert np.isnan(decoupled.paper_scale(boxes, geometry)).tolist() == [True, False]
