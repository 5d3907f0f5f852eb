"""The synthetic scenes: is their truth true?"""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest

from orthoscale.core.boxes import overlap
from orthoscale.errors import UsageError
from orthoscale.synthetic import (
    STYLES,
    Camera,
    Look,
    NormalFleet,
    Perspective,
    Pose,
    Vehicle,
    flight,
    lookalikes,
    make_scene,
    render,
    render_frame,
    render_ortho,
    vehicle_boxes,
    write_colmap,
    write_labels,
    write_ortho,
)
from orthoscale.synthetic.__main__ import main
from orthoscale.synthetic.labels import labelled_boxes, visible_share
from orthoscale.synthetic.mesh import pavement, rectangle, rounded
from orthoscale.synthetic.render import ortho_view, surface
from orthoscale.synthetic.vehicle import Bed, around

CLEAN = Look(noise=0.0, blur_px=0.0)


@pytest.fixture(scope="module")
def scene():
    return make_scene(5, NormalFleet(), 60, 30, "carpark")


@pytest.fixture(scope="module")
def oblique():
    camera = Camera(600, 500, 400, k1=-0.04)
    return Perspective(camera, Pose.looking(np.array([-40.0, 3.0, 45.0]), 0.1, np.deg2rad(50), 0.02))


def in_box(points: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Points (..., 2) in a box's own coordinates, where it spans -1..1 each way."""
    cos, sin = np.cos(box[4]), np.sin(box[4])
    d = points - box[:2]
    return np.stack([d @ [cos, sin], d @ [-sin, cos]], -1) / (box[2:4] / 2)


@pytest.mark.slow
@pytest.mark.parametrize("style", STYLES)
def test_nothing_stands_on_a_vehicle(style):
    scene = make_scene(11, None, 70, 30, style)
    assert len(scene.vehicles) == 30
    rows = np.array([[v.x, v.y, v.length, v.width, v.heading] for v in scene.vehicles])
    i, j = np.triu_indices(len(rows), 1)
    assert overlap(rows[i], rows[j]).max() == 0
    _, owner = render(scene, ortho_view(scene, 0.15), look=CLEAN)
    assert visible_share(scene.vehicles, ortho_view(scene, 0.15), owner).min() > 0.75  # bar a crown's edge


def test_box_of_an_orthophoto_is_the_hull(scene):
    view = ortho_view(scene, 0.05)
    for vehicle, box in zip(scene.vehicles, vehicle_boxes(scene.vehicles, view).xylwa, strict=True):
        assert box[2:4] * 0.05 == pytest.approx([vehicle.length, vehicle.width], abs=1e-9)
        hull = in_box(view.project(vehicle.hull), box)
        assert hull.max(0) == pytest.approx(1, abs=1e-9) and hull.min(0) == pytest.approx(-1, abs=1e-9)


def test_box_of_a_frame_just_encloses_the_lower_body(scene, oblique):
    boxes = vehicle_boxes(scene.vehicles, oblique, effective_height_m=0.8)
    for vehicle, box in zip(scene.vehicles, boxes.xylwa, strict=True):
        body = np.concatenate([np.insert(vehicle.footprint, 2, z, axis=1) for z in (0.0, 0.8)])
        corners = in_box(oblique.project(body), box)
        assert corners.max(0) == pytest.approx(1, abs=1e-9) and corners.min(0) == pytest.approx(-1, abs=1e-9)


def test_drawn_vehicles_fill_their_boxes(scene):
    """To a pixel: the renderer must not widen what it draws."""
    view = ortho_view(scene, 0.04)
    face, _ = surface(scene.mesh, view)
    owner = np.where(face < 0, -1, scene.mesh.owner[face])
    for i, box in enumerate(vehicle_boxes(scene.vehicles, view).xylwa):
        y, x = np.nonzero(owner == i)
        place = in_box(np.stack([x, y], 1) + 0.5, box) * box[2:4] / 2
        assert np.ptp(place[:, 0]) == pytest.approx(box[2], abs=1.5)
        beside_mirrors = place[np.abs(place[:, 0]) < 0.1 * box[2], 1]
        assert np.ptp(beside_mirrors) == pytest.approx(box[3], abs=1.5)


def test_picture_shows_vehicles_where_the_boxes_are(scene):
    image, boxes = render_ortho(scene, 0.1, look=CLEAN)
    empty, none = render_ortho(replace(scene, vehicles=()), 0.1, look=CLEAN)
    assert image.shape == (600, 600, 3) and image.dtype == np.uint8
    assert len(none) == 0 and len(boxes) == len(scene.vehicles)
    change = np.abs(image.astype(int) - empty).mean(2)
    inside = np.zeros(change.shape, np.uint8)
    for corners in boxes.corners:
        cv2.fillConvexPoly(inside, np.round(corners - 0.5).astype(np.int32), 1)
    assert np.median(change[inside == 1]) > 15
    shadows = cv2.dilate(inside, np.ones((81, 81)))
    assert (change[shadows == 0] == 0).all()


def test_equal_seeds_give_equal_pictures(scene):
    again = make_scene(5, NormalFleet(), 60, 30, "carpark")
    assert again.vehicles == scene.vehicles
    assert (render_ortho(again, 0.2, 3)[0] == render_ortho(scene, 0.2, 3)[0]).all()
    assert (render_ortho(scene, 0.2, 4)[0] != render_ortho(scene, 0.2, 3)[0]).any()
    assert make_scene(6, NormalFleet(), 60, 30, "carpark").vehicles != scene.vehicles


def test_panels_lie_side_by_side_within_their_roof():
    for seed in range(12):
        mesh = lookalikes.panels(np.random.default_rng(seed), 30, 18)
        glass = mesh.corners[len(mesh) // 2 :, :4]
        assert np.abs(glass[..., 0]).max() <= 15 and np.abs(glass[..., 1]).max() <= 9
        sides = np.linalg.norm(np.diff(glass, axis=1), axis=2)
        assert sides.max() < 2.35 and sides.min() > 0.85  # as modules are made
        rows = np.c_[glass.mean(1)[:, :2], np.ptp(glass[..., :2], axis=1), np.zeros(len(glass))]
        i, j = np.triu_indices(min(len(rows), 60), 1)
        assert overlap(rows[i], rows[j]).max() == 0


def _area(plan):
    x, y = plan.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_the_decks_about_a_bed_are_all_but_the_bed():
    plan, hole = rounded(5.2, 1.9, 0.3, 0.2), rectangle(1.5, 1.4) + [-1.6, 0.0]
    parts = around(plan, hole)
    assert len(parts) == 4
    assert min(map(_area, parts)) > 0  # counter-clockwise, or they would be seen from below
    assert sum(map(_area, parts)) == pytest.approx(_area(plan) - _area(hole))


@pytest.mark.parametrize(
    ("bed", "top"),
    [
        (Bed(0.3, depth=0.4), "floor"),
        (Bed(0.3, cover=(0.0, 0.0, 0.0)), "rim"),
        (Bed(0.3, cover=(0.5, 0.5, 0.5), cap=True), "roof"),
        (Bed(), "rim"),
    ],
)
def test_what_is_behind_a_pickups_cab_lies_as_high_as_it_says(bed, top):
    pickup = Vehicle(0.0, 0.0, 0.0, 5.2, 1.9, 1.8, "pickup", shoulder=0.2, bed=bed)
    mesh = pickup.mesh(np.random.default_rng(0))
    over = [face for face in mesh.corners if _over(face, (-1.9, 0.1))]
    highest = max(face[:, 2].mean() for face in over)
    expected = {"floor": pickup.belt - bed.depth, "rim": pickup.belt, "roof": pickup.height - 0.05}[top]
    assert highest == pytest.approx(expected, abs=0.035)
    assert np.ptp(mesh.corners[..., 0]) < 5.25  # nothing sticks out behind


def _over(face, point):
    """Whether a face (n, 3), seen from above, has (x, y) in it."""
    plan = face[:, :2].astype(np.float32)
    return abs(_area(plan)) > 1e-6 and cv2.pointPolygonTest(plan, point, False) > 0


def test_sizes_come_from_the_fleet():
    fleet = NormalFleet((3.4, 1.48, 1.7), (0.0, 0.0, 0.0))
    scene = make_scene(2, fleet, 50, 10)
    assert {(v.length, v.width, v.height) for v in scene.vehicles} == {(3.4, 1.48, 1.7)}


def test_neighbouring_faces_leave_no_gap(oblique):
    mesh = pavement((-200, 200), (-200, 200), 0.0, "plain", (0.5, 0.5, 0.5), piece=3.7)
    assert (surface(mesh, oblique.ideal())[0] >= 0).all()
    turned = mesh.placed(0.3, 0.1, 0.4)
    assert (surface(turned, ortho_view(make_scene(0, None, 20, 0), 0.05))[0] >= 0).all()


def test_distortion_and_its_inverse(oblique):
    points = np.random.default_rng(0).uniform([-20, -20, 0], [20, 20, 10], (50, 3))
    camera = oblique.in_camera(points)
    assert oblique.undistorted(oblique.project(points)) == pytest.approx(camera[:, :2] / camera[:, 2:], abs=1e-9)


def test_distorted_frame_matches_its_boxes(scene, oblique):
    """Drawn undistorted and then bent, the picture must still agree with the direct projection."""
    image, owner = render(scene, oblique, look=CLEAN)
    assert image.shape == (400, 500, 3)
    assert (image == render_frame(scene, oblique.camera, oblique.pose, look=CLEAN)).all()
    boxes, share = vehicle_boxes(scene.vehicles, oblique, 0.8), visible_share(scene.vehicles, oblique, owner)
    clear = (share > 0.9) & boxes.inside(500, 400)
    assert clear.sum() > 5
    for i in np.flatnonzero(clear):
        y, x = np.nonzero(owner == i)
        place = in_box(np.stack([x, y], 1) + 0.5, boxes.xylwa[i])
        assert (np.abs(place) < 1).all(1).mean() > 0.75


@pytest.mark.parametrize(("binary", "k1", "pitch"), [(True, 0.0, 90.0), (False, -0.05, 55.0)])
def test_colmap_model(tmp_path, scene, binary, k1, pitch):
    truth = write_colmap(
        scene, tmp_path, 3.7, 6, pitch, 50.0, 500, 400, 300, 4, binary,
        k1=k1, slope_deg=2.0, n_points=400, noise_px=0.0, pictures=False,
    )  # fmt: skip
    assert {p.suffix for p in (tmp_path / "sparse").iterdir()} == {".bin" if binary else ".txt"}
    model = pycolmap.Reconstruction(str(tmp_path / "sparse"))
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() < 1e-6
    assert model.num_points3D() == 400 and model.num_reg_images() == 6 and model.is_valid()
    assert min(len(p.track.elements) for p in model.points3D.values()) >= 2
    poses = flight(scene, 6, 50.0, pitch, 2.0, 4)
    metres = np.array([p.centre for p in poses])
    units = np.array([model.images[i + 1].projection_center() for i in range(6)])
    for a, b in ((0, 5), (1, 3), (2, 4)):
        assert np.linalg.norm(metres[a] - metres[b]) / np.linalg.norm(units[a] - units[b]) == pytest.approx(3.7)
    # A vehicle's truth in the model is where the camera of the model sees the vehicle.
    camera, image = model.cameras[1], model.images[3]
    at = camera.img_from_cam(image.cam_from_world() * np.array(truth["vehicles"][0]["centre_model"]))
    v = scene.vehicles[0]
    view = Perspective(Camera(500, 400, 300, k1), poses[2])
    assert np.ravel(at) == pytest.approx(view.project(np.array([v.x, v.y, 0.0])), abs=1e-6)


def test_colmap_model_has_pictures_and_noise(tmp_path, scene):
    truth = write_colmap(scene, tmp_path, 0.5, 3, 70.0, 45.0, 300, 320, 240, 1, n_points=200, noise_px=0.3)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse"))
    assert 0.25 < model.compute_mean_reprojection_error() < 0.55
    assert {p.name for p in (tmp_path / "images").iterdir()} == {i.name for i in model.images.values()}
    assert json.loads((tmp_path / "truth.json").read_text()) == truth
    assert truth["metres_per_model_unit"] == 0.5 and truth["frames"][0]["boxes"]


def test_written_orthophoto(tmp_path, scene):
    truth = write_ortho(scene, tmp_path / "site.png", 0.1)
    assert cv2.imread(str(tmp_path / "site.png")).shape == (600, 600, 3)
    assert json.loads((tmp_path / "site.truth.json").read_text()) == truth
    box = truth["boxes"][0]
    assert box["length"] * truth["gsd_m"] == pytest.approx(truth["vehicles"][box["vehicle"]]["length_m"])


def test_a_picture_of_another_ending_is_refused_before_it_is_rendered(tmp_path, scene, monkeypatch, capsys):
    monkeypatch.setattr("orthoscale.synthetic.model.render", lambda *_: pytest.fail("rendered"))
    with pytest.raises(UsageError, match=r"\.jpg or \.png"):
        write_ortho(scene, tmp_path / "site.tif", 0.1)
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "OUT.png or .jpg" in " ".join(capsys.readouterr().out.split())


def test_labels(tmp_path):
    labels = json.loads(write_labels(tmp_path, count=3, seed=2, size=192).read_text())["images"]
    assert len(labels) == 3
    for entry in labels:
        height, width, _ = cv2.imread(str(tmp_path / "images" / entry["file"])).shape
        assert (entry["width"], entry["height"], entry["set"]) == (width, height, "synthetic")
        for box in entry["boxes"]:
            assert box["kind"] in ("vehicle", "ignore", "large-vehicle")
            assert box["length"] >= box["width"] > 0
            if box["kind"] == "vehicle":
                assert 0 <= box["cx"] <= width and 0 <= box["cy"] <= height and box["length"] >= 8


def test_a_lorry_of_which_a_part_is_in_the_picture_is_no_background(scene):
    lorries = np.array([[-34.0, 0, 11, 2.5, 0.0], [-26, 9, 11, 2.5, 0.0], [-40, 5, 11, 2.5, 0.0]])  # of 30 m each way
    view = ortho_view(scene, 0.2)
    nothing = np.full((view.height, view.width), -1)
    boxes = labelled_boxes(replace(scene, lorries=lorries), view, nothing)
    large = [box for box in boxes if box["kind"] == "large-vehicle"]
    assert [box["cx"] for box in large] == pytest.approx([-20, 20])  # the third lies outside


def test_command_line(tmp_path):
    main(["ortho", str(tmp_path / "a.png"), "--extent", "20", "--vehicles", "3", "--gsd", "0.2", "--fleet", "de"])
    assert (tmp_path / "a.png").exists()
