"""Reads and checks the text files of a COLMAP model, line by line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ..errors import shown
from ..formats.reading import refuse_pointer
from .colmap_tables import (
    CAMERA_MODELS,
    MODEL_IDS,
    NO_POINT,
    NOT_UTF8_HINT,
    SENSOR_TYPES,
    CameraRow,
    FrameRow,
    ImageRow,
    Points,
    RigRow,
    Tables,
    add,
    damaged,
    unknown_camera,
)


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """All lines of a text file, stripped, each after its place (file and line number)."""
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                where = f"{path}, line {number}"
                if number == 1 and line.startswith("\ufeff"):
                    raise damaged(
                        where, "begins with a byte order mark, which COLMAP cannot read", "Save it without one."
                    )
                if not line.endswith("\n"):  # a number may have lost its last digits
                    raise damaged(
                        where, "the last line has no line break", "Copy the file again; if it is complete, add one."
                    )
                yield where, line.strip()
    except OSError as error:
        raise damaged(str(path), f"cannot be read ({error.strerror})", "Check its permissions.") from error
    except UnicodeDecodeError:
        raise damaged(str(path), "is not UTF-8 text", NOT_UTF8_HINT) from None


def _records(path: Path) -> Iterator[tuple[str, list[str]]]:
    for where, line in _lines(path):
        if line and not line.startswith("#"):
            yield where, line.split()


def _parse(where: str, words: list[str], kind: Callable, what: str) -> list:
    try:
        return [kind(word) for word in words]
    except (ValueError, OverflowError):
        raise damaged(where, f"{what}: a number is missing or malformed in '{' '.join(words)[:80]}'") from None


def _need_words(where: str, words: list[str], least: int, what: str) -> None:
    if len(words) < least:
        raise damaged(where, f"{what} needs {least} values, the line has {len(words)}")


def read_text(paths: dict[str, Path]) -> Tables:
    """The tables of the .txt files at `paths`. Raises InputError."""
    tables = Tables(paths=paths)
    readers = {
        "cameras": _text_cameras,
        "images": _text_images,
        "points3D": _text_points,
        "rigs": _text_rigs,
        "frames": _text_frames,
    }
    for table, path in paths.items():
        refuse_pointer(path)
        readers[table](path, tables)
    return tables


def _text_cameras(path: Path, tables: Tables) -> None:
    for where, words in _records(path):
        _need_words(where, words, 5, "a camera")
        camera, width, height = _parse(where, [words[0], *words[2:4]], int, "a camera")
        if words[1] not in MODEL_IDS:
            raise unknown_camera(where, camera, words[1])
        model = MODEL_IDS[words[1]]
        params = tuple(_parse(where, words[4:], float, f"camera {camera}"))
        expected = CAMERA_MODELS[model][1]
        if len(params) != expected:
            raise damaged(where, f"camera {camera}: {words[1]} has {expected} parameters, the line {len(params)}")
        add(tables.cameras, camera, CameraRow(where, model, width, height, params), where, "camera")


def _text_images(path: Path, tables: Tables) -> None:
    lines = _lines(path)
    for where, line in lines:
        if not line or line.startswith("#"):
            continue
        words = line.split(maxsplit=9)
        _need_words(where, words, 10, "an image")
        name = words[9]
        if " " in name:
            raise damaged(
                where, f"image name '{name}' has a space, which COLMAP cuts off in .txt models", "Use a .bin model."
            )
        image, camera = _parse(where, [words[0], words[8]], int, f"image {name}")
        pose = tuple(_parse(where, words[1:8], float, f"image {name}"))
        # The line of observations may be empty, and may be missing after the last image.
        seen_where, seen = next(lines, (where, ""))
        words = seen.split()
        if len(words) % 3:
            raise damaged(seen_where, f"observations of image {name} are not triples of x, y, point")
        points = _parse(seen_where, words[2::3], int, f"image {name}")
        if points and not -1 <= min(points) <= max(points) <= NO_POINT:
            raise damaged(seen_where, f"image {name}: a point id is out of range")
        x, y = (_parse(seen_where, words[k::3], float, f"image {name}") for k in (0, 1))
        ids = np.array([NO_POINT if p == -1 else p for p in points], np.uint64)
        tables.images.append(ImageRow(where, image, pose, camera, name, np.column_stack([x, y]), ids))


def _text_points(path: Path, tables: Tables) -> None:
    ids, values, tracks, lengths = [], [], [], []
    for where, words in _records(path):
        _need_words(where, words, 8, "a point")
        track = _parse(where, words[8:], int, f"point {words[0]}")
        if len(track) % 2:
            raise damaged(where, f"the track of point {words[0]} is not pairs of image and observation")
        number, *colour = _parse(where, [words[0], *words[4:7]], int, f"point {words[0]}")
        if not 0 <= number < NO_POINT or not all(0 <= c <= 255 for c in colour):
            raise damaged(where, f"point {words[0]}: its id or colour is out of range")
        ids.append(number)
        values.append(_parse(where, [*words[1:4], words[7]], float, f"point {words[0]}"))
        tracks += track
        lengths.append(len(track) // 2)
    if tracks and not 0 <= min(tracks) <= max(tracks) < 2**32:
        raise damaged(str(path), "a track refers to an image or observation that is out of range")
    tables.points = Points(
        path,
        np.array(ids, np.uint64),
        np.array(values, float).reshape(-1, 4),
        np.repeat(np.arange(len(ids)), np.array(lengths, int)),
        np.array(tracks, np.int64).reshape(-1, 2),
    )


def _text_sensor(where: str, kind: str, number: str) -> tuple[int, int]:
    if kind not in SENSOR_TYPES:
        raise damaged(where, f"unknown sensor type '{kind[:40]}'")
    return SENSOR_TYPES[kind], _parse(where, [number], int, "a sensor")[0]


def _text_rigs(path: Path, tables: Tables) -> None:
    tables.rigs = {}
    for where, words in _records(path):
        _need_words(where, words, 2, "a rig")
        rig, count = _parse(where, words[:2], int, "a rig")
        sensors: list[tuple[int, int, tuple[float, ...]]] = []
        rest = words[2:]
        while rest:
            _need_words(where, rest, 2 if not sensors else 3, f"a sensor of rig {rig}")
            kind, sensor = _text_sensor(where, *rest[:2])
            if sensors and rest[2] not in ("0", "1"):
                raise damaged(
                    where, f"whether sensor {sensor} of rig {rig} has a pose is {shown(rest[2], 20)}, not 0 or 1"
                )
            posed = bool(sensors) and rest[2] == "1"
            _need_words(where, rest, 10 if posed else 0, f"a sensor of rig {rig}")
            pose = tuple(_parse(where, rest[3:10], float, f"rig {rig}")) if posed else ()
            rest = rest[10 if posed else 3 if sensors else 2 :]
            sensors.append((kind, sensor, pose))
        if len(sensors) != count:
            raise damaged(where, f"rig {rig} announces {count} sensors, the line has {len(sensors)}")
        add(tables.rigs, rig, RigRow(where, sensors), where, "rig")


def _text_frames(path: Path, tables: Tables) -> None:
    tables.frames = {}
    for where, words in _records(path):
        _need_words(where, words, 10, "a frame")
        frame, rig, count = _parse(where, [*words[:2], words[9]], int, "a frame")
        pose = tuple(_parse(where, words[2:9], float, f"frame {frame}"))
        if len(words) != 10 + 3 * count:
            raise damaged(where, f"frame {frame} announces {count} data, the line has {(len(words) - 10) / 3:g}")
        data = [
            (*_text_sensor(where, *words[k : k + 2]), *_parse(where, words[k + 2 : k + 3], int, f"frame {frame}"))
            for k in range(10, len(words), 3)
        ]
        add(tables.frames, frame, FrameRow(where, rig, pose, data), where, "frame")
