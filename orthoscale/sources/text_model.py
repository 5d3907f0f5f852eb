"""Reconstructions of Bundler (bundle.out) and VisualSFM (.nvm), in plain text, with their frames.

Their files do not state the sizes of the images, so the frames are needed.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING

import numpy as np

from ..core.remarks import CAUTION, Remark
from ..errors import InputError
from ..formats.geometry.files import scale_file
from ..formats.geometry.text_models import FIRST_OF_MANY, TextModel, image_names, read_text_model
from .colmap_read import cameras_of
from .consistency import Observations, check_consistency, loose_images, observations, some_of_each
from .fingerprint import Stamp
from .frame_check import check_frames, points_seen
from .frames import find_frames, image_folder, places_of
from .json_model import build_model
from .one_file import OneFileSource
from .picture_file import stored_size

if TYPE_CHECKING:
    import pycolmap


@dataclass(frozen=True, eq=False)
class TextSource(OneFileSource):
    """A reconstruction in one text file, with its frames. Made by `TextSource.open`."""

    @classmethod
    def open(
        cls, path: Path | str, images: Path | str | None = None, need_images: bool = True, compare_frames: bool = True
    ) -> TextSource:
        """Open the file `path`; otherwise like `ColmapSource.open`, but the frames must exist. Raises InputError."""
        path = Path(path)
        stamp = Stamp.of(path)
        text = read_text_model(path)
        names, lists = _names(path, text)
        wanted = sorted({name for name, focal in zip(names, text.focal, strict=True) if focal > 0})
        if not wanted:
            raise InputError(f"{path}: no image is registered", "Reconstruct again, or give another model.")
        root, missing = image_folder(path.parent, Path(images) if images is not None else None, wanted)
        notes = [Remark(CAUTION, FIRST_OF_MANY)] if text.others else []
        if missing:
            left = f"{len(missing)} of {len(wanted)} frames are not in {root} and left out: {missing[0]} ..."
            notes.append(Remark(CAUTION, left))
        sizes = {name: _size(root / name) for name in set(wanted) - set(missing)}
        model = _built(path, text, names, sizes)
        seen = _observations(text, names, model)
        loose = loose_images(model, seen)
        notes += check_consistency(path, model, seen, loose)
        pictures, remarks = find_frames(model, path.parent, root, need_images, loose)
        notes += remarks
        if compare_frames:
            notes += check_frames(model, pictures, points_seen(model, seen))
        return cls(
            path=path,
            folder=path.parent,
            input_format=path.suffix,
            pictures=pictures,
            notes=notes,
            images=root,
            need_images=need_images,
            _paths=(path, *lists),
            _model=model,
            _stamps=(stamp, *map(Stamp.of, lists)),
            _loose=loose,
        )

    def _write_file(self, out: Path, scale: float) -> None:
        scale_file(self.path, out, scale)
        for path in self._paths[1:]:
            shutil.copyfile(path, out.with_name(path.name))

    def _read_back(self, out: Path) -> pycolmap.Reconstruction:
        text = read_text_model(out)
        sizes = {name: (camera.width, camera.height) for name, camera in cameras_of(self._model).items()}
        return _built(out, text, _names(out, text)[0], sizes)


def _names(path: Path, text: TextModel) -> tuple[list[str], list[Path]]:
    """`image_names`, with slashes between folders, since VisualSFM is mostly used on Windows, and as `places_of` has
    them."""
    given, lists = image_names(path, text)
    return places_of([PureWindowsPath(name).as_posix() for name in given]), lists


def _size(path: Path) -> tuple[int, int]:
    """(width, height) [px] of an image file. Raises InputError."""
    size = stored_size(path)
    if size is None:
        raise InputError(f"{path}: not an image", "Copy it again from its original.")
    return size


def _observations(text: TextModel, names: list[str], model: pycolmap.Reconstruction) -> Observations:
    """A sample of the observations of the images of `model`."""
    cameras = cameras_of(model)
    order = np.argsort(text.seen[:, 0], kind="stable")
    each = np.split(text.seen[order, 1:], np.searchsorted(text.seen[order, 0], np.arange(1, len(names))))
    of = {name: seen for name, seen in zip(names, each, strict=True) if name in cameras}
    pairs = []
    for (name, seen), some in zip(of.items(), some_of_each([len(seen) for seen in of.values()]), strict=True):
        camera = cameras[name]
        origin = (0, 0) if text.from_corner else (camera.principal_point_x, camera.principal_point_y)
        pairs.append((seen[some, 1:] + origin, seen[some, 0].astype(int)))
    return observations(list(of), pairs, text.points)


def _built(path: Path, text: TextModel, names: list[str], sizes: dict[str, tuple[int, int]]) -> pycolmap.Reconstruction:
    """The model of the images of known `sizes`. Raises InputError for impossible values."""
    cameras, poses = {}, {}
    for k, name in enumerate(names):
        if name not in sizes or not text.focal[k] > 0:
            continue
        size = np.array(sizes[name], float)
        centre = np.where(np.isnan(text.centre[k]), size / 2, text.centre[k])
        k1, k2, k3 = text.distortion[k].tolist()
        params = [text.focal[k], text.focal[k], *centre, k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0]
        cameras[name] = ("FULL_OPENCV", *sizes[name], [float(value) for value in params])
        poses[name] = (name, text.rotation[k], text.translation[k])
    try:
        return build_model(cameras, poses, text.points, text.colours.clip(0, 255).astype(np.uint8))
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{path}: {error}", "The file may be damaged: copy it again, or export it again.") from error
