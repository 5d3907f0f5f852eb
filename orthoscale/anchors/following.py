"""Following lines block by block, both ways from where they were first seen, by their cross sections."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from ..core.angles import unit_vector

BLOCKS_MISSING = 2  # most in succession
SECTION_STEP = 0.25  # [px] between the samples of a cross section


class Piece(Protocol):
    """A block of what is followed. place : (2,) [px]. heading : of its lines [rad]."""

    @property
    def place(self) -> np.ndarray: ...

    @property
    def heading(self) -> float: ...


P = TypeVar("P", bound=Piece)


def followed(
    first: P,
    step: float,
    shape: tuple[int, ...],
    further: Callable[[np.ndarray, Sequence[P], float], P | None],
    most: float = np.inf,
) -> tuple[list[P], int]:
    """The blocks that `first` belongs to, in order, and how many were looked for: one every `step` [px], both ways, as
    long as the picture of this `shape` goes on and no more than BLOCKS_MISSING in succession are missing.

    further : the block near a place (2,) [px], if there is one. It gets the place, the blocks before from `first` on,
    and the way: 1 along their heading, -1 against it. most : number of blocks one way.
    """
    height, width = shape
    parts, tried = [], 1
    for way in (1.0, -1.0):
        got, place, missing = [first], first.place, 0
        while missing <= BLOCKS_MISSING and len(got) < most:
            heading = got[-1].heading
            place = place + way * step * unit_vector(heading)
            if not (0 <= place[0] < width and 0 <= place[1] < height):
                break
            block = further(place, got, way)
            tried, missing = tried + 1, missing + 1 if block is None else 0
            if block is not None:
                got.append(block)
                place = block.place
        tried -= missing
        parts.append(got[1:])
    return [*parts[1][::-1], first, *parts[0]], tried


def three_back(before: Sequence[P]) -> P:
    """The block three back from the one that comes after `before`, or the first: the chord from it gives the direction
    in which the blocks run."""
    return before[max(len(before) - 3, 0)]


def ridge_across(profile: np.ndarray, sd: float) -> np.ndarray:
    """(N,) ridges of a cross section (N,) sampled every SECTION_STEP. The filter is the second derivative of a Gaussian
    of `sd` [px], negated; its absolute values sum to 1."""
    reach = np.ceil(4 * sd / SECTION_STEP)
    r = np.arange(-reach, reach + 1) * SECTION_STEP / sd
    kernel = (1 - r**2) * np.exp(-0.5 * r**2)
    kernel = (kernel - kernel.mean()) / np.abs(kernel).sum()
    return np.convolve(np.pad(profile, len(r) // 2, mode="edge"), kernel, mode="valid")
