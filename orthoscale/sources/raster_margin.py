"""The margin of a map sheet: paper with a legend, a title block and other lettering around the picture of the ground.

Letters are as long and as wide as vehicles in a coarse picture, stand in rows as vehicles do, and detectors take them
for such. So the margin counts as an area without data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from rasterio.windows import Window

# Chosen by eye, on sheets drawn around eight orthophotos. None of 1,494 real pictures is taken for a sheet; six are if
# made 1.6 times as bright, of 78 m of ground each, where all of a side is white.
PAPER_GREY = 200  # [of 255] paper is no darker than this; borders without data are seldom so light
ONE_COLOUR = 12  # [of 255] pixels of paper differ by no more from its colour, after JPEG or scanning too
NOISE = 4.0  # [of 255] standard deviation within a patch of scanned paper, at most
EDGE_PATCH = 48, 4  # length and depth of the patches along a picture's sides that are looked at [px] ...
PATCHES = 16  # ... and number of them along each side
FLAT_SIDE = 0.9  # share of these that show nothing but paper, along a side where the sheet's margin is
REDUCED_SIDE = 2048  # [px] longest side of the reduced picture in which the margin is outlined; lengths below are in it
STROKE = 17  # [px] odd; paper less far apart has lettering between it, or a line of the frame
NARROW_STRIP = 25  # [px] odd; a strip of paper narrower than this has no lettering, or is a bright street at the edge
ISLAND = 0.02  # share of the sheet below which something in the margin is no picture of the ground: an arrow, a logo
LETTERED = 0.005  # share of the margin that is not paper, below which nothing is drawn on it: it is a plain border

PAPER_BEYOND = STROKE + NARROW_STRIP  # [px] of paper beyond its sides, so that lettering near these is enclosed too
_SIDE = {
    "top": np.s_[:PAPER_BEYOND, PAPER_BEYOND:-PAPER_BEYOND],
    "bottom": np.s_[-PAPER_BEYOND:, PAPER_BEYOND:-PAPER_BEYOND],
    "left": np.s_[:, :PAPER_BEYOND],
    "right": np.s_[:, -PAPER_BEYOND:],
}

Read = Callable[[Window, tuple[int, int]], np.ndarray]
"""RGB uint8 (rows, columns, 3) of a window, resampled to so many rows and columns."""


@dataclass(frozen=True)
class Margin:
    """What of a sheet is margin: all but the pictures on it.

    width, height : of the sheet [px]. pictures : (N, 4) left, top, right and bottom of each [px].
    """

    width: int
    height: int
    pictures: np.ndarray

    @property
    def share(self) -> float:
        """Share of the sheet that is margin."""
        return float(self.at(Window(0, 0, self.width, self.height), _reduced(self.width, self.height)).mean())

    def at(self, window: Window, out: tuple[int, int]) -> np.ndarray:
        """Bool of shape `out`: where the `window`, resampled to that shape, shows the margin."""
        y = window.row_off + (np.arange(out[0]) + 0.5) * window.height / out[0]
        x = window.col_off + (np.arange(out[1]) + 0.5) * window.width / out[1]
        outside = np.ones(out, bool)
        for left, top, right, bottom in self.pictures:
            outside[np.ix_((y > top) & (y < bottom), (x > left) & (x < right))] = False
        return outside


def margin_of(width: int, height: int, read: Read) -> Margin | None:
    """The margin of a sheet of `width` x `height` px; None if the picture has none, or nothing is drawn on it.

    Patches along the sides are read first, from top to bottom, and a reduced picture of the whole only where one of the
    sides is paper.
    """
    sides = _sides(width, height, read)
    paper = _paper(np.concatenate(list(sides.values())))
    if paper is None:
        return None
    touching = [side for side, colours in sides.items() if _share_of(paper, colours) >= FLAT_SIDE]
    if not touching:
        return None
    out = _reduced(width, height)
    flat = cv2.inRange(read(Window(0, 0, width, height), out), paper - ONE_COLOUR, paper + ONE_COLOUR) > 0
    pictures = _pictures(flat, touching)
    rows, columns = out
    # The edge of a picture may be uneven, as that of the ground below a white sky.
    apart = Margin(columns, rows, pictures + STROKE * np.array([-1, -1, 1, 1]))
    well_outside = apart.at(Window(0, 0, columns, rows), out)
    if not well_outside.any() or np.mean(~flat[well_outside]) < LETTERED:
        return None
    return Margin(width, height, pictures * (np.array([width, height] * 2) / np.array([columns, rows] * 2)))


def _reduced(width: int, height: int) -> tuple[int, int]:
    """Rows and columns of the reduced picture."""
    factor = min(1.0, REDUCED_SIDE / max(width, height))
    return max(1, round(height * factor)), max(1, round(width * factor))


def _sides(width: int, height: int, read: Read) -> dict[str, np.ndarray]:
    """By side of the picture (PATCHES, 3) colours of the patches along it, NaN where a patch is not of one colour."""
    long, deep = EDGE_PATCH
    lying, standing = (min(long, width), min(deep, height)), (min(deep, width), min(long, height))

    def colour(at: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
        patch = read(Window(*at, *size), size[::-1]).reshape(-1, 3)
        return np.median(patch, axis=0) if patch.std(0).max() <= NOISE else np.full(3, np.nan)

    def evenly(to: int) -> list[int]:
        return np.linspace(0, to, PATCHES).astype(int).tolist()

    across, down = evenly(width - lying[0]), evenly(height - standing[1])
    top = [colour((x, 0), lying) for x in across]
    beside = [[colour((x, y), standing) for x in (0, width - standing[0])] for y in down]
    bottom = [colour((x, height - lying[1]), lying) for x in across]
    left, right = zip(*beside, strict=True)
    return {"top": np.array(top), "left": np.array(left), "right": np.array(right), "bottom": np.array(bottom)}


def _paper(colours: np.ndarray) -> np.ndarray | None:
    """(3,) the colour of the paper among those of patches (N, 3); None if none is so light."""
    light = colours[(colours >= PAPER_GREY).all(1)]
    return np.median(light, axis=0) if len(light) else None


def _share_of(paper: np.ndarray, colours: np.ndarray) -> float:
    """Share of the colours of patches (N, 3) that are the `paper`'s (3,); NaN is not."""
    return float((np.abs(colours - paper) <= ONE_COLOUR).all(1).mean())


def _pictures(flat: np.ndarray, touching: list[str]) -> np.ndarray:
    """(N, 4) left, top, right and bottom of the pictures in a reduced sheet that is paper where `flat` (h, w), and
    whose paper reaches the sides `touching`.

    Bright ground at its edge looks like paper. So what is taken is the whole rectangle that encloses a picture.
    """
    sheet = np.pad(flat.astype(np.uint8), PAPER_BEYOND)
    for side in touching:
        sheet[_SIDE[side]] = 1
    lettering_closed = cv2.morphologyEx(sheet, cv2.MORPH_CLOSE, np.ones((STROKE, STROKE), np.uint8))
    wide = cv2.morphologyEx(lettering_closed, cv2.MORPH_OPEN, np.ones((NARROW_STRIP, NARROW_STRIP), np.uint8))
    labels = cv2.connectedComponents(wide)[1]
    outside = np.unique(np.concatenate([labels[_SIDE[side]].ravel() for side in touching]))
    ground = ~np.isin(labels, outside[outside > 0])[PAPER_BEYOND:-PAPER_BEYOND, PAPER_BEYOND:-PAPER_BEYOND]
    left, top, width, height, area = cv2.connectedComponentsWithStats(ground.astype(np.uint8))[2][1:].T
    # A pixel more: those at the edge are of both.
    found = np.column_stack([left - 1, top - 1, left + width + 1, top + height + 1])
    return found[area >= ISLAND * ground.size].astype(float)
