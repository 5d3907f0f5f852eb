"""Detections of others and for others: every format gives back what went in; what fits no box is refused in words."""

import json
import warnings

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

from orthoscale.boxes import Boxes, overlap
from orthoscale.cli.main import cli
from orthoscale.detections import UNKNOWN_RULER, Detections
from orthoscale.errors import InputError, UsageError
from orthoscale.exchange import load, save
from orthoscale.exchange.items import rectangle
from orthoscale.pooling.ruler import Ruler
from orthoscale.sources.opening import open_source

RULER = Ruler((0.5, 1.0), (0.3, 0.4), (0.01, 0.02), 0.01, (1.0, 0.8))
BOXES = Boxes(
    np.array([[100.25, 80.5, 41, 17, 0.3], [200, 120, 38.5, 16.25, -1.2], [60, 160, 44, 18, np.pi / 4]]),
    np.array([0.95, 0.75, 0.5]),
)


def raster(path, crs=None, transform=None):
    with (
        warnings.catch_warnings(action="ignore"),
        rasterio.open(
            path, "w", driver="GTiff", width=320, height=240, count=3, dtype="uint8", crs=crs, transform=transform
        ) as file,
    ):
        file.write(np.full((3, 240, 320), 90, np.uint8))
    return open_source(path)


PLACES = {
    "no georeferencing": (None, None),
    "UTM": ("EPSG:32651", Affine(0.1, 0, 284000.5, 0, -0.1, 1615000.25)),
    "rotated": ("EPSG:32651", Affine(0.08, 0.06, 284000.5, 0.06, -0.08, 1615000.25)),
    "degrees": ("EPSG:4326", Affine(9e-7, 0, 121.0, 0, -9e-7, 14.6)),
    "Web Mercator": ("EPSG:3857", Affine(0.1, 0, 13467532.0, 0, -0.1, 1632019.9)),
}


@pytest.fixture(scope="module", params=PLACES)
def source(request, tmp_path_factory):
    return raster(tmp_path_factory.mktemp("place") / "ortho.tif", *PLACES[request.param])


@pytest.mark.parametrize("name", ["d.json", "d.coco.json", "d.txt", "d.geojson", "d.gpkg"])
def test_what_is_saved_reads_back(source, tmp_path, name):
    if name.endswith("gpkg"):
        pytest.importorskip("pyogrio")
    found = Detections({"ortho.tif": BOXES}, 0.8, RULER, (0.7, 0.5), "test", "abc")
    save(found, tmp_path / name, source)
    again = load(tmp_path / name, source)
    assert again.boxes["ortho.tif"].xylwa == pytest.approx(BOXES.xylwa, abs=0.02)
    assert again.boxes["ortho.tif"].score == pytest.approx(BOXES.score, abs=1e-3)
    if name != "d.txt":  # the one format that has no room for it
        assert again.about() == found.about()
    else:
        assert (again.zoom, again.ruler) == (1.0, UNKNOWN_RULER)


def test_many_pictures_keep_their_names(tmp_path):
    class Frames:
        unit, pictures, path = "m/model-unit", (), tmp_path
        picture_names = ("a/1.jpg", "a/2.jpg", "b/2.png")

    boxes = {"a/1.jpg": BOXES, "a/2.jpg": BOXES[:1], "b/2.png": BOXES[1:]}
    for name in ("d.coco.json", "d.txt", "d.geojson", "d.gpkg"):
        if name.endswith("gpkg"):
            pytest.importorskip("pyogrio")
        save(Detections(boxes, 1.0, RULER, (0.7, 0.5), "test"), tmp_path / name, Frames())
        again = load(tmp_path / name, Frames()).boxes
        assert {k: len(v) for k, v in again.items()} == {"a/1.jpg": 3, "a/2.jpg": 1, "b/2.png": 2}
    with pytest.raises(InputError, match="several pictures are called '2'"):
        (tmp_path / "2.txt").write_text("2 0.9 0 0 4 0 4 2 0 2\n")
        load(tmp_path / "2.txt", Frames())


# Rectangles


def test_four_corners_give_the_mean_of_opposite_sides():
    assert Boxes(rectangle(BOXES.corners[0])[None], np.ones(1)).xylwa[0] == pytest.approx(BOXES.xylwa[0])
    drawn = np.array([[0, 0], [40, 1], [41, 17], [1, 16]])  # by hand, a little skew
    x, y, length, width, angle = rectangle(drawn)
    assert (x, y) == (20.5, 8.5)
    assert (length, width) == (pytest.approx(40.01, abs=0.01), pytest.approx(16.03, abs=0.01))
    assert cv2.minAreaRect(drawn.astype(np.float32))[1][0] * cv2.minAreaRect(drawn.astype(np.float32))[1][1] > 1.03 * (
        length * width
    ), "the rectangle around it is larger"


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (1, 2, 3, 0), (0, 2, 1, 3), (0, 1, 2, 3, 0)])
def test_the_order_of_corners_does_not_matter(order):
    for box in BOXES.xylwa:
        corners = Boxes(box[None], np.ones(1)).corners[0][list(order)] + 40_000
        again = Boxes(rectangle(corners)[None] - [40_000, 40_000, 0, 0, 0], np.ones(1))
        assert overlap(box[None], again.xylwa)[0] > 0.999


def test_other_polygons_give_the_smallest_rectangle_around_them():
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ellipse = np.column_stack([20 * np.cos(angles), 8 * np.sin(angles)]) @ [[0.8, 0.6], [-0.6, 0.8]] + 50
    assert sorted(rectangle(ellipse)[2:4]) == pytest.approx([16, 40], abs=0.1)


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
        ("d.txt", "1 2 3\n", "line 1 is no box"),
        ("d.txt", f"ortho 0.9 {CAR}\n\northo nine {CAR}\n", "line 3 is no box"),
        ("d.txt", f"tokyo 0.9 {CAR}\n", "1 of its 1 pictures are not in .* the first is 'tokyo'"),
        ("d.txt", "ortho 0.9 5 5 5 5 5 5 5 5\n", "box 1 of ortho.tif has no extent"),
        ("d.txt", "ortho 0.9 nan 5 9 5 9 7 5 7\n", "box 1 of ortho.tif is not made of numbers"),
        ("d.txt", "ortho 0.9 900 5 940 5 940 20 900 20\n", "1 of 1 boxes lie outside of ortho.tif"),
        ("d.json", {"annotations": [{"image_id": 1, "bbox": [1, 2, 3, 4]}], "images": IMAGE}, "no direction"),
        ("d.json", {"annotations": [{"image_id": 2, "bbox": [1] * 5}], "images": IMAGE}, "not among its images"),
        ("d.json", {"annotations": [{"image_id": 1, "segmentation": {"counts": "ab"}}]}, r"mask \(RLE\)"),
        ("d.json", {"annotations": [{"segmentation": [CORNERS]}]}, r"annotations\[0\]: image_id is missing"),
        ("d.json", {"annotations": ["box"], "images": IMAGE}, r"annotations\[0\]: expected an object, found text"),
        ("d.json", {"annotations": [], "images": [{"id": 1}]}, r"images\[0\]: file_name is missing"),
        ("d.json", {"annotations": [{"image_id": 1, "segmentation": [CORNERS]}], "images": OTHER_SIZE}, "640 x 480 px"),
        (
            "d.json",
            {"annotations": [], "info": {"orthoscale": {"zoom": 1}}},
            "info.orthoscale: effective_height is missing",
        ),
        ("d.geojson", feature("Point", [1, 2]), "feature 1 is no polygon but Point"),
        ("d.geojson", feature("Polygon", [[[1, 2], [3, 4]]]), "has 2 usable corners"),
        ("d.geojson", feature("Polygon", [[["a", 2], [3, 4], [5, 6]]]), "is no polygon"),
        ("d.geojson", feature("Polygon", [RING], **{"class": "roof"}), "its classes are roof"),
        ("d.geojson", feature("Polygon", [RING], score="high"), "has a score that is not from 0 to 1"),
        ("d.geojson", feature("Polygon", [RING], picture="x.jpg"), "the first is 'x.jpg'"),
        ("d.geojson", {"type": "FeatureCollection", "features": [{"type": "Feature"}]}, "not GeoJSON that can be read"),
        ("d.geojson", "{", "not a detections file"),
        ("d.gpkg", "hello", "not a GeoPackage|pyogrio"),
    ],
)
def test_what_fits_no_box_is_refused_in_words(plain, tmp_path, name, text, message):
    if name.endswith("gpkg"):
        pytest.importorskip("pyogrio")
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
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="not text"):
        load(tmp_path / "binary.txt", plain)


def test_names_that_a_format_cannot_hold(tmp_path, plain):
    found = Detections({"ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), "test")
    with pytest.raises(UsageError, match="no format of detections ends like this"):
        save(found, tmp_path / "boxes.xml", plain)
    with pytest.raises(UsageError, match="has a space"):
        save(Detections({"my ortho.tif": BOXES}, 1.0, RULER, (0.7, 0.5), "test"), tmp_path / "d.txt", plain)


def test_the_command_converts_between_formats(plain, tmp_path):
    """Detections in, the scale and detections in another format out; a bad name is refused before any work."""
    grid = np.stack(np.meshgrid(np.arange(6) * 50 + 30.0, np.arange(3) * 60 + 40.0), -1).reshape(-1, 2)
    rows = np.column_stack([grid, 44 + grid[:, 0] % 3, np.full(18, 18.0), np.zeros(18)])
    found = Detections({"ortho.tif": Boxes(rows, np.ones(18))}, 1.0, RULER, (0.7, 0.5), "test")
    save(found, tmp_path / "in.geojson", plain)
    words = ["estimate", str(plain.path), "--detections", str(tmp_path / "in.geojson"), "--fleet", "DE", "--json"]
    result = CliRunner().invoke(cli, [*words, "--save-detections", str(tmp_path / "out.coco.json")])
    assert result.exception is None, result.output
    assert json.loads(result.output)["scale"] == pytest.approx(4.37 / 44.5, rel=0.08)  # vehicles all alike are no fleet
    assert load(tmp_path / "out.coco.json", plain).boxes["ortho.tif"].xylwa == pytest.approx(rows, abs=0.01)
    refused = CliRunner().invoke(cli, [*words, "--save-detections", str(tmp_path / "out.xml")])
    assert isinstance(refused.exception, UsageError) and not (tmp_path / "out.xml").exists()
