"""Small data sets with exact truth in the layouts that `orthoscale evaluate` reads: DenseUAV's, UAV-VisLoc+'s, CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyproj
import rasterio
from rasterio.transform import from_origin
from scipy.spatial.transform import Rotation

from ..core.boxes import Boxes
from ..core.detections import Detections
from ..core.ruler import Ruler
from ..evaluate.readers import DENSEUAV_FOCAL
from ..formats.detections.own import save_detections
from ..formats.pictures import write_jpeg
from .render import Look, depth, render, vehicle_boxes
from .scene import Scene
from .view import Camera, Perspective, Pose

FRAME_SIZE = (720, 540)  # width and height of a frame [px]; half the resolution of DenseUAV's cameras
VISLOC_FOCAL = 900.0  # [px] focal length of the frames in UAV-VisLoc's layout and in the CSV
LON_LAT = (9.0, 48.0)  # [deg] place of the scenes: central Europe, in UTM zone 32
GROUND_M, ROOFS_M = 120.0, 14.0
EFFECTIVE_HEIGHT_M = 0.8


def write_denseuav(
    scene: Scene, folder: Path, altitudes: Sequence[float] = (80, 90, 100), places: int = 3, pictures: bool = True
) -> None:
    """Write ``query_drone/000001/H80.JPG`` ...: every place from every altitude, straight down; and detections.json."""
    camera = Camera(DENSEUAV_FOCAL * float(np.hypot(*FRAME_SIZE)), *FRAME_SIZE)
    found: dict[str, Boxes] = {}
    rng = np.random.default_rng(1)
    for place in range(places):
        x, y = rng.uniform(-0.15, 0.15, 2) * scene.extent_m
        for altitude in altitudes:
            name = f"query_drone/{place + 1:06d}/H{altitude:g}.JPG"
            pose = Pose.looking(np.array([x, y, altitude]), rng.uniform(0, 2 * np.pi), np.pi / 2)
            found[name] = _photo(scene, camera, pose, folder / name, place, pictures)
    _write_detections(found, folder / "detections.json")


def write_visloc(
    scene: Scene,
    folder: Path,
    regions: Sequence[str] = ("01", "02"),
    photos: int = 4,
    altitude_m: float = 90.0,
    pictures: bool = True,
) -> None:
    """Write ``01/drone/01_0001.JPG`` ..., ``01/reference.txt``, ``01/camera.xml``, ``01/region01_dsm.tif`` and so on,
    as if the scene stood 120 m above the sea, with roofs on half of the surface model; and detections.json."""
    found: dict[str, Boxes] = {}
    for k, region in enumerate(regions):
        base = folder / region
        base.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng([k, 2])
        camera = Camera(VISLOC_FOCAL, *FRAME_SIZE)
        lines = ["# label longitude latitude height yaw pitch roll"]
        for number in range(1, photos + 1):
            name = f"{region}/drone/{region}_{number:04d}.JPG"
            # Yaw from north, pitch and roll from straight down, as in photogrammetry programs.
            yaw, pitch, roll = rng.uniform(0, 360), rng.normal(0, 4), rng.normal(0, 3)
            height = altitude_m * rng.uniform(0.9, 1.1)
            x, y = rng.uniform(-0.1, 0.1, 2) * scene.extent_m
            pose = Pose(survey_rotation(yaw, pitch, roll), np.array([x, y, height]))
            found[name] = _photo(scene, camera, pose, folder / name, 10 * k + number, pictures)
            lon, lat = _on_earth(x, y)
            angles = " ".join(f"{v:.6f}" for v in (yaw, pitch, roll))
            lines.append(f"{Path(name).name} {lon:.9f} {lat:.9f} {GROUND_M + height:.4f} {angles}")
        (base / "reference.txt").write_text("\n".join(lines) + "\n")
        width, high = FRAME_SIZE
        (base / "camera.xml").write_text(
            f"<calibration><projection>frame</projection><width>{width}</width><height>{high}</height>"
            f"<f>{VISLOC_FOCAL}</f><cx>0</cx><cy>0</cy><k1>0</k1><k2>0</k2><k3>0</k3><p1>0</p1><p2>0</p2></calibration>\n"
        )
        _write_dsm(base / f"region{region}_dsm.tif")
    _write_detections(found, folder / "detections.json")


def write_csv(scene: Scene, folder: Path, pitches: Sequence[float] = (-90, -70, -55), pictures: bool = True) -> None:
    """Write ``photos.csv`` with pitch [deg] and focal length [px], and its photos; detections.json; and
    ``depth/photos/000.npy`` ... with the exact depth along the optical axis [m]."""
    camera = Camera(VISLOC_FOCAL, *FRAME_SIZE)
    found: dict[str, Boxes] = {}
    rows = []
    for k, pitch in enumerate(pitches):
        name, altitude = f"photos/{k:03d}.jpg", 70.0 + 5 * k
        back = altitude / np.tan(np.radians(-pitch))
        pose = Pose.looking(np.array([-back, 0.0, altitude]), 0.0, np.radians(-pitch))
        found[name] = _photo(scene, camera, pose, folder / name, k, pictures)
        place = (folder / "depth" / name).with_suffix(".npy")
        place.parent.mkdir(parents=True, exist_ok=True)
        np.save(place, depth(scene, Perspective(camera, pose)).astype(np.float32))
        rows.append({"image": name, "altitude_m": altitude, "pitch_deg": pitch, "focal_px": VISLOC_FOCAL})
    with (folder / "photos.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    _write_detections(found, folder / "detections.json")


def survey_rotation(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """(3, 3) world (east, north, up) to camera axes, from the angles of photogrammetry programs [deg]: the picture's
    top to the north and straight down at zero; yaw clockwise, pitch lifts the nose, roll drops the right wing."""
    return np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("ZXY", [-yaw, pitch, roll], degrees=True).as_matrix().T


def _photo(scene: Scene, camera: Camera, pose: Pose, path: Path, seed: int, pictures: bool) -> Boxes:
    """Write the photo (plain grey without `pictures`); returns the boxes of the vehicles that lie completely in it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    view = Perspective(camera, pose)
    image = np.full((camera.height, camera.width, 3), 120, np.uint8)
    if pictures:
        image, _ = render(scene, view, seed, Look())
    write_jpeg(path, image, 93)
    near = tuple(v for v in scene.vehicles if view.in_front(np.array([v.x, v.y, 0.0])))
    boxes = vehicle_boxes(near, view, EFFECTIVE_HEIGHT_M)
    return boxes[boxes.inside(camera.width, camera.height)]


def _write_detections(found: dict[str, Boxes], path: Path) -> None:
    """Write the true boxes, as those of a faultless detector; only rounding adds noise, half a pixel at most."""
    height = (EFFECTIVE_HEIGHT_M, EFFECTIVE_HEIGHT_M)
    faultless = Ruler(margin_sd=(0.1, 0.1), bias_sd=(0.005, 0.005), noise=(0.3, 0.3))
    # `vehicle_boxes` treats vehicles as cuboids on the footprint.
    save_detections(Detections(found, 1.0, faultless, height, "true boxes of a synthetic scene", body="cuboid"), path)


def _on_earth(x: float, y: float) -> tuple[float, float]:
    lon, lat, _ = pyproj.Geod(ellps="WGS84").fwd(*LON_LAT, np.degrees(np.arctan2(x, y)), float(np.hypot(x, y)))
    return lon, lat


def _write_dsm(path: Path) -> None:
    """Write a surface model of 600 x 600 m, in cells of 2 m: ground at 120 m with a little noise, roofs on every second
    block of 20 m, and a border without data."""
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True)
    east, north = to_utm.transform(*LON_LAT)
    step, half = 2.0, 300.0
    count = int(2 * half / step)
    rows, columns = np.indices((count, count))
    blocks = (rows // 10 + columns // 10) % 2
    heights = GROUND_M + ROOFS_M * blocks + np.random.default_rng(0).normal(0, 0.05, blocks.shape)
    heights[:5] = -9999
    transform = from_origin(east - half, north + half, step, step)
    with rasterio.open(path, "w", "GTiff", count, count, 1, "EPSG:32632", transform, "float32", nodata=-9999) as out:
        out.write(heights.astype(np.float32), 1)
