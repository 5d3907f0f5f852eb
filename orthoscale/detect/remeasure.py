"""Measures the detected vehicles once more: the measurer's edges replace the detector's.

The detector processes the whole picture at one zoom; the measurer processes each vehicle, in the picture's own pixels.
That costs 50 times more per vehicle. So of more than MOST boxes only MOST are measured, evenly over pictures and
scores. They show by how much the detector's boxes of this scene are too large, and the others are corrected by that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial

import numpy as np

from ..core.boxes import Boxes, distinct, overlap
from ..core.detections import Detections
from ..core.evenly import evenly
from ..core.normal import median_and_sd
from ..core.progress import Progress
from ..core.remarks import signed
from ..core.ruler import Ruler
from ..core.source import Picture
from ..system.threads import Threads
from .cache import Kept, as_text, content_key
from .effort import Effort
from .enlarged import enlargement
from .measurer import Measured, Measurer, MeasurerCard
from .shade import DARK, shadow_contrast, shadows
from .soft import less_sure, softness
from .windows import windows_about

MOST = 400  # boxes that are measured; more would reduce the scale's uncertainty by less than the margin's part of it
MOST_IN_FRAMES = 1500  # the same in frames: each vehicle has many boxes, in views that show how high boxes reach
AT_A_TIME = 8  # boxes that one thread measures at a time
# Probability of "none" from which a box does not count: then "none" is likelier than not. In eleven test scenes 4 of
# 1243 vehicles reach it, and 5 of the 127 boxes beside them that are not vehicles. At a tenth it would be 154 and 60,
# small dark vehicles most of all (training/measurer/README.md).
NONE = 0.5
WHY_NONE = "in which the measurer saw no vehicle"
SAME = 0.4  # IoU with the proposed box below which another thing was measured; boxes 30 % too large have 0.59


@dataclass(frozen=True)
class _Change:
    """How measuring changes the sizes of one scene's boxes: (2,) median log ratio of measured to detected lengths and
    widths, and (2,) its one-sigma scatter."""

    log_ratio: np.ndarray
    scatter: np.ndarray


@dataclass(frozen=True)
class _Seen:
    """What the measurer saw in some of the detected boxes.

    index, proposed, told : by picture name, the numbers of these boxes (K,) among the detected ones, the boxes
    themselves, and what it measured there. enlarged : factor that the pictures had been enlarged by. soft : `softness`
    of the pictures. too_large : (2,) log factor of length and width that was taken off dark vehicles.
    """

    index: dict[str, np.ndarray]
    proposed: dict[str, Boxes]
    told: dict[str, Measured]
    enlarged: Fraction
    soft: float
    too_large: np.ndarray


def remeasured(
    pictures: Sequence[Picture],
    found: Detections,
    measurer: Measurer,
    effort: Effort,
    progress: Progress | None = None,
    most: int = MOST,
) -> Detections:
    """`found` with the boxes that `measurer` measures in `pictures`, and with its ruler.

    Boxes that it takes for no vehicle are set aside. Each box has a sigma of its own; those that were measured have
    kinds. effort : only its workers and cache are used. most : boxes that are measured, at most.
    """
    by_name = {picture.name: picture for picture in pictures}
    index = _chosen({name: boxes for name, boxes in found.boxes.items() if name in by_name}, most)
    if not index and len(found):
        return found  # no picture of the detected vehicles is available
    return _merged(found, _measured(by_name, found, index, measurer, effort, progress), measurer)


def _measured(
    pictures: Mapping[str, Picture],
    found: Detections,
    index: dict[str, np.ndarray],
    measurer: Measurer,
    effort: Effort,
    progress: Progress | None,
) -> _Seen:
    """What `measurer` sees in the boxes of `found` with the numbers `index`, unsure edges moved out and shadows taken
    off."""
    proposed = {name: found.boxes[name][numbers] for name, numbers in index.items()}
    windows = windows_about(pictures, proposed)
    enlarged, contrast = enlargement(windows), shadow_contrast(windows)
    look = partial(measurer, enlarged=enlarged, contrast=contrast)
    settings = {"measurer": measurer.sha256, "enlarged": str(enlarged), "contrast": contrast}
    key = content_key([pictures[name] for name in index], settings) if effort.cache else None
    with Kept(key) as kept:
        raw = _looked_at(pictures, proposed, look, effort.threads, kept, progress)
    outlined, soft = _moved_out(raw, measurer.card, float(enlarged))
    told, too_large = _without_shadows(outlined, float(enlarged))
    return _Seen(index, proposed, told, enlarged, soft, too_large)


def _merged(found: Detections, seen: _Seen, measurer: Measurer) -> Detections:
    """`found` with the measured boxes where there are any, all others corrected as these changed, and the measurer's
    ruler."""
    card, change = measurer.card, _change(seen)
    boxes, aside = {}, {}
    for name, before in found.boxes.items():
        if name not in seen.index:
            boxes[name] = distinct(_corrected(before, change))
            continue
        vehicle = _is_vehicle(seen.told[name], seen.proposed[name])
        rest = np.setdiff1d(np.arange(len(before)), seen.index[name])
        measured = _of(seen.told[name], measurer)[vehicle]
        boxes[name] = distinct(Boxes.concatenate([_corrected(before[rest], change), measured]))
        if not vehicle.all():
            aside[name] = seen.proposed[name][~vehicle]
    return replace(
        found.setting_aside(WHY_NONE, aside),
        boxes=boxes,
        ruler=_in_detector_pixels(less_sure(card.ruler, seen.enlarged, seen.soft), found.zoom * float(seen.enlarged)),
        effective_height=card.effective_height,
        undercut=card.undercut,
        body=card.body,
        detector=f"{found.detector}, measured by {card.name}",
        detector_sha256=measurer.sha256,
        notes=(*found.notes, *_notes(seen)),
    )


def _notes(seen: _Seen) -> Iterator[str]:
    """What measuring changed in the sizes, for the report, which counts the boxes set aside by itself."""
    length, width = (signed(each) for each in np.expm1(seen.too_large))
    if {length, width} != {signed(0.0)}:
        yield f"shadows make dark vehicles appear larger, by {length} in length and {width} in width: corrected"
    which, their = ("picture is", "its") if len(seen.index) == 1 else ("pictures are", "their")
    if seen.enlarged > 1:
        yield f"the {which} enlarged {float(seen.enlarged):g} times beyond {their} detail: measured at reduced size"
    if round(seen.soft, 2) > 1:
        yield f"the {which} soft: {their} edges are {seen.soft:.2f} times as uncertain as sharp ones"


def _chosen(boxes: Mapping[str, Boxes], most: int) -> dict[str, np.ndarray]:
    """Which boxes of each picture are measured: all, or `most` of them, evenly over pictures and scores."""
    order = [(name, k) for name, some in boxes.items() for k in np.argsort(-some.score, kind="stable").tolist()]
    chosen: dict[str, list[int]] = {}
    for name, k in (order[n] for n in evenly(len(order), most)):
        chosen.setdefault(name, []).append(k)
    return {name: np.array(index) for name, index in chosen.items()}


def _looked_at(
    pictures: Mapping[str, Picture],
    proposed: Mapping[str, Boxes],
    look: Callable[[Picture, Boxes], Measured],
    workers: int,
    kept: Kept,
    progress: Progress | None,
) -> dict[str, Measured]:
    """Results of `look` for the `proposed` boxes of each picture; those that the cache `kept` has are not computed
    again."""
    rows: dict[str, list[np.ndarray | None]] = {}
    jobs = []
    for name, boxes in proposed.items():
        rows[name] = [_kept(kept, pictures[name], box) for box in boxes.xylwa]
        new = [k for k, row in enumerate(rows[name]) if row is None]
        jobs += [(name, np.array(new[k : k + AT_A_TIME])) for k in range(0, len(new), AT_A_TIME)]
    with Threads(workers) as pool:
        looks = pool.map(lambda job: look(pictures[job[0]], proposed[job[0]][job[1]]), jobs)
        for done, ((name, index), told) in enumerate(zip(jobs, looks, strict=True), 1):
            for k, row in zip(index, told.rows, strict=True):
                rows[name][k] = row
                kept.keep(_row_name(pictures[name], proposed[name].xylwa[k]), row.astype("<f8").tobytes())
            if progress:
                progress("Measuring vehicles", done, len(jobs))
    return {name: Measured.of_rows(np.array(rows[name]), boxes.score) for name, boxes in proposed.items()}


def _moved_out(told: Mapping[str, Measured], card: MeasurerCard, pixel: float) -> tuple[dict[str, Measured], float]:
    """`told` with unsure edges moved outwards to the vehicles' outlines, and how soft the pictures are (`softness`).

    pixel : size of the pixels that were looked at [px of the picture].
    """
    if not (card.inward and any(card.sure) and told):
        return dict(told), 1.0
    every = [(t.sigma / card.sure_sigma(t.boxes.length, pixel))[t.kind[:, -1] < NONE] for t in told.values()]
    soft = softness(np.concatenate(every))
    moved = {name: t.moved_out(card.outward(t.sigma, t.boxes.length, pixel, soft)) for name, t in told.items()}
    return moved, soft


def _without_shadows(told: Mapping[str, Measured], pixel: float) -> tuple[dict[str, Measured], np.ndarray]:
    """`told` without the shadows in the boxes of dark vehicles, and (2,) the log factor of length and width that this
    takes off. pixel : as in `_moved_out`."""
    vehicles = [(t.boxes.sides, t.light, t.kind[:, -1] < NONE) for t in told.values()]
    every = [(np.log(sides[vehicle]), light[vehicle]) for sides, light, vehicle in vehicles]
    too_large = np.zeros(2)
    if every:
        log_size, light = (np.concatenate(part) for part in zip(*every, strict=True))
        too_large = shadows(log_size, light, pixel)
    without = {}
    for name, t in told.items():
        xylwa = t.boxes.xylwa.copy()
        xylwa[t.light < DARK, 2:4] *= np.exp(-too_large)
        without[name] = replace(t, boxes=replace(t.boxes, xylwa=xylwa))
    return without, too_large


def _row_name(picture: Picture, box: np.ndarray) -> str:
    return f"{as_text(picture)}:{','.join(map(repr, box.tolist()))}"


def _kept(kept: Kept, picture: Picture, box: np.ndarray) -> np.ndarray | None:
    content = kept.content(_row_name(picture, box))
    return None if content is None else np.frombuffer(content, "<f8")


def _is_vehicle(told: Measured, proposed: Boxes) -> np.ndarray:
    """(N,) bool: whether it is a vehicle, and the one that was proposed."""
    return (told.kind[:, -1] < NONE) & (overlap(told.boxes.xylwa, proposed.xylwa) >= SAME)


def _of(told: Measured, measurer: Measurer) -> Boxes:
    """The measured boxes with their sigma (relative, one sigma of length and width) and their kinds, as probabilities
    given that they are vehicles."""
    sigma = told.size_sigma * measurer.card.sigma_times / told.boxes.sides
    kinds = told.kind[:, :-1] / np.maximum(told.kind[:, :-1].sum(1, keepdims=True), 1e-9)
    return replace(told.boxes, sigma=sigma, kinds=kinds)


def _change(seen: _Seen) -> _Change:
    before = Boxes.concatenate(list(seen.proposed.values()))
    after = Boxes.concatenate([seen.told[name].boxes for name in seen.proposed])
    if not len(after):
        return _Change(np.zeros(2), np.zeros(2))
    return _Change(*median_and_sd(np.log(after.sides / before.sides)))


def _corrected(boxes: Boxes, change: _Change) -> Boxes:
    xylwa = boxes.xylwa.copy()
    xylwa[:, 2:4] *= np.exp(change.log_ratio)
    return replace(boxes, xylwa=xylwa, sigma=np.repeat(change.scatter[None], len(boxes), 0))


def _in_detector_pixels(ruler: Ruler, zoom: float) -> Ruler:
    """A ruler given in pixels of which each is `zoom` detector pixels wide, converted to detector pixels, as
    `Detections` has it."""
    margin, margin_sd, noise = (
        tuple((zoom * np.array(value)).tolist()) for value in (ruler.margin, ruler.margin_sd, ruler.noise)
    )
    return replace(ruler, margin=margin, margin_sd=margin_sd, noise=noise)
