"""The inputs that the arguments of a command line name: files, models, folders of either, and patterns."""

from __future__ import annotations

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

from ..errors import InputError, UsageError
from ..formats.names import first_few
from ..formats.pictures import PICTURES
from ..formats.reading import is_hidden
from ..sources.exchange_files import find_exchange
from ..system.paths import absolute
from ..system.signatures import ours
from .finished import input_of, report_of
from .workspace import models_in


class Named:
    """What the words of a command line name. A folder that stands for its contents is listed once, when first
    needed."""

    def __init__(self, words: Iterable[Path]):
        self.words = tuple(words)
        self._listed: dict[Path, _Listed] = {}

    @property
    def many(self) -> bool:
        """Whether the words may name more than one input: several of them, a pattern, or a folder that is no model."""
        return len(self.words) > 1 or any(_is_pattern(word) or bool(self._list(word).inputs) for word in self.words)

    @cached_property
    def inputs(self) -> list[Path]:
        """The inputs, each once, in the order of the words.

        A folder that is no model stands for the pictures and models in it (except a report's pictures), a pattern
        (``*``, ``?``, ``[...]``, ``**``) for the paths that match it, and a workspace with several models for each of
        them, even if it was named by a folder or a pattern. A path that does not exist stands for itself, and so does a
        folder without inputs: its error must not stop the other inputs. Raises InputError for a pattern that matches
        nothing, and for a folder without inputs if it is named alone.
        """
        found: dict[str, Path] = {}
        for word in self.words:
            named = [word]
            if _is_pattern(word):
                named = [Path(name) for name in sorted(_fitting(word.parts))]
                if not named:
                    raise InputError(f"no file fits {word}", "Check the pattern and the current folder.")
            for path in named:
                for each in self._list(path).inputs or [path]:
                    for one in _models_in(each, alone=len(self.words) == len(named) == 1) or [each]:
                        found.setdefault(os.path.realpath(one), one)
        return list(found.values())

    @property
    def not_looked_into(self) -> list[str]:
        """A sentence for each folder that stands for its contents: which folders in it have pictures that do not count,
        and how to name these."""
        self.inputs  # noqa: B018  lists the folders that fit a pattern
        told = []
        for word, listed in self._listed.items():
            pictures: dict[Path, Path] = {}
            for folder in listed.below if listed.inputs else ():
                with suppress(OSError, IndexError):  # it may be unreadable, or have no pictures
                    pictures[folder] = _inside(folder).inputs[0]
            if pictures:
                pattern = word / "*" / f"*{next(iter(pictures.values())).suffix}"
                told.append(
                    f"{word}: subfolders not searched: {first_few([folder.name for folder in pictures])}; "
                    f"to include them, give the pattern '{pattern}', in quotes"
                )
        return told

    def _list(self, path: Path) -> _Listed:
        if path not in self._listed:
            self._listed[path] = _in_folder(path)
        return self._listed[path]


def outputs_of(inputs: Sequence[Path], folder: Path) -> list[Path]:
    """Where in `folder` the scaled copy of each of `inputs` goes: a GeoTIFF named after the picture, or a folder named
    after the model.

    Inputs of the same name get their endings added (``site_jpg.tif``) if they lie in one folder, the names of their
    parent folders (``flight1_odm_orthophoto.tif``) if they lie in several, or both. An input whose copy exists already
    keeps that name, and none gets the name of another input's copy, as far as the reports beside the copies tell.
    Raises UsageError if `folder` and an input lie in each other, as an output could replace an input; and for a folder
    with the name of a GeoTIFF.
    """
    _check_folder(inputs, folder)
    owner = cache(lambda name: _owner(folder / name))
    real = [Path(os.path.realpath(path)) for path in inputs]
    names = []
    for path, mine, new in zip(inputs, real, _new_names(inputs), strict=True):
        kept = next((name for name in (*_names(path, False), *_names(path, True)) if owner(name) == mine), None)
        names.append(new if kept is None else [kept])
    return [folder / name for name in _told_apart(names, lambda k, name: owner(name) not in (None, real[k]))]


def _new_names(inputs: Sequence[Path]) -> list[list[str]]:
    """For each of `inputs` the names that its copy may get, the shortest first; the last one is unique to it."""
    bare = [path.parent / path.stem.lower() for path in map(absolute, inputs)]
    twins = {each for each, count in Counter(bare).items() if count > 1}
    folders = Counter(each.name for each in set(bare))  # in how many folders each name occurs
    return [_names(path, each in twins)[folders[each.name] > 1 :] for path, each in zip(inputs, bare, strict=True)]


def _told_apart(names: list[list[str]], of_another: Callable[[int, str], bool]) -> list[str]:
    """One name for each input, of those in `names`: the first that no other input has as well, whatever the case of its
    letters, and that is not `of_another` (called with the number of the input and the name); else the last."""
    while True:
        first = [each[0] for each in names]
        count = Counter(name.lower() for name in first)
        left = [
            each[1:] if len(each) > 1 and (count[name.lower()] > 1 or of_another(k, name)) else each
            for k, (each, name) in enumerate(zip(names, first, strict=True))
        ]
        if left == names:
            return first
        names = left


def _check_folder(inputs: Sequence[Path], folder: Path) -> None:
    """Raise UsageError for a `folder` that cannot hold the copies of `inputs`; see `outputs_of`."""
    if folder.suffix.lower() in (".tif", ".tiff") and not folder.is_dir():
        raise UsageError(
            f"{folder} would be the folder of the copies of {first_few(inputs)}",
            "Choose a name without a picture's ending, or give one input.",
        )
    there = Path(os.path.realpath(folder))
    for path in inputs:
        given = Path(os.path.realpath(path))
        if there in (given, *given.parents) or given in there.parents:
            raise UsageError(f"{folder} and the input {path} lie in each other", "Choose another folder for --out.")


def _names(path: Path, with_ending: bool) -> list[str]:
    """Names for the copy of the input at `path`, the shortest first; the last one is unique to it."""
    whole = absolute(path)
    *above, name = whole.parts[1:]
    end = ""
    if is_picture(path):
        picture = Path(name)
        ending = picture.suffix[1:] if with_ending else ""
        name, end = "_".join([picture.stem, ending] if ending else [picture.stem]), ".tif"
    names = ["_".join([*above[len(above) - depth :], name]) for depth in range(len(above) + 1)]
    mark = hashlib.blake2b(os.fsencode(whole), digest_size=4).hexdigest()
    return [f"{each}{end}" for each in (*names, f"{name}_{mark}")]


def _owner(out: Path) -> Path | None:
    """The input of which `out` is the copy; None if there is no copy, its report is missing, or the input is gone."""
    report = report_of(out) if out.exists() else None
    source = None if report is None else input_of(report)
    return source if source is not None and source.exists() else None


def is_picture(path: Path) -> bool:
    """Whether an input is a picture; else it is a model. Decided by its name, and whether it is a folder, only."""
    return not path.is_dir() and find_exchange(path) is None


def _models_in(path: Path, alone: bool) -> list[Path]:
    try:
        return models_in(path)
    except InputError:
        if alone:
            raise
        return []


def _fitting(parts: Sequence[str]) -> set[str]:
    """The paths that fit a pattern of these `parts`, of which ``**`` means any number of folders."""
    if "**" not in parts:
        return set(glob.glob(os.path.join(*parts)))
    at = parts.index("**")
    tops = glob.glob(os.path.join(*parts[:at])) if at else [os.curdir]
    rest = parts[at + 1 :] or ("*",)
    return {path for top in tops for folder in _folders(top) for path in _fitting((glob.escape(folder), *rest))}


def _folders(top: str) -> Iterator[str]:
    """The folder `top` and those below it, also behind links, but without hidden ones. Each is looked into once, and
    none in which `top` lies: links may lead in circles, in more ways than could ever be followed."""
    seen = set(Path(os.path.realpath(top)).parents)
    for folder, below, _ in os.walk(top, followlinks=True):
        real = Path(os.path.realpath(folder))
        if real in seen:
            below.clear()
            continue
        seen.add(real)
        below[:] = sorted(name for name in below if not is_hidden(name))
        yield folder


def _is_pattern(word: Path) -> bool:
    return glob.has_magic(str(word)) and not os.path.lexists(word)


@dataclass(frozen=True)
class _Listed:
    """inputs : the models and pictures in a folder. below : the folders in it that are no models. Both are empty for a
    path that is an input itself, or no folder."""

    inputs: list[Path] = field(default_factory=list)
    below: list[Path] = field(default_factory=list)


def _in_folder(path: Path) -> _Listed:
    return _inside(path) if path.is_dir() and not _is_model(path) else _Listed()


def _inside(folder: Path) -> _Listed:
    """The contents of a `folder` that is no model."""
    listed = _Listed()
    for each in sorted(folder.iterdir()):
        if is_hidden(each.name):
            continue
        if each.is_dir():
            (listed.inputs if _is_model(each) else listed.below).append(each)
        elif each.suffix.lower() in PICTURES and not _is_of_a_report(each):
            listed.inputs.append(each)
    return listed


def _is_of_a_report(path: Path) -> bool:
    """Whether `path` is the picture that `fix` drew beside a scaled orthophoto: ``scaled.tif.png``."""
    return path.with_suffix("").is_file() and ours(path)


def _is_model(folder: Path) -> bool:
    from ..sources.colmap_find import model_folders

    if find_exchange(folder) is not None:
        return True
    try:
        return bool(model_folders(folder))
    except InputError:
        return False
