"""Photos that `orthoscale locate` must not place: of ground that is not on the map, or with a wrong scale or heading.

Kinds, in turn, half of each with the heading known:

same      one half of the orthophotos whose other half is on the map
city      orthophotos of other cities, on a map of chips of American ones
lots      car parks, mobile homes and dense housing, on a map of others of the same kinds
frames    frames of the training scenes, on a map of orthophotos
drawn     a drawn town, on a map of another
rows      one block that is repeated all over the map: the photo is on it, in many places at once
scale     photos of the map, 2.3 to 3 times too large or too small
heading   photos of the map, 60 to 300 degrees off the given heading

An answer more than 20 m off is wrong.

    python benchmarks/locate_negatives.py --count 500 --method gradient     # Markdown on standard output
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from locate import (
    CHIP_STEP,
    COARSE,
    DATA,
    INTERVAL,
    City,
    Method,
    Nadir,
    chips,
    mosaic,
    orthophotos,
    shots,
    written,
)
from support.aerial import Shot, town

from orthoscale.errors import TooLittleEvidence
from orthoscale.locate.register import Known
from orthoscale.sources.satellite import Satellite

SMALL = 3600  # [px] side of the maps: 0.52 km2
LOTS = ("parkinglot", "mobilehomepark", "denseresidential")
WIDTHS = (100.0, 150.0, 200.0)  # [m] of the photos
FAR = 20.0  # [m] from which an answer is wrong
DRAWN = 2000  # [px] side of the drawn towns


@dataclass(frozen=True)
class Negative:
    """A photo and a map. foot : the photo's foot on the map [m right and down], None if it is not on it."""

    seen: Nadir
    sky: Satellite
    heading: float
    foot: tuple[float, float] | None = None


@dataclass(frozen=True)
class Try:
    """The result for one. told : whether the heading was given. share : matches of the best candidate, divided by those
    needed. problem : why there is no answer. seconds : duration of the search [s]."""

    method: str
    kind: str
    number: int
    told: bool
    answered: bool
    wrong: bool
    share: float
    problem: str
    seconds: float


class Ground:
    """The pictures from which photos and maps are made, each made when first needed."""

    def __init__(self, folder: Path):
        self.folder = folder

    def _map(self, name: str, picture: np.ndarray) -> Satellite:
        return written(picture, self.folder / f"{name}.tif")

    @cache  # noqa: B019 - one object
    def halves(self) -> tuple[City, City]:
        """Ground on the map, and other ground: the left and the right halves of the orthophotos."""
        between = chips()
        left = [part[:, : part.shape[1] // 2] for part in orthophotos()]
        right = [part[:, part.shape[1] // 2 :] for part in orthophotos()]
        fine, rects = mosaic(left, between[::2], SMALL)
        sky = self._map("halves", fine)
        other, places = mosaic(right, between[1::2], SMALL)
        return City(fine, rects, sky), City(other, places, sky)

    @cache  # noqa: B019
    def american(self) -> Satellite:
        """A map of chips only."""
        return self._map("american", mosaic([], chips(), SMALL)[0])

    @cache  # noqa: B019
    def lots(self) -> tuple[Satellite, City]:
        """A map of car parks and houses, and a city of others that are not on it."""
        some = chips(LOTS)
        sky = self._map("lots", mosaic([], some[::2], SMALL)[0])
        return sky, City(mosaic([], some[1::2], SMALL)[0], [(0, 0, SMALL, SMALL)], sky)

    @cache  # noqa: B019
    def drawn(self) -> tuple[Satellite, City]:
        """A map of a drawn town, and another one."""
        here, other = town(1, DRAWN), town(2, DRAWN)
        sky = self._map("drawn", here)
        return sky, City(other, [(0, 0, DRAWN, DRAWN)], sky)

    @cache  # noqa: B019
    def rows(self, which: int) -> City:
        """A block of houses repeated all over the map."""
        block = cv2.resize(cv2.imread(str(chips(LOTS)[which])), (CHIP_STEP, CHIP_STEP))
        city = np.tile(block, (SMALL // CHIP_STEP, SMALL // CHIP_STEP, 1))
        return City(city, [(0, 0, *city.shape[1::-1])], self._map(f"rows{which}", city))


def _one(city: City, number: int, draw: np.random.Generator) -> tuple[Shot, Nadir]:
    ((shot, rgb),) = shots(city, 1, float(draw.choice(WIDTHS)), 50_000 + number)
    return shot, Nadir(rgb, shot.altitude / shot.focal)


def same(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    shot, seen = _one(ground.halves()[1], number, draw)
    return Negative(seen, ground.halves()[0].sky, shot.heading)


def city(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    shot, seen = _one(ground.halves()[number % 2], number, draw)
    return Negative(seen, ground.american(), shot.heading)


def lots(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    sky, others = ground.lots()
    shot, seen = _one(others, number, draw)
    return Negative(seen, sky, shot.heading)


def frames(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    """A training frame. Its scale is only about right; for ground that is not on the map this does not matter."""
    every = sorted((DATA / "vehicles" / "images").glob("*.*"))
    rgb = cv2.imread(str(every[int(draw.integers(len(every)))]))[..., ::-1]
    small = cv2.resize(rgb, (640, round(640 * rgb.shape[0] / rgb.shape[1])), interpolation=cv2.INTER_AREA)
    seen = Nadir(np.ascontiguousarray(small), float(draw.choice(WIDTHS)) / 640)
    return Negative(seen, ground.halves()[0].sky, float(draw.uniform(0, 360)))


def drawn(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    sky, others = ground.drawn()
    shot, seen = _one(others, number, draw)
    return Negative(seen, sky, shot.heading)


def rows(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    ours = ground.rows(int(draw.integers(6)))
    shot, seen = _one(ours, number, draw)
    return Negative(seen, ours.sky, shot.heading, shot.foot)


def scale(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    ours = ground.halves()[0]
    shot, seen = _one(ours, number, draw)
    factor = float(draw.uniform(2.3, 3.0)) ** draw.choice([-1, 1])
    return Negative(Nadir(seen.rgb, seen.gsd * factor), ours.sky, shot.heading, shot.foot)


def heading(ground: Ground, number: int, draw: np.random.Generator) -> Negative:
    ours = ground.halves()[0]
    shot, seen = _one(ours, number, draw)
    return Negative(seen, ours.sky, shot.heading + draw.uniform(60, 300), shot.foot)


KINDS: dict[str, Callable[[Ground, int, np.random.Generator], Negative]] = {
    each.__name__: each for each in (same, city, lots, frames, drawn, rows, scale, heading)
}


def tried(ground: Ground, method: Method, kind: str, number: int) -> Try:
    draw = np.random.default_rng(70_000 + number)
    photo = KINDS[kind](ground, number, draw)
    # Without a given heading, photos of the kind `heading` would be no negatives.
    told = bool(number // len(KINDS) % 2) or kind == "heading"
    known = Known(INTERVAL, np.radians(photo.heading + draw.uniform(-6, 6)) if told else None)
    try:
        found, seconds = method.searched(photo.seen, photo.sky, known)
    except TooLittleEvidence:
        return Try(method.name, kind, number, told, False, False, 0.0, "too small on the map", 0.0)
    best = found.candidates[0] if found.candidates else None
    wrong = found.located is not None
    if wrong and best is not None and photo.foot is not None:
        there = best.map_pixels(np.zeros((1, 2)))[0] * COARSE
        wrong = bool(np.hypot(*(there - photo.foot)) >= FAR)
    share = best.inliers / found.needed if best is not None else 0.0
    answered = found.located is not None
    return Try(method.name, kind, number, told, answered, wrong, share, found.problem, seconds)


def numbers(count: int) -> Iterator[tuple[str, int]]:
    """`count` pairs of kind and number, the kinds in turn."""
    names = list(KINDS)
    return ((names[number % len(names)], number) for number in range(count))


def table(tries: list[Try]) -> None:
    """Print the wrong answers by kind."""
    print("| | negatives | answered | wrong | two places alike | most matches over those needed | s |")
    print("|---|---|---|---|---|---|---|")
    for name in [*KINDS, "all"]:
        some = [t for t in tries if name in (t.kind, "all")]
        if not some:
            continue
        twice = sum("two places" in t.problem for t in some)
        most = max((t.share for t in some if not t.answered and "two places" not in t.problem), default=0.0)
        answered, wrong = sum(t.answered for t in some), sum(t.wrong for t in some)
        seconds = np.median([t.seconds for t in some])
        print(f"| {name} | {len(some)} | {answered} | {wrong} | {twice} | {most:.2f} | {seconds:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", nargs="*", choices=("gradient", "dense", "retrieval"), default=["gradient"])
    parser.add_argument("--embedding", type=Path, help="network for retrieval")
    parser.add_argument("--count", type=int, default=500, help="for each method")
    parser.add_argument("--rows", type=Path, help="file of trials: those in it are not run again")
    told = parser.parse_args()
    cv2.setNumThreads(1)
    before = told.rows.read_text().splitlines() if told.rows is not None and told.rows.exists() else []
    tries = [Try(**json.loads(row)) for row in before]
    done = {(t.method, t.number) for t in tries}
    methods = [Method.of(name, told.embedding) for name in told.method]  # what one lacks is said before the first runs
    with tempfile.TemporaryDirectory() as folder:
        ground = Ground(Path(folder))
        for method in methods:
            for kind, number in numbers(told.count):
                if (method.name, number) in done:
                    continue
                tries.append(tried(ground, method, kind, number))
                if told.rows is not None:
                    with told.rows.open("a") as file:
                        file.write(json.dumps(asdict(tries[-1])) + "\n")
    for name in told.method:
        print(f"\n{name}\n")
        table([t for t in tries if t.method == name])


if __name__ == "__main__":
    main()
