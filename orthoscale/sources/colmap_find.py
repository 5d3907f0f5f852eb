"""Finds a COLMAP model: which folder of a workspace holds it, and in which format."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..formats.other_programs import project_in
from .colmap_binary import IMAGE_BYTES, read_binary
from .colmap_tables import RIG_TABLES, TABLES, Tables
from .colmap_text import read_text

TABLE_READERS = {"bin": read_binary, "txt": read_text}  # of a model's tables, by the format of its files


def model_folders(path: Path) -> list[Path]:
    """The folders of all models at or below `path`, as COLMAP's mapper leaves them: ``sparse/0``, ``sparse/1`` ...

    `path` is as in `colmap_check.open_model`. Raises InputError if there is none. The files are not read.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(
            f"{path} does not exist", "Give the folder that holds cameras.bin, images.bin and points3D.bin."
        )
    if not path.is_dir():
        raise InputError(f"{path} is a file, not a folder", "Give the folder that holds the model's files.")
    try:
        for group in (
            [path],
            [path / "sparse"],
            _subfolders(path / "sparse"),
            _numbered(path),
            _subfolders(path / "colmap/sparse"),
        ):
            if models := [folder for folder in group if _holds_model(folder)]:
                return models
        project = project_in(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check its permissions.") from error
    raise InputError(
        f"{path} holds no COLMAP model (no cameras.bin or cameras.txt in it, in sparse/ or in sparse/0)",
        project
        or "Give the folder that holds cameras.bin, images.bin and points3D.bin, or the .txt files of the same names. "
        f"Orthophotos in folders below it: '{path}/*/*.tif', in quotes.",
    )


def find_folder(path: Path) -> tuple[Path, list[str]]:
    """The folder of the model with the most images at or below `path`, and a note if there are others. Raises as
    `model_folders`."""
    models = model_folders(path)
    if len(models) == 1:
        return models[0], []
    sizes = [_image_count(folder) for folder in models]
    best = models[int(np.argmax(sizes))]
    others = ", ".join(f"{m.name}: {n}" for m, n in zip(models, sizes, strict=True) if m != best)
    return best, [f"{path} holds {len(models)} models: {best} has the most images ({max(sizes)}; {others})"]


def _holds_model(folder: Path) -> bool:
    return any((folder / f"{table}.{form}").is_file() for form in ("bin", "txt") for table in ("cameras", "images"))


def _subfolders(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []


def _numbered(folder: Path) -> list[Path]:
    return [p for p in _subfolders(folder) if p.name.isdigit()]


def _image_count(folder: Path) -> int:
    """Number of images that the files announce. It serves to choose between models, and is checked only afterwards."""
    binary, text = folder / "images.bin", folder / "images.txt"
    if binary.is_file():
        with binary.open("rb") as file:
            head = file.read(8)
        count = struct.unpack("<Q", head)[0] if len(head) == 8 else 0
        return count if count * IMAGE_BYTES <= binary.stat().st_size else 0
    if text.is_file():
        with text.open("rb") as file:
            return sum(1 for line in file if not line.startswith(b"#")) // 2
    return 0


def paths_of(folder: Path, form: str) -> dict[str, Path]:
    """The files of the model in `folder` of the format `form`, by table. Raises InputError if one of rigs and frames is
    missing."""
    paths = {table: folder / f"{table}.{form}" for table in TABLES}
    rigs = {table: folder / f"{table}.{form}" for table in RIG_TABLES}
    there = [path for path in rigs.values() if path.is_file()]
    if len(there) == 1:
        missing = next(path for path in rigs.values() if path not in there)
        raise InputError(
            f"{missing} is missing beside {there[0].name}",
            "Copy it from the original model; or, if the model has no rigs, move the other one away too.",
        )
    return paths | (rigs if there else {})


def choose_format(folder: Path) -> tuple[str, list[str]]:
    """The format of the model in `folder`, 'bin' or 'txt', and a note if there are files of both. Raises InputError if
    tables are missing, or both are whole and differ."""
    missing = {form: [t for t in TABLES if not (folder / f"{t}.{form}").is_file()] for form in ("bin", "txt")}
    if missing["bin"] and missing["txt"]:
        form = min(missing, key=lambda f: len(missing[f]))
        names = ", ".join(f"{table}.{form}" for table in missing[form])
        raise InputError(f"{folder}: {names} missing", "Copy the whole model folder.")
    if missing["bin"]:
        stray = [f"{t}.bin" for t in TABLES if t not in missing["bin"]]
        return "txt", [
            f"{folder}: reading the .txt files; {', '.join(stray)} without the rest ignored"
        ] if stray else []
    if missing["txt"]:
        return "bin", []
    # COLMAP reads .bin and ignores .txt beside it. File dates prove nothing after a copy, so contents must agree.
    binary, text = (_poses(read(paths_of(folder, form))) for form, read in TABLE_READERS.items())
    if binary != text:
        raise InputError(
            f"{folder} holds two different models, one in .bin and one in .txt files",
            "COLMAP would read the .bin files and ignore the .txt. Move those you do not mean to another folder.",
        )
    return "bin", [f"{folder}: .bin and .txt files agree; the .bin files are read"]


def _poses(tables: Tables) -> dict[str, tuple[float, ...]]:
    return {image.name: tuple(round(x, 5) + 0.0 for x in image.pose) for image in tables.images}
