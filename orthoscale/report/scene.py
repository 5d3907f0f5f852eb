"""The pictures of a report: the scene from above, the frame with most vehicles, and single vehicles.

Panels are pixels with outlines over them; `pictures` draws them into a PNG, `page` into HTML.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ..core.angles import unit_vector
from ..core.boxes import Boxes
from ..core.evenly import evenly
from ..core.round_numbers import scale_bar
from ..core.source import Picture, PosedSet, Source
from .anchors import size_of
from .stored import of_plan, pixel_size

OVERVIEW = 1600  # longest side of an overview [px]
CHIPS, REJECTED_CHIPS = 24, 8  # used and rejected vehicles that are shown one by one, as chips
CHIP = 180  # side of a chip [px]
CHIP_SPAN = 1.7  # side of a chip in vehicle lengths
ANCHOR_CROPS = 12  # anchors that are shown one by one, as crops
ANCHOR_CROP = 420  # longer side of a crop [px]
ANCHOR_BORDER = 0.12  # border around an anchor, as a share of its longer side
PAPER = 245  # grey of a plan's background
SMALLEST_MARK = 7  # smallest radius of a vehicle on a plan [px]


@dataclass(frozen=True)
class Outline:
    """points : (K, 2) corners [px of the panel]. used : whether the vehicle counts. label : its description."""

    points: np.ndarray
    used: bool
    label: str


@dataclass(frozen=True)
class Panel:
    """image : (h, w, 3) uint8 RGB. bar : scale bar, a round number of metres and its length [px]; only where the whole
    picture has one scale. fine : whether outlines are thin, because they lie on lines that must stay visible.
    """

    title: str
    image: np.ndarray
    outlines: Sequence[Outline]
    bar: tuple[float, float] | None = None
    reason: str = ""
    fine: bool = False


@dataclass(frozen=True)
class ReportPictures:
    """The pictures of a report; empty sequences where the source's own pictures are not at hand."""

    overviews: Sequence[Panel] = ()
    used: Sequence[Panel] = ()
    rejected: Sequence[Panel] = ()
    anchors: Sequence[Panel] = ()

    @classmethod
    def of(cls, report: Mapping[str, Any], source: Source | None) -> ReportPictures:
        """The pictures of a report, with the pixels of its `source`, as far as these are at hand."""
        vehicles, anchors = report["vehicles"], report["anchors"]
        pictures = _pictures(source, vehicles, anchors) if source else {}
        overviews = []
        if not of_plan(report):
            if vehicles or source:
                overviews.append(_plan(report, source.posed if source else None))
            name = _busiest(vehicles, pictures)
        else:
            name = _busiest(vehicles, report["pictures"])
        if name is not None:
            overviews.append(_overview(report, name, pictures.get(name)))
        used = [v for v in vehicles if v["used"]]
        rejected = [v for v in vehicles if not v["used"]]
        return cls(
            overviews,
            _chips(_some(sorted(used, key=lambda v: v["length"]), CHIPS), pictures),
            _chips(_some(sorted(rejected, key=lambda v: v["reason"]), REJECTED_CHIPS), pictures),
            anchor_panels(_some(anchors, ANCHOR_CROPS), pictures),
        )


def _pictures(source: Source, vehicles: Sequence[Mapping], anchors: Sequence[Mapping]) -> dict[str, Picture]:
    """The pictures at hand in which the vehicles' boxes and the anchors lie: the source's own, with its ground pictures
    if needed."""
    names = {box["picture"] for vehicle in vehicles for box in vehicle["boxes"]}
    names |= {anchor["picture"] for anchor in anchors}
    return pictures_of(source, ground=not names <= set(source.picture_names))


def pictures_of(source: Source, ground: bool = True) -> dict[str, Picture]:
    """The pictures of `source` that are at hand, by name. ground : with its ground pictures."""
    pictures: dict[str, Picture] = {p.name: p for p in source.pictures}
    if pictures and ground and source.posed is not None:
        pictures |= {p.name: p for p in source.posed.ground_pictures if p.frame is not None}
    return pictures


def _busiest(vehicles: Sequence[Mapping], pictures: Mapping[str, object]) -> str | None:
    """The name of the picture with most boxes of used vehicles; None if there are none."""
    counts = dict.fromkeys(pictures, 0)
    for vehicle in vehicles:
        for box in vehicle["boxes"]:
            if vehicle["used"] and box["picture"] in counts:
                counts[box["picture"]] += 1
    return max(counts, key=lambda name: counts[name]) if any(counts.values()) else None


def _overview(report: Mapping[str, Any], name: str, picture: Picture | None) -> Panel:
    width, height = report["pictures"][name] if picture is None else (picture.width, picture.height)
    zoom = min(1.0, OVERVIEW / max(width, height))
    size = max(1, round(width * zoom)), max(1, round(height * zoom))
    if picture is None:
        image = np.full((size[1], size[0], 3), PAPER, np.uint8)
    else:
        image = picture.read(0, 0, width, height, *size)
    outlines = [
        _outline(vehicle, box, zoom)
        for vehicle in report["vehicles"]
        for box in vehicle["boxes"]
        if box["picture"] == name
    ]
    flat = of_plan(report)
    bar = scale_bar(pixel_size(report)[0] / zoom, size[0]) if flat else None
    title = name if flat else f"{name}, the frame with most vehicles"
    return Panel(title, image, outlines, bar)


def _plan(report: Mapping[str, Any], source: PosedSet | None) -> Panel:
    """A model's sparse points from above, in metres, with its vehicles."""
    scale = float(report["scale"])
    vehicles = np.array([v["place_m"] for v in report["vehicles"]], float).reshape(-1, 2)
    points, colours = vehicles, np.full((len(vehicles), 3), PAPER, np.uint8)
    if source is not None:
        xyz, colours = source.sparse
        order = np.argsort(source.ground.height_above(xyz))  # higher points are drawn later
        points, colours = source.from_above(xyz[order]) * scale, colours[order]
    low, high = np.percentile(points, [1, 99], axis=0)
    low, high = np.minimum(low, vehicles.min(0, initial=np.inf)), np.maximum(high, vehicles.max(0, initial=-np.inf))
    border = 0.02 * (high - low).max()
    low, high = low - border, high + border
    zoom = OVERVIEW / (high - low).max()  # px per metre
    width, height = np.ceil((high - low) * zoom).astype(int)

    def to_px(plan: np.ndarray) -> np.ndarray:
        return np.stack([(plan[:, 0] - low[0]) * zoom, (high[1] - plan[:, 1]) * zoom], -1)

    image = np.full((height, width, 3), PAPER, np.uint8)
    dot = 2 if len(points) < 100_000 else 1
    pixels = to_px(points).round()
    # Points far outside of the picture, or not finite, are left out: OpenCV cannot take such numbers.
    shown = ((pixels >= -dot) & (pixels <= (width + dot, height + dot))).all(1)
    for (x, y), colour in zip(pixels[shown].astype(int).tolist(), colours[shown].tolist(), strict=True):
        cv2.circle(image, (x, y), dot, colour, -1)
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = unit_vector(turn)
    outlines = [
        Outline(centre + max(SMALLEST_MARK, v["length"] / 2 * zoom) * ring, v["used"], _label(v))
        for centre, v in zip(to_px(vehicles), report["vehicles"], strict=True)
    ]
    title = "The model from above" if source else "The vehicles from above"
    return Panel(title, image, outlines, scale_bar(1 / zoom, int(width)))


def _some(things: Sequence[Mapping], most: int) -> list[Mapping]:
    """`most` of them, evenly spread."""
    return [things[k] for k in evenly(len(things), most)]


def _chips(vehicles: Sequence[Mapping], pictures: Mapping[str, Picture]) -> list[Panel]:
    """A chip for each vehicle, cut out around its most confident box at hand."""
    chips = []
    for vehicle in vehicles:
        boxes = [box for box in vehicle["boxes"] if box["picture"] in pictures]
        if boxes:
            best = max(boxes, key=lambda box: box["score"])
            chips.append(_chip(vehicle, best, pictures[best["picture"]]))
    return chips


def _chip(vehicle: Mapping, box: Mapping, picture: Picture) -> Panel:
    cx, cy, length = box["xylwa_px"][:3]
    span = max(8, int(length * CHIP_SPAN))
    width, height = min(span, picture.width), min(span, picture.height)
    x = int(np.clip(cx - width / 2, 0, picture.width - width))
    y = int(np.clip(cy - height / 2, 0, picture.height - height))
    zoom = CHIP / span
    image = np.full((CHIP, CHIP, 3), PAPER, np.uint8)
    pixels = picture.read(x, y, width, height, round(width * zoom), round(height * zoom))
    image[: pixels.shape[0], : pixels.shape[1]] = pixels
    title = f"{vehicle['length']:.2f} × {vehicle['width']:.2f} m"
    return Panel(title, image, [_outline(vehicle, box, zoom, (-x * zoom, -y * zoom))], reason=vehicle["reason"])


def anchor_panels(anchors: Sequence[Mapping], pictures: Mapping[str, Picture]) -> list[Panel]:
    """A crop with the fitted lines for each of a report's `anchors` whose picture is at hand."""
    return [_crop(anchor, pictures[anchor["picture"]]) for anchor in anchors if anchor["picture"] in pictures]


def _crop(anchor: Mapping, picture: Picture) -> Panel:
    lines = np.array(anchor["lines_px"], float).reshape(-1, 2, 2)
    low, high = lines.min((0, 1)), lines.max((0, 1))
    border = max(4.0, ANCHOR_BORDER * float((high - low).max()))
    frame = np.array([picture.width, picture.height])
    first = np.clip(np.floor(low - border), 0, frame - 1).astype(int)
    size = np.maximum(np.clip(np.ceil(high + border), 1, frame).astype(int) - first, 1)
    zoom = ANCHOR_CROP / int(size.max())
    out = np.maximum(np.round(size * zoom).astype(int), 1)
    image = picture.read(*first.tolist(), *size.tolist(), *out.tolist())
    title = f"{anchor['kind']}: {size_of(anchor)}"
    outlines = [Outline((line - first) * zoom, anchor["counted"], title) for line in lines]
    return Panel(title, image, outlines, fine=True)


def _outline(vehicle: Mapping, box: Mapping, zoom: float, shift: tuple[float, float] = (0.0, 0.0)) -> Outline:
    corners = Boxes(np.array([box["xylwa_px"]]), np.ones(1)).mapped(zoom, shift).corners[0]
    return Outline(corners, vehicle["used"], _label(vehicle))


def _label(vehicle: Mapping) -> str:
    return f"{vehicle['length']:.2f} × {vehicle['width']:.2f} m, {vehicle['reason'] or 'used'}"
