"""How near is the scale if a reconstruction is made anew from the photos?

    python benchmarks/from_photos.py --keep FOLDER --scenes brighton,weedon,boruszyn   # ten minutes (data)

COLMAP's structure from motion (pycolmap) starts from the photos and a focal length, as of EXIF: features, matches
between all photos, one camera whose focal length and distortion it adjusts. So points, tracks and poses have the errors
of another reconstruction. Its cameras, laid upon those of the known model by a similarity transform, give its true
scale; the error is that of `estimate` without GPS. "Cameras off" is by how much the cameras then miss each other (RMS),
as a share of their spread: how much the two models are bent against each other.

Prints Markdown. ``--keep FOLDER`` has the models; those in it are not made again. COLMAP is not reproducible to the
last digit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import orthoscale  # before pycolmap, whose zlib clashes with that of other libraries
from orthoscale.errors import OrthoscaleError

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np  # noqa: E402
import pycolmap  # noqa: E402
from places import Scene, called, scenes  # noqa: E402
from support.simulate import table  # noqa: E402

FEATURES = 3000  # of a photo, at most
FEWEST = 3  # cameras that a similarity transform needs


def reconstructed(scene: Path, folder: Path) -> Path | None:
    """The model of most photos that COLMAP makes in `folder` of those of the `scene`; None if it makes none."""
    photos = scene / "images"
    database, models = folder / "database.db", folder / "sparse"
    if not models.exists():
        folder.mkdir(parents=True, exist_ok=True)
        database.unlink(missing_ok=True)
        options = pycolmap.FeatureExtractionOptions()
        options.sift.max_num_features = FEATURES
        camera = next(iter(pycolmap.Reconstruction(scene / "sparse").cameras.values()))
        start = [camera.mean_focal_length(), camera.width / 2, camera.height / 2, 0.0]
        reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL", camera_params=",".join(map(str, start)))
        single, cpu = pycolmap.CameraMode.SINGLE, pycolmap.Device.cpu
        pycolmap.extract_features(
            database, photos, camera_mode=single, reader_options=reader, extraction_options=options, device=cpu
        )
        pycolmap.match_exhaustive(database, device=cpu)
        models.mkdir()
        pycolmap.incremental_mapping(database, photos, models)
    made = {path: len(pycolmap.Reconstruction(path).images) for path in sorted(models.iterdir())}
    return max(made, key=lambda path: made[path]) if made else None


def cameras(model: Path) -> dict[str, np.ndarray]:
    """The place (3,) of each photo's camera [model units], by its name."""
    images = pycolmap.Reconstruction(model).images.values()
    return {image.name: image.projection_center() for image in images if image.has_pose}


def against(model: Path, known: Path) -> tuple[int, float, float]:
    """Number of cameras that both models have, units of `known` per unit of `model`, and by how much cameras are off
    (RMS) as a share of their spread. Raises ValueError for fewer than FEWEST cameras."""
    ours, theirs = cameras(model), cameras(known)
    both = sorted(set(ours) & set(theirs))
    if len(both) < FEWEST:
        raise ValueError(f"{len(both)} cameras are in both models; {FEWEST} are needed")
    here, there = (np.array([some[name] for name in both]) for some in (ours, theirs))
    known_from_ours = pycolmap.estimate_sim3d(here, there)
    off = (known_from_ours * here) - there
    spread = there - there.mean(0)
    return len(both), known_from_ours.scale, float(np.sqrt((off**2).sum() / (spread**2).sum()))


def row(scene: Scene, folder: Path) -> list[str]:
    """One row of the table: the scene reconstructed in `folder`, and its scale."""
    model = reconstructed(scene.path, folder)
    if model is None:
        return [scene.name, "0", "", "no model", "", "", ""]
    number, unit, off = against(model, scene.path / "sparse")
    truth = unit * scene.truth
    of = [scene.name, str(number), f"{100 * off:.1f} %"]
    try:
        scale = orthoscale.estimate(model, images=scene.path / "images", fleet=scene.country, gps=False).scale
    except OrthoscaleError as error:
        return [*of, f"refused: {error.message.splitlines()[0]}", "", "", ""]
    low, high = (100 * (end / truth - 1) for end in scale.interval90)
    error = f"{100 * (scale.value / truth - 1):+.1f} %"
    return [*of, error, f"{low:+.1f} to {high:+.1f} %", str(scale.vehicles_used), scale.verdict]


def main(some: list[Scene], folder: Path) -> None:
    pycolmap.logging.minloglevel = 2  # warnings of single photos say nothing here
    rows = []
    for scene in some:
        rows.append(row(scene, folder / scene.name))
        print(*rows[-1], file=sys.stderr, flush=True)
    head = ["photos of", "cameras", "cameras off", "error", "90 % interval", "vehicles", "verdict"]
    print(table(head, rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    parser.add_argument("--scenes", default="", help="names with commas; all without")
    options = parser.parse_args()
    every = [scene for scene in scenes() if scene.path.is_dir()]
    with tempfile.TemporaryDirectory() as scratch:
        main(called(every, options.scenes), options.keep or Path(scratch))
