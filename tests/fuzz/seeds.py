"""Every input that once failed, by name: how it is made, the command that faced it, and how it must end.

The suite runs all of them (`test_seeds.py`), and the campaign draws from them. Numbers in the comments are those of the
first campaign's list of findings.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from . import damage, hostile
from .bench import Bench, sim3
from .runner import Attempt
from .truth import CARD

Seed = Callable[[Bench], Attempt]
SEEDS: dict[str, Seed] = {}
BOXES = ("--detections", "in/boxes.json", "--fleet", "DE")
FIX = ("fix", "in/ortho.tif", *BOXES, "--override")
PLANS = ("in", *BOXES, "--mode", "planar")
ESTIMATE = ("estimate", "in/ortho.tif", *BOXES, "--json")


def seed(name: str) -> Callable[[Seed], Seed]:
    def keep(make: Seed) -> Seed:
        SEEDS[name] = make
        return make

    return keep


def ends(argv: tuple, *codes: int, **more: Any) -> Attempt:
    """An attempt that must end with one of `codes`."""
    return Attempt(tuple(argv), frozenset(codes), **more)


def edited(path: Path, edit: Callable[[Any], Any]) -> None:
    """Change the JSON in `path`: `edit` changes its document in place, or returns another."""
    document = json.loads(path.read_text())
    other = edit(document)
    path.write_text(json.dumps(document if other is None else other))


# Wrong answers without a word


@seed("wrong answer: boxes of the picture before it was resized")
def _boxes_of_another_size(bench: Bench) -> Attempt:
    inside = bench.take("ortho", "ortho.tif", "boxes.json")
    edited(inside / "boxes.json", lambda text: text.update(picture_sizes={"ortho.tif": [200, 200]}))
    return ends(ESTIMATE, 5)


@seed("wrong answer: a dense cloud of another run")
def _foreign_cloud(bench: Bench) -> Attempt:
    dense = bench.take("geometry") / "dense"
    head, mark, rows = (dense / "fused.ply").read_bytes().partition(b"end_header\n")
    (dense / "fused.ply").write_bytes(head + mark + (7 * np.frombuffer(rows, "<f4") + 30).astype("<f4").tobytes())
    return ends(("apply", "in/sim3.json", "in/dense", "--out", "out"), 5)


@seed("wrong answer: a layout by an edited pixel size")
def _edited_pixel_size(bench: Bench) -> Attempt:
    inside = bench.take("settings")
    edited(inside / "scaled.tif.json", lambda text: text.update(scale=0.23, interval90=[0.22, 0.24]))
    ask = ("--lot", "in/lot.geojson", "--facility", "tennis", "--out", "out")
    return ends(("layout", "in/scaled.tif", *ask), 5)


# 1, 2, 3: outputs on inputs


def _onto(name: str, kind: str, *argv: str, twice: bool = False) -> None:
    @seed(f"output on input: {name}")
    def make(bench: Bench) -> Attempt:
        inside = bench.take(kind)
        if twice:
            shutil.copytree(inside / "sparse/0", inside / "sparse/1")
        (inside / "foreign").mkdir()
        (inside / "foreign/thesis.txt").write_text("years of work")
        if kind == "opensfm":
            sim3(inside)
        return ends(argv, 2)


_onto("model into its workspace", "colmap-bin", "fix", "in/sparse/0", *PLANS[1:], "--out", "in", "--overwrite")
_onto("workspace onto its model", "colmap-bin", "fix", *PLANS, "--out", "in/sparse", "--overwrite")
_onto("several models onto themselves", "colmap-bin", "fix", *PLANS, "--out", "in", "--overwrite", twice=True)
_onto(
    "frames", "colmap-bin", "fix", "in/sparse", *PLANS[1:], "--images", "in/images", "--out", "in/images", "--overwrite"
)
_onto("boxes", "colmap-bin", "fix", *PLANS, "--out", "in/boxes.json", "--overwrite")
_onto("a foreign folder", "colmap-bin", "fix", *PLANS, "--out", "in/foreign", "--overwrite")
_onto("apply", "geometry", "apply", "in/sim3.json", "in/ascii.ply", "--out", "in", "--overwrite")
_onto("apply to a dense workspace", "geometry", "apply", "in/sim3.json", "in/dense", "--out", "in/dense", "--overwrite")
_onto("layout", "settings", "layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--facility", "tennis",
      "--out", "in", "--overwrite")  # fmt: skip
_onto("crop", "photos", "crop", "in/flight/a.jpg", "--detections", "in/boxes.json", "--fleet", "in/cars.json",
      "--satellite", "in/satellite.tif", "--out", "in/flight", "--overwrite")  # fmt: skip
_onto("orthophoto", "ortho", "fix", "in/ortho.tif", *BOXES, "--override", "--out", "in/ortho.tif", "--overwrite")
_onto("save detections on a model", "opensfm", "estimate", *PLANS, "--save-detections", "in/reconstruction.json")
_onto("save detections on images.txt", "colmap-txt", "estimate", *PLANS, "--save-detections", "in/sparse/0/images.txt")
_onto("evaluate", "csv", "evaluate", "in/photos.csv", "--detections", "in/detections.json", "--fleet", "DE",
      "--out", "in/photos.csv", "--overwrite")  # fmt: skip
_onto("photo", "photos", "photo", "in/flight", "--detections", "in/boxes.json", "--fleet", "in/cars.json",
      "--out", "in/boxes.json", "--overwrite")  # fmt: skip
_onto("report", "settings", "report", "in/report.json", "--out", "in/report.json", "--overwrite")


@seed("output on input: the world file of a.tif")
def _world_file(bench: Bench) -> Attempt:
    inside = bench.take("ortho", "ortho.tif", "labels.txt", "ortho.pgw")
    (inside / "ortho.tif").rename(inside / "a.tif")
    (inside / "ortho.pgw").rename(inside / "a.tfw")
    argv = (
        "fix",
        "in/a.tif",
        "--detections",
        "in/labels.txt",
        "--fleet",
        "DE",
        "--override",
        "--force",
        "--out",
        "in/a.tiff",
    )
    return ends((*argv, "--overwrite"), 0, 2, beside=True)


# 4: models that contradict themselves


def _model(name: str, edit: Callable[[Any], object], kind: str = "colmap-bin") -> None:
    @seed(f"model: {name}")
    def make(bench: Bench) -> Attempt:
        import pycolmap

        folder = bench.take(kind) / "sparse/0"
        model = pycolmap.Reconstruction(str(folder))
        edit(model)
        for old in folder.iterdir():
            old.unlink()
        (model.write_binary if kind.endswith("bin") else model.write_text)(str(folder))
        return ends(("estimate", *PLANS), 5)


def _focal(factor: float) -> Callable[[Any], None]:
    def edit(model: Any) -> None:
        for camera in model.cameras.values():
            camera.params = [camera.params[0] * factor, *camera.params[1:]]

    return edit


def _moved(place: Callable[[np.ndarray], np.ndarray]) -> Callable[[Any], None]:
    return lambda model: hostile.moved(lambda centres, rng: place(centres))(model, None)


for _kind in ("colmap-bin", "rig-txt"):
    _model(f"focal length 17 times too long ({_kind})", _focal(17.1), _kind)
    _model(f"focal length twice too long ({_kind})", _focal(2.0), _kind)
    _model(f"cameras twice as far apart ({_kind})", _moved(lambda c: c.mean(0) + 2 * (c - c.mean(0))), _kind)
    _model(
        f"cameras in a line ({_kind})",
        _moved(lambda c: c.mean(0) + np.outer(np.arange(len(c)), [0.3, 0.1, 0.02])),
        _kind,
    )
    _model(f"cameras in one place ({_kind})", _moved(lambda c: np.repeat(c.mean(0)[None], len(c), 0)), _kind)
    _model(f"points grown by 1.3 ({_kind})", lambda m: hostile.placed(m, lambda xyz: xyz * 1.3), _kind)


@seed("model: one byte of cameras.bin")
def _one_byte(bench: Bench) -> Attempt:
    path = bench.take("colmap-bin") / "sparse/0/cameras.bin"
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<d", 400.0))
    data[at + 6] = 0xB9  # of the exponent: 400 becomes 6400
    path.write_bytes(data)
    return ends(("estimate", *PLANS), 5)


@seed("model: points of another model")
def _points_of_another(bench: Bench) -> Attempt:
    folder = bench.take("colmap-bin") / "sparse/0"
    shutil.copy(bench.corpus / "other-bin/sparse/points3D.bin", folder)
    return ends(("estimate", *PLANS), 5)


@seed("model: cameras of another model")
def _cameras_of_another(bench: Bench) -> Attempt:
    folder = bench.take("colmap-bin") / "sparse/0"
    shutil.copy(bench.corpus / "other-bin/sparse/cameras.bin", folder)
    return ends(("estimate", *PLANS), 5)


# 5: rasters


def tiff_tag(data: bytes, tag: int) -> tuple[int, int, int]:
    """Of `tag` in the first directory of a little-endian TIFF: where its entry is, its count, where its values are."""
    at = struct.unpack_from("<I", data, 4)[0]
    for k in range(struct.unpack_from("<H", data, at)[0]):
        entry = at + 2 + 12 * k
        found, kind, count = struct.unpack_from("<HHI", data, entry)
        if found == tag:
            size = {3: 2, 4: 4, 16: 8}[kind] * count
            return entry, count, entry + 8 if size <= 4 else struct.unpack_from("<I", data, entry + 8)[0]
    raise ValueError(f"no tag {tag}")


def _offsets(name: str, file: str, tag: int, value: int, command: str) -> None:
    @seed(f"raster: {name}, {command}")
    def make(bench: Bench) -> Attempt:
        inside = bench.take("ortho", file, "labels.txt")
        data = bytearray((inside / file).read_bytes())
        _, count, at = tiff_tag(bytes(data), tag)
        for k in range(count // 2, count):
            struct.pack_into("<I", data, at + 4 * k, value)
        (inside / file).write_bytes(data)
        ask = (f"in/{file}", "--detections", "in/labels.txt", "--fleet", "DE")
        if command == "fix":
            return ends(("fix", *ask, "--override", "--force", "--out", "out.tif"), 5)
        return ends(("estimate", *ask), 0, 5)


for _command in ("estimate", "fix"):
    _offsets("strips far behind the end", "strips.tif", 273, 0x7FFFFFF0, _command)
    _offsets("strips at 0xffffffff", "strips.tif", 273, 0xFFFFFFFF, _command)
    _offsets("tiles far behind the end", "ortho.tif", 324, 0x7FFFFFF0, _command)
    _offsets("strips at 0", "strips.tif", 273, 0, _command)
    _offsets("strips at odd places", "strips.tif", 273, 13, _command)


# 6: kills


def _kill(number: signal.Signals, delay: float, model: bool, writing: bool) -> None:
    @seed(
        f"kill: {number.name} {delay} s after {'writing' if writing else 'it'} began, {'model' if model else 'ortho'}"
    )
    def make(bench: Bench) -> Attempt:
        if model:
            bench.take("colmap-bin")
            return Attempt(("fix", *PLANS, "--out", "out"), kill=(int(number), delay), when_writing=writing)
        bench.take("ortho", "ortho.tif", "boxes.json")
        return Attempt(("fix", *FIX[1:], "--out", "out.tif"), kill=(int(number), delay), when_writing=writing)


for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL):
    for _delay in (0.25, 0.8, 1.4):
        _kill(_number, _delay, model=True, writing=False)
    for _delay in (0.0, 0.02, 0.1):
        _kill(_number, _delay, model=True, writing=True)
        _kill(_number, _delay, model=False, writing=True)


# 7: hangs and floods


def _boxes(name: str, edit: Callable[[Any], Any], *codes: int) -> None:
    @seed(f"boxes: {name}")
    def make(bench: Bench) -> Attempt:
        inside = bench.take("ortho", "ortho.tif", "boxes.json")
        edited(inside / "boxes.json", edit)
        return ends(ESTIMATE, *(codes or (5,)))


def _every(change: Callable[[dict], object]) -> Callable[[Any], None]:
    """Change each box."""

    def edit(document: Any) -> None:
        for rows in document["pictures"].values():
            for row in rows:
                change(row)

    return edit


def _rows(make: Callable[[list], list]) -> Callable[[Any], None]:
    def edit(document: Any) -> None:
        for name, rows in document["pictures"].items():
            document["pictures"][name] = make(rows)

    return edit


_boxes("a margin known to 9.2e18 px", lambda d: d["ruler"].update(margin_sd=9.2e18))
_boxes("margins known to 9.2e18 px", lambda d: d["ruler"].update(margin_sd=[9.2e18, 9.2e18]))


@seed("PLY: 10^12 of something before the vertices")
def _elements(bench: Bench) -> Attempt:
    inside = bench.take("geometry", "sim3.json", "ascii.ply")
    text = (inside / "ascii.ply").read_text()
    more = "element thing 1000000000000\nproperty float a\nelement vertex"
    (inside / "ascii.ply").write_text(text.replace("element vertex", more, 1))
    return ends(("apply", "in/sim3.json", "in/ascii.ply", "--out", "out"), 5)


@seed("PLY: 10^8 vertices promised")
def _vertices(bench: Bench) -> Attempt:
    path = bench.take("nerfstudio") / "sparse_pc.ply"
    head, _, body = path.read_text().partition("element vertex ")
    path.write_text(f"{head}element vertex 100000000{body[len(body.split()[0]) :]}")
    return ends(("estimate", *PLANS), 5)


@seed("PLY: a property twice")
def _twice(bench: Bench) -> Attempt:
    inside = bench.take("geometry", "sim3.json", "ascii.ply")
    text = (inside / "ascii.ply").read_text()
    (inside / "ascii.ply").write_text(text.replace("property float y", "property float x"))
    return ends(("apply", "in/sim3.json", "in/ascii.ply", "--out", "out"), 5)


@seed("pipe as boxes")
def _pipe(bench: Bench) -> Attempt:
    os.mkfifo(bench.take("ortho", "ortho.tif") / "boxes.json")
    return ends(ESTIMATE, 5)


@seed("pipe as photo")
def _pipe_as_photo(bench: Bench) -> Attempt:
    inside = bench.take("ortho", "boxes.json")
    os.mkfifo(inside / "odd.tif")
    return ends(("photo", "in/odd.tif", "--focal-px", "900", *BOXES), 5)


@seed("memory: a table of 3 GiB in one line")
def _long_table(bench: Bench) -> Attempt:
    with (bench.take("ortho", "boxes.json") / "odd.csv").open("wb") as file:
        file.truncate(3 * 2**30)
    return ends(("evaluate", "in/odd.csv", *BOXES), 5)


@seed("memory: photos in a folder without end")
def _all_there_is(bench: Bench) -> Attempt:
    (bench.take("ortho", "boxes.json") / "odd.png").symlink_to("/proc")
    return ends(("evaluate", "in/odd.png", *BOXES), 5)


@seed("raster: a name that is no UTF-8, and no picture")
def _no_name(bench: Bench) -> Attempt:
    Path(os.fsdecode(os.fsencode(bench.take("ortho", "boxes.json")) + b"/\xed\xa0\x80.ply")).write_text("ply\n")
    return ends(("estimate", b"in/\xed\xa0\x80.ply", "--fleet", "DE", "--zoom", "1"), 5)


@seed("zeros without end as boxes")
def _zeros(bench: Bench) -> Attempt:
    (bench.take("ortho", "ortho.tif") / "boxes.json").symlink_to("/dev/zero")
    return ends(ESTIMATE, 5)


@seed("raster: a control point that is no number")
def _no_number(bench: Bench) -> Attempt:
    bench.take("strange", "control.tif")
    bench.take("ortho", "labels.txt")
    return ends(("estimate", "in/control.tif", "--detections", "in/labels.txt", "--fleet", "DE"), 0, 3, 4, 5)


for _name in hostile.VRTS:

    def _vrt(bench: Bench, name: str = _name) -> Attempt:
        inside = bench.take("ortho", "ortho.tif")
        os.mkfifo(inside / "pipe.tif")
        (inside / "odd.vrt").write_text(hostile.VRTS[name])
        return ends(("estimate", "in/odd.vrt", "--fleet", "DE", "--zoom", "1"), 3 if name == "code" else 5, 5)

    SEEDS[f"VRT of {_name}"] = _vrt


@seed("VRT of a large one, and boxes from a file")
def _large_with_boxes(bench: Bench) -> Attempt:
    """No picture has 2e9 px a side, though with boxes from a file nothing of it need be read."""
    inside = bench.take("ortho", "ortho.tif", "labels.txt")
    (inside / "odd.vrt").write_text(hostile.VRTS["a large one"])
    return ends(("estimate", "in/odd.vrt", "--detections", "in/labels.txt", "--fleet", "DE", "--json"), 5)


@seed("VRT with a word that is no text")
def _no_text(bench: Bench) -> Attempt:
    """GDAL quotes it."""
    inside = bench.take("ortho", "ortho.tif", "labels.txt")
    band = b'<VRTRasterBand dataType="\xbe\xff" band="1"/>'
    (inside / "odd.vrt").write_bytes(b'<VRTDataset rasterXSize="9" rasterYSize="9">' + band + b"</VRTDataset>")
    return ends(("estimate", "in/odd.vrt", "--detections", "in/labels.txt", "--fleet", "DE", "--json"), 5)


# 8, 9: memory


@seed("memory: boxes of 50,000 parked vehicles")
def _parked(bench: Bench) -> Attempt:
    inside = bench.take("strange", "tiled20000.tif")
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(250) * 25 + 50.0, np.arange(200) * 95 + 50.0)
    size = rng.normal([45, 18], [3, 0.8], (x.size, 2))
    rows = [
        {"cx": a, "cy": b, "length": c, "width": d, "angle": 1.5708, "score": 0.9}
        for (a, b, (c, d)) in zip(x.ravel().tolist(), y.ravel().tolist(), size.tolist(), strict=True)
    ]
    (inside / "boxes.json").write_text(json.dumps({"tiled20000.tif": rows}))
    return ends(("estimate", "in/tiled20000.tif", *BOXES), 0)


@seed("memory: frames of 108 megapixels")
def _frames(bench: Bench) -> Attempt:
    """The model, its frames and boxes 18.75 times as large."""
    import pycolmap

    inside, grow = bench.take("colmap-bin"), 18.75
    model = pycolmap.Reconstruction(str(inside / "sparse/0"))
    for camera in model.cameras.values():
        camera.rescale(12000, 9000)
    for image in model.images.values():
        for point in image.points2D:
            point.xy = point.xy * grow
    model.write_binary(str(inside / "sparse/0"))

    def larger(document: Any) -> None:
        for pictures in (document["pictures"], document.get("planar", {}).get("pictures", {})):
            for rows in pictures.values():
                for row in rows:
                    row.update({key: row[key] * grow for key in ("cx", "cy", "length", "width")})

    edited(inside / "boxes.json", larger)
    for path in (inside / "images").iterdir():
        path.unlink()
        path.hardlink_to(bench.corpus / "large/frame.jpg")
    return ends(("fix", "in", *BOXES, "--mode", "oblique", "--out", "out"), 0)


@seed("memory: a TIFF of 400 megapixels as a frame of 640 x 480")
def _wrong_frame(bench: Bench) -> Attempt:
    inside = bench.take("colmap-bin")
    shutil.copy(bench.corpus / "strange/strip20000.tif", inside / "images/00.png")
    return ends(("fix", *PLANS, "--out", "out"), 0, 5)


def _look(name: str) -> None:
    @seed(f"memory and time: looking at {name}")
    def make(bench: Bench) -> Attempt:
        bench.take("strange", name)
        argv = ("estimate", f"in/{name}", "--fleet", "DE", "--zoom", "0.1")
        # Without vehicles, anchors are looked for at any scale, which takes most of the time: once is enough.
        argv += () if name == "strip20000.tif" else ("--anchors", "none")
        return ends(argv, 3, 5, memory=1.5)


for _name in ("grey20000.png", "bits20000.png", "strip20000.tif", "tiled20000.tif"):
    _look(_name)


def _onnx(name: str, make_network: Callable[[Any, Path], None], *codes: int) -> None:
    @seed(f"ONNX: {name}")
    def make(bench: Bench) -> Attempt:
        from . import networks

        inside = bench.take("networks", "ortho.tif")
        make_network(networks, inside / "net.onnx")
        argv = ("estimate", "in/ortho.tif", "--detector", "in/net.onnx", "--fleet", "DE", "--zoom", "1")
        return ends(argv, *(codes or (5,)))


_onnx("an endless loop", lambda n, path: n.endless(path))
_onnx("20,000 boxes", lambda n, path: n.many_boxes(path, 20_000), 3, 5)
_onnx("100,000 boxes", lambda n, path: n.many_boxes(path, 100_000), 3, 5)
_onnx("6e8 values", lambda n, path: n.many_boxes(path, 75_000_000))
_onnx("an output of strings", lambda n, path: n.text_output(path))


@seed("memory and time: 100,000 boxes anywhere")
def _anywhere(bench: Bench) -> Attempt:
    inside = bench.take("strange", "tiled20000.tif")
    rng = np.random.default_rng(0)
    low, high = [0, 0, 20, 8, -1.5, 0], [20_000, 20_000, 60, 25, 1.5, 1]
    keys = ("cx", "cy", "length", "width", "angle", "score")
    rows = [dict(zip(keys, row, strict=True)) for row in rng.uniform(low, high, (100_000, 6)).tolist()]
    (inside / "boxes.json").write_text(json.dumps({"tiled20000.tif": rows}))
    return ends(("estimate", "in/tiled20000.tif", *BOXES), 0, 3, 4)


# 10, 11: nonsense


_boxes("negative zoom", lambda d: d.update(zoom=-1))
_boxes("zoom of no size", lambda d: d.update(zoom=0))
_boxes("negative noise", lambda d: d["ruler"].update(noise=[-2, -1]))
_boxes("scores that are not numbers", _every(lambda row: row.update(score=float("nan"))))
_boxes("boxes a hundred times the picture", _every(lambda row: row.update(length=44_000, width=18_000)))
_boxes("lengths and widths of nothing", _every(lambda row: row.update(length=50, width=1)), 3)
_boxes("five copies of one box", _rows(lambda rows: rows[:1] * 5), 3, 5)
_boxes("thirty copies of one box", _rows(lambda rows: rows[:1] * 30), 3, 5)
_boxes("4,800 copies of one box", _rows(lambda rows: rows[:1] * 4800), 3, 5)
_boxes("24,000 copies of one box", _rows(lambda rows: rows[:1] * 24_000), 3, 5)


@seed("frames: a box from above that is one pixel wide")
def _thin_box(bench: Bench) -> Attempt:
    inside = bench.take("colmap-bin")
    edited(inside / "boxes.json", lambda d: d["planar"]["pictures"]["ground/10.png"][3].update(width=1))
    return ends(("fix", *PLANS, "--out", "out"), 0)


@seed("lens: a camera model that there is not")
def _no_such_lens(bench: Bench) -> Attempt:
    inside = bench.take("photos", "flight/a.jpg", "boxes.json", "cars.json", "lens.txt")
    path = inside / "lens.txt"
    path.write_text(path.read_text().replace("OPENCV", "OPENC"))
    given = ("--detections", "in/boxes.json", "--fleet", "in/cars.json", "--lens", "in/lens.txt")
    return ends(("photo", "in/flight/a.jpg", *given), 5)


@seed("report: an interval that ends beside nought")
def _endless_interval(bench: Bench) -> Attempt:
    inside = bench.take("settings", "scaled.tif", "scaled.tif.json", "lot.geojson")
    edited(inside / "scaled.tif.json", lambda d: d["interval90"].__setitem__(0, 1e-320))
    return ends(("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--facility", "tennis", "--out", "out"), 0)


@seed("option: a count of 5,000 digits")
def _endless_count(bench: Bench) -> Attempt:
    bench.take("settings", "scaled.tif", "lot.geojson")
    many = f"parking-DE:{'9' * 5000}"
    return ends(("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--out", "out", "--facility", many), 2)


@seed("geometry: a link in a circle")
def _circle(bench: Bench) -> Attempt:
    inside = bench.take("geometry", "sim3.json")
    (inside / "odd.png").symlink_to("odd.png")
    return ends(("apply", "in/sim3.json", "in/odd.png", "--out", "out"), 5)


@seed("frames: a PNG whose pixels are damaged")
def _damaged_frame(bench: Bench) -> Attempt:
    path = bench.take("colmap-bin") / "images/00.png"
    data = bytearray(path.read_bytes())
    data[data.index(b"IDAT") + 200] ^= 0x55
    path.write_bytes(data)
    return ends(("fix", *PLANS, "--out", "out"), 6)


def _asked(name: str, *more: str | bytes, codes: tuple[int, ...] = (2,), command: tuple = ESTIMATE) -> None:
    @seed(f"option: {name}")
    def make(bench: Bench) -> Attempt:
        bench.take("ortho", "ortho.tif", "boxes.json")
        return ends((*command, *more), *codes)


_asked("a distance known to 1e300 m", "--known-distance", "10,10 300,300 41 1e300")
_asked("a distance of nan", "--known-distance", "10,10 300,300 nan")
_asked("no name of the output", "--out", "", "--overwrite", command=FIX)
_asked(
    "a point at 1e12",
    "--known-distance",
    "1000000000000,10 10,10 41",
    "--out",
    "o.tif",
    command=FIX,
    codes=(0, 2, 3, 4),
)
_asked("an output whose name is no UTF-8", "--out", b"\xff\xfe.tif", command=FIX, codes=(0, 2, 6))
_asked("an output whose name is too long", "--out", "a" * 300 + ".tif", command=FIX, codes=(2, 6))
_asked("saved under a name that is no UTF-8", "--save-detections", b"\xff\xfe.json", codes=(0, 2, 6))
_asked("saved under a name that is too long", "--save-detections", "a" * 300 + ".json", codes=(2, 6))


@seed("option: an input whose name is no UTF-8")
def _no_utf8(bench: Bench) -> Attempt:
    inside = bench.take("ortho", "ortho.tif")
    os.rename(inside / "ortho.tif", os.fsencode(inside) + b"/\xff\xfe.tif")
    return ends(("fix", b"in/\xff\xfe.tif", "--fleet", "DE", "--zoom", "1", "--override", "--out", "out.tif"), 0, 5)


@seed("option: an input whose name is too long")
def _too_long(bench: Bench) -> Attempt:
    bench.take("geometry", "sim3.json")
    return ends(("apply", "in/sim3.json", "in/" + "a" * 300 + ".ply", "--out", "out"), 5)


# 12: the cache


def _cache(name: str, harm: Callable[[Path], object]) -> None:
    @seed(f"cache: {name}")
    def make(bench: Bench) -> Attempt:
        bench.take("cache", "ortho.tif")
        shutil.copytree(bench.corpus / "cache/cache", bench.folder / "cache")
        for path in sorted((bench.folder / "cache").rglob("*.sqlite")):
            harm(path)
        argv = ("estimate", "in/ortho.tif", "--fleet", "DE", "--zoom", "1", "--json")
        return ends(argv, 0, truth=bench.answer("cache"), tolerance=1e-6)


def _patched(at: int, value: bytes) -> Callable[[Path], object]:
    def harm(path: Path) -> None:
        data = path.read_bytes()
        path.write_bytes(data[:at] + value + data[at + len(value) :])

    return harm


def _renamed(name: bytes, other: bytes) -> Callable[[Path], object]:
    def harm(path: Path) -> None:
        data = path.read_bytes()
        assert name in data and len(name) == len(other)
        path.write_bytes(data.replace(name, other))

    return harm


# SQLite's messages quote names that are no text.
_cache("a table's name that is no text", _renamed(b"tablelookslooks", b"tablelo\xbeksl\xbeoks"))
_cache("an index's name that is no text", _renamed(b"sqlite_autoindex_looks", b"sqlite_autoindex_l\xbe\xffks"))
_cache("cut in half", lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]))
_cache(
    "zeros after the header", lambda path: path.write_bytes(path.read_bytes()[:200].ljust(path.stat().st_size, b"\0"))
)
_cache("another page size", _patched(16, b"\x02\x00"))
_cache("another text", lambda path: path.write_bytes(b"not a database" * 400))
_cache("bits of the last page", lambda path: path.write_bytes(path.read_bytes()[:-800] + b"\x55" * 800))
_cache("a folder", lambda path: (path.unlink(), path.mkdir()))
for _k, _what in enumerate(("boxes larger", "boxes that are no numbers", "boxes cut off", "boxes lost")):
    _cache(_what, lambda path, k=_k: hostile.change_rows(path, k))


# 13: two at once


def _twins(name: str, kind: str, *argv: str) -> None:
    @seed(f"two at once: {name}")
    def make(bench: Bench) -> Attempt:
        bench.take(kind)
        return Attempt(argv, frozenset((0, 2, 6)), twins=2)


_twins("orthophoto", "ortho", *FIX, "--out", "out.tif")
_twins("model", "colmap-bin", "fix", *PLANS, "--out", "out")
_twins("apply", "geometry", "apply", "in/sim3.json", "in/splat.ply", "--out", "out")


# Exit 1 where 5 is due


READERS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "boxes.json": ("ortho", ("ortho.tif",), ESTIMATE),
    "boxes.coco.json": ("ortho", ("ortho.tif",), ("estimate", "in/ortho.tif", "--detections", "in/boxes.coco.json")),
    "boxes.geojson": ("ortho", ("ortho.tif",), ("estimate", "in/ortho.tif", "--detections", "in/boxes.geojson")),
    "fleet.json": ("settings", ("ortho.tif", "boxes.json"), (*ESTIMATE[:4], "--fleet", "in/fleet.json")),
    "calibration.json": (
        "settings",
        ("ortho.tif", "boxes.json"),
        (*ESTIMATE[:4], "--calibration", "in/calibration.json"),
    ),
    "lens.json": (
        "photos",
        ("flight/a.jpg", "boxes.json"),
        ("photo", "in/flight/a.jpg", "--detections", "in/boxes.json", "--lens", "in/lens.json"),
    ),
    "sim3.json": ("geometry", ("ascii.ply",), ("apply", "in/sim3.json", "in/ascii.ply", "--out", "out")),
    "scene.gltf": ("geometry", ("sim3.json",), ("apply", "in/sim3.json", "in/scene.gltf", "--out", "out")),
    "catalogue.json": (
        "settings",
        ("scaled.tif", "lot.geojson"),
        (
            "layout",
            "in/scaled.tif",
            "--lot",
            "in/lot.geojson",
            "--facility",
            "boules",
            "--catalogue",
            "in/catalogue.json",
            "--out",
            "out",
        ),  # fmt: skip
    ),
    "lot.geojson": (
        "settings",
        ("scaled.tif",),
        ("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--facility", "tennis", "--out", "out"),
    ),
    "report.json": ("settings", (), ("report", "in/report.json", "--out", "out.html")),
    "reconstruction.json": ("opensfm", ("boxes.json",), ("estimate", "in/reconstruction.json", *BOXES)),
    "transforms.json": ("nerfstudio", ("boxes.json", "sparse_pc.ply"), ("estimate", "in/transforms.json", *BOXES)),
}


def _reader(name: str, what: str, harm: Callable[[Path], object], *codes: int) -> None:
    """The file `name` of the corpus, harmed, before the command that reads it."""
    kind, others, argv = READERS[name]

    @seed(f"{name}: {what}")
    def make(bench: Bench) -> Attempt:
        inside = bench.take(kind, name, *others)
        harm(inside / name)
        return ends(argv, *(codes or (5,)))


for _name in READERS:
    for _bracket in "[{":
        _reader(_name, f"nested deeply, {_bracket}", lambda path, b=_bracket: path.write_bytes(damage.nested(b)))
    _reader(_name, "nested deeply within", lambda path: _deep_within(path))


def _deep_within(path: Path) -> None:
    """The valid document with one more key, or one more item, that is nested."""
    text = path.read_bytes().strip()
    more = b',"more":' if text.endswith(b"}") else b","
    path.write_bytes(text[:-1] + more + damage.nested() + text[-1:])


def _report_explained(bench: Bench) -> Attempt:
    (bench.take("settings", "report.json") / "report.json").write_bytes(damage.nested())
    return ends(("explain", "in/report.json"), 5)


SEEDS["report.json: nested deeply, explained"] = _report_explained

for _what, _ruler in {
    "one value": {"margin": [1.0]},
    "three values": {"noise": [1.0, 2.0, 3.0]},
    "negative": {"bias_sd": [-0.1, 0.1]},
    "not finite": {"noise": [1e400, 1.0]},
    "of text": {"margin": ["a", "b"]},
    "a number": {"margin_sd": 1.0},
    "unknown": {"colour": 1.0},
}.items():
    _boxes(f"ruler {_what}", lambda d, r=_ruler: d["ruler"].update(r))
    _reader("calibration.json", f"ruler {_what}", lambda path, r=_ruler: edited(path, lambda d: d["ruler"].update(r)))
_boxes("ruler a list", lambda d: d.update(ruler=[]))

for _what, _entry in {
    "negative shares": {"shares": {"mini": -1.0, "small hatch": 2.0}},
    "shares of nan": {"shares": {"mini": float("nan")}},
    "shares a list": {"shares": [1, 2]},
    "shares of text": {"shares": {"mini": "x"}},
    "shares without end": {"shares": {"mini": 1e308, "small hatch": 1e308}},
    "lengths without end": {"length": [1e308, 1e308]},
    "not finite": {"width": [float("inf"), 0.1]},
    "a year of text": {"year": "new"},
    "a year without end": {"year": float("inf")},
}.items():
    _reader("fleet.json", _what, lambda path, e=_entry: edited(path, lambda d: d.update(e)))

_reader("boxes.coco.json", "info a list", lambda path: edited(path, lambda d: d.update(info=[])))
_reader("boxes.coco.json", "size inf", lambda path: edited(path, lambda d: d["images"][0].update(width=float("inf"))))
for _what, _edit in {
    "geometry a list": lambda f: f.update(geometry=[]),
    "geometry text": lambda f: f.update(geometry="x"),
    "properties a list": lambda f: f.update(properties=[]),
    "properties text": lambda f: f.update(properties="x"),
}.items():
    _reader("boxes.geojson", _what, lambda path, e=_edit: edited(path, lambda d: e(d["features"][0])), 0, 5)
for _what, _entry in {"focal length inf": {"focal_px": float("inf")}, "huge": {"k1": 1e308, "cx": 1e308},
                      "size huge": {"width": 10**30}, "size inf": {"width": 1e400}}.items():  # fmt: skip
    _reader("lens.json", _what, lambda path, e=_entry: edited(path, lambda d: d.update(e)))
for _what, _entry in {"buffers text": {"buffers": "x"}, "buffers of text": {"buffers": ["x"]}, "images a number":
                      {"images": 3}, "images of nothing": {"images": [None]}, "uri a list": {"buffers": [{"uri": [1]}]},
                      "nodes an object": {"nodes": {}}}.items():  # fmt: skip
    _reader("scene.gltf", _what, lambda path, e=_entry: edited(path, lambda d: d.update(e)))


@seed("OBJ: mtllib without a name")
def _mtllib(bench: Bench) -> Attempt:
    inside = bench.take("geometry", "sim3.json", "mesh.obj")
    text = (inside / "mesh.obj").read_text()
    (inside / "mesh.obj").write_text(text.replace("mtllib a.mtl", "mtllib"))
    return ends(("apply", "in/sim3.json", "in/mesh.obj", "--out", "out"), 0, 5)


def _text(name: str, file: str, old: str, new: str) -> None:
    @seed(f"COLMAP text: {name}")
    def make(bench: Bench) -> Attempt:
        path = bench.take("colmap-txt") / "sparse/0" / file
        text = path.read_text()
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        words = lines[0].split()
        words[int(old)] = new
        path.write_text("\n".join([" ".join(words), *lines[1:]]) + "\n")
        return ends(("estimate", *PLANS), 5)


_text("camera number negative", "cameras.txt", "0", "-1")
_text("camera number huge", "cameras.txt", "0", "99999999999999999999")
_text("width negative", "cameras.txt", "2", "-640")
_text("width huge", "cameras.txt", "2", "18446744073709551616")
_text("image number negative", "images.txt", "0", "-5")
_text("image number huge", "images.txt", "0", "99999999999")
_text("camera of an image huge", "images.txt", "8", "99999999999")
_text("point number negative", "points3D.txt", "0", "-1")
_text("point number huge", "points3D.txt", "0", "99999999999999999999999")
_text("colour 300", "points3D.txt", "4", "300")
_text("colour negative", "points3D.txt", "4", "-1")


@seed("a network that never ends")
def _endless_network(bench: Bench) -> Attempt:
    (bench.take("ortho", "ortho.tif") / "net.onnx").symlink_to("/dev/zero")
    return ends(("estimate", "in/ortho.tif", "--detector", "in/net.onnx", "--zoom", "1"), 5)


@seed("materials that never end")
def _endless_materials(bench: Bench) -> Attempt:
    path = bench.take("geometry", "sim3.json", "mesh.obj") / "a.mtl"
    path.symlink_to("/dev/zero")
    return ends(("apply", "in/sim3.json", "in/mesh.obj", "--out", "out"), 0, 5)


@seed("rig: whether a sensor has a pose is 2.0")
def _odd_flag(bench: Bench) -> Attempt:
    path = bench.take("rig-txt") / "sparse/0/rigs.txt"
    head, line = path.read_text().rstrip().rsplit("\n", 1)
    words = line.split()
    assert words[6] == "1"  # after rig, count, the reference sensor's kind and number, and those of the second
    path.write_text("\n".join((head, " ".join((*words[:6], "2.0", *words[7:])))) + "\n")
    return ends(("estimate", *PLANS), 5)


@seed("VRT of two thousand million columns, copied")
def _endless_vrt(bench: Bench) -> Attempt:
    path = bench.take("ortho", "ortho.tif", "ortho.vrt", "labels.txt") / "ortho.vrt"
    path.write_text(path.read_text().replace('rasterXSize="400"', 'rasterXSize="-2147483649"'))
    words = ("--detections", "in/labels.txt", "--fleet", "DE", "--override", "--force", "--cog", "--out", "out.tif")
    return ends(("fix", "in/ortho.vrt", *words), 5)


@seed("PLY, its last byte lost")
def _cut_ply(bench: Bench) -> Attempt:
    path = bench.take("geometry", "sim3.json", "splat.ply") / "splat.ply"
    path.write_bytes(path.read_bytes()[:-1])
    return ends(("apply", "in/sim3.json", "in/splat.ply", "--out", "out"), 5)


for _what, _entry in {
    "stride 0": {"stride": 0},
    "stride negative": {"stride": -32},
    "stride text": {"stride": "x"},
    "stride huge": {"stride": 10**12},
    "score text": {"score": "x"},
    "score nan": {"score": float("nan")},
    "score 0": {"score": 0},
    "score 1": {"score": 1.0},
    "ruler a list": {"ruler": []},
    "ruler of one value": {"ruler": {"margin": [1.0]}},
    "lengths negative": {"usable_length": [-1, -5]},
    "best length 0": {"best_length": 0},
}.items():
    _onnx(f"card, {_what}", lambda n, path, e=_entry: n.card_network(path, json.dumps({**CARD, **e})))
_onnx("card nested deeply", lambda n, path: n.card_network(path, damage.nested().decode()))
_onnx("card a list", lambda n, path: n.card_network(path, "[]"))
_onnx(
    "names nested deeply", lambda n, path: n.many_boxes(path, 3, {**n.NAMES, "names": damage.nested().decode()}), 2, 5
)


def _control(name: str, line: str) -> None:
    @seed(f"control points: {name}")
    def make(bench: Bench) -> Attempt:
        path = bench.take("settings", "ortho.tif", "boxes.json", "control.txt") / "control.txt"
        path.write_text(path.read_text() + line + "\n")
        return ends((*ESTIMATE, "--ground-control", "in/control.txt"), 2, 5)


_control("nan", "nan,40 4 -4")
_control("nan metres", "40,41 nan -4")
_control("inf", "40,41 inf -4")


def _full(name: str, kind: str, limit: int, *argv: str) -> None:
    @seed(f"full disk: {name}, after {limit} bytes")
    def make(bench: Bench) -> Attempt:
        bench.take(kind)
        return ends(argv, 6, file_limit=limit)


for _limit in (0, 4096, 30_000):
    _full("boxes as GeoPackage", "ortho", _limit, *ESTIMATE[:-1], "--save-detections", "out.gpkg")
    _full("photos as GeoPackage", "photos", _limit, "photo", "in/flight", "--detections", "in/boxes.json", "--fleet",
          "in/cars.json", "--out", "out.gpkg")  # fmt: skip
    _full("a model", "colmap-bin", _limit, "fix", *PLANS, "--out", "out")
    _full("an orthophoto", "ortho", _limit, *FIX, "--out", "out.tif")
