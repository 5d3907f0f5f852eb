"""Reconstructions in plain text: Bundler's bundle.out (v0.3) and VisualSFM's .nvm (NVM_V3).

Both are parsed line by line, so that a wrong count runs into the end of the file instead of filling the memory. The
parser marks which words of a line are lengths; reading and scaling share it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError
from ..reading import read_text, reason

BUNDLER, NVM = ".out", ".nvm"
SUFFIXES = (BUNDLER, NVM)
FIRST_OF_MANY = "it holds several models, each with a scale of its own: only the first is written"
TRACKS = 20_000  # number of points, about, whose tracks are read
UPRIGHT = np.diag([1.0, -1.0, -1.0])  # Bundler's cameras have y up and look along -z, COLMAP's have y down and z


@dataclass(frozen=True)
class TextModel:
    """The content of such a file, C cameras with one image each, in COLMAP's axes.

    names : (C,) of the images, None if not in the file. focal : (C,) [px], 0 if not registered.
    distortion : (C, 3) FULL_OPENCV's k1, k2, k3. centre : (C, 2) principal points [px], NaN: the image's middle.
    rotation, translation : (C, 3, 3), (C, 3) camera_from_world. points, colours : (M, 3).
    seen : (K, 4) observations of some of the points: camera, point, x, y [px], y down, from the principal point or, if
    `from_corner`, from the image's corner. others : whether other models follow in the file.
    """

    names: list[str] | None
    focal: np.ndarray
    distortion: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    points: np.ndarray
    colours: np.ndarray
    seen: np.ndarray
    from_corner: bool
    others: bool = False


class Line(NamedTuple):
    """kind : what the line describes. words : its words. lengths : which of the words are lengths. seen : the track of
    a point, its observations in images; only for some of the points."""

    text: str
    kind: str
    words: list[str]
    lengths: slice = slice(0, 0)
    seen: str = ""


def read_text_model(path: Path) -> TextModel:
    """The first model in the file `path`. Raises InputError for one that is damaged or of another format."""
    parts: dict[str, list[list[Any]]] = {}
    try:
        for line in _lines(path):
            if line.kind in ("head", "camera", "others"):
                parts.setdefault(line.kind, []).append(line.words)
            elif line.kind:
                parts.setdefault(line.kind, []).append([float(word) for word in line.words[:6]])
            if line.seen:
                parts.setdefault("seen", []).extend(_seen(line.seen, len(parts["point"]) - 1))
        model = (_bundler if path.suffix.lower() == BUNDLER else _nvm)(parts)
        if not ((model.seen[:, 0] >= 0) & (model.seen[:, 0] < len(model.focal))).all():
            raise ValueError("a point was seen by a camera that does not exist")
        return model
    except (ValueError, OverflowError) as error:  # the latter for an integer with hundreds of digits
        raise _damaged(path, reason(error)) from error


def image_names(path: Path, text: TextModel) -> tuple[list[str], list[Path]]:
    """The names of the images of the model `text` at `path`, in the order of its cameras; and the list file beside it
    from which they are, for Bundler, whose models have no names. Raises InputError."""
    if text.names is not None:
        return text.names, []
    count = len(text.focal)
    # COLMAP's GUI writes x.out and x.out.list.txt; users of Metashape name both as they like.
    own = [path.with_name(name) for name in (f"{path.name}.list.txt", f"{path.stem}.list.txt", f"{path.stem}_list.txt")]
    places = [*own, path.with_name("list.txt"), path.parent.parent / "list.txt"]
    if path.name.endswith("bundle.out") and path.name != "bundle.out":  # COLMAP writes x.bundle.out, x.list.txt
        places.insert(0, path.with_name(path.name.removesuffix("bundle.out") + "list.txt"))
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        raise InputError(
            f"{path} has no list of its images ({path.with_name('list.txt')})", "Put Bundler's list.txt beside it."
        )
    lines = read_text(found, "It is Bundler's list of images.").splitlines()
    # Bundler writes "NAME 0 FOCAL", COLMAP only the name, which may contain spaces.
    names = [re.sub(r"\s+0\s+[-+.\deE]+$", "", line.strip()) for line in lines if line.strip()]
    if len(names) != count:
        raise InputError(
            f"{found} names {len(names)} images, {path} has {count} cameras", "Give the list it came from."
        )
    return names, [found]


def scale_text_model(source: Path, target: Path, scale: float) -> list[str]:
    """Write the first model of `source` with all lengths times `scale`, and all else unchanged. Returns notes for the
    user. Raises InputError."""
    notes = []
    with target.open("w", encoding="utf-8") as out:
        for line in _lines(source):
            if line.kind == "others":
                notes.append(FIRST_OF_MANY)
            words = line.words[line.lengths]
            if words:
                line.words[line.lengths] = [repr(float(word) * scale) for word in words]
                out.write(" ".join(line.words) + "\n")
            else:
                out.write(line.text)
        if source.suffix.lower() == NVM:
            out.write("\n0\n")  # no more models
    return notes


def _lines(path: Path) -> Iterator[Line]:
    """The lines of the file's first model. Raises InputError."""
    walk = _walk_bundler if path.suffix.lower() == BUNDLER else _walk_nvm
    number = 0

    def following() -> str:
        nonlocal number
        number += 1
        line = file.readline()
        if not line:
            raise ValueError("the file ends too early")
        return line

    try:
        with path.open(encoding="utf-8") as file:
            for line in walk(following):
                if not np.isfinite([float(word) for word in line.words[line.lengths]]).all():
                    raise ValueError("a length is not finite")
                yield line
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check the file and its permissions.") from error
    except ValueError as error:  # malformed numbers or counts, or bytes that are not UTF-8
        raise _damaged(path, f"line {number}: {reason(error)}") from error


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        f"{path}: neither Bundler's bundle.out (v0.3) nor VisualSFM's NVM_V3 ({why})",
        "The file may be damaged or of another version: copy it again, or export it again.",
    )


def _walk_bundler(following: Callable[[], str]) -> Iterator[Line]:
    head = following()
    if not head.startswith("# Bundle file v0.3"):
        raise ValueError("it does not begin with '# Bundle file v0.3'")
    yield Line(head, "", [])
    counts = following()
    cameras, points = _counts(counts, 2)
    yield Line(counts, "", [])

    def vector(kind: str, is_length: bool = False) -> Line:
        text = following()
        words = text.split()
        if len(words) != 3:
            raise ValueError(f"{len(words)} numbers where 3 belong")
        return Line(text, kind, words, slice(0, 3) if is_length else slice(0, 0))

    for _ in range(cameras):
        yield vector("lens")
        for _row in range(3):
            yield vector("rotation")
        yield vector("translation", True)
    for k in range(points):
        yield vector("point", True)
        yield vector("colour")
        text = following()
        yield Line(text, "", [], seen=_every(k, points, text))


def _walk_nvm(following: Callable[[], str]) -> Iterator[Line]:
    head = following()
    if (form := head.split()[:1]) != ["NVM_V3"]:
        other = "its form NVM_V3_R9T, with matrices for rotations, is not read" if form == ["NVM_V3_R9T"] else ""
        raise ValueError(other or "it does not begin with NVM_V3")
    yield Line(head, "head", head.split())
    for kind, least, lengths in (("camera", 10, slice(6, 9)), ("point", 6, slice(0, 3))):
        text = following()
        while not text.split():
            yield Line(text, "", [])
            text = following()
        (count,) = _counts(text, 1)
        yield Line(text, "", [])
        for k in range(count):
            text = following()
            words = text.rstrip().split(maxsplit=least)  # a point's track stays in one piece
            if len(words) < least:
                raise ValueError(f"{len(words)} words where {least} belong")
            yield Line(text, kind, words, lengths, _every(k, count, words[6]) if kind == "point" and words[6:] else "")
    with suppress(ValueError):  # the end of the file
        while (text := _next_of(following)).split() != ["0"]:
            if not (unregistered := _without_points(text, following)):
                yield Line("", "others", [])
                return
            yield from (Line(line, "", []) for line in ("\n", *unregistered))


def _without_points(text: str, following: Callable[[], str]) -> list[str]:
    """The lines of a model that begins with `text` and has no points: VisualSFM's last one, of unregistered images.
    Empty for any other model."""
    try:
        (count,) = _counts(text, 1)
        lines = [text, *(following() for _ in range(count)), points := _next_of(following)]
    except ValueError:
        return []
    return lines if points.split() == ["0"] else []


def _next_of(following: Callable[[], str]) -> str:
    """The next line with a word in it."""
    while not (text := following()).split():
        pass
    return text


def _every(number: int, count: int, text: str) -> str:
    """`text` of the point `number`, kept only for about TRACKS of the `count` points; '' for the others."""
    return text if number % max(1, count // TRACKS) == 0 else ""


def _seen(text: str, point: int) -> list[list[float]]:
    """Camera, `point`, x and y of each observation in a track: its text is their number, then camera, key, x and y of
    each."""
    count, *words = text.split()
    if len(words) != 4 * int(count):
        raise ValueError(f"a track of {count} images has {len(words)} numbers")
    return [[int(words[k]), point, float(words[k + 2]), float(words[k + 3])] for k in range(0, len(words), 4)]


def _counts(text: str, number: int) -> list[int]:
    counts = [int(word) for word in text.split()]
    if len(counts) != number or min(counts) < 1:
        raise ValueError(f"{text.strip()[:40]!r} where counts belong")
    return counts


def _bundler(parts: dict[str, list[list[Any]]]) -> TextModel:
    """As in Snavely's manual: P = R X + t, p = -P / P.z, pixels from the middle f (1 + k1 |p|^2 + k2 |p|^4) p, y up."""
    lens = np.array(parts["lens"], float)
    count = len(lens)
    return TextModel(
        names=None,
        focal=lens[:, 0],
        distortion=np.column_stack([lens[:, 1:], np.zeros(count)]),
        centre=np.full((count, 2), np.nan),
        rotation=UPRIGHT @ np.array(parts["rotation"], float).reshape(count, 3, 3),
        translation=np.array(parts["translation"], float) @ UPRIGHT,
        points=np.array(parts["point"], float),
        colours=np.array(parts["colour"], float),
        seen=np.array(parts.get("seen", []), float).reshape(-1, 4) * (1, 1, 1, -1),
        from_corner=False,
    )


def _nvm(parts: dict[str, list[list[Any]]]) -> TextModel:
    """As in VisualSFM's manual: name, focal length, quaternion wxyz, camera centre, radial distortion r; double quotes
    stand for spaces in names. There, (1 + r |m|^2) m undistorts a measurement m; here is the inverse, as a series."""
    values = np.array([words[1:10] for words in parts["camera"]], float)
    quaternion, centre, r = values[:, 1:5], values[:, 5:8], values[:, 8]
    if not (np.abs(np.linalg.norm(quaternion, axis=1) - 1) < 0.01).all():
        raise ValueError("a quaternion is not of length one")
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).as_matrix()
    head = parts["head"][0]  # NVM_V3 FixedK fx cx fy cy, for all cameras
    middle = (float(head[3]), float(head[5])) if len(head) >= 6 and head[1] == "FixedK" else (np.nan, np.nan)
    points = np.array([words[:6] for words in parts["point"]], float)
    seen = np.array(parts.get("seen", []), float).reshape(-1, 4)
    return TextModel(
        names=[words[0].replace('"', " ") for words in parts["camera"]],
        focal=values[:, 0],
        distortion=np.column_stack([-r, 3 * r**2, -12 * r**3]),
        centre=np.tile(middle, (len(r), 1)),
        rotation=rotation,
        translation=-np.einsum("nij,nj->ni", rotation, centre),
        points=points[:, :3],
        colours=points[:, 3:],
        seen=seen,
        # By VisualSFM's manual pixels are relative to the image's middle; COLMAP writes them relative to its corner.
        from_corner=bool((seen[:, 2:] >= 0).mean() > 0.95) if len(seen) else False,
        others="others" in parts,
    )
