"""Inputs that are sound in form and hostile in what they say, and words, names and places that nobody should give."""

from __future__ import annotations

import os
import random
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

Rng = random.Random

WORDS = (
    *("nan", "inf", "-inf", "-1", "0", "-0.0", "1e300", "1e-300", "1e308", "1e400", "9" * 5000, "", " ", "abc", "1,5"),
    *(
        "0x10",
        "٣",
        "\x1b[31m",
        "a\nb",
        "'",
        '"',
        "--",
        "-",
        "~",
        "%s",
        "../..",
        "/dev/zero",
        "tcp://127.0.0.1:1",
        "\udcff",
    ),
)
NAMES = (
    *(
        b"\xff\xfe.tif",
        b"a" * 251 + b".tif",
        b"a" * 300 + b".tif",
        b"-rf.tif",
        b"a b.tif",
        b"a\nb.tif",
        b"\x1b[31mred.tif",
    ),
    *(
        b"%s%n.tif",
        b"",
        b" ",
        b".tif",
        b"..tif",
        b"x.tif ",
        "é".encode() * 100,
        b"a/b/c.tif",
        b"x.tif/",
        b"x",
        b"x.json",
    ),
    *(
        b"'\"<script>.tif",
        b"\xed\xa0\x80.ply",
        b"x.exe",
        b"x.gpkg",
        b"\xff.ply",
        b"a:b.tif",
        b"*.tif",
        b"http://x/y.tif",
    ),
)


# Models that contradict themselves


def _focal(model: Any, rng: Rng) -> None:
    factor = rng.choice((0.2, 0.5, 0.8, 1.3, 2.0, 17.0))
    for camera in model.cameras.values():
        camera.params = [camera.params[0] * factor, *camera.params[1:]]


def _centre(model: Any, rng: Rng) -> None:
    for camera in model.cameras.values():
        f, x, y, *more = camera.params
        camera.params = [f, x * rng.choice((0.2, 3.0)), y * 2, *more]


def _half_size(model: Any, rng: Rng) -> None:
    for camera in model.cameras.values():
        camera.width, camera.height = camera.width // 2, camera.height // 2


def moved(place: Callable[[np.ndarray, Rng], np.ndarray]) -> Callable[[Any, Rng], None]:
    """Put the frames at `place` of their positions (N, 3), as they are turned."""

    def edit(model: Any, rng: Rng) -> None:
        import pycolmap

        frames = list(model.frames.values())
        turns = [f.rig_from_world.rotation for f in frames]
        centres = np.array([-(t.matrix().T @ f.rig_from_world.translation) for t, f in zip(turns, frames, strict=True)])
        for frame, turn, centre in zip(frames, turns, place(centres, rng), strict=True):
            frame.rig_from_world = pycolmap.Rigid3d(turn, -turn.matrix() @ centre)

    return edit


def _grown(centres: np.ndarray, rng: Rng) -> np.ndarray:
    return centres.mean(0) + (centres - centres.mean(0)) * rng.choice((0.3, 0.6, 1.5, 2.0, 10.0))


def _in_line(centres: np.ndarray, rng: Rng) -> np.ndarray:
    return centres.mean(0) + np.outer(np.arange(len(centres)), [0.3, 0.1, 0.02])


def _shuffled(centres: np.ndarray, rng: Rng) -> np.ndarray:
    return centres[rng.sample(range(len(centres)), len(centres))]


def _far(centres: np.ndarray, rng: Rng) -> np.ndarray:
    out = centres.copy()
    out[rng.randrange(len(out))] = rng.choice((1e9, 1e300, float("nan"), 0.0))
    return out


def placed(model: Any, place: Callable[[np.ndarray], np.ndarray]) -> None:
    """Put the points at `place` of their positions (N, 3)."""
    points = list(model.points3D.values())
    for point, xyz in zip(points, place(np.array([p.xyz for p in points])), strict=True):
        point.xyz = xyz


def _points(place: Callable[[np.ndarray, Rng], np.ndarray]) -> Callable[[Any, Rng], None]:
    return lambda model, rng: placed(model, lambda xyz: place(xyz, rng))


def _turned(model: Any, rng: Rng) -> None:
    """All rotations the other way round: world from camera, where camera from world belongs."""
    import pycolmap

    for frame in model.frames.values():
        pose = frame.rig_from_world
        frame.rig_from_world = pycolmap.Rigid3d(pose.rotation.inverse(), pose.translation)


def _observations(model: Any, rng: Rng) -> None:
    for image in model.images.values():
        for point in image.points2D:
            point.xy = (rng.uniform(0, 640), rng.uniform(0, 480))


EDITS: dict[str, Callable[[Any, Rng], None]] = {
    "focal length": _focal,
    "principal point": _centre,
    "image size": _half_size,
    "cameras grown": moved(_grown),
    "cameras in a line": moved(_in_line),
    "cameras in one place": moved(lambda c, rng: np.repeat(c.mean(0)[None], len(c), 0)),
    "cameras shuffled": moved(_shuffled),
    "a camera far away": moved(_far),
    "rotations inverted": _turned,
    "points grown": _points(lambda p, rng: p * rng.choice((0.5, 0.8, 1.3, 3.0))),
    "points shuffled": _points(_shuffled),
    "points flat in one place": _points(lambda p, rng: np.repeat(p[:1], len(p), 0)),
    "observations anywhere": _observations,
}


# Pictures


def png(width: int, height: int, bits: int = 8) -> bytes:
    """A black PNG of one channel, whatever its size, in little memory."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer, row = zlib.compressobj(1), bytes(1 + (width * bits + 7) // 8)
    rows = max(1, (1 << 20) // len(row))
    packed = [packer.compress(row * min(rows, height - y)) for y in range(0, height, rows)]
    data = b"".join([*packed, packer.flush()])
    header = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def vrt(source: str, more: str = "", size: int = 400) -> str:
    """A VRT of one band that takes its pixels from `source`."""
    return (
        f'<VRTDataset rasterXSize="{size}" rasterYSize="{size}"><GeoTransform>0,0.1,0,40,0,-0.1</GeoTransform>'
        f'<VRTRasterBand dataType="Byte" band="1"{more}><SimpleSource><SourceFilename relativeToVRT="1">{source}'
        f'</SourceFilename><SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="{size}" ySize="{size}"/>'
        f'<DstRect xOff="0" yOff="0" xSize="{size}" ySize="{size}"/></SimpleSource></VRTRasterBand></VRTDataset>'
    )


PYTHON_BAND = ' subClass="VRTDerivedRasterBand"><PixelFunctionLanguage>Python</PixelFunctionLanguage'
VRTS: dict[str, str] = {
    "itself": vrt("odd.vrt"),
    "a device": vrt("/dev/zero"),
    "a pipe": vrt("pipe.tif"),
    "a server": vrt("/vsicurl/http://10.255.255.1/x.tif"),
    "a service": '<GDAL_WMS><Service name="TMS"><ServerUrl>http://10.255.255.1/${z}/${x}/${y}.png</ServerUrl></Service>'
    "<DataWindow><UpperLeftX>-20037508</UpperLeftX><UpperLeftY>20037508</UpperLeftY><LowerRightX>20037508</LowerRightX>"
    "<LowerRightY>-20037508</LowerRightY><TileLevel>18</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>"
    "</DataWindow><Projection>EPSG:3857</Projection><BandsCount>3</BandsCount></GDAL_WMS>",
    "code": vrt("ortho.tif", PYTHON_BAND),
    "nothing": vrt("missing.tif"),
    "a large one": vrt("ortho.tif", size=2_000_000_000),
}


def odd_vrt(folder: Path, rng: Rng) -> str:
    """Write one of `VRTS`; returns its name."""
    os.mkfifo(folder / "pipe.tif")
    (folder / "odd.vrt").write_text(VRTS[rng.choice(list(VRTS))])
    return "odd.vrt"


# Places


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


def _holes(path: Path) -> None:
    """3 GiB of nothing."""
    with path.open("wb") as file:
        file.truncate(3 * 2**30)


def _crowd(path: Path) -> None:
    path.mkdir()
    for k in range(300):
        (path / f"{k}.tif").write_bytes(b"")


PLACES: dict[str, Callable[[Path], object]] = {
    "folder": Path.mkdir,
    "full folder": _crowd,
    "pipe": _pipe,
    "zeros without end": lambda path: path.symlink_to("/dev/zero"),
    "null": lambda path: path.symlink_to("/dev/null"),
    "terminal": lambda path: path.symlink_to("/dev/tty"),
    "memory": lambda path: path.symlink_to("/proc/self/mem"),
    "link to itself": _loop,
    "link to nothing": lambda path: path.symlink_to("missing"),
    "link to a folder": lambda path: path.symlink_to("/proc"),
    "nothing": lambda path: None,
    "empty": lambda path: path.write_bytes(b""),
    "one byte": lambda path: path.write_bytes(b"\n"),
    "holes": _holes,
}
ENDINGS = (
    ".tif",
    ".json",
    ".txt",
    ".geojson",
    ".gpkg",
    ".ply",
    ".glb",
    ".onnx",
    ".png",
    ".vrt",
    ".nvm",
    ".csv",
    ".obj",
    "",
)


def odd_place(folder: Path, rng: Rng) -> str:
    """Make something in `folder` that is no plain file; returns its path, relative to the folder's parent."""
    path = folder / f"odd{rng.choice(ENDINGS)}"
    PLACES[rng.choice(list(PLACES))](path)
    return f"{folder.name}/{path.name}"


# The cache


def change_rows(path: Path, what: int) -> None:
    """Change the boxes that a cache keeps, in good SQL: 0 larger, 1 not numbers, 2 cut off, 3 lost."""
    with closing(sqlite3.connect(path)) as file:
        try:
            rows = file.execute("SELECT tile, fine FROM looks").fetchall()
        except sqlite3.Error:
            return
        for tile, fine in rows:
            values = np.frombuffer(fine, "<f8").copy()
            values = values * 1.3 if what == 0 else values * np.nan
            changed = fine[: len(fine) // 2 + 3] if what == 2 else b"" if what == 3 else values.tobytes()
            file.execute("UPDATE looks SET fine = ? WHERE tile = ?", (changed, tile))
        file.commit()
