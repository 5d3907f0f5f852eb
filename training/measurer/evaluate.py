r"""How good the measurer is, compared with the detector's own boxes.

    python -m training.measurer.evaluate --measurer M.onnx rendered runs/bank
    python -m training.measurer.evaluate --measurer M.onnx hidden runs/bank --data ../shared/data
    python -m training.measurer.evaluate --measurer M.onnx changes --found NAME=PICTURES:BOXES.json [--found ...]
    python -m training.measurer.evaluate --measurer M.onnx paint --found NAME=PICTURES:BOXES.json [--found ...]
    python -m training.measurer.evaluate --measurer M.onnx hand --data ../shared/data
    python -m training.measurer.evaluate --measurer M.onnx places --known NAME=PICTURES:BOXES.json:GSD:FLEET [...]
    python -m training.measurer.evaluate --measurer M.onnx kinds --data ../shared/data

`rendered`: held-out vehicles with exact edges, through many simulated cameras and with bad proposals; by size.
`hidden`: partly covered rendered and real vehicles: whether it recognises hidden edges, and its errors there.
`changes`: the same real vehicles after their picture was resampled, blurred, sharpened, ...: by how much their sizes
change. `paint`: by how much a scene's dark vehicles measure larger than its light ones, which is due to shadows.
`hand`: against edges read by eye (labels/by_hand.json). `places`: vehicles in pictures of known scale in metres,
against the fleet's mean. `kinds`: against kinds determined by eye (labels/kinds.json), at places that were not trained
on. BOXES.json holds the detector's boxes, which propose where to look.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.boxes import Boxes, matched
from orthoscale.core.normal import median_and_sd
from orthoscale.detect.detector import Detector
from orthoscale.detect.measurer import ANSWERS, Measured, Measurer
from orthoscale.detect.remeasure import NONE as AS_NONE
from orthoscale.detect.shade import LEAST_PAINTED, dark_and_light, larger
from orthoscale.detect.tiles import FunctionDetector
from orthoscale.fleets import load_fleet
from training.evaluate import BY_HAND, Labelled, Scene, measured_scenes, reference_scene, twice_seen
from training.kinds import LABELS as KINDS_BY_EYE

from .chain import photograph, pyramid, sharpen, stretch
from .confusion import card_entries
from .crops import BACKWARDS, HELD_OUT, proposal
from .real import READ as LEARNT
from .real import SLANTED, TOLD, WIDTH_HABIT, by_name, load, read_patches, told_patches
from .rendered import Rendered
from .rendered import rendered as rendering

SHIPPED = Path("orthoscale/detect/weights/small_vehicle.onnx")
KIND_SIZES = (12, 25, 50, 200)  # limits of the size classes of results on kinds [px]
SIZES = (8, 15, 25, 40, 60, 90, 121)  # limits of the size classes of other results, vehicle lengths [px]
AROUND = 1.6  # half side of the window around a vehicle's centre, in vehicle lengths
NONE = ANSWERS.index("none")
HIDDEN_BELOW = 0.5  # probability of being seen below which an edge counts as hidden
FEWEST = 3  # vehicles that a place needs to be used for the ruler
LEAST_SCATTER = (0.02, 0.05)  # (one sigma) of a vehicle's length and width about its reading, at least


def trusted(measured: Measured, limit: float = 0.12) -> np.ndarray:
    """(N,) bool: a vehicle, not a larger one, all edges seen, with a sigma below `limit` of its length and width."""
    size = measured.boxes.xylwa[:, 2:4]
    return (
        (measured.kind[:, NONE] < 0.5)
        & (measured.kind[:, ANSWERS.index("larger")] < 0.5)
        & (measured.seen > 0.5).all(1)
        & (measured.size_sigma / size < limit).all(1)
    )


# Rendered.


def rendered(measurer: Measurer, bank: Path, count: int, seed: int) -> str:
    rng = np.random.default_rng(seed)
    pictures = [Rendered.load(file) for file in sorted(bank.glob("scene_*.npz"))[:HELD_OUT]]
    rows, kinds = [], []
    levels = [pyramid(p.light) for p in pictures]
    while len(rows) < count:
        n = rng.integers(len(pictures))
        if not len(pictures[n].boxes):
            continue
        k = rng.integers(len(pictures[n].boxes))
        if not pictures[n].seen[k].all() or pictures[n].kind[k] == ANSWERS.index("larger"):
            continue
        shot = photograph(levels[n], pictures[n].boxes[k], rng, True)
        box, proposed = shot.box, proposal(shot.box, rng)
        told = measurer.in_pixels(shot.pixels, Boxes(proposed[None], np.ones(1)))
        error = np.log(told.boxes.xylwa[0, 2:4] / box[2:4])
        first = np.log(proposed[2:4] / box[2:4])
        sigma = told.size_sigma[0] / told.boxes.xylwa[0, 2:4]
        rows.append([box[2], *error, *first, *sigma, float(trusted(told)[0])])
        kinds.append((pictures[n].kind[k], told.kind[0].argmax()))
    t = np.array(rows)
    lines = ["length [px]   n trusted | length: bias spread  z-spread | width: bias spread z-spread | follows proposal"]
    for low, high in [*zip(SIZES[:-1], SIZES[1:], strict=True), (SIZES[0], SIZES[-1])]:
        here = (t[:, 0] >= low) & (t[:, 0] < high)
        s = t[here & (t[:, 7] > 0)]
        if len(s) < 5:
            continue
        bias, spread = median_and_sd(s[:, 1:3])
        _, z = median_and_sd(s[:, 1:3] / s[:, 5:7])
        follow = [np.polyfit(s[:, 3 + j], s[:, 1 + j].clip(-0.3, 0.3), 1)[0] for j in (0, 1)]
        lines.append(
            f"{low:4d} to {high:4d} {here.sum():5d} {len(s) / here.sum():6.2f}  | {100 * bias[0]:+10.2f} % "
            f"{100 * spread[0]:5.2f} % {z[0]:6.2f}    | {100 * bias[1]:+8.2f} % "
            f"{100 * spread[1]:5.2f} % {z[1]:6.2f}   | {follow[0]:+.3f} {follow[1]:+.3f}"
        )
    kinds_array = np.array(kinds)
    lines.append(f"kind right: {(kinds_array[:, 0] == kinds_array[:, 1]).mean():.2f}")
    return "\n".join(lines)


def shadows(measurer: Measurer, scenes: int, seed: int) -> str:
    """The same vehicles under the same cameras with and without cast shadows."""
    moved = []
    for number in range(scenes):
        pair = [rendering(50_000 + 100 * seed + number, overcast) for overcast in (True, False)]
        levels = [pyramid(p.light) for p in pair]
        for k in np.flatnonzero(pair[0].seen.all(1) & (pair[0].kind != ANSWERS.index("larger"))):
            sizes = []
            for n in (0, 1):
                rng = np.random.default_rng([seed, number, k])
                shot = photograph(levels[n], pair[n].boxes[k], rng, True)
                told = measurer.in_pixels(shot.pixels, Boxes(proposal(shot.box, rng)[None], np.ones(1)))
                sizes.append(np.append(np.log(told.boxes.xylwa[0, 2:4] / shot.box[2:4]), trusted(told)[0]))
            if sizes[0][2] and sizes[1][2]:
                moved.append([*(sizes[1][:2] - sizes[0][:2]), *sizes[1][:2]])
    m, s = median_and_sd(np.array(moved))
    return (
        f"{len(moved)} rendered vehicles: with shadows the length changes by {100 * m[0]:+.2f} % (spread "
        f"{100 * s[0]:.2f}), the width by {100 * m[1]:+.2f} % ({100 * s[1]:.2f}); bias with shadows "
        f"{100 * m[2]:+.2f} and {100 * m[3]:+.2f} %"
    )


def hidden(measurer: Measurer, bank: Path, data: Path, count: int, seed: int) -> str:
    """Held-out vehicles, rendered ones and those read by eye at test places, with a tree or black shade over or beside
    each: how well hidden edges are distinguished from others, and the resulting errors of length."""
    rng = np.random.default_rng(seed)
    ground = [p.pixels for file in sorted(bank.glob("real_*.npz")) for p in load(file) if p.kind == NONE]
    pictures = [Rendered.load(file) for file in sorted(bank.glob("scene_*.npz"))[:HELD_OUT]]
    drawn = [
        (p.light, box) for p in pictures for box, seen, kind in zip(p.boxes, p.seen, p.kind, strict=True)
        if seen.all() and kind != ANSWERS.index("larger")
    ]  # fmt: skip
    read = [
        (patch.pixels, patch.box) for scene in measured_scenes(data) if scene.name not in (*LEARNT, *SLANTED)
        for p in scene.pictures for patch in read_patches(p.picture.path, p.vehicles) if patch.whole
    ]  # fmt: skip
    lines = [
        "           n  hidden edges told | others told seen | whole vehicles kept | length of all, of those kept [%]"
    ]
    for name, vehicles, linear in (("rendered", drawn, True), ("read", read, False)):
        rows = []
        for k in rng.choice(len(vehicles), count):
            pixels, box = vehicles[k]
            shot = photograph(pyramid(pixels), box, rng, linear, ground[rng.integers(len(ground))], cover=1.0)
            told = measurer.in_pixels(shot.pixels, Boxes(proposal(shot.shown, rng, good=True)[None], np.ones(1)))
            backwards = np.cos(told.boxes.xylwa[0, 4] - shot.box[4]) < 0
            seen = told.seen[0][BACKWARDS] if backwards else told.seen[0]
            rows.append((shot.hidden, seen, np.log(told.boxes.xylwa[0, 2] / shot.box[2]), told.kind[0, NONE] < 0.5))
        truth, seen, error, vehicle = (np.array(column) for column in zip(*rows, strict=True))
        whole, kept = ~truth.any(1), (seen > HIDDEN_BELOW).all(1) & vehicle
        quartiles = [np.quantile(100 * error[some], (0.1, 0.25, 0.5, 0.75)).round(1) for some in (vehicle, kept)]
        told_hidden, told_seen = (seen[truth] < HIDDEN_BELOW).mean(), (seen[~truth] > HIDDEN_BELOW).mean()
        lines.append(
            f"{name:9s} {count:4d} {told_hidden:17.2f} | {told_seen:16.2f} | {kept[whole].mean():19.2f} | "
            f"{quartiles[0]} {quartiles[1]}"
        )
    return "\n".join(lines)


# Real vehicles.


def windows(scene: Scene, most: int, seed: int = 0) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pixels (H, W, 3) around at most `most` vehicles of a scene, RGB, and the vehicle's box (5,) in them."""
    rng = np.random.default_rng(seed)
    all_ = [(p, box) for p in scene.pictures for box in p.vehicles]
    for k in rng.permutation(len(all_))[:most]:
        labelled, box = all_[k]
        yield _window(labelled, box)


def _window(labelled: Labelled, box: np.ndarray, reach: float = AROUND) -> tuple[np.ndarray, np.ndarray]:
    p = labelled.picture
    half = reach * max(box[2], 2 * box[3])
    x0, y0 = np.maximum(np.floor(box[:2] - half), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(box[:2] + half), (p.width, p.height)).astype(int)
    pixels = p.read(int(x0), int(y0), int(x1 - x0), int(y1 - y0), int(x1 - x0), int(y1 - y0))
    return pixels, box - [x0, y0, 0, 0, 0]


class _Pixels:
    """An array as a `Picture`."""

    def __init__(self, pixels: np.ndarray) -> None:
        self.name, self.pixels = "window", pixels
        self.height, self.width = pixels.shape[:2]

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        from orthoscale.sources.picture_file import resized

        return resized(self.pixels[y : y + height, x : x + width], out_width, out_height)


def detected(detector: Detector, pixels: np.ndarray, box: np.ndarray) -> np.ndarray | None:
    """The detector's box of the vehicle in `box` (5,), both looks at its best zoom; None if it does not find it."""
    zoom = detector.card.best_length / box[2]
    sensitive = FunctionDetector(lambda image: detector(image, threshold=0.2))
    found = twice_seen([_Pixels(pixels)], zoom, sensitive)["window"]  # type: ignore[list-item]
    i, _, _ = matched(found, Boxes(box[None], np.ones(1)), 0.4)
    return found.xylwa[i[0]] if len(i) else None


Change = Callable[[np.ndarray], np.ndarray]


def _jpeg(quality: int) -> Change:
    def change(x: np.ndarray) -> np.ndarray:
        coded = cv2.imencode(".jpg", x[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return np.ascontiguousarray(cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1])

    return change


def _floating(change: Change) -> Change:
    def whole(x: np.ndarray) -> np.ndarray:
        return (change(x.astype(np.float32) / 255) * 255 + 0.5).clip(0, 255).astype(np.uint8)

    return whole


def _resample(factor: float, way: int) -> Change:
    return lambda x: cv2.resize(x, (round(x.shape[1] * factor), round(x.shape[0] * factor)), interpolation=way)


CHANGES: dict[str, Change] = {
    "resampled 0.7 (area)": _resample(0.7, cv2.INTER_AREA),
    "resampled 0.85 (area)": _resample(0.85, cv2.INTER_AREA),
    "resampled 1.2 (cubic)": _resample(1.2, cv2.INTER_CUBIC),
    "resampled 1.5 (cubic)": _resample(1.5, cv2.INTER_CUBIC),
    "resampled 1.5 (linear)": _resample(1.5, cv2.INTER_LINEAR),
    "blur 0.7 px": _floating(lambda x: cv2.GaussianBlur(x, (0, 0), 0.7)),
    "blur 1.2 px": _floating(lambda x: cv2.GaussianBlur(x, (0, 0), 1.2)),
    "sharpened 1": _floating(lambda x: sharpen(x, 1.0, 1.0)),
    "sharpened 2": _floating(lambda x: sharpen(x, 2.0, 1.5)),
    "haze 0.4": _floating(lambda x: x + 0.4 * (np.float32(0.75) - x)),
    "JPEG 60": _jpeg(60),
    "JPEG 40": _jpeg(40),
    "darker": _floating(lambda x: 0.75 * x**1.4),
    "brighter": _floating(lambda x: np.clip(1.25 * x**0.75, 0, 1)),
    "shadows black": _floating(lambda x: stretch(x, 0.1)),
    "grey": lambda x: np.repeat(cv2.cvtColor(x, cv2.COLOR_RGB2GRAY)[..., None], 3, 2),
    "quarter turn": lambda x: np.ascontiguousarray(np.rot90(x)),
    "mirror": lambda x: np.ascontiguousarray(x[:, ::-1]),
}

PROPOSED = (0.85, 1.15)  # times the detector's box


def _moved(name: str, before: np.ndarray, after: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, float]:
    """The box (5,) in the changed window, and the factor by which it is larger there."""
    if name == "quarter turn":
        return np.array([box[1], before.shape[1] - box[0], *box[2:4], box[4] - np.pi / 2]), 1.0
    if name == "mirror":
        return np.array([before.shape[1] - box[0], *box[1:4], np.pi - box[4]]), 1.0
    factor = np.array([after.shape[1] / before.shape[1], after.shape[0] / before.shape[0]])
    grown = float(np.sqrt(factor.prod()))
    return np.array([*(box[:2] * factor), *(box[2:4] * grown), box[4]]), grown


def changes(measurer: Measurer, detector: Detector | None, scenes: list[Scene], most: int) -> str:
    larger = {f"proposed {factor} times": np.array([1, 1, factor, factor, 1]) for factor in PROPOSED}
    told: dict[str, list[np.ndarray]] = {name: [] for name in (*CHANGES, *larger)}
    boxes: dict[str, list[np.ndarray]] = {name: [] for name in told}
    count = 0
    for scene in scenes:
        for pixels, box in windows(scene, most):
            first = measurer.in_pixels(pixels, Boxes(box[None], np.ones(1)))
            if not trusted(first, 0.08)[0]:
                continue
            count += 1
            seen = detected(detector, pixels, box) if detector else None
            for name, factor in larger.items():
                again = measurer.in_pixels(pixels, Boxes((box * factor)[None], np.ones(1)))
                told[name].append(np.log(again.boxes.xylwa[0, 2:4] / first.boxes.xylwa[0, 2:4]))
            for name, change in CHANGES.items():
                after = change(pixels)
                there, grown = _moved(name, pixels, after, box)
                again = measurer.in_pixels(after, Boxes(there[None], np.ones(1)))
                told[name].append(np.log(again.boxes.xylwa[0, 2:4] / grown / first.boxes.xylwa[0, 2:4]))
                if detector and seen is not None and (other := detected(detector, after, there)) is not None:
                    boxes[name].append(np.log(other[2:4] / grown / seen[2:4]))
    lines = [f"{count} vehicles of {', '.join(s.name for s in scenes)}: median change, spread [%]"]
    lines.append(f"{'':24s}{'measurer: length':>20s}{'width':>16s}{'detector: length':>22s}{'width':>16s}")
    for name in told:
        parts = []
        for values in (told[name], boxes[name]):
            if values:
                m, s = median_and_sd(np.array(values))
                parts += [f"{100 * m[j]:+8.2f} {100 * s[j]:5.2f}" for j in (0, 1)]
        lines.append(f"{name:24s}" + "  ".join(f"{p:>16s}" for p in parts))
    return "\n".join(lines)


def paint(measurer: Measurer, scenes: list[Scene], most: int) -> str:
    """Dark vehicles against light ones, by scene: difference of medians, and its standard error."""
    lines = [f"{'':20s} dark light | length [px] | dark ones longer [%] | wider [%]"]
    for scene in scenes:
        told = [measurer.in_pixels(pixels, Boxes(box[None], np.ones(1))) for pixels, box in windows(scene, most)]
        size = np.log([t.boxes.xylwa[0, 2:4] for t in told])
        groups = dark_and_light(size, np.array([t.light[0] for t in told]))
        if min(map(len, groups)) < LEAST_PAINTED:
            continue
        apart, variance = larger(*groups)
        apart, error = 100 * apart, 100 * np.sqrt(variance)
        lines.append(
            f"{scene.name:20s} {len(groups[0]):4d} {len(groups[1]):5d} | {np.exp(np.median(size[:, 0])):11.0f} | "
            f"{apart[0]:+12.1f} +- {error[0]:.1f} | {apart[1]:+6.1f} +- {error[1]:.1f}"
        )
    return "\n".join(lines)


@dataclass(frozen=True)
class Place:
    """A measurer's results for one place's vehicles: medians (2,) of the log ratios of length and width to the
    readings, their variances (2,), and the vehicles' median size (2,) [px]."""

    log_ratio: np.ndarray
    variance: np.ndarray
    size: np.ndarray


def variance_of(spread: np.ndarray, count: int) -> np.ndarray:
    """(2,) variance of a place's medians, from the `spread` (2,) of `count` vehicles."""
    # The variance of a median is pi / 2 times that of a mean. The least scatter is for few that agree by chance.
    return np.asarray(np.pi / 2 * np.maximum(spread, LEAST_SCATTER) ** 2 / count)


def margin(places: list[Place]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(2,) the margin [px] in length and width that fits the places; (2,) their additional scatter (log, one sigma),
    found by leaving each of them out; (2, 2) lowest and highest margin of these fits."""

    def fit(some: list[Place], stray: np.ndarray) -> np.ndarray:
        x = np.array([1 / p.size for p in some])
        weight = 1 / (np.array([p.variance for p in some]) + stray**2)
        return (weight * x * [p.log_ratio for p in some]).sum(0) / (weight * x**2).sum(0)

    stray = np.full(2, 0.02)
    for _ in range(20):
        without = np.array([fit(places[:k] + places[k + 1 :], stray) for k in range(len(places))])
        left = np.array([p.log_ratio - m / p.size for p, m in zip(places, without, strict=True)])
        excess = (left**2 - [p.variance for p in places]).mean(0)
        stray = np.sqrt(np.maximum(excess, 0.003**2))
    return fit(places, stray), stray, np.array([without.min(0), without.max(0)])


def against_readings(measurer: Measurer, detector: Detector, scene: Scene, width_habit: float = 1.0) -> np.ndarray:
    """(N, 6) for the vehicles of a scene that were read by eye: log ratios of the measurer's length and width, and of
    the detector's, to the readings, whose widths are multiplied by `width_habit`; whether the detector found the
    vehicle, and whether the measurer's result is `trusted`."""
    rows = []
    for p in scene.pictures:
        for read in p.vehicles:
            pixels, box = _window(p, read * [1, 1, 1, width_habit, 1], 2.2)
            seen = detected(detector, pixels, box)
            start = box if seen is None else seen
            told = measurer.in_pixels(pixels, Boxes(start[None], np.ones(1)))
            ratios = (np.log(found[2:4] / box[2:4]) for found in (told.boxes.xylwa[0], start))
            rows.append([*np.concatenate(list(ratios)), seen is not None, trusted(told)[0]])
    return np.array(rows, float)


def hand(measurer: Measurer, detector: Detector, data: Path, file: Path) -> str:
    places = []
    lines = ["log ratio to what was read [%]: median, spread; the median's own uncertainty is about spread / sqrt(n)"]
    lines.append(
        f"{'':12s}   n found trusted | {'measurer: length':>18s} {'width':>16s} | {'detector: length':>18s} width"
    )
    for scene in measured_scenes(data, file):
        t = against_readings(measurer, detector, scene, WIDTH_HABIT)
        ok = t[:, 5] > 0
        found = t[:, 4] > 0
        if ok.sum() < 3:
            continue
        m, s = median_and_sd(t[ok, :2])
        if scene.name not in (*LEARNT, *SLANTED) and ok.sum() >= FEWEST:
            size = np.median([b for p in scene.pictures for b in p.vehicles], axis=0)[2:4]
            places.append(Place(m, variance_of(s, ok.sum()), size * [1, WIDTH_HABIT]))
        dm, ds = median_and_sd(t[found, 2:4])
        lines.append(
            f"{scene.name:12s} {len(t):3d} {found.sum():4d} {ok.sum():5d}   | {100 * m[0]:+8.2f} {100 * s[0]:6.2f}    "
            f"{100 * m[1]:+8.2f} {100 * s[1]:6.2f} | {100 * dm[0]:+8.2f} {100 * ds[0]:6.2f}   "
            f"{100 * dm[1]:+8.2f} {100 * ds[1]:6.2f}"
        )
    fit, stray, (low, high) = margin(places)
    lines.append(f"{len(places)} places not learnt from: margin [px] (without one of them), stray of the one left out")
    for axis, name in enumerate(("length", "width")):
        lines.append(
            f"{name:6s} {fit[axis]:+.2f} px ({low[axis]:+.2f} to {high[axis]:+.2f}), {100 * stray[axis]:.1f} %"
        )
    return "\n".join(lines)


def places(measurer: Measurer, detector: Detector, known: list[tuple[Scene, float, str]], most: int) -> str:
    """Medians in metres, and log(median / fleet's mean), 0 if they agree: minus the error of the scale that they
    imply."""
    lines = [
        "median length x width [m]; by how much length and width exceed the fleet's [%], which makes the scale as much "
        "too small"
    ]
    lines.append(f"{'':20s}   n trusted | detector's boxes{'':12s}| measurer{'':20s}| fleet")
    margin = np.array(detector.card.ruler.margin)
    for scene, gsd, code in known:
        fleet = load_fleet(code).mean[:2]
        boxes, told, ok = [], [], []
        for pixels, box in windows(scene, most):
            measured = measurer.in_pixels(pixels, Boxes(box[None], np.ones(1)))
            boxes.append((box[2:4] - margin * fleet[0] / gsd / detector.card.best_length) * gsd)
            told.append(measured.boxes.xylwa[0, 2:4] * gsd)
            ok.append(trusted(measured)[0])
        ok = np.array(ok)
        b, t = (np.median(np.array(v)[ok], axis=0) for v in (boxes, told))
        eb, et = 100 * np.log(b / fleet), 100 * np.log(t / fleet)
        lines.append(
            f"{scene.name:20s} {len(ok):3d} {ok.sum():5d}   | {b[0]:.2f} x {b[1]:.2f}  {eb[0]:+5.1f} {eb[1]:+5.1f}   | "
            f"{t[0]:.2f} x {t[1]:.2f}  {et[0]:+5.1f} {et[1]:+5.1f}   | {code} {fleet[0]:.2f} x {fleet[1]:.2f}"
        )
    return "\n".join(lines)


def kinds(measurer: Measurer, data: Path, file: Path, longest: float) -> str:
    """The measurer's kinds against the true ones: mean shares by kind and by place, how often the likeliest is right,
    and the resulting entries of the card. Pictures of vehicles longer than `longest` px are first reduced to that."""
    told: dict[str, list[tuple[int, np.ndarray, float]]] = {}
    for scene, there in by_name(json.loads(file.read_text())["vehicles"], "scene").items():
        if scene in TOLD:
            continue
        for patch in told_patches(data, there):
            pixels, box = patch.pixels, patch.box
            if box[2] > longest:
                pixels = _resample(longest / box[2], cv2.INTER_AREA)(pixels)
                box, _ = _moved("", patch.pixels, pixels, box)
            said = measurer.in_pixels(pixels, Boxes(box[None], np.ones(1))).kind[0]
            told.setdefault(scene, []).append((patch.kind, said, patch.box[2]))
    everything = [one for scene in told.values() for one in scene]
    groups = {"all": everything}
    for low, high in pairwise(KIND_SIZES):
        groups[f"{low} to {high} px"] = [one for one in everything if low <= one[2] < high]
    lines = ["mean share given to each kind, by what it is (rows); likeliest: how often that is said", ""]
    lines.append(f"{'':22s}{'is':>8s}    n  " + "".join(f"{name:>8s}" for name in ANSWERS) + "  likeliest")
    for name, some in {**groups, **told}.items():
        for kind in range(len(ANSWERS)):
            if mine := [said for truth, said, _ in some if truth == kind]:
                right = np.mean([said.argmax() == kind for said in mine])
                shares = "".join(f"{share:8.2f}" for share in np.mean(mine, axis=0))
                lines.append(f"{name:22s}{ANSWERS[kind]:>8s} {len(mine):4d}  {shares}  {right:9.2f}")
    places = []
    for some in told.values():
        vehicles = [(truth, said[:NONE]) for truth, said, _ in some if truth < NONE and said[NONE] < AS_NONE]
        if vehicles:
            given = np.array([share for _, share in vehicles])
            places.append((np.array([truth for truth, _ in vehicles]), given / given.sum(1, keepdims=True)))
    return "\n".join([*lines, "", f"for the card's ruler: {json.dumps(card_entries(places))}"])


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measurer", type=Path, required=True)
    parser.add_argument("--detector", type=Path, default=SHIPPED, help="(%(default)s)")
    commands = parser.add_subparsers(dest="command", required=True)
    a = commands.add_parser("rendered")
    a.add_argument("bank", type=Path)
    a.add_argument("--count", type=int, default=600)
    a.add_argument("--seed", type=int, default=0)
    h = commands.add_parser("hidden")
    h.add_argument("bank", type=Path)
    h.add_argument("--data", type=Path, required=True)
    h.add_argument("--count", type=int, default=400)
    h.add_argument("--seed", type=int, default=0)
    s = commands.add_parser("shadows")
    s.add_argument("--scenes", type=int, default=5)
    s.add_argument("--seed", type=int, default=0)
    b = commands.add_parser("changes")
    b.add_argument("--found", action="append", required=True, metavar="NAME=PICTURES:BOXES.json")
    b.add_argument("--alone", action="store_true", help="the measurer without the detector")
    p = commands.add_parser("paint")
    p.add_argument("--found", action="append", required=True, metavar="NAME=PICTURES:BOXES.json")
    c = commands.add_parser("hand")
    c.add_argument("--data", type=Path, required=True)
    c.add_argument("--of", type=Path, default=BY_HAND, help="what was read (%(default)s)")
    d = commands.add_parser("places")
    d.add_argument("--known", action="append", required=True, metavar="NAME=PICTURES:BOXES.json:GSD:FLEET")
    e = commands.add_parser("kinds")
    e.add_argument("--data", type=Path, required=True)
    e.add_argument("--of", type=Path, default=KINDS_BY_EYE, help="what was told (%(default)s)")
    e.add_argument("--longest", type=float, default=np.inf, help="reduce longer vehicles to so many pixels")
    for command in (b, d):
        command.add_argument("--most", type=int, default=30, help="vehicles of each scene (%(default)s)")
    p.add_argument("--most", type=int, default=150, help="vehicles of each scene (%(default)s)")
    return parser.parse_args()


def told(measurer: Measurer, options: argparse.Namespace) -> str:
    """What the command of the options finds out, as text."""
    command = options.command
    if command == "rendered":
        return rendered(measurer, options.bank, options.count, options.seed)
    if command == "hidden":
        return hidden(measurer, options.bank, options.data, options.count, options.seed)
    if command == "shadows":
        return shadows(measurer, options.scenes, options.seed)
    if command == "kinds":
        return kinds(measurer, options.data, options.of, options.longest)
    if command == "paint":
        return paint(measurer, [reference_scene(text) for text in options.found], options.most)
    detector = Detector(options.detector, threads=1)
    if command == "hand":
        return hand(measurer, detector, options.data, options.of)
    if command == "changes":
        scenes = [reference_scene(text) for text in options.found]
        return changes(measurer, None if options.alone else detector, scenes, options.most)
    return places(measurer, detector, [known_scene(text) for text in options.known], options.most)


def known_scene(text: str) -> tuple[Scene, float, str]:
    """A scene, its metres per pixel and the code of its fleet, from ``NAME=PICTURES:BOXES.json:GSD:FLEET``."""
    scene, gsd, fleet = text.rsplit(":", 2)
    return reference_scene(scene), float(gsd), fleet


def main() -> None:
    options = arguments()
    cv2.setNumThreads(1)
    print(told(Measurer(options.measurer), options))


if __name__ == "__main__":
    main()
