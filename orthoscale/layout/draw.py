"""Draws a layout: a mask, a line drawing, and an overlay on the orthophoto."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import shapely
from rasterio.features import rasterize
from shapely.geometry.base import BaseGeometry

from ..core.round_numbers import scale_bar
from .ground import MetricOrthophoto
from .place import PlacedFacility, rings

LINE_M = 0.05  # width of painted lines [m]: 5 cm in the rules of basketball, tennis and others
DRAWING_MARGIN = 0.06  # around the lot, as a share of its longer side
OVERLAY = 1600  # longest side of the overlay [px]
LOT, RUN_OFF = (255, 220, 40), (255, 255, 255)  # RGB
FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class Window:
    """A part of the picture [px]."""

    x: int
    y: int
    width: int
    height: int


def window_of(ground: MetricOrthophoto, lot: BaseGeometry) -> Window:
    """The part of the picture with the lot and a margin."""
    x0, y0, x1, y1 = shapely.transform(lot, ground.to_pixels).bounds
    margin = DRAWING_MARGIN * max(x1 - x0, y1 - y0)
    left, top = max(0, int(x0 - margin)), max(0, int(y0 - margin))
    right, bottom = min(ground.source.width, int(x1 + margin) + 1), min(ground.source.height, int(y1 + margin) + 1)
    return Window(left, top, right - left, bottom - top)


def mask(ground: MetricOrthophoto, placed: Sequence[PlacedFacility], window: Window) -> np.ndarray:
    """(2, h, w) uint16: the number (1, 2 ...) of the facility whose playing area, and whose area with run-off, contains
    the pixel's centre; 0 for none."""
    bands = []
    for areas in ([p.area for p in placed], [p.full_area for p in placed]):
        shapes = [(_shifted(ground, area, window), k) for k, area in enumerate(areas, 1)]
        size = (window.height, window.width)
        bands.append(rasterize(shapes, out_shape=size, dtype="uint16") if shapes else np.zeros(size, np.uint16))
    return np.stack(bands)


def lines(ground: MetricOrthophoto, placed: Sequence[PlacedFacility], window: Window) -> np.ndarray:
    """(h, w) uint8: 255 on painted lines and on the playing areas' edges, else 0, without antialiasing."""
    drawing = np.zeros((window.height, window.width), np.uint8)
    thickness = max(1, round(LINE_M / ground.gsd))
    for place in placed:
        for line in (*place.facility.lines, *place.facility.edges):
            points = _points(ground, window, 1.0, place.on_ground(line))
            cv2.polylines(drawing, [points], False, 255, thickness, cv2.LINE_8, shift=4)
    return drawing


def overlay(
    ground: MetricOrthophoto, lot: BaseGeometry, placed: Sequence[PlacedFacility], window: Window
) -> np.ndarray:
    """(h, w, 3) uint8 RGB: the orthophoto with the lot, the facilities and their lines, a scale bar and north."""
    zoom = min(OVERLAY / max(window.width, window.height), 4.0)
    size = max(1, round(window.width * zoom)), max(1, round(window.height * zoom))
    image = ground.source.read(window.x, window.y, window.width, window.height, *size).copy()
    drawn, tint = partial(_points, ground, window, zoom), image.copy()
    for place in placed:
        for area, colour in ((place.full_area, (205, 205, 195)), (place.area, place.facility.colour)):
            cv2.fillPoly(tint, [drawn(shapely.get_coordinates(area))], colour, shift=4)
    image = cv2.addWeighted(tint, 0.72, image, 0.28, 0)
    for ring in rings(lot):
        cv2.polylines(image, [drawn(ring)], False, LOT, 2, cv2.LINE_AA, shift=4)
    for place in placed:
        if place.facility.ends or place.facility.sides:
            run_off = drawn(shapely.get_coordinates(place.full_area))
            cv2.polylines(image, [run_off], False, RUN_OFF, 1, cv2.LINE_AA, shift=4)
        for line in (*place.facility.lines, *place.facility.edges):
            cv2.polylines(image, [drawn(place.on_ground(line))], False, (255, 255, 255), 1, cv2.LINE_AA, shift=4)
    for number, place in enumerate(placed, 1):
        x, y = drawn(np.array([place.centre]))[0] / 16
        _label(image, f"{number} {place.facility.code}", int(x), int(y))
    _scale_bar(image, ground.gsd / zoom)
    _north_arrow(image, np.subtract(*ground.to_pixels(np.array([[0.0, 1.0], [0.0, 0.0]]))))
    return image


def _shifted(ground: MetricOrthophoto, area: BaseGeometry, window: Window) -> BaseGeometry:
    return shapely.transform(area, lambda metres: ground.to_pixels(metres) - (window.x, window.y))


def _points(ground: MetricOrthophoto, window: Window, zoom: float, metres: np.ndarray) -> np.ndarray:
    """(n, 2) int32, in sixteenths of a pixel as OpenCV needs them; its pixel centres are integers, ours end in .5."""
    pixels = (ground.to_pixels(metres) - (window.x, window.y)) * zoom - 0.5
    return np.round(pixels * 16).astype(np.int32)


def _label(image: np.ndarray, text: str, x: int, y: int) -> None:
    (width, height), base = cv2.getTextSize(text, FONT, 0.6, 1)
    x, y = int(np.clip(x - width // 2, 4, max(4, image.shape[1] - width - 4))), y + height // 2
    cv2.rectangle(image, (x - 4, y - height - 4), (x + width + 4, y + base), (45, 45, 45), -1)
    cv2.putText(image, text, (x, y), FONT, 0.6, (255, 255, 255), 1, cv2.LINE_AA)


def _scale_bar(image: np.ndarray, metres_per_px: float) -> None:
    metres, length = scale_bar(metres_per_px, image.shape[1])
    x, y = 14, image.shape[0] - 14
    right = x + round(length)
    cv2.line(image, (x, y), (right, y), (0, 0, 0), 7)
    cv2.line(image, (x, y), (right, y), (255, 255, 255), 3)
    _label(image, f"{metres:g} m", right + 36, y - 4)


def _north_arrow(image: np.ndarray, north: np.ndarray) -> None:
    """north : (2,) its direction, right and down [px]."""
    middle = np.array([image.shape[1] - 36, 44])
    tip = middle + 26 * north / np.linalg.norm(north)
    tail = 2 * middle - tip
    for colour, thickness in (((0, 0, 0), 5), ((255, 255, 255), 2)):
        cv2.arrowedLine(
            image, tail.astype(int).tolist(), tip.astype(int).tolist(), colour, thickness, cv2.LINE_AA, 0, 0.35
        )
    _label(image, "N", *(middle + (tail - middle) * 1.6).astype(int).tolist())
