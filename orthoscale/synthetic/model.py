"""Surveys of a scene with exact truth: an orthophoto, or the frames of a flight and their COLMAP model."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.boxes import Boxes
from ..errors import UsageError
from ..formats.pictures import write_jpeg, write_png
from ..sources.colmap_library import pycolmap
from .labels import visible_share
from .render import Look, ortho_view, render, surface, vehicle_boxes
from .scene import Scene
from .view import Camera, Perspective, Pose


@dataclass(frozen=True)
class SceneToModel:
    """From the scene's metres to a model's units: ``model = rotation @ metres / metres_per_unit + translation``."""

    metres_per_unit: float
    rotation: np.ndarray
    translation: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, metres_per_unit: float) -> SceneToModel:
        """With the given scale and a random rotation and translation, as from structure from motion."""
        q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        return cls(metres_per_unit, q * np.sign(np.linalg.det(q)), rng.normal(0, 5, 3))

    def points(self, metres: np.ndarray) -> np.ndarray:
        """(..., 3) [m] to (..., 3) [model units]."""
        return metres @ self.rotation.T / self.metres_per_unit + self.translation

    def cam_from_world(self, pose: Pose) -> np.ndarray:
        """(3, 4) COLMAP's ``cam_from_world`` of a pose, in model units."""
        rotation = pose.rotation @ self.rotation.T
        return np.column_stack([rotation, -rotation @ self.points(pose.centre)])


def flight(
    scene: Scene, n_frames: int, altitude_m: float, pitch_deg: float = 90.0, slope_deg: float = 0.0, seed: int = 0
) -> list[Pose]:
    """Poses of a drone that flies to and fro over the scene, looking forward at `pitch_deg` below the horizon.

    slope_deg : slope of the ground (along +x) relative to a level flight; the scene's ground stays z = 0, so that the
    flight is tilted instead. Positions and attitudes vary at random, as a drone's do.
    """
    rng = np.random.default_rng([seed, 5])
    lines = max(1, round(np.sqrt(n_frames)))
    per_line = [len(part) for part in np.array_split(np.arange(n_frames), lines)]
    pitch, half = np.deg2rad(pitch_deg), scene.extent_m / 2
    back = altitude_m / np.tan(pitch) if pitch_deg < 90 else 0.0
    tilt = np.deg2rad(slope_deg)
    level = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    poses = []
    for line, count in enumerate(per_line):
        across = half * ((line + 0.5) / lines * 2 - 1) * 0.75
        along = half * (np.arange(count) + 0.5 - count / 2) / count * 2 * 0.75
        yaw = np.pi * (line % 2)
        for a in along if line % 2 == 0 else along[::-1]:
            centre = np.array([a - back * np.cos(yaw), across, altitude_m]) + rng.normal(0, [0.5, 0.5, 0.3])
            pose = Pose.looking(centre, yaw + rng.normal(0, 0.02), pitch + rng.normal(0, 0.01), rng.normal(0, 0.01))
            poses.append(Pose(pose.rotation @ level.T, level @ pose.centre))
    return poses


def write_colmap(
    scene: Scene,
    folder: Path,
    metres_per_unit: float = 1.0,
    n_frames: int = 16,
    pitch_deg: float = 90.0,
    altitude_m: float = 60.0,
    focal_px: float = 900.0,
    width: int = 1000,
    height: int = 750,
    seed: int = 0,
    binary: bool = True,
    *,
    k1: float = 0.0,
    slope_deg: float = 0.0,
    n_points: int = 1500,
    noise_px: float = 0.3,
    pictures: bool = True,
) -> dict:
    """Write ``folder/images/*.jpg``, the COLMAP model ``folder/sparse`` and ``folder/truth.json``; returns the truth.

    The model's world is rotated and moved at random, and scaled so that one unit is `metres_per_unit` metres.
    k1 : radial distortion; 0 writes SIMPLE_PINHOLE, else SIMPLE_RADIAL. noise_px : standard deviation of the 2D
    observations. pictures : False leaves out the images, which take most of the time, and the boxes of their vehicles.
    Boxes in the truth are those of `vehicle_boxes`, with the visible share of each vehicle.
    """
    folder = Path(folder)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, 6])
    world = SceneToModel.drawn(rng, metres_per_unit)
    camera = Camera(focal_px, width, height, k1)
    views = [Perspective(camera, pose) for pose in flight(scene, n_frames, altitude_m, pitch_deg, slope_deg, seed)]
    names = [f"frame_{i:04d}.jpg" for i in range(n_frames)]
    look = Look.drawn(rng)  # one camera, one day
    frames, images = [], []
    for i, (name, view) in enumerate(zip(names, views, strict=True)):
        boxes = vehicle_boxes(scene.vehicles, view)
        frame: dict = {"name": name, "boxes": []}
        if pictures:
            image, owner = render(scene, view, seed + i, look)
            _write_photo(folder / "images" / name, image)
            images.append(image)
            frame["boxes"] = _boxes_truth(boxes, visible_share(scene.vehicles, view, owner))
        frames.append(frame)
    points, tracks = _tie_points(scene, views, n_points, rng)
    model = _model(world, views, names, images, points, tracks, noise_px, rng)
    (folder / "sparse").mkdir(exist_ok=True)
    (model.write_binary if binary else model.write_text)(str(folder / "sparse"))
    vehicles = _vehicles_truth(scene)
    for v in vehicles:
        v["centre_model"] = world.points(np.array([v["x_m"], v["y_m"], 0.0])).tolist()
    truth = {
        "metres_per_model_unit": metres_per_unit,
        "rotation": world.rotation.tolist(),
        "translation": world.translation.tolist(),
        "altitude_m": altitude_m,
        "pitch_deg": pitch_deg,
        "vehicles": vehicles,
        "frames": frames,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
    return truth


def write_ortho(scene: Scene, path: Path, gsd_m: float, seed: int = 0) -> dict:
    """Write the scene's true orthophoto without georeferencing (PNG or JPEG by its ending) and its truth.

    The truth goes to ``<stem>.truth.json`` beside it and is returned. Raises UsageError for another ending, before
    anything is rendered.
    """
    path = Path(path)
    write = _writer(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    view = ortho_view(scene, gsd_m)
    image, owner = render(scene, view, seed)
    write(path, image)
    boxes = _boxes_truth(vehicle_boxes(scene.vehicles, view), visible_share(scene.vehicles, view, owner))
    size = {"gsd_m": gsd_m, "width": view.width, "height": view.height}
    truth = size | {"vehicles": _vehicles_truth(scene), "boxes": boxes}
    path.with_suffix(".truth.json").write_text(json.dumps(truth, indent=1))
    return truth


def _writer(path: Path) -> Callable[[Path, np.ndarray], None]:
    """The function that writes a picture with the ending of `path`. Raises UsageError for another ending."""
    if path.suffix.lower() in (".jpg", ".jpeg"):
        return _write_photo
    if path.suffix.lower() == ".png":
        return write_png
    raise UsageError(f"{path.name}: a picture's name ends in .jpg or .png", "Choose another name.")


def _write_photo(path: Path, image: np.ndarray) -> None:
    write_jpeg(path, image, 93)


def _vehicles_truth(scene: Scene) -> list[dict]:
    return [
        {
            "x_m": v.x, "y_m": v.y, "heading_rad": v.heading,
            "length_m": v.length, "width_m": v.width, "height_m": v.height, "shape": v.shape,
        }
        for v in scene.vehicles
    ]  # fmt: skip


def _boxes_truth(boxes: Boxes, share: np.ndarray) -> list[dict]:
    """The boxes of vehicles of which more than 5 % is visible."""
    names = ("cx", "cy", "length", "width", "angle")
    return [
        {"vehicle": i, "visible": round(float(share[i]), 3)} | dict(zip(names, boxes.xylwa[i].tolist(), strict=True))
        for i in np.flatnonzero(share > 0.05).tolist()
    ]


def _tie_points(
    scene: Scene, views: Sequence[Perspective], count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random points on visible surfaces, seen by three frames or more; by two if there are fewer than `count` of those.

    Returns ((P, 3) [m], (P, frames) bool: which frames see which point).
    """
    seen = []
    for view in views:
        ideal = view.ideal()
        face, planes = surface(scene.mesh, ideal)
        ground = ideal.nearness(np.array([[0.0, 0, 1]]), np.zeros((1, 3)))
        seen.append((ideal, face, np.concatenate([planes, ground])))  # face -1 finds the ground at the end
    candidates = []
    for ideal, face, planes in seen:
        x, y = (rng.uniform(0, size, 6 * count // len(views)) for size in (ideal.width, ideal.height))
        plane = planes[face[y.astype(int), x.astype(int)]]
        nearness = plane[:, 0] * x + plane[:, 1] * y + plane[:, 2]
        keep = nearness > 1e-4
        candidates.append(np.stack(ideal.position(x[keep], y[keep], nearness[keep]), 1).astype(float))
    points = rng.permutation(np.concatenate(candidates))
    tracks = np.zeros((len(points), len(views)), bool)
    for k, (view, (ideal, face, planes)) in enumerate(zip(views, seen, strict=True)):
        pixels, place = view.project(points), ideal.project(points)
        # Far outside of the picture, polynomial distortion can fold back into it; the ideal picture has none.
        inside = view.in_front(points) & ((place > 0) & (place < [ideal.width, ideal.height])).all(1)
        inside &= ((pixels > 1) & (pixels < [view.width - 1, view.height - 1])).all(1)
        x, y = place[inside].T
        plane = planes[face[y.astype(int), x.astype(int)]]
        nearest = plane[:, 0] * x + plane[:, 1] * y + plane[:, 2]
        tracks[inside, k] = np.abs(1 / nearest - view.in_camera(points[inside])[:, 2]) < 0.05
    seen_by = tracks.sum(1)
    chosen = np.argsort(seen_by < 3, kind="stable")[:count]
    chosen = chosen[seen_by[chosen] >= 2]
    return points[chosen], tracks[chosen]


def _model(
    world: SceneToModel,
    views: Sequence[Perspective],
    names: Sequence[str],
    images: Sequence[np.ndarray],
    points: np.ndarray,
    tracks: np.ndarray,
    noise_px: float,
    rng: np.random.Generator,
) -> pycolmap.Reconstruction:
    """The COLMAP model; points take their colour from `images`, or stay grey if there are none."""
    model = pycolmap.Reconstruction()
    c = views[0].camera
    kind, parameters = "SIMPLE_PINHOLE", [c.focal_px, c.width / 2, c.height / 2]
    if c.k1:
        kind, parameters = "SIMPLE_RADIAL", [*parameters, c.k1]
    camera = pycolmap.Camera(model=kind, width=c.width, height=c.height, params=parameters, camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    elements: list[list[pycolmap.TrackElement]] = [[] for _ in points]
    colours = np.full((len(points), 3), 128, np.uint8)
    for k, (name, view) in enumerate(zip(names, views, strict=True)):
        which = np.flatnonzero(tracks[:, k])
        pixels = view.project(points[which]) + noise_px * rng.standard_normal((len(which), 2))
        image = pycolmap.Image(name=name, keypoints=pixels, camera_id=1, image_id=k + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(world.cam_from_world(view.pose)))
        for number, point in enumerate(which):
            elements[point].append(pycolmap.TrackElement(k + 1, number))
        if images:
            x, y = pixels.astype(int).T
            colours[which] = images[k][y.clip(0, c.height - 1), x.clip(0, c.width - 1)]
    for xyz, track, colour in zip(world.points(points), elements, colours, strict=True):
        model.add_point3D(xyz, pycolmap.Track(track), colour)
    model.update_point_3d_errors()
    return model
