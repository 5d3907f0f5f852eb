"""Fleets: the table, its samples, files of one's own."""

import json

import numpy as np
import pytest

from orthoscale.errors import InputError, UsageError
from orthoscale.fleet import Fleet, codes


@pytest.mark.parametrize("code", codes())
def test_every_fleet_is_plausible_and_says_where_it_comes_from(code):
    fleet = Fleet.load(code)
    assert 3.5 < fleet.mean[0] < 6 and 1.5 < fleet.mean[1] < 2.2 and 1.4 < fleet.mean[2] < 2.1
    assert (fleet.mean_sd > 0).all() and len(fleet.source) > 10
    assert sum(c.weight for c in fleet.classes) == pytest.approx(1)
    # The classes together have the mean that the fleet claims.
    assert sum(c.weight * c.mean for c in fleet.classes) == pytest.approx(fleet.mean, rel=0.01)


@pytest.mark.parametrize("code", ["US", "JP", "WORLD"])
def test_samples_have_the_fleets_moments(code):
    fleet = Fleet.load(code)
    sizes = fleet.sample(np.random.default_rng(0), 40_000)
    assert sizes.mean(0) == pytest.approx(fleet.mean, rel=0.01)
    assert sizes[:, :2].std(0) == pytest.approx(fleet.sd[:2], rel=0.12)
    assert np.log(sizes[:, :2]).mean(0) == pytest.approx(fleet.log_mean, abs=0.004)


def test_names_are_case_blind_and_unknown_ones_are_refused_with_the_list():
    assert Fleet.load("us").code == Fleet.load("US").code == "US"
    with pytest.raises(UsageError, match="Known fleets: .*WORLD"):
        Fleet.load("atlantis")


def test_a_fleet_of_ones_own(tmp_path):
    entry = {"name": "taxis", "length": [4.8, 0.1], "width": [1.8, 0.02], "height": [1.5, 0.05],
             "mean_sd": [0.01, 0.01, 0.01], "corr_LW": 0.5, "source": "the depot"}  # fmt: skip
    path = tmp_path / "taxis.json"
    path.write_text(json.dumps(entry))
    assert Fleet.load(path).mean.tolist() == [4.8, 1.8, 1.5]
    del entry["mean_sd"]
    path.write_text(json.dumps(entry))
    with pytest.raises(InputError, match="mean_sd"):
        Fleet.load(path)


def test_what_is_unknown_does_not_depend_on_how_many_are_seen():
    world, germany = Fleet.load("WORLD"), Fleet.load("DE")
    assert world.log_mean_covariance[0, 0] > 3 * germany.log_mean_covariance[0, 0]
