"""Facilities in lots of known size, and the files that say where they are."""

import json
import math
import os

import cv2
import ezdxf
import numpy as np
import pyogrio
import pyproj
import pytest
import rasterio
import shapely
from rasterio.control import GroundControlPoint
from rasterio.transform import Affine
from shapely import LineString, Polygon, box
from support import in_process
from support.lots import lot_file, orthophoto

from orthoscale.anchors.court_models import (
    BASKETBALL_COURTS,
    CENTRE_CIRCLE,
    HANDBALL_COURT,
    PADEL_COURT,
    PENALTY_AREA,
    TENNIS_COURT,
    VOLLEYBALL_COURT,
)
from orthoscale.core.affine import transformed
from orthoscale.errors import InputError, UsageError
from orthoscale.formats.tables import known_objects, standards
from orthoscale.layout import draw, export
from orthoscale.layout.catalogue import load, parking, parse_requests
from orthoscale.layout.ground import open_ground
from orthoscale.layout.place import PlacedFacility, arrange, centres, holds
from orthoscale.layout.plan import document, plan, prompt
from orthoscale.layout.terminal import summary
from orthoscale.sources.georeference import LOCAL_CRS

FACILITIES = load()


@pytest.mark.parametrize("code", FACILITIES)
def test_every_facility_has_a_source_and_lines_within_it(code):
    f = FACILITIES[code]
    assert len(f.source) > 20 and f.length >= f.width > 0
    lines = np.concatenate(f.lines)
    assert (np.abs(lines) <= np.array([f.length, f.width]) / 2 + 0.95).all(), "net posts stand 0.91 m outside"
    assert lines.max(0) + lines.min(0) == pytest.approx([0, 0], abs=1e-6)


@pytest.mark.parametrize(
    "code, full",
    [("basketball", (32, 19)), ("tennis", (36.57, 18.29)), ("badminton", (17.4, 9.1)), ("volleyball", (24, 15))],
)
def test_sizes_with_run_off_are_those_of_the_sources(code, full):
    f = FACILITIES[code]
    assert (f.full_length, f.full_width) == pytest.approx(full)


def test_the_track_is_400_metres_long():
    f = FACILITIES["track"]
    straight = f.length - f.width
    kerb = f.width / 2 - 8 * 1.22
    assert kerb == pytest.approx(36.5) and straight == pytest.approx(84.39)
    assert 2 * straight + 2 * math.pi * (kerb + 0.30) == pytest.approx(400, abs=0.02)  # measured 30 cm off the kerb
    inside = Polygon(FACILITIES["football"].outline)
    assert Polygon(f.lines[0]).contains(inside), "the stadium's pitch lies within its track"


def test_cars_get_into_a_car_park():
    """No painted line crosses the aisle; a court is painted all round."""
    f = parking("parking-DE", 8)
    aisle = Polygon([(-f.length, -1), (f.length, -1), (f.length, 1), (-f.length, 1)])
    painted = [LineString(line) for line in (*f.lines, *f.edges)]
    assert not any(line.crosses(aisle) for line in painted)
    assert sum(line.length for line in map(LineString, f.edges)) == pytest.approx(2 * f.length)
    (ring,) = FACILITIES["tennis"].edges
    assert LineString(ring).is_closed and LineString(ring).length == pytest.approx(2 * (23.77 + 10.97))


def test_parking_has_as_many_bays_as_asked_for():
    f = parking("parking-US", 15)
    assert f.length == pytest.approx(8 * 2.74) and f.width == pytest.approx(2 * 5.49 + 7.32)
    assert len(f.lines) == 9 + 8  # eight bays on one side, seven on the other
    assert [LineString(line).length for line in f.lines] == pytest.approx([5.49] * 17)  # and as deep as a bay
    assert {abs(y) for line in f.lines for y in line[:, 1]} == {f.width / 2, 7.32 / 2}


@pytest.mark.parametrize(("country", "width", "depth"), [
    ("DE", 2.5, 16), ("AE", 2.5, 17), ("GCC", 2.5, 17), ("EE", 2.55, 16), ("TR", 2.45, 16), ("AU", 2.4, 17),
])  # fmt: skip
def test_bays_are_the_stalls_that_are_measured_by(country, width, depth):
    f = parking(f"parking-{country}", 20)
    assert (f.length, f.width) == pytest.approx((10 * width, depth))
    row = next(row for key, row in standards().stalls.items() if country in (key, *row.get("countries", ())))
    assert row["width"] == width and row["source"] in f.source and "; aisle: " in f.source


def test_courts_have_one_size_in_all_tables():
    painted = {"tennis": TENNIS_COURT, "volleyball": VOLLEYBALL_COURT, "handball": HANDBALL_COURT}
    for code, court in {**painted, "basketball": BASKETBALL_COURTS[0]}.items():
        laid = FACILITIES[code]
        assert court.standard.metres == laid.length
        assert court.size == pytest.approx([laid.length, laid.width], abs=0.1), "at the centres of the paint"
    seen = known_objects()
    (tennis,) = seen["tennis-court"]
    assert (tennis["length"][0], tennis["width"][0]) == (FACILITIES["tennis"].length, FACILITIES["tennis"].width)
    for court, row in zip(BASKETBALL_COURTS, seen["basketball-court"], strict=True):
        assert row["length"][0] == pytest.approx(court.standard.metres, abs=0.005)
        assert row["width"][0] == pytest.approx(court.size[1], abs=0.1)
    _, *lines = FACILITIES["padel"].lines  # but its walls
    ends = [np.sort(each[[0, -1]], 0) for each in lines]
    along = np.concatenate([each[:, 0] for each in ends if np.ptp(each[:, 1]) == 0])
    across = {each[0, 0] for each in ends if np.ptp(each[:, 0]) == 0}
    assert np.ptp(along) == pytest.approx(np.ptp(PADEL_COURT.drawing()[..., 0]))
    assert max(across) - min(across) == pytest.approx(PADEL_COURT.standard.metres)
    sizes = [np.ptp(line, 0).tolist() for line in FACILITIES["football"].lines]
    assert pytest.approx([16.5, PENALTY_AREA.standard.metres]) in sizes
    assert pytest.approx([CENTRE_CIRCLE.standard.metres] * 2, rel=0.002) in sizes


@pytest.mark.parametrize(
    "text, count, centre, bearing",
    [
        ("tennis", 1, None, None),
        ("tennis:3", 3, None, None),
        ("Tennis@10,20", 1, (10, 20), 0),
        ("tennis@10.5,-20,35", 1, (10.5, -20), 35),
        ("parking-de:12", 1, None, None),
    ],
)
def test_wishes(text, count, centre, bearing):
    requests = parse_requests([text])
    assert len(requests) == count and (requests[0].centre, requests[0].bearing) == (centre, bearing)


@pytest.mark.parametrize(
    "text, word", [("curling", "Known are basketball"), ("tennis:0", "count"), ("tennis@a,b", "no place"),
                   ("tennis@1", "no place"), ("tennis@1,2,1e30", "no place"),
                   ("parking-ZZ:4", "parking-COUNTRY"), ("a b", "not understood")]
)  # fmt: skip
def test_wishes_that_make_no_sense(text, word):
    with pytest.raises(UsageError, match=word):
        parse_requests([text])


def test_a_catalogue_of_ones_own(tmp_path):
    path = tmp_path / "own.json"
    own = {"Boules": {"name": "boules court", "length": 15, "width": 4, "ends": 1, "sides": 1, "source": "FIPJP"}}
    path.write_text(json.dumps({"facilities": own}))
    (request,) = parse_requests(["boules"], path)
    assert (request.facility.full_length, request.facility.full_width) == (17, 6)
    own["Boules"]["length"] = 3
    path.write_text(json.dumps({"facilities": own}))
    with pytest.raises(InputError, match="no less than the width"):
        load(path)


@pytest.mark.parametrize(("code", "infield"), [("Pitch", "pitch"), ("pitch", "PITCH"), ("Pitch", "Pitch")])
def test_an_infield_may_be_written_in_capitals(tmp_path, code, infield):
    """Only one written as its code in lower case was known."""
    size = {"length": 90, "width": 60, "ends": 1, "sides": 1, "source": "ours"}
    own = {code: {"name": "pitch", **size}, "Oval": {"name": "oval", **size, "lines": [], "infield": infield}}
    path = tmp_path / "own.json"
    path.write_text(json.dumps({"facilities": own}))
    facilities = load(path)
    assert np.array_equal(facilities["oval"].lines[-1], facilities["pitch"].lines[0])


def test_a_facility_written_in_capitals_replaces_the_infield_too(tmp_path):
    """The stadium kept the football pitch that was built in."""
    own = {"name": "our pitch", "length": 90, "width": 60, "ends": 1, "sides": 1, "source": "ours"}
    path = tmp_path / "own.json"
    path.write_text(json.dumps({"facilities": {"Football": own}}))
    facilities = load(path)
    assert facilities["football"].name == "our pitch"
    assert np.array_equal(facilities["stadium"].lines[-1], facilities["football"].lines[0])


def test_an_arc_may_be_drawn_either_way(tmp_path):
    """Clockwise, from the larger angle, it was the straight line between its ends."""
    whole = {"name": "rings", "length": 20, "width": 20, "ends": 0, "sides": 0, "source": "ours"}
    path = tmp_path / "own.json"
    for start, end in ((90, 270), (270, 90)):
        whole["lines"] = [["arc", 1, 2, 5, start, end]]
        path.write_text(json.dumps({"facilities": {"rings": whole}}))
        (arc,) = load(path)["rings"].lines
        assert np.hypot(*(arc - (1, 2)).T) == pytest.approx(5) and arc[:, 0].min() == pytest.approx(1 - 5)


# Placing


def test_where_a_rectangle_may_be_is_exact_in_a_rectangle():
    free = centres(box(0, 0, 50, 30), 20, 10, 0)
    assert shapely.bounds(free) == pytest.approx([5, 10, 45, 20], abs=0.002)
    assert shapely.bounds(centres(box(0, 0, 50, 30), 20, 10, 90)) == pytest.approx([10, 5, 40, 25], abs=0.002)
    assert not centres(box(0, 0, 20, 10), 20, 10, 90).is_empty, "an exact fit is one"
    assert centres(box(0, 0, 19.9, 10), 20, 10, 90).is_empty


def test_where_a_rectangle_may_be_agrees_with_trying():
    lot = Polygon([(0, 0), (60, 5), (70, 40), (35, 30), (20, 55), (-5, 30)], [[(20, 15), (30, 15), (30, 20), (20, 20)]])
    rng = np.random.default_rng(0)
    for bearing in (0.0, 20.0, 115.0):
        free = centres(lot, 16, 8, bearing)
        for x, y in rng.uniform([-5, 0], [70, 55], (300, 2)):
            place = Polygon(PlacedFacility(FACILITIES["padel"], (x, y), bearing).on_ground(np.array(
                [[8, 4], [-8, 4], [-8, -4], [8, -4]])))  # fmt: skip
            if shapely.distance(free.boundary, shapely.Point(x, y)) > 0.01:
                assert free.contains(shapely.Point(x, y)) == lot.contains(place)


def check(lot, placed, clearance):
    for k, place in enumerate(placed):
        assert shapely.buffer(lot, -clearance + 0.01, join_style="mitre").covers(place.full_area)
        for other in placed[:k]:
            assert place.full_area.distance(other.full_area) >= clearance - 0.01


@pytest.mark.parametrize("clearance", [0.0, 1.0, 3.0])
def test_facilities_lie_inside_clear_of_each_other_and_north_to_south(clearance):
    lot = Polygon([(0, 0), (110, 10), (100, 90), (20, 80)])
    avoid = box(50, 40, 60, 50)
    wanted = [r.facility for r in parse_requests(["basketball", "tennis:2", "badminton:3", "playground"])]
    placed, missing = arrange(lot, wanted, clearance=clearance, avoid=avoid)
    assert not missing and len(placed) == 7
    check(lot, placed, clearance)
    assert all(p.full_area.distance(avoid) >= clearance - 0.01 for p in placed)
    assert all(p.from_north <= 20 for p in placed if p.facility.north_south)


def test_north_to_south_is_a_preference_not_a_law():
    placed, missing = arrange(box(0, 0, 40, 20), [FACILITIES["basketball"]], clearance=0)
    assert not missing and placed[0].from_north == pytest.approx(90)


def test_an_exact_fit_is_found():
    placed, missing = arrange(box(0, 0, 19, 64), [FACILITIES["basketball"]] * 2, clearance=0)
    assert len(placed) == 2 and not missing


@pytest.mark.parametrize(
    "lot, length, width, empty",
    [
        (box(0, 0, 30, 19.5), 2.0, None, False),  # 32 x 19 wanted: two metres too short, and not wide enough instead
        (box(0, 0, 40, 15), None, 4.0, False),
        (box(0, 0, 30, 15), None, None, False),
    ],
)
def test_what_does_not_fit_is_told_by_how_much(lot, length, width, empty):
    placed, (missing,) = arrange(lot, [FACILITIES["basketball"]], clearance=0)
    assert not placed and missing.empty_lot is empty
    for told, truth in ((missing.short_length, length), (missing.short_width, width)):
        assert told == (None if truth is None else pytest.approx(truth, abs=0.1))
    if length is None and width is None:
        assert missing.share == pytest.approx(15 / 19, abs=0.01)
    assert "does not fit: the lot is too small even when empty, it lacks" in missing.sentence()


def test_no_room_left_is_another_reason():
    placed, (missing,) = arrange(box(0, 0, 25, 40), [FACILITIES["basketball"]] * 2, clearance=0)
    assert len(placed) == 1 and missing.empty_lot and "no room left" in missing.sentence()


def test_given_places_are_kept_and_judged():
    good = PlacedFacility(FACILITIES["badminton"], (20.0, 20.0), 30.0)
    outside = PlacedFacility(FACILITIES["badminton"], (0.0, 20.0), 0.0)
    over = PlacedFacility(FACILITIES["badminton"], (22.0, 20.0), 30.0)
    lot = box(0, 0, 60, 60)
    placed, missing = arrange(lot, [FACILITIES["tennis"]], [good, outside, over], clearance=1.0)
    assert placed[0] is good and placed[1].facility.code == "tennis"
    check(lot, placed, 1.0)
    assert missing[0].outside == pytest.approx((9.1 / 2 + 1) * 17.4, rel=0.01) and missing[0].overlapping == 0
    assert missing[1].overlapping > 0 and "does not fit where it was asked for" in missing[1].sentence()


def test_the_summary_tells_which_courts_are_off_north_south(tmp_path):
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45), (5, 45)])
    said = summary(plan(orthophoto(tmp_path), lot, ["badminton@15,25,0", "badminton@45,25,70"]), None)
    assert "badminton court, 13.4 x 6.1 m, N-S" in said[1] and "off north-south" not in said[1]
    assert "ENE-WSW, 70 degrees off north-south" in said[2]


def test_lines_are_drawn_where_they_lie_in_sixteenths_of_a_pixel(tmp_path):
    """OpenCV counts from the middle of the first pixel, rasters from its corner."""
    ground = open_ground(orthophoto(tmp_path))
    window = draw.Window(100, 50, 200, 100)
    metres = ground.to_metres(np.array([[100.5, 50.5], [104.75, 58.5]]))
    assert draw._points(ground, window, 1.0, metres).tolist() == [[0, 0], [68, 128]]
    assert draw._points(ground, window, 2.0, metres).tolist() == [[8, 8], [144, 264]]


def test_the_north_arrow_has_one_size():
    arrows = [np.zeros((100, 100, 3), np.uint8) for _ in range(2)]
    for arrow, length in zip(arrows, (1, 5), strict=True):
        draw._north_arrow(arrow, length * np.array([0.6, -0.8]))
    assert np.array_equal(*arrows) and arrows[0].any()


def test_what_remains_when_the_scale_is_off():
    lot = box(0, 0, 40, 40)
    middle = [PlacedFacility(FACILITIES["basketball"], (20.0, 20.0), 0.0)]
    assert holds(lot, middle, 1.2) == [True] and holds(lot, middle, 1.3) == [False]


# Rasters and files


def test_the_mask_is_exact_to_the_pixel(tmp_path):
    ground = open_ground(orthophoto(tmp_path))
    place = PlacedFacility(FACILITIES["badminton"], (30.02, 25.03), 0.0)
    window = draw.Window(0, 0, 700, 500)
    playing, full = draw.mask(ground, [place], window)
    y, x = (np.indices((500, 700)) + 0.5) * 0.1
    for band, width, length in ((playing, 6.1, 13.4), (full, 9.1, 17.4)):
        inside = (np.abs(x - 30.02) < width / 2) & (np.abs(50 - y - 25.03) < length / 2)
        assert np.array_equal(band == 1, inside)
    lines = draw.lines(ground, [place], window)
    assert set(np.unique(lines)) == {0, 255}
    rows, columns = np.nonzero(lines)
    assert (columns.min(), columns.max()) == (int((30.02 - 3.05) * 10), int((30.02 + 3.05) * 10))
    assert (rows.min(), rows.max()) == (int((50 - 25.03 - 6.7) * 10), int((50 - 25.03 + 6.7) * 10))


def test_metres_pixels_and_coordinates_go_there_and_back(tmp_path):
    ground = open_ground(orthophoto(tmp_path))
    points = np.array([[3.0, 4.0], [60.0, 45.0]])
    assert ground.to_metres(ground.to_pixels(points)) == pytest.approx(points)
    assert ground.to_crs(points) == pytest.approx(points), "local metres start at the lower left corner"
    assert ground.from_crs(ground.to_crs(points)) == pytest.approx(points)


def projected(path, crs, lon, lat, step, turned=0.0):
    """A raster of 900 x 900 px in `crs` around a place; `step` [CRS units per px]; `turned` clockwise [deg]."""
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    right = np.array([math.cos(math.radians(turned)), -math.sin(math.radians(turned))]) * step
    down = np.array([-math.sin(math.radians(turned)), -math.cos(math.radians(turned))]) * step
    corner = np.array([x, y]) - 450 * (right + down)
    transform = Affine(right[0], down[0], corner[0], right[1], down[1], corner[1])
    with rasterio.open(path, "w", "GTiff", 900, 900, 3, crs, transform, "uint8") as out:
        out.write(np.full((3, 900, 900), 128, np.uint8))
    return path


@pytest.mark.parametrize(
    "crs, step, turned, gsd",
    [
        ("EPSG:32632", 0.1, 0, 0.1),
        ("EPSG:3857", 0.2, 0, 0.1),
        ("EPSG:32632", 0.1, 30, 0.1),
        ("EPSG:4326", 0.1 / 78_845, 0, 0.1),
    ],
)
def test_places_on_earth_have_true_metres_and_true_north(tmp_path, crs, step, turned, gsd):
    """At 60 degrees north, metres of EPSG:3857 are half as long as they say, and degrees half as wide as high."""
    path = projected(tmp_path / "a.tif", crs, 9.0, 60.0, step, turned)
    geod = pyproj.Geod(ellps="WGS84")
    ring = [geod.fwd(9.0, 60.0, b, 45)[:2] for b in (45, 135, 225, 315)]
    made = plan(path, lot_file(tmp_path / "lot.geojson", ring), ["basketball"])
    assert made.ground.gsd == pytest.approx(gsd, rel=0.005)
    assert made.lot.area == pytest.approx(2 * 45**2, rel=0.01)
    (place,) = made.placed
    corners = shapely.get_coordinates(shapely.transform(place.full_area, made.ground.to_crs))[:4]
    lon, lat = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(*corners.T)
    azimuth, _, length = geod.inv(lon, lat, np.roll(lon, -1), np.roll(lat, -1))
    assert sorted(length) == pytest.approx([19, 19, 32, 32], rel=0.005)
    along = azimuth[np.argmax(length)] % 180
    assert min(abs(along - place.bearing), 180 - abs(along - place.bearing)) < 0.2
    assert made.ground.north == pytest.approx(-turned, abs=0.1)


@pytest.mark.parametrize("turned", [30, 200])
def test_north_is_true_where_pixels_are_turned_and_not_square(tmp_path, turned):
    """It was told by columns and rows, as if they were as long: 19 degrees off in pixels twice as high as wide."""
    path = projected(tmp_path / "a.tif", "EPSG:32632", 9.0, 60.0, 0.1, turned)
    with rasterio.open(path, "r+") as out:
        out.transform = out.transform @ Affine.scale(1, 2)
    ground = open_ground(path)
    assert (ground.north + turned + 180) % 360 - 180 == pytest.approx(0, abs=0.01)
    here, east, north = ground.from_crs(np.add(ground.to_crs(np.array([[40.0, 70.0]])), [[0, 0], [10, 0], [0, 10]]))
    assert [*(east - here), *(north - here)] == pytest.approx([10, 0, 0, 10], abs=0.02)


@pytest.mark.parametrize("crs, step", [("EPSG:32660", 0.1), ("EPSG:4326", 0.1 / 78_845), ("EPSG:3857", 0.14)])
@pytest.mark.parametrize("cut", [False, True])
def test_a_lot_on_the_180th_meridian(tmp_path, crs, step, cut):
    """Its ring jumps from 180 to -180 or, as RFC 7946 wants it, there are two; it went around the Earth, or was not in
    a picture in degrees that goes on beyond 180."""
    path = projected(tmp_path / "a.tif", crs, 179.9999, 45.0, step)
    geod = pyproj.Geod(ellps="WGS84")
    ring = [geod.fwd(179.9999, 45.0, b, 45)[:2] for b in (45, 135, 225, 315)]
    assert min(ring)[0] < -179 < 179 < max(ring)[0]
    file = lot_file(tmp_path / "lot.geojson", ring)
    if cut:
        whole = shapely.Polygon([(x % 360, y) for x, y in ring])
        halves = [whole & shapely.box(179, 44, 180, 46), whole & shapely.box(180, 44, 181, 46)]
        halves[1] = shapely.transform(halves[1], lambda c: c - [360, 0])
        file.write_text(shapely.to_geojson(shapely.MultiPolygon(halves)))
    made = plan(path, file, ["basketball"])
    assert made.lot.area == pytest.approx(2 * 45**2, rel=0.02)
    assert abs(open_ground(path).north) < 3, "the grid of UTM is turned by 2.1 degrees there"
    export.write(made, tmp_path)
    text = json.loads((tmp_path / "layout.geojson").read_text())
    east = np.array(text["features"][0]["geometry"]["coordinates"][0])[:, 0]
    assert np.ptp(east) < 0.01 and abs(east.mean()) <= 180.001


def test_the_place_of_a_picture_may_come_from_ground_control_points(tmp_path):
    known = projected(tmp_path / "a.tif", "EPSG:32632", 9.0, 60.0, 0.1, 30)
    with rasterio.open(known) as file:
        t, crs, pixels = file.transform, file.crs, file.read()
    points = [
        GroundControlPoint(row, col, *transformed((col, row), t))
        for col, row in ((0, 0), (900, 0), (900, 900), (0, 900))
    ]
    with rasterio.open(tmp_path / "points.tif", "w", "GTiff", 900, 900, 3, dtype="uint8", gcps=points, crs=crs) as out:
        out.write(pixels)
    lot = lot_file(tmp_path / "lot.geojson", [(100, 100), (800, 100), (800, 800), (100, 800)])
    same = plan(known, lot, ["basketball"], lot_pixels=True)
    done = run(
        tmp_path / "points.tif", "--lot", lot, "--lot-pixels", "--facility", "basketball", "--out", tmp_path / "out"
    )
    assert done.returncode == 0, done.stderr
    meta, _, (area,), _ = pyogrio.raw.read(tmp_path / "out" / "layout.gpkg", layer="facilities")
    (place,) = same.placed
    corners = shapely.get_coordinates(shapely.transform(place.area, same.ground.to_crs))
    assert meta["crs"] == "EPSG:32632" and shapely.get_coordinates(shapely.from_wkb(area)) == pytest.approx(
        corners, abs=1e-3
    )
    with rasterio.open(tmp_path / "out" / "mask.tif") as mask:
        assert np.allclose(mask.transform, t, rtol=0, atol=1e-3) and mask.crs == crs  # [m]


WAYS = {"south-up": (Affine(1, 0, 0, 0, -1, 900), slice(None, None, -1), slice(None)),
        "mirrored": (Affine(-1, 0, 900, 0, 1, 0), slice(None), slice(None, None, -1))}  # fmt: skip


@pytest.mark.parametrize("turned", [0, 30])
@pytest.mark.parametrize("way", WAYS)
def test_rows_that_go_north_and_columns_that_go_west_show_the_same_ground(tmp_path, way, turned):
    """Such a picture is mirrored as it is stored, the facilities on its ground are not."""
    usual = projected(tmp_path / "a.tif", "EPSG:32632", 9.0, 60.0, 0.1, turned)
    with rasterio.open(usual) as file:
        about, pixels, t = file.profile, file.read(), file.transform
    flip, rows, columns = WAYS[way]
    with rasterio.open(tmp_path / "flipped.tif", "w", **{**about, "transform": t * flip}) as out:
        out.write(pixels[:, rows, columns])
    geod = pyproj.Geod(ellps="WGS84")
    lot = lot_file(tmp_path / "lot.geojson", [geod.fwd(9.0, 60.0, b, 45)[:2] for b in (20, 110, 200, 250, 290)])
    x, y = transformed((450, 430), t)
    wish = f"basketball@{x},{y},25"
    made, same = (plan(path, lot, [wish, "padel"]) for path in (tmp_path / "flipped.tif", usual))
    (court, _), (other, _) = (
        [shapely.get_coordinates(shapely.transform(p.full_area, each.ground.to_crs)) for p in each.placed]
        for each in (made, same)
    )
    assert court == pytest.approx(other, abs=1e-3)
    assert made.lot.area == pytest.approx(same.lot.area)
    steps = made.ground.from_crs(np.array([[x, y], [x + 10, y], [x, y + 10]]))
    assert np.diff(steps, axis=0) == pytest.approx(np.array([[10, 0], [-10, 10]]), abs=0.02), "as CAD gets them"
    assert made.ground.to_metres(made.ground.to_pixels(steps)) == pytest.approx(steps)


def test_local_metres_whose_rows_go_north_as_fix_writes_them(tmp_path):
    with rasterio.open(
        tmp_path / "a.tif", "w", "GTiff", 700, 500, 3, LOCAL_CRS, Affine(0.1, 0, 0, 0, 0.1, 0), "uint8"
    ) as out:
        out.write(np.full((3, 500, 700), 128, np.uint8))
    ground = open_ground(tmp_path / "a.tif")
    points = ground.from_crs(np.array([[20.0, 10.0], [30.0, 10.0], [20.0, 20.0]]))
    assert np.diff(points, axis=0) == pytest.approx(np.array([[10, 0], [-10, 10]]))
    assert abs(ground.north) == pytest.approx(180) and any("nothing ties" in note for note in ground.notes)


def test_how_well_the_metres_are_known_is_told_per_facility(tmp_path):
    report = {"scale": 0.1, "interval90": [0.092, 0.106]}
    path = orthophoto(tmp_path, report=report)
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45), (5, 45)])
    planned = plan(path, lot, ["basketball@30,25"])
    said = "\n".join(summary(planned, None))
    assert "true length 25.76 to 29.68 m (90 %)" in said and "10.00 cm/px (90 %: 9.20 to 10.60)" in said
    row = document(planned)["facilities"][0]
    assert (row["length_low"], row["length_high"]) == pytest.approx((28 * 0.92, 28 * 1.06)), (
        "lengths, not how far they are off"
    )
    assert row["fits_at_low_scale"] and row["fits_at_high_scale"]
    told = document(plan(path, lot, ["basketball@30,25"], scale_error=0.3))["facilities"][0]
    assert told["fits_at_low_scale"] is False and told["width_high"] == pytest.approx(15 * 1.3)
    (tmp_path / "scaled.tif.json").unlink()
    unknown = plan(path, lot, ["basketball"])
    assert document(unknown)["facilities"][0]["length_low"] is None
    assert any("no scaled.tif.json" in note for note in unknown.notes)


@pytest.mark.parametrize(
    "report, why",
    [
        ({"scale": 0.1, "unit": "m/px"}, ""),
        ({"scale": 0.05, "pictures": {"a.tif": [1400, 1000]}}, ""),  # resampled since
        ({"scale": 0.1, "pictures": {"a.tif": [2000, 1000]}}, ""),  # cropped since
        ({"scale": 0.115, "pictures": {"a.tif": [700, 500]}}, "has 10 cm/px, but the scale in .* is 11.5 cm/px"),
        ({"scale": 0.2, "pictures": {"a.tif": [700, 500]}}, "has 10 cm/px, but the scale in .* is 20 cm/px"),
        ({"scale": 0.1, "unit": "m/model-unit"}, None),
    ],
)
def test_a_report_of_another_scale_does_not_say_how_certain_this_one_is(tmp_path, report, why):
    """The pixel size was edited, or the report is another file's: a layout of false lengths had a narrow interval."""
    path = orthophoto(tmp_path, report={**report, "interval90": [report["scale"] * 0.98, report["scale"] * 1.02]})
    if why:
        with pytest.raises(InputError, match=why):
            open_ground(path)
        assert open_ground(path, 0.1).interval == (0.9, 1.1)
    else:
        assert (open_ground(path).interval is None) == (why is None)


@pytest.mark.parametrize(("east", "north"), [(65, 45), (9e4, 9e4)])
def test_what_must_be_avoided_does_not_hold_a_facility_when_the_scale_is_off(tmp_path, east, north):
    """Also where it is all the trees of a city, hardly any of them in the picture: these were said to lie outside."""
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45), (5, 45)])
    tree = lot_file(tmp_path / "tree.geojson", [(40, 5), (east, 5), (east, north), (40, north)])
    path = orthophoto(tmp_path)
    text = document(plan(path, lot, ["basketball@29,25"], avoid=tree, scale_error=0.2))
    (row,) = text["facilities"]
    assert row["fits_at_high_scale"] and row["fits_at_low_scale"] is False, "its 19 m become 23.75, 29 + 11.9 > 40"
    assert text["free_area_m2"] == pytest.approx(60 * 40 - 25 * 40 - 32 * 19, abs=0.1)
    (alone,) = document(plan(path, lot, ["basketball@29,25"], scale_error=0.2))["facilities"]
    assert alone["fits_at_low_scale"] is True


def run(*arguments):
    return in_process.run("layout", *arguments)


def test_a_folder_with_everything_in_it(tmp_path):
    path = orthophoto(tmp_path, report={"scale": 0.1, "interval90": [0.096, 0.104]})
    lot = lot_file(tmp_path / "lot.geojson", [(50, 50), (650, 40), (660, 450), (60, 440)])
    wishes = ["basketball", "badminton:2", "parking-DE:8", "football"]
    options = [part for wish in wishes for part in ("--facility", wish)]
    out = tmp_path / "layout"
    before = path.read_bytes()
    done = run(path, "--lot", lot, "--lot-pixels", *options, "--out", out)
    assert done.returncode == 3, done.stderr
    assert done.stdout.startswith("placed     4 of 5 facilities")
    assert done.stderr.startswith("error: 1 of 5 facilities does not fit: football\n")
    assert "football pitch (111.0 x 74.0 m with its run-off) does not fit" in done.stdout
    assert "its layer" not in done.stdout  # the lot's file has one
    names = (
        "layout.json layout.gpkg layout.geojson layout.dxf mask.tif lines.tif mask.png lines.png lot.png overlay.png"
    )
    assert {p.name for p in out.iterdir()} == {*names.split(), "prompt.txt", ".orthoscale.json"}
    text = json.loads((out / "layout.json").read_text())
    assert [f["number"] for f in text["facilities"]] == [1, 2, 3, 4]
    assert "28 x 15 m" in (out / "prompt.txt").read_text()

    assert set(pyogrio.list_layers(out / "layout.gpkg")[:, 0]) == {"lot", "facilities", "run_off", "lines"}
    meta, _, shapes, _ = pyogrio.raw.read(out / "layout.gpkg", layer="facilities")
    areas = [shapely.from_wkb(s).area for s in shapes]
    assert areas == pytest.approx([f["length"] * f["width"] for f in text["facilities"]])
    assert "orthoscale local metres" in meta["crs"]
    first = json.loads((out / "layout.geojson").read_text())["features"][0]
    assert shapely.geometry.shape(first["geometry"]).area == pytest.approx(areas[0])
    there, _, shapes, _ = pyogrio.raw.read(out / "layout.geojson")
    assert "orthoscale local metres" in there["crs"], "without a CRS, they are taken for degrees"
    assert len(shapes) == len(areas) and list(there["fields"]) == list(meta["fields"])

    drawing = ezdxf.readfile(out / "layout.dxf")
    assert drawing.units == ezdxf.units.M and not drawing.audit().has_errors
    in_cad = [Polygon([p[:2] for p in e]) for e in drawing.modelspace().query('LWPOLYLINE[layer=="FACILITIES"]')]
    assert [p.area for p in in_cad] == pytest.approx(areas)

    with (
        rasterio.open(out / "mask.tif") as mask,
        rasterio.open(path) as ortho,
        rasterio.open(out / "lines.tif") as lines,
    ):
        for raster in (mask, lines):
            assert (raster.shape, raster.transform, raster.crs) == (ortho.shape, ortho.transform, ortho.crs)
        numbers = mask.read(1)
        for row, area in zip(text["facilities"], areas, strict=True):
            assert (numbers == row["number"]).sum() * 0.01 == pytest.approx(area, rel=0.02)
            assert numbers[int(row["row_px"]), int(row["column_px"])] == row["number"]
        drawn = lines.read(1)
    crop = cv2.imread(str(out / "lines.png"), cv2.IMREAD_UNCHANGED)
    assert (crop == 255).sum() == (drawn == 255).sum() > 1000
    assert crop.shape == cv2.imread(str(out / "lot.png")).shape[:2]
    assert path.read_bytes() == before
    again = run(path, "--lot", lot, "--lot-pixels", *options, "--out", out)
    assert again.returncode == 2 and "already exists" in again.stderr


def test_coordinates_of_a_world_file_alone_are_no_degrees(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((500, 700, 3), 120, np.uint8))
    (tmp_path / "a.pgw").write_text("0.1\n0\n0\n-0.1\n0.05\n49.95\n")
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45), (5, 45)])
    export.write(plan(tmp_path / "a.png", lot, ["basketball"]), tmp_path)
    assert "orthoscale local metres" in pyogrio.read_info(tmp_path / "layout.geojson")["crs"]


def test_the_prompt_names_sizes_and_places(tmp_path):
    path = orthophoto(tmp_path)
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45), (5, 45)])
    text = prompt(plan(path, lot, ["badminton@15,16", "badminton@55,34"]))
    assert "2 times a badminton court" in text and "southwest of the lot" in text and "northeast of the lot" in text


def test_a_side_that_is_nearly_north_is_not_told_to_point_south(tmp_path):
    """Bearings of sides are below 180 degrees, also when they are rounded."""
    path = orthophoto(tmp_path)
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45), (5, 45)])
    layout = plan(path, lot, ["badminton@35,25,179.998"])
    assert "long side 0 degrees from north" in prompt(layout)
    assert document(layout)["facilities"][0]["bearing"] == 0


@pytest.mark.parametrize(
    "ring, options, code, word",
    [
        ([(5, 5), (65, 5), (65, 45)], ["--facility", "curling"], 2, "Known are"),
        ([(5, 5), (65, 5), (65, 45)], ["--facility", "football"], 3, "nothing fits"),
        ([(5, 5), (65, 5), (65, 45)], [], 2, "--facility"),
        ([(5, 5), (65, 5), (65, 45)], ["--facility", "padel", "--clearance", "-1"], 2, "clearance"),
        ([(5, 5), (65, 5), (65, 45)], ["--facility", "padel", "--scale-error", "120"], 2, "100 per cent"),
        ([(500, 500), (560, 500), (560, 560)], ["--facility", "padel"], 5, "outside"),
        ([(50, 30), (660, 30), (660, 440), (50, 440)], ["--facility", "padel"], 5, "add --lot-pixels"),
        ([(9, 48), (9.001, 48), (9, 48.001)], ["--facility", "padel"], 5, "a lot of 5e-07 m2"),
        ([(5, 5), (5, 5), (5, 5)], ["--facility", "padel"], 5, "no polygon"),
        (None, ["--facility", "padel"], 5, "not GeoJSON"),
    ],
)
def test_bad_input_ends_in_one_sentence_and_nothing_written(tmp_path, ring, options, code, word):
    path = orthophoto(tmp_path)
    lot = tmp_path / "lot.geojson"
    lot.write_text("no GeoJSON") if ring is None else lot_file(lot, ring)
    done = run(path, "--lot", lot, *options, "--out", tmp_path / "out")
    assert done.returncode == code, done.stderr
    assert word in done.stderr and "Traceback" not in done.stderr and not (tmp_path / "out").exists()


@pytest.mark.parametrize("more", [[], ["--json"]])
def test_what_does_not_fit_ends_with_a_code_of_its_own_and_leaves_the_others(tmp_path, more):
    """A script would take exit code 0 for a layout with all that it asked for."""
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45), (5, 45)])
    wanted = ["--facility", "football", "--facility", "padel:2", "--facility", "football"]
    done = run(orthophoto(tmp_path), "--lot", lot, *wanted, "--out", tmp_path / "out", *more)
    assert done.returncode == 3
    assert "2 of 4 facilities do not fit: football\nOnly the others are placed." in done.stderr
    made = json.loads((tmp_path / "out" / "layout.json").read_text())
    assert [row["code"] for row in made["facilities"]] == ["padel", "padel"]
    assert json.loads(done.stdout) == made if more else "placed     2 of 4" in done.stdout


def test_of_a_file_with_several_layers_the_one_that_is_read_is_told(tmp_path):
    """Of a project's GeoPackage any first layer was taken for the lot."""
    for layer in ("old", "lot"):
        shape = np.array([shapely.to_wkb(box(5, 5, 65, 45))], object)
        more = {"append": True} if layer == "lot" else {}
        pyogrio.raw.write(
            tmp_path / "a.gpkg", shape, [], np.array([], object), layer=layer, geometry_type="Polygon", crs=None, **more
        )
    assert (
        "a.gpkg: its layer old is read, and not lot" in plan(orthophoto(tmp_path), tmp_path / "a.gpkg", ["padel"]).notes
    )


def test_a_lot_outside_is_told_where_the_picture_lies(tmp_path):
    """In numbers that can be read: the corner of a copy that `fix` writes may lie at -9e-29."""
    path = orthophoto(tmp_path)
    with rasterio.open(path, "r+") as file:
        file.transform = Affine(0.1, 0, -9.2e-29, 0, -0.1, 50)
    lot = lot_file(tmp_path / "lot.geojson", [(500, 500), (560, 500), (560, 560)])
    done = run(path, "--lot", lot, "--facility", "padel", "--out", tmp_path / "out")
    assert "from (0, 0) to (70, 50) in its own coordinates" in done.stderr


def test_a_lot_with_parts_that_only_touch_the_picture(tmp_path):
    """What the picture cuts from it is a line as well, which had no outline to draw: a bug was reported."""
    lot, parts = tmp_path / "lot.geojson", [box(5, 5, 65, 45), box(70, 10, 75, 20)]
    lot.write_text(shapely.to_geojson(shapely.MultiPolygon(parts)))
    done = run(orthophoto(tmp_path), "--lot", lot, "--facility", "padel", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out" / "layout.json").read_text())["lot_area_m2"] == 60 * 40


def test_a_lot_whose_outline_crosses_itself_and_turns_back(tmp_path):
    """Repaired, it is two areas and a line; the areas were not found beside the line."""
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 45), (65, 5), (5, 45), (1, 45), (5, 45)])
    made = plan(orthophoto(tmp_path), lot, ["padel"])
    assert made.lot.area == pytest.approx(60 * 40 / 2)


def test_an_orthophoto_with_a_world_file_alone(tmp_path):
    with rasterio.open(
        tmp_path / "a.tif", "w", "GTiff", 700, 500, 3, None, Affine(0.1, 0, 5, 0, -0.1, 9), "uint8"
    ) as out:
        out.write(np.full((3, 500, 700), 128, np.uint8))
    lot = lot_file(tmp_path / "lot.geojson", [(50, 50), (650, 40), (660, 450), (60, 440)])
    done = run(tmp_path / "a.tif", "--lot", lot, "--lot-pixels", "--facility", "tennis", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    meta, _, (area,), _ = pyogrio.raw.read(tmp_path / "out" / "layout.gpkg", layer="facilities")
    assert meta["crs"] is None and shapely.from_wkb(area).area == pytest.approx(23.77 * 10.97)


def test_an_orthophoto_without_metres_is_refused(tmp_path):
    orthophoto(tmp_path)
    lot = lot_file(tmp_path / "lot.geojson", [(5, 5), (65, 5), (65, 45)])
    done = run(tmp_path / "plain.png", "--lot", lot, "--facility", "padel")
    assert done.returncode == 5 and "has no scale in metres" in done.stderr and "orthoscale fix" in done.stderr


def test_the_list_has_sources():
    shown = run("--list")
    assert shown.returncode == 0 and "FIBA" in shown.stdout and "parking-CC:N" in shown.stdout


@pytest.mark.slow
@pytest.mark.real
def test_a_sports_complex_on_a_real_lot(data, tmp_path):
    """A yard in Manila; World Mercator stretches its metres by 3.3 %, the courts have theirs all the same."""
    yard = [(8, 1110), (120, 1130), (260, 1230), (310, 1300), (325, 1480), (300, 1560), (320, 1640), (480, 1740),
            (470, 1800), (400, 1850), (240, 1960), (30, 1990), (8, 1900)]  # fmt: skip
    lot = lot_file(tmp_path / "lot.geojson", yard)
    wishes = ["basketball", "tennis", "badminton:2", "football"]
    made = plan(data / "orthophotos" / "manila.tif", lot, wishes, lot_pixels=True, scale_error=0.07)
    assert made.ground.gsd == pytest.approx(0.0967, rel=0.005)
    placed = [p.facility.code for p in made.placed]
    assert placed.count("basketball") == placed.count("tennis") == 1 and "badminton" in placed
    check(made.lot, made.placed, 1.0)
    court = next(p for p in made.placed if p.facility.code == "basketball")
    sides = np.linalg.norm(np.diff(made.ground.to_pixels(court.on_ground(court.facility.outline)), axis=0), axis=1)
    assert sides.max() == pytest.approx(28 / 0.0967, rel=0.005)
    football = next(m for m in made.missing if m.facility.code == "football")
    assert not football.empty_lot and "lacks" in football.sentence()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_beside_a_shapefile_is_not_waited_for(tmp_path):
    (tmp_path / "lot.shp").write_bytes(b"\0\0\x27\x0a")
    os.mkfifo(tmp_path / "lot.dbf")
    with pytest.raises(InputError, match="lot.dbf is a pipe or a device"):
        plan(orthophoto(tmp_path), tmp_path / "lot.shp", ["basketball"])
