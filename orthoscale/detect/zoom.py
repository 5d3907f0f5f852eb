"""At what zoom does the detector see vehicles? Nobody knows the GSD, and a detector works only in its range of sizes.

A vehicle has one size in the picture, at whatever zoom it is looked at; a mistake has the size that the detector likes,
so it shrinks as the zoom grows. A sample of windows is therefore looked at over a whole pyramid of zooms.
Boxes that a neighbouring zoom confirms vote for their length in picture pixels; the length with most votes is the
vehicles', and the zoom that brings it to the detector's best length is the one to sweep at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from ..boxes import Boxes, matched, suppress
from ..errors import UsageError
from ..sources.picture import Picture
from .detector import Card
from .tiles import Detect, Tile, look, tiles

# Zooms looked at: octaves that bring vehicles of 8 to 400 px into the detector's range, each into that of two or three.
LEVELS = 2.0 ** np.arange(-4, 2.1, 1.0)
WINDOW = 768  # side of a sample window [px of the network's input]
# Network pixels looked at per zoom in the first round, about a second on two cores. Where a zoom is the right one these
# are 0.16 km2 of ground, whatever it is, so the same budget for all of them is fair.
BUDGET = 12e6
DECODED = 8.0  # pixels that are decoded in the time in which one is looked at (deflate: 18 ns against 150 ns)
WIDER = (4, 16)  # times as much in later rounds, but only at zooms where the rounds before promise vehicles
USUAL = (1 / 8, 1.0)  # where nothing is promised, zooms of drone pictures (1 to 12 cm/px) get one look more
PROMISING = 0.8  # votes that make a length worth another look; one vehicle that two zooms agree on gives as much
ENOUGH = 20.0  # votes (sum of scores) after which no further round is needed
CLEAR = (6.0, 0.35)  # so are fewer votes, where the second best length has less than this share of them
FEWEST = 3.0  # votes below which no zoom is right; five vehicles that two zooms agree on give more
SAME_BOX = 0.5  # overlap at which two zooms see the same vehicle
KERNEL = 0.12  # width of the vote histogram's kernel in log length, about the spread of a fleet's lengths
MAX_ZOOM = 4.0
HIGHEST_ZOOM = 10.0  # that may be asked for: vehicles are then 4 px long, half of what can be measured


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


def check_told(zoom: float | None, gsd_hint: float | None) -> None:
    """Raises UsageError for a --zoom or --gsd-hint that makes no sense; nothing needs to be read for that."""
    if zoom is not None and gsd_hint is not None:
        raise UsageError("--zoom and --gsd-hint say the same thing twice", "Give one of them.")
    for name, value in (("--zoom", zoom), ("--gsd-hint", gsd_hint)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} must be a positive number, not {value}")


def told_zoom(zoom: float | None, gsd_hint: float | None, card: Card, mean_length: float) -> float | None:
    """The zoom that was told, or that brings vehicles of `mean_length` [m] to the detector's best length where their
    size in pixels was; None where it is to be searched for. Raises UsageError, as `check_zoom`."""
    if gsd_hint is not None:
        zoom = card.best_length * gsd_hint / mean_length
    if zoom is not None:
        check_zoom(zoom, card)
    return zoom


def check_zoom(zoom: float, card: Card) -> None:
    """Raises UsageError for a zoom at which no vehicle could be seen, and which would take forever."""
    if zoom > HIGHEST_ZOOM:
        raise UsageError(
            f"a zoom of {zoom:.3g} would look for vehicles {card.best_length / zoom:.2g} px long",
            f"A zoom is detector pixels per picture pixel, {HIGHEST_ZOOM:g} at most; a GSD is in metres per pixel.",
        )


def search_zoom(
    pictures: Sequence[Picture],
    detect: Detect,
    card: Card,
    progress: Callable[[int, int], None] | None = None,
    seed: int = 0,
    workers: int = 1,
) -> ZoomChoice:
    """The zoom at which to sweep `pictures`, looked for on `workers` threads. Deterministic for a seed.

    All zooms are looked at a little. Then those that promise vehicles are looked at more widely, until the answer is
    clear; where none does, it is soon said that there are none.
    """
    longest = max(max(p.width, p.height) for p in pictures)
    levels = [_Level(float(z)) for z in LEVELS if longest * z >= 3 * card.usable_length[0]]
    order = np.random.default_rng(seed).permutation(len(pictures))

    def look_at(chosen: Sequence[_Level], budget: float) -> _Votes:
        with ThreadPoolExecutor(workers) as pool:
            for k, level in enumerate(chosen):
                windows = level.windows(pictures, order, budget)
                looks = pool.map(lambda window: look(pictures[window[0]], window[1], detect), windows)
                level.keep(windows, looks, card)
                if progress:
                    progress(k + 1, len(chosen))
        return _votes(levels)

    votes = look_at(levels, BUDGET)
    for times in WIDER:
        if votes.clear:
            break
        usable = np.array(card.usable_length)
        promised = [level for level in levels if votes.promises(usable / level.zoom)]
        if not promised and times == WIDER[0]:
            votes = look_at([level for level in levels if USUAL[0] <= level.zoom <= USUAL[1]], 2 * BUDGET)
            promised = [level for level in levels if votes.promises(usable / level.zoom)]
        if not promised or votes.clear:
            break
        votes = look_at(promised, times * BUDGET)
    return ZoomChoice(
        zoom=1.0 if votes.length is None else float(min(card.best_length / votes.length, MAX_ZOOM)),
        vehicle_px=votes.length if votes.best >= FEWEST else None,
        votes=votes.best,
        rival=votes.rival,
        table=votes.table,
    )


@dataclass
class _Level:
    """What has been seen at one zoom: boxes of usable length by picture number, in its pixels."""

    zoom: float
    parts: dict[int, list[Boxes]] = field(default_factory=dict)
    done: set[tuple[int, int, int]] = field(default_factory=set)
    spent: float = 0.0  # network pixels
    anchor: int = 0
    complete: bool = False

    def windows(self, pictures: Sequence[Picture], order: np.ndarray, budget: float) -> list[tuple[int, Tile]]:
        """Windows (picture number, tile) to look at next, until `budget` network pixels are spent, those before
        included; everything, where that costs no more. The same places serve every zoom, so that neighbouring zooms
        see the same vehicles."""
        if self.complete:
            return []
        if sum(p.width * p.height for p in pictures) * self.zoom**2 <= budget:
            everything = [(k, tile) for k, picture in enumerate(pictures) for tile in tiles(picture, self.zoom)]
            if sum(_cost(pictures[k], tile) for k, tile in everything) <= 2 * budget:
                self.complete, self.parts = True, {}
                return everything
        windows = []
        while self.spent < budget:
            index, sx, sy = _anchor(self.anchor, order)
            self.anchor += 1
            picture = pictures[index]
            span = max(1, int(WINDOW / self.zoom))
            width, height = min(span, picture.width), min(span, picture.height)
            x = int(np.clip(sx * picture.width - width / 2, 0, picture.width - width))
            y = int(np.clip(sy * picture.height - height / 2, 0, picture.height - height))
            out = max(1, round(width * self.zoom)), max(1, round(height * self.zoom))
            tile = Tile(x, y, width, height, *out)
            self.spent += _cost(picture, tile)  # also for a window seen before, so that small pictures come to an end
            if (index, x, y) not in self.done:
                self.done.add((index, x, y))
                windows.append((index, tile))
        return windows

    def keep(self, windows: Sequence[tuple[int, Tile]], looks: Iterable[Boxes], card: Card) -> None:
        """Add what was seen in `windows`."""
        low, high = card.usable_length
        for (index, _), boxes in zip(windows, looks, strict=True):
            usable = (boxes.length * self.zoom >= low) & (boxes.length * self.zoom <= high)
            self.parts.setdefault(index, []).append(boxes[usable])

    def boxes(self) -> dict[int, Boxes]:
        return {index: suppress(Boxes.concatenate(parts)) for index, parts in self.parts.items()}


@dataclass(frozen=True)
class _Votes:
    """length : the one with most votes [px of the picture], None without any; best, rival, table as in ZoomChoice.

    grid, votes : (K,) log lengths and the votes that they have.
    """

    length: float | None
    best: float
    rival: float
    table: list[tuple[float, int, int, float]]
    grid: np.ndarray
    votes: np.ndarray

    @property
    def clear(self) -> bool:
        """Whether looking on would change nothing."""
        return self.best >= ENOUGH or (self.best >= CLEAR[0] and self.rival < CLEAR[1])

    def promises(self, usable: np.ndarray) -> bool:
        """Whether a length between these two [px of the picture] has enough votes to look for more of it."""
        here = (self.grid >= np.log(usable[0])) & (self.grid <= np.log(usable[1]))
        return bool(self.votes[here].max(initial=0) >= max(PROMISING, self.best / 4))


def _votes(levels: Sequence[_Level]) -> _Votes:
    """Boxes that two neighbouring zooms agree on vote for their length."""
    lengths, weights, table = [], [], []
    before: dict[int, Boxes] = {}
    for level in levels:
        here = level.boxes()
        confirmed = [_confirmed(boxes, before.get(key)) for key, boxes in here.items()]
        for boxes, low in confirmed:
            lengths += [boxes.length, low.length]
            weights += [boxes.score, low.score]
        pairs = Boxes.concatenate([boxes for boxes, _ in confirmed])
        typical = float(np.median(pairs.length)) if len(pairs) else 0.0
        table.append((level.zoom, sum(map(len, here.values())), len(pairs), typical))
        before = here
    log_length, weight = np.log(np.concatenate(lengths or [np.ones(0)])), np.concatenate(weights or [np.ones(0)])
    if not len(log_length):
        return _Votes(None, 0.0, 0.0, table, np.empty(0), np.empty(0))
    grid = np.arange(log_length.min() - 0.1, log_length.max() + 0.1, 0.02)
    votes = (weight * np.exp(-0.5 * ((grid[:, None] - log_length) / KERNEL) ** 2)).sum(1)
    best = int(np.argmax(votes))
    elsewhere = votes[np.abs(grid - grid[best]) > 3 * KERNEL]
    rival = float(elsewhere.max(initial=0) / votes[best])
    return _Votes(float(np.exp(grid[best])), float(votes[best]), rival, table, grid, votes)


def _cost(picture: Picture, tile: Tile) -> float:
    """What a look costs, in network pixels: a large raster without overviews is decoded in full for the coarsest look.

    A picture that is decoded by windows says how many pixels by ``decoded_px``; a frame is decoded once for all zooms.
    """
    decoded_px = getattr(picture, "decoded_px", None)
    decoded = decoded_px(tile.width, tile.height, tile.out_width, tile.out_height) if decoded_px else 0.0
    return tile.out_width * tile.out_height + decoded / DECODED


def _anchor(number: int, order: np.ndarray) -> tuple[int, float, float]:
    """Place `number` of a sequence without end: picture, and where in it as shares of its width and height. Pictures
    take turns in `order`; places spread evenly at any length of the sequence (R2, Roberts 2018)."""
    golden = 1.32471795724474602596
    n = number + 1
    return int(order[number % len(order)]), (0.5 + n / golden) % 1, (0.5 + n / golden**2) % 1


def _confirmed(boxes: Boxes, others: Boxes | None) -> tuple[Boxes, Boxes]:
    """The pairs of boxes that two zooms agree on."""
    if others is None:
        return Boxes.empty(), Boxes.empty()
    i, j, _ = matched(boxes, others, SAME_BOX)
    return boxes[i], others[j]
