"""One PNG for visual inspection: where the vehicles are, and whether the boxes fit them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..formats.lettering import BLACK, WHITE, write_on
from ..formats.pictures import write_png
from ..system.paths import title_of
from .drift_map import drift_panel, regions_panel
from .scene import CHIP, Outline, Panel, ReportPictures
from .wording import quantity

USED_RGB, REJECTED_RGB = (0, 214, 255), (255, 106, 0)  # RGB; distinguishable with red-green colour blindness
SHEET_WIDTH = 1100  # width of the picture [px]
FEWEST_REGIONS = 2  # regions of a model with a scale of their own; fewer are not drawn
SHEET_COLUMNS = 6  # of the contact sheet


def draw(report: Mapping[str, Any], scene: ReportPictures, path: Path) -> None:
    """Write a PNG: the answer, the scene with used (blue) and rejected (orange) vehicles, a contact sheet, and the
    scale by place where it drifts."""
    panels = [_title(report), *(drawn(panel, SHEET_WIDTH / panel.image.shape[1]) for panel in scene.overviews)]
    if scene.used:
        panels.append(_contact_sheet(scene.used))
    drift = report.get("drift") or {}
    if drift.get("drifts"):
        if "cells" in drift:
            ((width, height),) = report["pictures"].values()
            panels.append(drift_panel(drift, width, height, SHEET_WIDTH))
        if len(drift.get("regions", [])) >= FEWEST_REGIONS:
            panels.append(regions_panel(drift, report["scale"], SHEET_WIDTH))
    write_png(path, np.concatenate([_padded(panel) for panel in panels]))


def _title(report: Mapping[str, Any]) -> np.ndarray:
    (value, low, high), unit = quantity(report, report["scale"], *report["interval90"])
    used, rejected = report["vehicles_used"], sum(report["vehicles_rejected"].values())
    lines = [
        f"{value} {unit}   90 %: {low} to {high}   {report['verdict']}",
        f"{used} vehicles used (blue), {rejected} rejected (orange), fleet {report['fleet']}; "
        f"{title_of(report['input']['path'], report['input']['folder'])}",
    ]
    panel = np.full((62, SHEET_WIDTH, 3), 255, np.uint8)
    for k, line in enumerate(lines):
        write_on(panel, (10, 26 + 27 * k), line, 21 - 4 * k)
    return panel


def drawn(panel: Panel, zoom: float) -> np.ndarray:
    """RGB of a panel enlarged by `zoom`, with its outlines and its scale bar."""
    height, width = panel.image.shape[:2]
    size = max(1, round(width * zoom)), max(1, round(height * zoom))
    image = cv2.resize(panel.image, size, interpolation=cv2.INTER_AREA if zoom < 1 else cv2.INTER_CUBIC)
    for outline in sorted(panel.outlines, key=lambda o: o.used):
        _outlined(image, outline, zoom, 1 if panel.fine else 2)
    if panel.bar is not None:
        metres, length = panel.bar
        end, y = 20 + round(length * zoom), size[1] - 16
        for colour, more in (((255, 255, 255), 4), ((0, 0, 0), 0)):  # black on a white rim, to show on any ground
            cv2.line(image, (20, y), (end, y), colour, 3 + more)
        write_on(image, (end + 10, y), f"{metres:g} m", 18, BLACK, WHITE, "lm")
    return image


def _outlined(image: np.ndarray, outline: Outline, zoom: float, width: int) -> None:
    # Sixteenths of a pixel (shift=4); OpenCV's pixel centres are integers, ours end in .5.
    points = np.round((outline.points * zoom - 0.5) * 16).astype(np.int32)
    colour = USED_RGB if outline.used else REJECTED_RGB
    cv2.polylines(image, [points], True, colour, width, cv2.LINE_AA, shift=4)


def _contact_sheet(panels: Sequence[Panel]) -> np.ndarray:
    """Vehicles with their boxes and sizes in metres, from the shortest to the longest."""
    cell = SHEET_WIDTH // SHEET_COLUMNS
    zoom = (cell - 4) / CHIP
    chips = []
    for panel in panels:
        chip = np.full((cell, cell, 3), 255, np.uint8)
        image = drawn(panel, zoom)
        chip[2 : 2 + image.shape[0], 2 : 2 + image.shape[1]] = image
        write_on(chip, (8, cell - 10), panel.title.replace("×", "x"), 15, WHITE, BLACK)
        chips.append(chip)
    chips += [np.full((cell, cell, 3), 255, np.uint8)] * (-len(chips) % SHEET_COLUMNS)
    starts = range(0, len(chips), SHEET_COLUMNS)
    return np.concatenate([np.concatenate(chips[k : k + SHEET_COLUMNS], 1) for k in starts])


def _padded(panel: np.ndarray) -> np.ndarray:
    return np.pad(panel, ((0, 8), (0, SHEET_WIDTH - panel.shape[1]), (0, 0)), constant_values=255)
