"""Every JSON reader against every kind of damage: refused in one line, with exit code 5, and at once."""

import json
import os
import re
from inspect import Parameter, isfunction, signature
from pathlib import Path

import pytest

import orthoscale
from orthoscale.cli.explain import explain
from orthoscale.detect.detector import Card
from orthoscale.detect.output_forms import _pipeline_normalisation
from orthoscale.errors import InputError, OrthoscaleError, shown
from orthoscale.fleets import load_fleet
from orthoscale.formats import reading
from orthoscale.formats.calibration import load_calibration
from orthoscale.formats.detections import load
from orthoscale.formats.detections.own import load_detections
from orthoscale.formats.geometry.sim3 import Sim3
from orthoscale.layout import catalogue
from orthoscale.layout.ground import _polygons
from orthoscale.report.stored import read_json
from orthoscale.sources.json_model import ExchangeSource
from orthoscale.sources.lens import read_calibration
from orthoscale.sources.scaling import scale_path

RULER = {"margin": [0, 0], "margin_sd": [1, 1], "bias_sd": [0.01, 0.01], "noise": [1, 1]}
BOX = {"cx": 30, "cy": 20, "length": 40, "width": 17, "angle": 0.1, "score": 0.9}
NOTE = {"zoom": 1, "effective_height": [0.7, 0.5], "detector_sha256": "", "ruler": RULER}
FLEET = {
    "name": "cars", "source": "a test", "year": 2020, "length": [4.4, 0.4], "width": [1.8, 0.1], "height": [1.5, 0.1],
    "mean_sd": [0.05, 0.02, 0.05], "shares": {"mini": 0.3, "mid": 0.7},
}  # fmt: skip
SHAPE = {"type": "Polygon", "coordinates": [[[10, 20], [50, 20], [50, 37], [10, 37], [10, 20]]]}
COCO = {
    "info": {"orthoscale": NOTE},
    "images": [{"id": 1, "file_name": "ortho.tif", "width": 320, "height": 240}],
    "categories": [{"id": 1, "name": "car"}],
    "annotations": [{"image_id": 1, "category_id": 1, "segmentation": [[10, 20, 50, 20, 50, 37, 10, 37]], "score": 1}],
}
CARD = {
    "name": "net", "usable_length": [12, 70], "best_length": 38, "score": 0.4, "effective_height": [0.7, 0.4],
    "ruler": RULER, "stride": 32, "normalisation": {"mean": [0, 0, 0], "std": [1, 1, 1]},
}  # fmt: skip
SIZE = {"mean": 4.4, "sd": 0.4, "mean_sd": 0.1}
REPORT = {
    "format": "orthoscale report 2", "fit": "", "judgements": [],
    "scale": 0.1, "unit": "m/px", "interval90": [0.09, 0.11], "verdict": "good",
    "uncertainty": {"sampling": 0.01}, "vehicles_used": 9, "fleet": "DE", "vehicles_rejected": {}, "boxes_rejected": {},
    "fleet_sizes": {"length": SIZE, "width": SIZE, "classes": []}, "checks": {}, "settings": {},
    "remarks": [{"severity": "info", "text": "a remark"}],
    "input": {"path": "a.tif", "sha256": "", "folder": "", "kind": "orthophoto"}, "pictures": {"a.tif": [320, 240]},
    "vehicles": [], "evidence": [], "anchors": [], "fleets": {}, "claim": None, "drift": None, "seconds": 1.0,
    "frame_bytes": {}, "frame_crc32": {}, "other_files": {}, "pixel_aspect": 1.0,
}  # fmt: skip
POSE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]]
TRANSFORMS = {"w": 100, "h": 80, "fl_x": 90, "frames": [{"file_path": "a.jpg", "transform_matrix": POSE}]}
RECONSTRUCTION = [
    {
        "cameras": {"c": {"width": 100, "height": 80, "focal": 0.9}},
        "shots": {"a.jpg": {"rotation": [0, 0, 0], "translation": [0, 0, 5], "camera": "c"}},
        "points": {"1": {"coordinates": [0, 0, 0], "color": [9, 9, 9]}},
    }
]
GLTF = {"asset": {"version": "2.0"}, "nodes": [{}], "scenes": [{"nodes": [0]}], "buffers": [{"uri": "b.bin"}]}
CALIBRATION = {
    "kind": "orthoscale calibration 1", "detector": "net", "detector_sha256": "", "ruler": RULER, "fleet": FLEET,
    "made_from": {},
}  # fmt: skip
SIM3 = {"scale": 2.5, "rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}
LENS = {"width": 4000, "height": 3000, "fx": 3000, "k1": -0.1}
FACILITY = {"name": "court", "source": "a test", "length": 20, "width": 10, "lines": [["line", 0, 0, 5, 5]]}
PIPELINE = {"pipeline": {"tasks": [{"transforms": [{"type": "Normalize", "mean": [0, 0, 0], "std": [1, 1, 1]}]}]}}


class Ortho:
    """A source of one picture of 320 x 240 px."""

    unit, path, picture_names, claimed = "m/px", Path("ortho.tif"), ["ortho.tif"], None

    def __init__(self):
        self.notes = []

    def image_size(self, name):
        return 320, 240

    @property
    def pictures(self):
        class Whole:
            name, width, height = "ortho.tif", 320, 240

        return [Whole]


def scaled(path):
    scale_path(path, path.with_name("out" + path.suffix), 2.0)


def sketched(path):
    """`scaled` for cameras, whose clouds need not be there."""
    ExchangeSource.open(path, need_images=False)


# File name, how it is read, what is valid in it, and a place in that with a value of a wrong kind there.
READERS = {
    "detections": ("d.json", load_detections, {**NOTE, "pictures": {"a": [BOX], "b": [BOX]}}, ("pictures", "b", 0)),
    "plain detections": ("d.json", load_detections, {"a": [BOX], "b": [BOX, BOX]}, ("b", 1, "length")),
    "coco": ("d.coco.json", lambda p: load(p, Ortho()), COCO, ("images",)),
    "geojson": ("d.geojson", lambda p: load(p, Ortho()), {"type": "FeatureCollection", "orthoscale": NOTE, "features": [
        {"type": "Feature", "geometry": SHAPE, "properties": {"score": 1}}]}, ("features", 0, "geometry")),
    "fleet": ("f.json", load_fleet, FLEET, ("shares",)),
    "calibration": ("c.json", load_calibration, CALIBRATION, ("ruler", "margin")),
    "report": ("r.json", read_json, REPORT, ("fleet_sizes", "length")),
    "explained report": ("r.json", lambda p: explain.callback(p, False), REPORT, ("uncertainty",)),
    "lens": ("l.json", read_calibration, LENS, ("fx",)),
    "catalogue": ("k.json", catalogue.load, {"facilities": {"own": FACILITY}}, ("facilities", "own", "length")),
    "lot": ("lot.geojson", _polygons, {"type": "FeatureCollection", "features": [
        {"type": "Feature", "geometry": SHAPE, "properties": {}}]}, ("features", 0, "geometry")),
    "sim3": ("s.json", Sim3.load, SIM3, ("translation",)),
    "transforms": ("transforms.json", scaled, TRANSFORMS, ("frames", 0, "transform_matrix")),
    "reconstruction": ("reconstruction.json", scaled, RECONSTRUCTION, (0, "shots", "a.jpg", "translation")),
    "model": ("reconstruction.json", sketched, RECONSTRUCTION, (0, "cameras", "c", "focal")),
    "gltf": ("m.gltf", scaled, GLTF, ("buffers",)),
    "pipeline": ("pipeline.json", lambda p: _pipeline_normalisation(p.with_name("net.onnx")), PIPELINE, ("pipeline",)),
    "card": ("card.json", lambda p: Card.from_json(p.read_text("utf-8", "surrogateescape"), str(p)), CARD, ("ruler",)),
}  # fmt: skip
FROM_FILES = [name for name in READERS if name not in ("card",)]


def damaged(values, place, new):
    """`values` with `new` at `place`."""
    if not place:
        return new
    copy = dict(values) if isinstance(values, dict) else list(values)
    copy[place[0]] = damaged(values[place[0]], place[1:], new) if len(place) > 1 else new
    return copy


def refusal(read, path):
    with pytest.raises(InputError) as raised:
        read(path)
    assert raised.value.exit_code == 5 and raised.value.hint
    message = raised.value.message
    assert str(path) in message and message.isprintable() and len(message) < 1000 + len(str(path))
    for word in ("Error", "Traceback", "NoneType", "float'", "dict", "invalid literal", "could not convert"):
        assert word not in message
    return message


@pytest.mark.parametrize("reader", READERS)
def test_what_is_valid_is_read(tmp_path, reader):
    name, read, valid, _ = READERS[reader]
    (tmp_path / name).write_text(json.dumps(valid))
    read(tmp_path / name)


DEEP = "[" * 100_000 + "]" * 100_000
WHOLE_FILES = {
    "deep": DEEP.encode(),
    "deep objects": b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
    "too deep for a format": b'{"a":' * 80 + b"1" + b"}" * 80,
    "empty": b"",
    "text": b'"text"',
    "a number": b"17",
    "null": b"null",
    "long number": b"9" * 6000,
    "infinite": b'{"a": 1e999}',
    "not UTF-8": b'{"a": "\xff\xfe\xfa"}',
    "UTF-16": '{"a": 1}'.encode("utf-16"),
    "no JSON": b"<html>",
    "zeros": bytes(100),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("fault", WHOLE_FILES)
def test_a_damaged_file_is_refused(tmp_path, reader, fault):
    name, read, _, _ = READERS[reader]
    (tmp_path / name).write_bytes(WHOLE_FILES[fault])
    refusal(read, tmp_path / name)


@pytest.mark.parametrize("reader", READERS)
def test_a_byte_order_mark_and_a_cut_are_named(tmp_path, reader):
    name, read, valid, _ = READERS[reader]
    content = json.dumps(valid).encode()
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + content)
    assert "byte order mark" in refusal(read, tmp_path / name)
    (tmp_path / name).write_bytes(content[: len(content) // 2])
    refusal(read, tmp_path / name)


WRONG = {
    "text": '"\\u001b[31m"',
    "true": "true",
    "NaN": "NaN",
    "infinite": "-Infinity",
    "too large": "1e400",
    "huge whole": "1" + "0" * 400,
    "list": "[[[]]]",
    "object": '{"\\u0007": ["x"]}',
    "deep": DEEP,
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("fault", WRONG)
def test_a_value_of_a_wrong_kind_is_refused(tmp_path, reader, fault):
    name, read, valid, place = READERS[reader]
    text = json.dumps(damaged(valid, place, "HERE")).replace('"HERE"', WRONG[fault])
    (tmp_path / name).write_text(text)
    message = refusal(read, tmp_path / name)
    if fault == "text" and len(place) > 1 and reader != "lot":  # GDAL reads those
        assert str(place[0]) in message, "the message names the place"


@pytest.mark.parametrize("reader", FROM_FILES)
def test_what_is_no_file_is_refused_at_once(tmp_path, reader):
    name, read, _, _ = READERS[reader]
    os.mkfifo(tmp_path / name)
    refusal(read, tmp_path / name)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to("/dev/zero")
    refusal(read, tmp_path / name)
    (tmp_path / name).unlink()
    (tmp_path / name).mkdir()
    if reader not in (
        "coco",
        "geojson",
        "gltf",
        "transforms",
        "reconstruction",
        "model",
        "lot",
    ):  # folders have a meaning
        refusal(read, tmp_path / name)


def test_a_file_larger_than_its_kind_may_be_is_not_read(tmp_path):
    with (tmp_path / "f.json").open("wb") as file:
        file.truncate(5 << 20)
    assert "larger than the 4 MiB" in refusal(load_fleet, tmp_path / "f.json")


def test_the_place_is_named_to_the_key(tmp_path):
    pictures = {f"{k}.jpg": [BOX] * 3 for k in range(50)}
    pictures["37.jpg"] = [BOX, BOX, {**BOX, "length": -4}]
    path = tmp_path / "d.json"
    path.write_text(json.dumps({**NOTE, "pictures": pictures}))
    message = refusal(load_detections, path)
    assert message.endswith('not a detections file (pictures["37.jpg"][2].length: expected a positive number)')


def test_forged_strings_stay_short_and_plain(tmp_path):
    path = tmp_path / "d.json"
    forged = "\x1b[2J\r\n" + "x" * 100_000
    path.write_text(json.dumps({**NOTE, "pictures": {forged: [{**BOX, "cx": "left"}]}}))
    assert len(refusal(load_detections, path)) < 300 + len(str(path))
    path.write_text(json.dumps({**NOTE, "ruler": {**RULER, forged: 1}, "pictures": {}}))
    assert len(refusal(load_detections, path)) < 300 + len(str(path))
    error = OrthoscaleError(f"a picture called {forged}", "\x07hint")
    assert error.message.isprintable() and len(error.message) < 2000 and error.hint == "\\x07hint"
    assert shown("Straße 東京") == "Straße 東京"


RULERS = [
    {"margin": [1, 2, 3]}, {"margin": []}, {"margin": 1}, {"margin_sd": [-1, 1]}, {"margin_sd": [9.2e18, 1]},
    {"noise": [-1, 1]}, {"noise": [1e300, 1]}, {"bias_sd": [2, 2]}, {"shrink": [1, 0]}, {"usual": [0, 1]},
    {"common_sd": -0.1}, {"common_sd": [0.1, 0.1]}, {"margins": [0, 0]}, [], "ruler",
]  # fmt: skip


@pytest.mark.parametrize("ruler", RULERS)
@pytest.mark.parametrize(
    "reader, place", [("detections", ()), ("calibration", ()), ("card", ()), ("coco", ("info", "orthoscale"))]
)
def test_a_ruler_that_measures_nothing_is_refused_wherever_it_stands(tmp_path, ruler, reader, place):
    name, read, valid, _ = READERS[reader]
    (tmp_path / name).write_text(json.dumps(damaged(valid, (*place, "ruler"), ruler)))
    assert "ruler" in refusal(read, tmp_path / name)


# What a message calls a place whose own name is not in it.
CALLED = {"coordinates": "corners|numbers|no polygon", "features": "not a vector file", "shares": "share|segment"}


@pytest.mark.parametrize(
    "reader, place, value",
    [
        *(("detections", ("zoom",), v) for v in (0, -1, 1e9, "1", None)),
        *(("detections", ("pictures", "a", 0, "score"), v) for v in (-0.1, 1.5, None)),
        ("detections", ("body",), "boat"),
        ("detections", ("effective_height",), [-1, 1]),
        *(("fleet", ("shares",), v) for v in ({"mini": -1, "mid": 2}, {"mini": 0}, {}, [1], {"mini": 1e300})),
        ("fleet", ("shares",), {"lorry": 1}),
        *(("fleet", ("length",), v) for v in ([4400, 300], [4.4], [4.4, 0], [-4, 1], [1e200, 1])),
        ("fleet", ("mixture",), [{"class": "a", "weight": 0, "length": [4, 1], "width": [2, 0.5], "height": [1, 0.5]}]),
        *(("card", ("stride",), v) for v in (0, -32, "32", 10**9, 1.5)),
        *(("card", ("score",), v) for v in ("high", -1, 2)),
        ("card", ("usable_length",), [70, 12]),
        ("card", ("normalisation", "std"), [0, 1, 1]),
        ("card", ("normalisation", "channels"), "GBR"),
        *(("lens", ("fx",), v) for v in (0, -5, 1e300)),
        ("lens", ("width",), 0),
        *(("sim3", (k,), v) for k, v in (("scale", "x"), ("rotation_wxyz", [1, 0, 0]), ("translation", [1, 2, 1e300]))),
        *(("catalogue", ("facilities", "own", "lines"), [v]) for v in (["line", 1], ["circle", 1], [1, 2], [])),
        ("catalogue", ("facilities", "own", "lines"), [["line", 0, 0, 0, "x"]]),
        ("catalogue", ("facilities", "own", "infield"), "own"),
        ("catalogue", ("facilities", "own", "infield"), "nothing"),
        ("catalogue", ("facilities", "own", "colour"), [1, 2]),
        *(("gltf", ("images",), v) for v in ({}, ["a.png"], [{"uri": 5}], "none")),
        *(("gltf", ("scenes",), v) for v in ([{"nodes": [-1]}], [{"nodes": [7]}], [{"nodes": ["0"]}], [0])),
        ("coco", ("info",), "by hand"),
        ("coco", ("images", 0, "width"), -5),
        ("coco", ("annotations", 0, "segmentation"), [[1, 2, 3]]),
        ("coco", ("annotations", 0, "score"), 7),
        ("geojson", ("features", 0, "properties"), [1]),
        ("geojson", ("features", 0, "properties", "score"), 99),
        ("geojson", ("features", 0, "geometry", "coordinates"), {"a": 1}),
        ("geojson", ("features", 0, "geometry", "coordinates"), [[[1e300, 0], [0, 1e300], [1, 1]]]),
        ("reconstruction", (), []),
        ("lot", ("features", 0, "geometry", "coordinates"), [[[1e300, 0], [0, 1e300], [1, 1], [1e300, 0]]]),
        ("lot", ("features",), 5),
        ("transforms", ("frames",), {}),
        ("model", (0, "cameras", "c", "width"), 10**12),
        ("report", ("vehicles",), [{"length": "long"}]),
        ("report", ("interval90",), [0.1]),
        ("explained report", ("uncertainty",), {"sampling": -1}),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_meant_is_refused(tmp_path, reader, place, value):
    """And not for something else that is wrong beside it."""
    name, read, valid, _ = READERS[reader]
    (tmp_path / name).write_text(json.dumps(damaged(valid, place, value)))
    message = refusal(read, tmp_path / name)
    named = next((part for part in reversed(place) if isinstance(part, str)), "none")
    assert re.search(CALLED.get(named, named.rstrip("s")), message.replace(str(tmp_path), "")), message


def test_the_limits_of_a_number_are_told_as_they_are(tmp_path):
    for zoom, told in ((0, "zoom: expected a number > 0.0001)"), ("1", "zoom: expected a number, found text)")):
        (tmp_path / "d.json").write_text(json.dumps({**NOTE, "pictures": {}, "zoom": zoom}))
        assert refusal(load_detections, tmp_path / "d.json").endswith(told)
    (tmp_path / "l.json").write_text(json.dumps({**LENS, "fx": 0}))
    assert refusal(read_calibration, tmp_path / "l.json").endswith("(fx: expected a positive number)")


def test_every_reader_of_files_is_given_a_hint_for_its_errors():
    here = [each for each in vars(reading).values() if getattr(each, "__module__", "") == reading.__name__]
    given = [hint for each in here if isfunction(each) and (hint := signature(each).parameters.get("hint"))]
    assert len(given) > 8 and all(hint.default is Parameter.empty for hint in given)
    with pytest.raises(InputError, match="install it again"):
        reading.shipped("no such table")


def test_the_tables_that_are_shipped_are_made_as_they_should():
    from support.tables import TABLES

    data = Path(orthoscale.__file__).parent / "data"
    for name, schema in TABLES.items():
        reading.read(data / f"{name}.json", schema, "a table", "")
    with pytest.raises(InputError):
        reading.read(data / "stalls.json", TABLES["objects"], "a table", "")
