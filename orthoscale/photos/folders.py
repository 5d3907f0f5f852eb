"""Finds the photos at paths of files and folders, and the files there that cannot be read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..formats.names import first_few
from ..formats.other_programs import VIDEOS
from ..formats.reading import absent, files_below
from ..sources.tags import READABLE_PHOTOS

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
# Photos in other formats: those of phones and the web, and raw ones of drone cameras.
OTHER_PHOTOS = (
    *(".heic", ".heif", ".avif", ".webp", ".jxl"),
    *(".dng", ".arw", ".cr2", ".cr3", ".gpr", ".iiq", ".nef", ".orf", ".pef", ".raf", ".rw2"),
)


@dataclass(frozen=True)
class FoundPhotos:
    """paths : of the photos, by their names. notes : on files in the folders that are not read."""

    paths: dict[str, Path]
    notes: tuple[str, ...] = ()


def find_photos(paths: Sequence[Path]) -> FoundPhotos:
    """Photos by name: files by their own, those of a folder (at any depth) by their path in it.

    Raises InputError for a missing path, a folder without photos, or two photos of one name.
    """
    found: dict[str, Path] = {}
    notes: list[str] = []
    for path in paths:
        if path.is_dir():
            inside = files_below(path, {*IMAGE_SUFFIXES, *OTHER_PHOTOS, *VIDEOS})
            photos = [each for each in inside if each.suffix.lower() in IMAGE_SUFFIXES]
            unread = [str(each.relative_to(path)) for each in _only_there(inside, photos)]
            if not photos:
                told = f", only {first_few(unread)}" if unread else ""
                raise InputError(f"{path}: no readable photo in this folder{told}", READABLE_PHOTOS)
            if unread:
                notes.append(f"{path}: not read: {first_few(unread)}. {READABLE_PHOTOS}")
            named = {each.relative_to(path).as_posix(): each for each in photos}
        elif path.exists():
            named = {path.name: path}
        else:
            raise absent(path, "Give photos, or a folder of them.")
        for name, place in named.items():
            if found.setdefault(name, place) != place:
                raise InputError(f"{place} and {found[name]} have the same name", "Measure them one after the other.")
    return FoundPhotos(found, tuple(notes))


def _only_there(files: Iterable[Path], photos: Iterable[Path]) -> list[Path]:
    """The videos among `files`, and those that are not one of `photos` in any format: cameras write raw photos beside
    JPEGs of the same name."""
    known = {each.with_suffix("") for each in photos}
    return [each for each in files if each.suffix.lower() in VIDEOS or each.with_suffix("") not in known]
