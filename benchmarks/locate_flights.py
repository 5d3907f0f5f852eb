"""`orthoscale locate` on real pictures: frames of a flight on an orthophoto of other frames of the same flight.

The map is made of the first half of the frames, in the order of their names, each place from the frame that sees it
most steeply, over the ground of the reconstruction. The second half are the photos, with pitch, roll and focal length
of the model, and a claimed scale that is right or wrong. So roofs lean and trees are seen from another side; light,
season and camera are the same. The truth is the model's.

    python benchmarks/locate_flights.py sheffield brighton      # Markdown on standard output; reads ../shared/data
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pyproj
import rasterio
from locate import DATA, Method
from rasterio.transform import from_origin

from orthoscale.core.projection.level import level_axes
from orthoscale.core.source import PosedSet
from orthoscale.errors import TooLittleEvidence
from orthoscale.locate.level import LevelledPhoto
from orthoscale.locate.register import Known
from orthoscale.photos.photo import Photo
from orthoscale.sources.lens import Lens
from orthoscale.sources.opening import open_source
from orthoscale.sources.satellite import Satellite
from orthoscale.sources.tags import read_tags

MAP_ACROSS = 1600  # [px] the longer side of the map
CHOSEN_EVERY = 16  # [px] side of the blocks of the map for which one frame is chosen
STEEPEST = 60.0  # [deg] off nadir, up to which a frame may be used for a place
SCALES = (0.8, 1.0, 1.25)  # claimed over true
INTERVAL = (0.8, 1.25)  # the 90 % interval of the claimed scale
EAST, NORTH = 500_000.0, 5_000_000.0  # of the map's corner
CRS = "EPSG:32632"


@dataclass(frozen=True)
class Flight:
    """A reconstruction with its frames. metres : per model unit."""

    posed: PosedSet
    cameras: dict[str, pycolmap.Camera]
    images: Path
    metres: float

    @classmethod
    def open(cls, name: str) -> Flight:
        folder = DATA / "reconstructions" / name
        posed = open_source(folder / "sparse", folder / "images").posed
        assert posed is not None
        model = pycolmap.Reconstruction(folder / "sparse")
        cameras = {image.name: model.cameras[image.camera_id] for image in model.images.values()}
        metres = json.loads((folder / "truth.json").read_text())["metres_per_model_unit"]
        return cls(posed, cameras, folder / "images", metres)

    def halves(self) -> tuple[list[str], list[str]]:
        names = sorted(name for name in self.cameras if (self.images / name).exists())
        return names[: len(names) // 2], names[len(names) // 2 :]

    def foot(self, name: str) -> np.ndarray:
        """(2,) the point below the camera, in the plane that follows the ground [model units]."""
        return self.posed.ground.plane(self.posed.centre(name)[None])[0]

    def up(self, name: str) -> np.ndarray:
        """(3,) the vertical in the camera's coordinates."""
        return self.posed.rotation(name) @ self.posed.ground.up

    def photo(self, name: str) -> Photo:
        tags = read_tags(self.images / name)
        lens = Lens(self.cameras[name], 0.0, "the model")
        return Photo(name, self.images / name, tags, lens, self.up(name), 0.0, "the model")

    def altitude(self, name: str) -> float:
        """Height of the camera above the ground [m]."""
        return float(self.posed.ground.height_above(self.posed.centre(name)[None])[0]) * self.metres

    def heading(self, name: str) -> float:
        """Direction of the picture's top, clockwise from the plane's second axis [rad]."""
        ahead = self.posed.rotation(name).T @ level_axes(self.up(name))[1]
        here = self.posed.centre(name)
        step = np.diff(self.posed.ground.plane(np.stack([here, here + ahead])), axis=0)[0]
        return float(np.arctan2(step[0], step[1]))


@dataclass(frozen=True)
class Map:
    """The map, and its upper left corner in the plane [model units]. gsd : [m/px]. covered : share of it with
    pixels."""

    sky: Satellite
    corner: np.ndarray
    gsd: float
    covered: float


def mapped(flight: Flight, names: list[str], path: Path) -> Map:
    """An orthophoto of the frames `names`."""
    ground, posed = flight.posed.ground, flight.posed
    feet = np.array([flight.foot(name) for name in names])
    reach = 1.2 * max(flight.altitude(name) for name in names) / flight.metres
    low, high = feet.min(0) - reach, feet.max(0) + reach
    step = float((high - low).max()) / MAP_ACROSS
    width, height = (int(v) // CHOSEN_EVERY * CHOSEN_EVERY for v in (high - low) / step)
    corner = np.array([low[0], low[1] + height * step])

    def world(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return ground.lift(corner + step * np.column_stack([columns + 0.5, -rows - 0.5]))

    coarse = np.indices((height // CHOSEN_EVERY, width // CHOSEN_EVERY)).reshape(2, -1)
    blocks = world(*(coarse * CHOSEN_EVERY + CHOSEN_EVERY / 2))
    off = np.full((len(names), blocks.shape[0]), np.inf)
    for k, name in enumerate(names):
        pixels = posed.project(name, blocks)
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= 4) & (pixels < np.array(posed.image_size(name)) - 4)).all(1)
        rays = posed.centre(name) - blocks
        angle = np.degrees(np.arccos(np.clip(rays @ ground.up / np.linalg.norm(rays, axis=1), -1, 1)))
        off[k, inside & (angle < STEEPEST)] = angle[inside & (angle < STEEPEST)]
    best = np.where(np.isfinite(off.min(0)), off.argmin(0), -1).reshape(coarse.max(1) + 1)
    chosen = np.kron(best, np.ones((CHOSEN_EVERY, CHOSEN_EVERY), int))
    picture, known = np.zeros((height, width, 3), np.uint8), chosen >= 0
    for k in np.unique(chosen[known]):
        rows, columns = np.nonzero(chosen == k)
        frame = cv2.imread(str(flight.images / names[k]))[..., ::-1]
        at = posed.project(names[k], world(rows, columns)).astype(np.float32) - 0.5
        shrunk = cv2.GaussianBlur(frame, (0, 0), 0.8)
        # OpenCV takes pictures of fewer than 2**15 rows only.
        for part in np.array_split(np.arange(len(rows)), len(rows) // 30_000 + 1):
            colours = cv2.remap(shrunk, at[part, None], None, cv2.INTER_LINEAR)[:, 0]
            picture[rows[part], columns[part]] = colours
    gsd = step * flight.metres
    place = from_origin(EAST, NORTH, gsd, gsd)
    with rasterio.open(path, "w", "GTiff", width, height, 3, CRS, place, "uint8", nodata=0) as out:
        out.write(np.moveaxis(np.where(known[..., None], np.maximum(picture, 1), 0), -1, 0))
    return Map(Satellite.open(path), corner, gsd, float(known.mean()))


@dataclass(frozen=True)
class Trial:
    """error : of the best candidate's foot [m], infinite without a candidate."""

    error: float
    answered: bool
    ratio: float
    problem: str
    seconds: float


def tried(flight: Flight, here: Map, name: str, method: Method, claimed: float, told: bool) -> Trial:
    seen = LevelledPhoto(flight.photo(name), flight.altitude(name) * claimed)
    # The map's columns point to grid north, which differs a little from true north.
    grid = np.radians(pyproj.Proj(CRS).get_factors(*here.sky.lon_lat(np.array([[0, 0]]))[0]).meridian_convergence)
    known = Known(INTERVAL, flight.heading(name) + grid if told else None)
    try:
        found, seconds = method.searched(seen, here.sky, known)
    except TooLittleEvidence as error:
        return Trial(np.inf, False, np.nan, error.message, 0.0)
    if not found.candidates:
        return Trial(np.inf, False, np.nan, found.problem, seconds)
    best = found.candidates[0]
    foot = flight.foot(name) - here.corner
    true = np.array([foot[0], -foot[1]]) * flight.metres
    error = float(np.hypot(*(best.map_pixels(np.zeros((1, 2)))[0] * here.gsd - true)))
    return Trial(error, found.located is not None, best.scale * claimed, found.problem, seconds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=["sheffield", "brighton", "weedon", "boruszyn"])
    parser.add_argument("--method", choices=("gradient", "dense"), default="gradient")
    parser.add_argument("--photos", type=int, default=12, help="of each flight, evenly over the second half")
    parser.add_argument("--keep", type=Path, help="folder for the maps")
    told = parser.parse_args()
    cv2.setNumThreads(1)
    method = Method.of(told.method, None)
    print(f"{told.method}\n")
    print("| flight | heading | claimed over true scale | photos | best within 5 m | 20 m | answered | wrong | "
          "largest error of an answer [m] | the map's scale over the true one | s |")  # fmt: skip
    print("|---" * 11 + "|")
    with tempfile.TemporaryDirectory() as folder:
        keep = told.keep or Path(folder)
        for scene in told.scenes:
            flight = Flight.open(scene)
            first, second = flight.halves()
            here = mapped(flight, first, keep / f"{scene}.tif")
            chosen = [second[k] for k in np.unique(np.linspace(0, len(second) - 1, told.photos).astype(int))]
            for heading, claimed in [(True, s) for s in SCALES] + [(False, 1.0)]:
                trials = [tried(flight, here, name, method, claimed, heading) for name in chosen]
                error = np.array([t.error for t in trials])
                answered = np.array([t.answered for t in trials])
                ratios = [t.ratio for t in trials if t.answered]
                print(
                    f"| {scene} | {'known' if heading else 'any'} | {claimed:g} | {len(trials)} | "
                    f"{(error < 5).mean():.2f} | {(error < 20).mean():.2f} | {answered.mean():.2f} | "
                    f"{(answered & (error >= 20)).sum()} | {error[answered].max(initial=0.0):.1f} | "
                    + (f"{np.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})" if ratios else "")
                    + f" | {np.median([t.seconds for t in trials]):.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
