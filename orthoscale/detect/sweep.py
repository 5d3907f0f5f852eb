"""The sweep: two detection passes, tile by tile or frame by frame. Whenever it stops, it has seen a fair sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.boxes import SAME_VEHICLE, Boxes, matched, suppress
from ..core.detections import Swept, Tile
from ..core.source import Picture
from .cache import TileCache
from .detector import Passes
from .tiles import Looks
from .workers import Visit

FIRST = 16  # tiles (or frames) that are processed before checking whether they are enough
SMALLEST_BATCH = 4  # tiles (or frames) of any later batch, at least
ON_TARGET = "enough for --target"
REPEATED = "the others show the same ground again"


@dataclass(frozen=True)
class Found:
    """Vehicles by picture name [px of the picture]: `boxes` that both passes show; `doubtful` ones that only the first
    shows, or both with too low a mean score. The score of `boxes` is the mean of both passes'.

    objects : objects of standard size that both passes show, by picture name and kind.
    """

    boxes: dict[str, Boxes]
    doubtful: dict[str, Boxes]
    swept: Swept
    objects: dict[str, dict[str, Boxes]] = field(default_factory=dict)


@dataclass(frozen=True)
class Stop:
    """When a sweep has seen enough: when the `spread` of what was found so far is at most `target`.

    spread : sampling part of the scale's uncertainty (relative, one sigma), infinite for too little evidence. It is
    computed after batches whose sizes depend only on what was found before, never on the time or on the number of
    workers, so the same tiles are visited every time. enough : number of steps of the order that show all there is to
    see, for frames. Then these are taken whatever the target, and more only while the spread is infinite.
    """

    spread: Callable[[Found], float]
    target: float = 0.0
    enough: int | None = None

    @property
    def first(self) -> int:
        """Steps before the spread is computed for the first time."""
        return FIRST if self.enough is None else max(self.enough, 1)

    def reached(self, spread: float) -> bool:
        """Whether `spread` is small enough."""
        return bool(spread <= self.target if self.enough is None else np.isfinite(spread))

    @property
    def why(self) -> str:
        """Why the sweep ended, for people."""
        return ON_TARGET if self.enough is None else REPEATED

    def further(self, steps: int, spread: float) -> int:
        """How many more steps will probably reach the target, if the spread is `spread` after `steps`: it falls with
        the square root of their number. At most as many again, because this is a rough guess."""
        excess = spread / self.target if self.target > 0 else np.inf
        return int(max(min(steps * (excess**2 - 1), steps), SMALLEST_BATCH))


def sweep_twice(
    jobs: Sequence[tuple[Picture, Tile]],
    order: Sequence[int | np.ndarray] | np.ndarray,
    visit: Visit,
    cache: TileCache | None = None,
    stop: Stop | None = None,
    progress: Callable[[int, int], None] | None = None,
    sure: float = 0.0,
    passes: Passes = Passes.FINE_FIRST,
) -> Found:
    """Process the tiles `jobs` in `order`, all of them or until `stop`.

    order : numbers of all jobs, each once; those of one frame, which are processed together, as one array.
    `progress(done, total)` counts tiles; the total is a guess if the sweep may stop early. A vehicle counts if the
    mean score of its two passes is at least `sure`. Its size is the geometric mean of theirs, or that of the fine one
    if `passes` are CONFIRMED.
    """
    looks: dict[int, Looks] = {}
    cached = steps = 0
    batch = len(order) if stop is None else stop.first
    while True:
        # Files are read fastest from top to bottom; many (JPEG, PNG) can be read only in this order.
        numbers = sorted(n for step in order[steps : steps + batch] for n in np.atleast_1d(step).tolist())
        steps += batch
        expected = len(looks) + len(numbers)
        kept = {n: had for n in numbers if (had := cache.get(*jobs[n])) is not None} if cache else {}
        looks |= kept
        cached += len(kept)
        if progress:
            progress(len(looks), expected)
        for number, seen in visit({n: jobs[n] for n in numbers if n not in kept}):
            looks[number] = seen
            if cache:
                cache.put(*jobs[number], seen)
            if progress:
                progress(len(looks), expected)
        found = _assembled(jobs, looks, cached, sure, passes)
        if stop is None or len(looks) == len(jobs):
            return found
        spread = stop.spread(found)
        if stop.reached(spread):
            return replace(found, swept=replace(found.swept, why=stop.why))
        batch = stop.further(steps, spread)


def _assembled(
    jobs: Sequence[tuple[Picture, Tile]], looks: dict[int, Looks], cached: int, sure: float, passes: Passes
) -> Found:
    """Merges overlapping tiles: non-maximum suppression in each pass, then what both passes show."""
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
        boxes[name], doubtful[name] = _in_both(pairs[name], sure, passes)
        both = {kind: _in_both(seen, sure, passes)[0] for kind, seen in others[name].items()}
        objects[name] = {kind: found for kind, found in both.items() if len(found)}
    swept = Swept([(jobs[n][0].name, jobs[n][1]) for n in numbers], len(jobs), cached, len(names))
    return Found(boxes, doubtful, swept, {name: kinds for name, kinds in objects.items() if kinds})


def _in_both(pairs: Sequence[tuple[Boxes, Boxes]], sure: float, passes: Passes) -> tuple[Boxes, Boxes]:
    """Boxes that the fine and the coarse pass over some tiles both show with a mean score of `sure` or more, and all
    other boxes of the pass that came first."""
    fine, coarse = (suppress(Boxes.concatenate([pair[k] for pair in pairs])) for k in (0, 1))
    i, j, _ = matched(fine, coarse, SAME_VEHICLE)
    xylwa = fine.xylwa[i].copy()
    if passes != Passes.CONFIRMED:
        xylwa[:, 2:4] = np.sqrt(fine.sides[i] * coarse.sides[j])
    score = (fine.score[i] + coarse.score[j]) / 2
    believed = score >= sure
    first, paired = (coarse, j) if passes == Passes.COARSE_FIRST else (fine, i)
    alone = np.ones(len(first), bool)
    alone[paired[believed]] = False
    return Boxes(xylwa[believed], score[believed]), first[alone]
