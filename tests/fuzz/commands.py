"""The classes of the campaign: each puts a damaged input into a folder and says which command is to face it.

A class is a function of a `Bench` and a generator of chance; class and seed make the same attempt every time.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from . import damage, hostile, seeds
from .bench import Bench, Rng, harm, how_for, sim3
from .runner import Attempt
from .truth import BOX_FORMATS, CARD, MODELS, RASTERS

HOSTILE_MEMORY = 1.5  # [GiB] what a hostile raster may take

# Reconstructions


def _measure(rng: Rng) -> tuple[str, ...]:
    """Estimate or fix a model; mostly the quick way."""
    words = ("in", "--detections", "in/boxes.json", "--fleet", "DE", "--json")
    mode = ("--mode", "planar") if rng.random() < 0.9 else ()
    if rng.random() < 0.85:  # frames without anything in them are searched for anchors as long as all else takes
        words = (*words, "--anchors", "none")
    if rng.random() < 0.6:
        return ("estimate", *words, *mode)
    return ("fix", *words, *mode, "--out", "out", "--report", rng.choice(("none", "none", "none", "json", "html")))


def _damaged_colmap(kinds: Sequence[str]) -> Callable[[Bench, Rng], Attempt]:
    def attempt(bench: Bench, rng: Rng) -> Attempt:
        kind = rng.choice(kinds)
        model = bench.take(kind) / "sparse/0"
        # The large files are mostly observations, where damage matters least.
        files = sorted(p for p in model.iterdir())
        path = rng.choice(
            [p for p in files if p.stem in ("cameras", "images", "points3D")] if rng.random() < 0.7 else files
        )
        harm(path, rng, how_for(path), rng.choice(files))
        if rng.random() < 0.05:
            path.unlink()
        if rng.random() < 0.05:
            (model / "sim3.json").write_text('{"scale": 5, "rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}')
            shutil.move(model / "sim3.json", bench.folder / "in/sim3.json")
            return Attempt(("apply", "in/sim3.json", "in/sparse/0", "--out", "out"))
        return Attempt(_measure(rng), truth=bench.answer(kind))

    return attempt


def edited_colmap(bench: Bench, rng: Rng) -> Attempt:
    """A model that is sound as a file and wrong as a whole: the kind of harm that scripts and mix-ups do."""
    import pycolmap

    kind = rng.choice(MODELS)
    folder = bench.take(kind) / "sparse/0"
    model = pycolmap.Reconstruction(str(folder))
    edit = rng.choice(list(hostile.EDITS))
    hostile.EDITS[edit](model, rng)
    for old in folder.iterdir():
        old.unlink()
    (model.write_binary if kind.endswith("bin") else model.write_text)(str(folder))
    return Attempt(_measure(rng), truth=bench.answer(kind))


def mixed_colmap(bench: Bench, rng: Rng) -> Attempt:
    """Files of two models in one folder."""
    kind = rng.choice(("colmap", "rig"))
    form = rng.choice(("bin", "txt"))
    folder = bench.take(f"{kind}-{form}") / "sparse/0"
    other = bench.corpus / f"other-{form}" / "sparse"
    names = [p.name for p in folder.iterdir() if (other / p.name).is_file()]
    for name in rng.sample(names, rng.randrange(1, len(names))):
        shutil.copy(other / name, folder / name)
    return Attempt(_measure(rng), truth=bench.answer(f"{kind}-{form}"))


def other_models(bench: Bench, rng: Rng) -> Attempt:
    """Reconstructions of OpenSfM, nerfstudio, Bundler and VisualSFM. They keep no observations, so a wrong number in
    them cannot be found; only how the program bears it counts."""
    kind, names = rng.choice(
        (
            ("opensfm", ("reconstruction.json",)),
            ("nerfstudio", ("transforms.json", "sparse_pc.ply")),
            ("bundler", ("bundle.out", "list.txt")),
            ("nvm", ("scene.nvm",)),
        )
    )
    inside = bench.take(kind)
    path = inside / (names[0] if rng.random() < 0.75 else rng.choice(names))
    harm(path, rng, how_for(path) if path.suffix != ".ply" else rng.choice((damage.text, damage.binary)))
    if rng.random() < 0.3:
        sim3(inside)
        return Attempt(("apply", "in/sim3.json", f"in/{names[0]}", "--out", "out"))
    return Attempt(_measure(rng))


# Detections and settings


def detections(bench: Bench, rng: Rng) -> Attempt:
    name = rng.choice(BOX_FORMATS)
    inside = bench.take("ortho", "ortho.tif", name)
    harm(inside / name, rng, how_for(Path(name)))
    ask = ("in/ortho.tif", "--detections", f"in/{name}", "--fleet", "DE")
    command = rng.choice(("estimate",) * 6 + ("check", "fix", "save", "exhaustive"))
    if command == "fix":
        return Attempt(
            ("fix", *ask, "--override", "--force", "--out", "out.tif", "--report", rng.choice(("json", "html")))
        )
    if command == "save":
        to = f"out{rng.choice(('.json', '.coco.json', '.geojson', '.gpkg', '.txt'))}"
        return Attempt(("estimate", *ask, "--save-detections", to))
    if command == "exhaustive":
        return Attempt(("estimate", *ask, "--json", "--estimator", "iqr"))
    anchors = ("--anchors", "none") if rng.random() < 0.6 else ()
    return Attempt((command, *ask, "--json", *anchors))


def model_detections(bench: Bench, rng: Rng) -> Attempt:
    """Boxes of a reconstruction's frames and plans, damaged; and those of photos and data sets."""
    which = rng.randrange(4)
    if which == 0:
        inside = bench.take("photos")
        harm(inside / "boxes.json", rng, damage.json_text)
        return Attempt(
            ("photo", "in/flight", "--detections", "in/boxes.json", "--fleet", "in/cars.json", "--out", "o.csv")
        )
    if which == 1:
        kind = rng.choice(("denseuav", "csv"))
        inside = bench.take(kind)
        harm(inside / "detections.json", rng, damage.json_text)
        place = "in/photos.csv" if kind == "csv" else "in"
        return Attempt(("evaluate", place, "--detections", "in/detections.json", "--fleet", "DE", "--out", "o.json"))
    inside = bench.take("colmap-bin")
    harm(inside / "boxes.json", rng, damage.json_text)
    return Attempt(_measure(rng))


def marks(bench: Bench, rng: Rng) -> Attempt:
    """Ground control marked in a model's pictures."""
    harm(bench.take("colmap-bin") / "gcp_list.txt", rng, damage.text)
    return Attempt((*_measure(rng), "--ground-control", "in/gcp_list.txt"))


def settings(bench: Bench, rng: Rng) -> Attempt:
    """Fleets, calibrations, similarities, catalogues, lenses, known points."""
    ask = ("estimate", "in/ortho.tif", "--detections", "in/boxes.json", "--json")
    name, argv = rng.choice(
        (
            *((f, (*ask, "--fleet", f"in/{f}")) for f in ("fleet.json", "mixture.json", "shares.json")),
            ("calibration.json", (*ask, "--calibration", "in/calibration.json")),
            ("control.txt", (*ask, "--fleet", "DE", "--ground-control", "in/control.txt")),
            ("standards.json", (*ask, "--fleet", "DE", "--anchor", "in/standards.json")),
            ("sim3.json", ("apply", "in/sim3.json", "in/ascii.ply", "--out", "out")),
            ("sim3.txt", ("apply", "in/sim3.txt", "in/ascii.ply", "--out", "out")),
            ("catalogue.json", ("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--facility", "boules")),
            ("lens.json", ()),
            ("lens.xml", ()),
            ("lens.txt", ()),
        )
    )
    if name.startswith("lens"):
        inside = bench.take("photos", "flight/a.jpg", "boxes.json", "cars.json", name)
        argv = (
            "photo",
            "in/flight/a.jpg",
            "--detections",
            "in/boxes.json",
            "--fleet",
            "in/cars.json",
            "--lens",
            f"in/{name}",
        )
    elif name.startswith("sim3"):
        inside = bench.take("geometry", name, "ascii.ply")
    elif name.startswith("cata"):
        inside = bench.take("settings", name, "scaled.tif", "lot.geojson")
        argv = (*argv, "--catalogue", "in/catalogue.json", "--out", "out")
    else:
        inside = bench.take("settings", name, "ortho.tif", "boxes.json")
    harm(inside / name, rng, how_for(Path(name)))
    return Attempt(argv)


def documents(bench: Bench, rng: Rng) -> Attempt:
    """Reports, lots, and what `layout` reads beside its picture."""
    lay = ("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--facility", "tennis", "--out", "out")
    name, argv = rng.choice(
        (
            ("report.json", ("report", "in/report.json", "--out", "out.html")),
            ("report.json", ("explain", "in/report.json", *rng.choice(((), ("--json",))))),
            ("lot.geojson", lay),
            ("trees.geojson", (*lay, "--avoid", "in/trees.geojson")),
            ("scaled.tif.json", lay),
        )
    )
    inside = bench.take(
        "settings", "report.json", "lot.geojson", "trees.geojson", "scaled.tif", "scaled.tif.json", "ortho.tif"
    )
    harm(inside / name, rng, how_for(Path(name)))
    return Attempt(argv)


# Pictures


def rasters(bench: Bench, rng: Rng) -> Attempt:
    name = rng.choice(RASTERS)
    sidecars = {"ortho.png": ("ortho.pgw",), "ortho.jpg": ("ortho.jgw",), "ortho.vrt": ("ortho.tif",)}.get(name, ())
    inside = bench.take("ortho", name, "labels.txt", *sidecars)
    path = inside / (rng.choice((name, name, *sidecars)) if sidecars else name)
    harm(path, rng, how_for(path))
    ask = (f"in/{name}", "--fleet", "DE")
    boxes = ("--detections", "in/labels.txt")
    command = rng.choice(("estimate", "estimate", "estimate", "check", "fix", "fix", "fix", "look"))
    if command == "look":
        return Attempt(("estimate", *ask, "--zoom", "1", "--json"), memory=HOSTILE_MEMORY)
    if command == "fix":
        more = rng.choice(
            ((), ("--cog",), ("--keep-origin",), ("--also", "tfw"), ("--also", "gpkg", "--report", "html"))
        )
        report = () if "--report" in more else ("--report", rng.choice(("none", "html")))
        argv = ("fix", *ask, *boxes, "--override", "--force", "--out", "out.tif", *report, *more)
        return Attempt(argv, memory=HOSTILE_MEMORY)
    return Attempt((command, *ask, *boxes, "--json"), memory=HOSTILE_MEMORY)


def hostile_rasters(bench: Bench, rng: Rng) -> Attempt:
    """Bombs, strange types and sizes, VRTs of pipes, devices and servers."""
    inside = bench.take("ortho", "ortho.tif", "labels.txt")
    if rng.random() < 0.4:
        name = hostile.odd_vrt(inside, rng)
    else:
        name = rng.choice(sorted(p.name for p in (bench.corpus / "strange").iterdir()))
        bench.take("strange", name)
    ask = ("estimate", f"in/{name}", "--fleet", "DE", "--json")
    if rng.random() < 0.5:
        return Attempt((*ask, "--detections", "in/labels.txt"), memory=HOSTILE_MEMORY)
    anchors = () if rng.random() < 0.2 else ("--anchors", "none")  # without vehicles they are sought at any scale
    return Attempt((*ask, "--zoom", "0.1" if "20000" in name else "1", *anchors), memory=HOSTILE_MEMORY)


def photos(bench: Bench, rng: Rng) -> Attempt:
    """Photos and their tags; satellite pictures."""
    inside = bench.take("photos")
    ask = ("--detections", "in/boxes.json", "--fleet", "in/cars.json")
    if rng.random() < 0.25:
        path = inside / rng.choice(("satellite.tif", "flight/a.jpg"))
        harm(path, rng, damage.binary)
        return Attempt(("crop", "in/flight/a.jpg", *ask, "--satellite", "in/satellite.tif", "--out", "out"), memory=1.5)
    harm(inside / "flight/a.jpg", rng, _tags)
    if rng.random() < 0.7:
        return Attempt(("photo", "in/flight/a.jpg", *ask, "--json"))
    out = f"o{rng.choice(('.csv', '.json', '.gpkg'))}"
    return Attempt(("photo", "in/flight", *ask, *rng.choice(((), ("--together",))), "--out", out))


def _tags(data: bytes, rng: Rng, donor: bytes) -> bytes:
    """Damage where a JPEG keeps its tags, and now and then anywhere."""
    if rng.random() < 0.3:
        return damage.binary(data, rng)
    end = min(len(data), 2000)
    how = damage.text if rng.random() < 0.4 else damage.binary
    return how(data[:end], rng) + data[end:]


def datasets(bench: Bench, rng: Rng) -> Attempt:
    """What `evaluate` reads: tables, poses, calibrations, surface models, photos."""
    kind, names = rng.choice(
        (
            ("csv", ("photos.csv", "photos.csv", "photos/000.jpg")),
            ("visloc", ("01/reference.txt", "01/camera.xml", "01/region01_dsm.tif", "01/drone/01_0001.JPG")),
            ("denseuav", ("query_drone/000001/H80.JPG",)),
        )
    )
    path = bench.take(kind) / rng.choice(names)
    harm(path, rng, how_for(path))
    place = "in/photos.csv" if kind == "csv" else "in"
    argv = ("evaluate", place, "--form", kind, "--detections", "in/detections.json", "--fleet", "DE")
    return Attempt((*argv, "--out", rng.choice(("o.json", "o.csv"))))


# Geometry and networks


def geometry(bench: Bench, rng: Rng) -> Attempt:
    name, damaged = rng.choice(
        (
            *((n, n) for n in ("ascii.ply", "binary_little_endian.ply", "binary_big_endian.ply", "splat.ply") * 2),
            *(("mesh.obj", n) for n in ("mesh.obj", "mesh.obj", "a.mtl")),
            ("scene.glb", "scene.glb"),
            ("scene.gltf", "scene.gltf"),
            ("scene.gltf", "part.bin"),
            ("dense", "dense/stereo/depth_maps/a.jpg.geometric.bin"),
            ("dense", "dense/fused.ply"),
            ("dense", "dense/fused.ply.vis"),
            ("dense", "dense/sparse/cameras.bin"),
            ("dense/stereo/depth_maps/a.jpg.geometric.bin",) * 2,
        )
    )
    inside = bench.take("geometry")
    path = inside / damaged
    head = path.suffix == ".ply" and rng.random() < 0.5
    harm(path, rng, _header if head else _glb if path.suffix == ".glb" and rng.random() < 0.5 else how_for(path))
    return Attempt(("apply", "in/sim3.json", f"in/{name}", "--out", "out"))


def workspaces(bench: Bench, rng: Rng) -> Attempt:
    """Dense workspaces of COLMAP: files damaged, cut short, missing, exchanged, of another model."""
    dense = bench.take("geometry") / "dense"
    files = sorted(path for path in dense.rglob("*") if path.is_file())
    for path in rng.sample(files, rng.randrange(1, 3)):
        what = rng.randrange(5)
        if what == 0:
            path.unlink()
        elif what == 1:
            path.write_bytes(path.read_bytes()[: rng.randrange(path.stat().st_size + 1)])
        elif what == 2:
            shutil.copy(rng.choice(sorted((bench.corpus / "geometry/dense").rglob("*.*"))), path)
        else:
            harm(path, rng, _header if path.suffix == ".ply" and rng.random() < 0.5 else how_for(path))
    if rng.random() < 0.5:
        return Attempt(("apply", "in/sim3.json", "in/dense", "--out", "out"))
    bench.take("colmap-bin", "boxes.json")
    shutil.copytree(bench.corpus / "colmap-bin/sparse/0", dense.parent / "sparse")
    ask = ("--detections", "in/boxes.json", "--fleet", "DE", "--mode", "planar", "--anchors", "none")
    return Attempt(("fix", "in/sparse", *ask, "--report", "none", "--dense", "--out", "out"))


def other_geometry(bench: Bench, rng: Rng) -> Attempt:
    clouds = ("ascii.pcd", "binary.pcd", "binary_compressed.pcd", "points.laz", "points.xyz", "points.splat")
    name = rng.choice((*clouds, "mesh.off", "text.stl", "binary.stl", "cameras.json"))
    path = bench.take("geometry") / name
    texts = ("ascii.pcd", "points.xyz", "mesh.off", "text.stl", "cameras.json")
    harm(path, rng, damage.text if name in texts else damage.binary)
    return Attempt(("apply", "in/sim3.json", f"in/{name}", "--out", "out"))


def _header(data: bytes, rng: Rng, donor: bytes) -> bytes:
    """Damage the words of a PLY's header."""
    head, mark, body = data.partition(b"end_header\n")
    return damage.text(head, rng) + mark + body


def _glb(data: bytes, rng: Rng, donor: bytes) -> bytes:
    """Damage the JSON in a GLB, with its lengths made right again."""
    size = int.from_bytes(data[12:16], "little")
    inner = damage.json_text(data[20 : 20 + size], rng)
    inner += b" " * (-len(inner) % 4)
    rest = data[20 + size :]
    total = (20 + len(inner) + len(rest)).to_bytes(4, "little")
    return data[:8] + total + len(inner).to_bytes(4, "little") + data[16:20] + inner + rest


def onnx_files(bench: Bench, rng: Rng) -> Attempt:
    """Networks of others, damaged as files and in what they say of themselves."""
    from . import networks

    inside = bench.take("networks", "ortho.tif")
    path = inside / "net.onnx"
    if rng.random() < 0.5:
        name = rng.choice(("ultralytics", "nms-free", "mmrotate", "card"))
        path.write_bytes(damage.binary((bench.corpus / "networks" / f"{name}.onnx").read_bytes(), rng))
    else:
        card = damage.json_text(json.dumps(CARD).encode(), rng)
        networks.card_network(path, card.decode("utf-8", "ignore"))
    return Attempt(("estimate", "in/ortho.tif", "--detector", "in/net.onnx", "--fleet", "DE", "--zoom", "1", "--json"))


# Words, places, circumstances


OPTIONS = (
    *("--zoom", "--gsd-hint", "--target", "--seed", "--workers", "--fleet", "--vehicle-class", "--known-distance"),
    *("--anchors", "--anchor", "--decoder", "--calibration", "--mode", "--images", "--scheduler"),
)


def options(bench: Bench, rng: Rng) -> Attempt:
    """Strange values of every option."""
    bench.take("settings", "ortho.tif", "boxes.json", "control.txt", "scaled.tif", "lot.geojson")
    value = rng.choice(hostile.WORDS)
    base = ("estimate", "in/ortho.tif", "--detections", "in/boxes.json", "--json")
    option = rng.choice(OPTIONS)
    if option == "--known-distance":
        words = [
            rng.choice(("10,10", "300,300", "1e300,1", "nan,1", "10,10,10", "id:1", "x@1,1", "10", *hostile.WORDS[:9]))
        ]
        words += [rng.choice(("300,20", "10,10", "inf,0")), *(rng.choice(hostile.WORDS) for _ in range(2))]
        value = " ".join(words)
    if rng.random() < 0.2:
        option, base = "--facility", ("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--out", "out")
        value = rng.choice(("tennis:", "tennis@", "parking-DE:", "tennis@1,1,", "")) + value
    elif rng.random() < 0.2:
        option = rng.choice(("--clearance", "--scale-error"))
        base = ("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--facility", "tennis", "--out", "out")
    elif rng.random() < 0.2:
        bench.take("photos", "flight/a.jpg", "boxes.json", "cars.json")
        base = ("photo", "in/flight/a.jpg", "--detections", "in/boxes.json", "--fleet", "in/cars.json")
        option = rng.choice(("--focal-px", "--pitch", "--roll", "--lens"))
    return Attempt((*base, option, value))


def names(bench: Bench, rng: Rng) -> Attempt:
    """Files and outputs with names that no one should give, and those that are not there."""
    name = rng.choice(hostile.NAMES)
    inside = bench.take("ortho", "ortho.tif", "boxes.json", "plain.json", "labels.txt")
    command = rng.choice(("estimate", "fix", "out", "save", "apply", "frame"))
    ask = ("--detections", "in/boxes.json", "--fleet", "DE")
    if command in ("estimate", "fix"):
        with contextlib.suppress(OSError, ValueError):
            shutil.copy(os.fsencode(inside / "ortho.tif"), os.fsencode(inside) + b"/" + name)
        out = ("--override", "--out", "out.tif") if command == "fix" else ()
        look = rng.choice((("--zoom", "1"), ("--detections", "in/labels.txt"), ("--detections", "in/labels.txt")))
        return Attempt((command, b"in/" + name.replace(b"\0", b""), "--fleet", "DE", *look, *out))
    if command == "out":
        return Attempt(("fix", "in/ortho.tif", *ask, "--override", "--out", name.replace(b"\0", b""), "--overwrite"))
    if command == "save":
        return Attempt(("estimate", "in/ortho.tif", *ask, "--save-detections", name.replace(b"\0", b"")))
    if command == "apply":
        bench.take("geometry", "sim3.json", "ascii.ply")
        with contextlib.suppress(OSError, ValueError):
            os.rename(os.fsencode(inside / "ascii.ply"), os.fsencode(inside) + b"/" + name)
        return Attempt(("apply", "in/sim3.json", b"in/" + name.replace(b"\0", b""), "--out", "out"))
    word = name.decode("utf-8", "replace")
    rows = json.loads((inside / "plain.json").read_text())["ortho.tif"]
    (inside / "plain.json").write_text(json.dumps({word: rows}))
    return Attempt(("estimate", "in/ortho.tif", "--detections", "in/plain.json", "--fleet", "DE"))


def places(bench: Bench, rng: Rng) -> Attempt:
    """Inputs that are folders, devices, pipes, links in a circle or nothing; frames that do not fit."""
    inside = bench.take("settings", "ortho.tif", "boxes.json", "sim3.json", "report.json", "lot.geojson", "scaled.tif")
    odd = hostile.odd_place(inside, rng)
    argv = rng.choice(
        (
            ("estimate", odd, "--fleet", "DE"),
            ("estimate", "in/ortho.tif", "--detections", odd),
            ("estimate", "in/ortho.tif", "--detections", "in/boxes.json", "--fleet", odd),
            ("estimate", "in/ortho.tif", "--detections", "in/boxes.json", "--calibration", odd),
            ("estimate", "in/ortho.tif", "--detections", "in/boxes.json", "--ground-control", odd),
            ("estimate", "in/ortho.tif", "--detector", odd, "--zoom", "1"),
            ("apply", odd, "in/sim3.json", "--out", "out"),
            ("apply", "in/sim3.json", odd, "--out", "out"),
            ("report", odd, "--out", "out.html"),
            ("explain", odd),
            ("photo", odd, "--fleet", "DE", "--focal-px", "900", "--detections", "in/boxes.json"),
            ("layout", "in/scaled.tif", "--lot", odd, "--facility", "tennis", "--out", "out"),
            ("evaluate", odd, "--fleet", "DE", "--detections", "in/boxes.json"),
            ("fix", "in/ortho.tif", "--detections", "in/boxes.json", "--override", "--out", odd),
        )
    )
    return Attempt(argv)


def frames(bench: Bench, rng: Rng) -> Attempt:
    """Frames of a reconstruction: damaged, of another size, missing, not pictures; several models in a workspace."""
    kind = rng.choice(("colmap-bin", "rig-txt", "bundler", "nvm"))
    inside = bench.take(kind)
    pictures = sorted(p for p in inside.rglob("*.png"))
    for path in rng.sample(pictures, rng.randrange(1, 4)):
        what = rng.randrange(5)
        if what == 0:
            path.unlink()
        elif what == 1:
            path.write_bytes(hostile.png(rng.choice((1, 64, 2000)), rng.choice((1, 480, 3000))))
        elif what == 2:
            path.write_text("no picture")
        else:
            harm(path, rng, damage.binary)
    if kind == "colmap-bin" and rng.random() < 0.4:
        shutil.copytree(inside / "sparse/0", inside / "sparse/1")
        harm(rng.choice(list((inside / f"sparse/{rng.randrange(2)}").iterdir())), rng, damage.binary)
        return Attempt(
            ("fix", "in", "--detections", "in/boxes.json", "--fleet", "DE", "--mode", "planar", "--out", "out")
        )
    return Attempt(("fix", "in", "--detections", "in/boxes.json", "--fleet", "DE", "--mode", "planar", "--out", "out"))


def values(bench: Bench, rng: Rng) -> Attempt:
    """Files that are sound but say too much: nested, enormous, countless, out of range; the seeds."""
    return seeds.SEEDS[rng.choice(list(seeds.SEEDS))](bench)


def full_disk(bench: Bench, rng: Rng) -> Attempt:
    """No room for the output: the size of files is limited, as on a disk that is full."""
    argv = writing(bench, rng)
    return Attempt(argv, file_limit=rng.choice((0, 1, 100, 4096, 20_000, 65_536, 200_000)))


def writing(bench: Bench, rng: Rng, place: str = "out") -> tuple[str, ...]:
    """A command that writes: every kind of output once in a while, under `place`."""
    boxes = ("--detections", "in/boxes.json", "--fleet", "DE")
    what = rng.randrange(9)
    if what == 0:
        bench.take(rng.choice(MODELS))
        return ("fix", "in", *boxes, "--mode", "planar", "--out", place)
    if what == 1:
        bench.take(rng.choice(("opensfm", "nerfstudio", "bundler", "nvm")))
        return ("fix", "in", *boxes, "--mode", "planar", "--out", place)
    if what in (2, 3):
        bench.take("ortho", "ortho.tif", "boxes.json")
        also = rng.choice(
            ((), ("--also", "gpkg"), ("--also", "tfw", "--also", "geojson", "--also", "tiles"), ("--cog",))
        )
        return ("fix", "in/ortho.tif", *boxes, "--override", *also, "--out", f"{place}.tif")
    if what == 4:
        bench.take("ortho", "ortho.tif", "boxes.json")
        end = rng.choice((".json", ".coco.json", ".txt", ".geojson", ".gpkg"))
        return ("estimate", "in/ortho.tif", *boxes, "--save-detections", f"{place}{end}")
    if what == 5:
        bench.take("geometry")
        files = ("in/splat.ply", "in/mesh.obj", "in/scene.gltf", "in/dense")
        return ("apply", "in/sim3.json", *files, "--out", place)
    if what == 6:
        bench.take("settings", "scaled.tif", "lot.geojson")
        return ("layout", "in/scaled.tif", "--lot", "in/lot.geojson", "--facility", "tennis", "--out", place)
    if what == 7:
        bench.take("photos")
        end = rng.choice((".csv", ".json", ".gpkg"))
        return (
            "photo",
            "in/flight",
            "--detections",
            "in/boxes.json",
            "--fleet",
            "in/cars.json",
            "--out",
            f"{place}{end}",
        )
    bench.take("settings", "report.json", "ortho.tif")
    return ("report", "in/report.json", "--out", f"{place}.html")


def cache(bench: Bench, rng: Rng) -> Attempt:
    """Looks kept from an earlier run, damaged: the answer must be the same as without."""
    bench.take("cache", "ortho.tif")
    shutil.copytree(bench.corpus / "cache/cache", bench.folder / "cache")
    for path in sorted(p for p in (bench.folder / "cache").rglob("*") if p.is_file()):
        what = rng.random()
        if what < 0.5:
            harm(path, rng, damage.binary)
        elif what < 0.8:
            harm(path, rng, _bits)
        elif what < 0.9:
            path.unlink()
            path.mkdir()
        else:
            hostile.change_rows(path, rng.randrange(4))
    argv = ("estimate", "in/ortho.tif", "--fleet", "DE", "--zoom", "1", "--json")
    return Attempt(argv, truth=bench.answer("cache"), tolerance=1e-6)


def _bits(data: bytes, rng: Rng, donor: bytes) -> bytes:
    """Many flipped bits, so that some hit the rows."""
    out = np.frombuffer(data, np.uint8).copy()
    places = np.array([rng.randrange(len(out)) for _ in range(200)])
    out[places] ^= 1 << np.array([rng.randrange(8) for _ in places]).astype(np.uint8)
    return out.tobytes()


def twins(bench: Bench, rng: Rng) -> Attempt:
    """Two runs at once on one output: one of them wins."""
    return Attempt(writing(bench, rng), twins=2)


def kills(bench: Bench, rng: Rng) -> Attempt:
    """SIGINT, SIGTERM, SIGHUP or SIGKILL at any time; SIGKILL is followed by a run that must tidy up."""
    argv = writing(bench, rng)
    if argv[0] == "fix" and rng.random() < 0.3:
        argv = (*argv, "--force")
    number = rng.choice((signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL))
    if rng.random() < 0.5:
        return Attempt(argv, kill=(int(number), rng.uniform(0, 0.15)), when_writing=True)
    return Attempt(argv, kill=(int(number), rng.choice((rng.uniform(0.1, 0.8), rng.uniform(0.3, 2.5)))))


def onto_inputs(bench: Bench, rng: Rng) -> Attempt:
    """`--out` and `--save-detections` on, above, in or beside inputs, by every kind of detour."""
    argv = list(writing(bench, rng))
    at = max(k for k, word in enumerate(argv) if word in ("--out", "--save-detections")) + 1
    inside = bench.folder / "in"
    files = sorted(p.relative_to(bench.folder).as_posix() for p in inside.rglob("*"))
    target = rng.choice((*files, "in", "in", ".", "in/new", f"in/new{Path(argv[at]).suffix}"))
    if rng.random() < 0.5:  # of the kind of file that the command would write
        same = [f for f in files if Path(f).suffix == Path(argv[at]).suffix]
        target = rng.choice(same) if same else target
    detour = rng.randrange(5)
    if detour == 0:
        link = bench.folder / f"link{Path(target).suffix}"
        link.symlink_to(target)
        target = link.name
    elif detour == 1 and (bench.folder / target).is_file():
        link = bench.folder / f"hard{Path(target).suffix}"
        os.link(bench.folder / target, link)
        target = link.name
    elif detour == 2:
        target = f"in/../{target}"
    elif detour == 3:
        target = str(bench.folder / target)
    argv[at] = target
    if rng.random() < 0.75 and argv[0] not in ("estimate",):
        argv.append("--overwrite")
    return Attempt(tuple(argv), beside=True)


CLASSES: dict[str, tuple[Callable[[Bench, Rng], Attempt], int]] = {
    "COLMAP binary": (_damaged_colmap(("colmap-bin", "rig-bin")), 1200),
    "COLMAP text": (_damaged_colmap(("colmap-txt", "rig-txt")), 1200),
    "COLMAP edited": (edited_colmap, 240),
    "COLMAP mixed up": (mixed_colmap, 60),
    "OpenSfM, nerfstudio, Bundler, NVM": (other_models, 1200),
    "detection files": (detections, 1200),
    "detections of frames": (model_detections, 250),
    "marks in pictures": (marks, 150),
    "fleets, calibrations, lenses, ...": (settings, 1200),
    "reports, lots": (documents, 500),
    "rasters damaged": (rasters, 800),
    "rasters hostile": (hostile_rasters, 60),
    "photos": (photos, 300),
    "data sets": (datasets, 250),
    "clouds, meshes, depth": (geometry, 900),
    "dense workspaces": (workspaces, 200),
    "PCD, LAZ, XYZ, STL, OFF, splats": (other_geometry, 300),
    "ONNX": (onnx_files, 200),
    "deep, huge and odd values": (values, 200),
    "options": (options, 300),
    "names": (names, 150),
    "pipes, devices, links": (places, 150),
    "frames, several models": (frames, 150),
    "full disk": (full_disk, 120),
    "tile cache": (cache, 100),
    "two at once": (twins, 60),
    "killed": (kills, 200),
    "--out on inputs": (onto_inputs, 250),
}


def prepare(bench: Bench, name: str, seed: int) -> Attempt:
    """Make attempt number `seed` of the class `name` in the bench's folder."""
    return CLASSES[name][0](bench, random.Random(f"{name}:{seed}"))
