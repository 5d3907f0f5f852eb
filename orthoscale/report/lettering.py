"""Letters on pictures, readable on any ground: black or coloured, with a halo all round."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

BLACK, WHITE = (0, 0, 0), (255, 255, 255)
HALO = 0.13  # width of a halo, as a share of the letters' size


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size)


def write_on(
    image: np.ndarray,
    place: tuple[float, float],
    text: str,
    size: int,
    colour: tuple[int, int, int] = BLACK,
    halo: tuple[int, int, int] | None = None,
    anchor: str = "ls",
) -> None:
    """Draw `text` into `image` (h, w, 3) uint8 RGB, `size` px high, with its `anchor` (Pillow's) at `place` [px]."""
    drawn = Image.fromarray(image)
    width = max(1, round(HALO * size)) if halo is not None else 0
    ImageDraw.Draw(drawn).text(
        place, text, colour, _font(size), anchor=anchor, stroke_width=width, stroke_fill=halo or colour
    )
    image[:] = np.asarray(drawn)


def text_width(text: str, size: int) -> float:
    """Width of `text` [px] in letters `size` px high."""
    return float(_font(size).getlength(text))
