"""The inputs that the arguments of a command line name: files, models, folders of either, and patterns."""

from __future__ import annotations

import glob
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..errors import InputError, UsageError
from ..sources.exchange_files import find_exchange
from ..system.outputs import ours
from .workspace import models_in

PICTURES = (".tif", ".tiff", ".jp2", ".jpg", ".jpeg", ".png", ".bmp", ".gif", ".vrt", ".webp", ".img", ".ecw", ".sid")
"""Endings by which a picture in a folder is known for one. One that is named itself may have any."""


def is_many(words: Sequence[Path]) -> bool:
    """Whether `words` may name more than one input: several of them, a pattern, or a folder that is no model."""
    return len(words) > 1 or any(_is_pattern(word) or bool(_in_folder(word)) for word in words)


def inputs_of(words: Iterable[Path]) -> list[Path]:
    """The inputs that `words` name, each once, in their order.

    A folder that holds no model stands for the pictures and the models in it (but for a report's pictures), a
    workspace with several models for each of them, a pattern (``*``, ``?``, ``[...]``, ``**``) for what fits it.
    What does not exist stands for itself. Raises InputError for a pattern that nothing fits.
    """
    found: dict[str, Path] = {}
    for word in words:
        named = [word]
        if _is_pattern(word):
            named = [Path(name) for name in sorted(glob.glob(str(word), recursive=True))]
            if not named:
                raise InputError(f"no file fits {word}", "Check the pattern and the current folder.")
        for path in named:
            for each in _in_folder(path) or models_in(path) or [path]:
                found.setdefault(os.path.realpath(each), each)
    return list(found.values())


def outputs_of(inputs: Sequence[Path], folder: Path) -> list[Path]:
    """Where in `folder` the scaled copy of each of `inputs` goes: a GeoTIFF of a picture's name, a folder of a model's.

    Inputs of one name take those of the folders above them along: ``flight1_odm_orthophoto.tif``.
    Raises UsageError where `folder` and an input lie in each other: an output could take an input's place; and for a
    folder that is called as a GeoTIFF.
    """
    if folder.suffix.lower() in (".tif", ".tiff") and not folder.is_dir():
        raise UsageError(f"{folder} would be the folder of several copies", "Choose a name that is no picture's.")
    there = Path(os.path.realpath(folder))
    for path in inputs:
        given = Path(os.path.realpath(path))
        if there in (given, *given.parents) or given in there.parents:
            raise UsageError(f"{folder} and the input {path} lie in each other", "Choose another folder for --out.")
    parts = [Path(os.path.abspath(path)).parts[1:] for path in inputs]
    longest = max(map(len, parts))
    depth = [1] * len(inputs)

    def name(k: int) -> str:
        *above, last = parts[k][-depth[k] :]
        stem = f"{Path(last).stem}.tif" if is_picture(inputs[k]) else last
        return "_".join([*above, stem])

    while True:
        names = [name(k) for k in range(len(inputs))]
        count = Counter(each.lower() for each in names)
        twice = [k for k, each in enumerate(names) if count[each.lower()] > 1 and depth[k] < longest]
        if not twice:
            break
        for k in twice:
            depth[k] += 1
    if max(count.values()) > 1:  # one name, two endings
        names = [f"{k}_{each}" if count[each.lower()] > 1 else each for k, each in enumerate(names)]
    return [folder / each for each in names]


def is_picture(path: Path) -> bool:
    """Whether an input is a picture; else it is a model. Looks at its name and kind only."""
    return not path.is_dir() and find_exchange(path) is None


def _is_pattern(word: Path) -> bool:
    return glob.has_magic(str(word)) and not os.path.lexists(word)


def _in_folder(path: Path) -> list[Path]:
    """The inputs in a folder that is none itself; empty where there are none, or `path` is an input or no folder."""
    if not path.is_dir() or _is_model(path):
        return []
    return [
        each
        for each in sorted(path.iterdir())
        if not each.name.startswith(".")
        and (_is_model(each) if each.is_dir() else each.suffix.lower() in PICTURES and not _is_of_a_report(each))
    ]


def _is_of_a_report(path: Path) -> bool:
    """Whether it is the picture that `fix` drew beside a scaled orthophoto: ``scaled.tif.png``."""
    return path.with_suffix("").is_file() and ours(path)


def _is_model(folder: Path) -> bool:
    from ..sources.colmap_check import model_folders

    if find_exchange(folder) is not None:
        return True
    try:
        return bool(model_folders(folder))
    except InputError:
        return False
