"""Sweeping pictures until enough is seen: tile by tile, or frame by frame, in an order that makes every stop fair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.boxes import SAME_VEHICLE, Boxes, matched, suppress
from ..core.detections import Swept, Tile
from ..core.source import Picture
from .cache import TileCache
from .tiles import Looks
from .workers import Visit

FIRST = 16  # tiles (or frames) that are looked at before asking whether they are enough
SMALLEST_BATCH = 4  # of any later batch
ON_TARGET = "enough for --target"
REPEATED = "the others show the same ground again"


@dataclass(frozen=True)
class Found:
    """Vehicles by picture name [px of the picture]: `boxes` that both looks show, `doubtful` that one alone does, or
    both without being sure. A box's score is the mean of both passes'.

    objects : those of a standard size that both looks show, by picture name and kind.
    """

    boxes: dict[str, Boxes]
    doubtful: dict[str, Boxes]
    swept: Swept
    objects: dict[str, dict[str, Boxes]] = field(default_factory=dict)


def sweep_twice(
    jobs: Sequence[tuple[Picture, Tile]],
    order: Sequence[int | np.ndarray] | np.ndarray,
    visit: Visit,
    cache: TileCache | None = None,
    spread: Callable[[Found], float] | None = None,
    target: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
    sure: float = 0.0,
    enough: int | None = None,
    second_measures: bool = True,
) -> Found:
    """Look at the tiles `jobs` in `order`, until `spread` of what was found is at most `target`.

    order : numbers of all jobs, each once; those of one frame, which are looked at together, as one array. enough : how
    many steps of it show all that there is: so many are looked at, and more only while the spread is infinite.

    `spread` is asked after batches of tiles that depend on nothing but what was found before, never on the time or on
    the number of workers, so the same tiles are visited every time. Without it all tiles are. `progress(done, total)`
    counts tiles, the total being a guess when a sweep may stop early. A vehicle counts when the mean score of its two
    looks is at least `sure`; its size is the geometric mean of theirs, or that of the first alone where not
    `second_measures`.
    """
    looks: dict[int, Looks] = {}
    cached = steps = 0
    batch = len(order) if spread is None else FIRST if enough is None else max(enough, 1)
    while True:
        # Files are read fastest from the top; many (JPEG, PNG) only so.
        numbers = sorted(n for step in order[steps : steps + batch] for n in np.atleast_1d(step).tolist())
        steps += batch
        expected = len(looks) + len(numbers)
        missing = {}
        for number in numbers:
            had = cache.get(*jobs[number]) if cache else None
            if had is None:
                missing[number] = jobs[number]
            else:
                looks[number] = had
                cached += 1
        if progress:
            progress(len(looks), expected)
        for number, seen in visit(missing):
            looks[number] = seen
            if cache:
                cache.put(*jobs[number], seen)
            if progress:
                progress(len(looks), expected)
        found = _assembled(jobs, looks, cached, sure, second_measures)
        if spread is None or len(looks) == len(jobs):
            return found
        reached = spread(found)
        if reached <= target if enough is None else np.isfinite(reached):
            return replace(found, swept=replace(found.swept, why=ON_TARGET if enough is None else REPEATED))
        batch = _next_batch(steps, reached / target if target > 0 else np.inf)


def _next_batch(seen: int, excess: float) -> int:
    """How many more steps, when the spread after `seen` of them is `excess` times the target: it falls with the square
    root of their number. At most as many again, because the guess is rough."""
    wanted = seen * (excess**2 - 1)
    return int(max(min(wanted, seen), SMALLEST_BATCH))


def _assembled(
    jobs: Sequence[tuple[Picture, Tile]], looks: dict[int, Looks], cached: int, sure: float, second_measures: bool
) -> Found:
    """Overlapping tiles put together: non-maximum suppression in each look, then what both looks show."""
    names = list(dict.fromkeys(picture.name for picture, _ in jobs))
    pairs: dict[str, list[tuple[Boxes, Boxes]]] = {name: [] for name in names}
    others: dict[str, dict[str, list[tuple[Boxes, Boxes]]]] = {name: {} for name in names}
    numbers = sorted(looks)
    for number in numbers:
        name, seen = jobs[number][0].name, looks[number]
        pairs[name].append((seen.fine, seen.coarse))
        for kind, pair in seen.objects.items():
            others[name].setdefault(kind, []).append(pair)
    boxes, doubtful, objects = {}, {}, {}
    for name in names:
        boxes[name], doubtful[name] = _in_both(pairs[name], sure, second_measures)
        both = {kind: _in_both(seen, sure, second_measures)[0] for kind, seen in others[name].items()}
        objects[name] = {kind: found for kind, found in both.items() if len(found)}
    swept = Swept([(jobs[n][0].name, jobs[n][1]) for n in numbers], len(jobs), cached, len(names))
    return Found(boxes, doubtful, swept, {name: kinds for name, kinds in objects.items() if kinds})


def _in_both(pairs: Sequence[tuple[Boxes, Boxes]], sure: float, second_measures: bool) -> tuple[Boxes, Boxes]:
    """Boxes that both passes over some tiles show, `sure` enough together, and the others of the first one."""
    first, second = (suppress(Boxes.concatenate([pair[k] for pair in pairs])) for k in (0, 1))
    i, j, _ = matched(first, second, SAME_VEHICLE)
    xylwa = first.xylwa[i].copy()
    if second_measures:
        xylwa[:, 2:4] = np.sqrt(xylwa[:, 2:4] * second.xylwa[j, 2:4])
    score = (first.score[i] + second.score[j]) / 2
    believed = score >= sure
    alone = np.ones(len(first), bool)
    alone[i[believed]] = False
    return Boxes(xylwa[believed], score[believed]), first[alone]
