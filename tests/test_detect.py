"""Tiles, decoding and zoom search, with a detector that finds drawn rectangles: known truth, no network."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from support.drawings import CARD, Drawing, RectangleDetector, car_park, rendered_vehicles

from orthoscale.actions.boxes import detector_of
from orthoscale.core.boxes import Boxes, matched
from orthoscale.detect.decoders import LENGTH_UNIT, MAP_STRIDE, WIDTH_UNIT, decode_maps
from orthoscale.detect.detector import Detector, Passes
from orthoscale.detect.tiles import TILE_SIZE, check_number, look_twice, one_pass, place, read, tiles
from orthoscale.detect.zoom import search_zoom
from orthoscale.errors import InputError
from orthoscale.requests import EstimateRequest
from orthoscale.system import budget


@pytest.mark.parametrize(
    "size, zoom", [((3000, 2100), 1.0), ((2100, 3000), 1.0), ((3000, 2100), 0.37), ((500, 300), 2.0), ((90, 40), 1.0)]
)
def test_tiles_cover_everything_and_overlap_enough(size, zoom):
    picture = Drawing(*size, Boxes.empty())
    cover = np.zeros((size[1], size[0]), int)
    for tile in tiles(picture, zoom):
        cover[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] += 1
        assert max(tile.out_width, tile.out_height) <= 1024
        assert tile.x + tile.width <= size[0] and tile.y + tile.height <= size[1]
    assert cover.min() >= 1
    # Any box of 120 network pixels lies whole in some tile.
    reach = int(120 / zoom)
    columns = sorted({(t.x, t.x + t.width) for t in tiles(picture, zoom)})
    rows = sorted({(t.y, t.y + t.height) for t in tiles(picture, zoom)})
    for spans in (columns, rows):
        for (_, end), (start, _) in zip(spans, spans[1:], strict=False):
            assert end - start >= reach


def test_the_tiles_of_all_pictures_together_fit_the_memory_budget(monkeypatch):
    """Frames of which each has few tiles may have too many together."""
    frames = [SimpleNamespace(name=f"{k}.jpg", width=3000, height=2100) for k in range(20)]
    each = len(tiles(frames[0], 1.0))
    monkeypatch.setattr(budget, "_budget", 19 * each * TILE_SIZE)
    check_number(frames[:19], 1.0)
    check_number([], 1.0)
    with pytest.raises(
        InputError, match=r"^a set of 20 pictures, the largest of which is 0\.jpg, 3000 x 2100 px, at zoom 1 needs"
    ):
        check_number(frames, 1.0)
    with pytest.raises(InputError, match=r"^0\.jpg, 3000 x 2100 px, at zoom 1 needs"):
        check_number(frames[:1], 1.0, lists=20)


def test_a_pass_finds_every_vehicle_once_where_it_is():
    truth = car_park(40, 2600, 1800, 60)
    (found,) = one_pass([Drawing(2600, 1800, truth)], 1.0, RectangleDetector()).values()
    i, j, overlaps = matched(truth, found, 0.5)
    assert len(found) == len(truth) == len(i)
    assert overlaps.min() > 0.85
    assert np.abs(found.centre[j] - truth.centre[i]).max() < 0.6


def test_vehicles_that_the_edge_cuts_are_dropped():
    truth = Boxes([[300, 200, 40, 17, 0], [600, 200, 40, 17, 0], [2, 300, 40, 17, 0]], np.ones(3))
    (found,) = one_pass([Drawing(600, 400, truth)], 1.0, RectangleDetector()).values()
    assert found.centre.tolist() == [pytest.approx([300, 200], abs=0.6)]


def test_boxes_keep_their_size_at_another_zoom():
    truth = car_park(150, 2400, 1800, 30)
    (found,) = one_pass([Drawing(2400, 1800, truth)], 0.25, RectangleDetector()).values()
    i, j, _ = matched(truth, found, 0.5)
    assert len(i) == len(truth)
    assert np.median(np.log(found.length[j] / truth.length[i])) == pytest.approx(0, abs=0.04)


def test_several_pictures_and_progress_that_ends_at_the_total():
    pictures = [Drawing(500, 400, car_park(40, 500, 400, 5, seed), f"{seed}.jpg") for seed in range(3)]
    steps = []
    found = one_pass(pictures, 1.0, RectangleDetector(), lambda done, total: steps.append((done, total)))
    assert {name: len(boxes) for name, boxes in found.items()} == {"0.jpg": 5, "1.jpg": 5, "2.jpg": 5}
    assert steps == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize("length", [9, 14, 25, 47, 90, 170, 330])
def test_the_zoom_search_finds_vehicles_of_any_size_among_mistakes(length):
    side = int(np.clip(30 * length, 700, 4000))
    picture = Drawing(side, side, car_park(length, side, side, 35))
    choice = search_zoom([picture], RectangleDetector(mistakes=2), CARD)
    assert choice.vehicle_px == pytest.approx(length, rel=0.2)
    assert choice.zoom == pytest.approx(min(38 / choice.vehicle_px, 4.0))
    assert choice.rival < 0.6


def test_no_vehicles_no_zoom():
    choice = search_zoom([Drawing(900, 700, Boxes.empty())], RectangleDetector(), CARD)
    assert choice.vehicle_px is None and choice.votes == 0


def test_mistakes_alone_make_no_zoom():
    choice = search_zoom([Drawing(900, 700, Boxes.empty())], RectangleDetector(mistakes=1), CARD)
    assert choice.vehicle_px is None


def test_the_zoom_search_is_the_same_twice():
    pictures = [Drawing(800, 600, car_park(30, 800, 600, 8, seed), str(seed)) for seed in range(6)]
    first, second = (search_zoom(pictures, RectangleDetector(1), CARD) for _ in range(2))
    assert first == second


def test_decoding_gives_back_what_was_written():
    boxes = Boxes([[41.3, 22.6, 40, 16, 0.7], [90.2, 70.1, 25, 11, -1.2]], [0.9, 0.6])
    maps = np.full((7, 32, 32), -6, np.float32)
    for (cx, cy, length, width, angle), score in zip(boxes.xylwa, boxes.score, strict=True):
        x, y = int(cx / MAP_STRIDE), int(cy / MAP_STRIDE)
        offset = (cx / MAP_STRIDE - 0.5 - x, cy / MAP_STRIDE - 0.5 - y)
        values = (np.log(length / LENGTH_UNIT), np.log(width / WIDTH_UNIT), np.cos(2 * angle), np.sin(2 * angle))
        maps[:, y, x] = (np.log(score / (1 - score)), *offset, *values)
    found = decode_maps(maps, 0.3)
    order = np.argsort(-found.score)
    assert found.xylwa[order] == pytest.approx(boxes.xylwa, abs=1e-4)
    assert found.score[order] == pytest.approx(boxes.score, abs=1e-5)
    assert len(decode_maps(maps, 0.7)) == 1


@pytest.fixture
def tiny(tmp_path):
    """An ONNX network with known output: the heat is the mean of the image, 30 minus it where there is none."""
    onnx = pytest.importorskip("onnx")
    from onnx import TensorProto, helper

    pool = helper.make_node("AveragePool", ["image"], ["mean"], kernel_shape=[4, 4], strides=[4, 4])
    weight = np.zeros((7, 3, 1, 1), np.float32)
    weight[0] = 20.0  # heat
    bias = np.array([-30, 0, 0, 0, 0, 1, 0], np.float32)
    conv = helper.make_node("Conv", ["mean", "weight", "bias"], ["maps"])
    graph = helper.make_graph(
        [pool, conv],
        "tiny",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", 3, "h", "w"])],
        [helper.make_tensor_value_info("maps", TensorProto.FLOAT, ["n", 7, "h4", "w4"])],
        [onnx.numpy_helper.from_array(weight, "weight"), onnx.numpy_helper.from_array(bias, "bias")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    card = {"name": "tiny", "usable_length": [12, 70], "best_length": 38, "score": 0.5, "effective_height": [0.8, 0.8],
            "ruler": {"margin": [0, 0], "margin_sd": [1, 1], "bias_sd": [0.01, 0.01], "noise": [1, 1]}}  # fmt: skip
    entry = model.metadata_props.add()
    entry.key, entry.value = "orthoscale", json.dumps(card)
    path = tmp_path / "tiny.onnx"
    onnx.save(model, path)
    return path


def test_a_detector_from_a_file_pads_normalises_and_decodes(tiny):
    image = np.zeros((50, 70, 3), np.uint8)
    image[20:24, 40:44] = 255  # exactly one cell; its heat is 20 * 3 - 30
    found = Detector(tiny)(image)
    assert found.xylwa == pytest.approx(np.array([[42, 22, 32, 14, 0]]), abs=1e-4)
    assert found.score[0] > 0.99


def test_a_file_that_is_no_detector_is_refused_in_words(tmp_path, tiny):
    onnx = pytest.importorskip("onnx")
    text = tmp_path / "text.onnx"
    text.write_text("hello")
    with pytest.raises(InputError, match="not an ONNX network"):
        Detector(text)
    with pytest.raises(InputError, match="cannot be read"):
        Detector(tmp_path / "missing.onnx")
    model = onnx.load(tiny)
    del model.metadata_props[:]
    onnx.save(model, tmp_path / "bare.onnx")
    with pytest.raises(InputError, match="without an orthoscale card"):
        Detector(tmp_path / "bare.onnx")


def test_the_shipped_detector_is_small_and_says_what_it_is():
    detector = Detector()
    weights = Path(__import__("orthoscale").__file__).parent / "detect" / "weights" / "small_vehicle.onnx"
    assert weights.stat().st_size <= 8_000_000
    card = detector.card
    assert card.usable_length[0] <= 12 and card.usable_length[1] >= 70
    assert card.training and card.licence


@pytest.mark.parametrize("plan, options, passes", [
    (True, {}, Passes.CONFIRMED), (True, {"fast": True}, Passes.FINE_FIRST),
    (True, {"measurer": "none"}, Passes.TWICE_CONFIRMED), (True, {"calibration": "ruler.json"}, Passes.TWICE_CONFIRMED),
    (False, {}, Passes.COARSE_FIRST), (False, {"measurer": "none"}, Passes.COARSE_FIRST),
])  # fmt: skip
def test_who_looks_at_what_is_told_by_the_input_and_the_request(plan, options, passes):
    asked = SimpleNamespace(source=SimpleNamespace(plan=object() if plan else None), calibration=None)
    detector = detector_of(asked, EstimateRequest(**options))
    assert detector.passes == passes
    assert (detector.confirming is not None) == (passes in (Passes.CONFIRMED, Passes.TWICE_CONFIRMED))


def test_the_finder_takes_the_second_look(monkeypatch):
    monkeypatch.setattr(Detector, "takes_parts", False)
    alone, both = Detector(threads=1), Detector(threads=1, passes=Passes.CONFIRMED)
    finder = both.confirming
    assert (both.sha256, both.card) == (alone.sha256, alone.card) and finder.sha256 != alone.sha256
    assert both.sure == finder.card.sure and finder.card.name in both.name
    assert Detector(*both.settings[:3], 1, both.settings[3]).confirming.sha256 == finder.sha256

    shown = np.full((500, 600, 3), 90, np.uint8)
    shown[200:282, 300:402] = rendered_vehicles()
    picture = Drawing(600, 500, Boxes.empty())
    picture.read = lambda *_: shown
    (tile,) = tiles(picture, 1.0)
    image = read(picture, tile)
    coarse = cv2.resize(image, (424, 354), interpolation=cv2.INTER_AREA)
    looks = look_twice(picture, tile, both)
    tile_of_coarse = replace(tile, out_width=424, out_height=354)
    assert len(looks.fine) and looks.fine.xylwa == pytest.approx(place(alone(image), tile).xylwa)
    assert looks.coarse.xylwa == pytest.approx(place(finder(coarse), tile_of_coarse).xylwa)
