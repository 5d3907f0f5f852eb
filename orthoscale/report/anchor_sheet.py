"""A contact sheet of anchors as PNG: each with the lines that were fitted to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.source import Source
from ..formats.lettering import write_on
from ..formats.pictures import write_png
from ..system.paths import title_of
from .pictures import SHEET_WIDTH, drawn
from .scene import Panel, anchor_panels, pictures_of

SHEET_CELLS = 3
SHEET_CELL = SHEET_WIDTH // SHEET_CELLS  # side of a cell [px], without its caption


def draw_anchors(anchors: Sequence[Mapping[str, Any]], source: Source, path: Path) -> None:
    """Write a PNG with a crop for each of a report's `anchors`, its fitted lines drawn over the picture."""
    panels = anchor_panels(anchors, pictures_of(source))
    cells = [np.full((60, SHEET_CELL * SHEET_CELLS, 3), 255, np.uint8)]
    write_on(cells[0], (10, 38), f"{len(anchors)} anchors in {title_of(source.path)}", 22)
    for start in range(0, len(panels), SHEET_CELLS):
        row = [_cell(panel) for panel in _row(panels[start : start + SHEET_CELLS])]
        used = max(int(np.flatnonzero((cell < 255).any((1, 2))).max(initial=0)) for cell in row) + 8
        cells.append(np.concatenate(row, axis=1)[:used])
    write_png(path, np.concatenate(cells))


def _row(panels: Sequence[Panel]) -> list[Panel | None]:
    return [*panels, *[None] * (SHEET_CELLS - len(panels))]


def _cell(panel: Panel | None) -> np.ndarray:
    cell = np.full((SHEET_CELL + 50, SHEET_CELL, 3), 255, np.uint8)
    if panel is not None:
        drawn_image = drawn(panel, (SHEET_CELL - 8) / max(panel.image.shape[:2]))
        cell[4 : 4 + drawn_image.shape[0], 4 : 4 + drawn_image.shape[1]] = drawn_image
        kind, _, standard = panel.title.partition(": ")
        for k, words in enumerate((kind, standard)):
            write_on(cell, (6, drawn_image.shape[0] + 22 + 18 * k), words, 14)
    return cell
