"""The ground under made-up terrain, where its height is known everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from orthoscale.errors import InputError, TooLittleEvidence
from orthoscale.sources.ground import Ground
from orthoscale.sources.ground_grid import variances
from orthoscale.sources.ground_sheet import Sheet

CAMERA_HEIGHT = 60.0  # [m], before the model's own unit
SIZE = 200.0


def flat(x, y):
    return 0 * x


def sloped(x, y):
    return 0.12 * x - 0.05 * y


def hilly(x, y):
    return 2 * np.sin(2 * np.pi * x / 150) + 1.5 * np.cos(2 * np.pi * y / 120) + 0.03 * x


class Scene:
    """Houses, trees, a full car park and stray points over a terrain, in an arbitrary frame and unit."""

    def __init__(self, terrain, count=8000, strays=0.2, seed=0, unit=0.07):
        random = np.random.default_rng(seed)
        xy = random.uniform(-SIZE / 2, SIZE / 2, (count, 2))
        x, y = xy.T
        over = np.zeros(count)
        house = (np.abs(x % 40 - 20) < 6) & (np.abs(y % 30 - 15) < 6) & (x > 0)
        tree = (np.hypot(x % 25 - 12, y % 20 - 10) < 5) & (x < 0) & (random.random(count) < 0.9)
        car = (np.abs(x) < 25) & (np.abs(y + 40) < 25) & (x % 3 < 1.9) & (y % 9 < 4.6)
        over[house] = random.uniform(5, 7, house.sum())
        over[tree] = random.uniform(1, 9, tree.sum())
        over[car] = random.choice([0.7, 1.0, 1.4], car.sum())
        points = np.column_stack([xy, terrain(x, y) + over + random.normal(0, 0.15, count)])
        stray = random.uniform([-SIZE / 2, -SIZE / 2, -60], [SIZE / 2, SIZE / 2, 50], (int(strays * count), 3))
        gx, gy = np.meshgrid(np.arange(-80, 81, 20.0), np.arange(-80, 81, 20.0))
        centres = np.column_stack([gx.ravel(), gy.ravel(), CAMERA_HEIGHT + random.normal(0, 1, gx.size)])
        gx, gy = np.meshgrid(np.arange(-85, 86, 5.0), np.arange(-85, 86, 5.0))
        truth = np.column_stack([gx.ravel(), gy.ravel(), terrain(gx.ravel(), gy.ravel())])

        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        shift = 10 * random.normal(size=3)
        self.unit, self.up = unit, turn[:, 2]
        self.points, self.centres, self.truth = (
            a @ turn.T * unit + shift for a in (np.concatenate([points, stray]), centres, truth)
        )
        self.plane_truth = truth


@pytest.mark.parametrize("strays", [0.0, 0.2])
@pytest.mark.parametrize("terrain", [flat, sloped, hilly])
def test_height_of_the_ground(terrain, strays):
    scene = Scene(terrain, strays=strays)
    error = Ground.fit(scene.points, scene.centres).height_above(scene.truth) / scene.unit / CAMERA_HEIGHT
    assert np.sqrt(np.mean(error**2)) < 0.002
    assert abs(np.median(error)) < 0.001
    assert np.percentile(np.abs(error), 95) < 0.005


@pytest.mark.parametrize(
    "axes, shift, unit",
    [([1, 2, 3], 0, 1), ([2, 3, 1], 0, 1), ([-2, 1, 3], 1e6, 1), ([-1, 3, 2], 0, 1e3), ([0, 0, 0], -1e6, 1e-2)],
)
def test_the_ground_goes_with_its_world(axes, shift, unit):
    """Turned, shifted, in another unit and with its points in another order, it is the same ground."""
    scene, random = Scene(hilly), np.random.default_rng(1)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    if any(axes):
        turn = np.eye(3)[np.abs(axes) - 1] * np.sign(axes)[:, None]
    ground = Ground.fit(scene.points, scene.centres)
    moved = Ground.fit(
        *(unit * (some @ turn.T + shift) for some in (random.permutation(scene.points), scene.centres[::-1]))
    )
    expected = ground.height_above(scene.truth)
    found = moved.height_above(unit * (scene.truth @ turn.T + shift)) / unit
    assert np.abs(found - expected).max() < 1e-7 * ground.camera_height
    assert moved.camera_height == pytest.approx(unit * ground.camera_height, rel=1e-7)


def test_ground_in_the_clearings_of_a_wood_does_not_depend_on_where_cells_end():
    """The same sheet over axes that lie another way: a clearing is as wide as a cell of the first sheet, or less."""
    random = np.random.default_rng(0)
    xy = random.uniform(-120, 120, (5000, 2))
    clearings = random.uniform(-120, 120, (60, 2))
    bare = np.linalg.norm(xy[:, None] - clearings, axis=2).min(1) < 7.5
    over = np.where(bare | (random.random(5000) > 0.97), 0, random.uniform(3, 8, 5000)) + random.normal(0, 0.1, 5000)
    points, level = np.column_stack([xy, 0.03 * xy[:, 0] + over]), np.array([*np.ndindex(13, 13)]) * 15.0 - 90
    centres = np.column_stack([(np.array([*np.ndindex(5, 5)]) - 2) * 40, np.full(25, CAMERA_HEIGHT)])
    truth = np.column_stack([level, 0.03 * level[:, 0]])
    for angle in np.radians([0, 15, 45]):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        error = Sheet.fit(points @ turn.T, centres @ turn.T, turn)[0].height_above(truth) / CAMERA_HEIGHT
        assert np.abs(error).max() < 0.005


@pytest.mark.parametrize("farthest", [3e2, 1e4, 1e7])
def test_the_horizon_does_not_move_the_ground(farthest):
    """Oblique frames show it: a tenth of the points is up to 300, 10,000 or 1e7 camera heights away."""
    scene, random = Scene(hilly), np.random.default_rng(0)
    away = random.normal(size=(1000, 3))
    away -= 0.95 * (away @ scene.up)[:, None] * scene.up
    away *= farthest * CAMERA_HEIGHT * scene.unit * random.uniform(0.1, 1, (1000, 1))
    ground = Ground.fit(np.concatenate([scene.points, scene.centres[:1] + away]), scene.centres)
    error = ground.height_above(scene.truth) / scene.unit / CAMERA_HEIGHT
    assert np.sqrt(np.mean(error**2)) < 0.003


@pytest.mark.parametrize("count", [1000, 40000])
def test_few_and_many_points(count):
    scene = Scene(flat, count=count)
    ground = Ground.fit(scene.points, scene.centres)
    assert np.abs(ground.height_above(scene.truth)).max() < 0.005 * CAMERA_HEIGHT * scene.unit
    assert ground.up @ scene.up > np.cos(np.radians(0.1))
    assert ground.camera_height == pytest.approx(CAMERA_HEIGHT * scene.unit, rel=0.01)
    assert ground.noise == pytest.approx(0.15 * scene.unit, rel=0.3)


def test_same_in_every_unit():
    small, large = Scene(hilly, unit=1e-3), Scene(hilly, unit=1e3)
    heights = [Ground.fit(s.points, s.centres).height_above(s.truth) / s.unit for s in (small, large)]
    assert np.abs(heights[0] - heights[1]).max() < 0.05


def test_rays_end_on_the_ground():
    scene = Scene(hilly)
    ground = Ground.fit(scene.points, scene.centres)
    middle = np.abs(scene.plane_truth[:, :2]).max(1) < 60
    target = scene.truth[middle]
    origin = scene.centres[np.random.default_rng(1).integers(0, len(scene.centres), len(target))]
    points, normals, ok = ground.intersect(origin, 0.1 * (target - origin))
    assert ok.all()
    assert np.abs(ground.height_above(points)).max() < 1e-7 * ground.camera_height
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-12
    assert np.abs(np.cross(points - origin, target - origin)).max() < 1e-9
    assert (normals @ scene.up > 0.9).all()
    steep = ((target - origin) @ -scene.up) > 0.5 * np.linalg.norm(target - origin, axis=1)
    assert np.linalg.norm(points - target, axis=1)[steep].max() < 0.03 * ground.camera_height
    # The normal is that of the surface itself.
    x, y = scene.plane_truth[middle][:, :2].T
    slope = np.hypot(
        2 * 2 * np.pi / 150 * np.cos(2 * np.pi * x / 150) + 0.03, 1.5 * 2 * np.pi / 120 * np.sin(2 * np.pi * y / 120)
    )
    assert np.median(np.abs(np.arccos(normals @ scene.up) - np.arctan(slope))) < np.radians(1.5)


def test_rays_that_miss():
    scene = Scene(flat)
    ground = Ground.fit(scene.points, scene.centres)
    origin = np.repeat(scene.centres[40:41], 5, axis=0)
    aside = np.cross(scene.up, [1.0, 0, 0])
    directions = np.array([scene.up, aside, aside - 0.05 * scene.up, [np.nan, 0, 1], [0, 0, 0]])
    points, normals, ok = ground.intersect(origin, directions)
    assert not ok.any()
    assert np.isfinite(points).all() and np.isfinite(normals).all()
    assert ground.intersect(np.empty((0, 3)), np.empty((0, 3)))[0].shape == (0, 3)


def test_no_evidence():
    scene = Scene(flat)
    with pytest.raises(TooLittleEvidence, match="20 points and 81 cameras are too few"):
        Ground.fit(scene.points[:20], scene.centres)
    with pytest.raises(TooLittleEvidence, match="9600 points and 0 cameras are too few"):
        Ground.fit(scene.points, scene.centres[:0])
    with pytest.raises(TooLittleEvidence, match="0 points and 81 cameras are too few"):
        Ground.fit(np.full((1000, 3), np.nan), scene.centres)


@pytest.mark.parametrize("shape", ["one place", "a line", "around the cameras"])
def test_no_ground(shape):
    random = np.random.default_rng(0)
    scene = Scene(flat)
    points = {
        "one place": np.zeros((1000, 3)),
        "a line": random.uniform(-5, 5, (1000, 1)) * np.array([1.0, 2, 3]),
        "around the cameras": random.normal(size=(3000, 3)),
    }[shape]
    if shape == "around the cameras":
        points *= 10 / np.linalg.norm(points, axis=1, keepdims=True)
    with pytest.raises(InputError, match="no ground surface lies below the cameras"):
        Ground.fit(points, random.normal(size=(50, 3)) if shape == "around the cameras" else scene.centres)


def test_single_camera_and_single_strip():
    scene = Scene(flat)
    for centres in (scene.centres[40:41], scene.centres[36:45]):
        ground = Ground.fit(scene.points, centres)
        assert np.abs(ground.height_above(scene.truth)).max() < 0.005 * CAMERA_HEIGHT * scene.unit


@pytest.mark.slow
def test_it_knows_how_well_it_knows_its_height():
    """Errors where points are sparse or missing are as large as the ground says."""
    strays = []
    for seed in range(6):
        scene = Scene(hilly, count=700, seed=seed)
        local = (scene.points - scene.points.mean(0)) / scene.unit
        aside = np.cross(scene.up, [1.0, 0, 0])
        gap = np.abs(local @ (aside / np.linalg.norm(aside)) - 25) < 20  # a strip where no point was found
        ground = Ground.fit(scene.points[~gap], scene.centres)
        error, sd = ground.height_above(scene.truth), ground.sd(scene.truth)
        strays.append(np.sqrt(np.mean((error / sd) ** 2)))
        assert sd.max() > 2 * np.median(sd)
    assert 0.3 < np.mean(strays) < 1.6


def test_beyond_its_points_it_goes_on_and_is_less_sure():
    scene = Scene(sloped)
    ground = Ground.fit(scene.points, scene.centres)
    outwards = np.array([[100.0, 0, 0], [115.0, 0, 0], [125.0, 0, 0]])
    outwards[:, 2] = sloped(outwards[:, 0], 0)
    world = scene.truth[np.argsort(np.abs(scene.plane_truth[:, :2]).sum(1))[0]]
    world = world + (
        outwards
        @ np.linalg.lstsq(scene.plane_truth - scene.plane_truth.mean(0), scene.truth - scene.truth.mean(0), rcond=None)[
            0
        ]
    )
    rays = world - scene.centres[40]
    points, _, ok = ground.intersect(np.repeat(scene.centres[40:41], 3, 0), rays)
    assert ok.all()
    sd = ground.sd(points)
    assert (np.diff(sd) > 0).all()
    assert (np.abs(ground.height_above(world)) < 3 * sd + 0.3 * scene.unit).all()


@pytest.mark.parametrize("size, reach", [(30, 7), (28, 7), (5, 7), (8, 7)])
def test_variances_are_the_diagonal_of_the_inverse(size, reach):
    rng = np.random.default_rng(size)
    offsets = range(-reach, reach + 1)
    band = sparse.diags([rng.normal(size=size - abs(k)) for k in offsets if abs(k) < size],
                        [k for k in offsets if abs(k) < size]).toarray()  # fmt: skip
    within = np.abs(np.subtract.outer(range(size), range(size))) <= reach
    precision = (band @ band.T) * within + 4 * reach * size * np.eye(size)
    found = variances(sparse.csr_matrix(precision), reach)
    assert found == pytest.approx(np.linalg.inv(precision).diagonal(), rel=1e-12)
