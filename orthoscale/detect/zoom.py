"""At what zoom does the detector see vehicles? Nobody knows the GSD, and a detector works only in its range of sizes.

A vehicle has one size in the picture, at whatever zoom it is looked at; a mistake has the size that the detector likes,
so it shrinks as the zoom grows. A sample of windows is therefore looked at over a whole pyramid of zooms.
Boxes that a neighbouring zoom confirms vote for their length in picture pixels; the length with most votes is the
vehicles', and the zoom that brings it to the detector's best length is the one to sweep at.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ..boxes import Boxes, matched, suppress
from ..sources.picture import Picture
from .detector import Card
from .tiles import Detect, Tile, look

# Zooms looked at: octaves that bring vehicles of 8 to 400 px into the detector's range, each into that of two or three.
LEVELS = 2.0 ** np.arange(-4, 2.1, 1.0)
WINDOW = 768  # side of a sample window [px of the network's input]
BUDGET = 12e6  # network pixels looked at per zoom and round; about a second on two cores
ENOUGH = 20.0  # votes (sum of scores) after which no further round is needed
FEWEST = 3.0  # votes below which no zoom is right; five vehicles that two zooms agree on give more
ROUNDS = 3  # each looks at twice as much as the one before
SAME_BOX = 0.5  # overlap at which two zooms see the same vehicle
KERNEL = 0.12  # width of the vote histogram's kernel in log length, about the spread of a fleet's lengths
MAX_ZOOM = 4.0


@dataclass(frozen=True)
class ZoomChoice:
    """zoom : network pixels per picture pixel. vehicle_px : the vehicles' length in picture pixels, None if not found.

    votes : confidence-weighted boxes behind the choice; rival : share that the second best length got.
    table : per zoom (zoom, boxes, confirmed boxes, their median length in picture pixels).
    """

    zoom: float
    vehicle_px: float | None
    votes: float
    rival: float
    table: list[tuple[float, int, int, float]]


def search_zoom(
    pictures: Sequence[Picture],
    detect: Detect,
    card: Card,
    progress: Callable[[int, int], None] | None = None,
    seed: int = 0,
    workers: int = 1,
) -> ZoomChoice:
    """The zoom at which to sweep `pictures`, looked for on `workers` threads. Deterministic for a seed."""
    choice = ZoomChoice(1.0, None, 0.0, 0.0, [])
    for round_ in range(ROUNDS):
        budget = BUDGET * 4**round_
        choice = _look_over(pictures, detect, card, budget, progress, seed, workers)
        seen_all = sum(p.width * p.height for p in pictures) * LEVELS[-1] ** 2 <= budget
        if choice.votes >= ENOUGH or seen_all:
            break
    return choice


def _look_over(
    pictures: Sequence[Picture], detect: Detect, card: Card, budget: float, progress, seed: int, workers: int
) -> ZoomChoice:
    anchors = _anchors(pictures, seed, max(1, int(budget / WINDOW**2)))
    levels = [z for z in LEVELS if max(max(p.width, p.height) for p in pictures) * z >= 3 * card.usable_length[0]]
    lengths, weights, table = [], [], []
    before: dict[int, Boxes] = {}
    for k, zoom in enumerate(levels):
        here = _level(pictures, anchors, zoom, detect, budget, card, workers)
        confirmed = [_confirmed(boxes, before.get(key)) for key, boxes in here.items()]
        for boxes, low in confirmed:
            lengths += [boxes.length, low.length]
            weights += [boxes.score, low.score]
        pairs = Boxes.concatenate([boxes for boxes, _ in confirmed])
        table.append(
            (
                float(zoom),
                sum(map(len, here.values())),
                len(pairs),
                float(np.median(pairs.length)) if len(pairs) else 0.0,
            )
        )
        before = here
        if progress:
            progress(k + 1, len(levels))
    log_length, weight = np.log(np.concatenate(lengths or [np.ones(0)])), np.concatenate(weights or [np.ones(0)])
    if not len(log_length):
        return ZoomChoice(1.0, None, 0.0, 0.0, table)
    grid = np.arange(log_length.min() - 0.1, log_length.max() + 0.1, 0.02)
    votes = (weight * np.exp(-0.5 * ((grid[:, None] - log_length) / KERNEL) ** 2)).sum(1)
    best = int(np.argmax(votes))
    elsewhere = votes[np.abs(grid - grid[best]) > 3 * KERNEL]
    length = float(np.exp(grid[best]))
    return ZoomChoice(
        zoom=float(min(card.best_length / length, MAX_ZOOM)),
        vehicle_px=length if votes[best] >= FEWEST else None,
        votes=float(votes[best]),
        rival=float(elsewhere.max(initial=0) / votes[best]),
        table=table,
    )


def _anchors(pictures: Sequence[Picture], seed: int, count: int) -> list[tuple[int, float, float]]:
    """Places (picture, x share, y share) spread over the pictures by a low-discrepancy sequence (R2, Roberts 2018);
    the same places serve every zoom, so that neighbouring zooms see the same vehicles."""
    order = np.random.default_rng(seed).permutation(len(pictures))
    n = np.arange(1, count + 1)
    golden = 1.32471795724474602596
    x, y = (0.5 + n / golden) % 1, (0.5 + n / golden**2) % 1
    step = len(pictures) / max(count, 1)
    return [
        (
            int(order[int(k * step) % len(pictures) if count < len(pictures) else k % len(pictures)]),
            float(x[k]),
            float(y[k]),
        )
        for k in range(count)
    ]


def _level(
    pictures: Sequence[Picture],
    anchors: Sequence[tuple[int, float, float]],
    zoom: float,
    detect: Detect,
    budget: float,
    card: Card,
    workers: int,
) -> dict[int, Boxes]:
    """Boxes of usable length by picture, in its pixels, from windows around the anchors until the budget is used."""
    windows = _windows(pictures, anchors, zoom, budget)
    with ThreadPoolExecutor(workers) as pool:
        looks = list(pool.map(lambda window: look(pictures[window[0]], window[1], detect), windows))
    found: dict[int, list[Boxes]] = {}
    low, high = card.usable_length
    for (index, _), boxes in zip(windows, looks, strict=True):
        usable = (boxes.length * zoom >= low) & (boxes.length * zoom <= high)
        found.setdefault(index, []).append(boxes[usable])
    return {index: suppress(Boxes.concatenate(parts)) for index, parts in found.items()}


def _windows(
    pictures: Sequence[Picture], anchors: Sequence[tuple[int, float, float]], zoom: float, budget: float
) -> list[tuple[int, Tile]]:
    """Windows (picture, tile) around the anchors, each once, until the budget is used."""
    windows = []
    done: set[tuple[int, int, int]] = set()
    spent = 0.0
    for index, sx, sy in anchors:
        picture = pictures[index]
        span = max(1, int(WINDOW / zoom))
        width, height = min(span, picture.width), min(span, picture.height)
        x = int(np.clip(sx * picture.width - width / 2, 0, picture.width - width))
        y = int(np.clip(sy * picture.height - height / 2, 0, picture.height - height))
        if (index, x, y) in done:
            continue
        done.add((index, x, y))
        tile = Tile(x, y, width, height, max(1, round(width * zoom)), max(1, round(height * zoom)))
        spent += tile.out_width * tile.out_height
        windows.append((index, tile))
        if spent >= budget:
            break
    return windows


def _confirmed(boxes: Boxes, others: Boxes | None) -> tuple[Boxes, Boxes]:
    """The pairs of boxes that two zooms agree on."""
    if others is None:
        return Boxes.empty(), Boxes.empty()
    i, j, _ = matched(boxes, others, SAME_BOX)
    return boxes[i], others[j]
