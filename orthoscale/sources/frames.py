"""The frames of a model on disk: finds the folder that the names of its images are relative to."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Collection, Sequence
from contextlib import suppress
from mimetypes import guess_type
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING

from ..core.remarks import CAUTION, INFO, Remark
from ..errors import InputError
from ..formats.geometry.beside import file_in
from ..formats.names import composed
from ..system.paths import homes
from .colmap_read import cameras_of
from .picture_file import PictureFile

if TYPE_CHECKING:
    import pycolmap

IMAGE_FOLDERS = ("images", "input", "frames", "rgb", ".")
IMAGES_ABOVE = 3  # folders above a model that are searched for its images, as for workspace/sparse/0


def find_frames(
    model: pycolmap.Reconstruction,
    folder: Path,
    images: Path | str | None,
    need_images: bool,
    without: Collection[str],
) -> tuple[list[PictureFile], list[Remark]]:
    """The frames of `model`, which lies in `folder`, that are on disk, but those of the images `without`; and remarks
    on those that are not. See `ColmapSource.open`."""
    cameras = {name: camera for name, camera in cameras_of(model).items() if name not in without}
    place_of = dict(zip(sorted(cameras), places_of(sorted(cameras)), strict=True))
    try:
        root, missing = image_folder(folder, Path(images) if images is not None else None, list(place_of.values()))
    except InputError as error:
        if need_images or images is not None:
            raise
        so = "without frames no anchors are searched for, and the report has no close-ups of vehicles"
        return [], [Remark(INFO, f"{error.message}; {so}")]
    pictures = []
    lacking = set(missing)
    for name, place in place_of.items():
        if place not in lacking:
            size = cameras[name].width, cameras[name].height
            pictures.append(PictureFile(name, file_in(root, place) or root / place, *size))
            pictures[-1].check_size()
    if not missing:
        return pictures, []
    text = f"{len(missing)} of {len(cameras)} frames are not in {root}, the first is {missing[0]}"
    return pictures, [Remark(CAUTION, text)]


def places_of(names: Sequence[str]) -> list[str]:
    """The paths at which to look for the images `names` in their folder. If all are absolute paths of another machine
    (no such file is on this one), they are made relative to the folder that they share; others stay as they are."""
    paths = [PureWindowsPath(name).as_posix() for name in names]
    if all(PureWindowsPath(path).root for path in paths) and not any(map(os.path.isfile, paths)):
        with suppress(ValueError):  # some on a drive, and others not
            shared = posixpath.commonpath([posixpath.dirname(path) for path in paths])
            return [posixpath.relpath(path, shared) for path in paths]
    return list(names)


def image_folder(folder: Path, given: Path | None, names: Sequence[str]) -> tuple[Path, list[str]]:
    """The folder that holds most of the image `names` (`places_of`) of the model in `folder`, and those that it lacks.

    given : where to look instead of beside and above the model. Raises InputError if none of them is found.
    """
    if given is not None:
        if not os.path.isdir(given):  # noqa: PTH112  pathlib's raises for names that are too long
            what = "is not a folder" if os.path.lexists(given) else "does not exist"
            raise InputError(f"--images {given} {what}", "Give the folder that the image names start from.")
        places = [given]
    else:
        bases = [folder, *(above for home in homes(folder) for above in home.parents[:IMAGES_ABOVE])]
        places = [base / sub for sub in IMAGE_FOLDERS for base in bases]
    best, missing = places[0], list(names)
    for place in places:
        if place.is_dir():
            lacking = [name for name in names if file_in(place, name) is None]
            if len(lacking) < len(missing):
                best, missing = place, lacking
            if not lacking:
                break
    if len(missing) == len(names):
        raise _not_found(folder, given, places, missing[0])
    return best, missing


def _not_found(folder: Path, given: Path | None, places: Sequence[Path], first: str) -> InputError:
    """The error that none of the frames of the model in `folder` is in one of `places`. It says where a frame is that
    may be the `first`, if there is one. given : as in `image_folder`."""
    what = f"no frame of the model {folder} was found; the first is {first}"
    inside = places if given is not None else [place for place in places if place.name in IMAGE_FOLDERS]
    if (shut := next((p for p in inside if p.is_dir() and not os.access(p, os.R_OK | os.X_OK)), None)) is not None:
        return InputError(f"{what}, and {shut} cannot be read", "Check the permissions of that folder.")
    higher = [] if given is None else given.absolute().parents[:IMAGES_ABOVE]
    if (start := next((place for place in higher if file_in(place, first) is not None), None)) is not None:
        return InputError(
            f"{what}, and that name begins above {given}", f"Give --images {start}: the names start there."
        )
    if (start := _below(inside, first)) is not None:
        return InputError(f"{what}, and it lies in {start}", f"Give --images {start}.")
    if (near := _of_nearly_that_name(places, first)) is not None:
        hint = "Name the frames as the model does: folders, endings, upper and lower case matter."
        if composed(near.as_posix()).endswith(composed(PureWindowsPath(first).as_posix())):
            hint = (
                "They look alike, but one has its marked letters (such as umlauts) as two characters each, as "
                "macOS writes them: name the frames anew, or as the model does."
            )
        return InputError(f"{what}, but {near} has another name", hint)
    above = f"{folder} and the {IMAGES_ABOVE} folders above it, and in {', '.join(IMAGE_FOLDERS[:-1])} of each"
    return InputError(
        f"{what}; looked in {given or above}",
        "Give the folder that the image names start from with --images, or the vehicles' boxes with --detections.",
    )


def _below(folders: Sequence[Path], name: str) -> Path | None:
    """A folder that has the image `name`, one or two levels below one of `folders`."""
    for folder in folders:
        with suppress(OSError):  # one of them cannot be read
            for level in ("*", "*/*"):
                for place in sorted(folder.glob(level)):
                    if file_in(place, name) is not None:
                        return place
    return None


def _of_nearly_that_name(places: Sequence[Path], name: str) -> Path | None:
    """A picture in one of `places` whose name differs from the image `name` only in its folder, ending or case, or in
    how its marked letters are written; in folders of that name, too."""
    wanted, above = _bare(PureWindowsPath(name).stem), PureWindowsPath(name).parts[:-1]
    for place in places:
        folders = [place]
        for part in above:  # the folders of the name, however their letters are written
            folders += [below for below in _inside(folders[-1]) if _bare(below.name) == _bare(part)][:1]
        for folder in folders:
            for path in _inside(folder):
                if _bare(path.stem) == wanted and (guess_type(path.name)[0] or "").startswith("image/"):
                    return path
    return None


def _inside(folder: Path) -> list[Path]:
    with suppress(OSError):  # no folder, or it cannot be read
        return sorted(folder.iterdir())
    return []


def _bare(text: str) -> str:
    return composed(text).casefold()
