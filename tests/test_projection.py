"""The exact projection against boxes made from bodies of known size, seen by cameras of known pose."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.bodies import CAR, ESTATE, block, body
from support.camera import simple_views
from support.simulate import DENSEUAV, PITCHES, UNIT, Body, car_mesh, found_ruler
from support.simulate import fly as flown

from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring.planar_sweep import SweepGeometry
from orthoscale.core.projection import exact
from orthoscale.core.projection.exact import BEND, BODIES, Hull, ground_size
from orthoscale.core.projection.height import lean
from orthoscale.core.projection.own_ruler import OwnRuler, SeenBoxes
from orthoscale.core.projection.view import Views
from orthoscale.synthetic.vehicle import Vehicle


def flight(n, pitch_deg, rng, focal=1000.0, altitude=90.0, unit=0.07, shape=None, roll_deg=0.0, slope=0.0, sizes=None):
    """n vehicles seen by a camera at `altitude` [m], in units of `unit` metres: (boxes, views, sizes [m])."""
    plan, heights = shape or body()
    size = rng.normal([4.5, 1.8], [0.3, 0.08], (n, 2)) if sizes is None else np.tile(sizes[:2], (n, 1))
    pitch, roll = np.radians(pitch_deg), np.radians(roll_deg)
    # Camera looks down by `pitch`; world z up. Rows of the rotation are the camera's axes.
    forward = np.array([0, np.cos(pitch), -np.sin(pitch)])
    right = np.array([1.0, 0, 0])
    down = np.cross(forward, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, -np.sin(roll) * right + np.cos(roll) * down
    rotation = np.stack([right, down, forward])
    normal = np.array([np.sin(slope), 0, np.cos(slope)])

    pixels = rng.uniform([-500, -350], [500, 350], (n, 2))
    rays = np.column_stack([pixels / focal, np.ones(n)]) @ rotation
    camera = np.array([0, 0, altitude])
    centre = camera + rays * (-(camera @ normal) / (rays @ normal))[:, None]
    heading = rng.uniform(0, np.pi, n)
    flat = np.stack([np.cos(heading), np.sin(heading), np.zeros(n)], -1)
    along = flat - (flat @ normal)[:, None] * normal
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(normal, along)

    offset = plan[None] * size[:, None]
    points = centre[:, None] + offset[..., :1] * along[:, None] + offset[..., 1:] * across[:, None]
    points = points + heights[None, :, None] * normal

    def project(world):
        local = (world - camera) @ rotation.T
        return local[..., :2] / local[..., 2:] * focal

    tip = project(centre + 1e-3 * along) - project(centre)
    angle = np.arctan2(tip[:, 1], tip[:, 0])
    axes = np.stack([np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)], 1)
    seen = np.einsum("nij,npj->npi", axes, project(points))
    low, high = seen.min(1), seen.max(1)
    middle = np.einsum("nij,ni->nj", axes, (low + high) / 2)
    boxes = Boxes(np.column_stack([middle, high - low, angle]), np.ones(n))
    keep = boxes.length == (high - low)[:, 0]  # foreshortened beyond recognition: the short side became the long one

    rays = np.column_stack([middle / focal, np.ones(n)]) @ rotation
    ground = camera + rays * (-(camera @ normal) / (rays @ normal))[:, None]
    local = (ground - camera) @ rotation.T / unit
    views = Views(
        local, np.broadcast_to(rotation @ normal, (n, 3)), np.broadcast_to(np.diag([focal, focal]), (n, 2, 2))
    )
    return boxes[keep], views[keep], size[keep]


@pytest.mark.parametrize("pitch", [90, 75, 60, 45, 30])
@pytest.mark.parametrize("focal, altitude", [(1000, 90), (4000, 450)])
def test_sizes_come_back_at_every_pitch(pitch, focal, altitude):
    unit = 0.07
    boxes, views, size = flight(300, pitch, np.random.default_rng(pitch), focal, altitude, unit)
    error = np.log(ground_size(boxes, views, unit) * unit / size)
    solved = np.isfinite(error).all(1)
    assert solved.mean() > 0.97
    assert np.abs(error[solved].mean(0)).max() < 0.003
    assert error[solved].std(0).max() < 0.005


def test_roll_slope_and_a_taller_hull_are_geometry_like_any_other():
    hull = Hull(height=1.3)
    boxes, views, size = flight(300, 60, np.random.default_rng(1), roll_deg=20, slope=0.15, shape=body(CAR, 1.3))
    error = np.log(ground_size(boxes, views, 0.07, hull) * 0.07 / size)
    assert np.nanmax(np.abs(np.nanmean(error, 0))) < 0.004


@pytest.mark.parametrize("pitch, worst", [(90, 0.045), (75, 0.09)])
def test_another_body_than_the_one_assumed_costs_little_near_nadir(pitch, worst):
    boxes, views, size = flight(300, pitch, np.random.default_rng(2), shape=body(ESTATE, 1.5), altitude=90)
    error = np.log(ground_size(boxes, views, 0.07, Hull(height=1.5)) * 0.07 / size)
    assert np.abs(np.nanmean(error, 0)).max() < worst


BODY = {
    "a hatchback's mesh up to 0.8 m": (car_mesh("hatch", 0.8), "car", 0.015),
    "the whole of it": (car_mesh("hatch"), "car", 0.02),
    "a sharp block, told": (Body("", (4.4, 1.9), *block(1.6)), "cuboid", 0.003),
}


@pytest.mark.parametrize("name", BODY)
def test_the_views_of_another_body_tell_a_ruler_that_suits_it(name):
    shape, told, worst = BODY[name]
    seen = [flown(np.random.default_rng(-p), 60, DENSEUAV, p, shape) for p in PITCHES]
    ruler = found_ruler(seen, told)
    for s in seen:
        error = np.log(shape.size / (UNIT * ruler.size(SeenBoxes(s.boxes, s.views(unit=UNIT), 1.0, UNIT))))
        assert abs(np.nanmean(error)) < worst, s.pitch


@pytest.mark.parametrize("body", BODIES)
def test_walls_lean_from_the_bumpers_up_and_never_outwards(body):
    def widths(side_lean):
        plan, heights = Hull(**{**vars(BODIES[body]), "height": 1.6, "side_lean": side_lean}).outline()
        return {float(h): 2 * plan[heights == h, 1].max() for h in np.unique(heights)}

    tapered, upright = widths(0.05), widths(BODIES[body].least_lean[1] - 5.0)
    assert tapered[0.0] == tapered[BEND] == 1.0 and tapered[1.6] <= 1 - 2 * 0.05 * (1.6 - BEND) + 1e-9
    assert set(upright.values()) == {1.0}


@pytest.mark.parametrize("pitch", [90, 60, 45, 30])
@pytest.mark.parametrize("angle, along", [(np.pi / 2, True), (0.0, False)])
def test_a_height_shows_by_the_elevations_cotangent_on_the_side_that_points_to_the_camera(pitch, angle, along):
    views = simple_views(np.array([[720.0, 540.0]]), (1440, 1080), 1000.0, -np.radians(pitch))
    shown = lean(Boxes(np.array([[720.0, 540.0, 50, 20, angle]]), np.ones(1)), views)[0]
    told = 1 / np.tan(np.radians(pitch))
    assert shown == pytest.approx([told, 0] if along else [0, told], abs=1e-6)


@pytest.mark.parametrize("body", ["car", "van"])
def test_with_the_least_lean_all_walls_just_stand_straight(body):
    """The front too, which a car's roof is drawn in from by more than from the rear."""
    tall = {**vars(BODIES[body]), "height": 1.6}
    end, side = Hull(**tall).least_lean
    for share, straight in ((1.0, True), (0.95, False)):
        plan, heights = Hull(**{**tall, "end_lean": share * end, "side_lean": share * side}).outline()
        top = plan[heights == 1.6]
        reach = min(top[:, 0].max(), -top[:, 0].min()), top[:, 1].max()
        assert (reach == pytest.approx((0.5, 0.5), abs=1e-9)) == straight
        assert (max(reach) < 0.5 - 1e-3) != straight


def test_a_wrong_guess_of_the_scale_hardly_matters():
    boxes, views, size = flight(300, 60, np.random.default_rng(3))
    right, off = (ground_size(boxes, views, 0.07 * factor) for factor in (1.0, 1.1))
    assert np.nanmedian(np.abs(np.log(off / right))) < 0.03


def test_a_box_too_small_for_any_vehicle_of_that_height_is_nan():
    boxes, views, _ = flight(20, 45, np.random.default_rng(4))
    tiny = Boxes(boxes.xylwa * [1, 1, 0.1, 0.1, 1], boxes.score)
    assert np.isnan(ground_size(tiny, views, 0.07)).all(1).mean() > 0.8


def test_a_box_that_the_height_all_but_fills_shows_no_sliver_of_a_vehicle():
    """Half of their size at 30 degrees: of one box in 16 the height leaves nothing, or less."""
    boxes, views, _ = flight(400, 30, np.random.default_rng(4))
    size = 0.07 * ground_size(Boxes(boxes.xylwa * [1, 1, 0.5, 0.5, 1], boxes.score), views, 0.07)
    assert 0.7 < np.isfinite(size).all(1).mean() < 0.8 and np.nanmin(size) > 0.09


@pytest.mark.parametrize("aside", [0.0, 10.0])
def test_elevation_and_pixel_size(aside):
    """A pixel beside the middle is of the picture's plane: it covers no more across, though the ray is longer."""
    views = Views(np.array([[aside, 0, 10.0]]), np.array([[0, 0, -1.0]]), np.diag([500.0, 500.0])[None])
    assert views.elevation[0] == pytest.approx(np.arctan2(10, aside))
    assert views.unit_per_pixel[0] == pytest.approx(10 / 500)


def test_a_longer_lens_from_higher_up_takes_the_same_picture_from_straight_above():
    views = Views(np.array([[3.0, -2.0, 10.0]]), np.array([[0, 0, -1.0]]), np.diag([500.0, 500.0])[None])
    longer = views.with_focal(1.2)
    assert longer.ground[0] == pytest.approx([3.0, -2.0, 12.0]), "the same footprints, by a camera so much higher"
    assert longer.unit_per_pixel == pytest.approx(views.unit_per_pixel)


def test_a_size_that_more_steps_would_change_is_not_told(monkeypatch):
    """Boxes up to as wide as the camera is far, which hardly any vehicle fills."""
    rng = np.random.default_rng(0)
    views = simple_views(rng.uniform([0, 500], [1440, 1080], (400, 2)), (1440, 1080), 1000.0, np.radians(-30), 10.0)
    length = rng.uniform(1.5, 13.0, 400) * 1000 * np.sin(views.elevation) / 10
    sides = np.column_stack([length, length * rng.uniform(0.2, 0.9, 400)])
    boxes = Boxes(np.column_stack([np.zeros((400, 2)), sides, rng.uniform(0, np.pi, 400)]), np.ones(400))
    told = ground_size(boxes, views, 1.0)
    monkeypatch.setattr(exact, "ITERATIONS", 60)
    known = np.isfinite(told).all(1)
    assert 0.2 < known.mean() < 0.9
    assert told[known] == pytest.approx(ground_size(boxes, views, 1.0)[known], rel=0.05)


@pytest.mark.parametrize("place", [(0.0, 0.0), (3.0, 8.0), (0.0, 20.0), (25.0, 15.0), (-1.0, 2.5)])
@pytest.mark.parametrize("unit", [1.0, 4e7, 1e-4])
def test_a_plan_made_by_one_camera_gives_footprints(place, unit):
    """A block of 4.5 x 1.8 x 0.8 m, seen from 15 m, by the shadow that its corners throw on the ground; in units as
    large as the Earth's circumference too, of which no vehicle was long enough."""
    camera, size, height = 15.0, np.array([4.5, 1.8]), 0.8
    corners = np.array(place) + np.array([[x, y] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * size
    shown = np.concatenate([corners, corners * camera / (camera - height)])
    low, high = shown.min(0), shown.max(0)
    middle, none = (low + high)[None] / 2 / camera, (0.0, 0.0)
    boxes = Boxes(np.zeros((1, 5)), np.ones(1))
    flat = (high - low)[None] / unit
    plan = SimpleNamespace(camera=np.full((1, 1), camera / unit), offset=middle, flat=flat, boxes=boxes)
    ruler = OwnRuler.of_card((height, height), none, (0.25, 0.25), none, BODIES["cuboid"])
    assert unit * ruler.size(SweepGeometry._seen(plan, unit))[0] == pytest.approx(size, rel=1e-4)


@pytest.mark.parametrize("pitch", [85, 70, 55, 45])
def test_outlines_of_rendered_vehicles_are_those_of_the_body_assumed(pitch):
    """Meshes with tucked-in bumpers and doors, shoulders, cabins and wheels. Taken for a body with sharper corners and
    upright ends, lengths come out several per cent too small."""
    rng = np.random.default_rng(pitch)
    error = []
    for shape, size in (("sedan", (4.7, 1.82, 1.46)), ("hatch", (4.2, 1.77, 1.5)), ("suv", (4.6, 1.85, 1.68))):
        vehicle = Vehicle(0, 0, 0, *size, shape=shape, tucked=(0.12, 0.05))
        faces = vehicle.mesh(rng).corners.reshape(-1, 3)
        mesh = faces[np.abs(faces[:, 1]) < size[1] / 2 + 0.02]  # without mirrors
        boxes, views, known = flight(200, pitch, rng, shape=(mesh[:, :2] / size[:2], mesh[:, 2]), unit=1.0, sizes=size)
        body = replace(BODIES["car"], height=size[2])
        error.append(np.nanmedian(np.log(ground_size(boxes, views, 1.0, body) / known), axis=0))
    assert np.abs(np.mean(error, axis=0)) == pytest.approx([0.0, 0.0], abs=0.03)
    assert abs(np.mean(error, axis=0)[0]) < 0.02
