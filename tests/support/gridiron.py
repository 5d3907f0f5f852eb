"""Pictures of fields of American football with exact truth."""

from __future__ import annotations

from support.courts import GRASS, court_picture

YARD = 0.9144


def gridiron(width=160 / 3 * YARD, line=0.1016):
    """Painted rectangles (x0, y0, x1, y1) [m] about the middle of a field: goal lines 100 yards apart, yard lines every
    five, hash marks, end lines and side lines."""
    half = width / 2
    boxes = [(k * 5 * YARD - line / 2, -half, k * 5 * YARD + line / 2, half) for k in range(-10, 11)]
    boxes += [(side * 60 * YARD - line, -half, side * 60 * YARD + line, half) for side in (-1, 1)]
    boxes += [(-60 * YARD, side * half - 0.9, 60 * YARD, side * half + 0.9) for side in (-1, 1)]
    for k in range(-50, 51):
        if k % 5:
            boxes += [(k * YARD - line / 2, y - 0.3, k * YARD + line / 2, y + 0.3) for y in (-8.1, 8.1)]
    return boxes


def field_picture(gsd, angle=0.4, side=130.0, **looks):
    """RGB uint8 of a field in the middle of a square of `side` [m]."""
    looks = {"ground": GRASS, "surface": (70, 100, 55), **looks}
    return court_picture([(gridiron(), (side / 2, side / 2), angle)], gsd, 2 * [round(side / gsd)], **looks)
