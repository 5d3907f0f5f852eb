"""Searches for anchors in pictures of roughly known scale: window by window, each kind at the resolution it needs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..core.anchors import Anchor, AnchorFinder, Standard, alike
from ..core.detections import Tile
from ..core.source import Picture
from ..detect.cache import RASTER_CODE, Kept, content_key, tile_name
from ..detect.effort import Effort
from ..detect.filled import filled, one_grey
from ..detect.order import visiting_order
from ..detect.tiles import check_number, read, tiles
from ..detect.workers import done_on_threads
from ..system import budget

WINDOW_SIDE = 1024  # [px that a finder sees] side of a window for small anchors
WINDOW_EXTENTS = 4.0  # least side of a window in anchors' extents: a quarter of each side is seen twice
LARGEST_WINDOW = 2048  # [px that a finder sees]
SHARE_OF_MEMORY = 0.5  # of the memory budget, for all finders together
BYTES_EACH = 80  # [byte] that a finder takes per pixel: eight maps of directions, and some of floats
SPARE = 16  # [px that a finder sees] by which windows overlap beyond the extent
WINDOW_LISTS = 16  # lists of all windows that exist at once: one for each kind, and in the order of the visits
FIRST_WINDOWS = 16  # looked at in one batch for each kind, before it is decided whether they are enough
ENOUGH_ANCHORS = 8  # of a kind, after which more hardly help: half of their variance is common to all
# Pixels, as a finder sees them, after which the search for a kind ends: some 20 s on two cores at 1 s/Mpx. The windows
# are spread evenly, so that common anchors are found.
MOST_PIXELS = 20e6
MIDDLE_OF_PIXEL = 0.5  # [px] from a pixel's upper left corner to its centre, the origin of finders' coordinates
CODE_OF_FINDERS = (
    "anchors/*.py",
    "core/anchors.py",
    "core/angles.py",
    "core/linked.py",
    "core/normal.py",
    *RASTER_CODE,
    "sources/picture_file.py",
    "sources/ground_picture.py",
)


@dataclass(frozen=True)
class Sought:
    """What to search for, and where: a finder, and pictures with their rough ground sampling distances [m/px]."""

    finder: AnchorFinder
    pictures: Sequence[tuple[Picture, float]]


def search(
    sought: Sequence[Sought],
    gsd_sd: float,
    country: str = "",
    effort: Effort | None = None,
    most_pixels: float = MOST_PIXELS,
    enough: int = ENOUGH_ANCHORS,
    progress: Callable[[int, int], None] | None = None,
) -> list[Anchor]:
    """The anchors in pictures whose ground sampling distances are known to a relative one sigma of `gsd_sd`, each once
    per picture [px of the picture].

    Unless the `effort` is exhaustive, the search for a kind ends when `enough` of it are found or `most_pixels` were
    searched. The choice of windows depends only on the pictures, the scale and the effort's seed.
    `progress(done, total)` counts windows; the total is the most there may be.
    """
    effort = effort or Effort()
    workers = effort.threads
    parts = [_KindSearch(one, gsd_sd, country, effort, most_pixels, enough) for one in sought]
    with ExitStack() as open_things:
        for part in parts:
            part.cache = open_things.enter_context(AnchorCache(part.key() if effort.cache else None))
        while not all(part.done for part in parts):
            batch = [(part, number) for part in parts for number in part.next()]
            batch.sort(key=lambda one: one[0].place(one[1]))  # files are read fastest from the top, many only that way
            work: dict[int, dict[int, Callable[[], list[Anchor]]]] = {}  # by how many fit into memory at once
            for k, (part, number) in enumerate(batch):
                if not part.recalled(number):
                    work.setdefault(_at_once(part.jobs[number][1], workers), {})[k] = part.work(number)
            for at_once, some in work.items():
                for k, found in done_on_threads(some, at_once):
                    part, number = batch[k]
                    part.put(number, found)
                    if progress:
                        progress(sum(len(p.looks) for p in parts), sum(len(p.jobs) for p in parts))
    return [anchor for part in parts for anchor in part.found()]


def _at_once(window: Tile, workers: int) -> int:
    """How many windows like this the `workers` may search at the same time, within the memory budget."""
    needed = BYTES_EACH * window.out_width * window.out_height
    return max(1, min(workers, int(SHARE_OF_MEMORY * budget.memory() / needed)))


class _KindSearch:
    """The search of one kind: its windows in the order in which they are looked at, and what was found."""

    def __init__(
        self, sought: Sought, gsd_sd: float, country: str, effort: Effort, most_pixels: float, enough: int
    ) -> None:
        self.finder, self.gsd_sd, self.country = sought.finder, gsd_sd, country
        self.exhaustive, self.most_pixels, self.enough = effort.exhaustive, most_pixels, enough
        self.gsd = {picture.name: gsd for picture, gsd in sought.pictures}
        self.pictures = [picture for picture, gsd in sought.pictures if gsd <= self.finder.coarsest]
        windows = [(p, tile) for p in self.pictures for tile in windows_of(p, self.gsd[p.name], self.finder)]
        order = np.arange(len(windows))
        if not self.exhaustive:
            windows = [(picture, tile) for picture, tile in windows if filled(picture).share(tile)]
            if len(self.pictures) == 1:
                order = visiting_order([tile for _, tile in windows], np.ones(len(windows)), effort.seed)
            else:
                order = np.random.default_rng(effort.seed).permutation(len(windows))
        self.jobs = [windows[k] for k in order]
        self.looks: dict[int, list[Anchor]] = {}
        self.cache = AnchorCache(None)

    @property
    def done(self) -> bool:
        if len(self.looks) == len(self.jobs):
            return True
        if self.exhaustive or len(self.looks) < FIRST_WINDOWS:
            return False
        seen = sum(self.jobs[k][1].out_width * self.jobs[k][1].out_height for k in self.looks)
        return seen >= self.most_pixels or len(self.found()) >= self.enough

    def next(self) -> range:
        """Numbers of the windows to look at next."""
        if self.done:
            return range(0)
        count = len(self.jobs) if self.exhaustive else FIRST_WINDOWS
        return range(len(self.looks), min(len(self.looks) + count, len(self.jobs)))

    def place(self, number: int) -> tuple[str, int, int]:
        """Sort key that puts windows in the order of reading."""
        picture, tile = self.jobs[number]
        return picture.name, tile.y, tile.x

    def recalled(self, number: int) -> bool:
        """Take the result for window `number` from an earlier run's cache; whether there is one."""
        found = self.cache.get(*self.jobs[number])
        if found is not None:
            self.looks[number] = found
        return found is not None

    def work(self, number: int) -> Callable[[], list[Anchor]]:
        """The job of searching window `number`."""
        picture, tile = self.jobs[number]
        return partial(look, self.finder, picture, tile, self.gsd[picture.name], self.gsd_sd, self.country)

    def put(self, number: int, found: list[Anchor]) -> None:
        """Keep the anchors `found` in window `number`."""
        self.looks[number] = found
        self.cache.put(*self.jobs[number], found)

    def found(self) -> list[Anchor]:
        """All anchors found so far, each once per picture."""
        every = [anchor for number in sorted(self.looks) for anchor in self.looks[number]]
        return [
            anchor
            for picture in self.pictures
            for anchor in each_once([anchor for anchor in every if anchor.picture == picture.name])
        ]

    def key(self) -> str | None:
        # Not the default repr, a memory address, which would never match again.
        settled = repr(self.finder) if is_dataclass(self.finder) else repr(vars(self.finder))
        settings = {
            "finder": [type(self.finder).__name__, self.finder.kind, settled],
            "between": [self.finder.extent, self.finder.finest, self.finder.coarsest],
            "gsd": [sorted(self.gsd.items()), self.gsd_sd],
            "country": self.country,
        }
        return content_key(self.pictures, settings, CODE_OF_FINDERS)


def windows_of(picture: Picture, gsd: float, finder: AnchorFinder) -> list[Tile]:
    """Windows that cover a picture of `gsd` m/px so that every anchor lies wholly in one; where the picture is finer
    than the finder's `finest`, they are shrunk to that."""
    zoom = min(1.0, gsd / finder.finest)
    extent = finder.extent * zoom / gsd
    side = min(max(WINDOW_SIDE, math.ceil(WINDOW_EXTENTS * extent)), LARGEST_WINDOW)
    overlap = min(math.ceil(extent) + SPARE, side // 2)
    # Each picture alone, although the windows of all are in memory together: in a list each takes 270 byte, so those of
    # 10,000 frames, a dozen each, are 30 MB for each kind. Only a single huge picture has too many.
    check_number([picture], zoom, side, overlap, WINDOW_LISTS)
    return tiles(picture, zoom, side, overlap)


def look(
    finder: AnchorFinder, picture: Picture, tile: Tile, gsd: float, gsd_sd: float, country: str = ""
) -> list[Anchor]:
    """The anchors in one window of a picture of `gsd` m/px, in the picture's pixels. A window of one grey (no data)
    is not looked at."""
    image = read(picture, tile)
    if one_grey(image):
        return []
    factor = np.array([tile.width / tile.out_width, tile.height / tile.out_height])
    mean = float(np.sqrt(factor.prod()))
    corner = np.array([tile.x, tile.y])
    return [
        replace(
            anchor,
            place=(anchor.place + MIDDLE_OF_PIXEL) * factor + corner,
            lines=(anchor.lines + MIDDLE_OF_PIXEL) * factor + corner,
            pixels=anchor.pixels * mean,
            residual=anchor.residual * mean,
            picture=picture.name,
        )
        for anchor in finder.find(image, gsd * mean, gsd_sd, country)
    ]


def each_once(anchors: Sequence[Anchor]) -> list[Anchor]:
    """The anchors of one kind and picture, with only the surest of those that are the same object."""
    number = alike([anchor.lines for anchor in anchors], [anchor.pixels for anchor in anchors])
    best: dict[int, Anchor] = {}
    for k, anchor in zip(number.tolist(), anchors, strict=True):
        if k not in best or (anchor.false, anchor.relative_sd) < (best[k].false, best[k].relative_sd):
            best[k] = anchor
    return list(best.values())


class AnchorCache(Kept):
    """Anchors that were found in windows, as a list of objects in JSON."""

    def get(self, picture: Picture, tile: Tile) -> list[Anchor] | None:
        """What was found in `tile` before, or None. Raises nothing."""
        content = self.content(tile_name(picture, tile))
        return None if content is None else [_anchor(values) for values in json.loads(content)]

    def put(self, picture: Picture, tile: Tile, anchors: Sequence[Anchor]) -> None:
        """Keep what was found in `tile`. Raises nothing."""
        content = json.dumps([asdict(anchor) for anchor in anchors], default=lambda values: values.tolist())
        self.keep(tile_name(picture, tile), content.encode())


def _anchor(values: Mapping[str, Any]) -> Anchor:
    lines = np.array(values["lines"], float).reshape(-1, 2, 2)
    standards = tuple(Standard(**{**s, "countries": tuple(s["countries"])}) for s in values["standards"])
    arrays = {name: np.array(values[name], float) for name in ("place", "residual")}
    return Anchor(**{**values, **arrays, "lines": lines, "standards": standards, "unlike": tuple(values["unlike"])})
