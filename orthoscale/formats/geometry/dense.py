"""Writes COLMAP's dense workspace in metres: undistorted model, depth maps, clouds, meshes; other files are copied."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...system.paths import homes
from ...system.signatures import written_in_metres
from ..names import first_few
from ..reading import HUGE, files_below, is_hidden, read_bytes
from .lengthless import has_lengths
from .ply import vertex_count

DEPTH_KINDS = (".geometric.bin", ".photometric.bin")
FRAMES = "images"  # the folder of undistorted frames
MOST_LEFT_NAMED = 20  # files left out that a note names; OpenMVS has a depth map for each image
VISIBILITY_HEAD = 8  # bytes of the number of points at the beginning of a list of the images that see them
COMPUTE_ANEW = "The file is damaged or was cut off: copy it or compute it again."


def scale_depth_map(source: Path, target: Path, scale: float) -> None:
    """Write COLMAP's depth map (``width&height&channels&``, then float32, little-endian) with depths times `scale`."""
    head, depths = _depth_map(source)
    target.write_bytes(head + (depths.astype(float) * scale).astype("<f4").tobytes())


def read_depth_map(path: Path) -> np.ndarray:
    """(height, width) depths along the optical axis [model units] in COLMAP's depth map, 0 where there is none. Raises
    InputError."""
    return _depth_map(path)[1]


def _depth_map(path: Path) -> tuple[bytes, np.ndarray]:
    """The header of COLMAP's depth map, and its depths (height, width). Raises InputError."""
    data = read_bytes(path, COMPUTE_ANEW, HUGE)
    try:
        *shape, rest = data[:64].split(b"&", 3)
        width, height, channels = map(int, shape)
        head = len(data[:64]) - len(rest)
    except ValueError:
        raise InputError(f"{path}: not a depth map of COLMAP", COMPUTE_ANEW) from None
    needed = head + 4 * width * height * channels
    if channels != 1 or min(width, height) < 1 or len(data) != needed:
        raise InputError(
            f"{path}: {len(data)} bytes, but a depth map of {width} x {height} x {channels} has {needed}",
            COMPUTE_ANEW,
        )
    return data[:head], np.frombuffer(data, "<f4", offset=head).reshape(height, width)


def is_dense(folder: Path) -> bool:
    """Whether `folder` looks like a dense workspace of COLMAP."""
    return (folder / "stereo").is_dir() or (folder / "fused.ply").is_file()


def find_dense(model: Path) -> Path | None:
    """The dense workspace that belongs to the sparse model in the folder `model`, where COLMAP would have put it.

    That of ``W/dense/sparse`` is ``W/dense``; of ``W/sparse``, ``W/dense``; of ``W/sparse/0``, ``W/dense/0`` or
    ``W/dense``.
    """
    for home in homes(model):
        places = [home.parent, home.parent / "dense", home / "dense"]
        if home.name.isdigit():
            above = home.parent.parent / "dense"
            places = [above / home.name, above, *places]
        if (found := next((place for place in places if is_dense(place)), None)) is not None:
            return found
    return None


def visibility_fault(cloud: Path, images: int) -> str:
    """What is wrong with COLMAP's list beside a cloud (``fused.ply.vis``) of the images that see each point, as a
    sentence; empty if nothing is, or there is no list. It has no lengths, but meshing needs it. images : number of
    images in the undistorted model. Raises InputError for a cloud whose header cannot be read, OSError."""
    path = cloud.with_name(cloud.name + ".vis")
    if not path.is_file():
        return ""
    cut, size = f"{path} is damaged or was cut off", path.stat().st_size
    if size < VISIBILITY_HEAD or size % 4:
        return cut
    with path.open("rb") as file:
        count = int.from_bytes(file.read(VISIBILITY_HEAD), "little")
    if count != (known := vertex_count(cloud)):
        return f"{path} lists {count:,} points, but {cloud.name} has {known:,}: meshing will not take them together"
    if size == VISIBILITY_HEAD:
        return cut if count else ""
    words = np.memmap(path, "<u4", "r", VISIBILITY_HEAD)  # for each point the number of images, and their numbers
    if words.max() > images:
        return f"{path} names images that the undistorted model lacks"
    each, at = words.data, 0
    try:
        for _ in range(count):
            at += each[at] + 1
    except IndexError:
        return cut
    return "" if at == len(words) else cut


def sparse_folders(dense: Path) -> list[Path]:
    """The folders of undistorted sparse models in the workspace `dense`."""
    sparse = dense / "sparse"
    folders = [sparse, *sorted(p for p in sparse.iterdir() if p.is_dir())] if sparse.is_dir() else []
    return [f for f in folders if sparse_in(f)]


def sparse_in(folder: Path) -> bool:
    """Whether a sparse model of COLMAP lies in `folder`."""
    return any((folder / f"cameras.{form}").is_file() for form in ("bin", "txt"))


def scale_dense(
    source: Path, target: Path, scale: float, model: Callable[[Path, Path], None], any_file: Callable[[Path, Path], str]
) -> list[str]:
    """Write the dense workspace `source` into the empty folder `target` in metres; returns notes for the user.

    model : writes the sparse model in one folder into another, in metres. any_file : writes one file in metres, or
    returns why it cannot; such a file is left out. Raises what these raise, and InputError for a damaged depth map and
    for a folder that cannot be read.
    """
    left, scaled = [], 0
    for path in files_below(source, onerror=_unreadable):
        place = path.relative_to(source)
        if place.parts[0] == "sparse" and len(place.parts) > 1:
            continue
        out = target / place
        out.parent.mkdir(parents=True, exist_ok=True)
        is_map = "depth_maps" in place.parts and path.name.endswith(DEPTH_KINDS)
        if not is_map and not has_lengths(path, frame=place.parts[0] == FRAMES):
            shutil.copyfile(path, out)
        elif written_in_metres(path):
            left.append(f"{place} (in metres already: orthoscale wrote it)")
        elif is_map:
            scale_depth_map(path, out, scale)
            scaled += 1
        elif reason := any_file(path, out):
            left.append(f"{place} ({reason})")
        else:
            scaled += 1
    for folder in sparse_folders(source):
        out = target / folder.relative_to(source)
        out.mkdir(parents=True, exist_ok=True)
        model(folder, out)
    notes = [
        f"{source}: {scaled} depth {'map, cloud or mesh' if scaled == 1 else 'maps, clouds and meshes'} converted to "
        "metres too"
        if scaled
        else f"{source}: its undistorted model converted to metres; there is no depth map, cloud or mesh in it"
    ]
    if left:
        notes.append(f"left in {source}, because not in metres: {first_few(left, MOST_LEFT_NAMED)}")
    if passed := sorted(_passed_over(source)):
        what = "hidden files, pipes, and links to folders or to nothing are not copied"
        notes.append(f"left in {source}: {first_few(passed, MOST_LEFT_NAMED)} ({what})")
    return notes


def _unreadable(error: OSError) -> None:
    raise InputError(f"{error.filename}: cannot be read ({error.strerror})", "Check its permissions.") from error


def _passed_over(dense: Path) -> Iterator[str]:
    """What `files_below` does not give of the workspace `dense`: links to folders or to nothing, pipes, what is hidden.
    Those among the sparse models are left out, and macOS's ``._`` files, one of which may lie beside every other."""
    for root, folders, names in os.walk(dense):
        for path in (Path(root, name) for name in (*folders, *names)):
            place = path.relative_to(dense)
            ordinary = path.is_file() or (path.is_dir() and not path.is_symlink())
            hidden = is_hidden(path.name) and not path.name.startswith("._")
            if (hidden or not ordinary) and place.parts[0] != "sparse":
                yield str(place)
