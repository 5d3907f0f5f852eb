"""Satellite crops: as much ground as the photo shows, where they say that they are."""

import csv
import json
import re

import cv2
import numpy as np
import pyproj
import pytest
import rasterio
from PIL import Image
from rasterio.control import GroundControlPoint
from rasterio.transform import Affine
from support import in_process
from support.photos import ALTITUDE, CARS, FOCAL, SIZE, boxes_in, detections_of, view_from, write_photo

from orthoscale.errors import UsageError
from orthoscale.formats.degrees import turn_of
from orthoscale.formats.detections.own import save_detections
from orthoscale.photos.crop import Satellite, plan_crops

LON, LAT = 9.0, 60.0
GEOD = pyproj.Geod(ellps="WGS84")


def satellite(path, crs="EPSG:32632", step=0.5, size=1600, turned=0.0, lon=LON):
    """A picture whose red is the column and whose green is the row, over 10 px, around a place in Norway, say."""
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, LAT)
    a = np.radians(turned)
    right, down = step * np.array([np.cos(a), -np.sin(a)]), step * np.array([-np.sin(a), -np.cos(a)])
    corner = np.array([x, y]) - size / 2 * (right + down)
    transform = Affine(right[0], down[0], corner[0], right[1], down[1], corner[1])
    rows, columns = np.indices((size, size))
    pixels = np.stack([columns // 10, rows // 10, 0 * rows]).astype(np.uint8)
    with rasterio.open(path, "w", "GTiff", size, size, 3, crs, transform, "uint8", photometric="RGB") as out:
        out.write(pixels)
    return path


@pytest.mark.parametrize("crs, step, turned, pixel", [
    ("EPSG:32632", 0.5, 0, 0.5), ("EPSG:3857", 0.6, 0, 0.3), ("EPSG:32632", 0.5, 25, 0.5),
])  # fmt: skip
def test_crops_are_as_large_on_the_ground_as_the_footprint(tmp_path, crs, step, turned, pixel):
    sky = Satellite.open(satellite(tmp_path / "sat.tif", crs, step, turned=turned))
    crops = plan_crops(sky, gsd=0.08, photo_size=(1000, 750), at=(LON, LAT))
    assert crops.pixel == pytest.approx([pixel] * 2, rel=0.005)
    ((x, y, width, height),) = crops.windows
    assert (width, height) == (round(80 / crops.pixel[0]), round(60 / crops.pixel[1]))
    corners = sky.lon_lat(np.array([[x, y], [x + width, y], [x + width, y + height]]))
    sides = [GEOD.inv(*corners[k], *corners[k + 1])[2] for k in (0, 1)]
    assert sides == pytest.approx([80, 60], abs=0.6 * pixel)
    assert sky.lon_lat(np.array([[x + width / 2, y + height / 2]]))[0] == pytest.approx([LON, LAT], abs=1e-5)
    assert crops.out == (1000, 750) and crops.query == (0, 0, 1000, 750)


def stored_mirrored(path, how):
    """The picture at `path`, stored with its last row first ("rows") or its last column first ("columns")."""
    with rasterio.open(path, "r+") as out:
        pixels, (height, width), t = out.read(), out.shape, out.transform
        if how == "rows":
            out.write(pixels[:, ::-1])
            out.transform = Affine(t.a, -t.b, t.c + t.b * height, t.d, -t.e, t.f + t.e * height)
        else:
            out.write(pixels[:, :, ::-1])
            out.transform = Affine(-t.a, t.b, t.c + t.a * width, -t.d, t.e, t.f + t.d * width)
    return path


@pytest.mark.parametrize("turned", [0, 25])
@pytest.mark.parametrize("how", ["rows", "columns"])
def test_a_map_that_is_stored_mirrored_gives_the_same_crops(tmp_path, how, turned):
    """South-up, as GDAL's netCDF and some viewers store it: the ground is the same. It was refused."""
    write_photo(tmp_path / "a.jpg")
    path = stored_mirrored(satellite(tmp_path / "sat.tif", turned=turned), how)
    satellite(tmp_path / "usual.tif", turned=turned)
    line = ("--gsd", 0.05, "--at", f"{LON},{LAT}", "--size", 200)
    for sky, out in (("usual", "a"), ("sat", "b")):
        done = run(tmp_path / "a.jpg", "--satellite", tmp_path / f"{sky}.tif", *line, "--out", tmp_path / out)
        assert done.returncode == 0, done.stderr
    (usual,), (row,) = (csv.DictReader((tmp_path / out / "manifest.csv").open()) for out in "ab")
    a, b = (cv2.imread(str(tmp_path / out / "gallery/0000.jpg")).astype(int) for out in "ab")
    if how == "columns":  # turned by half a turn then, as it is seen from above
        b = b[::-1, ::-1]
    assert np.abs(a - b).max() < 12, "JPEG, and a pixel by which windows are rounded"
    assert [float(row[k]) for k in ("longitude", "latitude")] == pytest.approx(
        [float(usual[k]) for k in ("longitude", "latitude")], abs=1e-5
    )
    # The manifest's pixels are those of the file.
    middle = int(row["column_px"]) + int(row["width_px"]) / 2, int(row["row_px"]) + int(row["height_px"]) / 2
    with rasterio.open(path) as sky:
        to_crs = pyproj.Transformer.from_crs("EPSG:4326", sky.crs, always_xy=True)
        place = to_crs.transform(float(row["longitude"]), float(row["latitude"]))
        assert sky.xy(middle[1], middle[0], offset="ul") == pytest.approx(place, abs=0.01)


@pytest.mark.parametrize("turned", [0, 25])
def test_where_a_map_goes_is_said_by_all_its_corners(tmp_path, turned):
    sky = Satellite.open(satellite(tmp_path / "sat.tif", turned=turned))
    ends = np.array(re.findall(r"\d+\.\d{6}", sky.extent_in_words()), float).reshape(2, 2)
    corners = sky.lon_lat(1600 * np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]))
    assert ends == pytest.approx(np.array([corners.min(0), corners.max(0)]), abs=1e-6)


def test_a_map_in_degrees_goes_on_beyond_the_180th_meridian(tmp_path):
    """A place there was not in it, and its ends were told the wrong way round."""
    sky = Satellite.open(satellite(tmp_path / "sat.tif", "EPSG:4326", 1e-5, lon=180.0))
    for lon, column in ((179.995, 300), (-179.995, 1300)):
        assert sky.pixel_of(lon, LAT) == pytest.approx([column, 800], abs=0.01)
        assert sky.lon_lat(np.array([column, 800.0]))[0] == pytest.approx([lon, LAT], abs=1e-7)
        assert len(plan_crops(sky, 0.08, (1000, 750), (lon, LAT)).windows) == 1
    assert "It goes from 179.992000, 59.992000 to 180.008000, 60.008000" in sky.extent_in_words()


@pytest.mark.parametrize("crs", ["EPSG:3857", "EPSG:3395", "EPSG:6933"])
def test_a_map_in_mercator_goes_on_beyond_the_180th_meridian(tmp_path, crs):
    """A place there was 40,000 km beside it: priors and crops were refused, outlines went around the Earth."""
    sky = Satellite.open(satellite(tmp_path / "sat.tif", crs, 1.0, lon=180.0))
    pixels = np.array([[300.0, 800.0], [1300.0, 700.0]])
    west, east = sky.lon_lat(pixels)
    assert west[0] > 179.9 and east[0] < -179.9
    for place, pixel in ((west, pixels[0]), (east, pixels[1])):
        assert sky.pixel_of(*place) == pytest.approx(pixel, abs=0.01)
        assert len(plan_crops(sky, 0.08, (1000, 750), tuple(place)).windows) == 1
    assert sky.in_crs(np.array([west, east])) == pytest.approx(sky.coordinates(pixels))


def test_how_far_it_is_once_around_the_earth():
    """In the unit of the map; 0 where coordinates end at a meridian, or it is no line of equal x."""
    mercator = 2 * np.pi * 6_378_137
    for crs, turn in {
        "EPSG:4326": 360, "EPSG:4807": 400, "EPSG:3857": mercator, "EPSG:3832": mercator,
        "+proj=eqc +units=us-ft": mercator * 3937 / 1200, "EPSG:32632": 0, "EPSG:3413": 0, "EPSG:8857": 0,
        "EPSG:4978": 0, "nonsense": 0,
    }.items():  # fmt: skip
        assert turn_of(crs) == pytest.approx(turn, rel=1e-9), crs


def test_squares_are_those_of_the_shorter_side(tmp_path):
    sky = Satellite.open(satellite(tmp_path / "sat.tif"))
    crops = plan_crops(sky, 0.08, (1000, 750), (LON, LAT), square=True, out_px=384)
    assert crops.windows[0, 2:].tolist() == [120, 120]
    assert crops.query == (125, 0, 750, 750) and crops.out == (384, 384)


@pytest.mark.parametrize("stride", [0.5, 0.25, 1.0])
def test_windows_cover_the_search_area_by_the_stride(tmp_path, stride):
    sky = Satellite.open(satellite(tmp_path / "sat.tif"))
    crops = plan_crops(sky, 0.08, (1000, 750), (LON, LAT), radius=200, stride=stride)
    for axis, window in ((0, 160), (1, 120)):
        starts = np.unique(crops.windows[:, axis])
        assert np.diff(starts).max() <= stride * window + 1
        assert starts[0] + window / 2 == pytest.approx(800 - 400, abs=1)
        assert starts[-1] + window / 2 == pytest.approx(800 + 400, abs=1)
    assert len(np.unique(crops.windows[:, :2], axis=0)) == len(crops.windows)


def test_without_a_place_the_whole_picture_is_searched(tmp_path):
    sky = Satellite.open(satellite(tmp_path / "sat.tif"))
    windows = plan_crops(sky, 0.08, (1000, 750)).windows
    assert windows[:, :2].min(0).tolist() == [0, 0]
    assert (windows[:, :2] + windows[:, 2:]).max(0).tolist() == [1600, 1600]
    assert len(windows) == 19 * 26  # (1600 - 160) / 80 + 1 and, rounded up, (1600 - 120) / 60 + 1


@pytest.mark.parametrize(
    "options, word",
    [
        ({"at": (LON + 1, LAT)}, "is not in sat.tif"),
        ({"gsd": 2.0}, "larger satellite picture"),
        ({"stride": 0}, "stride"),
        ({"radius": 100}, "--at"),
        ({"gsd": -1.0}, "positive"),
        ({"stride": 0.01}, "too many"),
        ({"stride": 0.001}, "shifts crops by 0.12 px of sat.tif, less than a pixel"),
        ({"stride": 1e-9}, "less than a pixel"),
    ],
)
def test_impossible_wishes_are_refused(tmp_path, options, word):
    sky = Satellite.open(satellite(tmp_path / "sat.tif"))
    with pytest.raises(UsageError, match=word):
        plan_crops(sky, **{"gsd": 0.08, "photo_size": (1000, 750), **options})


def test_windows_are_counted_before_they_are_made(tmp_path, monkeypatch):
    """Of a large picture they could fill the memory."""
    sky = Satellite.open(satellite(tmp_path / "sat.tif"))
    monkeypatch.setattr(np, "linspace", None)
    with pytest.raises(UsageError, match="1112735 windows are too many"):
        plan_crops(sky, 0.08, (1000, 750), stride=0.01)


def run(*arguments):
    return in_process.run("crop", *arguments)


def test_a_gallery_with_its_manifest(tmp_path):
    path = satellite(tmp_path / "sat.tif")
    photo = write_photo(tmp_path / "a.jpg")
    (tmp_path / "cars.json").write_text(json.dumps(CARS))
    save_detections(detections_of({"a.jpg": boxes_in(view_from(-90))}), tmp_path / "boxes.json")
    out = tmp_path / "crops"
    lens = ["--focal-px", FOCAL, "--pitch", -90]
    rules = ["--detections", tmp_path / "boxes.json", "--fleet", tmp_path / "cars.json", *lens]
    area = ["--satellite", path, "--at", f"{LON},{LAT}", "--radius", 60, "--size", 200, "--out", out]
    done = run(photo, *rules, *area, "--json")
    assert done.returncode == 0, done.stderr
    text = json.loads(done.stdout)
    assert text == json.loads((out / "crop.json").read_text())
    truth = ALTITUDE / FOCAL
    assert text["gsd"] == pytest.approx(truth, rel=0.005)
    assert text["window_m"] == pytest.approx([truth * SIZE[0], truth * SIZE[1]], rel=0.01)
    assert text["gsd_interval90"][0] < truth < text["gsd_interval90"][1]
    with Image.open(out / "query.jpg") as query:
        assert query.size == (200, 150)
    rows = list(csv.DictReader((out / "manifest.csv").open()))
    assert len(rows) == text["crops"] == len(list((out / "gallery").iterdir())) > 4
    with rasterio.open(path) as sky:
        to_crs = pyproj.Transformer.from_crs("EPSG:4326", sky.crs, always_xy=True)
        for row in rows[::3]:
            image = cv2.imread(str(out / row["file"]))
            assert image.shape == (150, 200, 3)
            # The pixels of the crop's middle say where they are from, and so does the manifest.
            down, across = sky.index(*to_crs.transform(float(row["longitude"]), float(row["latitude"])))
            assert int(image[75, 100, 2]) * 10 == pytest.approx(across, abs=25)
            assert int(image[75, 100, 1]) * 10 == pytest.approx(down, abs=25)
            assert across == pytest.approx(int(row["column_px"]) + int(row["width_px"]) / 2, abs=1.5)
    shown = run(photo, "--gsd", 0.05, *area, "--overwrite")
    assert shown.returncode == 0 and "(given)" in shown.stdout and "50.0 x 37.5 m" in shown.stdout


def test_the_fleet_that_a_photos_place_chooses_is_told(tmp_path):
    save_detections(detections_of({"a.jpg": boxes_in(view_from(-90))}), tmp_path / "boxes.json")
    photo = write_photo(tmp_path / "a.jpg", gps=(LON, LAT))
    words = ["--satellite", satellite(tmp_path / "sat.tif"), "--at", f"{LON},{LAT}", "--detections"]
    done = run(photo, *words, tmp_path / "boxes.json", "--focal-px", FOCAL, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert re.search(r"note +fleet NO: .* is in Norway; choose another with --fleet", done.stdout), done.stdout


@pytest.mark.parametrize(
    "photo, sky, options, code, word",
    [
        ("a.jpg", "sat.tif", ["--gsd", 0.05, "--at", "north"], 2, "--at"),
        ("a.jpg", "sat.tif", ["--gsd", 0.05, "--at", "200,95"], 2, "--at"),
        ("a.jpg", "plain.png", ["--gsd", 0.05], 2, "no place on Earth"),
        ("a.jpg", "none.tif", ["--gsd", 0.05], 5, "does not exist"),
        ("none.jpg", "sat.tif", ["--gsd", 0.05], 5, "none.jpg"),
        ("a.jpg", "sat.tif", [], 5, "no focal length"),
        ("a.jpg", "sat.tif", ["--focal-px", 900, "--detections", "few.json"], 3, "--gsd"),
        ("a.jpg", "sat.tif", ["--gsd", 0.05, "--fleet", "DE"], 2, "--fleet does nothing here"),
        ("a.jpg", "sat.tif", ["--gsd", 0.05, "--lens", "few.json"], 2, "Remove --lens."),
    ],
)
def test_bad_input_ends_in_one_sentence_and_nothing_written(tmp_path, monkeypatch, photo, sky, options, code, word):
    monkeypatch.chdir(tmp_path)
    satellite(tmp_path / "sat.tif", size=300)
    cv2.imwrite("plain.png", np.full((300, 300, 3), 120, np.uint8))
    write_photo(tmp_path / "a.jpg")
    save_detections(detections_of({"a.jpg": boxes_in(view_from(-90), 3)}), tmp_path / "few.json")
    done = run(photo, "--satellite", sky, *options, "--out", "out")
    assert done.returncode == code, done.stderr
    assert word in done.stderr and "Traceback" not in done.stderr and not (tmp_path / "out").exists()


def test_a_picture_that_ground_control_points_place(tmp_path):
    """Such files have no geotransform, and GDAL says the identity."""
    sky = Satellite.open(satellite(tmp_path / "sat.tif"))
    corners = [(0, 0), (1600, 0), (0, 1600), (1600, 1600)]
    points = [GroundControlPoint(y, x, *map(float, sky.coordinates(np.array([[x, y]]))[0])) for x, y in corners]
    with rasterio.open(tmp_path / "sat.tif") as given:
        pixels = given.read()
    with rasterio.open(tmp_path / "gcp.tif", "w", "GTiff", 1600, 1600, 3, dtype="uint8", photometric="RGB") as out:
        out.gcps = points, rasterio.CRS.from_string("EPSG:32632")
        out.write(pixels)
    placed = Satellite.open(tmp_path / "gcp.tif")
    middle = np.array([[800.0, 800.0]])
    assert placed.lon_lat(middle)[0] == pytest.approx(sky.lon_lat(middle)[0], abs=1e-7)
    assert plan_crops(placed, 0.08, (1000, 750), (LON, LAT)).pixel == pytest.approx([0.5] * 2, rel=0.005)
