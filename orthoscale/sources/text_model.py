"""Reconstructions of Bundler (bundle.out) and VisualSFM (.nvm), in plain text, with their frames.

Their files do not tell how large the images are: the frames do, so they must be there.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, OutputError, UsageError
from ..rescale.files import scale_path
from ..rescale.sim3 import Sim3
from ..rescale.text_models import TextModel, read_text_model
from .colmap import ColmapSource, find_frames, image_folder
from .colmap_write import difference
from .exchange import DIGITS, build_model
from .picture_file import stored_size

if TYPE_CHECKING:
    import pycolmap


@dataclass(frozen=True, eq=False)
class TextSource(ColmapSource):
    """A reconstruction in one text file, with its frames; `folder` is the file's. Made by `TextSource.open`."""

    @classmethod
    def open(cls, path: Path | str, images: Path | str | None = None, need_images: bool = True) -> TextSource:
        """Open the file `path`; otherwise as `ColmapSource.open`, but the frames must be there. Raises InputError."""
        path = Path(path)
        text = read_text_model(path)
        names, lists = (text.names, []) if text.names is not None else _listed(path, len(text.focal))
        wanted = sorted({_clean(name) for name, focal in zip(names, text.focal, strict=True) if focal > 0})
        if not wanted:
            raise InputError(f"{path}: no image is registered", "Reconstruct again, or give another model.")
        root, missing = image_folder(path.parent, Path(images) if images is not None else None, wanted)
        notes = []
        if missing:
            notes.append(f"{len(missing)} of {len(wanted)} frames are not in {root} and left out: {missing[0]} ...")
        sizes = {name: _size(root / name) for name in set(wanted) - set(missing)}
        model = _built(path, text, names, sizes)
        pictures = find_frames(model, path.parent, root, need_images, notes)
        return cls(path, path.parent, path.suffix, pictures, notes, (path, *lists), model)

    @cached_property
    def dense(self) -> Path:
        """There is none of COLMAP's."""
        raise UsageError(f"{self.path} has no dense workspace of COLMAP", "Bring other files with `orthoscale apply`.")

    def write(self, folder: Path, metres_per_unit: float) -> None:
        """Write the file in metres into the empty `folder`, with its list of images, sim3.json and sim3.txt.

        Raises UsageError for an impossible scale, OutputError if what was written does not read back as it was meant.
        """
        sim3 = Sim3(float(metres_per_unit))
        out = folder / self.path.name
        lists = self._paths[1:]
        try:
            scale_path(self.path, out, sim3.scale)
            for path in lists:
                shutil.copyfile(path, folder / path.name)
            sim3.save(folder)
        except OSError as error:
            raise OutputError(f"{folder}: writing failed ({error})", "Check permissions and free space.") from error
        text = read_text_model(out)
        names = text.names if text.names is not None else _listed(out, len(text.focal))[0]
        sizes = {name: self.image_size(name) for name in self.picture_names}
        problem = difference(self._model, _built(out, text, names, sizes), sim3.scale, DIGITS)
        if problem:
            raise OutputError(f"{out}: the written model differs: {problem}", "Please report this with the model.")


def _clean(name: str) -> str:
    return Path(name).as_posix()


def _listed(path: Path, count: int) -> tuple[list[str], list[Path]]:
    """The names of Bundler's images, in the order of its cameras, and the list that holds them."""
    places = [path.with_name("list.txt"), path.parent.parent / "list.txt"]
    if path.name.endswith("bundle.out") and path.name != "bundle.out":  # COLMAP writes x.bundle.out, x.list.txt
        places.insert(0, path.with_name(path.name.removesuffix("bundle.out") + "list.txt"))
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        raise InputError(f"{path} has no list of its images ({places[0]})", "Put Bundler's list.txt beside it.")
    try:
        names = [line.split()[0] for line in found.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise InputError(f"{found}: cannot be read ({error})", "Check the file and its permissions.") from error
    if len(names) != count:
        raise InputError(
            f"{found} names {len(names)} images, {path} has {count} cameras", "Give the list it came from."
        )
    return names, [found]


def _size(path: Path) -> tuple[int, int]:
    """(width, height) [px] of an image file. Raises InputError."""
    size = stored_size(path)
    if size is None:
        from PIL import Image

        try:
            with Image.open(path) as image:
                size = image.size
        except OSError as error:
            raise InputError(f"{path}: not an image ({error})", "Copy it again from its original.") from error
    return size


def _built(path: Path, text: TextModel, names: list[str], sizes: dict[str, tuple[int, int]]) -> pycolmap.Reconstruction:
    """The model of the images of known `sizes`. Raises InputError for what cannot be meant."""
    cameras, poses = {}, {}
    for k, name in enumerate(map(_clean, names)):
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
        raise InputError(f"{path}: {error}", "The file may be damaged: copy it again, or write it anew.") from error
