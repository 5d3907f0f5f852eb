"""Draws lettering on pictures, readable on any background: black or coloured, with a halo."""

from __future__ import annotations

import unicodedata
from functools import cache
from math import ceil, floor
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

BLACK, WHITE = (0, 0, 0), (255, 255, 255)
HALO = 0.13  # width of a halo, as a share of the letters' size


# Pillow's built-in font, the same on every computer, has ASCII only: other characters would be empty boxes.
_SPELT = str.maketrans({
    "ß": "ss", "æ": "ae", "Æ": "Ae", "œ": "oe", "Œ": "Oe", "ø": "o", "Ø": "O", "đ": "d", "Đ": "D", "ł": "l", "Ł": "L",
    "ı": "i", "þ": "th", "Þ": "Th", "ð": "d", "−": "-", "–": "-", "—": "-", "×": "x", "±": "+-", "’": "'",
})  # fmt: skip
_RULED = ImageDraw.Draw(Image.new("RGB", (1, 1)))  # only for measuring texts


def in_ascii(text: str) -> str:
    """`text` in characters that can be drawn: without accents, and with a question mark for what has no equivalent."""
    bare = unicodedata.normalize("NFKD", text.translate(_SPELT))
    return "".join(c for c in bare if not unicodedata.combining(c)).encode("ascii", "replace").decode()


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
    text = in_ascii(text)
    width = max(1, round(HALO * size)) if halo is not None else 0
    left, top, right, bottom = _RULED.textbbox(place, text, _font(size), anchor=anchor, stroke_width=width)
    x, y = max(0, floor(left) - 1), max(0, floor(top) - 1)
    part = image[y : max(0, ceil(bottom) + 1), x : max(0, ceil(right) + 1)]  # so that not the whole picture is copied
    if not part.size:
        return
    drawn = Image.fromarray(part)
    ImageDraw.Draw(drawn).text(
        (place[0] - x, place[1] - y),
        text,
        colour,
        _font(size),
        anchor=anchor,
        stroke_width=width,
        stroke_fill=halo or colour,
    )
    part[:] = np.asarray(drawn)


def text_width(text: str, size: int) -> float:
    """Width of `text` [px] in letters `size` px high."""
    return float(_font(size).getlength(in_ascii(text)))
