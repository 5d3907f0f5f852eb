"""Suppression against shapely, and vehicles at edges: seen whole, or not counted."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from shapely import Polygon

from orthoscale.core.boxes import Boxes, matched, suppress
from orthoscale.detect.detector import CUT, Detector
from orthoscale.detect.tiles import look, one_pass, tiles

TOWN = Path(__file__).parent.parent / "examples" / "town" / "ortho.jpg"


def suppressed_by_shapely(boxes, iou):
    """The plain rule: the best box stays, whatever overlaps it goes, and so on."""
    order = list(np.argsort(-boxes.score, kind="stable"))
    polygons = [Polygon(c) for c in boxes.corners]
    kept = []
    while order:
        best = order.pop(0)
        kept.append(best)

        def apart(k, best=best):
            shared = polygons[best].intersection(polygons[k]).area
            return shared / (polygons[best].area + polygons[k].area - shared) < iou

        order = [k for k in order if apart(k)]
    return boxes[np.array(kept, int)]


@pytest.mark.parametrize("iou", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("seed", range(5))
def test_suppression_is_that_of_exact_overlaps(seed, iou):
    """Crowds of boxes of all shapes: beside, across, inside one another, equal."""
    rng = np.random.default_rng(seed)
    n = 120
    xylwa = np.column_stack([rng.uniform(0, 200, (n, 2)), rng.uniform(4, 60, (n, 2)), rng.uniform(-2, 2, n)])
    xylwa[:20] = xylwa[20:40]  # equal
    xylwa[40:60, :2] = xylwa[60:80, :2]  # concentric
    boxes = Boxes(xylwa, rng.permutation(n) / n)
    got, expected = suppress(boxes, iou), suppressed_by_shapely(boxes, iou)
    assert got.score.tolist() == expected.score.tolist()
    given = {tuple(row) for row in boxes.xylwa.tolist()}
    assert all(tuple(row) in given for row in got.xylwa.tolist()), "never merged"


@pytest.fixture(scope="module")
def town():
    """The example town at 38 px per vehicle, RGB."""
    image = cv2.cvtColor(cv2.imread(str(TOWN)), cv2.COLOR_BGR2RGB)
    return cv2.resize(image, None, fx=0.74, fy=0.74, interpolation=cv2.INTER_AREA)[:1024, :1024]


@pytest.fixture(scope="module")
def detector():
    return Detector()


def test_boxes_that_keep_from_the_edge_are_whole(town, detector):
    """What the shipped detector sees of vehicles that an edge cuts touches the edge, and is dropped."""
    whole = suppress(detector(town))
    rng = np.random.default_rng(0)
    side, cut, kept_shares = 300, 0, []
    for _ in range(20):
        x, y = (int(rng.integers(0, town.shape[axis] - side)) for axis in (1, 0))
        found = suppress(detector(np.ascontiguousarray(town[y : y + side, x : x + side])))
        i, j, _ = matched(whole.mapped(1.0, (-x, -y)), found, 0.15)
        kept = found.inside(side, side, CUT)[j]
        cut += int((~whole.mapped(1.0, (-x, -y)).inside(side, side)[i]).sum())
        kept_shares.append(found.length[j][kept] / whole.length[i][kept])
    shares = np.concatenate(kept_shares)
    assert cut > 15 and len(shares) > 50, "enough to tell"
    assert np.median(shares) == pytest.approx(1, abs=0.02)
    assert np.mean(shares < 0.85) < 0.03


def test_tiles_see_what_the_whole_picture_shows(town, detector):
    """Vehicles on the seams between tiles are found once, as long as without seams."""

    class Town:
        name, height, width = "town", *town.shape[:2]

        def read(self, x, y, width, height, out_width, out_height):
            return np.ascontiguousarray(town[y : y + height, x : x + width])

    whole = suppress(detector(town))
    whole = whole[whole.inside(Town.width, Town.height, CUT)]
    seams = tiles(Town(), 1.0, tile=400, overlap=128)
    assert len(seams) >= 9
    seen = suppress(Boxes.concatenate([look(Town(), tile, detector) for tile in seams]))
    i, j, _ = matched(whole, seen, 0.5)
    assert len(i) >= 0.95 * len(whole) and len(seen) <= 1.05 * len(whole)
    assert np.percentile(np.abs(np.log(seen.length[j] / whole.length[i])), 90) < 0.05
    (swept,) = one_pass([Town()], 1.0, detector).values()
    assert len(swept) == pytest.approx(len(whole), abs=2)
