"""Finding a COLMAP model and walking its files, so that pycolmap never meets a damaged one.

pycolmap trusts what it reads: a lying count eats all memory, a NaN pose loads as valid, random bytes hang it. Here
every count is held against the file's size, every number must be finite, and every reference must lead somewhere.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import InputError, shown
from .consistency import Observations, observations, some_of_each

NO_POINT = 2**64 - 1
FARTHEST = 1e12  # [units] nothing on Earth is so far, not even in millimetres
CAMERA_SENSOR = 0
IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
TABLES = ("cameras", "images", "points3D")
RIG_TABLES = ("rigs", "frames")
# Model id: name, number of parameters, how many of them (the first ones) are focal lengths.
CAMERA_MODELS = {
    0: ("SIMPLE_PINHOLE", 3, 1),
    1: ("PINHOLE", 4, 2),
    2: ("SIMPLE_RADIAL", 4, 1),
    3: ("RADIAL", 5, 1),
    4: ("OPENCV", 8, 2),
    5: ("OPENCV_FISHEYE", 8, 2),
    6: ("FULL_OPENCV", 12, 2),
    7: ("FOV", 5, 2),
    8: ("SIMPLE_RADIAL_FISHEYE", 4, 1),
    9: ("RADIAL_FISHEYE", 5, 1),
    10: ("THIN_PRISM_FISHEYE", 12, 2),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16, 2),
    12: ("SIMPLE_DIVISION", 4, 1),
    13: ("DIVISION", 5, 2),
    14: ("SIMPLE_FISHEYE", 3, 1),
    15: ("FISHEYE", 4, 2),
    16: ("EUCM", 6, 2),
}
MODEL_IDS = {name: model for model, (name, _, _) in CAMERA_MODELS.items()}
SENSOR_TYPES = {"CAMERA": 0, "IMU": 1}
WRITE_ANEW = "The file is damaged: copy the model again, or write it anew with `colmap model_converter`."


@dataclass(frozen=True)
class ModelFiles:
    """A COLMAP model on disk whose files have been walked and found whole.

    folder : where it lies. format : 'bin' or 'txt'. paths : the files that make it up.
    seen : some of what its images saw. notes : what was chosen or left aside on the way, for the report.
    """

    folder: Path
    format: str
    paths: tuple[Path, ...]
    seen: Observations
    notes: tuple[str, ...] = ()


def open_model(path: Path) -> ModelFiles:
    """Find the model at or below `path` and check it.

    `path` is a folder with cameras, images and points3D (.bin or .txt), or a workspace that has them in `sparse/`,
    `sparse/0` or the like; of several models the one with the most images is taken.
    Raises InputError, saying which file, where in it and which image, for anything missing or damaged.
    """
    folder, notes = _find_folder(Path(path))
    form, more = _choose_format(folder)
    paths = _paths(folder, form)
    tables = _READERS[form](paths)
    _check(tables)
    return ModelFiles(folder, form, tuple(paths.values()), _seen(tables), (*notes, *more))


def check_model(folder: Path, form: str) -> None:
    """Walk the files of the model in `folder` of the format `form` ('bin' or 'txt'); raises as `open_model`."""
    _check(_READERS[form](_paths(folder, form)))


# --- Which files -----------------------------------------------------------------------------------------------------


def model_folders(path: Path) -> list[Path]:
    """The folders of all models at or below `path`, as COLMAP's mapper leaves them: ``sparse/0``, ``sparse/1`` ...

    `path` is as in `open_model`. Raises InputError where there is none; the files are not looked into.
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
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check its permissions.") from error
    raise InputError(
        f"{path} holds no COLMAP model (no cameras.bin or cameras.txt in it, in sparse/ or in sparse/0)",
        "Give the folder that holds cameras.bin, images.bin and points3D.bin, or the .txt files of the same names.",
    )


def _find_folder(path: Path) -> tuple[Path, list[str]]:
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
    """How many images the model claims: good enough to choose between models, checked afterwards."""
    binary, text = folder / "images.bin", folder / "images.txt"
    if binary.is_file():
        with binary.open("rb") as file:
            head = file.read(8)
        count = struct.unpack("<Q", head)[0] if len(head) == 8 else 0
        return count if count * 73 <= binary.stat().st_size else 0
    if text.is_file():
        with text.open("rb") as file:
            return sum(1 for line in file if not line.startswith(b"#")) // 2
    return 0


def _paths(folder: Path, form: str) -> dict[str, Path]:
    """The files of one format, by table; both or none of rigs and frames."""
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


def _choose_format(folder: Path) -> tuple[str, list[str]]:
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
    # COLMAP reads .bin and never looks at .txt beside it. File dates prove nothing after a copy: contents must agree.
    if _poses(_read_binary(_paths(folder, "bin"))) != _poses(_read_text(_paths(folder, "txt"))):
        raise InputError(
            f"{folder} holds two different models, one in .bin and one in .txt files",
            "COLMAP would read the .bin files and ignore the .txt. Move those you do not mean to another folder.",
        )
    return "bin", [f"{folder}: .bin and .txt files agree; the .bin files are read"]


def _poses(tables: _Tables) -> dict[str, tuple[float, ...]]:
    return {image.name: tuple(round(x, 5) + 0.0 for x in image.pose) for image in tables.images}


# --- What a model holds ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Camera:
    where: str
    model: int
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class _Image:
    where: str
    id: int
    pose: tuple[float, ...]  # qw qx qy qz tx ty tz
    camera: int
    name: str
    xy: np.ndarray  # (K, 2)
    points: np.ndarray  # (K,) uint64, NO_POINT for none


@dataclass(frozen=True)
class _Points:
    path: Path
    ids: np.ndarray  # (P,) uint64
    values: np.ndarray  # (P, 4) x y z error
    track_of: np.ndarray  # (T,) index of the point each track element belongs to
    tracks: np.ndarray  # (T, 2) image id, index of the observation in the image


@dataclass(frozen=True)
class _Rig:
    where: str
    sensors: list[tuple[int, int, tuple[float, ...]]]  # type, id, pose or ()


@dataclass(frozen=True)
class _Frame:
    where: str
    rig: int
    pose: tuple[float, ...]
    data: list[tuple[int, int, int]]  # sensor type, sensor id, data id


@dataclass
class _Tables:
    cameras: dict[int, _Camera] = field(default_factory=dict)
    images: list[_Image] = field(default_factory=list)
    points: _Points = field(init=False)
    rigs: dict[int, _Rig] | None = None
    frames: dict[int, _Frame] | None = None
    paths: dict[str, Path] = field(default_factory=dict)


def _damaged(where: str, what: str, hint: str = WRITE_ANEW) -> InputError:
    return InputError(f"{where}: {what}", hint)


def _add(table: dict, key: int, value: object, where: str, kind: str) -> None:
    if key in table:
        raise _damaged(where, f"{kind} {key} appears twice")
    table[key] = value


# --- Binary ----------------------------------------------------------------------------------------------------------


class _Bytes:
    """A binary file read front to back, never past its end and always to its end."""

    def __init__(self, path: Path):
        self.path, self.at = path, 0
        try:
            with path.open("rb") as file:
                self.size = path.stat().st_size
                self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if self.size else b""
        except OSError as error:
            raise _damaged(str(path), f"cannot be read ({error.strerror})", "Check its permissions.") from error

    @property
    def where(self) -> str:
        return f"{self.path}, byte {self.at}"

    def need(self, size: int, what: str) -> None:
        if self.at + size > self.size:
            raise _damaged(self.where, f"file ends ({self.size} bytes) within {what}")

    def take(self, form: str, what: str) -> tuple:
        form = "<" + form
        self.need(struct.calcsize(form), what)
        values = struct.unpack_from(form, self.data, self.at)
        self.at += struct.calcsize(form)
        return values

    def count(self, smallest: int, what: str) -> int:
        """A count of records that take at least `smallest` bytes each."""
        where = self.where
        (count,) = self.take("Q", f"the number of {what}")
        if count * smallest > self.size - self.at:
            raise _damaged(where, f"{count} {what} announced, but only {self.size - self.at} bytes follow")
        return count

    def text(self, what: str) -> str:
        end = self.data.find(b"\0", self.at, self.at + 4096)
        if end < 0:
            raise _damaged(self.where, f"no end of {what} within 4096 bytes")
        try:
            text = self.data[self.at : end].decode()
        except UnicodeDecodeError:
            raise _damaged(self.where, f"{what} is not UTF-8 text") from None
        self.at = end + 1
        return text

    def done(self) -> None:
        if self.at != self.size:
            raise _damaged(self.where, f"{self.size - self.at} bytes more than the announced records need")


_OBSERVATION = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
_POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")])


def _read_binary(paths: dict[str, Path]) -> _Tables:
    tables = _Tables(paths=paths)
    readers = {
        "cameras": _binary_cameras,
        "images": _binary_images,
        "points3D": _binary_points,
        "rigs": _binary_rigs,
        "frames": _binary_frames,
    }
    for table, path in paths.items():
        file = _Bytes(path)
        readers[table](file, tables)
        file.done()
    return tables


def _binary_cameras(file: _Bytes, tables: _Tables) -> None:
    for _ in range(file.count(48, "cameras")):
        where = file.where
        camera, model, width, height = file.take("IiQQ", "a camera")
        if model not in CAMERA_MODELS:
            raise _unknown_camera(where, camera, model)
        params = file.take(f"{CAMERA_MODELS[model][1]}d", f"the parameters of camera {camera}")
        _add(tables.cameras, camera, _Camera(where, model, width, height, params), where, "camera")


def _unknown_camera(where: str, camera: int, model: object) -> InputError:
    if model in (17, "EQUIRECTANGULAR"):
        return _damaged(
            where,
            f"camera {camera} is spherical (EQUIRECTANGULAR)",
            "Cut perspective views out of the panoramas first.",
        )
    return _damaged(where, f"camera {camera} has the unknown model {model}")


def _binary_images(file: _Bytes, tables: _Tables) -> None:
    for _ in range(file.count(73, "images")):
        where = file.where
        image, *pose, camera = file.take("I7dI", "an image")
        name = file.text(f"the name of image {image}")
        count = file.count(24, f"observations of image {image} ({name})")
        seen = np.frombuffer(file.data, _OBSERVATION, count, file.at) if count else np.empty(0, _OBSERVATION)
        file.at += 24 * count
        tables.images.append(_Image(where, image, tuple(pose), camera, name, seen["xy"], seen["point"]))


def _binary_points(file: _Bytes, tables: _Tables) -> None:
    count = file.count(_POINT.itemsize, "points")
    starts = np.empty(count, np.int64)
    data, size, at, head = file.data, file.size, file.at, _POINT.itemsize
    track = struct.Struct("<Q").unpack_from
    for k in range(count):
        starts[k] = at
        at += head
        if at <= size:
            at += 8 * track(data, at - 8)[0]
        if at > size:
            file.at = int(starts[k])
            raise _damaged(file.where, f"file ends ({size} bytes) within the record of point {k + 1} of {count}")
    file.at = at
    # Records differ in length: their heads are told from their tracks by a running sum that is 1 inside the heads.
    inside = np.zeros(size + 1, np.int8)
    inside[starts] += 1
    inside[starts + head] -= 1
    inside = np.cumsum(inside, dtype=np.int8)[:at].astype(bool)
    raw = np.frombuffer(data, np.uint8, at)
    heads = raw[inside].view(_POINT)
    tracks = raw[8:][~inside[8:]].view("<u4").reshape(-1, 2).astype(np.int64)
    values = np.column_stack([heads["xyz"], heads["error"]])
    track_of = np.repeat(np.arange(count), heads["track"].astype(np.int64))
    tables.points = _Points(file.path, heads["id"].astype(np.uint64), values, track_of, tracks)


def _binary_rigs(file: _Bytes, tables: _Tables) -> None:
    tables.rigs = {}
    for _ in range(file.count(8, "rigs")):
        where = file.where
        sensors: list[tuple[int, int, tuple[float, ...]]] = []
        rig, count = file.take("II", "a rig")
        for k in range(count):
            kind, sensor = file.take("iI", f"the sensors of rig {rig}")
            pose: tuple[float, ...] = ()
            if k and file.take("B", f"the sensors of rig {rig}")[0]:
                pose = file.take("7d", f"the sensors of rig {rig}")
            sensors.append((kind, sensor, pose))
        _add(tables.rigs, rig, _Rig(where, sensors), where, "rig")


def _binary_frames(file: _Bytes, tables: _Tables) -> None:
    tables.frames = {}
    for _ in range(file.count(68, "frames")):
        where = file.where
        frame, rig, *pose, count = file.take("II7dI", "a frame")
        file.need(16 * count, f"the {count} data of frame {frame}")
        data = [file.take("iIQ", "") for _ in range(count)]
        _add(tables.frames, frame, _Frame(where, rig, tuple(pose), data), where, "frame")


# --- Text ------------------------------------------------------------------------------------------------------------


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """All lines of a text file, stripped, each with where it is."""
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                where = f"{path}, line {number}"
                if not line.endswith("\n"):  # a number may have lost its last digits
                    raise _damaged(
                        where, "the last line has no end", "Copy the file again; if it is whole, end the line."
                    )
                yield where, line.strip()
    except OSError as error:
        raise _damaged(str(path), f"cannot be read ({error.strerror})", "Check its permissions.") from error
    except UnicodeDecodeError:
        raise _damaged(str(path), "is not UTF-8 text") from None


def _records(path: Path) -> Iterator[tuple[str, list[str]]]:
    for where, line in _lines(path):
        if line and not line.startswith("#"):
            yield where, line.split()


def _parse(where: str, words: list[str], kind: Callable, what: str) -> list:
    try:
        return [kind(word) for word in words]
    except (ValueError, OverflowError):
        raise _damaged(where, f"{what}: a number is missing or malformed in '{' '.join(words)[:80]}'") from None


def _need_words(where: str, words: list[str], least: int, what: str) -> None:
    if len(words) < least:
        raise _damaged(where, f"{what} needs {least} values, the line has {len(words)}")


def _read_text(paths: dict[str, Path]) -> _Tables:
    tables = _Tables(paths=paths)
    readers = {
        "cameras": _text_cameras,
        "images": _text_images,
        "points3D": _text_points,
        "rigs": _text_rigs,
        "frames": _text_frames,
    }
    for table, path in paths.items():
        readers[table](path, tables)
    return tables


def _text_cameras(path: Path, tables: _Tables) -> None:
    for where, words in _records(path):
        _need_words(where, words, 5, "a camera")
        camera, width, height = _parse(where, [words[0], *words[2:4]], int, "a camera")
        if words[1] not in MODEL_IDS:
            raise _unknown_camera(where, camera, words[1])
        model = MODEL_IDS[words[1]]
        params = tuple(_parse(where, words[4:], float, f"camera {camera}"))
        expected = CAMERA_MODELS[model][1]
        if len(params) != expected:
            raise _damaged(where, f"camera {camera}: {words[1]} has {expected} parameters, the line {len(params)}")
        _add(tables.cameras, camera, _Camera(where, model, width, height, params), where, "camera")


def _text_images(path: Path, tables: _Tables) -> None:
    lines = _lines(path)
    for where, line in lines:
        if not line or line.startswith("#"):
            continue
        words = line.split(maxsplit=9)
        _need_words(where, words, 10, "an image")
        name = words[9]
        if " " in name:
            raise _damaged(
                where, f"image name '{name}' has a space, which COLMAP cuts off in .txt models", "Use a .bin model."
            )
        image, camera = _parse(where, [words[0], words[8]], int, f"image {name}")
        pose = tuple(_parse(where, words[1:8], float, f"image {name}"))
        # The line of observations may be empty, and may be missing after the last image.
        seen_where, seen = next(lines, (where, ""))
        words = seen.split()
        if len(words) % 3:
            raise _damaged(seen_where, f"observations of image {name} are not triples of x, y, point")
        points = _parse(seen_where, words[2::3], int, f"image {name}")
        if points and not -1 <= min(points) <= max(points) <= NO_POINT:
            raise _damaged(seen_where, f"image {name}: a point id is out of range")
        x, y = (_parse(seen_where, words[k::3], float, f"image {name}") for k in (0, 1))
        ids = np.array([NO_POINT if p == -1 else p for p in points], np.uint64)
        tables.images.append(_Image(where, image, pose, camera, name, np.column_stack([x, y]), ids))


def _text_points(path: Path, tables: _Tables) -> None:
    ids, values, tracks, lengths = [], [], [], []
    for where, words in _records(path):
        _need_words(where, words, 8, "a point")
        track = _parse(where, words[8:], int, f"point {words[0]}")
        if len(track) % 2:
            raise _damaged(where, f"the track of point {words[0]} is not pairs of image and observation")
        colour = _parse(where, [words[0], *words[4:7]], int, f"point {words[0]}")
        if not 0 <= colour[0] < NO_POINT or not all(0 <= c <= 255 for c in colour[1:]):
            raise _damaged(where, f"point {words[0]}: its id or colour is out of range")
        ids.append(colour[0])
        values.append(_parse(where, [*words[1:4], words[7]], float, f"point {words[0]}"))
        tracks += track
        lengths.append(len(track) // 2)
    if tracks and not 0 <= min(tracks) <= max(tracks) < 2**32:
        raise _damaged(str(path), "a track refers to an image or observation that is out of range")
    tables.points = _Points(
        path,
        np.array(ids, np.uint64),
        np.array(values, float).reshape(-1, 4),
        np.repeat(np.arange(len(ids)), np.array(lengths, int)),
        np.array(tracks, np.int64).reshape(-1, 2),
    )


def _text_sensor(where: str, kind: str, number: str) -> tuple[int, int]:
    if kind not in SENSOR_TYPES:
        raise _damaged(where, f"unknown sensor type '{kind[:40]}'")
    return SENSOR_TYPES[kind], _parse(where, [number], int, "a sensor")[0]


def _text_rigs(path: Path, tables: _Tables) -> None:
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
                raise _damaged(
                    where, f"whether sensor {sensor} of rig {rig} has a pose is {shown(rest[2], 20)}, not 0 or 1"
                )
            posed = bool(sensors) and rest[2] == "1"
            _need_words(where, rest, 10 if posed else 0, f"a sensor of rig {rig}")
            pose = tuple(_parse(where, rest[3:10], float, f"rig {rig}")) if posed else ()
            rest = rest[10 if posed else 3 if sensors else 2 :]
            sensors.append((kind, sensor, pose))
        if len(sensors) != count:
            raise _damaged(where, f"rig {rig} announces {count} sensors, the line has {len(sensors)}")
        _add(tables.rigs, rig, _Rig(where, sensors), where, "rig")


def _text_frames(path: Path, tables: _Tables) -> None:
    tables.frames = {}
    for where, words in _records(path):
        _need_words(where, words, 10, "a frame")
        frame, rig, count = _parse(where, [*words[:2], words[9]], int, "a frame")
        pose = tuple(_parse(where, words[2:9], float, f"frame {frame}"))
        if len(words) != 10 + 3 * count:
            raise _damaged(where, f"frame {frame} announces {count} data, the line has {(len(words) - 10) / 3:g}")
        data = [
            (*_text_sensor(where, *words[k : k + 2]), *_parse(where, words[k + 2 : k + 3], int, f"frame {frame}"))
            for k in range(10, len(words), 3)
        ]
        _add(tables.frames, frame, _Frame(where, rig, pose, data), where, "frame")


_READERS = {"bin": _read_binary, "txt": _read_text}


# --- Does it make sense ----------------------------------------------------------------------------------------------


def _check(tables: _Tables) -> None:
    """Raise InputError for values and references that cannot be meant; the first one found."""
    _check_cameras(tables)
    _check_images(tables)
    _check_points(tables)
    if tables.rigs is not None and tables.frames is not None:
        _check_rigs(tables, tables.rigs, tables.frames)


def _check_pose(where: str, pose: tuple[float, ...], what: str) -> None:
    if not (np.abs(pose) <= FARTHEST).all():
        raise _damaged(where, f"the pose of {what} has a value that is not a finite number, or beyond {FARTHEST:g}")
    norm = np.linalg.norm(pose[:4])
    if abs(norm - 1) > 0.01:
        raise _damaged(where, f"the rotation of {what} is no unit quaternion (its norm is {norm:.3g})")


def _check_cameras(tables: _Tables) -> None:
    for number, camera in tables.cameras.items():
        if not 0 <= number < 2**32 - 1:
            raise _damaged(camera.where, f"camera id {number} is out of range")
        if not (0 < camera.width < 2**20 and 0 < camera.height < 2**20):
            raise _damaged(camera.where, f"camera {number} has the impossible size {camera.width} x {camera.height} px")
        if not np.isfinite(camera.params).all():
            raise _damaged(camera.where, f"camera {number} has a parameter that is not a finite number")
        focals = camera.params[: CAMERA_MODELS[camera.model][2]]
        if min(focals) <= 0:
            raise _damaged(camera.where, f"camera {number} has the impossible focal length {min(focals):g} px")


def _check_images(tables: _Tables) -> None:
    if not tables.images:
        raise _damaged(
            str(tables.paths["images"]), "no registered image", "Give a model that COLMAP could reconstruct."
        )
    ids: set[int] = set()
    names: set[str] = set()
    for image in tables.images:
        what = f"image {image.id} ({image.name})"
        if not image.name:
            raise _damaged(image.where, f"image {image.id} has no name")
        if not 0 <= image.id < 2**32 - 1:
            raise _damaged(image.where, f"{what}: its id is out of range")
        if image.id in ids or image.name in names:
            raise _damaged(image.where, f"{what} appears twice, by its id or by its name")
        ids.add(image.id)
        names.add(image.name)
        _check_pose(image.where, image.pose, what)
        if image.camera not in tables.cameras:
            raise _damaged(image.where, f"{what} refers to camera {image.camera}, which does not exist")
        if not np.isfinite(image.xy).all():
            raise _damaged(image.where, f"{what} has an observation that is not a finite number")


def _check_points(tables: _Tables) -> None:
    points, images = tables.points, tables.images
    if not len(points.ids):
        raise _damaged(
            str(points.path),
            "no points",
            "The ground is found from sparse points: triangulate them (point_triangulator).",
        )
    sane = (np.abs(points.values) <= FARTHEST).all(1)
    if not sane.all():
        what = f"point {points.ids[~sane][0]} has a value that is not a finite number, or beyond {FARTHEST:g}"
        raise _damaged(str(points.path), what)
    order = np.argsort(points.ids)
    known = points.ids[order]
    if (known[1:] == known[:-1]).any():
        raise _damaged(str(points.path), f"point {known[1:][known[1:] == known[:-1]][0]} appears twice")

    counts = np.array([len(image.points) for image in images])
    named = np.concatenate([image.points for image in images])
    place = np.minimum(np.searchsorted(known, named), len(known) - 1)
    lost = (named != NO_POINT) & (known[place] != named)
    if lost.any():
        first = int(np.argmax(lost))
        image = images[int(np.searchsorted(np.cumsum(counts), first, side="right"))]
        raise _damaged(
            image.where,
            f"image {image.id} ({image.name}) observes point {named[first]}, which is not in {points.path.name}",
            "images and points3D do not belong together: copy both from the same model.",
        )

    ids = np.array([image.id for image in images])
    by_id = np.argsort(ids)
    seen_by = by_id[np.minimum(np.searchsorted(ids[by_id], points.tracks[:, 0]), len(ids) - 1)]
    wrong = (ids[seen_by] != points.tracks[:, 0]) | (points.tracks[:, 1] >= counts[seen_by])
    if not wrong.any():
        observation = (np.cumsum(counts) - counts)[seen_by] + points.tracks[:, 1]
        wrong = named[observation] != points.ids[points.track_of]
    if wrong.any():
        first = int(np.argmax(wrong))
        image, observation = points.tracks[first]
        raise _damaged(
            str(points.path),
            f"the track of point {points.ids[points.track_of[first]]} refers to observation {observation} of image "
            f"{image}, which {'is of another point' if image in ids else 'does not exist'}",
            "images and points3D do not belong together: copy both from the same model.",
        )


def _seen(tables: _Tables) -> Observations:
    """Some of what the images of sound `tables` saw."""
    points = tables.points
    order = np.argsort(points.ids)
    known = points.ids[order]
    with_point = [np.flatnonzero(image.points != NO_POINT) for image in tables.images]
    chosen = some_of_each([len(seen) for seen in with_point])

    def pairs() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for image, seen, some in zip(tables.images, with_point, chosen, strict=True):
            place = order[np.searchsorted(known, image.points[seen[some]])]
            yield image.xy[seen[some]], points.values[place, :3]

    return observations([image.name for image in tables.images], pairs())


def _check_rigs(tables: _Tables, rigs: dict[int, _Rig], frames: dict[int, _Frame]) -> None:
    for number, rig in rigs.items():
        if not rig.sensors:
            raise _damaged(rig.where, f"rig {number} has no sensor")
        for kind, sensor, pose in rig.sensors:
            if kind not in SENSOR_TYPES.values():
                raise _damaged(rig.where, f"rig {number} has a sensor of the unknown type {kind}")
            if kind == CAMERA_SENSOR and sensor not in tables.cameras:
                raise _damaged(rig.where, f"rig {number} refers to camera {sensor}, which does not exist")
            if pose:
                _check_pose(rig.where, pose, f"sensor {sensor} in rig {number}")
    images = {image.id: image for image in tables.images}
    poses = {}  # by image id: the pose of its sensor in the rig, and that of the rig
    for number, frame in frames.items():
        _check_pose(frame.where, frame.pose, f"frame {number}")
        if frame.rig not in rigs:
            raise _damaged(frame.where, f"frame {number} refers to rig {frame.rig}, which does not exist")
        # The first sensor is the rig's origin.
        sensors = rigs[frame.rig].sensors
        placed = {(kind, sensor): pose for kind, sensor, pose in sensors} | {sensors[0][:2]: IDENTITY}
        for kind, sensor, data in frame.data:
            if (kind, sensor) not in placed:
                raise _damaged(frame.where, f"frame {number} refers to sensor {sensor}, which rig {frame.rig} has not")
            if kind != CAMERA_SENSOR:
                continue
            if data not in images:
                raise _damaged(frame.where, f"frame {number} refers to image {data}, which does not exist")
            if data in poses:
                raise _damaged(frame.where, f"frame {number} refers to image {data}, which another frame has")
            if images[data].camera != sensor:
                raise _damaged(frame.where, f"frame {number} has image {data} under camera {sensor}, not its own")
            if not placed[kind, sensor]:
                raise _damaged(rigs[frame.rig].where, f"camera {sensor} of rig {frame.rig} has images, but no pose")
            poses[data] = (placed[kind, sensor], frame.pose)
    for image in tables.images:
        if image.id not in poses:
            raise _damaged(image.where, f"image {image.id} ({image.name}) is in no frame")
    _check_agreement(tables.images, np.array([poses[image.id] for image in tables.images]))


def _check_agreement(images: list[_Image], poses: np.ndarray) -> None:
    """Poses are written twice, by image and by frame; pycolmap takes the frames'. Both must say the same."""
    own = np.array([image.pose for image in images])
    sensor, rig, camera = (Rotation.from_quat(pose[:, [1, 2, 3, 0]]) for pose in (poses[:, 0], poses[:, 1], own))
    turn = ((sensor * rig).inv() * camera).magnitude()
    shift = np.linalg.norm(sensor.apply(poses[:, 1, 4:]) + poses[:, 0, 4:] - own[:, 4:], axis=1)
    off = (turn > 1e-4) | (shift > 1e-4 * np.abs(own[:, 4:]).max())
    if off.any():
        image = images[int(np.argmax(off))]
        raise _damaged(
            image.where,
            f"image {image.id} ({image.name}) has another pose than its frame gives it",
            "Rigs and frames are older or newer than the images. If the images are right, move the former two away.",
        )
