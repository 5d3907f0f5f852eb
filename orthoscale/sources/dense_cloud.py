"""Dense clouds and depth maps beside a reconstruction: finding them, and reading their points piece by piece."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.evenly import evenly
from ..core.progress import Progress
from ..core.remarks import CAUTION, INFO, Remark
from ..errors import InputError
from ..formats.geometry.dense import (
    DEPTH_KINDS,
    find_dense,
    read_depth_map,
    sparse_folders,
    visibility_fault,
)
from ..formats.geometry.ply import points_in
from ..formats.geometry.vertices import vertices_in
from ..formats.names import first_few
from ..formats.reading import absent
from ..system.paths import homes
from .cloud_fit import FEWEST_NEAR, cloud_fit
from .colmap_check import open_model
from .colmap_read import images_of, read_model

if TYPE_CHECKING:
    import pycolmap

MOST_DENSE_POINTS = 10_000_000  # that are used; more do not make the ground any better
# Depth maps, and depths of points in them, that are compared with the model; and by what factor their median may
# differ. Another run has a unit of its own, which is so near by chance only.
MAPS_COMPARED, DEPTHS_COMPARED, DEPTHS_APART = 5, 50, 1.1
MOST_LACKING_NAMED = 3  # images without depth maps
FUSED_CLOUD = "fused.ply"
Y_UP = (".glb", ".gltf", ".obj")  # whose y axis is up: Blender and others turn models to it whose z axis is up
# Where other programs write clouds in the coordinates of their reconstruction, relative to the folder of its file.
CLOUD_PLACES = (
    "../odm_filterpoints/point_cloud.ply",  # ODM, whose reconstruction.json lies in opensfm/
    "odm_filterpoints/point_cloud.ply",
    "undistorted/openmvs/scene_dense.ply",
    "undistorted/depthmaps/merged.ply",  # OpenSfM
)
# ODM's clouds in map coordinates, which are turned and shifted against the reconstruction's.
CLOUDS_ON_THE_MAP = tuple(f"odm_georeferencing/odm_georeferenced_model.{ending}" for ending in ("laz", "las", "ply"))


@dataclass(frozen=True)
class DenseCloud:
    """A dense point cloud, or COLMAP's depth maps, in the coordinates of a reconstruction.

    path : a PLY file, or a dense workspace of COLMAP. named : whether the user named it, rather than it being found.
    progress : called while it is read.
    """

    path: Path
    named: bool = False
    progress: Progress | None = None

    @property
    def what(self) -> str:
        """What to call it in a sentence."""
        return f"the cloud of the depth maps in {self.path}" if self.path.is_dir() else f"the dense cloud {self.path}"

    @property
    def files(self) -> list[Path]:
        """The files that its points are read from: the cloud; or the depth maps and the model with their cameras."""
        if not self.path.is_dir():
            return [self.path]
        cameras = [path for folder in sparse_folders(self.path)[:1] for path in sorted(folder.iterdir())]
        return [*_depth_maps(self.path), *(path for path in cameras if path.is_file())]

    def blocks(self) -> Iterator[np.ndarray]:
        """(N, 3) points [model units, world] in pieces, about MOST_DENSE_POINTS in all at most. Raises InputError for a
        damaged or truncated file."""
        return _of_depth_maps(self.path, self._show_progress) if self.path.is_dir() else self._of_file()

    def _of_file(self) -> Iterator[np.ndarray]:
        try:
            yield from points_in(self.path, MOST_DENSE_POINTS, self._show_progress)
        except OSError as error:
            raise InputError(f"{self.path} cannot be read ({error})", "Check its name and permissions.") from error

    def _show_progress(self, done: int, total: int) -> None:
        if self.progress is not None:
            self.progress("dense cloud", done, total)


def find_cloud(folder: Path, progress: Progress | None = None) -> tuple[DenseCloud | None, list[Remark]]:
    """The dense cloud that belongs to the reconstruction in `folder`, if one lies where programs put it, else COLMAP's
    depth maps; and remarks on clouds that cannot be used. Whether it really fits the reconstruction is not checked
    here."""
    workspace = find_dense(folder)
    files = [workspace / FUSED_CLOUD] if workspace else []
    for home in homes(folder):
        above = [home, home.parent, home.parent.parent] if home.name.isdigit() else [home, home.parent]
        files += [place / FUSED_CLOUD for place in above]
        files += [Path(os.path.abspath(home / name)) for name in CLOUD_PLACES]
    found = next((path for path in files if path.is_file()), None)
    if found is None and workspace is not None and _depth_maps(workspace):
        found = workspace
    if found is not None:
        return DenseCloud(found, progress=progress), []
    for place in (home.parent / name for home in homes(folder) for name in CLOUDS_ON_THE_MAP):
        if place.is_file():
            text = (
                f"{place} is in the coordinates of a map, not in the reconstruction's, and is left out; the ground is "
                "found from the sparse points (odm_filterpoints/point_cloud.ply could be used)"
            )
            return None, [Remark(INFO, text)]
    return None, []


def cloud_at(path: Path, progress: Progress | None = None) -> DenseCloud:
    """The cloud or dense workspace that the user named. Raises InputError if `path` is neither."""
    if path.is_dir():
        fused = path / FUSED_CLOUD
        if not fused.is_file() and not _depth_maps(path):
            raise InputError(
                f"{path} is not a dense workspace of COLMAP: it has no {FUSED_CLOUD} and no depth maps",
                "Name a .ply file, or the folder that stereo/ lies in.",
            )
        return DenseCloud(fused if fused.is_file() else path, True, progress)
    if not path.is_file():
        raise absent(path, "Name a dense cloud (.ply) or a dense workspace of COLMAP.")
    if path.suffix.lower() != ".ply":
        raise InputError(f"{path} is not a PLY file", "Export the cloud as .ply, in the reconstruction's coordinates.")
    return DenseCloud(path, True, progress)


def _depth_maps(workspace: Path) -> list[Path]:
    """The depth maps of a workspace: if there are any that other views confirmed (geometric), only these."""
    folder = workspace / "stereo" / "depth_maps"
    for kind in DEPTH_KINDS:
        if maps := sorted(folder.rglob("[!.]*" + kind)):
            return maps
    return []


def _undistorted(sparse: Path) -> tuple[pycolmap.Reconstruction, dict[str, pycolmap.Image]]:
    """The model in the folder `sparse`, and its registered images by name. Raises InputError."""
    model = read_model(sparse, open_model(sparse).format)
    return model, images_of(model)


def _image_of(path: Path, workspace: Path) -> str:
    """The name of the image whose depth map `path` is."""
    name = path.relative_to(workspace / "stereo" / "depth_maps").as_posix()
    return next(name.removesuffix(kind) for kind in DEPTH_KINDS if name.endswith(kind))


def _of_no_image(path: Path, sparse: Path) -> InputError:
    return InputError(f"{path}: no image of {sparse} has this name", "Run image_undistorter again.")


def _check_depth_maps(
    workspace: Path, sparse: Path, model: pycolmap.Reconstruction, images: Mapping[str, pycolmap.Image]
) -> None:
    """Raise InputError for depth maps in `workspace` that are of another model than the undistorted `model` in its
    folder `sparse`, such as those of a former run: none has one of its `images`, or its points lie at other depths."""
    maps = _depth_maps(workspace)
    if not maps:
        return
    known = [path for path in maps if _image_of(path, workspace) in images]
    if not known:
        raise _of_no_image(maps[0], sparse)
    ratios = []
    for path in (known[k] for k in evenly(len(known), MAPS_COMPARED)):
        depth, image = read_depth_map(path), images[_image_of(path, workspace)]
        points = [model.point3D(seen.point3D_id).xyz for seen in image.points2D if seen.has_point3D()]
        pose, camera = image.cam_from_world(), model.camera(image.camera_id)
        local = np.array(points).reshape(-1, 3) @ pose.rotation.matrix().T + pose.translation
        local = local[local[:, 2] > 0]
        pixels = np.asarray(camera.img_from_cam(local), float).reshape(-1, 2) * depth.shape[::-1]
        column, row = (pixels / (camera.width, camera.height)).T
        inside = (column >= 0) & (column < depth.shape[1]) & (row >= 0) & (row < depth.shape[0])
        z = depth[row[inside].astype(int), column[inside].astype(int)]
        ratios.append((z / local[inside, 2])[np.isfinite(z) & (z > 0)])
    apart = np.concatenate(ratios)
    if len(apart) >= DEPTHS_COMPARED and abs(np.log(np.median(apart))) > np.log(DEPTHS_APART):
        raise InputError(
            f"{workspace}: its depth maps are not of the model {sparse}: they show its points at "
            f"{np.median(apart):.3g} times the distance",
            "They may be of a former run: run patch_match_stereo and stereo_fusion again, or remove --dense.",
        )


def check_workspace(workspace: Path) -> list[Remark]:
    """Raise InputError for a dense workspace whose depth maps, cloud or meshes are not of the undistorted model in it;
    returns remarks on what is missing, and on a cloud of which this cannot be told. A cropped cloud is of its model."""
    if not (sparse := sparse_folders(workspace)):
        return []
    model, images = _undistorted(sparse[0])
    _check_depth_maps(workspace, sparse[0], model, images)
    remarks = _on_missing_maps(workspace, sorted(images))
    points, centres = sparse_points(model), np.array([image.projection_center() for image in images.values()])
    for path in sorted(path for path in workspace.glob("[!.]*.ply") if path.is_file()):
        try:
            fit = cloud_fit(points, centres, points_in(path, MOST_DENSE_POINTS))
        except (InputError, OSError):  # what is wrong with it is said where it is written
            continue
        if fit.another:
            raise InputError(
                f"{path} is not of the model {sparse[0]}: {fit.said}",
                "It may be of a former run or in metres already: make it again, or move it away.",
            )
        if path.name == FUSED_CLOUD:
            if not fit.own:
                text = f"{path} may be of another model ({fit.said}): its copy is in metres only if it is of this one"
                remarks.append(Remark(CAUTION, text))
            try:
                text = visibility_fault(path, len(images))
            except OSError as error:
                text = f"{path}.vis cannot be read ({error.strerror})"
            if text:
                remarks.append(Remark(CAUTION, text))
    return remarks


def off_metric_model(path: Path, folder: Path, points: np.ndarray, centres: np.ndarray) -> str:
    """A sentence that says so if the vertices of the file `path`, in metres, do not lie where the model in `folder` has
    its `points` (M, 3) [m], seen from `centres` (C, 3) [m]; else, and where this cannot be told, empty."""
    try:
        fit = cloud_fit(points, centres, vertices_in(path, MOST_DENSE_POINTS))
        if fit.another and path.suffix.lower() in Y_UP:
            upright = (block[:, [0, 2, 1]] * [1, -1, 1] for block in vertices_in(path, MOST_DENSE_POINTS))
            fit = cloud_fit(points, centres, upright)
    except InputError:  # what is wrong with the file is said where it is written
        return ""
    doubt = "it is in metres only if it was in that model's units, turned or shifted"
    return f"does not lie on the sparse points of {folder} ({fit.said}): {doubt}" if fit.another else ""


def sparse_points(model: pycolmap.Reconstruction) -> np.ndarray:
    """(M, 3) points of a model that three images see or more; all of them, if these are few."""
    every = list(model.points3D.values())
    places = np.array([point.xyz for point in every]).reshape(-1, 3)
    sure = np.array([point.track.length() > 2 for point in every], bool)
    return places[sure] if sure.sum() >= FEWEST_NEAR else places


def _on_missing_maps(workspace: Path, names: list[str]) -> list[Remark]:
    """A caution if some of the images `names` have depth maps and others none, as after a stereo run that was stopped:
    on the geometric ones, unless there are none at all."""
    folder = workspace / "stereo" / "depth_maps"
    for kind in DEPTH_KINDS:
        lacking = [name for name in names if not (folder / f"{name}{kind}").is_file()]
        if 0 < len(lacking) < len(names):
            what = f"{kind.split('.')[1]} depth maps of {len(lacking)} of {len(names)} images"
            return [Remark(CAUTION, f"{workspace} has no {what}: {first_few(lacking, MOST_LACKING_NAMED)}")]
    return []


def _of_depth_maps(workspace: Path, progress: Callable[[int, int], None]) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the points of depth maps [model units, world], by the undistorted cameras of their workspace."""
    maps, sparse = _depth_maps(workspace), sparse_folders(workspace)
    if not sparse:
        raise InputError(
            f"{workspace} has depth maps, but not the undistorted model in sparse/ that they belong to",
            "Run image_undistorter again.",
        )
    model, images = _undistorted(sparse[0])
    for k, path in enumerate(maps):
        if (name := _image_of(path, workspace)) not in images:
            raise _of_no_image(path, sparse[0])
        depth, camera = read_depth_map(path), model.camera(images[name].camera_id)
        step = max(1, int(np.ceil(np.sqrt(depth.size * len(maps) / MOST_DENSE_POINTS))))
        row, column = (axis.ravel() for axis in np.mgrid[: depth.shape[0] : step, : depth.shape[1] : step])
        z = depth[row, column].astype(float)
        seen = np.isfinite(z) & (z > 0)
        # patch_match_stereo may make depth maps smaller than their images.
        pixels = np.column_stack([column[seen], row[seen]]) + 0.5
        pixels *= np.array([camera.width, camera.height]) / depth.shape[::-1]
        pose = images[name].cam_from_world()
        rays = np.column_stack([np.asarray(camera.cam_from_img(pixels), float).reshape(-1, 2), np.ones(len(pixels))])
        yield (rays * z[seen, None] - pose.translation) @ pose.rotation.matrix()
        progress(k + 1, len(maps))
