"""--against: the scale, the place and the direction of an orthophoto by a map of another date, with known truth."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyproj
import pytest
import rasterio
import shapely
from rasterio.transform import Affine, from_origin
from support import in_process
from support.aerial import other_date

import orthoscale
from orthoscale.actions.against import _found_on, _pictures, on_map
from orthoscale.core.evidence import BY_MAP, Evidence
from orthoscale.sources.on_map import OnMap
from orthoscale.sources.opening import open_source
from orthoscale.sources.raster import RasterSource
from orthoscale.sources.satellite import Satellite
from orthoscale.synthetic import make_scene, write_colmap
from orthoscale.synthetic.render import render_ortho

TOWN = Path(__file__).parent.parent / "examples/town/ortho.jpg"
TOWN_GSD = 0.085  # [m/px], its truth
ZOOM, TURN = 0.8, 35.0  # of the picture that is looked for: coarser, and turned against the map [deg]
GSD = TOWN_GSD / ZOOM


def written(path, rgb, crs=None, transform=None):
    height, width = rgb.shape[:2]
    with rasterio.open(path, "w", "GTiff", width, height, 3, crs, transform, "uint8", photometric="RGB") as out:
        out.write(np.moveaxis(rgb, -1, 0))
    return path


def cut(rgb, turn, zoom, side):
    """The middle of a picture, turned by `turn` [deg] and at `zoom`; and (2, 3) from its pixels to the picture's."""
    turn = np.radians(turn)
    linear = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) / zoom
    middle = np.array(rgb.shape[1::-1]) / 2
    matrix = np.column_stack([linear, middle - linear @ [side / 2, side / 2]])
    centred = np.column_stack([linear, matrix[:, 2] + linear @ [0.5, 0.5] - 0.5])  # OpenCV's pixels
    return cv2.warpAffine(rgb, centred, (side, side), flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP), matrix


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """``map.tif``: the town at 0.17 m/px in UTM zone 32; ``ortho.png``: its middle at another date, turned, coarser and
    without a place; and from pixels of that to the map's coordinates."""
    folder = tmp_path_factory.mktemp("against")
    rgb = cv2.cvtColor(cv2.imread(str(TOWN)), cv2.COLOR_BGR2RGB)
    corner = from_origin(500_000, 5_400_000, TOWN_GSD, TOWN_GSD)
    half = cv2.resize(rgb, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    written(folder / "map.tif", half, "EPSG:32632", corner @ corner.scale(rgb.shape[1] / half.shape[1]))
    changed = other_date(rgb, np.random.default_rng(1), TOWN_GSD)
    picture, matrix = cut(changed, TURN, ZOOM, 800)
    cv2.imwrite(str(folder / "ortho.png"), picture[..., ::-1])
    pixels = np.array([[0, 0], [800, 0], [800, 800], [0, 800], [400, 400]], float)
    there = np.array([corner @ tuple(p) for p in pixels @ matrix[:, :2].T + matrix[:, 2]])
    return folder, pixels, there


@pytest.fixture(scope="module")
def ground_gsd(pair):
    """True metres of a pixel of the picture: UTM's metres are a bit short in the middle of a zone."""
    _, pixels, there = pair
    lon, lat = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True).transform(*there.T)
    return pyproj.Geod(ellps="WGS84").inv(lon[0], lat[0], lon[1], lat[1])[2] / 800


@pytest.fixture(scope="module")
def lies(pair):
    folder = pair[0]
    return on_map(
        open_source(folder / "ortho.png"), Satellite.open(folder / "map.tif"), (1.06 * GSD, 0.05), cache=False
    )


@pytest.mark.slow
def test_the_scale_is_one_more_piece_of_evidence(lies, ground_gsd):
    (evidence,) = lies.evidence
    assert evidence.kind == BY_MAP and "map.tif" in evidence.says
    assert 0.004 < evidence.relative_sd < 0.05
    assert evidence.value == pytest.approx(ground_gsd, rel=3 * evidence.relative_sd)


@pytest.mark.slow
def test_pixels_that_are_not_square_are_made_square_before_they_are_looked_for(pair, tmp_path):
    """The scale was 17 % off, and sure to 1.6 %."""
    folder, pixels, there = pair
    narrow = cv2.resize(cv2.imread(str(folder / "ortho.png")), (533, 800), interpolation=cv2.INTER_AREA)
    wide = GSD * 800 / 533
    path = written(tmp_path / "ortho.tif", narrow[..., ::-1], "EPSG:32632", Affine(wide, 0, 500_100, 0, -GSD, 5.4e6))
    square = float(np.sqrt(wide * GSD))
    got = on_map(open_source(path), Satellite.open(folder / "map.tif"), (1.03 * square, 0.05), cache=False)
    (evidence,) = got.evidence
    assert evidence.value == pytest.approx(square, rel=3 * evidence.relative_sd)
    place = got.place(got.gsd_m).transform
    put = np.array([place @ tuple(p) for p in pixels * (533 / 800, 1)])
    assert np.hypot(*(put - there).T).max() < 1.5


def test_pixels_of_a_plan_need_not_be_square(tmp_path):
    oblong = Affine(0.3, 0, 500_000, 0, -0.1, 5_400_000)
    source = open_source(written(tmp_path / "ortho.tif", np.zeros((120, 80, 3), np.uint8), "EPSG:32632", oblong))
    (seen,) = _pictures(source)
    seen = replace(seen, gsd=source.claimed.gsd_m * seen.gsd)
    assert seen.size == pytest.approx([24, 12], rel=1e-3) and seen.at(0.2).valid.shape == (60, 120)


@pytest.mark.slow
def test_a_picture_whose_rows_go_north_is_found_too(pair, tmp_path):
    folder, pixels, there = pair
    flipped = cv2.imread(str(folder / "ortho.png"))[::-1, :, ::-1]
    path = written(tmp_path / "ortho.tif", flipped, "EPSG:32632", Affine(GSD, 0, 500_100, 0, GSD, 5.4e6))
    got = on_map(open_source(path), Satellite.open(folder / "map.tif"), (1.03 * GSD, 0.05), cache=False)
    (evidence,) = got.evidence
    assert evidence.value == pytest.approx(GSD, rel=3 * evidence.relative_sd)
    place = got.place(got.gsd_m).transform
    put = np.array([place @ tuple(p) for p in pixels * (1, -1) + (0, 800)])
    assert np.hypot(*(put - there).T).max() < 1.5 and place.determinant > 0


@pytest.mark.slow
def test_place_and_direction_are_the_maps(pair, lies):
    _, pixels, there = pair
    place = lies.place(lies.gsd_m)
    got = np.array([place.transform @ tuple(p) for p in pixels])
    assert np.hypot(*(got - there).T).max() < 1.5
    assert pyproj.CRS.from_user_input(place.crs).to_epsg() == 32632


@pytest.mark.parametrize(("heading", "told"), [(359.85, 0), (0.2, 0), (359.4, 359), (35.1, 35)])
def test_a_direction_is_below_360_degrees(heading, told):
    candidate = SimpleNamespace(middle=(8.5, 47.25), heading=np.radians(heading))
    assert _found_on("map.tif", candidate).endswith(f"longitude 8.500000, latitude 47.250000, heading {told} degrees")


@pytest.mark.slow
def test_another_scale_grows_about_the_middle(pair, lies):
    one, two = lies.place(lies.gsd_m).transform, lies.place(1.1 * lies.gsd_m).transform
    assert two @ (400, 400) == pytest.approx(one @ (400, 400), abs=1e-6)
    sides = [np.subtract(t @ (800, 0), t @ (0, 0)) for t in (one, two)]
    assert sides[1] == pytest.approx(1.1 * sides[0])


@pytest.mark.slow
def test_another_place_gives_nothing_and_says_so(pair, tmp_path):
    folder = pair[0]
    rgb = cv2.imread(str(TOWN))[..., ::-1]
    elsewhere = np.ascontiguousarray(cv2.flip(rgb, 1))
    path = tmp_path / "ortho.png"
    cv2.imwrite(str(path), cut(elsewhere, 10, ZOOM, 800)[0][..., ::-1])
    got = on_map(open_source(path), Satellite.open(folder / "map.tif"), (GSD, 0.05), cache=False)
    assert not got.evidence and got.place(0.1) is None
    assert got.notes[0].startswith("not found on map.tif: best candidate has")


def test_a_picture_that_is_small_on_the_map_is_no_error(pair, tmp_path):
    path = tmp_path / "small.png"
    cv2.imwrite(str(path), cv2.imread(str(pair[0] / "ortho.png"))[:90, :90])
    got = on_map(open_source(path), Satellite.open(pair[0] / "map.tif"), (GSD, 0.05), cache=False)
    assert not got.evidence and "each side needs 96 px" in got.notes[0]


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A reconstruction of three frames of a drawn suburb, and ``map.tif`` of the same suburb in another light."""
    folder = tmp_path_factory.mktemp("flight")
    scene = make_scene(5, None, 130.0, 60, "suburb")
    write_colmap(scene, folder, METRES_PER_UNIT, 3, 90.0, 75.0, 600.0, 640, 480, seed=5)
    rgb, _ = render_ortho(scene, 0.2, 9)
    side = rgb.shape[0] * 0.2
    written(folder / "map.tif", rgb, "EPSG:32632", from_origin(500_000 - side / 2, 5_400_000, 0.2, 0.2))
    return folder


METRES_PER_UNIT = 3.7


@pytest.mark.slow
def test_a_reconstruction_is_found_by_its_pictures_of_the_ground(flight):
    satellite = Satellite.open(flight / "map.tif")
    got = on_map(open_source(flight / "sparse"), satellite, (1.04 * METRES_PER_UNIT, 0.05), cache=False)
    (evidence,) = got.evidence
    assert evidence.value == pytest.approx(METRES_PER_UNIT, rel=max(3 * evidence.relative_sd, 0.01)), got
    assert evidence.relative_sd < 0.05 and got.place(1.0) is None
    lon, lat = re.search(r"around longitude ([\d.]+), latitude ([\d.]+),", got.notes[0]).groups()
    assert float(lon) == pytest.approx(9.0, abs=1e-3) and float(lat) == pytest.approx(48.752, abs=1e-3)


def told(value, sd):
    """What stands in for a match: of this scale [m/px], in the map's CRS, upside down."""
    affine = np.array([[-value, 0, 500_100], [0, value, 5_399_900]])
    return OnMap(
        (Evidence(BY_MAP, value, sd, "its place on map.tif"),),
        ("found",),
        pyproj.CRS.from_epsg(32632),
        affine,
        value,
        (1, 1),
    )


@pytest.fixture(scope="module")
def boxed(pair):
    """The example's own boxes; the vehicles say 0.085 m/px."""
    boxes = pair[0] / "boxes.json"
    result = orthoscale.estimate(TOWN, fleet="DE", anchors=["none"])
    orthoscale.save_detections(result.detections, boxes)
    return ["--detections", boxes, "--fleet", "DE", "--anchors", "none"], result.scale


@pytest.mark.slow
def test_vehicles_and_map_are_pooled_and_the_copy_lies_there(pair, boxed, tmp_path, monkeypatch):
    words, alone = boxed
    monkeypatch.setattr("orthoscale.actions.estimate.on_map", lambda *_: told(alone.value * 1.01, 0.004))
    line = ["fix", TOWN, *words, "--against", pair[0] / "map.tif", "--report", "json", "--out", tmp_path / "out.tif"]
    done = in_process.run(*line, "--also", "geojson")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out.tif.json").read_text())
    assert [e["kind"] for e in report["evidence"]] == [BY_MAP]
    low, high = report["interval90"]
    assert high - low <= alone.interval90[1] - alone.interval90[0]
    with rasterio.open(tmp_path / "out.tif") as out:
        assert out.crs.to_epsg() == 32632 and out.transform.a < 0
        assert alone.value < abs(out.transform.a) < 1.01 * alone.value
        corners = pyproj.Transformer.from_crs(out.crs, "EPSG:4326", always_xy=True).transform_bounds(*out.bounds)
    outlines = [f["geometry"] for f in json.loads((tmp_path / "out.tif.geojson").read_text())["features"]]
    places = shapely.points(np.concatenate([np.array(each["coordinates"][0]) for each in outlines]))
    assert len(outlines) > 20 and shapely.box(*corners).buffer(1e-4).contains(places).all()


@pytest.mark.slow
def test_without_a_place_on_the_map_there_is_no_geojson(pair, boxed, tmp_path, monkeypatch):
    words, alone = boxed
    monkeypatch.setattr("orthoscale.actions.estimate.on_map", lambda *_: OnMap(notes=("not found on map.tif",)))
    line = ["fix", TOWN, *words, "--against", pair[0] / "map.tif", "--also", "geojson", "--also", "gpkg"]
    done = in_process.run(*line, "--report", "json", "--out", tmp_path / "out.tif")
    assert done.returncode == 6 and "out.tif.geojson could not be written" in done.stderr, done.stderr
    assert "no place on Earth" in done.stderr
    assert (tmp_path / "out.tif.gpkg").exists() and not (tmp_path / "out.tif.geojson").exists()


@pytest.mark.slow
def test_a_map_that_contradicts_the_vehicles_is_exit_code_4(pair, boxed, tmp_path, monkeypatch):
    words, alone = boxed
    monkeypatch.setattr("orthoscale.actions.estimate.on_map", lambda *_: told(alone.value * 1.3, 0.01))
    done = in_process.run("fix", TOWN, *words, "--against", pair[0] / "map.tif", "--out", tmp_path / "out.tif")
    assert done.returncode == 4 and "its place on map.tif" in done.stderr and not (tmp_path / "out.tif").exists()


@pytest.mark.parametrize(
    "name, word", [("none.tif", "does not exist"), ("ortho.png", "no place on Earth"), ("text.tif", "text.tif")]
)
def test_what_is_no_map_is_refused_before_anything_is_measured(pair, tmp_path, name, word):
    (tmp_path / "text.tif").write_text("no map")
    path = pair[0] / name if name == "ortho.png" else tmp_path / name
    done = in_process.run("estimate", TOWN, "--against", path, "--fleet", "DE")
    assert done.returncode in (2, 5) and word in done.stderr and "Traceback" not in done.stderr


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.parametrize("name, gsd, fleet", [("manila.tif", 0.0967, "PH"), ("banepa.jpg", 0.132, "NP")])
def test_real_orthophotos_against_maps_of_another_light_scale_and_direction(data, tmp_path, name, gsd, fleet):
    """The whole way with the detector: where vehicles err by up to 10 %, the map does by little."""
    source = RasterSource.open(data / "orthophotos" / name)
    rgb = source.read(0, 0, source.width, source.height, source.width, source.height)
    coarse = cv2.resize(
        other_date(rgb, np.random.default_rng(2), gsd), None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA
    )
    turned, matrix = cut(coarse, 30.0, 1.0, int(min(coarse.shape[:2]) * 1.3))
    step = gsd * source.width / coarse.shape[1]
    corner = from_origin(500_000, 0.0, step, step)
    linear = rasterio.Affine(*matrix.ravel())
    # Zone 51 at the equator, where metres are metres but for the zone's 0.9996.
    written(tmp_path / "map.tif", turned, "EPSG:32651", corner @ linear)
    lone = tmp_path / "ortho.png"
    cv2.imwrite(str(lone), rgb[..., ::-1])
    result = orthoscale.estimate(lone, fleet=fleet, against=tmp_path / "map.tif", anchors=["none"], cache=False)
    (evidence,) = [e for e in result.scale.evidence if e.kind == BY_MAP]
    assert evidence.value == pytest.approx(gsd, rel=max(3 * evidence.relative_sd, 0.01))
    assert result.scale.value == pytest.approx(gsd, rel=0.03) or result.disagreement is not None
