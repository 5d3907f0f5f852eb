"""COLMAP models of a known flight, written as files, and frames for them."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pycolmap


def make_model(
    camera_model="OPENCV", params=(400, 410, 320, 240, 0.05, -0.02, 0.001, -0.001), rig=False, points=1500, lift=0.0
):
    """A flight over flat ground: 640 x 480 px, 12 units up, pitched by 25 degrees; in a rotated coordinate system.
    lift : height of its sparse points above the ground [units]."""
    random = np.random.default_rng(0)
    model = pycolmap.Reconstruction()
    for number in (1, 2) if rig else (1,):
        camera = pycolmap.Camera(camera_id=number, model=camera_model, width=640, height=480, params=list(params))
        if not rig:
            model.add_camera_with_trivial_rig(camera)
        else:
            model.add_camera(camera)
    if rig:
        pair = pycolmap.Rig(rig_id=1)
        pair.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1))
        aside = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0, 0.2, 0.0])), np.array([0.1, 0, 0]))
        pair.add_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 2), aside)
        model.add_rig(pair)

    turn = pycolmap.Rotation3d(np.array([0.4, -0.3, 0.9])).matrix()
    points = np.column_stack([random.uniform(-12, 12, (points, 2)), random.normal(lift, 0.02, points)])
    colours = random.integers(0, 255, (len(points), 3), dtype=np.uint8)
    down = np.diag([1.0, -1, -1])
    image_id = 0
    for k, (x, y) in enumerate([(x, y) for x in (-6, -2, 2, 6) for y in (-5, 0, 5)]):
        tilt = pycolmap.Rotation3d(np.array([np.radians(25 * (-1) ** k), 0, 0])).matrix()
        rotation = tilt @ down
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation @ turn.T), -rotation @ np.array([x, y, 12.0]))
        if rig:
            frame = pycolmap.Frame(frame_id=k + 1, rig_id=1)
            frame.rig_from_world = pose
            members = [(image_id + 1, 1), (image_id + 2, 2)]
            for number, camera in members:
                frame.add_data_id(pycolmap.data_t(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera), number))
            model.add_frame(frame)
            for number, camera in members:
                image = pycolmap.Image(name=f"cam{camera}/{k:02d}.png", camera_id=camera, image_id=number)
                image.frame_id = k + 1
                model.add_image(image)
            model.register_frame(k + 1)
            image_id += 2
        else:
            image_id += 1
            image = pycolmap.Image(name=f"{k:02d}.png", camera_id=1, image_id=image_id)
            model.add_image_with_trivial_frame(image, pose)

    seen = {number: [] for number in model.images}
    tracks = []
    for index, point in enumerate(points @ turn.T):
        track = []
        for number, image in model.images.items():
            pixel = image.project_point(point)
            if pixel is not None and 0 < pixel[0] < 640 and 0 < pixel[1] < 480:
                track.append((number, len(seen[number])))
                seen[number].append(pixel)
        tracks.append((index, point, track))
    for number, pixels in seen.items():
        model.images[number].points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in [*pixels, (5.0, 5.0)]])
    for index, point, track in tracks:
        if len(track) >= 3:
            elements = pycolmap.Track([pycolmap.TrackElement(i, k) for i, k in track])
            model.add_point3D(point, elements, colours[index])
    return model, turn


def save(model, folder: Path, form: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(folder)) if form == "bin" else model.write_text(str(folder))
    return folder


def put_frames(model, folder: Path, size=(640, 480)):
    for image in model.images.values():
        path = folder / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((size[1], size[0], 3), 90, np.uint8))


def draw_points(model, image, place, k1=None):
    """A frame with the points of `image` in their colours, by its lens, or by that of `make_model` with this k1."""
    frame = np.full((480, 640, 3), 90, np.uint8)
    camera = pycolmap.Camera(model.camera(image.camera_id).todict())
    if k1 is not None:
        camera.params = [*camera.params[:4], k1, *camera.params[5:]]
    for seen in image.points2D:
        if seen.has_point3D():
            point = model.points3D[seen.point3D_id]
            x, y = camera.img_from_cam((image.cam_from_world() * point.xyz)[None])[0].astype(int).tolist()
            cv2.circle(frame, (x, y), 4, point.color[::-1].tolist(), -1)
    place.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(place), frame)


def patched(folder: Path, name: str, offset: int, form: str, *values) -> None:
    path = folder / name
    data = bytearray(path.read_bytes())
    struct.pack_into("<" + form, data, offset, *values)
    path.write_bytes(data)
