"""Vehicles at edges: seen whole, or not counted."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from orthoscale.core.boxes import Boxes, matched, suppress
from orthoscale.detect.detector import CUT, Detector
from orthoscale.detect.tiles import look, one_pass, tiles

TOWN = Path(__file__).parent.parent / "examples" / "town" / "ortho.jpg"


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
