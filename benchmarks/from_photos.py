"""How near is the scale if a reconstruction is made anew from the photos?

    python benchmarks/from_photos.py --keep FOLDER --scenes brighton,weedon,boruszyn   # ten minutes (data)
    python benchmarks/from_photos.py --keep FOLDER --rendered 24                       # an hour

COLMAP's structure from motion (pycolmap) starts from the photos and a focal length, as of EXIF: features, matches
between all photos, one camera whose focal length and distortion it adjusts. So points, tracks and poses have the errors
of another reconstruction. With ``--rendered`` the photos are those of `rendered_flights.py`, whose cameras are exact.

The true scale is that on the ground: the new model's points, laid by a similarity transform upon the same points as the
known cameras see them. (Not that of the cameras: seen from straight above, a model whose focal length or distortion is
off has them too high or in a bowl, and its ground is right.) Errors are those of `estimate` without GPS, by the model
made anew and by the known one. "Cameras off" is by how much the cameras then miss the known ones (RMS), as a share of
their spread: how much the new model is bent against the known one. Rendered photos have GPS positions whose errors are
0.3 m each, and walk by 0.15 m from photo to photo; "with GPS" is the error of `estimate` with them.

Prints Markdown. ``--keep FOLDER`` has photos and models; those in it are not made again. COLMAP is not reproducible to
the last digit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import orthoscale  # before pycolmap, whose zlib clashes with that of other libraries
from orthoscale.errors import OrthoscaleError
from orthoscale.sources.colmap import ColmapSource

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np  # noqa: E402
import pycolmap  # noqa: E402
import pyproj  # noqa: E402
from PIL import Image  # noqa: E402
from places import Scene, called, scenes  # noqa: E402
from rendered_flights import Flight, rendered  # noqa: E402
from support.photos import add_gps  # noqa: E402
from support.simulate import table  # noqa: E402

FEATURES = 3000  # of a photo, at most
FEWEST = 50  # points that a similarity transform is fitted to: orthoscale needs as many to find the ground
MISSES = 0.003  # [rad] most that a point's place may be off a ray to it; more is a wrong match


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


def seen_by(known: pycolmap.Reconstruction, model: pycolmap.Reconstruction) -> tuple[np.ndarray, np.ndarray]:
    """The points (M, 3) of `model`, and the same as the cameras of `known` see them: the places nearest to the rays
    through their observations. Without points that fewer than three photos see, or whose rays do not meet."""
    images = {image.name: image for image in known.images.values()}
    ours, theirs = [], []
    for point in model.points3D.values():
        views = [(model.images[e.image_id], e.point2D_idx) for e in point.track.elements]
        rays = [ray(known, images[i.name], i.points2D[k].xy) for i, k in views if i.name in images]
        if len(rays) < 3:
            continue
        centre, direction = (np.array(some) for some in zip(*rays, strict=True))
        across = np.eye(3) - direction[:, :, None] * direction[:, None]
        place = np.linalg.lstsq(across.sum(0), (across @ centre[:, :, None]).sum(0)[:, 0])[0]
        off = np.linalg.norm(across @ (place - centre)[:, :, None], axis=1)[:, 0]
        if (off < MISSES * np.linalg.norm(place - centre, axis=1)).all():
            ours.append(point.xyz)
            theirs.append(place)
    return np.array(ours), np.array(theirs)


def ray(model: pycolmap.Reconstruction, image: pycolmap.Image, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre (3,) and unit direction (3,), in the world, of the ray through a `pixel` of the `image`."""
    direction = np.append(model.cameras[image.camera_id].cam_from_img(pixel), 1.0)
    direction = image.cam_from_world().rotation.matrix().T @ direction
    return image.projection_center(), direction / np.linalg.norm(direction)


def cameras_off(
    known_from_ours: pycolmap.Sim3d, model: pycolmap.Reconstruction, known: pycolmap.Reconstruction
) -> float:
    """By how much the cameras of `model` miss those of `known` (RMS), as a share of these cameras' spread."""
    places = [{i.name: i.projection_center() for i in some.images.values() if i.has_pose} for some in (model, known)]
    both = sorted(set(places[0]) & set(places[1]))
    ours, theirs = (np.array([some[name] for name in both]) for some in places)
    spread = theirs - theirs.mean(0)
    return float(np.sqrt((((known_from_ours * ours) - theirs) ** 2).sum() / (spread**2).sum()))


def row(scene: Scene, folder: Path) -> list[str]:
    """One row of the table: the scene reconstructed in `folder`, and its scale."""
    path = reconstructed(scene.path, folder)
    if path is None:
        return [scene.name, "0", *[""] * 3, "no model", *[""] * 5]
    model, known = pycolmap.Reconstruction(path), pycolmap.Reconstruction(scene.path / "sparse")
    ours, theirs = seen_by(known, model)
    if len(ours) < FEWEST:
        return [scene.name, str(len(model.images)), *[""] * 3, f"{len(ours)} points are right", *[""] * 5]
    known_from_ours = pycolmap.estimate_sim3d(ours, theirs)
    truth = known_from_ours.scale * scene.truth
    focal = [next(iter(some.cameras.values())).mean_focal_length() for some in (model, known)]
    return [
        scene.name,
        str(len(model.images)),
        f"{focal[0] / focal[1]:.3f}",
        f"{100 * cameras_off(known_from_ours, model, known):.1f} %",
        estimated(scene, scene.path, scene.truth)[0],
        *estimated(scene, path, truth),
        *estimated(scene, path, truth, gps=True)[:2],
    ]


def estimated(scene: Scene, model: Path, truth: float, gps: bool = False) -> list[str]:
    """Error and interval [%], number of vehicles and verdict of the scale of a `model` of the scene."""
    try:
        scale = orthoscale.estimate(model, images=scene.path / "images", fleet=scene.country, gps=gps).scale
    except OrthoscaleError as error:
        return [f"refused: {error.message.split(',')[0]}", "", "", ""]
    low, high = (f"{100 * (end / truth - 1):+.1f}" for end in scale.interval90)
    error = f"{100 * (scale.value / truth - 1):+.1f}"
    return [error, f"{low} to {high}", str(scale.vehicles_used), scale.verdict]


def flight(number: int, folder: Path) -> Scene:
    """One flight of `rendered_flights.py`."""
    drawn = Flight.drawn(number)
    path = folder / f"flight_{number:02d}"
    scene = Scene(path, drawn.fleet, rendered(number, drawn, path)["metres_per_model_unit"])
    place(scene, np.random.default_rng([54, number]))
    return scene


def place(scene: Scene, rng: np.random.Generator) -> None:
    """Write GPS positions into the photos of the scene, in the order of their names, if they have none."""
    source = ColmapSource.open(scene.path)
    centres = np.array([source.centre(photo.name) for photo in source.pictures])
    metres = scene.truth * np.column_stack([source.ground.plane(centres), centres @ source.ground.up])
    metres += rng.normal(0, 0.3, metres.shape) + np.cumsum(rng.normal(0, 0.15, metres.shape), axis=0)
    lon, lat = pyproj.Proj(proj="aeqd", lon_0=8.0, lat_0=50.0, ellps="WGS84")(*metres[:, :2].T, inverse=True)
    for photo, *at in zip(source.pictures, lon, lat, metres[:, 2] - metres[:, 2].min(), strict=True):
        jpeg, tags = photo.path.read_bytes(), Image.Exif()
        add_gps(tags, *map(float, at))
        segment = tags.tobytes()
        if segment[:4] not in jpeg[:20]:
            photo.path.write_bytes(jpeg[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2) + segment + jpeg[2:])


def main(some: list[Scene], folder: Path) -> None:
    pycolmap.logging.minloglevel = 2  # warnings of single photos say nothing here
    rows = []
    for scene in some:
        rows.append(row(scene, folder / f"{scene.name}_anew"))
        print(*rows[-1], file=sys.stderr, flush=True)
    head = ["photos of", "photos", "focal length", "cameras off", "error, known model [%]"]
    print(table([*head, "error [%]", "90 % interval", "vehicles", "verdict", "with GPS", "90 % interval"], rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    parser.add_argument("--scenes", default="", help="names with commas; all without")
    parser.add_argument("--rendered", type=int, default=0, help="this many rendered flights, and no real photos")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        keep = options.keep or Path(scratch)
        if options.rendered:
            main([flight(number, keep) for number in range(options.rendered)], keep)
        else:
            main(called([scene for scene in scenes() if scene.path.is_dir()], options.scenes), keep)
