"""A COLMAP model as OpenSfM, nerfstudio, Bundler and VisualSFM would write it, and checks of the result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from orthoscale.actions.fix import fix
from orthoscale.formats.detections.own import save_detections

from .flights import UNIT, found_by
from .models import put_frames

LENS = {"f": 400.0, "k1": 0.05, "k2": -0.02}


def opensfm(model, folder: Path, **camera) -> Path:
    """The model as OpenSfM would write it."""
    lens = {"projection_type": "perspective", "width": 640, "height": 480, "focal": LENS["f"] / 640}
    shots, points = {}, {}
    for image in model.images.values():
        pose = image.cam_from_world()
        turn = Rotation.from_matrix(pose.rotation.matrix()).as_rotvec()
        shots[image.name] = {"camera": "c", "rotation": turn.tolist(), "translation": pose.translation.tolist()}
    for number, point in model.points3D.items():
        points[str(number)] = {"coordinates": point.xyz.tolist(), "color": point.color.tolist()}
    part = {"cameras": {"c": {**lens, "k1": LENS["k1"], "k2": LENS["k2"], **camera}}, "shots": shots, "points": points}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "reconstruction.json").write_text(json.dumps([part]))
    return folder / "reconstruction.json"


def nerfstudio(model, folder: Path, **more) -> Path:
    """The model as ns-process-data would write it."""
    frames = []
    for image in model.images.values():
        pose = image.cam_from_world()
        matrix = np.eye(4)
        matrix[:3, :3] = pose.rotation.matrix().T * (1, -1, -1)
        matrix[:3, 3] = image.projection_center()
        frames.append({"file_path": f"images/{image.name}", "transform_matrix": matrix.tolist()})
    folder.mkdir(parents=True, exist_ok=True)
    points = model.points3D.values()
    sparse_cloud(folder, np.array([p.xyz for p in points]), np.array([p.color for p in points]))
    text = {"camera_model": "OPENCV", "w": 640, "h": 480, "fl_x": LENS["f"], "fl_y": LENS["f"], "cx": 320, "cy": 240}
    text |= {"k1": LENS["k1"], "k2": LENS["k2"], "frames": frames, "ply_file_path": "sparse_pc.ply", **more}
    (folder / "transforms.json").write_text(json.dumps(text))
    return folder / "transforms.json"


def sparse_cloud(folder: Path, points: np.ndarray, colours: np.ndarray) -> None:
    """``sparse_pc.ply`` in `folder`, as nerfstudio writes it."""
    header = "ply\nformat ascii 1.0\nelement vertex {}\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    header += "".join(f"property uint8 {colour}\n" for colour in ("red", "green", "blue")) + "end_header\n"
    rows = (f"{x:8f} {y:8f} {z:8f} {r} {g} {b}\n" for (x, y, z), (r, g, b) in zip(points, colours, strict=True))
    (folder / "sparse_pc.ply").write_text(header.format(len(points)) + "".join(rows))


def process_data(model, folder: Path) -> None:
    """Write what ``ns-process-data images --skip-colmap`` leaves in `folder` (nerfstudio 1.1,
    process_data/colmap_utils.py): the world rotated so that z is up, as ``applied_transform`` states, and its points as
    text; cameras per frame."""
    folder.mkdir(parents=True, exist_ok=True)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    frames = []
    for number, image in model.images.items():
        matrix = np.eye(4)
        matrix[:3, :3] = turn @ image.cam_from_world().rotation.matrix().T * (1, -1, -1)
        matrix[:3, 3] = turn @ image.projection_center()
        camera = model.cameras[image.camera_id]
        lens = {
            "fl_x": camera.focal_length_x,
            "fl_y": camera.focal_length_y,
            "k1": 0.0,
            "k2": 0.0,
            "p1": 0.0,
            "p2": 0.0,
        }
        lens |= {"cx": camera.principal_point_x, "cy": camera.principal_point_y, "w": camera.width, "h": camera.height}
        lens |= dict(zip(("k1", "k2"), camera.params[3:5], strict=False)) if camera.model.name != "PINHOLE" else {}
        place = {"file_path": f"images/{image.name}", "transform_matrix": matrix.tolist(), "colmap_im_id": number}
        frames.append(place | lens | {"camera_model": "OPENCV"})
    points = np.array([point.xyz for point in model.points3D.values()]) @ turn.T
    sparse_cloud(folder, points, np.full(points.shape, 9))
    text = {"frames": frames, "applied_transform": np.column_stack([turn, np.zeros(3)]).tolist()}
    (folder / "transforms.json").write_text(json.dumps(text | {"ply_file_path": "sparse_pc.ply"}, indent=4))


def same_views(colmap, other, folder=""):
    """Assert that rays, ground and projections of both sources are the same; `other` has the pictures in `folder`."""
    pixels = np.random.default_rng(0).uniform((20, 20), (620, 460), (200, 2))
    for name in colmap.picture_names[::4]:
        theirs = folder + name
        views, world, ok = colmap.views(name, pixels)
        views2, world2, ok2 = other.views(theirs, pixels)
        assert (ok == ok2).all() and ok.mean() > 0.6
        assert np.allclose(world[ok], world2[ok], atol=0.02)  # another choice of ground points
        assert np.allclose(views.lens[ok], views2.lens[ok], rtol=1e-6, atol=1e-3)
        assert np.allclose(colmap.project(name, world[ok]), other.project(theirs, world[ok]), atol=1e-4)


def rescaled(model, turn, writer, tmp_path, **options):
    """The file that `writer` made from `model`, and the result of `fix` for it; asserts that the scale is right and the
    input untouched."""
    path = writer(model, tmp_path / "in")
    put_frames(model, tmp_path / "in/images")
    before = {p: p.read_bytes() for p in (tmp_path / "in").rglob("*.*")}
    save_detections(found_by(path, turn), tmp_path / "boxes.json")
    result = fix(path.parent, tmp_path / "out", fleet="DE", detections=tmp_path / "boxes.json", **options)
    assert {p: p.read_bytes() for p in before} == before
    assert result.scale.value == pytest.approx(UNIT, rel=0.03)
    return path, result


K1, K2 = 0.05, -0.02
FLIP = np.diag([1.0, -1.0, -1.0])


def colour(point) -> str:
    return " ".join(map(str, point.color.tolist()))


def track(model, point, first: int, y_up: bool = False) -> str:
    """The track of `point` in images, pixels from their middle; the first image has the number `first`."""
    numbers = {image: k for k, image in enumerate(model.images, first)}
    words = [str(len(point.track.elements))]
    for element in point.track.elements:
        x, y = model.image(element.image_id).points2D[element.point2D_idx].xy - (320, 240)
        words += [
            str(numbers[element.image_id]),
            str(element.point2D_idx),
            repr(float(x)),
            repr(float(-y if y_up else y)),
        ]
    return " ".join(words)


def bundler(model, folder: Path, k=(K1, K2), lost: int = 1) -> Path:
    """The model as Bundler would write it, after `lost` images that it did not register."""
    names = [f"lost{i}.jpg" for i in range(lost)] + [image.name for image in model.images.values()]
    lines = ["# Bundle file v0.3", f"{len(names)} {len(model.points3D)}"]
    lines += ["0 0 0", *["0 0 0"] * 3, "0 0 0"] * lost
    for image in model.images.values():
        pose = image.cam_from_world()
        rows = [*(FLIP @ pose.rotation.matrix()), FLIP @ pose.translation]
        lines += [
            f"{float(image.camera.params[0])!r} {k[0]} {k[1]}",
            *(" ".join(map(repr, row.tolist())) for row in rows),
        ]
    for point in model.points3D.values():
        lines += [" ".join(map(repr, point.xyz.tolist())), colour(point), track(model, point, lost, y_up=True)]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bundle.out").write_text("\n".join(lines) + "\n")
    (folder / "list.txt").write_text("".join(f"./{name} 0 400.0\n" for name in names))
    return folder / "bundle.out"


def nvm(model, folder: Path, r: float = 0.0, head: str = "NVM_V3", more: str = "0\n", tracks: bool = True) -> Path:
    """The model as VisualSFM would write it."""
    lines = [head, "", str(len(model.images))]
    for image in model.images.values():
        x, y, z, w = Rotation.from_matrix(image.cam_from_world().rotation.matrix()).as_quat()
        values = [image.camera.params[0], w, x, y, z, *image.projection_center(), r]
        lines.append(f"{image.name} " + " ".join(repr(float(v)) for v in values) + " 0")
    lines += ["", str(len(model.points3D))]
    for p in model.points3D.values():
        lines.append(f"{' '.join(map(repr, p.xyz.tolist()))} {colour(p)} " + (track(model, p, 0) if tracks else "0"))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.nvm").write_text("\n".join([*lines, "", more]))
    return folder / "scene.nvm"
