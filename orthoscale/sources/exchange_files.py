"""Recognises other programs' reconstruction files. Their readers are imported only when needed."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError
from ..formats.geometry.text_models import SUFFIXES

MODEL_SUFFIXES = (".json", *SUFFIXES)  # of other programs' models
MODEL_FILES = (
    "reconstruction.json",
    "opensfm/reconstruction.json",
    "transforms.json",
    "bundle.out",
    "bundle/bundle.out",
)


def find_exchange(path: Path) -> Path | None:
    """Another program's file: `path` itself, or one in the folder `path` if that holds no COLMAP model; else None."""
    if path.suffix.lower() in MODEL_SUFFIXES and path.is_file():
        return path
    if not path.is_dir():
        return None
    places = [*(path / place for place in MODEL_FILES), *sorted(path.glob("[!.]*.nvm"))]
    found = next((place for place in places if place.is_file()), None)
    if found is not None:
        from .colmap_find import model_folders

        try:
            model_folders(path)
        except InputError:
            return found
    return None
