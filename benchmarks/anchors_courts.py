"""Painted courts against known scales: ``python benchmarks/anchors_courts.py [KIND] [HALF]``.

Reads ``../shared/data`` or ``ORTHOSCALE_DATA``. The chips are split by the MD5 of their names: thresholds and
uncertainties were chosen on `building`, nothing on `other` (default). Finer pictures are drawn, coarser ones shrunk
from the chips. The vehicles' scale is off by a random 8 % (one sigma, at most 12 %).
A place is a picture with the scale that those vehicles and all its courts give together, combined as in the program.
CPU seconds are those of this process, whatever else the machine does.
"""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from orthoscale.anchors import courts
from orthoscale.core.anchors import Anchor

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

from anchor_places import (  # noqa: E402
    CHIP_GSD,
    VEHICLES_SD,
    Place,
    Sample,
    chips,
    half_width,
    held,
    place_of,
    scenes,
    vehicles_off,
)
from support.courts import (  # noqa: E402
    BLUE,
    CLAY,
    GRASS,
    GREEN,
    basketball,
    court_picture,
    handball,
    penalty_area,
    tennis,
    volleyball,
)


@dataclass
class Tally:
    """What was found in pictures of one kind: error of each anchor, places, megapixels and CPU seconds."""

    pictures: int = 0
    megapixels: float = 0.0
    seconds: float = 0.0
    found: list[float] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    false: list[tuple[str, float]] = field(default_factory=list)

    def look(self, finder: courts.CourtFinder, name: str, picture: np.ndarray, gsd: float, off: float) -> None:
        start = time.process_time()
        anchors: list[Anchor] = list(finder.find(picture, gsd * off, VEHICLES_SD, ""))
        self.seconds += time.process_time() - start
        self.pictures += 1
        self.megapixels += picture.shape[0] * picture.shape[1] / 1e6
        for anchor in anchors:
            error = float(anchor.metres_per_pixel()[0] / gsd - 1)
            self.found.append(error)
            self.false.append((name, anchor.false))
        if anchors:
            self.places.append(place_of(anchors, gsd, gsd * off, VEHICLES_SD, ""))

    def row(self, name: str) -> str:
        cost = f"{self.seconds / self.megapixels:.2f}"
        if not self.found:
            return f"| {name} | {self.pictures} | {self.megapixels:.1f} | 0 | 0 | | | | | | {cost} |"
        each, places = np.array(self.found), np.array(self.places)
        size, off = np.abs(each), np.abs(places[:, 0])
        return (
            f"| {name} | {self.pictures} | {self.megapixels:.1f} | {len(each)} | {len(places)} | "
            f"{100 * np.median(each):+.2f} | {100 * np.quantile(size, 0.9):.2f} / {100 * size.max():.1f} | "
            f"{100 * np.mean(off <= 0.005):.0f} | {100 * np.quantile(off, 0.9):.2f} | "
            f"{100 * held(places):.0f} (+-{100 * half_width(places):.2f}) | {cost} |"
        )


HEAD = (
    "| pictures | number | Mpx | anchors | in pictures | error: median [%] | 90 % / worst [%] | "
    "places within 0.5 % [%] | places: 90 % [%] | in their 90 % interval (median width) [%] | CPU s/Mpx |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def half_of(path: Path) -> str:
    """The half to which a chip belongs."""
    return ("building", "other")[int(hashlib.md5(path.name.encode()).hexdigest(), 16) % 2]


def half_of_chips(half: str, with_courts: bool) -> Iterator[Sample]:
    """The chips of a half, with tennis courts or without."""
    return chips(lambda path: half_of(path) == half and path.stem.startswith("tennis") == with_courts)


# Each finder, and the functions that draw its courts by the edges that the rules give.
KINDS: dict[str, tuple[courts.CourtFinder, tuple[Callable[[], list], ...]]] = {
    "tennis": (courts.TENNIS, (tennis, lambda: tennis(0.04, 0.05), lambda: tennis(0.05, 0.10))),
    "volleyball": (courts.VOLLEYBALL, (volleyball,)),
    "basketball": (
        courts.BASKETBALL,
        (basketball, lambda: basketball(28.651, 15.24, 3.66, 5.79), lambda: basketball(25.603, 15.24, 3.66, 5.79)),
    ),
    "handball": (courts.HANDBALL, (handball,)),
    "football": (courts.FOOTBALL, (penalty_area,)),
}


def drawn(kind: str, gsd: float, count: int, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray]]:
    """Pictures of one court each, in many looks, with worn paint, trees and shade."""
    finder, paints = KINDS[kind]
    side = finder.extent + 8
    for number in range(count):
        place = (side / 2 + rng.uniform(-1, 1), side / 2 + rng.uniform(-1, 1))
        yield str(number), court_picture(
            [(paints[number % len(paints)](), place, rng.uniform(0, np.pi))], gsd, 2 * [round(side / gsd)],
            ground=(GREEN, GRASS)[number % 2], surface=(GREEN, BLUE, CLAY)[number % 3],
            white=int(rng.uniform(190, 240)), wear=rng.uniform(0, 0.3), blur_px=rng.uniform(0.5, 0.9),
            noise=rng.uniform(1, 3), shade=rng.choice([0, 0.3]), trees=int(rng.integers(0, 4)), seed=number,
        )  # fmt: skip


def main(kind: str = "tennis", half: str = "other") -> None:
    finder, _ = KINDS[kind]
    print(HEAD)
    for zoom in (1.0, 1.333, 1.64) if kind == "tennis" else ():
        tally, rng = Tally(), np.random.default_rng(0)
        for name, chip, *_ in half_of_chips(half, with_courts=True):
            size = [round(side / zoom) for side in chip.shape[1::-1]]
            small = cv2.resize(chip, size, interpolation=cv2.INTER_AREA) if zoom > 1 else chip
            gsd = CHIP_GSD * float(np.sqrt(np.divide(chip.shape[:2], small.shape[:2]).prod()))
            tally.look(finder, name, small, gsd, vehicles_off(rng))
        print(tally.row(f"chips with tennis courts, {CHIP_GSD * zoom:.2f} m/px"), flush=True)
    for gsd in (0.05, 0.1, 0.2, 0.3, 0.5):
        tally, rng = Tally(), np.random.default_rng(1)
        for name, picture in drawn(kind, gsd, 24, rng):
            tally.look(finder, name, picture, gsd, vehicles_off(rng))
        print(tally.row(f"drawn, a {kind} court each, {gsd:.2f} m/px"), flush=True)
    for what, pictures in (
        ("chips without tennis courts", half_of_chips(half, with_courts=False)),
        ("chips with tennis courts", half_of_chips(half, with_courts=True)),
        ("orthophotos", scenes(montages=True)),
    ):
        if kind == "tennis" and what == "chips with tennis courts":
            continue
        tally, rng = Tally(), np.random.default_rng(2)
        for name, picture, gsd, _ in pictures:
            tally.look(finder, name, picture, gsd, vehicles_off(rng))
        print(tally.row(what), *(f"{name}: {false:.2f}" for name, false in tally.false), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
