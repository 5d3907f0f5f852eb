"""Detections: kept in a file and read back; files of others; files that are none."""

import json

import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNKNOWN_RULER, Detections
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import Sightings, gather
from orthoscale.errors import InputError, TooLittleEvidence, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import load_detections, save_detections


@pytest.mark.parametrize("name", ["d.gpkg", "d.txt", "d.coco.json", "d"])
def test_boxes_are_not_written_as_json_under_another_formats_name(tmp_path, name):
    with pytest.raises(UsageError, match="name that ends in .json"):
        save_detections(Detections({}, 1.0, Ruler((0, 0)), (0.7, 0.5), "test"), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_what_is_saved_reads_back(tmp_path):
    boxes = {"a.jpg": Boxes([[10.25, 20.5, 40.125, 17, 0.3]], [0.75]), "b.jpg": Boxes.empty()}
    ruler = Ruler((0.5, 1.0), (0.3, 0.4), (0.01, 0.02), noise=(1.0, 0.8))
    save_detections(Detections(boxes, 0.8, ruler, (0.7, 0.5), "test", "abc"), tmp_path / "d.json")
    again = load_detections(tmp_path / "d.json")
    assert again.boxes["a.jpg"].xylwa == pytest.approx(boxes["a.jpg"].xylwa, abs=0.01)
    assert len(again) == 1 and len(again.boxes["b.jpg"]) == 0 and again.body == "car"
    assert (again.zoom, again.ruler, again.effective_height, again.detector) == (0.8, ruler, (0.7, 0.5), "test")


def test_plain_boxes_of_others_get_a_careful_ruler(tmp_path):
    row = {"cx": 5, "cy": 6, "length": 40, "width": 17, "angle": 0.1}
    path = tmp_path / "theirs.json"
    path.write_text(json.dumps({"a.jpg": [row, {**row, "kind": "large-vehicle"}], "b.jpg": []}))
    found = load_detections(path)
    assert len(found) == 1 and found.ruler == UNKNOWN_RULER and found.zoom == 1
    assert found.boxes["a.jpg"].score.tolist() == [1]


@pytest.mark.parametrize(
    "content",
    [
        "not json",
        "[1, 2]",
        '{"a.jpg": 3}',
        '{"a.jpg": [{"cx": 1}]}',
        '{"a.jpg": [{"cx": 1, "cy": 1, "length": -4, "width": 2, "angle": 0}]}',
        '{"a.jpg": [{"cx": NaN, "cy": 1, "length": 4, "width": 2, "angle": 0}]}',
        '{"pictures": {"a.jpg": []}, "zoom": "wide"}',
        '{"pictures": {}, "zoom": 1, "ruler": {"margins": [0, 0]}}',
        '{"pictures": {}, "zoom": 1, "effective_height": [1, 1], "detector_sha256": "", "body": "boat"}',
    ],
)
def test_a_file_that_is_none_is_refused_by_name(tmp_path, content):
    path = tmp_path / "bad.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"bad\.json: not a detections file"):
        load_detections(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_detections(tmp_path / "missing.json")


def test_boxes_are_normalised_on_the_way_in(tmp_path):
    path = tmp_path / "flat.json"
    path.write_text(json.dumps({"a": [{"cx": 0, "cy": 0, "length": 2, "width": 4, "angle": 0}]}))
    assert load_detections(path).boxes["a"].xylwa[0, 2:] == pytest.approx([4, 2, -np.pi / 2])


@pytest.mark.parametrize("width", [40.0, 20.0, 0.4])
def test_boxes_shaped_like_no_vehicles_are_too_little_evidence_or_a_scale_but_no_crash(width):
    """Votes of 40 x 40, 40 x 20 and 40 x 0.4 px; only the second are vehicles."""
    rows = np.array([[60 + 50.0 * (k % 10), 60 + 50.0 * (k // 10), 40, width, 0.1] for k in range(60)])
    boxes = Boxes(rows, np.ones(60))
    pixel = np.ones(60)
    votes = gather(Sightings(boxes.xylwa[:, 2:4], pixel, boxes.centre, boxes.score, boxes.sigma), False)
    for ruler in (UNKNOWN_RULER, Ruler(margin=(-30.0, -0.2)), Ruler(margin=(30.0, 0.0))):
        try:
            scale = pool(votes, load_fleet("DE"), ruler, "m/px")
            assert np.isfinite([scale.value, *scale.interval90]).all() and scale.value > 0
        except TooLittleEvidence:
            assert width != 20.0 or ruler.margin != UNKNOWN_RULER.margin
