"""Training: targets and augmentation keep boxes on their pixels, margins and figures are what they say they are."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.detect.decoders import decode_maps
from orthoscale.detect.measurer import ANSWERS
from orthoscale.fleets import load_fleet
from orthoscale.synthetic import make_scene
from training import augment, by_hand, data, kinds, measured, missing, propose
from training.data import MARGINS, read_labels, split
from training.evaluate import (
    Comparison,
    Labelled,
    Scene,
    at_equal_recall,
    average_precision,
    checked_scenes,
    compare,
    draw,
    evaluate,
    fit_margin,
    known_boxes,
    labelled_scenes,
    measured_scenes,
    picture_files,
    place_scenes,
    reference_scene,
    rendered_scene,
    table,
)
from training.geometry import warp
from training.log import Log
from training.measurer import real
from training.measurer import rendered as measurer_rendered
from training.paste import paste
from training.targets import CROP, encode

NOTHING = np.empty((0, 5))
FINDER_FILE = Path(measured.__file__).parent / "weights" / "finder.onnx"


def rows(boxes, kind="vehicle"):
    """Boxes (N, 5) as a label file has them."""
    fields = ("cx", "cy", "length", "width", "angle")
    return [dict(zip(fields, map(float, box), strict=True)) | {"kind": kind} for box in boxes]


def write_labels(folder, scenes, size=400):
    """A label file with one picture per scene: {scene: (pixels or None for grey, rows)}."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    entries = []
    for scene, (pixels, boxes) in scenes.items():
        pixels = np.full((size, size, 3), 90, np.uint8) if pixels is None else pixels
        cv2.imwrite(str(folder / "images" / f"{scene}.png"), pixels)
        entries.append(
            {"file": f"{scene}.png", "set": scene, "width": pixels.shape[1], "height": pixels.shape[0],
             "source": "a test", "licence": "CC0", "boxes": boxes}
        )  # fmt: skip
    path = folder / "labels.json"
    path.write_text(json.dumps({"images": entries}))
    return path


def draw_boxes(boxes, size=400, paint=230, ground=60, window=None):
    """Anti-aliased filled boxes (N, 5) on even ground, with a dark windscreen where `window` gives a grey level."""
    fine = 8
    image = np.full((size * fine, size * fine), ground, np.uint8)

    def fill(xylwa, grey):
        corners = Boxes(xylwa, np.ones(len(xylwa))).corners * fine - 0.5
        for polygon in np.round(corners).astype(np.int32):
            cv2.fillConvexPoly(image, polygon, grey)

    fill(boxes, paint)
    if window is not None:
        glass = boxes.copy()
        glass[:, :2] += 0.125 * boxes[:, 2:3] * np.c_[np.cos(boxes[:, 4]), np.sin(boxes[:, 4])]
        glass[:, 2:4] *= (0.15, 0.85)
        fill(glass, window)
    small = cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA)
    return np.repeat(small[..., None], 3, 2)


def field_of_boxes(rng, length=45.0, width=19.0, pitch=100, size=400):
    """(16, 5) boxes on a grid, each turned and shifted at random."""
    y, x = np.mgrid[pitch / 2 : size : pitch, pitch / 2 : size : pitch]
    n = x.size
    centre = np.c_[x.ravel(), y.ravel()] + rng.uniform(-5, 5, (n, 2))
    return np.c_[centre, rng.normal(length, 2, n), rng.normal(width, 0.5, n), rng.uniform(-np.pi / 2, np.pi / 2, n)]


def as_maps(heat, values):
    """Targets as a perfect network's output."""
    p = np.clip(heat, 1e-6, 1 - 1e-6)
    return np.concatenate([np.log(p / (1 - p))[None], values])


# Targets


def test_targets_decode_to_the_boxes_they_were_made_of():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[40:240:60, 40:240:60]
    n = x.size
    boxes = np.c_[x.ravel() + rng.uniform(-3, 3, n), y.ravel() + rng.uniform(-3, 3, n),
                  rng.uniform(14, 50, n), rng.uniform(7, 13, n), rng.uniform(-1.5, 1.5, n)]  # fmt: skip
    heat, background, values, _ = encode(boxes, np.ones(n, bool))
    found = decode_maps(as_maps(heat, values), 0.9)
    order = [int(np.argmin(np.linalg.norm(found.centre - b[:2], axis=1))) for b in boxes]
    assert len(found) == n and background.all()
    assert found.xylwa[order] == pytest.approx(boxes, abs=2e-3)


def test_ignored_small_and_cut_boxes_are_neither_vehicle_nor_background():
    boxes = np.array([[60, 60, 40, 18, 0.3], [150, 60, 8, 4, 0.0], [2, 150, 40, 18, 0.0]], float)
    heat, background, _, weight = encode(boxes, np.array([False, True, True]))
    assert heat.max() == 0 and weight.max() == 0
    for x, y in ((60, 60), (150, 60), (2, 150)):
        assert background[y // 4, x // 4] == 0
    assert background[50, 50] == 1


def test_a_vehicle_weighs_as_the_ground_that_it_covers():
    boxes = np.array([[62, 62, 32, 14, 0.3], [150, 62, 16, 7, 0.0], [150, 182, 64, 28, 1.0]], float)
    weight = encode(boxes, np.ones(3, bool))[3]
    assert [weight[y // 4, x // 4] for x, y in ((62, 62), (150, 62), (150, 182))] == pytest.approx([1.0, 0.25, 4.0])
    assert weight.sum() == pytest.approx((1 + 0.25 + 4) * (1 + 8 * 0.3))


# Augmentation


def test_a_cropped_box_still_outlines_its_vehicle(tmp_path, monkeypatch):
    monkeypatch.setattr(augment, "photometric", lambda pixels, rng: pixels.astype(np.float32) / 255)
    box = np.array([[203.3, 190.8, 60.0, 26.0, 0.7]])
    (image,) = read_labels(write_labels(tmp_path, {"a": (draw_boxes(box, paint=255, ground=20), rows(box))}))
    rng, checked = np.random.default_rng(1), 0
    for _ in range(60):
        pixels, heat, _, values, _ = augment.crop(image, rng)
        found = decode_maps(as_maps(heat, values), 0.9)
        if len(found) != 1 or not found.inside(CROP, CROP, 2).all():
            continue
        y, x = np.nonzero(pixels[0] > 0.54)
        d = np.c_[x + 0.5, y + 0.5] - found.centre[0]
        assert np.abs(d.mean(0)).max() < 0.3
        along = np.array([np.cos(found.angle[0]), np.sin(found.angle[0])])
        # An even distribution over a length L has the variance L^2 / 12.
        assert np.sqrt(12 * (d @ along).var()) == pytest.approx(found.length[0], rel=0.03, abs=0.7)
        assert np.sqrt(12 * (d @ (-along[1], along[0])).var()) == pytest.approx(found.width[0], rel=0.03, abs=0.7)
        checked += 1
    assert checked > 20


@pytest.mark.parametrize("zoom", [0.1, 0.2, 0.4])
def test_a_shrunk_crop_of_a_picture_of_odd_size_shows_its_vehicle_where_the_box_is(tmp_path, zoom):
    pixels = np.full((1415, 1607, 3), 20, np.uint8)
    pixels[1300:1350, 1460:1560] = 255
    box = np.array([[1510.0, 1325.0, 100.0, 50.0, 0.0]])
    (image,) = read_labels(write_labels(tmp_path, {"a": (pixels, rows(box))}))
    shift = CROP / 2 - zoom * box[0, :2]
    for seed in range(4):  # of both levels that a crop may come from
        drawn = warp(image, zoom * np.eye(2), shift, zoom, np.random.default_rng(seed))[..., 0]
        light = np.clip(drawn.astype(float) - 115, 0, None)
        y, x = np.indices(light.shape) + 0.5
        middle = np.array([(light * x).sum(), (light * y).sum()]) / light.sum()
        assert middle == pytest.approx([CROP / 2, CROP / 2], abs=0.3)


def test_light_and_sensor_keep_shape_and_range():
    rng = np.random.default_rng(2)
    pixels = rng.integers(0, 256, (CROP, CROP, 3)).astype(np.uint8)
    for _ in range(25):
        out = augment.photometric(pixels, rng)
        assert out.shape == pixels.shape and out.dtype == np.uint8


def test_a_stretch_makes_some_shadows_black_and_some_light_things_white():
    ramp = np.tile(np.linspace(0.3, 0.6, CROP, dtype=np.float32)[:, None, None], (1, CROP, 3))
    stretched = augment.stretch(ramp, np.random.default_rng(4))
    assert stretched.min() < 0 and stretched.max() > 1
    assert ((stretched > 0) & (stretched < 1)).mean() > 0.8


def test_sharpened_edges_have_halos_and_soft_ones_are_wide(monkeypatch):
    step = np.full((CROP, CROP, 3), 0.3, np.float32)
    step[:, CROP // 2 :] = 0.7

    def across(enlarged, sharpened):
        monkeypatch.setattr(augment, "ENLARGED", enlarged)
        monkeypatch.setattr(augment, "SHARPENED", sharpened)
        rows = [augment.sensed(step.copy(), np.random.default_rng(seed))[CROP // 2, :, 0] for seed in range(20)]
        return [row for row in rows if np.abs(np.diff(row[:20])).max() < 1e-6]  # without noise

    assert max(row.max() for row in across(0, 1)) > 0.75
    assert max((np.abs(np.diff(row)) > 0.01).sum() for row in across(1, 0)) > 3
    assert max(row.max() for row in across(0, 0)) <= 0.7 + 1e-5


def test_some_crops_show_vehicles_of_other_shapes(tmp_path, monkeypatch):
    images = read_labels(write_labels(tmp_path, {"a": (None, rows([[200, 200, 40, 16, 0.3]]))}))

    def spread(reshaped):
        monkeypatch.setattr(augment, "RESHAPED", reshaped)
        rng, shapes = np.random.default_rng(1), []
        for _ in range(200):
            *_, values, weight = augment.crop(images[0], rng)
            if weight.any():
                length, width = values[2:4, weight == weight.max()][:, 0]
                shapes.append(length - width)
        return np.std(shapes)

    assert spread(1.0) > 1.4 * spread(0.0)


def test_measured_boxes_take_the_place_of_drawn_ones(tmp_path):
    drawn = [[100, 100, 44, 20, 0.2], [200, 150, 44, 20, 0], [300, 300, 60, 25, 1.0]]
    file = write_labels(tmp_path, {"a": (None, rows(drawn))})
    before = read_labels(file)

    class OneLook:
        card = SimpleNamespace(ruler=SimpleNamespace(margin=np.array([1.0, 0.5])))

        def in_pixels(self, pixels, boxes, looks):
            told = boxes.xylwa + [1, -1, -2, -1, 0.01]
            told[1, 2] *= 0.7  # too far from what was drawn
            kind = np.tile([1.0, 0, 0, 0, 0], (len(told), 1))
            kind[2] = [0, 0, 0, 0, 1]  # no vehicle
            return SimpleNamespace(boxes=replace(boxes, xylwa=told), kind=kind)

    kept = measured.measured(OneLook(), before[0])
    assert kept == {0: [101, 99, 41, 18.5, 0.21]}
    (tmp_path / "measured.json").write_text(json.dumps({"images": {before[0].path.name: kept}}))
    (after,) = measured.with_measured(before, tmp_path / "measured.json")
    assert after.boxes[0].tolist() == kept[0]
    assert np.array_equal(after.boxes[1:], before[0].boxes[1:])


def test_crops_are_drawn_from_every_scene(tmp_path):
    images = read_labels(write_labels(tmp_path, {"a": (None, []), "b": (None, rows([[200, 200, 40, 18, 0]]))}))
    stream = augment.crops(images, {"a": 0.5, "b": 0.5}, seed=0)
    heats = [next(stream)[1].max() for _ in range(20)]
    assert 0 < sum(h > 0 for h in heats) < 20


def test_pasted_vehicles_are_where_their_boxes_say_and_half_of_the_patches_are_bare(tmp_path):
    box = np.array([[203.3, 190.8, 60.0, 26.0, 0.7]])
    donors = read_labels(write_labels(tmp_path, {"a": (draw_boxes(box, paint=255, ground=200), rows(box))}))
    rng, vehicles, patches = np.random.default_rng(3), 0, 0
    for _ in range(80):
        ground = np.full((CROP, CROP, 3), 20, np.uint8)
        keep_clear = np.array([[128.0, 128.0, 40.0, 18.0, 0.0]])
        pixels, added = paste(ground, keep_clear, donors, rng)
        assert (np.hypot(*(added[:, :2] - 128).T) >= (added[:, 2] + 40) / 2 - 1e-9).all()
        white = (pixels[..., 0] > 228).astype(np.uint8)
        for x, y, length, width, _ in added:
            assert white[int(y), int(x)]
            if length > 30 and length / 2 < min(x, y) and max(x, y) < CROP - length / 2:
                inside = white[max(0, int(y - length)) : int(y + length), max(0, int(x - length)) : int(x + length)]
                assert inside.sum() >= 0.85 * length * width
        vehicles += len(added)
        patches += cv2.connectedComponents((pixels[..., 0] > 100).astype(np.uint8))[0] - 1
    assert 0.3 < vehicles / patches < 0.7


# Labels


def test_what_was_judged_since_is_part_of_the_labels(tmp_path, monkeypatch):
    labelled = rows([[50, 50, 40, 18, 0]]) + rows([[150, 50, 40, 18, 0], [250, 50, 40, 18, 0]], "candidate")
    path = write_labels(tmp_path, {"a": (None, labelled), "b": (None, labelled)})
    judged = {"vehicle": [[152, 51, 42, 19, 0.1], [150, 300, 42, 19, 0.1]], "background": [[249, 50, 40, 18, 0]]}
    (tmp_path / "judged.json").write_text(json.dumps({"images": {"a.png": judged}}))
    monkeypatch.setattr(data, "JUDGED", tmp_path / "judged.json")
    a, b = read_labels(path)
    assert a.kinds.tolist() == ["vehicle"] * 3 and b.kinds.tolist() == ["vehicle", "candidate", "candidate"]
    margin = json.loads(MARGINS.read_text())["margin_px"]["judged"]
    assert a.vehicles[1:] == pytest.approx(np.array(judged["vehicle"]) - [0, 0, *margin, 0])
    assert a.lookalikes.tolist() == judged["background"] and not len(b.lookalikes)


def test_crops_show_what_was_taken_for_a_vehicle(monkeypatch):
    monkeypatch.setattr(augment, "photometric", lambda pixels, rng: pixels.astype(np.float32) / 255)
    pixels = np.full((4000, 4000, 3), 90, np.uint8)
    pixels[2980:3020, 2980:3020] = 255  # what was taken for one, far from the only vehicle
    image = data.LabelledImage(
        Path("a.png"), "city", 4000, 4000, "", "", np.array([[500.0, 500, 40, 18, 0]]), np.array(["vehicle"], object),
        lookalikes=np.array([[3000.0, 3000, 40, 18, 0]]), _levels=[pixels],
    )  # fmt: skip
    rng = np.random.default_rng(5)
    drawn = [augment.crop(image, rng) for _ in range(60)]
    heat, background = np.array([crop[1] for crop in drawn]), np.array([crop[2] for crop in drawn])
    bright = np.array([crop[0].max() > 0.6 for crop in drawn])
    assert 12 < bright.sum() < 45 and not heat[bright].any() and background[bright].all()


def test_vehicles_that_labels_lack_are_proposed(tmp_path):
    boxes = np.array([[100, 100, 36, 16, 0.3], [300, 100, 36, 16, 1.0], [200, 300, 36, 16, 0.0]], float)
    labelled = rows(boxes[:1]) + rows(boxes[1:2], "candidate")
    (image,) = read_labels(write_labels(tmp_path, {"a": (draw_boxes(boxes), labelled)}))

    def detect(picture):  # every bright blob is a vehicle; the picture may be shrunk
        contours, _ = cv2.findContours((picture[..., 0] > 145).astype(np.uint8), cv2.RETR_EXTERNAL, 2)
        rectangles = [cv2.minAreaRect(c) for c in contours]
        found = [(*c, max(s) + 1, min(s) + 1, np.radians(a if s[0] > s[1] else a + 90)) for c, s, a in rectangles]
        return Boxes(np.array(found).reshape(-1, 5), np.full(len(found), 0.8))

    known = image.boxes[image.kinds != "candidate"]
    found = missing.proposals(image, detect, 36.0, known)
    order = np.argsort(found.centre[:, 1])
    assert found.centre[order] == pytest.approx(boxes[1:, :2], abs=1.5)
    assert found.length == pytest.approx(36, abs=2.5)
    assert missing.cell(image, found.xylwa[0], "0").shape == (missing.CELL, missing.CELL, 3)


def test_a_proposal_is_drawn_where_its_vehicle_is(tmp_path, monkeypatch):
    pixels = np.full((60, 60, 3), 20, np.uint8)
    pixels[20:28, 20:32] = 255  # five times as large in its cell
    (image,) = read_labels(write_labels(tmp_path, {"a": (pixels, rows(np.array([[26.0, 24.0, 12.0, 8.0, 0.0]])))}))
    lines = []
    monkeypatch.setattr(cv2, "polylines", lambda canvas, corners, *_: lines.append(corners[0]))
    bright = missing.cell(image, image.boxes[0], "")[..., 2] > 137
    y, x = np.nonzero(bright)
    assert [x.min(), y.min(), x.max(), y.max()] == pytest.approx([*lines[0].min(0), *lines[0].max(0)], abs=1)


def test_margins_are_taken_off_both_sides(tmp_path):
    margin = json.loads(MARGINS.read_text())["margin_px"]["warsaw"]
    boxes = [[100, 100, 50, 24, 0.2], [200, 200, 10, 4, 0.2]]
    path = write_labels(tmp_path, {"warsaw": (None, rows(boxes)), "elsewhere": (None, rows(boxes))})
    tight, untouched = read_labels(path)
    assert tight.vehicles[0, 2:4] == pytest.approx([50 - margin[0], 24 - margin[1]])
    assert tight.vehicles[1, 3] == pytest.approx(4 - min(margin[1], 1))  # never more than a quarter of the width
    assert untouched.vehicles == pytest.approx(np.array(boxes, float))
    assert read_labels(path, tighten=False)[0].vehicles == pytest.approx(np.array(boxes, float))


def test_the_split_is_by_scene(tmp_path):
    images = read_labels(write_labels(tmp_path, {name: (None, []) for name in ("munich", "ohio", "park")}))
    training, held_out = split(images, {"ohio"})
    assert [i.scene for i in training] == ["munich", "park"] and [i.scene for i in held_out] == ["ohio"]
    with pytest.raises(ValueError, match="no such scene in the labels: atlantis"):
        split(images, {"atlantis", "ohio"})


# Evaluation


def test_boxes_are_matched_and_ignored_ground_counts_neither_way():
    vehicles = np.array([[50, 50, 40, 18, 0.0], [150, 50, 40, 18, 1.0], [250, 50, 40, 18, 0.5]])
    ignored = np.array([[50, 200, 60, 30, 0.4]])
    boxes = np.array([
        [51, 50, 42, 18, 0.03],  # a hit
        [150, 50, 40, 18, -0.5],  # in its place, but across it
        [55, 205, 40, 18, 0.0],  # on ignored ground
        [300, 300, 40, 18, 0.0],  # on nothing
    ])  # fmt: skip
    c = compare(Boxes(boxes, [0.9, 0.8, 0.7, 0.6]), vehicles, ignored)
    assert c.hit.tolist() == [0, -1, -1] and c.boxes.score.tolist() == [0.9, 0.8, 0.6]
    assert compare(Boxes.empty(), vehicles, ignored).hit.tolist() == []
    assert compare(Boxes(boxes, np.ones(4)), NOTHING, NOTHING).hit.tolist() == [-1] * 4


@pytest.mark.parametrize(
    "score, hit, vehicles, area",
    [
        ([0.9, 0.8, 0.7], [1, 1, 1], 3, 1.0),
        ([0.9, 0.8, 0.7], [1, 0, 1], 2, (1 + 2 / 3) / 2),
        ([0.7, 0.8, 0.9], [1, 0, 1], 2, (1 + 2 / 3) / 2),  # the order of the list does not matter
        ([0.9, 0.8, 0.7], [1, 0, 1], 4, (1 + 2 / 3) / 4),  # two are never found
        ([0.9, 0.8, 0.7], [0, 1, 1], 2, 2 / 3),  # half right, then two thirds: the better one counts
        ([0.9], [0], 5, 0.0),
        ([], [], 5, 0.0),
    ],
)
def test_average_precision(score, hit, vehicles, area):
    assert average_precision(np.array(score), np.array(hit, bool), vehicles) == pytest.approx(area)


def test_a_scene_is_swept_at_its_zoom_and_summed_up(tmp_path):
    vehicles = np.array(
        [[100, 100, 40, 18, 0.2], [300, 100, 40, 18, 0.2], [100, 300, 40, 18, 0.2], [398, 300, 40, 18, 0]]
    )
    labels = write_labels(tmp_path, {"a": (None, rows(vehicles) + rows([[300, 300, 60, 30, 0]], "ignore"))})
    (scene,) = labelled_scenes(labels, [])

    def detect(image):
        """Two of three whole vehicles 10 % too long, one mistake, one on ignored ground; seen at half size."""
        assert image.shape[:2] == (200, 200)
        boxes = np.array(
            [[100, 100, 44, 18, 0.2], [300, 100, 44, 18, 0.2], [200, 200, 40, 18, 0], [300, 300, 40, 18, 0]]
        )
        return Boxes(boxes, [0.9, 0.3, 0.8, 0.7]).mapped(0.5)

    result, comparisons = evaluate(scene, detect, best_length=20, score=0.5, looks=1)
    assert (result.pictures, result.vehicles, result.zoom, result.false) == (1, 3, 0.5, 1)
    assert result.precision == pytest.approx(1 / 2) and result.recall == pytest.approx(1 / 3)
    assert result.average_precision == pytest.approx((1 + 2 / 3) / 3)
    assert result.length == pytest.approx((np.log(1.1), 0, np.log(1.1)), abs=1e-9)
    assert result.width == pytest.approx((0, 0, 0), abs=1e-9)
    assert "0.500 (1 false)" in table([result])
    assert draw(comparisons, scene, 0.5, width=300).shape == (300, 300, 3)
    with pytest.raises(ValueError, match="no such scene .*: b; there are a"):
        labelled_scenes(labels, ["b"])


def test_two_looks_leave_out_what_one_alone_shows(tmp_path):
    vehicles = np.array([[100, 100, 40, 18, 0.2], [300, 100, 40, 18, 0.2]])
    (scene,) = labelled_scenes(write_labels(tmp_path, {"a": (draw_boxes(vehicles), rows(vehicles))}), [])

    def detect(image):
        """Both vehicles, the second one less surely from afar; one mistake that shows from near alone."""
        zoom = image.shape[0] / 400
        near = zoom == 1
        boxes = np.r_[vehicles, [[200, 300, 40, 18, 0]]][: 3 if near else 2]
        return Boxes(boxes, [0.9, 0.9, 0.8] if near else [0.8, 0.3]).mapped(zoom)

    result, _ = evaluate(scene, detect, best_length=40, score=0.7)
    assert (result.false, result.precision, result.recall) == (0, 1, 0.5)  # the second scores 0.6 on average
    assert result.average_precision == 1
    result, _ = evaluate(scene, detect, best_length=40, score=0.5, looks=1)
    assert (result.false, result.recall) == (1, 1)


def test_checked_pictures_are_those_of_the_shared_data():
    scenes = {scene.name: scene for scene in checked_scenes(Path("data"))}
    assert {name: len(scene.pictures) for name, scene in scenes.items()} == {
        "manila": 1, "sheffield": 10, "brighton": 18,
    }  # fmt: skip
    assert all(scene.complete for scene in scenes.values())
    for scene in scenes.values():
        for p in scene.pictures:
            assert p.picture.path.parts[0] == "data"
            assert Boxes(p.vehicles, np.ones(len(p.vehicles))).inside(p.picture.width, p.picture.height, 0).all()


def test_places_are_those_whose_pictures_are_there(tmp_path):
    assert place_scenes(tmp_path) == []
    (tmp_path / "places").mkdir()
    cv2.imwrite(str(tmp_path / "places" / "tianjin.jpg"), np.zeros((8, 12, 3), np.uint8))
    (scene,) = place_scenes(tmp_path)
    (picture,) = scene.pictures
    assert (scene.name, scene.complete) == ("tianjin", True)
    assert (picture.picture.width, picture.picture.height) == (12, 8)
    assert (picture.vehicles.shape, picture.ignored.shape) == ((10, 5), (3, 5))


def test_a_place_of_which_nothing_is_ignored(tmp_path, monkeypatch):
    """`propose keep` leaves out kinds without boxes."""
    kept = propose.judged({"site.png": [{"box": [6.0, 4.0, 4.0, 2.0, 0.0], "kind": "vehicle"}]}, "")
    (tmp_path / "places.json").write_text(json.dumps({"images": kept}))
    monkeypatch.setattr("training.evaluate.PLACES", tmp_path / "places.json")
    (tmp_path / "places").mkdir()
    cv2.imwrite(str(tmp_path / "places" / "site.png"), np.zeros((8, 12, 3), np.uint8))
    ((picture,),) = (scene.pictures for scene in place_scenes(tmp_path))
    assert (len(picture.vehicles), len(picture.ignored)) == (1, 0)


def test_a_scene_without_vehicles_has_false_boxes_only(tmp_path):
    (scene,) = labelled_scenes(write_labels(tmp_path, {"dunes": (None, [])}), ["dunes"])
    result, _ = evaluate(scene, lambda image: Boxes([[100, 100, 40, 18, 0]], [0.9]), 45, 0.5, looks=1)
    assert result.false == 1 and result.recall is None and result.average_precision is None and result.length is None
    assert "(1 false)" in table([result])


def test_incomplete_references_say_nothing_about_precision(tmp_path):
    path = write_labels(tmp_path, {"a": (None, []), "b": (None, [])})
    reference = tmp_path / "boxes.json"
    reference.write_text(json.dumps({"a.png": rows([[200, 200, 40, 18, 0.1]])}))
    scene = reference_scene(f"place={path.parent / 'images'}:{reference}")
    assert scene.name == "place" and [p.picture.name for p in scene.pictures] == ["a.png"]
    result, _ = evaluate(scene, lambda image: Boxes([[200, 200, 40, 18, 0.1]], [0.9]), 40, 0.5, looks=1)
    assert result.recall == 1 and result.precision is None and result.average_precision is None
    assert "(incomplete)" in table([result])
    reference.write_text(json.dumps({"z.png": []}))
    with pytest.raises(ValueError, match="none of the pictures"):
        reference_scene(f"place={path.parent / 'images'}:{reference}")


# The ruler's margin


def simulated(rng, code, gsd, margin, n=400):
    fleet = load_fleet(code)
    size = fleet.sample(rng, n)[:, :2] / np.reshape(gsd, (-1, 1)) + margin + rng.normal(0, (1.5, 1.0), (n, 2))
    return size[:, 0], size[:, 1], gsd, fleet


def test_fit_margin_recovers_what_was_added():
    rng = np.random.default_rng(3)
    known = [simulated(rng, code, gsd, (2.5, 1.5)) for code, gsd in (("DE", 0.1), ("US", 0.13), ("PL", 0.2))]
    known.append(simulated(rng, "DE", rng.uniform(0.1, 0.2, 400), (2.5, 1.5)))  # a reconstruction: each its own scale
    margin = fit_margin(known)
    assert margin.value == pytest.approx([2.5, 1.5], abs=0.3)
    assert margin.left_out == pytest.approx(np.tile([2.5, 1.5], (4, 1)), abs=0.4)
    assert (margin.sd < margin.scenes_sd.min(0)).all()


def test_fit_margin_trusts_coarse_pixels_and_known_fleets_most_and_admits_disagreement():
    rng = np.random.default_rng(4)
    agreeing = [simulated(rng, "DE", gsd, (2.0, 1.0)) for gsd in (0.1, 0.2, 0.3)]
    margin = fit_margin(agreeing)
    # What is not known of the fleet is a share of a vehicle, so it is fewer pixels where pixels are coarse.
    assert (np.diff(margin.scenes_sd[:, 0]) < 0).all()
    odd = [*agreeing, simulated(rng, "DE", 0.25, (8.0, 6.0))]
    surprised = fit_margin(odd)
    assert (surprised.sd > 2 * margin.sd).all()
    assert surprised.left_out[-1] == pytest.approx(margin.value)
    assert np.isnan(fit_margin(agreeing[:1]).left_out).all()


def test_known_boxes_are_in_detector_pixels(tmp_path):
    cv2.imwrite(str(tmp_path / "p.png"), np.full((300, 300, 3), 90, np.uint8))
    length, width = np.exp(load_fleet("DE").log_mean)

    def detect(image):
        wanted = [40, 40 * width / length]
        boxes = [[80, 80, *wanted, 0], [80, 140, 20, 8, 0], [150, 80, *wanted, 0]]  # the second is no car
        return Boxes(boxes, [0.9, 0.9, 0.2])

    long_px, wide_px, gsd, fleet = known_boxes(f"{tmp_path / 'p.png'}:0.1:DE", detect, best_length=40, score=0.5)
    assert fleet.code == "DE" and gsd == pytest.approx(length / 40)
    assert long_px == pytest.approx([40], rel=0.02) and wide_px == pytest.approx([40 * width / length], rel=0.02)


# Measured by hand


def reading_of(box, to_cell):
    """What a perfect reader reads of a box [px of the picture]."""
    linear = to_cell[:, :2]
    scale, turn = np.sqrt(np.linalg.det(linear)), np.arctan2(linear[1, 0], linear[0, 0])
    x, y = linear @ box[:2] + to_cell[:, 2]
    tilt = (np.degrees(box[4] + turn) + 90) % 180 - 90
    long, wide = box[2] * scale / 2, box[3] * scale / 2
    return [x - long, x + long, y - wide, y + wide, tilt]


def test_a_reading_is_a_box_of_the_picture():
    boxes = field_of_boxes(np.random.default_rng(1))
    cells = by_hand.choose([("s", Path("p.png"), boxes, (400, 400))], 6, seed=2)
    assert len(cells) == 6
    for cell in cells:
        again = by_hand.to_picture(by_hand.read_box(reading_of(cell.label, cell.to_cell)), cell.to_cell)
        assert again[:4] == pytest.approx(cell.label[:4])
        assert np.cos(2 * (again[4] - cell.label[4])) == pytest.approx(1)


def test_vehicles_to_measure_come_from_all_scenes_and_as_many_pictures_as_there_are():
    pictures = [(scene, Path(f"{scene}{k}.png"), field_of_boxes(np.random.default_rng(k)), (400, 400))
                for scene in ("a", "b") for k in range(3)]  # fmt: skip
    small = ("a", Path("small.png"), np.array([[200, 200, 20, 8, 0.0]]), (400, 400))
    cut = ("b", Path("cut.png"), np.array([[10, 200, 40, 18, 0.0]]), (400, 400))
    cells = by_hand.choose([*pictures, small, cut], 4, seed=0)
    for scene in ("a", "b"):
        files = [cell.picture.name for cell in cells if cell.scene == scene]
        assert len(files) == 4 and set(files) == {f"{scene}{k}.png" for k in range(3)}


def test_what_was_measured_before_is_not_measured_again():
    boxes = field_of_boxes(np.random.default_rng(1))
    read = [{"picture": "folder/p.png", "read": list(boxes[2])}, {"picture": "q.png", "read": list(boxes[0])}]
    cells = by_hand.choose([("s", Path("p.png"), boxes, (400, 400))], len(boxes), seed=2, kept=read)
    assert {tuple(c.label) for c in cells} == {tuple(b) for k, b in enumerate(boxes) if k != 2}


def test_cells_show_their_vehicle_where_the_map_says(tmp_path):
    boxes = field_of_boxes(np.random.default_rng(4))
    cv2.imwrite(str(tmp_path / "p.png"), draw_boxes(boxes))
    cells = by_hand.choose([("s", tmp_path / "p.png", boxes, (400, 400))], 4, seed=5)
    assert len(cells) == 4
    for cell in cells:
        left, right, top, bottom, tilt = reading_of(cell.label, cell.to_cell)
        drawn = by_hand.draw_cell(cell)[..., 2].astype(float)
        mask = np.zeros(drawn.shape, np.uint8)
        corners = Boxes(by_hand.read_box((left, right, top, bottom, tilt))[None], np.ones(1)).corners - 0.5
        cv2.fillConvexPoly(mask, np.round(corners[0]).astype(np.int32), 1)
        inside, ring = (
            cv2.erode(mask, np.ones((9, 9))) > 0,
            (cv2.dilate(mask, np.ones((21, 21))) > 0) & (cv2.dilate(mask, np.ones((9, 9))) == 0),
        )
        assert np.percentile(drawn[inside], 5) > np.percentile(drawn[ring], 95) + 60


@pytest.fixture
def command(monkeypatch, capsys):
    """Runs a module's command line; what it prints."""

    def run(module, *arguments):
        monkeypatch.setattr("sys.argv", [module.__name__, *map(str, arguments)])
        module.main()
        return capsys.readouterr().out

    return run


def test_margins_are_what_labels_exceed_the_readings_by(tmp_path, monkeypatch, command):
    rng = np.random.default_rng(7)
    loose = {"park": (0.0, 0.0), "munich": (3.0, -1.0), "minsk": (-2.0, 1.5)}
    scenes, truth = {}, {}
    for scene, margin in loose.items():
        boxes = field_of_boxes(rng)
        truth[scene] = boxes
        scenes[scene] = (draw_boxes(boxes), rows(boxes + [0, 0, *margin, 0]))
    labels = write_labels(tmp_path / "labels", scenes)
    folder, kept = tmp_path / "sheets", tmp_path / "by_hand.json"

    run = partial(command, by_hand)
    run("sheets", "--labels", labels, "--count", 12, "--out", folder)
    cells = json.loads((folder / "cells.json").read_text())
    assert len(cells) == 36 and len(list(folder.glob("sheet_*.png"))) == 36 // by_hand.PER_SHEET
    readers = [tmp_path / "first.json", tmp_path / "second.json"]
    for sign, file in zip((-1, 1), readers, strict=True):  # one sees vehicles too small, the other too large
        readings = {}
        for number, cell in enumerate(cells):
            boxes = truth[cell["scene"]]
            box = boxes[np.argmin(np.hypot(*(boxes[:, :2] - cell["label"][:2]).T))] + [0, 0, sign, sign, 0]
            readings[number] = reading_of(box, np.array(cell["to_cell"]))
        readings[0] = None  # could not be read
        file.write_text(json.dumps(readings))
    run("draw", folder, readers[0])
    assert len(list(folder.glob("drawn_*.png"))) == 36 // by_hand.PER_SHEET
    run("keep", folder, *readers, "--data", tmp_path / "labels", "--to", kept)
    vehicles = json.loads(kept.read_text())["vehicles"]
    assert len(vehicles) == 35 and {v["readers"] for v in vehicles} == {2}
    told = by_hand.margins(vehicles)
    for scene, margin in loose.items():
        assert told[scene][0] == pytest.approx(margin, abs=0.02)
    assert "munich           12     +3.00" in run("margins", "--of", kept).replace("11     +3", "12     +3")
    # What was measured is what a detector's sizes are compared with.
    monkeypatch.setattr("training.evaluate.BY_HAND", kept)
    measured = {scene.name: scene for scene in measured_scenes(tmp_path / "labels")}
    assert set(measured) == set(loose) and not measured["park"].complete
    assert sum(len(p.vehicles) for scene in measured.values() for p in scene.pictures) == 35


def test_what_is_read_again_is_averaged(tmp_path):
    def vehicle(read, readers=1, picture="a.png"):
        return {"scene": "s", "picture": picture, "label": read, "read": read, "readers": readers}

    kept = [vehicle([50.0, 40, 40, 18, 1.56], 2), vehicle([90.0, 40, 40, 18, 0.0])]
    new = [vehicle([53.0, 40, 43, 15, -1.57]), vehicle([50.0, 40, 40, 18, 0.0], picture="b.png")]
    told = by_hand.joined(kept, new)
    assert [v["readers"] for v in told] == [3, 1, 1] and told[2]["picture"] == "b.png"
    assert told[0]["read"] == pytest.approx([51.0, 40, 41, 17, 1.56 + (np.pi - 3.13) / 3], abs=0.01)
    assert told[1]["read"] == [90.0, 40, 40, 18, 0.0]


def test_sheets_of_a_place_need_only_a_detectors_boxes(tmp_path, command):
    boxes = field_of_boxes(np.random.default_rng(8))
    cv2.imwrite(str(tmp_path / "place.png"), draw_boxes(boxes))
    names = ("cx", "cy", "length", "width", "angle", "score")
    found = [dict(zip(names, map(float, [*box, 0.9]), strict=True)) for box in boxes]
    (tmp_path / "boxes.json").write_text(json.dumps({"place.png": found}))
    place = f"place={tmp_path / 'place.png'}:{tmp_path / 'boxes.json'}"
    command(by_hand, "sheets", "--found", place, "--count", 5, "--out", tmp_path / "sheets")
    cells = by_hand.read_sheets(tmp_path / "sheets")
    assert [cell.scene for cell in cells] == ["place"] * 5
    for cell in cells:
        assert np.abs(boxes - cell.label).max(1).min() < 1e-6
    assert (tmp_path / "sheets" / "READING.txt").exists()


def test_kinds_are_kept_where_readers_agree(tmp_path, command):
    boxes = field_of_boxes(np.random.default_rng(8))
    labels = write_labels(tmp_path / "labels", {"park": (draw_boxes(boxes), rows(boxes))})
    folder, kept = tmp_path / "sheets", tmp_path / "kinds.json"

    run = partial(command, kinds)
    run("sheets", "--labels", labels, "--count", 8, "--out", folder)
    cells = by_hand.read_sheets(folder)
    assert len(cells) == 8 and (folder / "sheet_00.png").exists() and (folder / "READING.txt").exists()
    one, other = tmp_path / "one.json", tmp_path / "other.json"
    blank = ["??????"] * (kinds.ROWS - 2)
    one.write_text(json.dumps({"0": ["cpvln?", "cc????", *blank]}))
    other.write_text(json.dumps({"0": ["ccvlnp", "cp????", *blank]}))
    run("keep", folder, one, other, "--data", tmp_path / "labels", "--to", kept)
    vehicles = json.loads(kept.read_text())["vehicles"]
    assert [v["kind"] for v in vehicles] == ["car", "van", "larger", "none", "car"]
    assert [v["box"] for v in vehicles] == [cells[k].label.round(2).tolist() for k in (0, 2, 3, 4, 6)]
    assert {v["readers"] for v in vehicles} == {2}
    table = run("agreement", folder, one, other)
    assert "| pickup | 2 | 0 | 0 | 0 | 0 | 1 |" in table  # of three pickups two were cars to the other, one unknown
    one.write_text(json.dumps({"0": ["cpvln", "cc????", *blank]}))
    with pytest.raises(ValueError, match="rows of 6 letters"):
        kinds.read_answers(one, 8)
    run("sheets", "--labels", labels, "--count", 100, "--out", tmp_path / "rest", "--to", kept)
    rest = [cell.label.round(2).tolist() for cell in by_hand.read_sheets(tmp_path / "rest")]
    assert len(rest) > 3 and not any(v["box"] in rest for v in vehicles)  # what was told is not asked again
    # What was told is what the measurer learns from.
    patches = real.told_patches(tmp_path / "labels", vehicles)
    assert [ANSWERS[p.kind] for p in patches] == [v["kind"] for v in vehicles]
    for patch, vehicle in zip(patches, vehicles, strict=True):
        assert patch.box[2:].tolist() == vehicle["box"][2:]


def test_sheets_may_show_only_what_a_measurer_takes_for_rare(tmp_path, monkeypatch, command):
    """Told by how wide they are: the pickups and vans of a place that has few."""
    boxes = field_of_boxes(np.random.default_rng(8))
    labels = write_labels(tmp_path / "labels", {"park": (draw_boxes(boxes), rows(boxes))})
    limit = np.median(boxes[:, 3])

    class ByWidth:
        def __init__(self, path):
            assert path is None  # the shipped one

        def in_pixels(self, pixels, found):
            kind = np.full((len(found), len(ANSWERS)), 0.1)
            kind[:, ANSWERS.index("pickup")] = np.where(found.xylwa[:, 3] > limit, 0.4, 0.2)
            kind[:, ANSWERS.index("van")] = 0.11
            return SimpleNamespace(kind=kind)

    monkeypatch.setattr(kinds, "Measurer", ByWidth)
    command(kinds, "sheets", "--labels", labels, "--likely", 0.5, "--count", 100, "--out", tmp_path / "sheets",
            "--to", tmp_path / "none.json")  # fmt: skip
    drawn = [cell.label for cell in by_hand.read_sheets(tmp_path / "sheets")]
    command(
        kinds, "sheets", "--labels", labels, "--count", 100, "--out", tmp_path / "all", "--to", tmp_path / "none.json"
    )
    every = [cell.label for cell in by_hand.read_sheets(tmp_path / "all")]
    assert 3 < len(drawn) == sum(label[3] > limit for label in every) < len(every)
    assert all(label[3] > limit for label in drawn)


@pytest.mark.parametrize(
    ("cells", "rows"),
    [
        (60, ["cccccc"] * (kinds.ROWS + 1)),  # what is too much would be told of the next sheet's
        (60, [*["cccccc"] * (kinds.ROWS - 1), "ccccccc"]),
        (60, ["cccccc"] * (kinds.ROWS - 1)),  # which row lacks?
        (4, ["ccc"]),
        (4, []),
    ],
)
def test_answers_that_may_be_of_other_vehicles_are_refused(tmp_path, cells, rows):
    file = tmp_path / "answers.json"
    file.write_text(json.dumps({"0": rows}))
    with pytest.raises(ValueError, match="sheet 0 needs 8 rows of 6 letters"):
        kinds.read_answers(file, cells)


def test_the_last_sheet_may_be_answered_as_far_as_it_goes(tmp_path):
    file = tmp_path / "answers.json"
    file.write_text(json.dumps({"0": ["cccccc"] * kinds.ROWS, "1": ["pppppp", "v"]}))
    told = kinds.read_answers(file, kinds.PER_SHEET + 7)
    assert list(told.values()) == ["car"] * kinds.PER_SHEET + ["pickup"] * 6 + ["van"]


# The network (with torch)


@pytest.fixture
def torch():
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield torch
    torch.set_num_threads(threads)


def small_label_set(tmp_path):
    boxes = field_of_boxes(np.random.default_rng(8))
    return write_labels(tmp_path, {"a": (draw_boxes(boxes, window=40), rows(boxes)), "held": (None, [])})


@pytest.mark.parametrize("kind", ["small", "lite0"])
def test_networks_answer_at_stride_four(torch, kind):
    from training.network import NETWORKS

    with torch.no_grad():
        maps = NETWORKS[kind]().eval()(torch.zeros(1, 3, 64, 96))
    assert maps.shape == (1, 7, 16, 24)


def imagenet_weights(torch, lite0):
    """Random weights under the package's names, with statistics that matter."""
    given, inputs = {}, lite0.STEM

    def add(prefix, norm, shape):
        given[f"{prefix}.weight"] = torch.randn(shape) * (2 / shape[1:].numel()) ** 0.5
        count = shape[0]
        given.update({f"{norm}.{part}": torch.rand(count) + 0.5 for part in ("weight", "running_var")})
        given.update({f"{norm}.{part}": torch.randn(count) * 0.3 for part in ("bias", "running_mean")})

    add("_conv_stem", "_bn0", torch.Size((inputs, 3, 3, 3)))
    block = 0
    for count, size, _, expansion, outputs in lite0.STAGES:
        for _ in range(count):
            inner, name = inputs * expansion, f"_blocks.{block}"
            if expansion > 1:
                add(f"{name}._expand_conv", f"{name}._bn0", torch.Size((inner, inputs, 1, 1)))
            add(f"{name}._depthwise_conv", f"{name}._bn1", torch.Size((inner, 1, size, size)))
            add(f"{name}._project_conv", f"{name}._bn2", torch.Size((outputs, inner, 1, 1)))
            inputs, block = outputs, block + 1
    return given


def test_what_imagenet_taught_is_folded_exactly(torch, tmp_path):
    from torch.nn import functional as F

    from training import lite0

    torch.manual_seed(2)
    given = imagenet_weights(torch, lite0)

    def step(x, conv, norm, stride=1, groups=1):
        weight = given[f"{conv}.weight"]
        x = F.conv2d(x, weight, None, stride, weight.shape[-1] // 2, groups=groups)
        parts = (given[f"{norm}.{part}"] for part in ("running_mean", "running_var", "weight", "bias"))
        return F.batch_norm(x, *parts, eps=1e-3)

    image = torch.rand(1, 3, 64, 48)
    x = F.relu6(step((image * 255 - 127) / 128, "_conv_stem", "_bn0", 2))
    block, expected = 0, []
    for count, _, stride, expansion, _ in lite0.STAGES:
        for k in range(count):
            name, before = f"_blocks.{block}", x
            if expansion > 1:
                x = F.relu6(step(x, f"{name}._expand_conv", f"{name}._bn0"))
            x = step(x, f"{name}._depthwise_conv", f"{name}._bn1", stride if k == 0 else 1, x.shape[1])
            x = step(F.relu6(x), f"{name}._project_conv", f"{name}._bn2")
            x = x if k == 0 else x + before  # the table's stages with one block change the number of channels
            if block in lite0.ENDS:
                expected.append(x)
            block += 1
    torch.save(given, tmp_path / "weights.pth")
    network = lite0.Lite0()
    network.load_imagenet(tmp_path / "weights.pth")
    with torch.no_grad():
        for ours, theirs in zip(network(image), expected, strict=True):
            assert torch.allclose(ours, theirs, rtol=1e-4, atol=1e-4 * float(theirs.std()))
    del given["_blocks.3._project_conv.weight"]
    torch.save(given, tmp_path / "weights.pth")
    with pytest.raises(ValueError, match=r"lacks _blocks\.3\._project_conv"):
        network.load_imagenet(tmp_path / "weights.pth")


@pytest.mark.parametrize(("size", "stride"), [(3, 1), (3, 2), (5, 1), (5, 2)])
def test_depthwise_gradients_are_those_of_torch(torch, size, stride):
    from training.lite0 import Depthwise

    torch.manual_seed(3)
    ours = Depthwise(6, size, stride)
    plain = torch.nn.Conv2d(6, 6, size, stride, size // 2, groups=6)
    plain.load_state_dict(ours.state_dict())
    gradients = []
    for conv in (ours, plain):
        x = torch.linspace(-1, 1, 2 * 6 * 12 * 10).reshape(2, 6, 12, 10).requires_grad_()
        conv(x).square().sum().backward()
        gradients.append((x.grad, conv.weight.grad, conv.bias.grad))
    for one, other in zip(*gradients, strict=True):
        assert torch.allclose(one, other, rtol=1e-4, atol=1e-5)


def test_pictures_of_a_folder_have_its_labels(tmp_path, monkeypatch):
    folder, labels = tmp_path / "chips", tmp_path / "labels"
    folder.mkdir()
    labels.mkdir()
    for name in ("lot1", "roof2"):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((60, 64, 3), 50, np.uint8))
    (labels / "chips.json").write_text(json.dumps({
        "usual_length": 15.0, "source": "a test", "licence": "CC0",
        "images": {"lot1.png": {"vehicle": [[30, 20, 15, 7, 0.5]], "ignore": [[50, 50, 14, 6, 0]]},
                   "roof2.png": {"background": [[20, 20, 15, 7, 0]]}},
    }))  # fmt: skip
    monkeypatch.setattr(data, "LABELS", labels)
    lot, roof = read_labels(folder, tighten=False)
    assert lot.vehicles.tolist() == [[30, 20, 15, 7, 0.5]] and lot.kinds.tolist() == ["vehicle", "ignore"]
    assert (lot.scene, roof.scene, len(roof.boxes), len(roof.lookalikes)) == ("lot", "roof", 0, 1)
    assert (lot.height, lot.width, lot.usual_length) == (60, 64, 15.0)


def test_what_a_person_says_of_proposals_counts():
    found = {
        "lot1.jpg": [{"box": [1, 1, 15, 7, 0], "kind": "vehicle"}, {"box": [2, 2, 15, 7, 0], "kind": "ignore"}],
        "lot2.jpg": [{"box": [3, 3, 15, 7, 0], "kind": "vehicle"}, {"box": [4, 4, 15, 7, 0], "kind": "vehicle"}],
        "roof1.jpg": [{"box": [5, 5, 15, 7, 0], "kind": "vehicle"}],
    }
    kept = propose.judged(found, "lot vehicle 1\nlot background 2-3\n\nroof ignore 0\nroof1.jpg add 9 9 15 7 0.5\n")
    assert kept == {
        "lot1.jpg": {"vehicle": [[1, 1, 15, 7, 0], [2, 2, 15, 7, 0]]},
        "lot2.jpg": {"background": [[3, 3, 15, 7, 0], [4, 4, 15, 7, 0]]},
        "roof1.jpg": {"vehicle": [[9, 9, 15, 7, 0.5]], "ignore": [[5, 5, 15, 7, 0]]},
    }


def test_what_is_judged_is_ignored_no_more():
    before = {"lot1.jpg": {"vehicle": [[1, 1, 15, 7, 0]], "ignore": [[20, 20, 15, 7, 0], [60, 60, 15, 7, 0]]}}
    now = {"lot1.jpg": {"background": [[20.5, 20, 15, 7, 0]]}, "roof1.jpg": {"background": [[5, 5, 15, 7, 0]]}}
    assert propose.added(before, now) == {
        "lot1.jpg": {
            "vehicle": [[1, 1, 15, 7, 0]], "ignore": [[60, 60, 15, 7, 0]], "background": [[20.5, 20, 15, 7, 0]],
        },
        "roof1.jpg": {"background": [[5, 5, 15, 7, 0]]},
    }  # fmt: skip


def test_looks_agree_on_what_most_of_them_show():
    vehicle, other = [50.0, 40.0, 16.0, 7.0, 0.3], [90.0, 80.0, 16.0, 7.0, 0.3]
    looks = [Boxes(np.array([vehicle]) + [0, 0, k, 0, 0], np.array([0.8])) for k in range(3)]
    looks.append(Boxes(np.array([vehicle, other]), np.array([0.6, 0.2])))
    best, least = propose.agreed(looks)
    assert best["box"] == pytest.approx([50, 40, 16.5, 7, 0.3]) and best["score"] == pytest.approx(0.75)
    assert (best["sure"], least["sure"]) == (1.0, 0.0) and least["score"] == pytest.approx(0.05)


@pytest.mark.slow
def test_the_loss_falls_on_a_handful_of_crops(torch, tmp_path):
    from training.network import VehicleNet, loss

    images = read_labels(small_label_set(tmp_path))[:1]
    stream = augment.crops(images, {}, seed=0)
    image, *targets = (torch.from_numpy(np.stack(part)) for part in zip(*(next(stream) for _ in range(4)), strict=True))
    image = image.float() / 255
    network = VehicleNet()
    optimiser = torch.optim.AdamW(network.parameters(), 1.5e-3)
    losses = []
    for _ in range(20):
        parts = loss(network(image), *targets)
        assert set(parts) == {"heat", "offset", "size", "angle"}
        total = sum(parts.values())
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        losses.append(total.item())
    assert np.isfinite(losses).all() and losses[-1] < 0.6 * losses[0]


def test_a_network_of_other_widths_does_the_same_where_what_it_lost_did_nothing(torch):
    from training.network import Residual
    from training.reshape import reshaped

    torch.manual_seed(3)
    before, after = Residual(4, 6).eval(), Residual(5, 4).eval()
    with torch.no_grad():
        before.second[0].weight[:, [1, 4]] = 0  # two channels that nobody reads
        before.first[1].weight.uniform_(0.5, 2)
        before.first[1].running_mean.uniform_(-1, 1)
    after.load_state_dict(reshaped(before.state_dict(), after.state_dict()))
    x = torch.rand(1, 5, 8, 8)  # the fifth channel is new
    with torch.no_grad():
        assert torch.allclose(after(x)[:, :4], before(x[:, :4]), atol=1e-6)
        assert after.second[0].weight[4].abs().min() > 0  # what writes the new channel can learn
    with pytest.raises(ValueError, match="sizes that cannot be cut: first.0.weight"):
        reshaped(before.state_dict(), Residual(3, 4).state_dict())
    with pytest.raises(ValueError, match="other layers: "):
        reshaped(before.state_dict(), before.first.state_dict())


def with_statistics(torch, network):
    """The network with normalisations that do something."""
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.weight.uniform_(0.5, 1.5)
                module.bias.uniform_(-0.3, 0.3)
                module.running_mean.uniform_(-0.5, 0.5)
                module.running_var.uniform_(0.5, 1.5)
    return network.eval()


@pytest.mark.parametrize("kind", ["small", "lite0"])
def test_training_goes_on_from_what_was_exported(torch, tmp_path, monkeypatch, kind):
    from training import export
    from training.network import NETWORKS
    from training.unfold import unfolded

    torch.manual_seed(5)
    network = with_statistics(torch, NETWORKS[kind]())
    torch.save({"kind": kind, "average": network.state_dict()}, tmp_path / "checkpoint.pt")
    exported, card = tmp_path / "exported.onnx", Path(export.__file__).with_name("card.json")
    monkeypatch.setattr("sys.argv", ["export", *map(str, ("--run", tmp_path, "--card", card, "--out", exported))])
    export.main()
    again = NETWORKS[kind]()
    crops, other = torch.rand(2, 3, 64, 64), torch.rand(1, 3, 96, 64)
    again.load_state_dict(unfolded(exported, again, crops))
    with torch.no_grad():
        for image in (crops, other):
            assert torch.allclose(again.eval()(image), network(image), atol=1e-4)
        # In training, too, it does what it did: its statistics are those of the crops.
        assert torch.allclose(again.train()(crops), network(crops), atol=0.05)


def test_the_measurers_training_goes_on_from_what_was_exported(torch, tmp_path):
    from training.measurer.export import write
    from training.measurer.network import MeasureNet
    from training.unfold import unfolded

    torch.manual_seed(6)
    network, again = with_statistics(torch, MeasureNet()), MeasureNet()
    crops = 255 * torch.rand(4, 3, 48, 96)
    again.load_state_dict(unfolded(write(network, tmp_path / "exported.onnx"), again, crops))
    with torch.no_grad():
        for before, after in zip(network(crops), again.eval()(crops), strict=True):
            assert torch.allclose(before, after, atol=1e-3)


@pytest.mark.slow
def test_training_stops_and_goes_on(torch, tmp_path, monkeypatch):
    from training import train

    labels = small_label_set(tmp_path)

    def run(*more):
        options = ["--labels", labels, "--run", tmp_path / "run", "--hold-out", "held", "--batch", 2, "--workers", 0]
        monkeypatch.setattr("sys.argv", ["train", *map(str, options), "--threads", "1", *map(str, more)])
        train.main()
        return torch.load(tmp_path / "run" / "checkpoint.pt", map_location="cpu")

    first = run("--steps", 2)
    again = run("--steps", 2, "--resume")  # nothing left to do: what is read is what is written
    for part in ("network", "average"):
        assert all(torch.equal(first[part][name], again[part][name]) for name in first[part])
    further = run("--steps", 4, "--resume")
    assert (first["step"], again["step"], further["step"]) == (2, 2, 4)
    assert not torch.equal(first["network"]["maps.weight"], further["network"]["maps.weight"])
    assert further["optimiser"]["state"][0]["step"] == 4
    with pytest.raises(ValueError, match="atlantis"):
        run("--steps", 2, "--hold-out", "atlantis")
    # Two learn from the same crops, and end when their time is up.
    run("--steps", 1000, "--minutes", 0.002, "--network", "small", "lite0", "--start", tmp_path / "run/checkpoint.pt",
        FINDER_FILE)  # fmt: skip
    for kind in ("small", "lite0"):
        kept = torch.load(tmp_path / "run" / kind / "checkpoint.pt", map_location="cpu")
        assert kept["kind"] == kind and 0 < kept["step"] < 1000


def test_a_training_that_goes_on_between_two_lines_of_its_log_has_true_means_there(tmp_path):
    log = Log(tmp_path, every=100, batch=16, first=250, steps=1000)
    for step in range(251, 401):
        log.add(step, {"heat": 2.0})
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(line["step"], line["heat"]) for line in lines] == [(300, 2.0), (400, 2.0)]


def test_false_boxes_are_counted_at_equal_recall():
    boxes = Boxes(np.tile([50.0, 50, 40, 18, 0], (5, 1)), np.array([0.9, 0.8, 0.7, 0.6, 0.5]))
    line = at_equal_recall([Comparison(boxes, np.array([0, -1, 1, -1, -1]), np.tile([50.0, 50, 40, 18, 0], (2, 1)))])
    # The second of two vehicles is found at 0.7, below one false box; precision is 1 at the first and 2/3 at it.
    assert "2 vehicles, average precision 0.833" in line and "0.70: 1 (score 0.70)" in line


def test_rendered_vehicles_out_of_sight_are_nobodys_to_find(tmp_path):
    cv2.imwrite(str(tmp_path / "town.png"), np.zeros((60, 80, 3), np.uint8))
    rows = [{"cx": 20, "cy": 30, "length": 15, "width": 7, "angle": 0, "visible": v} for v in (1.0, 0.4)]
    (tmp_path / "town.truth.json").write_text(json.dumps({"boxes": rows}))
    (picture,) = rendered_scene([tmp_path / "town.png"]).pictures
    assert (len(picture.vehicles), len(picture.ignored), picture.picture.width) == (1, 1, 80)


def test_pictures_of_a_folder_are_listed_with_their_sizes(tmp_path):
    for name, shape in (("b.png", (20, 30, 3)), ("a.jpg", (40, 50, 3)), ("c.tif", (60, 70, 3))):
        cv2.imwrite(str(tmp_path / name), np.zeros(shape, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture")
    found = [(p.name, p.width, p.height) for p in picture_files(tmp_path)]
    assert found == [("a.jpg", 50, 40), ("b.png", 30, 20), ("c.tif", 70, 60)]
    assert Scene("s", [Labelled(picture_files(tmp_path)[0], NOTHING, NOTHING)]).length == data.NOMINAL_LENGTH


def test_pale_ground_changes_nothing_but_the_ground():
    scene = make_scene(3, extent_m=40.0, n_vehicles=10, style="carpark")
    pale = measurer_rendered.bleached(scene, np.random.default_rng(0))
    assert pale.vehicles is scene.vehicles
    changed = (pale.scenery.colour != scene.scenery.colour).any(1)
    assert changed.any() and (scene.scenery.corners[changed][..., 2] < measurer_rendered.FLAT).all()
    least, most = measurer_rendered.PALE_ALBEDO
    albedo = pale.scenery.colour[changed].mean(1)
    assert least <= albedo.min() and albedo.max() <= most and np.mean(pale.ground[1]) > np.mean(scene.ground[1])


def test_a_measurers_stray_is_told_apart_from_its_readers():
    """Places of known stray, read by readers with habits, margins and errors of their own."""
    from training.measurer.readers import Reading, stray

    rng = np.random.default_rng(5)
    own = rng.normal(0, (0.01, 0.03), (60, 2))  # of the measurer, by place
    habits, margins = rng.normal(0, 0.03, (4, 2)), rng.normal(0, 0.4, (4, 2))
    size = np.exp(rng.uniform(np.log(8), np.log(60), (60, 1))) * [2.4, 1.0]
    sigma = np.full(2, 0.01)
    readings = [
        Reading(
            own[place] + habits[k] + margins[k] / size[place] + error,
            sigma**2,
            size[place],
            reader=k,
            place=f"{place}",
        )
        for k in range(4)
        for place, error in enumerate(rng.normal(0, 0.02, (60, 2)))
        if rng.random() < 0.8
    ]
    assert np.sqrt(stray(readings)) == pytest.approx([0.01, 0.03], rel=0.35)
    alone = [replace(r, log_ratio=r.log_ratio - own[int(r.place)]) for r in readings]
    assert np.abs(stray(alone)).max() < 0.006**2, "what a reader has wrong for himself is not the measurer's"
