"""Boxes: conventions, exact overlap against shapely, suppression."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from shapely import Polygon

from orthoscale.core import boxes as core_boxes
from orthoscale.core.angles import axis_angle
from orthoscale.core.boxes import Boxes, distinct, matched, overlap, overlapping, suppress


def boxes(*rows, score=None):
    rows = np.array(rows, float)
    return Boxes(rows, np.ones(len(rows)) if score is None else np.array(score))


def test_an_axis_is_the_same_after_half_a_turn():
    turns = np.array([0.0, 0.3, -0.3, np.pi / 2, -np.pi / 2, 3.0, -3.0, 7.0])
    found = axis_angle(turns)
    assert ((found >= -np.pi / 2) & (found < np.pi / 2)).all()
    assert np.tan(found[[1, 2, 5, 6, 7]]) == pytest.approx(np.tan(turns[[1, 2, 5, 6, 7]]))
    assert axis_angle(np.pi / 2) == -np.pi / 2 and axis_angle(np.pi - 0.1) == pytest.approx(-0.1)


def test_the_long_side_is_the_length_and_the_angle_is_its():
    b = boxes([10, 20, 4, 9, 0.2])
    assert b.length[0] == 9 and b.width[0] == 4
    assert b.angle[0] == pytest.approx(0.2 + np.pi / 2 - np.pi)


def test_corners_go_along_the_length_clockwise_on_screen():
    b = boxes([10, 20, 8, 2, 0.0])
    assert b.corners[0].tolist() == [[14, 21], [6, 21], [6, 19], [14, 19]]
    turned = boxes([0, 0, 8, 2, np.pi / 4])
    # y points down, so a positive angle turns the long side towards the lower right.
    front, right = turned.corners[0, [0, 3]].mean(0), turned.corners[0, [0, 1]].mean(0)
    assert front == pytest.approx([4 / np.sqrt(2), 4 / np.sqrt(2)])
    assert turned.along[0] == pytest.approx(front / 4) and turned.across[0] == pytest.approx(right)


def test_mapped_moves_and_scales_back_and_forth():
    b = boxes([10, 20, 8, 2, 0.3])
    there = b.mapped(0.5, (3, 4))
    assert there.xylwa[0].tolist() == pytest.approx([8, 14, 4, 1, 0.3])
    assert there.mapped(2, (-6, -8)).xylwa == pytest.approx(b.xylwa)


def test_a_box_that_pokes_out_is_not_inside():
    b = boxes([50, 50, 20, 10, 0.5], [5, 50, 20, 10, 0.0], [50, 99, 20, 10, 0.0])
    assert b.inside(100, 100).tolist() == [True, False, False]


def test_scores_and_boxes_must_match():
    with pytest.raises(ValueError, match="2 boxes but 1 scores"):
        Boxes(np.ones((2, 5)), np.ones(1))


box = st.tuples(
    st.floats(-5, 5), st.floats(-5, 5), st.floats(0.5, 12), st.floats(0.5, 6), st.floats(-np.pi / 2, np.pi / 2)
)


@settings(deadline=None)
@given(box, box)
def test_overlap_is_shapelys(a, b):
    p, q = (Boxes(np.array([r]), np.ones(1)) for r in (a, b))
    first, second = (Polygon(r.corners[0]) for r in (p, q))
    expected = first.intersection(second).area / first.union(second).area
    assert overlap(p.xylwa, q.xylwa)[0] == pytest.approx(expected, abs=1e-6)


def test_overlap_of_many_pairs_is_that_of_each():
    rng = np.random.default_rng(0)
    a, b = (rng.uniform([-3, -3, 1, 1, -1.5], [3, 3, 9, 5, 1.5], (200, 5)) for _ in range(2))
    together = overlap(a, b)
    assert together == pytest.approx([overlap(a[k : k + 1], b[k : k + 1])[0] for k in range(200)])
    assert together.max() > 0.5 and together.min() == 0


def test_suppression_keeps_the_best_and_never_merges():
    b = boxes([0, 0, 10, 4, 0], [1, 0, 10, 4, 0], [30, 0, 10, 4, 0], score=[0.6, 0.9, 0.5])
    kept = suppress(b)
    assert kept.score.tolist() == [0.9, 0.5]
    assert kept.xylwa[0].tolist() == [1, 0, 10, 4, 0]


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


def test_side_by_side_vehicles_both_stay():
    # 1.8 m wide, parked 2.4 m apart, at 45 degrees: their axis-aligned boxes overlap, they do not.
    b = boxes([0, 0, 45, 18, np.pi / 4], [17, -17, 45, 18, np.pi / 4], score=[0.9, 0.8])
    assert len(suppress(b)) == 2


def test_a_suppressed_box_suppresses_nobody():
    b = boxes([0, 0, 10, 4, 0], [4, 0, 10, 4, 0], [8, 0, 10, 4, 0], score=[0.9, 0.8, 0.7])
    assert suppress(b, iou=0.3).score.tolist() == [0.9, 0.7]


def test_matching_is_one_to_one_and_takes_the_best_pair():
    a = boxes([0, 0, 10, 4, 0], [2, 0, 10, 4, 0])
    b = boxes([2.1, 0, 10, 4, 0])
    i, j, o = matched(a, b, 0.5)
    assert (i.tolist(), j.tolist()) == ([1], [0]) and o[0] > 0.9


def test_nothing_in_nothing_out():
    assert len(suppress(Boxes.empty())) == 0
    assert len(matched(Boxes.empty(), boxes([0, 0, 1, 1, 0]), 0.5)[0]) == 0
    assert len(Boxes.concatenate([])) == 0


def test_thousands_of_copies_are_one_vehicle_and_heaps_are_refused():
    one = np.array([[50, 50, 40, 17, 0.3]])
    assert len(distinct(Boxes(np.repeat(one, 24_000, axis=0), np.linspace(0, 1, 24_000)))) == 1
    heap = one + np.random.default_rng(0).normal(0, 2, (5000, 5)) * [1, 1, 0.2, 0.1, 0.01]
    with pytest.raises(ValueError, match="overlap almost entirely"):
        distinct(Boxes(heap, np.ones(5000)))


def test_neighbours_in_a_full_car_park_are_no_copies():
    """Bays of 5.0 x 2.5 m, vehicles of 4.4 x 1.8 m: none is lost, and a roof among them harms none."""
    x, y = np.meshgrid(np.arange(100) * 2.5, np.arange(60) * 5.0)
    rows = np.column_stack([x.ravel(), y.ravel(), np.full(6000, 4.4), np.full(6000, 1.8), np.full(6000, np.pi / 2)])
    boxes = Boxes(np.vstack([rows, [[50, 50, 90, 40, 0]]]), np.random.default_rng(0).uniform(0, 1, 6001))
    assert distinct(boxes) is boxes


@given(st.floats(0, 1.2), st.floats(0.4, 2.5), st.floats(-0.5, 0.5))
def test_what_overlaps_by_half_is_found_among_any_sizes(shift, size, turn):
    pair = Boxes(np.array([[100, 100, 40, 17, 0], [100 + 40 * shift, 100, 40 * size, 17 * size, turn]]), [0.9, 0.8])
    same = overlap(pair.xylwa[:1], pair.xylwa[1:])[0] >= 0.5
    assert len(distinct(pair)) == (1 if same else 2)


def test_a_fault_names_the_box():
    good, bad = [30, 20, 40, 17, 0], [30, 20, 401, 17, 0]
    assert Boxes(np.array([good]), [1]).fault(320, 240) is None and Boxes.empty().fault(1, 1) is None
    assert Boxes(np.array([good, bad]), [1, 1]).fault() is None
    assert Boxes(np.array([good, bad]), [1, 1]).fault(320, 240)[0] == 1
    assert Boxes(np.array([good]), [1], [[-0.1, 0.1]]).fault() == (0, "has a sigma that is not a fraction")


def crowd(n, side, seed):
    rng = np.random.default_rng(seed)
    size = rng.uniform([15, 6], [60, 25], (n, 2))
    return Boxes(np.column_stack([rng.uniform(0, side, (n, 2)), size, rng.uniform(-1.5, 1.5, n)]), rng.uniform(0, 1, n))


@pytest.mark.parametrize("iou", [0.15, 0.3, 0.5])
def test_the_pairs_that_overlap_are_those_of_all_pairs(iou):
    a, b = crowd(150, 150, 0), crowd(200, 150, 1)
    i, j = (k.ravel() for k in np.indices((150, 200)))
    every = overlap(a.xylwa[i], b.xylwa[j])
    found = overlapping(a, b, iou)
    assert list(zip(*found[:2], strict=True)) == list(zip(i[every >= iou], j[every >= iou], strict=True))
    assert found[2] == pytest.approx(every[every >= iou])


def test_few_of_the_pairs_in_a_crowd_are_clipped(monkeypatch):
    """Clipping is what costs: a hundred thousand boxes take seconds."""
    clipped = []
    monkeypatch.setattr(core_boxes, "_overlap", lambda a, b: clipped.append(len(a)) or np.zeros(len(a)))
    many = crowd(3000, 800, 0)
    neighbours = sum(len(row) for row in cKDTree(many.centre).query_ball_point(many.centre, 50)) / 2
    distinct(many)
    assert 0 < sum(clipped) < 0.1 * neighbours


def test_many_boxes_on_one_another_leave_one():
    """Their pairs are never all in memory; one giant among them makes no neighbours of the others."""
    many = Boxes(np.tile([500.0, 500.0, 40.0, 18.0, 0.3], (20_000, 1)), np.linspace(0.5, 0.9, 20_000))
    giant = Boxes([[500.0, 500.0, 44_000.0, 20_000.0, 0.0]], [0.7])
    left = suppress(Boxes.concatenate([many, giant]))
    assert left.score == pytest.approx([0.9, 0.7])


@pytest.mark.parametrize("shape", [(5, 4), (3, 4), (5,), (2, 5, 1)])
def test_boxes_have_five_columns(shape):
    """(5, 4) has as many numbers as four boxes."""
    with pytest.raises(ValueError, match="boxes of shape"):
        Boxes(np.ones(shape), np.ones(4))
