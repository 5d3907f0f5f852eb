"""The effective height, fitted from views of known vehicles without any metres."""

import numpy as np
import pytest

from orthoscale.projection.height import fit_height


@pytest.mark.parametrize("height", [(0.5, 0.5), (0.8, 0.4), (1.6, 0.0)])
def test_the_height_comes_back_whatever_the_vehicles_sizes(height):
    rng = np.random.default_rng(0)
    vehicle = np.repeat(np.arange(40), 8)
    true_size = rng.normal([4.5, 1.8], [0.4, 0.1], (40, 2))
    leaning = rng.uniform(0, 1, (len(vehicle), 2))
    seen = true_size[vehicle] + np.array(height) * leaning + rng.normal(0, [0.15, 0.08], (len(vehicle), 2))
    seen[::25] += 3.0  # an odd box now and then
    members = [np.flatnonzero(vehicle == k) for k in range(40)]
    fitted, sd = fit_height(seen, leaning, members)
    assert fitted == pytest.approx(height, abs=0.12)
    assert (sd < 0.1).all()


def test_single_views_say_nothing():
    members = [np.array([k]) for k in range(50)]
    _, sd = fit_height(np.ones((50, 2)), np.ones((50, 2)), members)
    assert np.isinf(sd).all()
