"""Text files with a box per line, four corners and a class: DOTA's (https://captain-whu.github.io/DOTA), Ultralytics'.

Labels: ``x1 y1 x2 y2 x3 y3 x4 y4 class difficult``, a file per picture, with its name.
Results: ``picture score x1 y1 x2 y2 x3 y3 x4 y4``, a file per class, called ``Task1_class.txt``.
Ultralytics (https://docs.ultralytics.com/datasets/obb): ``class x1 y1 x2 y2 x3 y3 x4 y4``, for predictions also the
score; a file per picture, classes as numbers, corners as shares of the picture's width and height.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...core.boxes import Boxes
from ...errors import InputError, UsageError, shown
from ...system.signatures import room
from ..reading import read_text
from .items import Item, short_name

HEADER = ("imagesource:", "gsd:")
BEYOND = 1.0  # largest distance of a corner from a picture's middle, in its widths: predictions may lie outside of it


def read(path: Path, only_picture: bool) -> list[Item]:
    """The boxes of one file, or of all .txt files of a folder. Raises InputError.

    only_picture : the source has one picture only, so that a label file need not have its name.
    """
    if path.is_dir():
        files = sorted(path.glob("[!.]*.txt"))
        if not files:
            raise InputError(f"{path}: a folder without .txt files", "Give DOTA's label files, one per picture.")
        return [item for file in files for item in read(file, only_picture=False)]
    label = path.stem.partition("_")[2] if path.stem.startswith("Task1_") else None
    picture = None if only_picture else path.stem
    items = []
    text = read_text(path, "Give DOTA's text, or another format of detections.")
    lines = [(number, line, line.split()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(n, line, words) for n, line, words in lines if words and not line.lower().startswith(HEADER)]
    of_ultralytics = [_of_ultralytics(words, picture) for _, _, words in lines]
    if all(of_ultralytics):  # a single line may fit several formats
        return [item for item in of_ultralytics if item is not None]
    for number, line, words in lines:
        item = _label(words, picture) or _result(words, label)
        if item is None:
            raise InputError(
                f"{path}: line {number} is not a box ({shown(line.strip())!r})",
                "Expected 'x1 y1 x2 y2 x3 y3 x4 y4 class difficult', 'picture score x1 y1 x2 y2 x3 y3 x4 y4', or "
                "Ultralytics' 'class x1 y1 x2 y2 x3 y3 x4 y4' with corners from 0 to 1.",
            )
        items.append(item)
    return items


def names_in_text(named: Iterable[str], pictures: Sequence[str]) -> list[str]:
    """The names in a results file of the pictures `named`, some of the source's `pictures`. Raises UsageError for one
    with a space, which ends a name there."""
    names = [short_name(picture, pictures) for picture in named]
    for name in names:
        if any(c.isspace() for c in name):
            raise UsageError(
                f"DOTA's text cannot hold the picture name {shown(name)!r}, which has a space",
                "Save as .json instead.",
            )
    return names


def write(path: Path, boxes: Mapping[str, Boxes], pictures: Sequence[str]) -> None:
    """Write a results file, which keeps scores and picture names. Raises UsageError for names with spaces."""
    lines = [f"imagesource:{room(path)}"]
    for name, found in zip(names_in_text(boxes, pictures), boxes.values(), strict=True):
        for corners, score in zip(found.corners, found.score, strict=True):
            lines.append(f"{name} {score:.4f} " + " ".join(f"{v:.3f}" for v in corners.ravel()))
    path.write_text("".join(line + "\n" for line in lines), encoding="utf-8")


def _of_ultralytics(words: Sequence[str], picture: str | None) -> Item | None:
    numbers = _numbers(words)
    if numbers is None or len(numbers) not in (9, 10) or not words[0].isdecimal():
        return None
    if not (np.abs(numbers[1:9] - 0.5) < BEYOND).all():
        return None
    score = float(numbers[9]) if len(numbers) == 10 else 1.0
    return Item(numbers[1:9].reshape(4, 2), score, str(int(words[0])), picture, relative=True)


def _label(words: Sequence[str], picture: str | None) -> Item | None:
    corners = _numbers(words[:8])
    if corners is None or len(words) not in (9, 10) or _numbers(words[8:9]) is not None:
        return None
    return Item(corners.reshape(4, 2), 1.0, words[8], picture)


def _result(words: Sequence[str], label: str | None) -> Item | None:
    numbers = _numbers(words[1:])
    if numbers is None or len(numbers) != 9:
        return None
    return Item(numbers[1:].reshape(4, 2), float(numbers[0]), label, words[0])


def _numbers(words: Sequence[str]) -> np.ndarray | None:
    try:
        return np.array([float(w) for w in words])
    except ValueError:
        return None
