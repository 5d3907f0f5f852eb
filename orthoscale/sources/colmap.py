"""COLMAP models: reads them, finds where their frames see the ground, and writes them again in metres."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ..core.claims import BY_ORTHOSCALE
from ..core.control import READING_SD
from ..core.projection.view import LOWEST_ELEVATION, Views
from ..core.remarks import CAUTION, INFO, Remark, informing
from ..core.source import FocalDoubt, GpsScale, Located, OffGround
from ..errors import InputError, OrthoscaleError, OutputError, UsageError
from ..formats.geometry.dense import scale_dense
from ..formats.geometry.files import reason_left
from ..formats.geometry.sim3 import Sim3
from ..formats.points import coordinates, number, pixel
from .already_metric import FromOrigin, where_gps_says
from .cameras import SCALED_MARK, refuse_another
from .colmap_beside import copy_beside
from .colmap_check import open_model
from .colmap_dense import dense_of
from .colmap_read import images_of, read_model
from .colmap_write import write_scaled
from .consistency import check_consistency, loose_images
from .database import pose_priors
from .dense_cloud import DenseCloud, sparse_points
from .dense_ground import dense_ground
from .distortion import project, undistort
from .fingerprint import Stamp, content_hash, require_unchanged
from .focal import bend_sd, focal_doubt, without_ground
from .frame_check import all_points_seen, check_frames
from .frames import find_frames
from .ground import Ground
from .ground_picture import GroundPicture, ground_pictures
from .picture_file import PictureFile
from .positions import gps_scale

if TYPE_CHECKING:
    from typing import Self

    import pycolmap

FEW_POINTS = 500  # with fewer points of three views or more, those of two are used, too; chosen by eye, not tuned


@dataclass(frozen=True, eq=False)
class ColmapSource:
    """A sparse COLMAP model with its frames. Open it with `ColmapSource.open`; the files are never changed.

    path : what was opened, or of several models in it the one that was taken. folder : the model's own folder, at or
    below it. input_format : 'bin' or 'txt'.
    pictures : the frames that are on disk, in the order of their names.
    notes : what was chosen or left out while opening, for the report.
    unit : of a scale of this source, as `write` takes it.
    images, need_images : as given to `open`.
    cloud : dense cloud from which the ground is found, beside the sparse points; see `on_cloud`.
    """

    path: Path
    folder: Path
    input_format: str
    pictures: list[PictureFile]
    notes: list[Remark]
    _paths: tuple[Path, ...]
    _model: pycolmap.Reconstruction
    images: Path | None = None
    need_images: bool = True
    unit: str = "m/model-unit"
    cloud: DenseCloud | None = None
    _stamps: tuple[Stamp, ...] = ()  # of the files, before they were read
    _parts: tuple[tuple[str, ...], ...] = ()  # as in `ModelFiles`
    _loose: frozenset[str] = frozenset()  # names of `loose_images`, which are left out

    @classmethod
    def open(
        cls, path: Path | str, images: Path | str | None = None, need_images: bool = True, compare_frames: bool = True
    ) -> ColmapSource:
        """Open the model at or below `path` (see `colmap_check.open_model`) and find its frames.

        images : the folder that image names are relative to; by default `images/` and the like are looked for beside
            and above the model. need_images : False if detections are given: then missing frames are a note, not an
            error. compare_frames : whether frames that are found are compared with the model (`check_frames`); False
            where nothing is measured.

        Raises InputError for a missing, damaged or inconsistent model (`check_consistency`), missing frames, or frames
        of another size than their camera.
        """
        files = open_model(Path(path))
        model = read_model(files.folder, files.format)
        loose = loose_images(model, files.seen)
        consistency = check_consistency(files.folder, model, files.seen, loose)
        pictures, missing = find_frames(model, files.folder, images, need_images, loose)
        notes = [*informing(files.notes), *consistency, *missing]
        parts = tuple(tuple(name for name in part if name not in loose) for part in files.parts)
        parts = tuple(part for part in parts if len(part) > 1)
        if len(parts) > 1:
            *most, last = (str(len(part)) for part in parts)
            sizes = f"{', '.join(most)} and {last} images"
            text = f"the model falls into parts that share no point ({sizes}): each may have a scale of its own"
            notes.append(Remark(CAUTION, text))
        if compare_frames:
            notes += check_frames(model, pictures, all_points_seen(model))
        if note := pose_priors(files.folder):
            notes.append(Remark(INFO, note))
        return cls(
            path=files.path,
            folder=files.folder,
            input_format=files.format,
            pictures=pictures,
            notes=notes,
            images=None if images is None else Path(images),
            need_images=need_images,
            _paths=files.paths,
            _model=model,
            _stamps=files.stamps,
            _parts=parts,
            _loose=loose,
        )

    def on_cloud(self, cloud: DenseCloud) -> Self:
        """The same source, with its ground found from the dense `cloud`. Raises InputError."""
        return replace(self, cloud=cloud, _stamps=(*self._stamps, *map(Stamp.of, cloud.files)))

    @property
    def points_and_cameras(self) -> tuple[np.ndarray, np.ndarray]:
        """(M, 3) points that several images see, and (C, 3) camera centres [model units]."""
        return sparse_points(self._model), np.array(list(self.centres.values()))

    @property
    def parts(self) -> Iterator[ColmapSource]:
        """Its parts that share no point with each other, each with its own images and points; none if it holds
        together. Each is made when its turn comes: it starts as a copy of the whole model."""
        return map(self._part, self._parts if len(self._parts) > 1 else ())

    def _part(self, images: tuple[str, ...]) -> ColmapSource:
        model, names = copy(self._model), set(images)
        for frame in model.reg_frame_ids():
            if not any(model.image(data.id).name in names for data in model.frame(frame).image_ids):
                model.deregister_frame(frame)
        pictures = [picture for picture in self.pictures if picture.name in names]
        return replace(self, _model=model, pictures=pictures, notes=[], cloud=None, _parts=())

    def __reduce__(self) -> tuple:
        """Pickled as its path, since pycolmap's models cannot be pickled: they are read again from their files."""
        images = None if self.images is None else self.images.absolute()
        cloud = None if self.cloud is None else replace(self.cloud, progress=None)
        return _reopened, (type(self), self.path.absolute(), images, self.need_images, cloud, self.notes)

    @cached_property
    def ground(self) -> Ground:
        """The ground under the cameras. Raises TooLittleEvidence or InputError if none is found."""
        points = np.array([p.xyz for p in self._model.points3D.values() if p.track.length() != 2])
        if len(points) < FEW_POINTS:  # points that only two images see are the worst, but better than none
            points = self.sparse[0]
        centres = np.array(list(self.centres.values()))
        try:
            sparse = Ground.fit(points, centres)
        except InputError as error:
            raise without_ground(self._model, error) from error
        return self._on_cloud(sparse, points, centres)

    def _on_cloud(self, sparse: Ground, points: np.ndarray, centres: np.ndarray) -> Ground:
        """The ground found from the dense cloud as well, if there is one. Without one, and if one that the user did not
        name is damaged or of another reconstruction, the `sparse` ground."""
        if self.cloud is None:
            return sparse
        try:
            ground = dense_ground(sparse, points, centres, self.cloud.blocks())
            note = Remark(INFO, f"the ground is found on {self.cloud.what}")
        except OrthoscaleError as error:
            why = error.message.removeprefix(str(self.cloud.path)).lstrip(",: ")
            if self.cloud.named:
                raise InputError(f"{self.cloud.what}: {why}", error.hint) from error
            text = f"{self.cloud.what} is left out, and the ground found from the sparse points: {why}"
            ground, note = sparse, Remark(CAUTION, text)
        if note not in self.notes:
            self.notes.append(note)
        return ground

    @cached_property
    def focal(self) -> FocalDoubt:
        """How far the focal length may be trusted."""
        return focal_doubt(self._model, self.pictures)

    @cached_property
    def bend_sd(self) -> float:
        """How far its tracks leave open whether it is bent, see `focal.bend_sd`."""
        return bend_sd(self._model, self.ground.up)

    @cached_property
    def gps(self) -> GpsScale:
        """The scale by the GPS positions of its frames."""
        return gps_scale(self)

    @cached_property
    def ground_pictures(self) -> list[GroundPicture]:
        """The near-nadir parts of the frames, warped onto the ground."""
        return ground_pictures(self, self.pictures)

    @property
    def camera_height(self) -> float:
        """Median height of the cameras over the ground [model units]."""
        return self.ground.camera_height

    @property
    def claimed(self) -> None:
        """A model in its own units claims no scale."""
        return None

    @property
    def plan(self) -> None:
        """None: a model is not a plan."""
        return None

    @property
    def posed(self) -> ColmapSource:
        """This source itself."""
        return self

    def from_above(self, place: np.ndarray) -> np.ndarray:
        """(N, 2) places on the ground's plane [model units] of points (N, 3). The direction of north is unknown."""
        return self.ground.plane(place)

    def locate(self, point: str) -> Located:
        """The position [model units] of a point given as ``X,Y,Z``, ``id:123`` (a 3D point) or ``NAME@X,Y`` (the ground
        at a pixel of an image). Raises ValueError, `OffGround`."""
        if point.startswith("id:"):
            return Located(self.point(int(number(point[3:]))), 0.0, np.zeros(3))
        if "@" not in point:
            return Located(coordinates(point, 3, "a point of a model"), 0.0, np.zeros(3))
        name, _, place = point.rpartition("@")
        at = pixel(place, *self.image_size(name), "a pixel")
        _, (there, *beside), ok = self.views(name, at + np.array([(0, 0), (1, 0), (0, 1)]))
        if not ok.all():
            raise OffGround(f"{point!r} does not see the model's ground")
        read_sd = READING_SD * float(np.linalg.norm(beside - there, axis=1).max())
        return Located(there, read_sd, there - self.centre(name))

    @property
    def by_orthoscale(self) -> bool:
        """Whether orthoscale wrote this model, whose folder then has a file of ours."""
        return (self.folder / SCALED_MARK).is_file()

    @property
    def metric_already(self) -> str:
        """Why this model counts as metric, empty if it does not: orthoscale wrote it, its coordinates are those of a
        map, or the GPS positions of its frames are its cameras' own."""
        return f"{BY_ORTHOSCALE} ({SCALED_MARK} lies in it)" if self.by_orthoscale else self._georeferenced

    @cached_property
    def _from_origin(self) -> FromOrigin:
        return FromOrigin.of(np.array(list(self.centres.values())))

    @cached_property
    def _georeferenced(self) -> str:
        return self._from_origin.as_on_a_map or where_gps_says(self.gps)

    def _tell_moved(self, scale: float) -> None:
        """Note that a model in map coordinates moves when it is scaled by `scale` about their origin."""
        if moved := self._from_origin.moved(scale):
            self.notes.append(Remark(INFO, moved))

    @cached_property
    def sparse(self) -> tuple[np.ndarray, np.ndarray]:
        """The sparse points: (M, 3) positions [model units] and (M, 3) uint8 RGB colours."""
        points = self._model.points3D.values()
        return np.array([p.xyz for p in points]), np.array([p.color for p in points], np.uint8)

    def point(self, number: int) -> np.ndarray:
        """(3,) position of the 3D point with this number [model units]. Raises ValueError if there is none."""
        if number not in self._model.points3D:
            raise ValueError(f"the model has no 3D point {number}")
        return np.array(self._model.points3D[number].xyz)

    @property
    def picture_names(self) -> list[str]:
        """Names of all registered images, also of those whose frames are missing; without `loose_images`."""
        return sorted(self._images)

    def _image(self, name: str) -> pycolmap.Image:
        if name not in self._images:
            raise UsageError(
                f"{self.folder}: no registered image is named {name}", "Names are those in the model, with its folders."
            )
        return self._images[name]

    @cached_property
    def _images(self) -> dict[str, pycolmap.Image]:
        return {name: image for name, image in images_of(self._model).items() if name not in self._loose}

    @cached_property
    def centres(self) -> dict[str, np.ndarray]:
        """(3,) centre of each camera [model units, world], by the name of its image."""
        return {name: self.centre(name) for name in self.picture_names}

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the model itself, and its dense cloud."""
        return self._paths if self.cloud is None else (*self._paths, self.cloud.path)

    def content_hash(self) -> str:
        """SHA-256 in hex over the names and contents of the model's files, and of its dense cloud's, which the scale
        depends on as well. Raises InputError, also if a file was changed since it was opened: the hash would be that of
        data that was not used."""
        require_unchanged(self._stamps)
        found = content_hash([*sorted(self._paths), *(self.cloud.files if self.cloud is not None else ())])
        require_unchanged(self._stamps)
        return found

    def views(
        self, name: str, points: np.ndarray, lowest_elevation: float = LOWEST_ELEVATION
    ) -> tuple[Views, np.ndarray, np.ndarray]:
        """How the image `name` sees the ground at its pixels `points` (N, 2).

        Returns the `Views` in camera coordinates, the ground points (N, 3) in world coordinates, and (N,) bool whether
        the ray meets known ground at `lowest_elevation` degrees or steeper. Where it is False, the values are finite
        placeholders. Raises UsageError for an image that the model does not have.
        """
        image = self._image(name)
        points = np.asarray(points, float).reshape(-1, 2)
        plane, lens, ok = undistort(self._model.camera(image.camera_id), points)

        camera_from_world = image.cam_from_world()
        rotation = camera_from_world.rotation.matrix()
        centre = image.projection_center()
        rays = np.column_stack([plane, np.ones(len(plane))]) @ rotation
        world, normal, meets = self.ground.intersect(np.broadcast_to(centre, rays.shape), rays)
        seen = world @ rotation.T + camera_from_world.translation
        ok &= meets & (seen[:, 2] > 0)
        seen[~ok] = (0, 0, self.camera_height)
        views = Views(seen, np.where(ok[:, None], normal @ rotation.T, (0, 0, -1.0)), lens)
        return views, world, ok & (views.elevation >= np.radians(lowest_elevation))

    def centre(self, name: str) -> np.ndarray:
        """(3,) camera centre of the image `name` [model units, world]."""
        return self._images[name].projection_center()

    def rotation(self, name: str) -> np.ndarray:
        """(3, 3) `camera_from_world` of the image `name`: its rows are the camera's x, y and z in the world."""
        return self._images[name].cam_from_world().rotation.matrix()

    def image_size(self, name: str) -> tuple[int, int]:
        """Width and height of the image `name` [px]. Raises UsageError for one that the model does not have."""
        camera = self._model.camera(self._image(name).camera_id)
        return camera.width, camera.height

    def project(self, name: str, world: np.ndarray) -> np.ndarray:
        """(N, 2) pixels of the points `world` (N, 3) in the image `name`; NaN for points that it cannot show."""
        image = self._images[name]
        pose = image.cam_from_world()
        return project(self._model.camera(image.camera_id), world @ pose.rotation.matrix().T + pose.translation)

    def check_writable(self) -> None:
        """Nothing to check: a model's files all lie in its own folder."""

    def write(self, folder: Path, metres_per_unit: float) -> None:
        """Write the model in metres into the empty `folder`, in its input format, with sim3.json and sim3.txt.

        All lengths are multiplied by `metres_per_unit` about the model's origin, without rotation or shift (`Sim3`).
        Small files beside the input model are copied along; `notes` says which, and what was left out.

        Raises UsageError for a scale that is not positive and finite, InputError for a model that was changed since it
        was opened, OutputError if the written files do not read back as the scaled model.
        """
        sim3 = Sim3(float(metres_per_unit))
        folder = Path(folder)
        require_unchanged(self._stamps)
        write_scaled(self.folder, self.input_format, self._model, folder, sim3.scale)
        try:
            sim3.save(folder)
            notes = informing(copy_beside(self.folder, folder, {path.name for path in self._paths}))
        except OSError as error:
            raise OutputError(f"{folder}: writing failed ({error})", "Check permissions and free space.") from error
        self.notes.extend(note for note in notes if note not in self.notes)
        self._tell_moved(sim3.scale)

    @cached_property
    def dense(self) -> Path:
        """The dense workspace that belongs to this model. Raises what `dense_of` raises."""
        found, remarks = dense_of(self.folder, self.centres, lambda: self.camera_height)
        self.notes.extend(remarks)
        return found

    def write_dense(self, folder: Path, metres_per_unit: float) -> None:
        """Write the dense workspace in metres into the empty `folder`. Raises what `dense` raises."""
        self.notes.extend(informing(scale_workspace(self.dense, folder, metres_per_unit)))


def _reopened(
    kind: type[ColmapSource], path: Path, images: Path | None, need: bool, cloud: DenseCloud | None, notes: list[Remark]
) -> ColmapSource:
    return replace(kind.open(path, images, need, compare_frames=False), cloud=cloud, notes=notes)


def scale_model(
    source: Path, target: Path, scale: float, metric: Mapping[str, np.ndarray] = MappingProxyType({})
) -> None:
    """Write the sparse model in the folder `source` into the empty folder `target` in metres.

    metric : cameras [m] of the model for which the scale was measured. Raises InputError; UsageError for a model that
    is in metres already, and for another model, whose cameras of the same names stand elsewhere.
    """
    model = ColmapSource.open(source, need_images=False, compare_frames=False)
    if model.by_orthoscale:
        raise UsageError(f"{source} is in metres already: {model.metric_already}", "Apply it to the original model.")
    refuse_another(source, model.centres, metric, scale)
    model.write(target, scale)


def scale_workspace(
    source: Path, target: Path, scale: float, metric: Mapping[str, np.ndarray] = MappingProxyType({})
) -> list[str]:
    """Write the dense workspace `source` into the empty folder `target` in metres; returns notes for the report.
    metric : as for `scale_model`."""
    of_files: list[str] = []
    notes = scale_dense(
        source,
        target,
        scale,
        lambda a, b: scale_model(a, b, scale, metric),
        lambda a, b: reason_left(a, b, scale, of_files),
    )
    return [*notes, *of_files]
