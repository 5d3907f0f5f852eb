"""Parts of an orthophoto with another pixel size are told, and its scale is not good."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNKNOWN_HEIGHT, Detections
from orthoscale.core.measuring.ways import measure_source
from orthoscale.core.remarks import CAUTION, REFUSAL
from orthoscale.core.ruler import Ruler
from orthoscale.core.verdicts import UNUSABLE
from orthoscale.fleets import load_fleet

SIDE, GSD = 4000, 0.1


def measured(factor, longer=1.0, apart=True, many=9):
    """60 cars in the left half and `many` at the right, which appear `factor` times as large, and `longer` for their
    width; not `apart`: all over the picture."""
    rng = np.random.default_rng(1)
    size = np.exp(rng.multivariate_normal(np.log([4.4, 1.8]), [[0.006, 0.002], [0.002, 0.002]], 60 + many)) / GSD
    size[60:] *= factor * np.array([longer, 1.0])
    place = np.stack(np.meshgrid(np.arange(100, SIDE, 200), np.arange(100, SIDE, 200)), -1).reshape(-1, 2)
    left = rng.permutation(place[place[:, 0] < (SIDE / 2 if apart else SIDE)])
    right = rng.permutation(place[place[:, 0] > 0.6 * SIDE])
    place = np.concatenate([left[:60], right[:many] if apart else left[60 : 60 + many]])
    boxes = Boxes(np.column_stack([place, size, np.zeros(len(size))]), np.ones(len(size)))
    plan = SimpleNamespace(name="plan", width=SIDE, height=SIDE, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    found = Detections({"plan": boxes}, 1.0, Ruler(), UNKNOWN_HEIGHT, "a file")
    scale = measure_source(plan, found, load_fleet("DE")).scale
    return scale, [remark for remark in scale.remarks if "different pixel sizes" in remark.text]


@pytest.mark.parametrize("factor", [0.5, 1.6, 2.0])
def test_a_part_where_cars_have_another_size_is_told(factor):
    """Two halves of a mosaic, one enlarged: the scale of the other was good, to 2 %, and nothing else was said."""
    scale, (remark,) = measured(factor)
    told = re.match(r"9 vehicles of a car's shape, ([\d.]+) times as large as the others", remark.text)[1]
    assert float(told) == pytest.approx(factor, rel=0.1)
    assert scale.verdict in ("poor", UNUSABLE) and scale.parts["drift"] > 0.1
    assert remark.severity == (REFUSAL if scale.verdict == UNUSABLE else CAUTION)


@pytest.mark.parametrize(
    "other", [{"longer": 1.4}, {"apart": False}, {"many": 4}], ids=["lorries", "among them", "few"]
)
def test_vehicles_of_another_kind_are_no_such_part(other):
    scale, said = measured(2.0, **other)
    assert sum(scale.rejected.values()) >= 4 and not said
