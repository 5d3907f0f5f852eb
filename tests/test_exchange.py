"""Detections of others and for others: every format gives back what went in; what fits no box is refused in words."""

import json
import os
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unicodedata import normalize

import cv2
import numpy as np
import pyogrio
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from rasterio.control import GroundControlPoint
from support.in_process import run
from support.models import make_model
from support.models import save as save_model
from support.photos import write_photo

import orthoscale
from orthoscale.cli.main import cli
from orthoscale.core.affine import transformed
from orthoscale.core.boxes import Boxes, overlap
from orthoscale.core.detections import UNKNOWN_RULER, Detections
from orthoscale.core.ruler import Ruler
from orthoscale.errors import InputError, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections import load, save
from orthoscale.formats.detections.items import rectangles
from orthoscale.formats.detections.own import about, load_detections
from orthoscale.sources.georeference import LOCAL_CRS
from orthoscale.sources.opening import open_source

RULER = Ruler((0.5, 1.0), (0.3, 0.4), (0.01, 0.02), 0.01, (1.0, 0.8))
BOXES = Boxes(
    np.array([[100.25, 80.5, 41, 17, 0.3], [200, 120, 38.5, 16.25, -1.2], [60, 160, 44, 18, np.pi / 4]]),
    np.array([0.95, 0.75, 0.5]),
)


def raster(path, crs=None, transform=None, size=(320, 240), **more):
    profile = {"driver": "GTiff", "width": size[0], "height": size[1], "count": 3, "dtype": "uint8", "crs": crs, **more}
    if transform is not None:
        profile["transform"] = transform
    with warnings.catch_warnings(action="ignore"), rasterio.open(path, "w", **profile) as file:
        file.write(np.full((3, *size[::-1]), 90, np.uint8))
    return open_source(path)


PLACES = {
    "no georeferencing": (None, None),
    "UTM": ("EPSG:32651", Affine(0.1, 0, 284000.5, 0, -0.1, 1615000.25)),
    "rotated": ("EPSG:32651", Affine(0.08, 0.06, 284000.5, 0.06, -0.08, 1615000.25)),
    "degrees": ("EPSG:4326", Affine(9e-7, 0, 121.0, 0, -9e-7, 14.6)),
    "local metres": (LOCAL_CRS, Affine(0.1, 0, 0, 0, -0.1, 24)),
    "placeholder": ("EPSG:32630", Affine(0.1, 0, 0, 0, -0.1, 0)),
    "Web Mercator": ("EPSG:3857", Affine(0.1, 0, 13467532.0, 0, -0.1, 1632019.9)),
}


@pytest.fixture(scope="module", params=PLACES)
def source(request, tmp_path_factory):
    return raster(tmp_path_factory.mktemp("place") / "ortho.tif", *PLACES[request.param])


def test_boxes_of_a_picture_whose_name_is_not_utf_8_read_back(tmp_path):
    name = "caf\udce9.jpg"
    picture = SimpleNamespace(name=name, width=320, height=240)
    album = SimpleNamespace(
        path=tmp_path, notes=[], claimed=None, pictures=[picture], picture_names=[name], image_size=lambda _: (320, 240)
    )
    for form in ("d.json", "d.coco.json", "d.geojson", "d.gpkg"):
        there = {name: BOXES}
        found = Detections(there, 0.8, RULER, (0.7, 0.5), "test", "abc", doubtful=there, set_aside={"alike": there})
        save(found, tmp_path / form, album)
        again = load(tmp_path / form, album)
        assert [*again.boxes, *again.doubtful, *again.set_aside["alike"]] == [name] * 3, form


def test_what_was_seen_in_other_models_pictures_is_left_out(tmp_path):
    """Whether it counted or not: of two models of a workspace, boxes of both are in one file."""
    frames = pictures_of(["a.jpg", "b.jpg"], tmp_path)
    other = {"other.jpg": BOXES}
    found = Detections({"a.jpg": BOXES}, 0.8, RULER, (0.7, 0.5), "test", doubtful={"b.jpg": BOXES, **other})
    found = replace(found, set_aside={"alike": other}, objects={"other.jpg": {"tennis-court": BOXES}})
    save(found, tmp_path / "d.json", frames)
    again = load(tmp_path / "d.json", frames)
    assert (list(again.doubtful), again.set_aside, again.objects) == (["b.jpg"], {"alike": {}}, {})


@pytest.mark.parametrize("ending", ["json", "coco.json", "geojson", "gpkg"])
def test_boxes_of_a_file_whose_name_is_not_utf_8_are_saved_and_read_back(tmp_path, ending):
    """What found them is called like their file."""
    Image.fromarray(np.zeros((240, 320, 3), np.uint8)).save(tmp_path / "a.png")
    path = tmp_path / os.fsdecode(b"caf\xe9.json")
    path.write_text(json.dumps({"a.png": [{"cx": 30, "cy": 20, "length": 40, "width": 17, "angle": 0.1, "score": 1}]}))
    source = open_source(tmp_path / "a.png")
    save(load(path, source), tmp_path / f"b.{ending}", source)
    again = load(tmp_path / f"b.{ending}", source)
    assert len(again) == 1 and again.detector == r"boxes of caf\udce9.json"


def test_boxes_saved_without_their_picture_are_json_that_strict_readers_take(tmp_path):
    orthoscale.save_detections(
        Detections({"caf\udce9.jpg": BOXES}, 0.8, RULER, (0.7, 0.5), "test"), tmp_path / "d.json"
    )
    assert list(load_detections(tmp_path / "d.json").boxes) == [r"caf\udce9.jpg"]


@pytest.mark.parametrize("name", ["d.json", "d.coco.json", "d.txt", "d.geojson", "d.gpkg"])
def test_what_is_saved_reads_back(source, tmp_path, name):
    found = Detections({"ortho.tif": BOXES}, 0.8, RULER, (0.7, 0.5), "test", "abc")
    save(found, tmp_path / name, source)
    again = load(tmp_path / name, source)
    assert again.boxes["ortho.tif"].xylwa == pytest.approx(BOXES.xylwa, abs=0.02)
    assert again.boxes["ortho.tif"].score == pytest.approx(BOXES.score, abs=1e-3)
    if name != "d.txt":  # the one format that has no room for it
        assert about(again) == about(found)
    else:
        assert (again.zoom, again.ruler) == (1.0, UNKNOWN_RULER)


def test_boxes_lie_where_ground_control_points_place_the_picture(tmp_path):
    """Those of a program that made a warped copy of it fit, and ours fit the copy."""
    crs, t = PLACES["rotated"]
    corners = [(0, 0), (320, 0), (320, 240), (0, 240)]
    points = [GroundControlPoint(y, x, *transformed((x, y), t)) for x, y in corners]
    for folder in ("known", "pointed"):
        (tmp_path / folder).mkdir()
    known = raster(tmp_path / "known" / "ortho.tif", crs, t)
    pointed = raster(tmp_path / "pointed" / "ortho.tif", crs, gcps=points)
    found = Detections({"ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), "test")
    for name in ("d.geojson", "d.gpkg"):
        save(found, tmp_path / name, known)
        assert load(tmp_path / name, pointed).boxes["ortho.tif"].xylwa == pytest.approx(BOXES.xylwa, abs=0.02)
        save(found, tmp_path / name, pointed)
        assert load(tmp_path / name, known).boxes["ortho.tif"].xylwa == pytest.approx(BOXES.xylwa, abs=0.02)


@pytest.mark.parametrize("name", ["local metres", "placeholder", "no georeferencing"])
def test_geojson_of_a_picture_that_lies_nowhere_has_pixels(tmp_path, name):
    source = raster(tmp_path / "ortho.tif", *PLACES[name])
    save(Detections({"ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), "test"), tmp_path / "d.geojson", source)
    text = json.loads((tmp_path / "d.geojson").read_text())
    assert text["orthoscale"]["coordinates"] == "pixels"
    ring = np.array(text["features"][0]["geometry"]["coordinates"][0])[:4]
    assert ring * [1, -1] == pytest.approx(BOXES.corners[0], abs=1e-3)
    assert "orthoscale pixels" in pyogrio.read_info(tmp_path / "d.geojson")["crs"], "GDAL takes them for degrees"


def test_many_pictures_keep_their_names(tmp_path):
    class Frames:
        claimed, pictures, path = None, (), tmp_path
        picture_names = ("a/1.jpg", "a/2.jpg", "b/2.png")

        def image_size(self, name):
            return 4000, 3000

    boxes = {"a/1.jpg": BOXES, "a/2.jpg": BOXES[:1], "b/2.png": BOXES[1:]}
    for name in ("d.coco.json", "d.txt", "d.geojson", "d.gpkg"):
        save(Detections(boxes, 1.0, RULER, (0.7, 0.5), "test"), tmp_path / name, Frames())
        again = load(tmp_path / name, Frames()).boxes
        assert {k: len(v) for k, v in again.items()} == {"a/1.jpg": 3, "a/2.jpg": 1, "b/2.png": 2}
    with pytest.raises(InputError, match="several pictures are called '2'"):
        (tmp_path / "2.txt").write_text("2 0.9 0 0 4 0 4 2 0 2\n")
        load(tmp_path / "2.txt", Frames())


class Flight:
    """Frames of 640 x 480 px in a folder, with a marked letter in their names."""

    claimed, pictures, path, folder = None, (), Path("model"), "flight"

    def __init__(self, start="flight/"):
        self.picture_names = tuple(f"{start}{normalize('NFC', 'ä')} {k}.jpg" for k in range(3))
        self.notes = []

    def image_size(self, name):
        return 640, 480


@pytest.mark.parametrize("form", ["NFC", "NFD"])
@pytest.mark.parametrize("name", ["d.json", "d.coco.json", "d.geojson", "d.gpkg"])
def test_names_whose_marked_letters_are_two_characters_are_the_same(tmp_path, name, form):
    """macOS writes them so, and they look alike: "none of its 3 pictures is in the model"."""
    flight, theirs = Flight(), Flight()
    theirs.picture_names = tuple(normalize(form, picture) for picture in flight.picture_names)
    save(Detections(dict.fromkeys(theirs.picture_names, BOXES), 1.0, RULER, (0.7, 0.5), ""), tmp_path / name, theirs)
    assert sorted(load(tmp_path / name, flight).boxes) == list(flight.picture_names) and not flight.notes


@pytest.mark.parametrize("name", ["d.json", "d.coco.json", "d.geojson", "d.gpkg"])
@pytest.mark.parametrize("theirs, ours", [("a\u0308.jpg", "\u00e4.jpg"), ("caf\udce9.jpg", "caf\udce9.jpg")])
def test_ground_pictures_are_recognised_by_the_names_of_their_frames(tmp_path, name, theirs, ours):
    """With marked letters of two characters, or not in UTF-8, the boxes from above were lost without a word."""
    above = Detections({f"ground/{theirs}": BOXES}, 1.0, RULER, (0.7, 0.5), "")
    found = replace(above, boxes={theirs: BOXES}, planar=above)
    save(found, tmp_path / name, sized([theirs], (640, 480)))
    again = load(tmp_path / name, sized([ours], (640, 480)))
    assert list(again.boxes) == [ours] and again.planar is not None
    assert list(again.planar.boxes) == [f"ground/{ours}"]


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_names_that_differ_only_by_their_form_stay_apart(tmp_path, form):
    flight = Flight()
    flight.picture_names = tuple(normalize(each, "ä.jpg") for each in ("NFC", "NFD"))
    boxes = {normalize(form, "ä.jpg"): BOXES}
    save(Detections(boxes, 1.0, RULER, (0.7, 0.5), ""), tmp_path / "d.json", flight)
    assert list(load(tmp_path / "d.json", flight).boxes) == list(boxes)


@pytest.mark.parametrize("start", ["flight/", "C:\\flight\\"])
@pytest.mark.parametrize("change", [str, lambda n: Path(n).name, lambda n: n[:-4], lambda n: Path(n).stem])
def test_sizes_in_coco_are_compared_whatever_name_a_picture_has(tmp_path, start, change):
    """With names without the folder or the ending they were not: a scale twice too large was given."""
    flight = Flight(start)
    save(Detections({flight.picture_names[0]: BOXES}, 1.0, RULER, (0.7, 0.5), ""), tmp_path / "d.coco.json", flight)
    text = json.loads((tmp_path / "d.coco.json").read_text())
    (image,) = text["images"]
    image["file_name"] = change(image["file_name"].replace("\\", "/"))
    (tmp_path / "d.coco.json").write_text(json.dumps(text))
    assert list(load(tmp_path / "d.coco.json", flight).boxes) == [flight.picture_names[0]]
    image["width"], image["height"] = 320, 240
    (tmp_path / "d.coco.json").write_text(json.dumps(text))
    with pytest.raises(InputError, match="has 320 x 240 px, the source's 640 x 480"):
        load(tmp_path / "d.coco.json", flight)


def sized(names, size):
    class Frames:
        claimed, pictures, path, picture_names, notes = None, (), Path("model"), names, []

        def image_size(self, name):
            return size

    return Frames()


@pytest.mark.parametrize("name", ["d.json", "d.coco.json", "d.geojson", "d.gpkg"])
def test_boxes_of_pictures_that_were_resized_later_are_refused(tmp_path, name):
    """All boxes lie within the larger pictures: a scale twice too large was given without a word."""
    save(
        Detections({"a.jpg": BOXES}, 1.0, RULER, (0.7, 0.5), ""), tmp_path / name, sized(["a.jpg", "b.jpg"], (320, 240))
    )
    assert load(tmp_path / name, sized(["a.jpg", "b.jpg"], (320, 240))).sizes == {"a.jpg": (320, 240)}
    for pictures in (["a.jpg", "b.jpg"], ["other.jpg"]):
        with pytest.raises(InputError, match=r"jpg has 320 x 240 px, the source's 640 x 480"):
            load(tmp_path / name, sized(pictures, (640, 480)))


def test_boxes_in_ground_pictures_are_of_frames_of_one_size_too(tmp_path):
    above = Detections({"ground/a.jpg": BOXES}, 1.0, RULER, (0.7, 0.5), "")
    found = replace(above, boxes={"a.jpg": BOXES[:0]}, planar=above)
    save(found, tmp_path / "d.json", sized(["a.jpg"], (320, 240)))
    with pytest.raises(InputError, match=r"has 320 x 240 px, the source's 640 x 480"):
        load(tmp_path / "d.json", sized(["a.jpg"], (640, 480)))


def test_boxes_that_python_saves_of_a_result_have_their_sizes(tmp_path):
    source = sized(["a.jpg", "b.jpg"], (320, 240))
    found = Detections({"a.jpg": BOXES}, 1.0, RULER, (0.7, 0.5), "").made_on(source)
    orthoscale.save_detections(found, tmp_path / "d.json")
    assert load_detections(tmp_path / "d.json").sizes == {"a.jpg": (320, 240)}


@pytest.mark.parametrize("sizes", [{"ortho.tif": [0, 4]}, {"ortho.tif": [4]}, {"ortho.tif": 4}, ["ortho.tif"]])
def test_impossible_sizes_are_refused(tmp_path, sizes):
    save(Detections({"a.jpg": BOXES}, 1.0, RULER, (0.7, 0.5), ""), tmp_path / "d.json", sized(["a.jpg"], (320, 240)))
    text = json.loads((tmp_path / "d.json").read_text())
    (tmp_path / "d.json").write_text(json.dumps({**text, "picture_sizes": sizes}))
    with pytest.raises(InputError, match="picture_sizes"):
        load(tmp_path / "d.json", sized(["a.jpg"], (320, 240)))


@pytest.mark.parametrize("name", ["d.geojson", "d.gpkg"])
def test_boxes_on_the_map_fit_another_cut_of_a_picture_but_no_resampled_one(tmp_path, name):
    crs, t = PLACES["UTM"]
    for folder in ("whole", "cut", "larger"):
        (tmp_path / folder).mkdir()
    whole = raster(tmp_path / "whole/ortho.tif", crs, t)
    objects = {"ortho.tif": {"tennis-court": BOXES}}
    found = Detections({"ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), "", doubtful={"ortho.tif": BOXES}, objects=objects)
    save(found, tmp_path / name, whole)
    cut = raster(tmp_path / "cut/ortho.tif", crs, Affine(0.1, 0, t.c - 4, 0, -0.1, t.f + 3), size=(360, 270))
    again = load(tmp_path / name, cut)
    assert again.boxes["ortho.tif"].centre == pytest.approx(BOXES.centre + (40, 30), abs=0.02)
    assert (again.doubtful, again.objects) == ({}, {}) and "another cut of this picture" in str(cut.notes[-1])
    larger = raster(tmp_path / "larger/ortho.tif", crs, Affine(0.05, 0, t.c, 0, -0.05, t.f), size=(640, 480))
    with pytest.raises(InputError, match="boxes are 2 times as long in this picture"):
        load(tmp_path / name, larger)


def test_boxes_in_one_of_several_layers_are_those_of_the_vehicles(tmp_path):
    """Any first layer of a project's GeoPackage was taken for them."""
    source = raster(tmp_path / "ortho.tif", *PLACES["UTM"])
    save(Detections({"ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), ""), tmp_path / "d.gpkg", source)
    meta, _, shapes, _ = pyogrio.raw.read(tmp_path / "d.gpkg")
    for name, layers in {"a.gpkg": ("roofs", "vehicles"), "b.gpkg": ("roofs", "cars")}.items():
        for layer in layers:
            pyogrio.raw.write(
                tmp_path / name,
                shapes if layer != "roofs" else shapes[:1],
                [],
                np.array([], object),
                layer=layer,
                geometry_type="Polygon",
                crs=meta["crs"],
                append=layer != "roofs",
            )
    assert len(load(tmp_path / "a.gpkg", source).boxes["ortho.tif"]) == len(BOXES)
    with pytest.raises(InputError, match=r"several layers \(roofs, cars\), and none is called vehicles"):
        load(tmp_path / "b.gpkg", source)


def test_shares_of_frames_that_are_not_at_hand_are_of_their_size_in_the_model(tmp_path):
    """Labels of Ultralytics: shares of the picture's width and height."""
    model, _ = make_model()
    source = open_source(save_model(model, tmp_path / "model", "bin"), need_images=False)
    (labels := tmp_path / "labels").mkdir()
    for name in source.picture_names:
        (labels / Path(name).with_suffix(".txt").name).write_text("0 0.45 0.47 0.55 0.47 0.55 0.53 0.45 0.53\n")
    found = load(labels, source).boxes
    assert not source.pictures and sorted(found) == sorted(source.picture_names)
    for boxes in found.values():
        assert boxes.xylwa[0, :4] == pytest.approx([320, 240, 64, 28.8], abs=0.1)


EVERYTHING = ("d.json", "d.coco.json", "d.geojson", "d.gpkg")


def pictures_of(names, folder):
    class Frames:
        claimed, pictures, path, picture_names, notes = None, (), folder, names, []

        def image_size(self, name):
            return 4000, 3000

    return Frames()


def same(a, b, digits=0.011):
    assert a.xylwa[:, :4] == pytest.approx(b.xylwa[:, :4], abs=digits)
    assert np.abs(np.exp(2j * a.angle) - np.exp(2j * b.angle)).max(initial=0) < 2e-3, "angles are those of axes"
    assert a.score == pytest.approx(b.score, abs=6e-4) and a.sigma == pytest.approx(b.sigma, abs=6e-6, nan_ok=True)
    assert a.kinds == pytest.approx(b.kinds, abs=6e-4, nan_ok=True)


@st.composite
def some_boxes(draw):
    """Boxes on a grid, far enough apart that none repeats another; length and width differ, as vehicles' do."""
    count = draw(st.integers(0, 5))
    width = draw(hnp.arrays(float, count, elements=st.floats(5, 30)))
    length = width * draw(hnp.arrays(float, count, elements=st.floats(1.2, 4)))
    angle = draw(hnp.arrays(float, count, elements=st.floats(-1.57, 1.57)))
    score = draw(hnp.arrays(float, count, elements=st.floats(0, 1)))
    sigma = draw(hnp.arrays(float, (count, 2), elements=st.one_of(st.floats(0, 0.5), st.just(np.nan))))
    kinds = draw(hnp.arrays(float, (count, 4), elements=st.floats(0, 1)))
    kinds[draw(hnp.arrays(bool, count))] = np.nan
    centre = np.column_stack([200.0 * np.arange(1, count + 1), np.full(count, 300.0)])
    return Boxes(np.column_stack([centre, length, width, angle]), score, sigma, kinds)


@st.composite
def some_detections(draw, plans=True):
    names = ["a/1.jpg", "b 2.png", "Ü.tif"]
    ruler = Ruler(tuple(draw(st.tuples(st.floats(-3, 3), st.floats(-3, 3)))), common_sd=draw(st.floats(0, 0.1)))
    return Detections(
        boxes={name: draw(some_boxes()) for name in names},
        zoom=draw(st.floats(0.1, 4)),
        ruler=ruler,
        effective_height=draw(st.tuples(st.floats(0, 2), st.floats(0, 2))),
        detector=draw(st.text(max_size=20)),
        detector_sha256="ab" * 32,
        doubtful={name: boxes for name in names[:2] if len(boxes := draw(some_boxes()))},
        objects={names[0]: {"tennis-court": boxes}} if len(boxes := draw(some_boxes())) else {},
        set_aside={why: {names[0]: boxes} for why in ("panels", "no vehicle") if len(boxes := draw(some_boxes()))},
        planar=draw(some_detections(plans=False)) if plans and draw(st.booleans()) else None,
        body=draw(st.sampled_from(["car", "van"])),
    )


@pytest.mark.parametrize("name", EVERYTHING)
@settings(max_examples=15, deadline=None)
@given(found=some_detections())
def test_load_gives_back_all_that_was_saved(tmp_path_factory, name, found):
    folder = tmp_path_factory.mktemp("d")
    source = pictures_of(list(found.boxes), folder)
    save(found, folder / name, source)
    again = load(folder / name, source)
    assert about(again) == about(found) and source.notes == []

    def compare(a, b):
        assert a.set_aside.keys() == b.set_aside.keys()
        aside = [(a.set_aside[why], b.set_aside[why]) for why in b.set_aside]
        for ours, theirs in ((a.boxes, b.boxes), (a.doubtful, b.doubtful), *aside):
            for picture in {*ours, *theirs}:
                same(ours.get(picture, Boxes.empty()), theirs.get(picture, Boxes.empty()))
        assert a.objects.keys() == b.objects.keys()
        for picture, kinds in a.objects.items():
            same(kinds["tennis-court"], b.objects[picture]["tennis-court"])
        assert (a.planar is None) == (b.planar is None)

    compare(again, found)
    if found.planar is not None:
        assert about(again.planar) == about(found.planar)
        compare(again.planar, found.planar)


def test_files_of_before_reasons_were_kept_apart_are_read(tmp_path):
    row = {"cx": 100.0, "cy": 80.0, "length": 41.0, "width": 17.0, "angle": 0.3}
    text = {
        "detector": "t", "detector_sha256": "", "zoom": 0.8, "effective_height": [0.7, 0.5], "body": "car",
        "doubt": "low confidence, or detected at only one resolution", "doubtful": {"a.jpg": [row]},
        "pictures": {"a.jpg": [row, {**row, "cx": 200.0}]},
    }  # fmt: skip
    (tmp_path / "d.json").write_text(json.dumps(text))
    found = load(tmp_path / "d.json", pictures_of(["a.jpg"], tmp_path))
    assert (len(found), found.unconfirmed, found.set_aside) == (2, 1, {})


def test_dota_text_keeps_boxes_and_scores(tmp_path):
    source = pictures_of(["a.jpg"], tmp_path)
    noisy = Boxes(BOXES.xylwa, BOXES.score, np.full((3, 2), 0.03))
    found = Detections({"a.jpg": noisy}, 0.8, RULER, (0.7, 0.5), "t", doubtful={"a.jpg": BOXES[:1]})
    save(found, tmp_path / "d.txt", source)
    again = load(tmp_path / "d.txt", source)
    same(Boxes(again.boxes["a.jpg"].xylwa, again.boxes["a.jpg"].score), BOXES)
    assert np.isnan(again.boxes["a.jpg"].sigma).all() and again.doubtful == {} and again.ruler == UNKNOWN_RULER


def test_dota_text_refuses_the_name_that_would_be_written(tmp_path):
    """Of two pictures with one name but for the ending the whole names are written; only one has boxes, and a space."""
    source = pictures_of(["a.old jpg", "a.jpg"], tmp_path)
    with pytest.raises(UsageError, match=r"'a.old jpg', which has a space"):
        save(Detections({"a.old jpg": BOXES}, 0.8, RULER, (0.7, 0.5), "t"), tmp_path / "d.txt", source)
    assert not (tmp_path / "d.txt").exists()


# Rectangles


def test_four_corners_give_the_mean_of_opposite_sides():
    assert Boxes(rectangles([BOXES.corners[0]])[0][None], np.ones(1)).xylwa[0] == pytest.approx(BOXES.xylwa[0])
    drawn = np.array([[0, 0], [40, 1], [41, 17], [1, 16]])  # by hand, a little skew
    x, y, length, width, angle = rectangles([drawn])[0]
    assert (x, y) == (20.5, 8.5)
    assert (length, width) == (pytest.approx(40.01, abs=0.01), pytest.approx(16.03, abs=0.01))
    assert cv2.minAreaRect(drawn.astype(np.float32))[1][0] * cv2.minAreaRect(drawn.astype(np.float32))[1][1] > 1.03 * (
        length * width
    ), "the rectangle around it is larger"
    closed = np.vstack([drawn, drawn[:1]])  # as GeoJSON has it: its last corner is its first
    assert (rectangles([closed]) == rectangles([drawn])).all()


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (1, 2, 3, 0), (0, 2, 1, 3), (0, 1, 2, 3, 0)])
def test_the_order_of_corners_does_not_matter(order):
    for box in BOXES.xylwa:
        corners = Boxes(box[None], np.ones(1)).corners[0][list(order)] + 40_000
        again = Boxes(rectangles([corners]) - [40_000, 40_000, 0, 0, 0], np.ones(1))
        assert overlap(box[None], again.xylwa)[0] > 0.999


def test_other_polygons_give_the_smallest_rectangle_around_them():
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ellipse = np.column_stack([20 * np.cos(angles), 8 * np.sin(angles)]) @ [[0.8, 0.6], [-0.6, 0.8]] + 50
    assert sorted(rectangles([ellipse])[0][2:4]) == pytest.approx([16, 40], abs=0.1)


# Files as others write them


@pytest.fixture
def plain(tmp_path):
    return raster(tmp_path / "ortho.tif")


def load_text(plain, tmp_path, name, text, **options):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text if isinstance(text, str) else json.dumps(text))
    return load(path, plain, **options)


CAR = "10 20 50 20 50 37 10 37"


def test_dota_labels(plain, tmp_path):
    text = f"imagesource:GoogleEarth\ngsd:0.14\n{CAR} small-vehicle 0\n{CAR} large-vehicle 1\n\n0 0 9 0 9 9 0 9 ship\n"
    (box,) = load_text(plain, tmp_path, "any.txt", text).boxes["ortho.tif"].xylwa
    assert box == pytest.approx([30, 28.5, 40, 17, 0])
    assert len(load_text(plain, tmp_path, "labels/ortho.txt", text).boxes["ortho.tif"]) == 1
    (tmp_path / "labels/._ortho.txt").write_bytes(b"\0\5\x16\7")  # macOS leaves these on disks of other systems
    assert len(load(tmp_path / "labels", plain).boxes["ortho.tif"]) == 1, "a folder of label files"
    assert len(load_text(plain, tmp_path, "a.txt", text, vehicle_classes=["large vehicle", "ship"])) == 2


def test_standard_objects_come_along(plain, tmp_path):
    court = "100 100 220 100 220 155 100 155"
    text = f"{CAR} small-vehicle 0\n{court} tennis-court 0\n{court} harbor 0\n"
    found = load_text(plain, tmp_path, "any.txt", text)
    assert list(found.objects["ortho.tif"]) == ["tennis-court"] and len(found) == 1
    assert found.objects["ortho.tif"]["tennis-court"].xylwa[0] == pytest.approx([160, 127.5, 120, 55, 0])


def test_dota_results(plain, tmp_path):
    found = load_text(plain, tmp_path, "Task1_small-vehicle.txt", f"ortho 0.83 {CAR}\n")
    assert found.boxes["ortho.tif"].score.tolist() == [0.83]
    with pytest.raises(InputError, match=r"1 boxes, none of a class whose name means small .*; its classes are ship"):
        load_text(plain, tmp_path, "Task1_ship.txt", f"ortho 0.83 {CAR}\n")


def of_ultralytics(boxes, number=0, score=False):
    corners = boxes.corners / (320, 240)
    tail = [f" {s:.6f}" if score else "" for s in boxes.score]
    lines = [f"{number} " + " ".join(f"{v:.8f}" for v in c.ravel()) + t for c, t in zip(corners, tail, strict=True)]
    return "".join(line + "\n" for line in lines)


def test_ultralytics_labels_and_predictions(plain, tmp_path):
    """Corners as shares of width and height, which differ here: a box read by one of them alone would be skewed."""
    found = load_text(plain, tmp_path, "labels/ortho.txt", of_ultralytics(BOXES))
    assert found.boxes["ortho.tif"].xylwa == pytest.approx(BOXES.xylwa, abs=1e-4)
    assert len(load(tmp_path / "labels", plain)) == 3, "a folder of label files"
    predicted = load_text(plain, tmp_path, "p.txt", of_ultralytics(BOXES, 10, score=True))
    assert predicted.boxes["ortho.tif"].score == pytest.approx(BOXES.score)
    both = of_ultralytics(BOXES[:2], 10) + of_ultralytics(BOXES[2:], 9)
    with pytest.raises(InputError, match=r"classes have numbers and no names \(9, 10\)"):
        load_text(plain, tmp_path, "two.txt", both)
    assert len(load_text(plain, tmp_path, "two.txt", both, vehicle_classes=["10"])) == 2


def test_csv_tables(plain, tmp_path):
    rows = "".join(",".join(map(str, row)) + f",{s}\n" for row, s in zip(BOXES.xylwa, BOXES.score, strict=True))
    found = load_text(plain, tmp_path, "d.csv", "cx,cy,length,width,angle,score\n" + rows).boxes["ortho.tif"]
    assert found.xylwa == pytest.approx(BOXES.xylwa) and found.score == pytest.approx(BOXES.score)
    text = "Image; CX; CY; Length; Width; Angle_deg; Class\northo.tif; 100; 80; 40; 17; 30; car\n"
    text += "ortho; 9; 9; 9; 5; 0; ship\n"
    (box,) = load_text(plain, tmp_path, "d.csv", text).boxes["ortho.tif"].xylwa
    assert box == pytest.approx([100, 80, 40, 17, np.pi / 6])
    text = "cx;cy;length;width;angle_deg;picture\n100,5;80,25;40;17,125;30;ortho.tif\n"  # as much of Europe writes it
    (box,) = load_text(plain, tmp_path, "d.csv", text).boxes["ortho.tif"].xylwa
    assert box == pytest.approx([100.5, 80.25, 40, 17.125, np.pi / 6])


@pytest.mark.parametrize("name", [*EVERYTHING, "d.txt", "d.csv"])
def test_copies_of_a_box_count_once_in_every_format(plain, tmp_path, name):
    nearly = Boxes(BOXES.xylwa + [0.6, -0.4, 0.5, 0.3, 0.01], BOXES.score - 0.1)
    copies = Boxes.concatenate([*[BOXES] * 4, nearly])
    if name.endswith("csv"):
        lines = [
            "cx,cy,length,width,angle,score",
            *(",".join(map(str, r)) for r in np.column_stack([copies.xylwa, copies.score])),
        ]
        (tmp_path / name).write_text("\n".join(lines))
    else:
        save(Detections({"ortho.tif": copies}, 1.0, RULER, (0.7, 0.5), "test"), tmp_path / name, plain)
    again = load(tmp_path / name, plain)
    same(Boxes(again.boxes["ortho.tif"].xylwa, again.boxes["ortho.tif"].score), BOXES, 0.02)
    assert plain.notes[-1].text.endswith("12 of its 15 boxes repeat the vehicle of another and were left out")


@pytest.mark.parametrize("name", [*EVERYTHING, "d.txt"])
@pytest.mark.parametrize(
    "box, score, message",
    [
        ([160, 120, 44_000, 17, 0], 0.9, "is longer than the whole picture"),
        ([160, 120, 401, 17, 0], 0.9, "is longer than the whole picture"),
        ([160, 120, 40, 17, 0], 1.5, "score"),
        ([160, 120, 40, 17, 0], -0.2, "score"),
        ([160, 120, 40, 17, 0], np.nan, "score|malformed"),
        ([np.nan, 120, 40, 17, 0], 0.9, "numbers|malformed|usable corners"),
        ([160, 120, 40, 0, 0], 0.9, "extent|width"),
    ],
)
def test_boxes_that_cannot_be_meant_are_refused_in_every_format(plain, tmp_path, name, box, score, message):
    found = Detections({"ortho.tif": Boxes(np.array([box]), np.array([score]))}, 1.0, RULER, (0.7, 0.5), "test")
    if name == "d.gpkg" and np.isnan(box).any():
        pytest.skip("GEOS makes no polygon of it")
    save(found, tmp_path / name, plain)
    if name.endswith("json"):  # as other programs write what orthoscale leaves empty
        (tmp_path / name).write_text((tmp_path / name).read_text().replace("null", "NaN"))
    with pytest.raises(InputError, match=message):
        load(tmp_path / name, plain)


def test_coco_with_corners_or_an_angle(plain, tmp_path):
    text = {
        "images": [{"id": 7, "file_name": "ortho.tif", "width": 320, "height": 240}],
        "categories": [{"id": 1, "name": "Car"}, {"id": 2, "name": "Bus"}],
        "annotations": [
            {"image_id": 7, "category_id": 1, "segmentation": [[float(v) for v in CAR.split()]], "score": 0.7},
            {"image_id": 7, "category_id": 1, "bbox": [100, 100, 40, 17, 30]},
            {"image_id": 7, "category_id": 2, "bbox": [100, 100, 90, 30, 30]},
        ],
    }
    boxes = load_text(plain, tmp_path, "d.json", text).boxes["ortho.tif"]
    assert boxes.xylwa == pytest.approx(np.array([[30, 28.5, 40, 17, 0], [100, 100, 40, 17, -np.pi / 6]]))
    assert boxes.score.tolist() == [0.7, 1]
    results = [{"image_id": "ortho", "category_id": 1, "bbox": [100, 100, 40, 17, 30], "score": 0.6}]
    assert len(load_text(plain, tmp_path, "r.json", results)) == 1


def test_geojson_as_map_programs_write_it(tmp_path):
    place = raster(tmp_path / "ortho.tif", *PLACES["UTM"])
    corners = np.column_stack([284000.5 + 0.1 * BOXES.corners[0][:, 0], 1615000.25 - 0.1 * BOXES.corners[0][:, 1]])
    ring = [[*point, 0.0] for point in [*corners.tolist(), corners[0].tolist()]]
    feature = {
        "geometry": {"type": "MultiPolygon", "coordinates": [[ring]]},
        "properties": {"conf": 0.4, "name": "car"},
    }
    text = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32651"}},
        "features": [feature],
    }
    boxes = load_text(place, tmp_path, "d.geojson", text).boxes["ortho.tif"]
    assert boxes.xylwa == pytest.approx(BOXES.xylwa[:1], abs=1e-3) and boxes.score.tolist() == [0.4]


def test_geojson_in_the_pixels_of_a_picture_without_place(plain, tmp_path):
    for sign in (1, -1):
        ring = (BOXES.corners[0] * [1, sign]).tolist()
        text = {"type": "FeatureCollection",
                "features": [{"geometry": {"type": "Polygon", "coordinates": [ring]}, "properties": None}]}  # fmt: skip
        boxes = load_text(plain, tmp_path, "d.geojson", text).boxes["ortho.tif"]
        assert boxes.xylwa == pytest.approx(BOXES.xylwa[:1], abs=1e-3)


@pytest.mark.parametrize(
    "name, text",
    [
        ("d.txt", f"tokyo 0.9 {CAR}\n"),
        ("d.csv", "cx,cy,length,width,angle,picture\n30,30,40,17,0,tokyo\n"),
        ("d.json", {"tokyo": [{"cx": 30, "cy": 30, "length": 40, "width": 17, "angle": 0}]}),
        ("d.json", {"annotations": [{"image_id": 1, "bbox": [30, 30, 40, 17, 0]}],
                    "images": [{"id": 1, "file_name": "tokyo"}]}),
    ],
)  # fmt: skip
def test_boxes_of_one_picture_are_of_the_only_one_whatever_its_name(plain, tmp_path, name, text):
    """The same pixels under another name."""
    before = len(plain.notes)
    found = load_text(plain, tmp_path, name, text)
    assert list(found.boxes) == ["ortho.tif"] and len(found) == 1
    (note,) = [note for note in plain.notes[before:] if "tokyo" in note.text]
    assert note.severity == "caution" and "'ortho.tif'" in note.text


def feature(kind, coordinates, **properties):
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "FeatureCollection", "features": [{"geometry": geometry, "properties": properties}]}


RING = [[10, 20], [50, 20], [50, 37], [10, 37]]
IMAGE = [{"id": 1, "file_name": "ortho.tif"}]
OTHER_SIZE = [{"id": 1, "file_name": "ortho.tif", "width": 640, "height": 480}]
CORNERS = [float(v) for v in CAR.split()]


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("d.txt", "1 2 3\n", "line 1 is not a box"),
        ("d.txt", "0 5 5 45 5 45 20 5 20\n", "line 1 is not a box"),  # of Ultralytics, but for its pixels
        ("d.txt", f"ortho 0.9 {CAR}\n\northo nine {CAR}\n", "line 3 is not a box"),
        ("d.txt", f"tokyo 0.9 {CAR}\nparis 0.9 {CAR}\n", "none of its 2 pictures is in .* the first is 'tokyo'"),
        ("d.txt", "tokyo 0.9 900 5 940 5 940 20 900 20\n", "1 of 1 boxes of 'tokyo' lie outside of ortho.tif"),
        (
            "d.json",
            {
                "annotations": [{"image_id": 1, "segmentation": [CORNERS]}],
                "images": [{**OTHER_SIZE[0], "file_name": "x.jpg"}],
            },
            "640 x 480 px",
        ),
        ("d.txt", "ortho 0.9 5 5 5 5 5 5 5 5\n", "box 1 of ortho.tif has no extent"),
        ("d.txt", "ortho 0.9 nan 5 9 5 9 7 5 7\n", "box 1 of ortho.tif is not made of numbers"),
        ("d.txt", "ortho 0.9 900 5 940 5 940 20 900 20\n", "1 of 1 boxes lie outside of ortho.tif"),
        ("d.json", {"annotations": [{"image_id": 1, "bbox": [1, 2, 3, 4]}], "images": IMAGE}, "no direction"),
        ("d.json", {"annotations": [{"image_id": 1, "bbox": [1, 2, -3, 4, 0]}], "images": IMAGE}, "no extent"),
        ("d.json", {"annotations": [{"image_id": 2, "bbox": [1] * 5}], "images": IMAGE}, "not among its images"),
        ("d.json", {"annotations": [{"image_id": 1, "segmentation": {"counts": "ab"}}]}, r"mask \(RLE\)"),
        (
            "d.json",
            {"annotations": [{"image_id": 1, "segmentation": [[1, 2, 3, 4]]}], "images": IMAGE},
            "fewer than three corners",
        ),
        ("d.json", {"annotations": [{"segmentation": [CORNERS]}]}, r"annotations\[0\]: image_id is missing"),
        ("d.json", {"annotations": ["box"], "images": IMAGE}, r"annotations\[0\]: expected an object, found text"),
        ("d.json", {"annotations": [], "images": [{"id": 1}]}, r"images\[0\]: file_name is missing"),
        ("d.json", {"annotations": [{"image_id": 1, "segmentation": [CORNERS]}], "images": OTHER_SIZE}, "640 x 480 px"),
        (
            "d.json",
            {"annotations": [], "info": {"orthoscale": {"zoom": 1}}},
            "info.orthoscale: effective_height is missing",
        ),
        ("d.geojson", feature("Point", [1, 2]), "feature 1 is not a polygon but Point"),
        ("d.geojson", feature("Polygon", [[[1, 2], [3, 4]]]), "has 2 usable corners"),
        ("d.geojson", feature("Polygon", [[["a", 2], [3, 4], [5, 6]]]), "is not a polygon"),
        ("d.geojson", feature("Polygon", [RING], **{"class": "roof"}), "its classes are roof"),
        ("d.geojson", feature("Polygon", [RING], score="high"), "has a score that is not from 0 to 1"),
        ("d.geojson", {"type": "FeatureCollection", "features": [{"type": "Feature"}]}, "not GeoJSON that can be read"),
        ("d.geojson", "{", "not a detections file"),
        ("d.gpkg", "hello", "not a GeoPackage|pyogrio"),
        ("d.csv", "cx,cy,length\n", "no column width and angle"),
        ("d.csv", "cx,cy,length,width,angle\n1,2,3,2,x\n", "line 2: angle is 'x', not a number"),
        *(
            ("d.csv", f"cx,cy,length,width,angle\n9,9,4,2,0\n1,2,{box}\n", "line 3: length and width must be positive")
            for box in ("-3,2,0", "3,-2,0", "-3,-2,0", "3,0,0", "3,2,1e30")
        ),
        ("d.csv", "cx,cy,length,width,angle\n1,2,3,2\n", "line 2: angle is '', not a number"),
        ("d.csv", "cx,cy,length,width,angle\n1,5,2,3,2,0,5\n", "line 2: has more cells than the header has"),
        ("d.csv", "", "no column cx"),
        ("d.csv", "cx,cy,length,width,angle,CX\n1,2,3,2,0,4\n", "several columns cx"),
    ],
)
def test_what_fits_no_box_is_refused_in_words(plain, tmp_path, name, text, message):
    with pytest.raises(InputError, match=message) as refusal:
        load_text(plain, tmp_path, name, text)
    assert name in str(refusal.value), "the message names the file"


def test_files_that_are_not_there(plain, tmp_path):
    for name in ("no.json", "no.txt", "no.geojson", "no.gpkg"):
        with pytest.raises(InputError, match="cannot be read"):
            load(tmp_path / name, plain)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"without \.txt files"):
        load(tmp_path / "empty", plain)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("Citroën 1 2\n".encode("cp1252"), r"not UTF-8 text \(byte 5\).*save it as UTF-8"),
        ("1 2\n".encode("utf-16"), "not UTF-8 text but UTF-16: save it as UTF-8"),
    ],
)
def test_a_text_of_a_spreadsheet_in_another_encoding_is_to_be_saved_as_utf_8(plain, tmp_path, content, said):
    """What was said, "not text", is wrong: it is one in an editor."""
    for name in ("boxes.txt", "boxes.csv"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=said):
            load(tmp_path / name, plain)


def test_names_that_a_format_cannot_hold(tmp_path, plain):
    found = Detections({"ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), "test")
    with pytest.raises(UsageError, match="not an ending of a detections format"):
        save(found, tmp_path / "boxes.xml", plain)
    with pytest.raises(UsageError, match="has a space"):
        save(Detections({"my ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), "test"), tmp_path / "d.txt", plain)


@pytest.mark.parametrize(
    "words", [["estimate"], ["estimate", "--dry-run"], ["fix", "--out", "NEW"], ["check"], ["photo"]]
)
def test_names_that_a_format_cannot_hold_are_refused_before_anything_is_measured(tmp_path, monkeypatch, words):
    def measured(*args, **more):
        raise AssertionError("it was measured")

    for module in ("actions.estimate", "photos.survey"):
        monkeypatch.setattr(f"orthoscale.{module}.boxes_of", measured)
    photo, ortho = tmp_path / "my photo.jpg", tmp_path / "my ortho.tif"
    write_photo(photo, exif={0x920A: 4.5, 0xA405: 24})
    place = {"crs": LOCAL_CRS, "transform": Affine(0.1, 0, 0, 0, -0.1, 6.4)}
    with rasterio.open(ortho, "w", "GTiff", 64, 64, 3, dtype="uint8", **place) as file:
        file.write(np.random.default_rng(0).integers(1, 255, (3, 64, 64), np.uint8))
    more = {"fix": ["--override", "--out", tmp_path / "new.tif"], "photo": ["--pitch", "-90"]}.get(words[0], [])
    picture = photo if words == ["photo"] else ortho
    command = [words[0], picture, *words[1:], *more, "--save-detections", tmp_path / "boxes.txt"]
    done = run(*command)
    assert done.returncode == 2 and "has a space" in done.stderr, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["my ortho.tif", "my photo.jpg"]


def test_a_picture_whose_name_is_no_utf_8_is_saved_in_each_format(tmp_path):
    name = os.fsdecode(b"caf\xe9.tif")
    found = Detections({name: BOXES}, 1.0, RULER, (0.7, 0.5), "test")
    source = SimpleNamespace(picture_names=[name], image_size=lambda name: (300, 300), claimed=None)
    for ending in (".json", ".coco.json", ".txt", ".geojson"):
        save(found, tmp_path / f"boxes{ending}", source)
        assert "caf" in (tmp_path / f"boxes{ending}").read_text(encoding="utf-8")


def test_the_command_converts_between_formats(plain, tmp_path):
    """Detections in, the scale and detections in another format out; a bad name is refused before any work."""
    grid = np.stack(np.meshgrid(np.arange(6) * 50 + 30.0, np.arange(3) * 60 + 40.0), -1).reshape(-1, 2)
    sizes = load_fleet("DE").sample(np.random.default_rng(0), 18)[:, :2] / 0.1
    rows = np.column_stack([grid, sizes, np.zeros(18)])
    found = Detections({"ortho.tif": Boxes(rows, np.ones(18))}, 1.0, RULER, (0.7, 0.5), "test")
    save(found, tmp_path / "in.geojson", plain)
    words = ["estimate", str(plain.path), "--detections", str(tmp_path / "in.geojson"), "--fleet", "DE", "--json"]
    result = CliRunner().invoke(cli, [*words, "--save-detections", str(tmp_path / "out.coco.json")])
    assert result.exception is None, result.output
    low, high = json.loads(result.output)["interval90"]
    assert low < 0.1 < high < 1.4 * low
    assert load(tmp_path / "out.coco.json", plain).boxes["ortho.tif"].xylwa == pytest.approx(rows, abs=0.01)
    refused = CliRunner().invoke(cli, [*words, "--save-detections", str(tmp_path / "out.xml")])
    assert isinstance(refused.exception, UsageError) and not (tmp_path / "out.xml").exists()
