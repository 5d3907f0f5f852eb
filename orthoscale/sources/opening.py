"""Opens the source at a path: decides what kind it is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.remarks import CAUTION, Remark
from ..core.source import Source
from ..errors import InputError, UsageError
from ..formats.geometry.text_models import SUFFIXES
from ..formats.reading import absent, check_regular, refuse_pointer
from .colmap_tables import FILE_NAMES
from .exchange_files import find_exchange

if TYPE_CHECKING:
    from ..core.progress import Progress
    from .colmap import ColmapSource


AN_INPUT = "the path of an orthophoto or of a model"  # for messages
NO_CLOUD = "none"  # instead of the name of a dense cloud: find the ground from the sparse points alone


def open_source(
    path: str | Path,
    images: str | Path | None = None,
    need_images: bool = True,
    ground_cloud: str | Path | None = None,
    progress: Progress | None = None,
    compare_frames: bool = True,
) -> Source:
    """The source at `path`: a folder or text file is a reconstruction, another file an image. Raises InputError;
    UsageError if `images` are given for an image.

    ground_cloud : dense cloud or workspace of a reconstruction; by default one is searched for beside it, and NO_CLOUD
    means none. progress : of reading the cloud, once the ground is needed. images, need_images, compare_frames : see
    `ColmapSource.open`.
    """
    path, images = Path(path), None if images is None else Path(images)
    if not os.path.exists(path):  # noqa: PTH110  pathlib's raises for names that are too long
        raise absent(path, "Give an orthophoto, or the folder of a COLMAP model.")
    if (text := find_exchange(path)) is not None:
        if text.suffix.lower() in SUFFIXES:
            from .text_model import TextSource

            return _on_cloud(TextSource.open(text, images, need_images, compare_frames), ground_cloud, progress)
        from .json_model import ExchangeSource

        return _on_cloud(ExchangeSource.open(text, images, need_images, compare_frames), ground_cloud, progress)
    if path.is_dir():
        from .colmap import ColmapSource

        return _on_cloud(ColmapSource.open(path, images, need_images, compare_frames), ground_cloud, progress)
    if path.name in FILE_NAMES:
        raise InputError(f"{path} is one file of a COLMAP model", f"Give the folder that holds them all: {path.parent}")
    if images is not None:
        raise UsageError("--images is for COLMAP models", f"{path} is a file: remove --images.")
    check_regular(path, "Give an orthophoto, or the folder of a COLMAP model.")
    refuse_pointer(path)
    from .raster import RasterSource

    return RasterSource.open(path)


def _on_cloud(source: ColmapSource, named: str | Path | None, progress: Progress | None) -> ColmapSource:
    """`source` with the dense cloud from which its ground is found, if there is one."""
    from .dense_cloud import cloud_at, find_cloud

    if named is not None:
        return source if str(named) == NO_CLOUD else source.on_cloud(cloud_at(Path(named), progress))
    cloud, remarks = find_cloud(source.folder, progress)
    source.notes.extend(remarks)
    if cloud is None:
        return source
    try:
        return source.on_cloud(cloud)
    except InputError as error:  # the user did not name it: the sparse points will do
        source.notes.append(Remark(CAUTION, f"{cloud.what} is left out: {error.message}"))
        return source
