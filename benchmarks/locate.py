"""Success of `orthoscale locate` on simulated pairs: against scale error, heading and footprint, by method.

The map is a mosaic of real orthophotos (../shared/data: places, orthophotos, and chips of American cities between
them) with their mirror images as further places. Photos are what a pinhole camera sees of it at another date
(tests/support/aerial.py): season, a fifth of the ground rebuilt, vehicles moved, light, lean, defocus, noise. Negatives
are photos of places whose ground was taken out of the map.

    python benchmarks/locate.py --photos 20 --method gradient          # Markdown on standard output
    python benchmarks/locate.py --negatives 500 --method gradient
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.transform import from_origin

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.aerial import Shot, other_date  # noqa: E402

from orthoscale.locate.features import Features, GradientFeatures  # noqa: E402
from orthoscale.locate.ground import GroundImage  # noqa: E402
from orthoscale.locate.register import Known, Registration, register  # noqa: E402
from orthoscale.sources.satellite import Satellite  # noqa: E402

DATA = Path(os.environ.get("ORTHOSCALE_DATA", Path(__file__).parents[2] / "shared" / "data"))
FINE, COARSE = 0.2, 0.4  # [m/px] of what photos see, and of the map
SIDE = 6000  # [px] of the mosaic: 1.44 km2
CHIP_GSD, CHIP_STEP = 0.3048, 390  # [m/px]; [px] of the mosaic that a chip of 256 px covers
FOCAL, WIDTH, HEIGHT = 600.0, 640, 480  # [px] of the photos
SCALE_ERRORS = (0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0)
FOOTPRINTS = (100.0, 150.0, 200.0, 300.0)  # [m] the photos' width
INTERVAL = (0.9, 1.1)  # the 90 % interval of a scale by vehicles


@dataclass(frozen=True)
class City:
    """fine : what photos see. rects : (x, y, width, height) of its real orthophotos [px of `fine`]. sky : the map."""

    fine: np.ndarray
    rects: list[tuple[int, int, int, int]]
    sky: Satellite


@dataclass(frozen=True)
class Nadir:
    """A `Seen` of a picture from straight above that claims `gsd`; its own place is its middle."""

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


def mosaic() -> tuple[np.ndarray, list[tuple[int, int, int, int]]]:
    """The city from above, BGR, and where its real orthophotos are."""
    known = json.loads((DATA / "places" / "truth.json").read_text())
    names = ("tartu_b.jpg", "tartu_c.jpg", "gorinchem.png", "kampala.jpg")
    parts = [resampled(DATA / "places" / name, known[name]["gsd_m"]) for name in names]
    parts += [resampled(DATA / "orthophotos" / name, g) for name, g in (("banepa.jpg", 0.132), ("manila.tif", 0.0967))]
    parts += [np.ascontiguousarray(part[:, ::-1]) for part in parts]
    parts.sort(key=lambda part: -part.shape[0])
    city, used, rects = np.zeros((SIDE, SIDE, 3), np.uint8), np.zeros((SIDE, SIDE), bool), []
    x = y = row = 0
    for part in parts:
        height, width = part.shape[:2]
        if x + width > SIDE:
            x, y, row = 0, y + row, 0
        city[y : y + height, x : x + width] = part
        used[y : y + height, x : x + width] = True
        rects.append((x, y, width, height))
        x, row = x + width, max(row, height)
    chips = sorted((DATA / "vehicles" / "chips").glob("*.*"))
    order = iter(np.random.default_rng(0).permutation(len(chips)))
    for top in range(0, SIDE, CHIP_STEP):
        for left in range(0, SIDE, CHIP_STEP):
            free = ~used[top : top + CHIP_STEP, left : left + CHIP_STEP]
            if free.any():
                chip = cv2.resize(cv2.imread(str(chips[next(order)])), (CHIP_STEP, CHIP_STEP))
                city[top : top + CHIP_STEP, left : left + CHIP_STEP][free] = chip[: free.shape[0], : free.shape[1]][
                    free
                ]
    return city, rects


def written(city: np.ndarray, path: Path) -> Satellite:
    """The mosaic as a georeferenced map of COARSE m/px."""
    side = round(SIDE * FINE / COARSE)
    smaller = cv2.resize(city, (side, side), interpolation=cv2.INTER_AREA)
    place = from_origin(500_000, 6_470_000, COARSE, COARSE)
    with rasterio.open(path, "w", "GTiff", side, side, 3, "EPSG:32635", place, "uint8", tiled=True) as out:
        out.write(np.moveaxis(smaller[..., ::-1], -1, 0))
    return Satellite.open(path)


def shots(city: City, count: int, footprint: float, seed: int) -> list[tuple[Shot, np.ndarray]]:
    """Photos `footprint` m wide over the city's real orthophotos at another date: poses and pictures (RGB)."""
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
class Trial:
    """One search. error : of the best candidate [m]. z : of its scale, in sigmas."""

    found: Registration
    error: float
    seconds: float
    z: float


def tried(
    city: City, features: Features, shot: Shot, rgb: np.ndarray, factor: float, heading: bool, slack: float
) -> Trial:
    """One photo whose claimed scale is `factor` times the right one; `heading` known to 6 degrees, or not at all."""
    told = np.radians(shot.heading + slack) if heading else None
    begun = time.perf_counter()
    own = shot.altitude / shot.focal
    found = register(Nadir(rgb, own * factor), city.sky, features, Known(INTERVAL, told))
    seconds = time.perf_counter() - begun
    if not found.candidates:
        return Trial(found, np.inf, seconds, np.nan)
    best = found.candidates[0]
    error = float(np.hypot(*(best.map_pixels(np.zeros((1, 2)))[0] * COARSE - shot.foot)))
    return Trial(found, error, seconds, (best.scale * factor - 1) / found.scale_sd if found.located else np.nan)


def line(label: str, trials: list[Trial]) -> str:
    error = np.array([t.error for t in trials])
    answered = np.array([t.found.located is not None for t in trials])
    wrong = int((answered & (error > 20)).sum())
    z = np.array([t.z for t in trials])
    spread = np.sqrt(np.nanmean(z[answered] ** 2)) if answered.any() else np.nan
    seconds = np.median([t.seconds for t in trials])
    return (
        f"| {label} | {len(trials)} | {(error < 5).mean():.2f} | {(error < 20).mean():.2f} | {answered.mean():.2f} | "
        f"{(answered & (error < 5)).mean():.2f} | {wrong} | {spread:.1f} | {seconds:.1f} |"
    )


HEAD = (
    "| | photos | best within 5 m | 20 m | answered | answered within 5 m | answered wrong | scale off [sigmas] | s |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


def curves(city: City, features: Features, photos: int, parts: list[str]) -> None:
    """Tables on standard output."""
    slack = np.random.default_rng(5).uniform(-6, 6, photos)

    def run(footprint: float, factor: float, heading: bool) -> list[Trial]:
        taken = shots(city, photos, footprint, int(footprint))
        return [tried(city, features, s, rgb, factor, heading, slack[k]) for k, (s, rgb) in enumerate(taken)]

    if "footprint" in parts:
        print(f"\n{features.name}, right scale, heading known to 6 degrees\n\n{HEAD}")
        for footprint in FOOTPRINTS:
            print(line(f"{footprint:.0f} m", run(footprint, 1.0, True)), flush=True)
    if "heading" in parts:
        print(f"\n{features.name}, 150 m, right scale, heading not known\n\n{HEAD}")
        print(line("150 m", run(150.0, 1.0, False)), flush=True)
    if "scale" in parts:
        print(f"\n{features.name}, 150 m, heading known, claimed over true scale\n\n{HEAD}")
        for factor in SCALE_ERRORS:
            print(line(f"{factor:g}", run(150.0, factor, True)), flush=True)


def negatives(city: City, features: Features, count: int, first: int) -> None:
    """Photos of orthophotos that are not on the map: half of them taken off it, the photos of that half looked for."""
    kept = city.fine.copy()
    gone = [k for k in range(len(city.rects)) if k % 2]
    draw = np.random.default_rng(7)
    for k in gone:
        x, y, w, h = city.rects[k]
        others = [r for j, r in enumerate(city.rects) if j not in gone]
        u, v, a, b = others[draw.integers(len(others))]
        patch = np.rot90(city.fine[v : v + b, u : u + a], 1)  # turned ground of elsewhere fills the place
        tile = np.tile(patch, (-(-h // patch.shape[0]), -(-w // patch.shape[1]), 1))
        kept[y : y + h, x : x + w] = tile[:h, :w]
    with tempfile.TemporaryDirectory() as folder:
        sky = written(kept, Path(folder) / "map.tif")
        elsewhere = City(city.fine, [city.rects[k] for k in gone], sky)
        answered, most = 0, 0.0
        for number in range(first, first + count):
            draw = np.random.default_rng(10_000 + number)
            ((shot, rgb),) = shots(elsewhere, 1, float(draw.choice(FOOTPRINTS)), number)
            trial = tried(elsewhere, features, shot, rgb, 1.0, bool(number % 4), float(draw.uniform(-6, 6)))
            answered += trial.found.located is not None
            if trial.found.candidates:
                most = max(most, trial.found.candidates[0].inliers / trial.found.needed)
            if (number + 1) % 25 == 0:
                done = number + 1 - first
                print(f"{done} negatives: {answered} answered, at most {most:.2f} of what is needed", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", choices=("gradient", "dense"), default="gradient")
    parser.add_argument("--photos", type=int, default=20)
    parser.add_argument("--negatives", type=int, default=0, help="photos of places that are not on the map")
    parser.add_argument("--first", type=int, default=0, help="number of the first negative")
    parser.add_argument("--parts", nargs="*", default=["footprint", "heading", "scale"])
    told = parser.parse_args()
    features: Features = GradientFeatures()
    if told.method == "dense":
        from orthoscale.locate.dense import DenseFeatures

        features = DenseFeatures()
    fine, rects = mosaic()
    with tempfile.TemporaryDirectory() as folder:
        city = City(fine, rects, written(fine, Path(folder) / "map.tif"))
        if told.negatives:
            negatives(city, features, told.negatives, told.first)
        else:
            curves(city, features, told.photos, told.parts)


if __name__ == "__main__":
    main()
