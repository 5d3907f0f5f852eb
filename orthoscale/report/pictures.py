"""Pictures that a person judges in five seconds: where the vehicles are, and whether the boxes fit them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, cast

import cv2
import numpy as np

from ..boxes import Boxes
from ..errors import OutputError
from ..pipeline import Result
from ..sources.picture import Picture
from .drift_map import drift_panel

if TYPE_CHECKING:
    from ..sources.colmap import ColmapSource

USED, REJECTED = (40, 220, 60), (255, 70, 40)  # RGB
OVERVIEW = 1100  # longest side of the overview [px]
CHIPS, COLUMNS, CHIP = 24, 6, 150  # contact sheet: number, per row, side of one [px]
CHIP_SPAN = 1.7  # side of a chip in vehicle lengths
FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw(result: Result, path: Path) -> None:
    """Write a PNG: an overview with used (green) and rejected (red) vehicles, and a contact sheet of 24 of them;
    for a reconstruction a plan of its points and vehicles first (and only, when the frames are not at hand)."""
    panels = [_title(result)]
    pictures: dict[str, Picture] = {picture.name: picture for picture in result.pictures}
    if result.source.unit == "m/model-unit":
        panels.append(_plan(result))
    if pictures:
        panels.append(_overview(result, pictures[_busiest(result, pictures)]))
        panels.append(_contact_sheet(result, pictures))
    if result.drift is not None:
        (whole,) = result.source.pictures
        panels.append(drift_panel(result.drift, whole.width, whole.height, OVERVIEW))
    width = max(panel.shape[1] for panel in panels)
    sheet = np.concatenate([_padded(panel, width) for panel in panels])
    ok, png = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    if not ok:
        raise OutputError(f"{path}: the picture could not be encoded")
    path.write_bytes(png.tobytes())


def _used_boxes(result: Result) -> np.ndarray:
    """(M,) bool: boxes of vehicles that count."""
    used = np.zeros(len(result.boxes), bool)
    for member, counts in zip(result.votes.members, result.scale.used, strict=True):
        used[member] = counts
    return used


def _busiest(result: Result, pictures: Mapping[str, Picture]) -> str:
    """The picture that shows most vehicles that count."""
    names, counts = np.unique(result.picture[_used_boxes(result)], return_counts=True)
    at_hand = np.isin(names, list(pictures))
    return str(names[np.argmax(counts * at_hand)])


def _title(result: Result) -> np.ndarray:
    scale = result.scale
    low, high = scale.interval90
    lines = [
        f"{scale.value:.5g} {scale.unit}   90 %: {low:.5g} to {high:.5g}   {scale.verdict}",
        f"{scale.vehicles_used} vehicles used (green), {sum(scale.rejected.values())} rejected (red), "
        f"fleet {scale.fleet}; {result.source.path.name}",
    ]
    panel = np.full((62, OVERVIEW, 3), 255, np.uint8)
    for k, line in enumerate(lines):
        cv2.putText(panel, line, (10, 25 + 27 * k), FONT, 0.7 - 0.12 * k, (20, 20, 20), 2 - k, cv2.LINE_AA)
    return panel


def _overview(result: Result, picture: Picture) -> np.ndarray:
    zoom = OVERVIEW / max(picture.width, picture.height)
    image = picture.read(
        0, 0, picture.width, picture.height, max(1, round(picture.width * zoom)), max(1, round(picture.height * zoom))
    )
    here = result.picture == picture.name
    used = _used_boxes(result)
    image = _outlined(image, result.boxes[here & ~used].mapped(zoom), REJECTED)
    image = _outlined(image, result.boxes[here & used].mapped(zoom), USED)
    return image


def _outlined(image: np.ndarray, boxes: Boxes, colour: tuple[int, int, int], thickness: int = 1) -> np.ndarray:
    image = np.ascontiguousarray(image)
    for corners in boxes.corners:
        # Sixteenths of a pixel (shift=4); OpenCV's pixel centres are integers, ours end in .5.
        points = np.round((corners - 0.5) * 16).astype(np.int32)
        cv2.polylines(image, [points], True, colour, thickness, cv2.LINE_AA, shift=4)
    return image


def _contact_sheet(result: Result, pictures: Mapping[str, Picture]) -> np.ndarray:
    """24 vehicles, evenly chosen from all used ones by length, each with its box and size in metres."""
    votes, scale = result.votes, result.scale
    order = np.flatnonzero(scale.used)[np.argsort(votes.size[scale.used, 0])]
    chosen = order[np.unique(np.linspace(0, len(order) - 1, min(CHIPS, len(order))).round().astype(int))]
    chips = []
    for k in chosen:
        members = votes.members[k]
        best = members[np.argmax(result.boxes.score[members])]
        size = votes.size[k] * scale.value
        if (name := str(result.picture[best])) in pictures:
            chips.append(_chip(pictures[name], result.boxes[best : best + 1], size))
    chips += [np.full((CHIP, CHIP, 3), 255, np.uint8)] * (-len(chips) % COLUMNS)
    rows = [np.concatenate(chips[k : k + COLUMNS], 1) for k in range(0, len(chips), COLUMNS)]
    return np.concatenate(rows)


def _chip(picture: Picture, box: Boxes, size: np.ndarray) -> np.ndarray:
    span = max(8, int(box.length[0] * CHIP_SPAN))
    width, height = min(span, picture.width), min(span, picture.height)
    x = int(np.clip(box.centre[0, 0] - width / 2, 0, picture.width - width))
    y = int(np.clip(box.centre[0, 1] - height / 2, 0, picture.height - height))
    inner = CHIP - 4
    zoom = inner / span
    image = picture.read(x, y, width, height, round(width * zoom), round(height * zoom))
    image = _outlined(image, box.mapped(zoom, (-x * zoom, -y * zoom)), USED)
    chip = np.full((CHIP, CHIP, 3), 255, np.uint8)
    chip[2 : 2 + image.shape[0], 2 : 2 + image.shape[1]] = image
    label = f"{size[0]:.2f} x {size[1]:.2f} m"
    cv2.putText(chip, label, (6, CHIP - 9), FONT, 0.42, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(chip, label, (6, CHIP - 9), FONT, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
    return chip


def _plan(result: Result) -> np.ndarray:
    """Sparse points from above, in metres, with the vehicles where they stand."""
    scale, votes, source = result.scale, result.votes, cast("ColmapSource", result.source)
    xyz, colours = source.sparse
    order = np.argsort(source.ground.height_above(xyz))  # what stands higher is drawn later
    axes = _plan_axes(source.ground.up)
    points, vehicles, colours = xyz[order] @ axes.T, votes.place @ axes.T, colours[order]
    low, high = np.percentile(points, [1, 99], axis=0)
    low, high = np.minimum(low, vehicles.min(0)), np.maximum(high, vehicles.max(0))
    zoom = (OVERVIEW - 40) / (high - low).max()
    size = np.ceil((high - low) * zoom).astype(int) + 40

    def to_px(p: np.ndarray) -> np.ndarray:
        q = (p - low) * zoom + 20
        return np.stack([q[:, 0], size[1] - q[:, 1]], -1)

    panel = np.full((size[1], size[0], 3), 245, np.uint8)
    for (x, y), colour in zip(to_px(points).round().astype(int), colours.tolist(), strict=True):
        cv2.circle(panel, (int(x), int(y)), 1, colour, -1, cv2.LINE_AA)
    radius = max(3, round(float(np.median(votes.size[:, 0])) * zoom / 2))
    for (x, y), used in zip(to_px(vehicles).round().astype(int), scale.used, strict=True):
        cv2.circle(panel, (int(x), int(y)), radius, USED if used else REJECTED, 2, cv2.LINE_AA)
    # A scale bar of a round number of metres, about a quarter of the panel.
    metres = (OVERVIEW / 4) / zoom * scale.value
    step = 10.0 ** np.floor(np.log10(metres))
    metres = step * max(k for k in (1, 2, 5) if k * step <= metres)
    bar = round(metres / scale.value * zoom)
    cv2.line(panel, (20, size[1] - 14), (20 + bar, size[1] - 14), (0, 0, 0), 3)
    cv2.putText(panel, f"{metres:g} m", (28 + bar, int(size[1]) - 8), FONT, 0.55, (0, 0, 0), 1, cv2.LINE_AA)
    return panel


def _plan_axes(up: np.ndarray) -> np.ndarray:
    """(2, 3) unit vectors, right and up on the plan, for looking down along -`up`; which way is north is not known."""
    right = np.eye(3)[np.argmin(np.abs(up))]
    right = right - (right @ up) * up
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(up, right)])


def _padded(panel: np.ndarray, width: int) -> np.ndarray:
    return np.pad(panel, ((0, 8), (0, width - panel.shape[1]), (0, 0)), constant_values=255)
