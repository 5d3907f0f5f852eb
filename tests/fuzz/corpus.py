"""Small valid inputs of every kind, one folder each; the campaign damages copies of them.

    corpus = build(Path("corpus"))     # corpus/colmap-bin/sparse/0/cameras.bin, corpus/colmap-bin/boxes.json ...

The makers of the test suite make them, so a new kind of input is made once for both.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
import warnings
from collections.abc import Callable, Collection
from pathlib import Path

import cv2
import numpy as np
import rasterio
import rasterio.shutil
from rasterio.control import GroundControlPoint
from rasterio.transform import from_origin
from support import control, flights, geometry, in_process, lots, networks, photos
from support import other_programs as others
from support.models import make_model, put_frames, save

from orthoscale.core.calibration import Calibration
from orthoscale.core.detections import Detections
from orthoscale.core.ruler import Ruler
from orthoscale.formats.calibration import save_calibration
from orthoscale.formats.detections import own as own_format
from orthoscale.formats.detections.files import save as save_detections
from orthoscale.formats.geometry.sim3 import Sim3
from orthoscale.sources.opening import open_source
from orthoscale.synthetic import make_scene, render_ortho, write_colmap
from orthoscale.synthetic.folders import write_csv, write_denseuav, write_visloc

from .hostile import png
from .networks import card_network
from .truth import BOX_FORMATS, CARD, GSD, MODEL_SCALE, MODELS, RASTERS

PINHOLE = ("SIMPLE_PINHOLE", (400.0, 320, 240))
POINTS = 600  # of a model


def build(folder: Path, answered: Collection[str] = ()) -> Path:
    """Make every kind in the new `folder`; returns it. answered : kinds whose scales are wanted, by default all of
    `ANSWERS`."""
    assert flights.UNIT == MODEL_SCALE
    folder.mkdir(parents=True)
    for kind, make in KINDS.items():
        (folder / kind).mkdir()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            make(folder / kind)
    answers = {kind: _answer(folder / kind, *ANSWERS[kind]) for kind in answered or ANSWERS}
    (folder / "answers.json").write_text(json.dumps(answers))
    return folder


def _answer(folder: Path, *ask: str) -> float:
    """The scale of a valid input: what damage is measured against."""
    said = in_process.run("estimate", *(word.replace("@", str(folder)) for word in ask), "--fleet", "DE", "--json")
    scale = json.loads(said.stdout)["scale"]
    truth = GSD if folder.name == "cache" else MODEL_SCALE
    assert abs(scale / truth - 1) < 0.06, f"{folder.name}: {scale}, {truth} is true"
    return scale


# Reconstructions. No frames where none are needed: boxes come from a file.


def _colmap(form: str, rig: bool = False) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        model, turn = make_model(*PINHOLE, rig=rig, points=POINTS)
        save(model, folder / "sparse/0", form)
        put_frames(model, folder / "images")
        _found(folder, turn)
        control.marked(folder / "gcp_list.txt", open_source(folder), turn)

    return make


def _another(form: str) -> Callable[[Path], None]:
    """A model of another flight, of which files get mixed up with those of the first."""

    def make(folder: Path) -> None:
        scene = make_scene(7, None, 60.0, 10)
        write_colmap(scene, folder, 2.0, 10, 80.0, 45.0, 700.0, 640, 480, binary=form == "bin", pictures=False)

    return make


def _other(write: Callable) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        lens = PINHOLE if write is others.nvm else ("RADIAL", (400.0, 320, 240, 0.05, -0.02))
        model, turn = make_model(*lens, points=POINTS)
        path = write(model, folder)
        put_frames(model, folder if path.suffix in (".out", ".nvm") else folder / "images")
        _found(folder, turn, path)

    return make


def _found(folder: Path, turn: np.ndarray, path: Path | None = None) -> None:
    own_format.save_detections(flights.found_by(path or folder, turn), folder / "boxes.json")


# Orthophotos and what is found in them


def _ortho(folder: Path) -> None:
    """One synthetic picture of 400 x 400 px as GeoTIFF, COG, strips, PNG and JPEG with world files, VRT, and its boxes
    in every format."""
    image, boxes = render_ortho(make_scene(3, None, 40.0, 30), GSD, 3)
    place = from_origin(500000, 5300000, GSD, GSD)
    profile = {"driver": "GTiff", "width": image.shape[1], "height": image.shape[0], "count": 3, "dtype": "uint8"}
    placed = {**profile, "crs": "EPSG:32632", "transform": place}
    with rasterio.open(folder / "ortho.tif", "w", **placed, tiled=True, blockxsize=128, blockysize=128) as file:
        file.write(image.transpose(2, 0, 1))
    with rasterio.open(folder / "strips.tif", "w", **placed, compress="deflate") as file:
        file.write(image.transpose(2, 0, 1))
    rasterio.shutil.copy(folder / "ortho.tif", folder / "cog.tif", driver="COG", compress="deflate")
    for name in ("ortho.png", "ortho.jpg"):
        cv2.imwrite(str(folder / name), image[..., ::-1])
        (folder / f"ortho.{name[-3]}{name[-1]}w").write_text("0.1\n0\n0\n-0.1\n500000.05\n5299999.95\n")
    rasterio.shutil.copy(folder / "ortho.tif", folder / "ortho.vrt", driver="VRT")
    text = (folder / "ortho.vrt").read_text()
    (folder / "ortho.vrt").write_text(text.replace(str(folder) + "/", ""))
    rng = np.random.default_rng(0)
    noisy = boxes.xylwa + rng.normal(0, [0.3, 0.3, 0.5, 0.3, 0.01], (len(boxes), 5))
    boxes = type(boxes)(noisy, np.full(len(boxes), 0.9))[boxes.inside(image.shape[1], image.shape[0])]
    ruler = Ruler((0.0, 0.0), (0.2, 0.2), (0.01, 0.01), 0.0, (0.5, 0.3))
    with open_source(folder / "ortho.tif") as source:
        found = Detections({"ortho.tif": boxes}, 1.0, ruler, (0.7, 0.6), "made for the campaign")
        for name in BOX_FORMATS[:-1]:
            save_detections(found, folder / name, source)
    lines = [" ".join(f"{v:.2f}" for v in corners.ravel()) + " small-vehicle 0\n" for corners in boxes.corners]
    (folder / "labels.txt").write_text("".join(lines))
    plain = [dict(zip(("cx", "cy", "length", "width", "angle"), row, strict=True)) for row in boxes.xylwa.tolist()]
    (folder / "plain.json").write_text(json.dumps({"ortho.tif": plain}))


def _strange(folder: Path) -> None:
    """Pictures of unusual types and sizes, and some that are far larger than their files."""
    rng = np.random.default_rng(0)
    kinds = {
        "float": ("float32", 3, 300, 300), "word": ("uint16", 1, 300, 300), "signed": ("int16", 4, 300, 300),
        "complex": ("complex64", 1, 300, 300), "bands": ("uint8", 17, 300, 300), "dot": ("uint8", 3, 1, 1),
        "line": ("uint8", 3, 1, 30000), "double": ("float64", 3, 300, 300),
        "radar": ("complex_int16", 1, 300, 300),
    }  # fmt: skip
    for name, (kind, count, height, width) in kinds.items():
        profile = {"driver": "GTiff", "width": width, "height": height, "count": count, "dtype": kind}
        with rasterio.open(folder / f"{name}.tif", "w", **profile) as file:
            data = rng.uniform(0, 200, (count, height, width)).astype("int16" if name == "radar" else kind)
            if name in ("float", "double"):
                data[:, ::3] = np.nan
            file.write(data)
    place = {
        "nan": from_origin(np.nan, 0, 0.1, 0.1),
        "zero": from_origin(0, 0, 0, 0),
        "huge": from_origin(1e300, 0, 1e300, 1),
    }
    for name, transform in place.items():
        profile = {"driver": "GTiff", "width": 300, "height": 300, "count": 3, "dtype": "uint8", "transform": transform}
        with rasterio.open(folder / f"{name}.tif", "w", **profile, crs="EPSG:32632") as file:
            file.write(np.full((3, 300, 300), 90, np.uint8))
    points = [GroundControlPoint(y, x, 0.1 * x, -0.1 * y) for x in (0, 300) for y in (0, 300)]
    points[0] = GroundControlPoint(0, 0, np.nan, 0)
    profile = {"driver": "GTiff", "width": 300, "height": 300, "count": 3, "dtype": "uint8", "crs": "EPSG:32632"}
    with rasterio.open(folder / "control.tif", "w", **profile, gcps=points) as file:
        file.write(np.full((3, 300, 300), 90, np.uint8))
    profile = {"driver": "GTiff", "count": 1, "dtype": "uint8", "SPARSE_OK": True, "compress": "deflate"}
    with rasterio.open(folder / "tiled20000.tif", "w", **profile, width=20000, height=20000, tiled=True):
        pass
    profile |= {"SPARSE_OK": False, "width": 20000, "height": 20000, "blockysize": 20000}
    with rasterio.open(folder / "strip20000.tif", "w", **profile) as file:
        file.write(np.zeros((1, 20000, 20000), np.uint8))
    (folder / "grey20000.png").write_bytes(png(20000, 20000))
    (folder / "bits20000.png").write_bytes(png(20000, 20000, 1))


def _large(folder: Path) -> None:
    """A frame of 108 megapixels, as large cameras take them."""
    cv2.imwrite(str(folder / "frame.jpg"), np.full((9000, 12000, 3), 90, np.uint8))


def _cache(folder: Path) -> None:
    """An orthophoto and the looks that were kept of it."""
    shutil.copy(folder.parent / "ortho/ortho.tif", folder)
    before = os.environ.get("ORTHOSCALE_CACHE")
    os.environ["ORTHOSCALE_CACHE"] = str(folder / "cache")
    try:
        _answer(folder, *ANSWERS["cache"])
    finally:
        os.environ.pop("ORTHOSCALE_CACHE") if before is None else os.environ.update(ORTHOSCALE_CACHE=before)


def _settings(folder: Path) -> None:
    """Fleet, calibration, similarity, catalogue, known points, a report; with the orthophoto that they are for."""
    _ortho(folder)
    (folder / "fleet.json").write_text(json.dumps(photos.CARS))
    parts = [{"class": c, "weight": 0.5, **photos.CARS} for c in ("small", "large")]
    (folder / "mixture.json").write_text(json.dumps({**photos.CARS, "mixture": parts}))
    shares = {"mini": 0.1, "small hatch": 0.5, "compact hatch": 0.4}
    (folder / "shares.json").write_text(json.dumps({**photos.CARS, "shares": shares}))
    known = Calibration("tiny", "ab" * 32, Ruler(), dict(photos.CARS), {"ortho": "x.tif"})
    save_calibration(known, folder / "calibration.json")
    Sim3(MODEL_SCALE).save(folder)
    own = {"name": "boules court", "length": 15, "width": 4, "ends": 1, "sides": 1, "source": "FIPJP"}
    (folder / "catalogue.json").write_text(
        json.dumps({"facilities": {"boules": {**own, "lines": [["line", 0, 0, 5, 0]]}}})
    )
    bays = {"kind": "parking bays", "metres": 2.5, "sd": 0.02, "name": "ours", "source": "a plan"}
    (folder / "standards.json").write_text(json.dumps({"standards": [bays]}))
    (folder / "control.txt").write_text("40,40 4 -4\n360,40 36 -4\n40,360 4 -36\n360,360 36 -36\n")
    said = in_process.run("estimate", folder / "ortho.tif", "--detections", folder / "boxes.json", "--json")
    (folder / "report.json").write_text(said.stdout)
    lots.orthophoto(folder, 0.2, (350, 250), report={"scale": 0.2, "interval90": [0.196, 0.204], "unit": "m/px"})
    lots.lot_file(folder / "lot.geojson", [(5, 5), (60, 5), (60, 40), (5, 40)])
    lots.lot_file(folder / "trees.geojson", [(50, 30), (55, 30), (55, 35), (50, 35)])


def _photos(folder: Path) -> None:
    """A flight of three photos with their tags, boxes, fleet and every form of lens calibration."""
    (folder / "flight").mkdir()
    xmp = (
        'drone-dji:GimbalPitchDegree="-60" drone-dji:GimbalRollDegree="0" drone-dji:GimbalYawDegree="30" '
        'drone-dji:RelativeAltitude="59.0"'
    )
    size = photos.SIZE
    exif = {0xA405: round(photos.FOCAL * np.hypot(36, 24) / np.hypot(*size))}
    for k, name in enumerate(("a.jpg", "b.jpg", "c.jpg")):
        photos.write_photo(folder / "flight" / name, xmp, exif, gps=(8.0 + 0.001 * k, 47.0))
    boxes = photos.boxes_in(photos.view_from(-60))
    found = photos.detections_of({"a.jpg": boxes, "b.jpg": boxes, "c.jpg": boxes[:4]})
    own_format.save_detections(found, folder / "boxes.json")
    (folder / "cars.json").write_text(json.dumps(photos.CARS))
    for name, text in photos.CALIBRATIONS.items():
        (folder / f"lens{Path(name).suffix}").write_text(text.replace("4000", "1000").replace("3000", "750"))
    _satellite(folder / "satellite.tif")


def _satellite(path: Path) -> None:
    picture = np.random.default_rng(0).integers(60, 180, (3, 600, 600), np.uint8)
    place = from_origin(424000, 5206000, 0.5, 0.5)  # about 8 E, 47 N
    profile = {"driver": "GTiff", "width": 600, "height": 600, "count": 3, "dtype": "uint8"}
    with rasterio.open(path, "w", **profile, crs="EPSG:32632", transform=place, tiled=True) as file:
        file.write(picture)


def _set(write: Callable, **options: object) -> Callable[[Path], None]:
    return lambda folder: write(make_scene(1, None, 80.0, 30), folder, pictures=False, **options)


def _geometry(folder: Path) -> None:
    """What `apply` scales: clouds, splat, meshes, glTF with its buffer, a dense workspace, depth maps, sim3."""
    Sim3(MODEL_SCALE).save(folder)
    xyz = np.random.default_rng(0).normal(0, 3, (40, 3))
    for form in ("ascii", "binary_little_endian", "binary_big_endian"):
        geometry.ply(folder / f"{form}.ply", form, ["x", "y", "z"], xyz, faces=True)
    splat = ["x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    geometry.ply(folder / "splat.ply", "binary_little_endian", splat, np.random.default_rng(1).normal(0, 1, (40, 11)))
    (folder / "mesh.obj").write_text("mtllib a.mtl\nv 1 2 3\nv -4 0.5 6 1 0 0\nv 0 0 1\nvn 0 0 1\nf 1//1 2//1 3//1\n")
    (folder / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    (folder / "a.png").write_bytes(cv2.imencode(".png", np.zeros((2, 2, 3), np.uint8))[1].tobytes())
    geometry.glb(folder / "scene.glb", geometry.gltf())
    (folder / "part.bin").write_bytes(struct.pack("<12f", *range(12)))
    buffers = {"buffers": [{"uri": "part.bin", "byteLength": 48}], "images": [{"uri": "a.png"}]}
    (folder / "scene.gltf").write_text(json.dumps(geometry.gltf(**buffers)))
    rows = np.zeros(3, geometry.PCD_ROW)
    for form in ("ascii", "binary", "binary_compressed"):
        (folder / f"{form}.pcd").write_bytes(geometry.pcd(form, geometry.pcd_body(form, rows)))
    (folder / "points.laz").write_bytes(geometry.las(b"laszip encoded", 22204, b"any", form=0x83))
    view = {"id": 0, "img_name": "a.jpg", "position": [1, 2, 3], "rotation": np.eye(3).tolist(), "fx": 50, "fy": 50}
    (folder / "cameras.json").write_text(json.dumps([view]))
    (folder / "points.xyz").write_text("x,y,z,class\n1,2,3,4\n-4,0.5,6e1,7\n")
    (folder / "mesh.off").write_text("COFF\n# a comment\n3 1 0\n1 2 3 255 0 0\n-4 0.5 6 0 0 0\n0 0 1 0 0 0\n3 0 1 2\n")
    triangle = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    (folder / "text.stl").write_text(f"solid a\n{triangle}endsolid a\n")
    (folder / "binary.stl").write_bytes(bytes(80) + struct.pack("<I12fH", 1, *range(12), 0))
    (folder / "points.splat").write_bytes(struct.pack("<6f8B", *range(14)) * 3)
    model = make_model(*PINHOLE, points=POINTS)[0]
    geometry.dense_workspace(folder / "dense", model)
    xyz = np.array([point.xyz for point in model.points3D.values()])
    cloud = np.repeat(xyz, 5, axis=0) + np.random.default_rng(2).normal(0, 0.02, (5 * len(xyz), 3))
    geometry.ply(folder / "dense/fused.ply", "binary_little_endian", ["x", "y", "z"], cloud)
    seen = np.tile(np.array([2, 0, 1], "<u4"), len(cloud))  # each point in the first two images
    (folder / "dense/fused.ply.vis").write_bytes(struct.pack("<Q", len(cloud)) + seen.tobytes())


def _networks(folder: Path) -> None:
    """Networks in every layout, tiny, one of them with a card of orthoscale's; and the picture that they look at."""
    _ortho(folder)
    for name in RASTERS[1:]:
        (folder / name).unlink()
    for name, outputs, metadata in (
        ("ultralytics", {"output0": networks.raw()}, networks.NAMES),
        ("nms-free", {"output0": networks.nms_free()}, {**networks.NAMES, "end2end": "True"}),
        ("mmrotate", networks.mmrotate(), {}),
    ):
        networks.network(folder / f"{name}.onnx", outputs, metadata)
    card_network(folder / "card.onnx", json.dumps(CARD))


PLANS = ("@", "--detections", "@/boxes.json", "--mode", "planar")
ANSWERS: dict[str, tuple[str, ...]] = {kind: PLANS for kind in MODELS} | {"cache": ("@/ortho.tif", "--zoom", "1")}
KINDS: dict[str, Callable[[Path], None]] = {
    "colmap-bin": _colmap("bin"),
    "colmap-txt": _colmap("txt"),
    "rig-bin": _colmap("bin", rig=True),
    "rig-txt": _colmap("txt", rig=True),
    "other-bin": _another("bin"),
    "other-txt": _another("txt"),
    "opensfm": _other(others.opensfm),
    "nerfstudio": _other(others.nerfstudio),
    "bundler": _other(others.bundler),
    "nvm": _other(others.nvm),
    "ortho": _ortho,
    "strange": _strange,
    "large": _large,
    "cache": _cache,
    "settings": _settings,
    "photos": _photos,
    "denseuav": _set(write_denseuav, places=1),
    "visloc": _set(write_visloc, regions=("01",)),
    "csv": _set(write_csv),
    "geometry": _geometry,
    "networks": _networks,
}
