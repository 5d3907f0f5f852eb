"""Vehicles in an orthophoto whose pixels are not square on the ground, as in degrees."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from orthoscale.actions.anchors import Wanted, anchors_at
from orthoscale.actions.calibrate import calibrate
from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import Detections
from orthoscale.core.measuring.measure import measure
from orthoscale.core.measuring.method import Method
from orthoscale.core.measuring.plan import PlanGeometry
from orthoscale.core.projection.planar import ground_size
from orthoscale.core.ruler import Ruler
from orthoscale.errors import UsageError
from orthoscale.fleets import load_fleet
from orthoscale.sources.raster import RasterSource

GSD = 0.1  # geometric mean of a pixel's sides [m]


def seen(size, heading, aspect):
    """The boxes (N, 5) about vehicles of `size` (N, 2) [m] in pixels `aspect` times as wide as high."""
    out = []
    for k, ((length, width), turn) in enumerate(zip(size, heading, strict=True)):
        ahead, aside = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        corners = [a * length / 2 * ahead + b * width / 2 * aside for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        there = np.array(corners) / GSD / (np.sqrt(aspect), 1 / np.sqrt(aspect))
        _, (w, h), angle = cv2.minAreaRect(there.astype(np.float32))
        angle = np.deg2rad(angle) + (np.pi / 2 if w < h else 0)
        out.append([60 + 90 * (k % 20), 60 + 90 * (k // 20), max(w, h), min(w, h), angle])
    return np.array(out)


@pytest.mark.parametrize("aspect", [0.55, 0.8, 1.0, 1.5])
@pytest.mark.parametrize("heading", [0.0, np.pi / 2])
def test_vehicles_along_rows_and_columns_are_as_large_as_they_are(aspect, heading):
    boxes = Boxes(seen([(4.5, 1.8)], [heading], aspect), np.ones(1))
    assert ground_size(boxes, aspect)[0] * GSD == pytest.approx([4.5, 1.8], rel=1e-4)


def scale_of(aspect, heading, believed):
    rng = np.random.default_rng(3)
    fleet = load_fleet("DE")
    parts = [fleet.classes[k] for k in rng.choice(len(fleet.classes), 80, p=[c.weight for c in fleet.classes])]
    size = np.exp([rng.multivariate_normal(part.log_mean, part.log_covariance) for part in parts])
    boxes = Boxes(seen(size, heading, aspect), np.full(80, 0.9))
    source = SimpleNamespace(
        name="degrees.tif", width=2000, height=1000, picture_names=["degrees.tif"], unit="m/px",
        claimed=SimpleNamespace(aspect=believed),
    )  # fmt: skip
    found = Detections({source.name: boxes}, 1.0, Ruler(margin=(0, 0)), (0.7, 0.5), "test")
    return measure(PlanGeometry.of(source, found), fleet, Method()).scale


def test_the_noise_of_votes_is_a_share_of_the_vehicles_sizes():
    """As these are what it is pooled with; boxes may be larger by a wide margin."""
    boxes = Boxes(np.array([[60.0 * k, 60, 48, 21, 0.1 * k] for k in range(9)]), np.full(9, 0.9))
    source = SimpleNamespace(name="a", width=900, height=99, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    found = Detections({"a": boxes}, 1.0, Ruler(margin=(3, 3), noise=(2, 1.2)), (0.7, 0.5), "test")
    measured = measure(PlanGeometry.of(source, found), load_fleet("DE"), Method())
    assert measured.size == pytest.approx(np.tile([45.0, 18.0], (9, 1)))
    assert measured.pooled.noise * measured.size == pytest.approx(np.tile([2.0, 1.2], (9, 1)))


def test_a_lot_whose_vehicles_stand_one_way_has_the_same_scale_in_degrees():
    lot = np.full(80, 0.02)
    square, squeezed, unaware = scale_of(1.0, lot, 1.0), scale_of(0.7, lot, 0.7), scale_of(0.7, lot, 1.0)
    assert squeezed.value == pytest.approx(square.value, rel=0.01)
    assert abs(np.log(unaware.value / square.value)) > 0.03, "the case is too easy"
    widths = [np.log(s.interval90[1] / s.interval90[0]) for s in (square, squeezed)]
    assert widths[1] > 1.3 * widths[0]


def test_vehicles_at_any_angle_in_squeezed_pixels_keep_the_truth_in_the_interval():
    scale = scale_of(0.7, np.random.default_rng(5).uniform(0, np.pi, 80), 0.7)
    low, high = scale.interval90
    assert low < GSD < high


@pytest.fixture
def degrees(tmp_path):
    """An orthophoto at 60 degrees north, with pixels half as wide as high."""
    path = tmp_path / "degrees.tif"
    transform = Affine(2e-6, 0, 25.0, 0, -2e-6, 60.0)
    with rasterio.open(
        path, "w", driver="GTiff", width=300, height=200, count=3, dtype="uint8", crs="EPSG:4326", transform=transform
    ) as out:
        out.write(np.random.default_rng(0).integers(60, 200, (3, 200, 300), np.uint8))
    return path


def test_a_known_distance_in_degrees_is_as_long_as_it_is_on_the_ground(degrees):
    with RasterSource.open(degrees) as source:
        a, across, down = (source.locate(text).place for text in ("100,100", "200,100", "100,200"))
        gsd = source.claimed.gsd_m
    metres = [np.linalg.norm(b - a) * gsd for b in (across, down)]
    assert metres == pytest.approx([11.16, 22.28], rel=0.002)  # 0.0002 degrees of longitude and latitude there


def test_what_needs_square_pixels_is_left_out_or_refused_in_degrees(degrees):
    with RasterSource.open(degrees) as source:
        searched = anchors_at(source, 0.16, 0.05, Wanted(("tennis-court",)))
    assert not searched.votes and "pixels are not square" in searched.notes[0]
    with pytest.raises(UsageError, match="times as wide as high"):
        calibrate(degrees)
