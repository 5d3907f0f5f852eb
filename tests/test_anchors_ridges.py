"""Bright lines: their direction, place and strength, whatever surrounds them."""

import numpy as np
import pytest

from orthoscale.anchors.peaks import circle_centres, peak_shift
from orthoscale.anchors.ridges import CLEAR_RIDGE, DIRECTIONS, lightness, segments, steered


def line_picture(angle, width=1.0, contrast=40.0, noise=1.0):
    """Grey levels (161, 161) float32 with a line through the middle."""
    y, x = np.mgrid[-80:81, -80:81]
    off = np.abs(y * np.cos(angle) - x * np.sin(angle))
    line = contrast * np.clip((width + 1) / 2 - off, 0, 1)
    return (90 + line + np.random.default_rng(0).normal(0, noise, line.shape)).astype(np.float32)


@pytest.mark.parametrize("degrees", [0, 17, 45, 90, 101, 135, 170])
def test_a_line_is_a_ridge_of_its_own_direction(degrees):
    maps = steered(line_picture(np.radians(degrees)))
    own = round(degrees * DIRECTIONS / 180) % DIRECTIONS
    middle = maps[:, 80, 80].astype(int)
    assert middle[own] == middle.max() >= 0.9 * CLEAR_RIDGE
    assert middle[(own + DIRECTIONS // 2) % DIRECTIONS] < 0.3 * CLEAR_RIDGE


@pytest.mark.parametrize("degrees", [0, 17, 45, 62, 90, 101, 135, 170])
def test_the_pieces_of_a_line_lie_on_it(degrees):
    angle = np.radians(degrees)
    found = segments(steered(line_picture(angle)), 0.8)
    assert len(found.angle) >= 3
    turn = (found.angle - angle + np.pi / 2) % np.pi - np.pi / 2
    off = (found.middle[:, 1] - 80) * np.cos(angle) - (found.middle[:, 0] - 80) * np.sin(angle)
    assert np.abs(turn).max() < np.radians(4) and np.abs(off).max() < 1.5


def test_a_dark_line_is_none():
    assert steered(180 - line_picture(0.3))[:, 80, 80].max() < 0


def test_a_bright_neighbour_does_not_hide_a_line():
    """The strength is relative to what is near, up to a limit."""
    picture = line_picture(0.0)
    picture[:30] += 120
    assert steered(picture)[0, 80, 40:120].mean() > 0.8 * CLEAR_RIDGE


def test_paint_on_colour_counts_as_much_as_on_grey():
    """White on orange is nearly as light as its ground in the mean of the channels, not in the least."""
    orange = np.full((40, 40, 3), (230, 150, 60), np.uint8)
    orange[20] = 235
    light = lightness(orange)
    assert light[20, 20] - light[10, 20] > 100


def test_a_peak_is_the_top_of_its_parabola_and_near_the_middle_sample():
    top = np.array([-0.4, 0.0, 0.3])
    left, middle, right = (5.0 - (step - top) ** 2 for step in (-1, 0, 1))
    assert peak_shift(left, middle, right) == pytest.approx(top)
    flat, steep = peak_shift(*np.array([[1.0, 0.0], [1.0, 9.0], [1.0, 17.9]]))
    assert (flat, steep) == (0.0, 1.0), "no top, and one that is far off"


def test_the_edge_of_a_circle_votes_for_its_middle():
    turn = np.arange(90) * 2 * np.pi / 90
    normal = np.cos(turn), np.sin(turn)
    place = 40 + 15 * normal[0], 30 + 15 * normal[1]
    found, share = circle_centres(place, normal, 15.0, (61, 80), 3, 0.5), 90 / (2 * np.pi * 15)
    assert found.mean(0) == pytest.approx([40, 31, 15, share]), "its cell, 3 px wide, and those around"
    edge = circle_centres((place[0] - 40, place[1]), normal, 15.0, (61, 80), 3, 0.5)
    assert edge[:, 3] == pytest.approx(share), "none votes twice at the picture's edge"
