"""Which kind of source lies at a path."""

from __future__ import annotations

import os
from pathlib import Path

from ..core.source import Source
from ..errors import InputError, UsageError
from ..formats.geometry.text_models import SUFFIXES
from .exchange_files import find_exchange


def open_source(path: str | Path, images: str | Path | None = None, need_images: bool = True) -> Source:
    """The source at `path`: a folder or text file is a reconstruction, another file an image. Raises InputError."""
    path, images = Path(path), None if images is None else Path(images)
    if not os.path.exists(path):  # noqa: PTH110  pathlib's raises for names that are too long
        raise InputError(f"{path} does not exist", "Give an orthophoto, or the folder of a COLMAP model.")
    if (text := find_exchange(path)) is not None:
        if text.suffix.lower() in SUFFIXES:
            from .text_model import TextSource

            return TextSource.open(text, images=images, need_images=need_images)
        from .json_model import ExchangeSource

        return ExchangeSource.open(text, images=images, need_images=need_images)
    if path.is_dir():
        from .colmap import ColmapSource

        return ColmapSource.open(path, images=images, need_images=need_images)
    if images is not None:
        raise UsageError("--images is for COLMAP models", f"{path} is a file: remove --images.")
    from .raster import RasterSource

    return RasterSource.open(path)
