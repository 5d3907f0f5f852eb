"""Finds the vehicles in a set of pictures: the scale search, then two detection passes over as many tiles as needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from ..core.boxes import Boxes
from ..core.confirmed import seldom_confirmed
from ..core.detections import Detections, Tile, ZoomChoice
from ..core.equal_sizes import all_alike, more_of_the_same
from ..core.progress import Progress, of_step
from ..core.remarks import amount
from ..core.source import Picture
from ..errors import EvidenceDisagrees, TooLittleEvidence
from .cache import TileCache, cache_key
from .coarse_pass import coarse_pass
from .cover import Cover
from .detector import Detector
from .effort import Effort
from .filled import filled
from .order import visiting_order
from .sweep import Found, Stop, sweep_twice
from .tie_break import settled
from .tiles import check_number, tiles
from .workers import visitor
from .zoom import search_zoom

WHY_EQUAL = "things of one size that stand together, as solar panels or graves do"
WHY_SELDOM = "of a size at which the two passes agree on few, as on mistakes"
ZOOM_FRAMES = 200  # frames of a model that the scale search gets; but for the lowest factors, it seldom needs more


def find_vehicles(
    pictures: Sequence[Picture],
    detector: Detector | None = None,
    zoom: float | None = None,
    progress: Progress | None = None,
    effort: Effort | None = None,
    sampling: Callable[[Detections], float] | None = None,
    cover: Cover | None = None,
) -> Detections:
    """Sweep `pictures` at the right zoom (searched for unless given). A vehicle must be detected in both passes.

    detector : the shipped one by default. zoom : detector pixels per picture pixel.
    sampling : computes the sampling part of the uncertainty from the detections so far (infinite if they are too few).
    The sweep then skips empty tiles and ends when this reaches the effort's target. Without it, all tiles are
    processed. cover : the order of overlapping frames. Then `cover.enough` of them are processed whatever the target,
    and more only while the evidence is too little.
    Raises TooLittleEvidence, EvidenceDisagrees.
    """
    effort = effort or Effort()
    detector = detector or Detector(threads=effort.threads_each)
    choice = None
    if zoom is None:
        choice = find_zoom(pictures, detector, progress, effort, cover)
        zoom = choice.zoom
    check_number(pictures, zoom)
    sweep = _Sweep(pictures, detector, zoom, choice, effort, progress)
    found = sweep.whole() if sampling is None or effort.exhaustive else sweep.until_enough(sampling, cover)
    found = _without(found, WHY_EQUAL, _equal_things)
    if len(pictures) == 1:
        # Not for frames: their distances vary, so vehicles have several lengths, and distant ones are seldom confirmed.
        found = _without(found, WHY_SELDOM, seldom_confirmed)
    return found


@dataclass(frozen=True)
class _Sweep:
    """What is swept, and how. zoom : detector pixels per picture pixel. choice : how it was searched for; None if the
    user gave it."""

    pictures: Sequence[Picture]
    detector: Detector
    zoom: float
    choice: ZoomChoice | None
    effort: Effort
    progress: Progress | None

    def whole(self) -> Detections:
        """What all tiles show."""
        jobs = [(picture, tile) for picture in self.pictures for tile in tiles(picture, self.zoom)]
        return self._detections(self._swept(jobs, np.arange(len(jobs)), None))

    def until_enough(self, sampling: Callable[[Detections], float], cover: Cover | None) -> Detections:
        """What the tiles show that are not empty, until they are enough; `sampling` and `cover` as in
        `find_vehicles`."""
        each = [
            [(picture, tile) for tile in tiles(picture, self.zoom) if filled(picture).share(tile)]
            for picture in self.pictures
        ]
        jobs = [job for some in each for job in some]
        order: Sequence[np.ndarray] | np.ndarray
        if cover is None:
            order = self._promising_first(jobs)
        else:
            of_picture = np.split(np.arange(len(jobs)), np.cumsum([len(some) for some in each])[:-1])
            order = [of_picture[k] for k in cover.order]
        enough = None if cover is None else cover.enough
        stop = Stop(lambda found: sampling(self._detections(found)), self.effort.target, enough)
        return self._detections(self._swept(jobs, order, stop))

    def _promising_first(self, jobs: Sequence[tuple[Picture, Tile]]) -> np.ndarray:
        """Numbers of an orthophoto's tiles, evenly spread wherever the sweep stops; those that the coarse pass finds
        promising tend to come sooner."""
        places = [tile for _, tile in jobs]
        evenly = visiting_order(places, np.ones(len(jobs)), self.effort.seed)
        progress = of_step(self.progress, "Coarse pass")
        promising = coarse_pass(jobs, evenly, self.detector, self.effort.threads, progress)
        return visiting_order(places, promising, self.effort.seed)

    def _swept(
        self, jobs: Sequence[tuple[Picture, Tile]], order: Sequence[np.ndarray] | np.ndarray, stop: Stop | None
    ) -> Found:
        """`sweep_twice`, with the cache and the workers of the effort."""
        detector, effort = self.detector, self.effort
        with ExitStack() as open_things:
            key = cache_key(self.pictures, detector, self.zoom) if effort.cache else None
            cache = open_things.enter_context(TileCache(key)) if key else None
            visit = open_things.enter_context(visitor(detector, effort.threads, effort.scheduler))
            progress = of_step(self.progress, "Finding vehicles")
            return sweep_twice(jobs, order, visit, cache, stop, progress, detector.sure, detector.passes)

    def _detections(self, found: Found) -> Detections:
        """`found` with the detector's ruler, and how the zoom was chosen."""
        card = self.detector.card
        return Detections(
            found.boxes,
            self.zoom,
            card.ruler,
            card.effective_height,
            self.detector.name,
            self.detector.sha256,
            doubtful=found.doubtful,
            objects=found.objects,
            swept=replace(found.swept, zoom_choice=self.choice),
            body=card.body,
            undercut=card.undercut,
            zoom_given=self.choice is None,
        )


def _without(found: Detections, why: str, doubted: Callable[[Boxes, Boxes], np.ndarray]) -> Detections:
    """`found` without the boxes that `doubted` selects; they are set aside, and a note says how many and `why`.

    doubted : from the boxes of one picture and its doubtful ones to (N,) bool of the former.
    """
    boxes, aside = dict(found.boxes), {}
    for name, seen in found.boxes.items():
        out = doubted(seen, found.doubtful.get(name, Boxes.empty()))
        if out.any():
            boxes[name], aside[name] = seen[~out], seen[out]
    if not aside:
        return found
    note = f"{amount(sum(map(len, aside.values())), 'boxes do not count')}: {why}"
    return replace(found.setting_aside(why, aside), boxes=boxes, notes=(*found.notes, note))


def _equal_things(boxes: Boxes, _: Boxes) -> np.ndarray:
    """(N,) bool: `boxes` of things too equal in size for vehicles, and what is probably more of the same."""
    alike = all_alike(boxes)
    return alike | more_of_the_same(boxes, alike) if alike.any() else alike


def find_zoom(
    pictures: Sequence[Picture], detector: Detector, progress: Progress | None, effort: Effort, cover: Cover | None
) -> ZoomChoice:
    """The zoom for the sweep; of overlapping frames with the order `cover`, by the first ZOOM_FRAMES. Raises
    TooLittleEvidence if none shows vehicles, EvidenceDisagrees if two are about equally likely."""
    if cover is not None:
        pictures = [pictures[k] for k in cover.first(ZOOM_FRAMES)]
    step = of_step(progress, "Scale search")
    choice = search_zoom(pictures, detector, detector.card, step, effort.seed, effort.threads)
    choice = settled(choice, pictures, detector, effort, step)
    if choice.vehicle_px is None:
        looks = choice.looks
        raise TooLittleEvidence(
            f"no vehicles found at any resampling factor from {looks[0].zoom:.2g} to {looks[-1].zoom:.2g} "
            f"({amount(sum(look.boxes for look in looks), 'boxes of low confidence')}, "
            f"{sum(look.confirmed for look in looks)} of them at two factors)",
            "If there are vehicles, give their size: --gsd-hint METRES_PER_PIXEL or --zoom FACTOR.",
        )
    if other := choice.as_likely:
        raise EvidenceDisagrees(
            f"vehicles may be {choice.vehicle_px:.0f} px long, or {other:.0f} px: both are about equally likely",
            f"Choose: --zoom {choice.zoom:.2g}, --zoom {detector.card.best_length / other:.2g}, or roughly how "
            "large a pixel is (--gsd-hint METRES_PER_PIXEL).",
        )
    return choice
