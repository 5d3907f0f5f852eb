"""The scale search: finds the resampling factor that suits the detector, for pictures of unknown GSD.

A vehicle has the same size in the picture at every resampling factor; a false detection has the size that the detector
was trained for, so it shrinks in the picture as the factor grows. A sample of windows is therefore processed at a whole
pyramid of factors. Boxes that a neighbouring factor confirms vote for their length in picture pixels. The length with
the most significant votes is taken for the vehicles', and the factor that brings it to the detector's best length is
used for the sweep.

In a large picture two factors often agree by chance (glints on water, tiles, gravel). So a box's vote is its score
times a weight that depends on the share of boxes of about its length on which the two factors agree: 0.6 to 0.95 for
vehicles, 0.05 to 0.4 for anything else. Factors also differ in the area that was sampled: at a low factor a small
picture is soon seen as a whole, at a high one there is always more to see. The number of false votes grows with this
area, and their scatter with its square root; so votes are compared with this scatter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain, groupby, islice

import numpy as np

from ..core.boxes import SAME_VEHICLE, Boxes, matched, suppress
from ..core.confirmed import OF_MISTAKES, share_confirmed
from ..core.detections import Tile, ZoomChoice, ZoomLook
from ..core.equal_sizes import all_alike, more_of_the_same
from ..core.source import Picture
from ..errors import UsageError
from ..system.threads import Threads
from .detector import Card
from .filled import Filled, Windowed, filled
from .tiles import Detect, place, read, tiles

# Where these numbers come from: BUDGET's second and DECODED's ratio were measured on two cores. The rest follows from
# what each comment says, or was chosen by eye when the search was written (commits b828208, ab86001, 039154f), so that
# the search is right for vehicles of 8 to 400 px, few of them among many mistakes, and for ground without any
# (tests/test_zoom.py). No script has tuned them, and nobody has measured how much better others would be.
# Zooms that are tried: octaves. Two or three of them bring vehicles of 8 to 400 px into the detector's usable range.
ZOOM_LEVELS = 2.0 ** np.arange(-4, 2.1, 1.0)
WINDOW = 768  # side of a sample window [px of the network's input]
# Network pixels processed per zoom in the first round; about a second on two cores. At the right zoom they cover
# 0.16 km2 of ground, whatever that zoom is, so the same budget for all of them is fair.
BUDGET = 12e6
DECODED = 8.0  # pixels decoded in the time that the network takes for one (deflate: 18 ns against 150 ns)
READ_TOGETHER = 4  # windows of a picture that are read at once, at most; each takes 2 to 3 MB
WIDER = (4, 16)  # factors on BUDGET in later rounds, only for zooms that the rounds before found promising
USUAL = (1 / 8, 1.0)  # if no zoom is promising, those of drone pictures (1 to 12 cm/px) get one more look
PROMISING = 0.5  # votes that make a length worth another look; one vehicle that two zooms agree on gives as much
ENOUGH_VOTES = 14.0  # votes (of 1 at most each) after which no further round is needed
CLEAR_WINNER = (4.0, 0.35)  # fewer votes are enough, too, if the second best length has less than this share of them
FEWEST_VOTES = 2.0  # votes below which no zoom is right; five vehicles that two zooms agree on give more
# Share of boxes that two zooms agree on: up to the first it is that of mistakes, whose votes get the least weight; from
# the second on that of vehicles, whose votes count in full.
AGREED = (OF_MISTAKES, 0.6)
LEAST_VOTE = 0.05  # weight of a vote, however small the share of boxes that zooms agree on
MISTAKE_EVERY = 2e6  # on busy ground, network pixels for each mistake on which zooms agree by chance
WELL_SEEN = 20.0  # shorter boxes [px of the network] get the network's usual size, so cars all look alike
VISIBLE = 1.15  # factor on the least usable length, from which a zoom should confirm what another sees
KERNEL = 0.12  # width of the vote histogram's kernel in log length, about the spread of a fleet's lengths
VOTES_AT_ONCE = 8192  # votes that are counted at once
MAX_ZOOM = 4.0  # highest that the search chooses: vehicles of 8 px become 32 px long, and more enlarging shows no more
HIGHEST_ZOOM = 10.0  # highest that a user may ask for: it suits vehicles of 4 px, half of what can be measured


def user_zoom(zoom: float | None, gsd_hint: float | None, card: Card, mean_length: float) -> float | None:
    """The zoom that the user gives: `zoom`, or that at which vehicles of `mean_length` [m] have the detector's best
    length if the GSD is `gsd_hint` [m/px]. None if neither is given: it has to be searched for.

    Raises UsageError, as `check_zoom`.
    """
    if gsd_hint is not None:
        zoom = card.best_length * gsd_hint / mean_length
    if zoom is not None:
        check_zoom(zoom, card)
    return zoom


def check_zoom(zoom: float, card: Card) -> None:
    """Raises UsageError for a zoom that is too high: no vehicle could be seen, and the sweep would take forever."""
    if zoom > HIGHEST_ZOOM:
        raise UsageError(
            f"a resampling factor of {zoom:.3g} would search for vehicles {card.best_length / zoom:.2g} px long",
            f"It is detector pixels per picture pixel, {HIGHEST_ZOOM:g} at most; a GSD is in metres per pixel.",
        )


def search_zoom(
    pictures: Sequence[Picture],
    detect: Detect,
    card: Card,
    progress: Callable[[int, int], None] | None = None,
    seed: int = 0,
    workers: int = 1,
) -> ZoomChoice:
    """The zoom at which to sweep `pictures`, searched for on `workers` threads. Deterministic for a seed.

    All zooms get a small sample first. Then the promising ones get larger samples, until the answer is clear. If none
    is promising, the search soon ends without vehicles.
    """
    longest = max(max(p.width, p.height) for p in pictures)
    shown = [filled(picture) for picture in pictures]
    least = min(3 * card.usable_length[0] / longest, ZOOM_LEVELS[-1])  # some zoom is tried, however small a picture is
    levels = [_Level(float(z), shown) for z in ZOOM_LEVELS if z >= least]
    order = np.random.default_rng(seed).permutation(len(pictures))

    def look_at(chosen: Sequence[_Level], budget: float) -> _ZoomVotes:
        work = [level.windows(pictures, order, budget) for level in chosen]
        seen = iter(_looks(pictures, list(chain(*work)), detect, workers, progress))
        for level, windows in zip(chosen, work, strict=True):
            level.keep(windows, islice(seen, len(windows)), card)
        return _votes(levels, card.usable_length[0])

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
        zoom=1.0 if votes.length is None else zoom_for(votes.length, card),
        vehicle_px=votes.length if votes.best >= FEWEST_VOTES else None,
        votes=votes.best,
        rival_px=votes.rival_length,
        rival=votes.rival,
        looks=votes.looks,
        one_scale=len(pictures) == 1,
    )


def zoom_for(length: float, card: Card) -> float:
    """The zoom that suits vehicles of `length` [px of the picture] best."""
    return float(min(card.best_length / length, MAX_ZOOM))


def sample(pictures: Sequence[Picture], zoom: float, seed: int = 0) -> list[tuple[int, Tile]]:
    """Windows (picture number, tile) for a sample at `zoom` that costs as much as one zoom in the search's first
    round."""
    level = _Level(zoom, [filled(picture) for picture in pictures])
    return level.windows(pictures, np.random.default_rng(seed).permutation(len(pictures)), BUDGET)


def _looks(
    pictures: Sequence[Picture],
    windows: Sequence[tuple[int, Tile]],
    detect: Detect,
    workers: int,
    progress: Callable[[int, int], None] | None,
) -> list[Boxes]:
    """What `detect` sees in each of the `windows` (picture number, tile).

    Those of one picture, whatever their zoom, are read READ_TOGETHER at a time: memory holds few frames, and to decode
    one takes longer than to look at a window of it.
    """
    turn = sorted(range(len(windows)), key=lambda k: windows[k][0])  # stable: by zoom within a picture
    same = (list(numbers) for _, numbers in groupby(turn, key=lambda k: windows[k][0]))
    jobs = [numbers[k : k + READ_TOGETHER] for numbers in same for k in range(0, len(numbers), READ_TOGETHER)]

    def done(numbers: Sequence[int]) -> list[Boxes]:
        shown = [(windows[k][1], read(pictures[windows[k][0]], windows[k][1])) for k in numbers]
        return [place(detect(image), tile) for tile, image in shown]

    seen: dict[int, Boxes] = {}
    with Threads(workers) as pool:
        for numbers, boxes in zip(jobs, pool.map(done, jobs), strict=True):
            seen |= zip(numbers, boxes, strict=True)
            if progress:
                progress(len(seen), len(windows))
    return [seen[k] for k in range(len(windows))]


@dataclass
class _Level:
    """What was seen at one zoom so far.

    filled : where each picture shows anything. parts : boxes of usable length by picture number [px of the picture].
    done : (picture number, x, y) of the windows that were taken. next_place : number of the next place to look at.
    complete : whether the pictures were seen as a whole.
    """

    zoom: float
    filled: Sequence[Filled]
    parts: dict[int, list[Boxes]] = field(default_factory=dict)
    done: set[tuple[int, int, int]] = field(default_factory=set)
    spent: float = 0.0  # network pixels
    looked: float = 0.0  # network pixels in `parts` that may show anything
    next_place: int = 0
    complete: bool = False

    def windows(self, pictures: Sequence[Picture], order: np.ndarray, budget: float) -> list[tuple[int, Tile]]:
        """Windows (picture number, tile) to look at next, until `budget` network pixels are spent, earlier rounds
        included; all of the pictures if that costs no more. The same places serve every zoom, so that neighbouring
        zooms see the same vehicles. Empty places are left out."""
        if self.complete:
            return []
        shown = list(zip(pictures, self.filled, strict=True))
        if sum(picture.width * picture.height * where.area for picture, where in shown) * self.zoom**2 <= budget:
            everything = [
                (k, tile)
                for k, (picture, where) in enumerate(shown)
                for tile in tiles(picture, self.zoom)
                if where.share(tile)
            ]
            if sum(_cost(pictures[k], tile) for k, tile in everything) <= 2 * budget:
                self.complete, self.parts, self.looked = True, {}, 0.0
                return everything
        windows = []
        while self.spent < budget:
            index, sx, sy = _place(self.next_place, order)
            self.next_place += 1
            if not self.filled[index].at(sx, sy):
                continue
            picture = pictures[index]
            span = max(1, int(WINDOW / self.zoom))
            width, height = min(span, picture.width), min(span, picture.height)
            x = int(np.clip(sx * picture.width - width / 2, 0, picture.width - width))
            y = int(np.clip(sy * picture.height - height / 2, 0, picture.height - height))
            out = max(1, round(width * self.zoom)), max(1, round(height * self.zoom))
            tile = Tile(x, y, width, height, *out)
            self.spent += _cost(picture, tile)  # repeated windows count, too: else small pictures would loop forever
            if (index, x, y) not in self.done:
                self.done.add((index, x, y))
                windows.append((index, tile))
        return windows

    def keep(self, windows: Sequence[tuple[int, Tile]], looks: Iterable[Boxes], card: Card) -> None:
        """Add what was seen in `windows`."""
        low, high = card.usable_length
        for (index, tile), boxes in zip(windows, looks, strict=True):
            self.looked += tile.out_width * tile.out_height * self.filled[index].share(tile)
            usable = (boxes.length * self.zoom >= low) & (boxes.length * self.zoom <= high)
            self.parts.setdefault(index, []).append(boxes[usable])

    def boxes(self) -> dict[int, Boxes]:
        return {index: suppress(Boxes.concatenate(parts)) for index, parts in self.parts.items()}


@dataclass(frozen=True)
class _ZoomVotes:
    """length, rival_length : the two lengths with the most significant votes [px of the picture], None without any.
    best : votes of the first. rival, looks : as in ZoomChoice.

    grid, votes : (K,) log lengths, and the votes of each.
    """

    length: float | None
    best: float
    rival_length: float | None
    rival: float
    looks: list[ZoomLook]
    grid: np.ndarray
    votes: np.ndarray

    @property
    def clear(self) -> bool:
        """Whether further rounds would hardly change the choice."""
        return self.best >= ENOUGH_VOTES or (self.best >= CLEAR_WINNER[0] and self.rival < CLEAR_WINNER[1])

    def promises(self, usable: np.ndarray) -> bool:
        """Whether a length in the range `usable` (2,) [px of the picture] has votes enough for another round."""
        here = (self.grid >= np.log(usable[0])) & (self.grid <= np.log(usable[1]))
        return bool(self.votes[here].max(initial=0) >= max(PROMISING, self.best / 4))


@dataclass(frozen=True)
class _Ballots:
    """Boxes that vote: their lengths (N,) [px of the picture], the weight of each vote (N,), and the scatter of false
    votes (N,) in the area that was sampled at the box's zoom."""

    length: np.ndarray
    weight: np.ndarray
    chance: np.ndarray


def _votes(levels: Sequence[_Level], least_length: float) -> _ZoomVotes:
    """Boxes that two neighbouring zooms agree on vote for their length.

    least_length : of usable boxes at any zoom [px of the network].
    """
    ballots, looks = [], []
    lower: _Level | None = None
    there: dict[int, Boxes] = {}
    for level in levels:
        here = {key: _unlike(boxes, level.zoom) for key, boxes in level.boxes().items()}
        confirmed = [_confirmed(boxes, there.get(key)) for key, boxes in here.items()]
        pairs = Boxes.concatenate([boxes for boxes, _ in confirmed])
        if lower:
            # A window at a lower zoom contains that at a higher one, so it could have confirmed all boxes that are long
            # enough.
            seen = Boxes.concatenate(list(here.values())).length
            vote = _reliability(pairs.length, seen[seen * lower.zoom >= VISIBLE * least_length])
            chance = np.full(len(pairs), np.sqrt(1 + level.looked / MISTAKE_EVERY))
            for boxes in (pairs, Boxes.concatenate([low for _, low in confirmed])):
                ballots.append(_Ballots(boxes.length, vote * boxes.score, chance))
        looks.append(ZoomLook(level.zoom, sum(map(len, here.values())), len(pairs)))
        lower, there = level, here
    return _counted(ballots, looks)


def _counted(ballots: Sequence[_Ballots], looks: list[ZoomLook]) -> _ZoomVotes:
    """The lengths whose votes are largest in proportion to the scatter of false votes."""
    if not sum(len(some.length) for some in ballots):
        return _ZoomVotes(None, 0.0, None, 0.0, looks, np.empty(0), np.empty(0))
    log_length = np.log(np.concatenate([some.length for some in ballots]))
    weight = np.concatenate([some.weight for some in ballots])
    standing_each = weight / np.concatenate([some.chance for some in ballots])
    grid = np.arange(log_length.min() - 0.1, log_length.max() + 0.1, 0.02)
    votes = standing = np.zeros(len(grid))
    for k in range(0, len(weight), VOTES_AT_ONCE):
        block = slice(k, k + VOTES_AT_ONCE)
        near = np.exp(-0.5 * ((grid[:, None] - log_length[block]) / KERNEL) ** 2)
        votes, standing = votes + near @ weight[block], standing + near @ standing_each[block]
    best = int(np.argmax(standing))
    # The flank of a broad peak counts, too: if lengths scatter more than those of vehicles, some are of something else.
    # Of eleven pictures refused for it, five would get a scale by peaks alone, off by 1, 2, 7, 28 and 42 %.
    elsewhere = np.where(np.abs(grid - grid[best]) > 3 * KERNEL, standing, 0.0)
    second = int(np.argmax(elsewhere))
    rival = float(elsewhere[second] / standing[best])
    length, rival_length = np.exp(grid[[best, second]]).tolist()
    return _ZoomVotes(length, float(votes[best]), rival_length if rival else None, rival, looks, grid, votes)


def _unlike(boxes: Boxes, zoom: float) -> Boxes:
    """`boxes` found at `zoom` that may vote. Things that are too equal in size for vehicles do not; nor do boxes of
    about their length that are fewer, since they are probably more of the same."""
    alike = all_alike(boxes) & (boxes.length * zoom >= WELL_SEEN)
    if not alike.any():
        return boxes
    return boxes[~alike & ~more_of_the_same(boxes, alike)]


def _reliability(agreed: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(K,) weights, LEAST_VOTE to 1, of boxes that two zooms agree on.

    agreed : (K,) their lengths. seen : (N,) lengths of all boxes of one zoom that the other could have confirmed.
    """
    share = share_confirmed(agreed, agreed, seen)
    return np.clip((share - AGREED[0]) / (AGREED[1] - AGREED[0]), LEAST_VOTE, 1.0)


def _cost(picture: Picture, tile: Tile) -> float:
    """Cost of a look in network pixels, decoding included: a large raster without overviews is decoded in full even for
    the coarsest look.

    A picture that is decoded by windows says how many pixels; a frame is decoded once for all zooms.
    """
    size = tile.out_width, tile.out_height
    decoded = picture.decoded_px(tile.width, tile.height, *size) if isinstance(picture, Windowed) else 0.0
    return math.prod(size) + decoded / DECODED


def _place(number: int, order: np.ndarray) -> tuple[int, float, float]:
    """Place `number` of an endless sequence: picture, and position in it as shares of its width and height. Pictures
    take turns in `order`; positions are evenly spread at any length of the sequence (R2, Roberts 2018)."""
    golden = 1.32471795724474602596
    n = number + 1
    return int(order[number % len(order)]), (0.5 + n / golden) % 1, (0.5 + n / golden**2) % 1


def _confirmed(boxes: Boxes, others: Boxes | None) -> tuple[Boxes, Boxes]:
    """The pairs of boxes that two zooms agree on."""
    if others is None:
        return Boxes.empty(), Boxes.empty()
    i, j, _ = matched(boxes, others, SAME_VEHICLE)
    return boxes[i], others[j]
