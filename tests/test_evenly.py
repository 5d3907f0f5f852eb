"""Some of many things, evenly spread."""

from __future__ import annotations

import numpy as np
import pytest

from orthoscale.core.evenly import evenly


@pytest.mark.parametrize("count", [0, 1, 2, 29, 30, 31, 100, 12_345])
def test_they_go_from_the_first_to_the_last_in_equal_steps(count):
    some = evenly(count, 30)
    assert len(some) == min(count, 30)
    if count > 1:
        assert (some[0], some[-1]) == (0, count - 1)
        assert np.ptp(np.diff(some)) <= 1


def test_few_are_all():
    assert evenly(7, 30).tolist() == list(range(7))
