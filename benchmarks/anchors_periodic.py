"""Crossings, bays, lane lines, tracks and yard lines against known scales.

``python benchmarks/anchors_periodic.py [--kind KIND]``.

Reads ``../shared/data`` or ``ORTHOSCALE_DATA``. The vehicles' scale is off by a random 8 % (one sigma, at most 12 %);
of an anchor's standards the one nearest to the truth counts. A place is a picture with the scale that those vehicles
and all its anchors give together, combined as in the program. A second row separates the errors of the picture from
those of the standard: one sigma of the fit alone, by the scatter about it; and places whose anchors were taken for the
standard nearest to the truth, apart from the others. False finds were counted by eye, on the pictures that ``--draw
FOLDER`` writes. CPU seconds are those of this process, including shrinking to the finder's resolution.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from orthoscale.anchors.bays import ParkingBays
from orthoscale.anchors.crossings import ZebraCrossings
from orthoscale.anchors.dashes import LaneDashes
from orthoscale.anchors.gridiron import Gridirons
from orthoscale.anchors.rails import RailTracks
from orthoscale.anchors.repeated import LOCAL_STRETCH
from orthoscale.anchors.running import RunningTracks
from orthoscale.core.anchors import Anchor, AnchorFinder
from orthoscale.core.normal import Z90

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

from anchor_places import VEHICLES_SD, Place, Sample, chips, held, place_of, scenes, vehicles_off  # noqa: E402
from support.gridiron import field_picture  # noqa: E402
from support.markings import PAINT, picture, stroke  # noqa: E402
from support.rails import RUST, railway, track  # noqa: E402
from support.running import running_track  # noqa: E402

HEAD = (
    "| pictures | kind | number | Mpx | anchors | in pictures | error: median [%] | 68 % / 90 % / worst [%] | "
    "in the 90 % interval [%] | places: 68 % / 90 % / worst [%] | in the 90 % interval [%] | CPU s/Mpx |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|"
)


@dataclass
class Tally:
    """What one finder found in pictures of one sort: for each anchor its error, claimed sd and sd of the fit alone;
    places, megapixels and CPU seconds."""

    finder: AnchorFinder
    draw: Path | None = None
    pictures: int = 0
    megapixels: float = 0.0
    seconds: float = 0.0
    found: list[tuple[float, float, float]] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)

    def look(self, name: str, image: np.ndarray, gsd: float, country: str, off: float) -> None:
        start = time.process_time()
        zoom = min(1.0, gsd * off / self.finder.finest)
        small = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA) if zoom < 1 else image
        anchors = list(self.finder.find(np.ascontiguousarray(small), gsd * off / zoom, VEHICLES_SD, country))
        self.seconds += time.process_time() - start
        self.pictures += 1
        self.megapixels += image.shape[0] * image.shape[1] / 1e6
        for anchor in anchors:
            errors = np.log(anchor.metres_per_pixel() * zoom / gsd)
            k = int(np.abs(errors).argmin())
            sd = float(np.hypot(anchor.relative_sd, anchor.standards[k].relative_sd))
            fit = float(np.sqrt(max(anchor.relative_sd**2 - LOCAL_STRETCH**2, 0.0)))
            self.found.append((float(errors[k]), sd, fit))
        if anchors:
            self.places.append(place_of(anchors, gsd / zoom, gsd * off / zoom, VEHICLES_SD, country))
        if self.draw and anchors:
            drawn(small, anchors, self.draw / f"{self.finder.kind}-{name}.png")

    def row(self, sort: str) -> str:
        start = f"| {sort} | {self.finder.kind} | {self.pictures} | {self.megapixels:.1f} |"
        cost = f"{self.seconds / max(self.megapixels, 1e-9):.2f} |"
        if not self.found:
            return f"{start} 0 | 0 | | | | | | {cost}"
        each, places = np.array(self.found), np.array(self.places)
        parts = [f"{start} {len(each)} | {len(places)} | {100 * np.median(each[:, 0]):+.1f}"]
        for errors, share in ((each, np.mean(np.abs(each[:, 0]) <= Z90 * each[:, 1])), (places, held(places))):
            size = np.abs(errors[:, 0])
            parts.append(" / ".join(f"{100 * value:.1f}" for value in (*np.quantile(size, [0.68, 0.9]), size.max())))
            parts.append(f"{100 * share:.0f}")
        return " | ".join([*parts, cost]) + "\n" + self.apart(each[:, 2], places)

    @staticmethod
    def apart(fit: np.ndarray, places: np.ndarray) -> str:
        """A line on the one sigma of fits (N,), and on places (M, 4) by whether the standard was right or wrong."""
        said = [f"  one sigma of the fit: median {100 * np.median(fit):.2f}, 90 % {100 * np.quantile(fit, 0.9):.2f} %"]
        for name, chosen in (("right", places[:, 3] > 0), ("wrong", places[:, 3] == 0)):
            these = places[chosen]
            if len(these):
                size = np.abs(these[:, 0])
                said.append(
                    f"{len(these)} places of the {name} standard: median {100 * np.median(size):.1f}, "
                    f"90 % {100 * np.quantile(size, 0.9):.1f} %, {100 * held(these):.0f} % in their intervals"
                )
        return "; ".join(said)


def drawn(image: np.ndarray, anchors: list[Anchor], path: Path) -> None:
    """Write `image` with the lines of `anchors`."""
    canvas = image[..., ::-1].copy()
    for anchor in anchors:
        for line in np.round((anchor.lines + 0.5) * 8).astype(int).tolist():
            cv2.line(canvas, line[0], line[1], (0, 255, 255), 1, cv2.LINE_AA, 3)
    cv2.imwrite(str(path), canvas)


def painted(kind: str, gsd: float, count: int) -> Iterator[Sample]:
    """Drawn anchors, one in each picture, in all directions, worn, partly under vehicles, blurred and noisy."""
    rng = np.random.default_rng(4)
    for number in range(count):
        turn, looks = rng.uniform(0, np.pi), {"blur_px": rng.uniform(0.5, 0.9), "noise": rng.uniform(1, 5)}
        if kind == RailTracks.kind:
            bright = (RUST, (170, 165, 160), (215, 215, 215))[number % 3]
            boxes = track(y=rng.uniform(-5, 5), bright=bright, sleeper=rng.choice([0.6, 0.65]))
            yield (
                str(number),
                railway(boxes, gsd, 60, turn, bend=rng.choice([0, 1 / 900]), seed=number, **looks),
                gsd,
                "DE",
            )
            continue
        if kind == RunningTracks.kind:
            middle = ((0, 40), (60, 20), (-20, -40))[number % 3]
            lanes = int(rng.choice([6, 8]))
            yield str(number), running_track(gsd, 70, middle, turn, lanes=lanes, seed=number, **looks), gsd, "DE"
            continue
        if kind == Gridirons.kind:
            yield str(number), field_picture(gsd, turn, wear=rng.uniform(0, 0.4), seed=number, **looks), gsd, "US"
            continue
        white = tuple(int(level * rng.uniform(0.7, 1.0)) for level in PAINT[:1]) * 3
        if kind == ZebraCrossings.kind:
            shapes = [(stroke(20 + k, 22, 4, 0.5, 90), white) for k in range(12)]
            under = stroke(20 + rng.uniform(0, 11), 23, 4.5, 1.8, 90)
        elif kind == ParkingBays.kind:
            slant = rng.choice([90, 90, 60, 45])
            step = 2.5 / np.sin(np.radians(slant))
            shapes = [(stroke(12 + step * k, 22, 5, rng.uniform(0.1, 0.15), slant), white) for k in range(12)]
            under = stroke(12 + step * (rng.integers(1, 10) + 0.5), 22, 4.5, 1.8, slant)
        else:
            shapes = [(stroke(5 + 9 * k, 22, 3, 0.15), white) for k in range(7)]
            under = stroke(5 + 9 * rng.integers(1, 6), 22, 4.5, 1.8)
        yield str(number), picture(
            [*shapes, (under, (40, 44, 60))], gsd, (72, 72), turn=rng.uniform(0, 180), blur=rng.uniform(0.5, 0.9),
            noise=rng.uniform(1, 5), seed=number,
        ), gsd, "DE"  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", type=Path)
    finders: tuple[AnchorFinder, ...] = (
        ZebraCrossings(), ParkingBays(), LaneDashes(), RailTracks(), RunningTracks(), Gridirons()
    )  # fmt: skip
    parser.add_argument("--kind", choices=[finder.kind for finder in finders])
    chosen = parser.parse_args()
    draw = chosen.draw
    if draw:
        draw.mkdir(parents=True, exist_ok=True)
    print(HEAD)
    for finder in finders:
        if chosen.kind not in (None, finder.kind):
            continue
        for sort, pictures in (("orthophotos and frames of 7 places", scenes()), ("American chips", chips())):
            tally, rng = Tally(finder, draw), np.random.default_rng(0)
            for name, image, gsd, country in pictures:
                off = vehicles_off(rng)
                if gsd * off <= finder.coarsest:
                    tally.look(name, image, gsd, country, off)
            print(tally.row(sort), flush=True)
        for gsd in (0.06, 0.12, 0.2, 0.3):
            tally, rng = Tally(finder), np.random.default_rng(1)
            for name, image, gsd_, country in painted(finder.kind, gsd, 20):
                off = vehicles_off(rng)
                if gsd * off <= finder.coarsest:
                    tally.look(name, image, gsd_, country, off)
            print(tally.row(f"drawn, one each, {gsd:.2f} m/px"), flush=True)


if __name__ == "__main__":
    main()
