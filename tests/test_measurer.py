"""The measurer's geometry is exact: crops, the windows that it learns from, and the way back into the picture."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.detect.measurer import (
    ANSWERS,
    CROP_HEIGHT,
    CROP_WIDTH,
    MOVED_AT_MOST,
    Measured,
    Measurer,
    MeasurerCard,
    crop,
    moved_out,
    pixels_per_crop_pixel,
    placed,
)
from training.measurer import chain, crops, real

DARK = 60  # ground of drawn pictures; filters undershoot, and must not be cut off at black
CARD = Path(__file__).parents[1] / "training/measurer/card_m21.json"
FINE = 8  # samples per pixel that drawn pictures are averaged from


class Pixels:
    """An array as a `Picture`."""

    name = "pixels"

    def __init__(self, pixels: np.ndarray) -> None:
        self.pixels, self.height, self.width = pixels, *pixels.shape[:2]

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        assert (width, height) == (out_width, out_height)
        return self.pixels[y : y + height, x : x + width]


def drawn(box: np.ndarray, width: int, height: int) -> np.ndarray:
    """A light box (5,) on DARK, (H, W, 3) uint8; each pixel has the share that the box covers."""
    y, x = ((np.arange(n * FINE, dtype=np.float32) + 0.5) / FINE for n in (height, width))
    y = y[:, None]
    cos, sin = np.cos(box[4]), np.sin(box[4])
    u, v = cos * (x - box[0]) + sin * (y - box[1]), cos * (y - box[1]) - sin * (x - box[0])
    inside = ((np.abs(u) < box[2] / 2) & (np.abs(v) < box[3] / 2)).astype(np.float32)
    share = cv2.resize(inside, (width, height), interpolation=cv2.INTER_AREA)
    return np.repeat((DARK + share * 120 + 0.5).astype(np.uint8)[..., None], 3, 2)


def extents(pixels: np.ndarray) -> np.ndarray:
    """-x, +x, -y, +y of a light box on DARK from the middle of the pixels: its light along each axis, in all as much
    as that of an evenly lit stretch, about the light's centre."""
    light = pixels[..., 0].astype(float) - DARK
    found = []
    for axis in (0, 1):
        middle = light.shape[axis] // 2
        profile = np.take(light, range(middle - 3, middle + 3), axis).mean(axis)
        at = np.arange(len(profile)) + 0.5 - len(profile) / 2
        centre, length = (profile * at).sum() / profile.sum(), profile.sum() / np.median(profile[np.abs(at) < 5])
        found += [centre - length / 2, centre + length / 2]
    return np.array(found)


@pytest.mark.parametrize("length", [11.0, 30.0, 57.0, 130.0])
@pytest.mark.parametrize("angle", [0.0, 0.6, 2.1, -1.57])
def test_a_crop_shows_the_box_where_the_box_is(length: float, angle: float) -> None:
    box = np.array([151.3, 148.8, length, 0.45 * length, angle])
    step = pixels_per_crop_pixel(box)
    shown = extents(crop(drawn(box, 300, 300), box))
    expected = np.array([-length, length, -0.45 * length, 0.45 * length]) / 2 / step
    assert shown == pytest.approx(expected, abs=0.12 / step)  # what is drawn is good to a sixteenth of a pixel


def test_edges_lead_back_to_the_box_that_they_are_the_edges_of() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        box = np.array([*rng.uniform(0, 100, 2), rng.uniform(10, 90), rng.uniform(5, 40), rng.uniform(-3, 3)])
        proposed = crops.proposal(box, rng)
        back = placed(proposed, *crops.edges_in_crop(box, proposed))
        assert back[:4] == pytest.approx(box[:4])
        assert np.sin(back[4] - box[4]) == pytest.approx(0, abs=1e-9)


BOX = np.array([230.4, 220.7, 120.0, 54.0, 0.4])


@pytest.fixture(scope="module")
def pyramid() -> object:
    return chain.pyramid(drawn(BOX, 461, 455))


@pytest.mark.parametrize("scale", [0.09, 0.23, 0.5, 0.8, 1.3])
@pytest.mark.parametrize("fine", [1, 2])
def test_a_window_has_its_vehicle_where_its_box_says(pyramid: object, scale: float, fine: int) -> None:
    rng = np.random.default_rng(1)
    box = BOX
    for _ in range(3):
        pixels, there = chain.window(pyramid, box, scale, rng, fine)
        if fine == 2:
            pixels = cv2.resize(pixels, (pixels.shape[1] // 2, pixels.shape[0] // 2), interpolation=cv2.INTER_AREA)
        longer = np.log(there[2] / there[3]) - np.log(box[2] / box[3])  # the shape is changed, the area is not
        assert 0 < abs(longer) <= 2 * chain.SHAPES_SD
        assert there[2:4].prod() == pytest.approx(scale**2 * box[2:4].prod())
        step = pixels_per_crop_pixel(there)
        shown = extents(crop(pixels, there)) * step
        half = there[[2, 2, 3, 3]] / 2 * [-1, 1, -1, 1]
        assert shown == pytest.approx(half, abs=0.1)


def test_resampling_moves_the_box_with_the_picture() -> None:
    rng = np.random.default_rng(2)
    box = np.array([60.2, 58.9, 40.0, 18.0, 0.9])
    picture = drawn(box, 120, 120).astype(np.float32) / 255
    for factor in (0.55, 0.8, 1.3, 1.9):
        for _ in range(4):
            after, true = chain.resample(picture, factor, rng)
            there = box * [true, true, true, true, 1]
            shown = extents(crop((after * 255).clip(0, 255).astype(np.uint8), there)) * pixels_per_crop_pixel(there)
            assert shown == pytest.approx(there[[2, 2, 3, 3]] / 2 * [-1, 1, -1, 1], abs=0.2)


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Measurer:
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from training.measurer.network import MeasureNet

    torch.manual_seed(0)
    net = MeasureNet()
    with torch.no_grad():  # an untrained network answers the same to everything
        for parameter in net.parameters():
            parameter.mul_(1.5)
    net(torch.rand(16, 3, CROP_HEIGHT, CROP_WIDTH) * 255)
    from training.export import with_card
    from training.measurer.export import write

    path = tmp_path_factory.mktemp("measurer") / "m.onnx"
    with_card(write(net, path), json.loads(CARD.read_text()), path)
    return Measurer(path)


@pytest.mark.slow
def test_mirrors_and_quarter_turns_of_a_picture_give_the_same_vehicle(untrained: Measurer) -> None:
    rng = np.random.default_rng(3)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (160, 200, 3)).astype(np.uint8), (0, 0), 2.0)
    box = np.array([90.0, 70.5, 48.0, 21.0, 0.0])  # along the axis, so that its turns need no other interpolation
    one = untrained.in_pixels(picture, Boxes(box[None], np.ones(1)), looks=1)
    x, y, length, width, angle = box
    turned = {
        "mirror": (picture[:, ::-1], [200 - x, y, length, width, np.pi - angle]),
        "half turn": (picture[::-1, ::-1], [200 - x, 160 - y, length, width, angle + np.pi]),
        "quarter turn": (np.rot90(picture), [y, 200 - x, length, width, angle - np.pi / 2]),
    }
    for name, (pixels, there) in turned.items():
        other = untrained.in_pixels(np.ascontiguousarray(pixels), Boxes(np.array([there]), np.ones(1)), looks=1)
        assert other.boxes.xylwa[0, 2:4] == pytest.approx(one.boxes.xylwa[0, 2:4], abs=0.02), name
        assert sorted(other.sigma[0]) == pytest.approx(sorted(one.sigma[0]), rel=0.02), name


@pytest.mark.slow
def test_contrast_and_brightness_do_not_move_edges(untrained: Measurer) -> None:
    rng = np.random.default_rng(4)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (160, 200, 3)).astype(np.uint8), (0, 0), 2.0)
    boxes = Boxes(np.array([[90.0, 70.5, 48.0, 21.0, 0.3]]), np.ones(1))
    one, other = (untrained.in_pixels(p, boxes, looks=1) for p in (picture // 2, picture // 2 + 90))
    assert other.boxes.xylwa == pytest.approx(one.boxes.xylwa, abs=0.05)


@pytest.mark.slow
def test_nothing_proposed_nothing_measured(untrained: Measurer) -> None:
    assert len(untrained.in_pixels(np.zeros((50, 50, 3), np.uint8), Boxes.empty()).boxes) == 0


@pytest.mark.slow
def test_a_window_of_a_picture_shows_what_the_whole_picture_does(untrained: Measurer) -> None:
    rng = np.random.default_rng(5)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (260, 300, 3)).astype(np.uint8), (0, 0), 2.0)
    boxes = Boxes(np.array([[120.0, 130.5, 48.0, 21.0, 0.3], [20.0, 240.0, 44.0, 20.0, 1.2]]), np.ones(2))
    whole = untrained.in_pixels(picture, boxes)
    assert untrained(Pixels(picture), boxes).boxes.xylwa == pytest.approx(whole.boxes.xylwa, abs=0.05)


def test_the_shipped_card_is_the_one_in_the_training_folder() -> None:
    assert Measurer().card == MeasurerCard.from_json(CARD.read_text(), str(CARD))


def test_a_sure_edge_stays_and_an_unsure_one_is_moved_out_by_as_much_as_it_is_unsure() -> None:
    card = MeasurerCard.from_json(CARD.read_text(), str(CARD))
    length = np.array([20.0, 80.0])
    sure = np.hypot(card.sure[0] * length, card.sure[1])
    assert (card.outward(np.repeat(sure[:, None], 4, 1), length) == 0).all()
    sigma = sure[:, None] + np.array([-0.1, 0.0, 0.3, 100.0])
    moved = card.outward(sigma, length)
    assert moved[:, :3] == pytest.approx(np.tile([0.0, 0.0, 0.3 * card.inward], (2, 1)))
    assert moved[:, 3] == pytest.approx(MOVED_AT_MOST * length)
    older = MeasurerCard(card.name, card.ruler, card.sigma_times, card.effective_height, card.body)
    assert (older.outward(sigma, length) == 0).all()


def test_an_edge_that_is_moved_leaves_the_other_three_where_they_are() -> None:
    rng = np.random.default_rng(6)
    for edge in range(4):
        box = np.array([*rng.uniform(0, 100, 2), 40.0, 18.0, rng.uniform(-1.5, 1.5)])
        outward = np.zeros(4)
        outward[edge] = 3.0
        moved = moved_out(box[None], outward[None])[0]

        def edges(one: np.ndarray, cos: float = np.cos(box[4]), sin: float = np.sin(box[4])) -> np.ndarray:
            along, across = one[0] * cos + one[1] * sin, one[1] * cos - one[0] * sin
            return np.array([along - one[2] / 2, along + one[2] / 2, across - one[3] / 2, across + one[3] / 2])

        assert moved[4] == box[4]
        assert edges(moved) - edges(box) == pytest.approx(outward * [-1, 1, -1, 1])


def test_what_is_told_of_an_edge_stays_with_it_when_the_box_is_turned() -> None:
    """Boxes that came out wider than long, or point elsewhere, are turned along the longer side."""
    rng = np.random.default_rng(7)
    count = 40
    xylwa = np.column_stack([rng.uniform(20, 40, (count, 4)), rng.uniform(-7, 7, count)])
    edges = rng.permuted(np.tile(np.arange(1.0, 5.0), (count, 1)), axis=1)
    rows = np.column_stack([xylwa, edges, edges / 4, np.zeros((count, len(ANSWERS) + 1))])
    told = Measured.of_rows(rows, np.ones(count))

    def middles(boxes: np.ndarray) -> np.ndarray:
        along = np.stack([np.cos(boxes[:, 4]), np.sin(boxes[:, 4])], 1) * boxes[:, 2:3] / 2
        across = np.stack([-np.sin(boxes[:, 4]), np.cos(boxes[:, 4])], 1) * boxes[:, 3:4] / 2
        return boxes[:, None, :2] + np.stack([-along, along, -across, across], 1)

    for values, before in ((told.sigma, edges), (told.seen, edges / 4)):
        one, other = (np.argsort(some, axis=1)[..., None] for some in (before, values))
        same = np.take_along_axis(middles(xylwa), one, 1) - np.take_along_axis(middles(told.boxes.xylwa), other, 1)
        assert np.abs(same).max() < 1e-9
    again = Measured.of_rows(told.rows, np.ones(count))
    assert (again.rows == told.rows).all()


def test_what_is_moved_is_less_certain() -> None:
    box = np.array([90.0, 70.5, 48.0, 21.0, 0.3])
    picture = drawn(box, 200, 160).astype(float)
    shade = 1 / (1 + np.exp((np.indices((160, 200))[1] - 92) / 4))[..., None]  # one end merges with the ground
    picture = (DARK + (picture - DARK) * (0.05 + 0.95 * shade)).astype(np.uint8)
    measurer = Measurer()
    card, boxes = measurer.card, Boxes(box[None], np.ones(1))
    after = measurer.in_pixels(picture, boxes)
    measurer.card = MeasurerCard(card.name, card.ruler, card.sigma_times, card.effective_height, card.body)
    before = measurer.in_pixels(picture, boxes)
    outward = card.outward(before.sigma, before.boxes.xylwa[:, 2])
    assert outward.max() > 0, "all edges are sure: nothing is tested"
    assert after.boxes.xylwa == pytest.approx(moved_out(before.boxes.xylwa, outward))
    assert (after.sigma > before.sigma)[outward > 0].all() and (after.sigma == before.sigma)[outward == 0].all()


def test_a_kind_is_shown_from_fine_pictures_though_most_of_it_is_in_coarse_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def patch(length: int, grey: int) -> object:
        box = np.array([1.6 * length, 1.6 * length, length, 0.4 * length, 0.0])
        return real.Patch(np.full((4 * length, 4 * length, 3), grey, np.uint8), box, True, ANSWERS.index("pickup"))

    real.save(tmp_path / "kind_x.npz", [patch(15, 40)] * 99 + [patch(60, 220)])
    monkeypatch.setitem(crops.SHARES, "rendered", 0.0)
    shown = [one.pixels.mean() > 128 for one in islice(crops.Examples(tmp_path, seed=1), 900)]
    assert 0.05 < np.mean(shown) < 0.15  # one in eleven, where one of a hundred is


def test_a_bank_of_which_all_is_held_out_is_refused_at_once(tmp_path: Path) -> None:
    crops = pytest.importorskip("training.measurer.crops")
    with pytest.raises(ValueError, match="beside the 10 that are held out"):
        crops.Examples(tmp_path, seed=1)


def test_what_a_cover_hides_is_told_and_nothing_else():
    rng = np.random.default_rng(4)
    ground = np.full((64, 64, 3), 90, np.uint8)
    box = np.array([100.0, 100.0, 60.0, 26.0, 0.4])
    picture = np.full((200, 200, 3), 0.3, np.float32)
    cv2.fillPoly(picture, [np.round(Boxes(box[None], np.ones(1)).corners[0]).astype(np.int32)], (0.9, 0.2, 0.2))
    out = np.array([[-np.cos(0.4), -np.sin(0.4)], [np.cos(0.4), np.sin(0.4)]])  # of the rear, of the front
    told = []
    for _ in range(200):
        shot = chain.covered(picture, box, ground, rng)
        for edge in (0, 1):
            x, y = np.round(box[:2] + 27 * out[edge] - 0.5).astype(int)
            gone = np.abs(shot.pixels[y - 1 : y + 2, x - 1 : x + 2] - picture[y, x]).max() > 0.05
            told.append((shot.hidden[edge], gone))
        assert (shot.shown[2:4] <= box[2:4] + 1e-9).all()
        if not shot.hidden[:2].any():
            assert shot.shown[2] == pytest.approx(box[2])
        elif shot.hidden[:2].sum() == 1:  # what is in sight lies at the other end
            ahead = (shot.shown[:2] - box[:2]) @ out[1]
            assert ahead * (1 if shot.hidden[0] else -1) > 0
    hidden, gone = np.array(told).T
    assert 30 < hidden.sum() < 370
    assert gone[hidden].mean() > 0.9 and gone[~hidden].mean() < 0.25
