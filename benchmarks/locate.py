"""Success of `orthoscale locate` on simulated pairs: against scale error, heading and footprint, by method.

The map is a mosaic of real orthophotos (../shared/data: places, orthophotos) with chips of American cities between
them. Photos are what a pinhole camera would see of it at another date (tests/support/aerial.py): season, a fifth of the
ground rebuilt, vehicles moved, light, lean, defocus, noise. For photos of places that are not on the map see
`locate_negatives.py`.

    python benchmarks/locate.py --photos 20 --method gradient dense    # Markdown on standard output
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.transform import from_origin

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.aerial import Shot, other_date  # noqa: E402

from orthoscale.locate.features import Features, GradientFeatures  # noqa: E402
from orthoscale.locate.ground import GroundImage  # noqa: E402
from orthoscale.locate.register import Known, PlaceFinder, Registration, register  # noqa: E402
from orthoscale.sources.satellite import Satellite  # noqa: E402

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared" / "data")
FINE, COARSE = 0.2, 0.4  # [m/px] of the ground that photos see, and of the map
SIDE = 6000  # [px] of the mosaic: 1.44 km2
CHIP_GSD, CHIP_STEP = 0.3048, 390  # [m/px]; [px] of the mosaic that a chip of 256 px covers
FOCAL, WIDTH, HEIGHT = 600.0, 640, 480  # [px] of the photos
SCALE_ERRORS = (0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0)
FOOTPRINTS = (100.0, 150.0, 200.0, 300.0)  # [m] the photos' width
INTERVAL = (0.9, 1.1)  # the 90 % interval of a scale by vehicles


@dataclass(frozen=True)
class City:
    """fine : the ground that photos see. rects : (x, y, width, height) of its real orthophotos [px of `fine`]. sky :
    the map."""

    fine: np.ndarray
    rects: list[tuple[int, int, int, int]]
    sky: Satellite


@dataclass(frozen=True)
class Nadir:
    """A `Query` for a nadir picture with the claimed `gsd` [m/px]; its reference point is its middle."""

    rgb: np.ndarray
    gsd: float

    @property
    def size(self) -> np.ndarray:
        return self.gsd * np.array(self.rgb.shape[1::-1], float)

    def at(self, gsd: float) -> GroundImage:
        zoom = self.gsd / gsd
        how = cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR
        pixels = cv2.resize(self.rgb, None, fx=zoom, fy=zoom, interpolation=how)
        return GroundImage(pixels, np.ones(pixels.shape[:2], bool), gsd, -gsd * np.array(pixels.shape[1::-1]) / 2)


def resampled(path: Path, gsd: float) -> np.ndarray:
    picture = cv2.imread(str(path))
    how = cv2.INTER_AREA if gsd < FINE else cv2.INTER_CUBIC
    return cv2.resize(picture, None, fx=gsd / FINE, fy=gsd / FINE, interpolation=how)


def orthophotos() -> list[np.ndarray]:
    """Real orthophotos, BGR at FINE m/px."""
    known = json.loads((DATA / "places" / "truth.json").read_text())
    names = ("tartu_b.jpg", "tartu_c.jpg", "gorinchem.png", "kampala.jpg")
    parts = [resampled(DATA / "places" / name, known[name]["gsd_m"]) for name in names]
    return parts + [
        resampled(DATA / "orthophotos" / name, gsd) for name, gsd in (("banepa.jpg", 0.132), ("manila.tif", 0.0967))
    ]


def chips(kinds: Sequence[str] = ("",)) -> list[Path]:
    """Chips of American cities whose names begin with any of `kinds`, in random order."""
    found = sorted(p for p in (DATA / "vehicles" / "chips").glob("*.*") if p.name.startswith(tuple(kinds)))
    return [found[k] for k in np.random.default_rng(0).permutation(len(found))]


def mosaic(
    parts: list[np.ndarray], between: Sequence[Path], side: int = SIDE
) -> tuple[np.ndarray, list[tuple[int, int, int, int]]]:
    """A city from above, BGR, `side` px wide, of `parts` with chips `between` them; and where the parts are."""
    parts = sorted(parts, key=lambda part: -part.shape[0])
    city, used, rects = np.zeros((side, side, 3), np.uint8), np.zeros((side, side), bool), []
    x = y = row = 0
    for part in parts:
        height, width = part.shape[:2]
        if x + width > side:
            x, y, row = 0, y + row, 0
        city[y : y + height, x : x + width] = part
        used[y : y + height, x : x + width] = True
        rects.append((x, y, width, height))
        x, row = x + width, max(row, height)
    order = itertools.cycle(between)
    for top, left in itertools.product(range(0, side, CHIP_STEP), repeat=2):
        square = slice(top, top + CHIP_STEP), slice(left, left + CHIP_STEP)
        free = ~used[square]
        if free.any():
            chip = cv2.resize(cv2.imread(str(next(order))), (CHIP_STEP, CHIP_STEP))
            city[square][free] = chip[: free.shape[0], : free.shape[1]][free]
    return city, rects


def written(city: np.ndarray, path: Path) -> Satellite:
    """The mosaic as a georeferenced map of COARSE m/px."""
    side = round(len(city) * FINE / COARSE)
    smaller = cv2.resize(city, (side, side), interpolation=cv2.INTER_AREA)
    place = from_origin(500_000, 6_470_000, COARSE, COARSE)
    with rasterio.open(path, "w", "GTiff", side, side, 3, "EPSG:32635", place, "uint8", tiled=True) as out:
        out.write(np.moveaxis(smaller[..., ::-1], -1, 0))
    return Satellite.open(path)


def shots(city: City, count: int, footprint: float, seed: int) -> list[tuple[Shot, np.ndarray]]:
    """Poses and pictures (RGB) of photos, `footprint` m wide, over the city's real orthophotos at another date."""
    draw = np.random.default_rng(seed)
    area = np.array([w * h for _, _, w, h in city.rects], float)
    taken = []
    for _ in range(count):
        x, y, w, h = city.rects[draw.choice(len(area), p=area / area.sum())]
        margin = 0.35 * footprint / FINE
        at = [low + draw.uniform(min(margin, s / 2), max(s - margin, s / 2)) for low, s in ((x, w), (y, h))]
        heading = float(draw.uniform(0, 360))
        foot = (at[0] * FINE, at[1] * FINE)
        shot = Shot(foot, heading, footprint * FOCAL / WIDTH, FOCAL, (WIDTH, HEIGHT))
        picture = other_date(shot.of(city.fine, FINE), draw, footprint / WIDTH)
        taken.append((shot, np.ascontiguousarray(picture[..., ::-1])))
    return taken


@dataclass(frozen=True)
class Case:
    """One trial by `method`: photo `number` of those `footprint` m wide, with a claimed scale `factor` times the right
    one, its heading given to 6 degrees (`told`) or not at all."""

    method: str
    footprint: float
    told: bool
    factor: float
    number: int


@dataclass(frozen=True)
class Trial:
    """One search. error : of the best candidate [m], None without any. z : error of the scale of an answer in sigmas,
    None without one. inliers, needed : matches that agree at the best candidate, and that must agree. seconds :
    processor time of the search; for retrieval wall time, as its network has a process of its own."""

    case: Case
    error: float | None
    answered: bool
    z: float | None
    inliers: int
    needed: int
    seconds: float


@dataclass(frozen=True)
class Method:
    """A way to search. finder : None for correlation."""

    name: str
    features: Features
    finder: PlaceFinder | None = None

    @classmethod
    def of(cls, name: str, embedding: Path | None) -> Method:
        """The method called `name`; retrieval with the network `embedding`."""
        if name == "dense":
            from orthoscale.locate.dense import DenseFeatures

            return cls(name, DenseFeatures())
        if name == "retrieval":
            from orthoscale.locate.retrieval import Retrieval

            assert embedding is not None, "give --embedding"
            return cls(name, GradientFeatures(), Retrieval.open(embedding, None, cache=True))
        return cls(name, GradientFeatures())

    def searched(self, seen: Nadir, sky: Satellite, known: Known) -> tuple[Registration, float]:
        """The registration, and its duration [s]."""
        clock = time.process_time if self.finder is None else time.perf_counter
        begun = clock()
        found = register(seen, sky, self.features, known, finder=self.finder)
        return found, clock() - begun


def tried(city: City, method: Method, case: Case) -> Trial:
    ((shot, rgb),) = shots(city, 1, case.footprint, 1000 * int(case.footprint) + case.number)
    slack = np.random.default_rng(case.number).uniform(-6, 6)
    told = np.radians(shot.heading + slack) if case.told else None
    own = shot.altitude / shot.focal
    found, seconds = method.searched(Nadir(rgb, own * case.factor), city.sky, Known(INTERVAL, told))
    answered = found.located is not None
    if not found.candidates:
        return Trial(case, None, False, None, 0, found.needed, seconds)
    best = found.candidates[0]
    error = float(np.hypot(*(best.map_pixels(np.zeros((1, 2)))[0] * COARSE - shot.foot)))
    z = (best.scale * case.factor - 1) / found.scale_sd if answered else None
    return Trial(case, error, answered, z, best.inliers, found.needed, seconds)


def cases(method: str, photos: int) -> list[Case]:
    """All cases of the tables, one photo after the other, so that the tables are even whenever the run is stopped."""
    every = []
    for number in range(photos):
        for told in (True, False):
            every += [Case(method, 150.0, told, factor, number) for factor in SCALE_ERRORS]
            every += [Case(method, footprint, told, 1.0, number) for footprint in FOOTPRINTS if footprint != 150.0]
    return every


def kept(path: Path | None) -> list[Trial]:
    """The trials that earlier runs wrote to `path`."""
    if path is None or not path.exists():
        return []
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [Trial(Case(**row.pop("case")), **row) for row in rows]


HEAD = (
    "| {} | photos | best within 5 m | 20 m | answered | answered within 5 m | 20 m | wrong | "
    "scale off [sigmas, rms] | s of one core per km2 |\n|---|---|---|---|---|---|---|---|---|---|"
)


def line(label: str, trials: list[Trial]) -> str:
    """A row of a table: shares of photos, and the number of answers more than 20 m off."""
    error = np.array([np.inf if t.error is None else t.error for t in trials])
    answered = np.array([t.answered for t in trials])
    z = [t.z for t in trials if t.z is not None]
    shares = [error < 5, error < 20, answered, answered & (error < 5), answered & (error < 20)]
    spread = f"{np.sqrt(np.mean(np.square(z))):.1f}" if z else ""
    km2 = (SIDE * FINE / 1000) ** 2
    return (
        f"| {label} | {len(trials)} | "
        + " | ".join(f"{share.mean():.2f}" for share in shares)
        + f" | {(answered & (error >= 20)).sum()} | {spread} | {np.median([t.seconds for t in trials]) / km2:.2f} |"
    )


def tables(trials: list[Trial]) -> None:
    """Print tables of the cells that have trials."""
    for method, told in itertools.product(dict.fromkeys(t.case.method for t in trials), (True, False)):
        these = [t for t in trials if t.case.method == method and t.case.told == told]
        heading = "heading known to 6 degrees" if told else "heading not known"
        for title, by, chosen in (
            ("claimed over true scale", "factor", [t for t in these if t.case.footprint == 150.0]),
            ("footprint [m]", "footprint", [t for t in these if t.case.factor == 1.0]),
        ):
            if not chosen:
                continue
            print(f"\n{method}, {heading}\n\n{HEAD.format(title)}")
            for value in sorted({getattr(t.case, by) for t in chosen}):
                print(line(f"{value:g}", [t for t in chosen if getattr(t.case, by) == value]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", nargs="*", choices=("gradient", "dense", "retrieval"), default=["gradient"])
    parser.add_argument("--embedding", type=Path, help="network for retrieval")
    parser.add_argument("--photos", type=int, default=20, help="in each cell of the tables")
    parser.add_argument("--rows", type=Path, help="file of trials: those in it are not run again")
    told = parser.parse_args()
    cv2.setNumThreads(1)
    trials = kept(told.rows)
    done = {t.case for t in trials}
    methods = [Method.of(name, told.embedding) for name in told.method]  # what one lacks is said before the first runs
    fine, rects = mosaic(orthophotos(), chips())
    with tempfile.TemporaryDirectory() as folder:
        city = City(fine, rects, written(fine, Path(folder) / "map.tif"))
        for method in methods:
            for case in cases(method.name, told.photos):
                if case in done:
                    continue
                trials.append(tried(city, method, case))
                if told.rows is not None:
                    with told.rows.open("a") as file:
                        file.write(json.dumps(asdict(trials[-1])) + "\n")
    tables(trials)


if __name__ == "__main__":
    main()
