"""What `fix` writes for orthophotos as they really are, what `check` says of their claims, and files for others."""

import csv
import json
import math
import os
import re
import sqlite3
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pyogrio
import pyproj
import pytest
import rasterio
import shapely
from click.testing import CliRunner
from rasterio.control import GroundControlPoint
from rasterio.transform import Affine
from support.pictures import squares

import orthoscale
from orthoscale.actions.check import Comparison, comparisons
from orthoscale.actions.many import run_many
from orthoscale.core.claims import OF_A_COPY, own_claim
from orthoscale.core.detections import Swept, Tile
from orthoscale.core.evidence import Evidence
from orthoscale.core.projection.planar import ground_size
from orthoscale.core.remarks import CAUTION, INFO, SEVERITIES, Remark
from orthoscale.core.scale import Scale
from orthoscale.errors import EvidenceDisagrees, TooLittleEvidence, UsageError
from orthoscale.formats.csv_table import write_csv
from orthoscale.formats.names import json_in_utf8
from orthoscale.formats.vector import write_layer
from orthoscale.report.extras import write_tiles
from orthoscale.report.geo import outlines, table
from orthoscale.report.pictures import REJECTED_RGB, USED_RGB
from orthoscale.report.stored import pixel_size
from orthoscale.requests import EstimateRequest
from orthoscale.sources.raster import RasterSource

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul")
W, H, GSD = 900, 700, 0.08
FLEET = {
    "name": "cars", "source": "a test", "year": 2020, "length": [4.4, 0.4], "width": [1.8, 0.1], "height": [1.5, 0.1],
    "mean_sd": [0.05, 0.02, 0.05], "shares": {"mini": 0.3, "mid": 0.7},
}  # fmt: skip
UTM = Affine(GSD * 0.9996, 0, 500_000, 0, -GSD * 0.9996, 5_400_000)  # GSD on the ground, at the central meridian


def picture(path, crs=None, transform=None, gcps=None, **profile):
    pixels = np.moveaxis(squares(W, H, 0, 255), -1, 0)
    profile = {"driver": "GTiff", "width": W, "height": H, "count": 3, "dtype": "uint8", **profile}
    if transform is not None:
        profile["transform"] = transform
    with rasterio.open(path, "w", crs=crs, **profile) as dataset:
        dataset.write(pixels)
        if gcps:
            dataset.gcps = gcps
    return path


@pytest.fixture(scope="module")
def boxes(tmp_path_factory):
    """Detections that give GSD: 80 vehicles of the German fleet, 4.37 x 1.79 m with its spread."""
    rng = np.random.default_rng(1)
    size = np.exp(rng.multivariate_normal(np.log([4.37, 1.79]), [[0.008, 0.003], [0.003, 0.002]], 80)) / GSD
    apart = np.stack(np.meshgrid(np.linspace(60, W - 60, 10), np.linspace(60, H - 60, 8)), -1).reshape(-1, 2)
    rows = [
        {"cx": x, "cy": y, "length": length, "width": width, "angle": a, "score": 0.8}
        for (x, y), (length, width), a in zip(apart, size, rng.uniform(-1.5, 1.5, 80), strict=True)
    ]
    path = tmp_path_factory.mktemp("boxes") / "boxes.json"
    path.write_text(json.dumps({"a.tif": rows}))
    return path


def fixed(path, out, boxes, **options):
    return orthoscale.fix(path, out, detections=boxes, fleet="DE", override=True, force=True, **options)


def test_what_opening_cautioned_of_is_said_where_no_vehicles_are_known(tmp_path):
    """Pixels of 0.08 x 0.16 m: it was "no boxes have the shape of vehicles", and nothing of the pixels."""
    oblong = picture(tmp_path / "a.tif", "EPSG:32632", Affine(0.08, 0, 500_000, 0, -0.16, 5_400_000))
    rows = [
        {"cx": 60.0 + 40 * k, "cy": 90.0, "length": 90.0, "width": 9.0, "angle": 0.0, "score": 0.9} for k in range(9)
    ]
    (tmp_path / "boxes.json").write_text(json.dumps({"a.tif": rows}))
    with pytest.raises(TooLittleEvidence) as told:
        orthoscale.estimate(oblong, detections=tmp_path / "boxes.json", fleet="DE", anchors=["none"])
    assert "pixels are 0.5 times as wide as high on the ground" in told.value.hint and "warp it" in told.value.hint


# Where the copy lies


def gcps(gsd=GSD):
    t = Affine(gsd * 0.9996, 0, 500_000, 0, -gsd * 0.9996, 5_400_000) * Affine.rotation(10)
    points = [(0, 0), (W, 0), (0, H), (W, H)]
    return [GroundControlPoint(row=y, col=x, x=(t * (x, y))[0], y=(t * (x, y))[1]) for x, y in points], "EPSG:32632"


CASES = {
    "nothing": ({}, "local metres, origin at the lower left corner"),
    "UTM": ({"crs": "EPSG:32632", "transform": UTM}, "WGS 84 / UTM zone 32N"),
    "rotated": ({"crs": "EPSG:32632", "transform": UTM * Affine.rotation(25)}, "rotated by"),
    "upside down": ({"crs": "EPSG:32632", "transform": UTM * Affine.rotation(150)}, "; rotated by -150 degrees"),
    "south-up": ({"crs": "EPSG:32632", "transform": UTM * Affine.scale(1, -1)}, "rows go north"),
    "mirrored": ({"crs": "EPSG:32632", "transform": UTM * Affine.scale(-1, 1)}, "its first column is the easternmost"),
    "degrees": ({"crs": "EPSG:4326", "transform": Affine(1e-6, 0, 10, 0, -7e-7, 50)}, "degrees per pixel"),
    "feet": ({"crs": "EPSG:3734", "transform": Affine(0.26, 0, 2e6, 0, -0.26, 6e5)}, "US survey foot per pixel"),
    "Web Mercator": ({"crs": "EPSG:3857", "transform": Affine(0.16, 0, 1e6, 0, -0.16, 8_399_738)}, "metre per pixel"),
    "fake UTM": ({"crs": "EPSG:32630", "transform": Affine(0.1, 0, 0, 0, -0.1, 0)}, "placeholder"),
    "GCP": ({"gcps": gcps()}, "4 ground control points"),
    "world file": ({"transform": Affine(0.1, 0, 500, 0, -0.1, 900)}, "unknown unit"),
}


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("profile, says", CASES.values(), ids=CASES)
def test_each_case_is_handled_and_said(tmp_path, boxes, profile, says):
    path = picture(tmp_path / "a.tif", **profile)
    out = tmp_path / "out.tif"
    result = fixed(path, out, boxes)
    assert any(says in note for note in map(str, result.source.notes)), result.source.notes
    shape = math.sqrt(result.source.claimed.aspect)
    w, h = result.scale.value * shape, result.scale.value / shape
    with rasterio.open(path) as a, rasterio.open(out) as b:
        assert np.array_equal(a.read(), b.read()) and not b.gcps[0]
        assert b.crs.units_factor[1] == 1.0 and not b.crs.is_projected
        up = "rows go north" in " ".join(map(str, result.source.notes))
        assert np.allclose(b.transform[:6], (w, 0, 0, 0, h, 0) if up else (w, 0, 0, 0, -h, h * H))
        assert (b.bounds.left, min(b.bounds.bottom, b.bounds.top)) == (0, 0), "origin at the lower left"
    report = result.to_dict()
    for vehicle in report["vehicles"]:
        (x, y, *_), place = vehicle["boxes"][0]["xylwa_px"], vehicle["place_m"]
        assert place == pytest.approx([x * w, (y if up else H - y) * h], abs=0.02), "where the copy shows it"
    assert pixel_size(report) == pytest.approx((w, h), rel=1e-9)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("name", [n for n in CASES if n not in ("nothing", "fake UTM", "world file")])
def test_a_copy_that_keeps_its_origin_has_the_measured_size_on_the_ground(tmp_path, boxes, name):
    path = picture(tmp_path / "a.tif", **CASES[name][0])
    out = tmp_path / "out.tif"
    result = fixed(path, out, boxes, keep_origin=True)
    before, after = RasterSource.open(path).claimed, RasterSource.open(out).claimed
    assert after.usable and after.gsd_m == pytest.approx(result.scale.value, rel=2e-5)
    assert (after.transform.c, after.transform.f) == pytest.approx((before.transform.c, before.transform.f), abs=1e-9)
    assert after.crs == before.crs
    angle = [math.atan2(c.transform.d, c.transform.a) for c in (before, after)]
    assert angle[0] == pytest.approx(angle[1], abs=1e-9)
    assert (before.transform.determinant > 0) == (after.transform.determinant > 0)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_there_may_be_no_origin_to_keep(tmp_path, boxes):
    result = fixed(picture(tmp_path / "a.tif"), tmp_path / "out.tif", boxes, keep_origin=True)
    assert any("no origin to keep" in note for note in map(str, result.source.notes))


def test_a_world_files_corner_is_kept_in_local_metres(tmp_path, boxes):
    path = picture(tmp_path / "a.tif", **CASES["world file"][0])
    result = fixed(path, tmp_path / "out.tif", boxes, keep_origin=True)
    with rasterio.open(tmp_path / "out.tif") as d:
        assert d.transform[:6] == pytest.approx((result.scale.value, 0, 500, 0, -result.scale.value, 900))


@pytest.mark.parametrize(
    "options", [{}, {"compress": "jpeg", "photometric": "ycbcr"}, {"nodata": 7}, {"nbits": 7}], ids=str
)
def test_a_cog_stays_one_on_demand(tmp_path, boxes, options):
    from rasterio.shutil import copy

    plain = picture(tmp_path / "plain.tif", crs="EPSG:32632", transform=UTM, tiled=True, **options)
    copy(plain, tmp_path / "a.tif", driver="COG", BLOCKSIZE=256, OVERVIEW_COUNT=1)
    result = fixed(tmp_path / "a.tif", tmp_path / "plainly.tif", boxes)
    assert any("no longer cloud-optimised" in note for note in map(str, result.source.notes))
    result = fixed(tmp_path / "a.tif", tmp_path / "out.tif", boxes, cog=True, keep_origin=True)
    with rasterio.open(tmp_path / "a.tif") as a, rasterio.open(tmp_path / "out.tif") as b:
        assert b.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and b.overviews(1)
        assert np.array_equal(a.read(), b.read()) and a.nodata == b.nodata
        assert b.crs == a.crs
    assert not list(tmp_path.glob("plain.out*")) and not list(tmp_path.glob(".*partial"))


def test_a_classic_tiff_without_room_becomes_a_bigtiff_by_need(tmp_path, boxes, monkeypatch):
    monkeypatch.setattr("orthoscale.sources.raster_copy._CLASSIC", 1000)
    path = picture(tmp_path / "a.tif", crs="EPSG:32632", transform=UTM)
    fixed(path, tmp_path / "out.tif", boxes)
    with rasterio.open(path) as a, rasterio.open(tmp_path / "out.tif") as b:
        assert np.array_equal(a.read(), b.read()) and b.block_shapes[0] == (256, 256), "converted, not copied"
    big = picture(tmp_path / "b.tif", crs="EPSG:32632", transform=UTM, BIGTIFF="YES")
    assert RasterSource.open(big)._original._can_be_copied()
    assert not RasterSource.open(path)._original._can_be_copied()


# Files for other programs


@pytest.fixture(scope="module")
def everything(tmp_path_factory, boxes):
    folder = tmp_path_factory.mktemp("all")
    path = picture(folder / "a.tif", crs="EPSG:32632", transform=UTM)
    kinds = ("tfw", "scale", "gpkg", "geojson", "tiles")
    return folder, fixed(path, folder / "out.tif", boxes, also=kinds, keep_origin=True)


def test_the_world_file_says_the_same_as_the_geotiff(everything):
    folder, _ = everything
    a, d, b, e, x, y = (float(line) for line in (folder / "out.tfw").read_text().split())
    with rasterio.open(folder / "out.tif") as raster:
        assert raster.transform[:6] == pytest.approx((a, b, x - a / 2 - b / 2, d, e, y - d / 2 - e / 2), abs=1e-6)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("name", ["rotated", "south-up"])
def test_gdal_reads_the_world_file_as_the_geotiff_lies(tmp_path, boxes, name):
    path = picture(tmp_path / "a.tif", **CASES[name][0])
    fixed(path, tmp_path / "out.tif", boxes, also=["tfw"], keep_origin=True)
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((H, W), np.uint8))
    (tmp_path / "out.tfw").rename(tmp_path / "b.pgw")
    with rasterio.open(tmp_path / "out.tif") as copy, rasterio.open(tmp_path / "b.png") as beside:
        assert beside.transform[:6] == pytest.approx(copy.transform[:6], abs=1e-6)


def test_the_copy_says_how_well_its_scale_is_known(everything, boxes):
    """Who gets the file alone, without its report, reads it in the layer's properties."""
    folder, result = everything
    low, high = result.scale.interval90
    said = f"{result.scale.value:.6g} m/px, 90 % {low:.6g} to {high:.6g} m/px, {result.scale.verdict}; "
    said += f"{result.scale.vehicles_used} vehicles, fleet {result.scale.fleet}"
    with rasterio.open(folder / "out.tif") as raster:
        assert raster.tags()["ORTHOSCALE_SCALE"] == said
    fixed(folder / "out.tif", folder / "again.tif", boxes, cog=True)
    with rasterio.open(folder / "again.tif") as raster:
        assert raster.tags()["ORTHOSCALE_SCALE"] == said, "that of the last"


def test_that_a_copy_agrees_with_its_own_scale_is_no_confirmation(everything, boxes):
    """`check` said that it agrees, at 0.0 sigma, and nothing else where the copy kept its place."""
    copy = everything[0] / "out.tif"
    result = orthoscale.check(copy, detections=boxes, fleet="DE").result
    assert result.source.by_orthoscale and not everything[1].source.by_orthoscale
    assert any("agreement with vehicles does not confirm" in remark.text for remark in result.remarks)
    (row,) = run_many("check", [copy], EstimateRequest(detections=boxes, fleet="DE"))
    assert row["claim"] == OF_A_COPY, "many inputs have a table, and no remarks"
    said = [r.text for r in everything[1].remarks]
    assert not any("does not confirm" in text for text in said)


def test_what_printing_a_result_shows_are_all_its_remarks(everything):
    """It was "none" where the command line had notes."""
    _, result = everything
    told = dict(result.brief())["remarks"]
    assert result.remarks and told == f"{len(result.remarks)}, the first: {result.remarks[0].text}"


def test_what_a_result_cautions_of_comes_before_what_it_notes(everything):
    """A caution from opening a model, that all cameras stand on one line, was the last of its remarks."""
    _, result = everything
    source = SimpleNamespace(notes=[*result.source.notes, Remark(INFO, "read"), Remark(CAUTION, "on a line")])
    remarks = replace(result, source=source).remarks
    assert len(remarks) == len(result.remarks) + 2
    first = [remark.severity for remark in remarks]
    assert first == sorted(first, key=SEVERITIES.index) and first[0] == CAUTION and first[-1] == INFO


def test_the_scale_file_begins_with_the_scale(everything):
    folder, result = everything
    assert float((folder / "out.tif.scale.txt").read_text().split()[0]) == result.scale.value


def test_all_is_written_of_a_fleet_whose_name_is_not_utf_8(tmp_path, boxes):
    fleet = tmp_path / os.fsdecode(b"caf\xe9.json")
    fleet.write_text(json.dumps(FLEET))
    path = picture(tmp_path / "a.tif", crs="EPSG:32632", transform=UTM)
    kinds = ("tfw", "scale", "gpkg", "geojson", "tiles")
    options = {"also": kinds, "keep_origin": True, "detections": boxes, "override": True, "force": True}
    result = orthoscale.fix(path, tmp_path / "out.tif", fleet=fleet, **options)
    assert result.scale.fleet == "caf\udce9"
    assert r"fleet caf\udce9;" in (tmp_path / "out.tif.scale.txt").read_text()


def test_the_geopackage_holds_the_vehicles_in_metres_with_a_style(everything):
    from pyogrio import read_info
    from pyogrio.raw import read

    folder, result = everything
    path = folder / "out.tif.gpkg"
    info = read_info(path, layer="vehicles")
    assert info["features"] == len(result.votes) and info["crs"] == "EPSG:32632"
    _, _, geometry, columns = read(path, layer="vehicles")
    values = dict(zip(info["fields"], columns, strict=True))
    from shapely import from_wkb

    shapes = from_wkb(geometry)
    # 0.04 %: the projection's own scale; lengths in the table are on the ground.
    assert [s.minimum_rotated_rectangle.area for s in shapes] == pytest.approx(
        values["length_m"] * values["width_m"], rel=2e-3
    )
    assert values["used"].sum() == result.scale.vehicles_used
    with sqlite3.connect(path) as file:
        ((name, qml),) = file.execute("SELECT f_table_name, styleQML FROM layer_styles WHERE useAsDefault")
    from xml.etree import ElementTree

    renderer = ElementTree.fromstring(qml).find("renderer-v2")
    assert name == "vehicles" and renderer.get("attr") == "used"
    assert len(renderer.findall("symbols/symbol")) == 2
    drawn = {}
    for category in renderer.findall("categories/category"):
        symbol = renderer.find(f"symbols/symbol[@name='{category.get('symbol')}']")
        options = {option.get("name"): option.get("value") for option in symbol.iter("Option")}
        drawn[category.get("value")] = options["outline_color"], options["color"], options["outline_style"]
    blue, orange = (",".join(map(str, rgb)) for rgb in (USED_RGB, REJECTED_RGB))  # the report's
    assert drawn == {
        "true": (f"{blue},255", f"{blue},40", "solid"), "false": (f"{orange},255", f"{orange},40", "dash")
    }  # fmt: skip


def test_boxes_lie_where_the_vehicles_are_in_the_copy(everything):
    folder, result = everything
    rings = outlines(result, result.source.place(result.scale.value, keep_origin=True))
    with rasterio.open(folder / "out.tif") as raster:
        centre = np.array([~raster.transform * tuple(ring[:4].mean(0)) for ring in rings])
    assert centre == pytest.approx(result.votes.place, abs=1e-3)


def test_geojson_is_longitude_and_latitude_or_refused(everything, tmp_path, boxes):
    folder, result = everything
    text = json.loads((folder / "out.tif.geojson").read_text())
    assert len(text["features"]) == len(result.votes)
    ring = np.array(text["features"][0]["geometry"]["coordinates"][0])
    _, _, sides = pyproj.Geod(ellps="WGS84").inv(*ring[:-1].T, *ring[1:].T)
    properties = text["features"][0]["properties"]
    assert sorted(sides)[::2] == pytest.approx([properties["width_m"], properties["length_m"]], rel=2e-3)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        plain = picture(tmp_path / "a.tif")
    with pytest.raises(UsageError, match="has no place on Earth"):
        fixed(plain, tmp_path / "out.tif", boxes, also=["geojson"])
    assert not list(tmp_path.glob("out.tif*"))


def test_tiles_without_a_sweep_are_a_header(everything):
    with (everything[0] / "out.tif.tiles.csv").open() as file:
        assert len(list(csv.reader(file))) == 1, "boxes from a file: no tile was looked at"


def test_a_vehicle_counts_in_the_tile_whose_middle_is_nearest(everything, tmp_path):
    """Two tiles overlap; vehicles at x = 60, 147, ..., 840 px, eight in each column: six columns are nearer to the
    first tile's middle, measured by the tiles' widths, and no vehicle counts twice."""
    _, result = everything
    tiles = [("a.tif", Tile(0, 0, 600, H, 600, H)), ("a.tif", Tile(500, 0, 400, H, 400, H))]
    swept = replace(result.detections, swept=Swept(tiles, 2))
    write_tiles(replace(result, detections=swept), result.place(), tmp_path / "tiles.csv")
    with (tmp_path / "tiles.csv").open() as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert [[row[name] for name in ("x_px", "y_px", "width_px", "height_px")] for row in rows] == [
        [0, 0, 600, H], [500, 0, 400, H]
    ]  # fmt: skip
    assert [row["vehicles"] for row in rows] == [48, 32] and sum(row["used"] for row in rows) == result.scale.used.sum()
    first = result.scale.used & (result.votes.place[:, 0] < 550)
    deviation = result.vehicles["scale_deviation"][first]
    assert rows[0]["m_per_px"] == pytest.approx(result.scale.value * np.exp(deviation.mean()), rel=1e-5)
    assert rows[0]["relative_spread"] == pytest.approx(deviation.std(ddof=1), rel=1e-3)


def test_what_is_not_known_is_empty_in_every_format(everything, tmp_path):
    """It was "nan" in tables, which spreadsheets take for text, and NaN in JSON, which strict readers refuse."""
    _, result = everything
    tiles = [("a.tif", Tile(0, 0, W, H, W, H)), ("a.tif", Tile(9 * W, 0, W, H, W, H))]  # no vehicle is in the second
    swept = replace(result.detections, swept=Swept(tiles, 2))
    write_tiles(replace(result, detections=swept), result.place(), tmp_path / "tiles.csv")
    assert (tmp_path / "tiles.csv").read_text().splitlines()[2].endswith(",0,0,,")
    row = {"a": float("nan"), "b": float("inf"), "c": 1.5}
    write_csv(tmp_path / "a.csv", list(row), [row])
    assert (tmp_path / "a.csv").read_text().split() == ["a,b,c", ",,1.5"]
    assert json.loads(json_in_utf8({"rows": [row, (1, "\udcff")]})) == {
        "rows": [{"a": None, "b": None, "c": 1.5}, [1, "\\udcff"]]
    }
    for name in ("a.gpkg", "a.geojson"):
        write_layer(tmp_path / name, "rows", [shapely.Point(1, 2)], [row], "Point", "EPSG:4326")
        ogr = pyogrio.raw.read(tmp_path / name)
        assert [v[0] is None or np.isnan(v[0]) for v in ogr[3]] == [True, True, False], name
    assert "NaN" not in (tmp_path / "a.geojson").read_text() and "nan" not in (tmp_path / "a.geojson").read_text()


def test_a_vehicle_s_deviation_is_in_percent(everything):
    """It was the logarithm times a hundred: -69 % of a scale of half the size."""
    folder, result = everything
    _, _, _, values = pyogrio.raw.read(folder / "out.tif.gpkg", layer="vehicles", columns=["scale_deviation_percent"])
    ratio = np.exp(result.vehicles["scale_deviation"])
    assert values[0] == pytest.approx(100 * (ratio - 1), abs=1e-9)
    told = json.loads((folder / "out.tif.geojson").read_text())["features"]
    assert [f["properties"]["scale_deviation_percent"] for f in told] == pytest.approx(100 * (ratio - 1))


def test_all_outputs_are_refused_before_any_work(tmp_path, boxes):
    path = picture(tmp_path / "a.tif", crs="EPSG:32632", transform=UTM)
    (tmp_path / "out.tfw").write_text("precious")
    with pytest.raises(UsageError, match=r"out\.tfw already exists"):
        fixed(path, tmp_path / "out.tif", boxes, also=["tfw"])
    assert not (tmp_path / "out.tif").exists() and (tmp_path / "out.tfw").read_text() == "precious"


# Check


@pytest.mark.parametrize(
    "ratio, sd, verdict, guess",
    [
        (1.0, 0.03, "agrees", ""),
        (1.04, 0.03, "agrees", ""),
        (1.07, 0.03, "doubtful", ""),
        (0.5, 0.03, "disagrees", "enlarged"),
        (2.05, 0.03, "disagrees", "halved"),
        (0.31, 0.03, "disagrees", "feet were taken for metres"),
        (1.4, 0.03, "disagrees", ""),
    ],
)
def test_comparisons(ratio, sd, verdict, guess):
    comparison = Comparison("somebody claims", 0.1, 0.1 * ratio, sd)
    assert comparison.verdict == verdict
    assert (guess in comparison.sentence()) and bool(comparison.guesses) == bool(guess)
    assert ("m/px, the same as the 0.1 that" in comparison.sentence()) == (ratio == 1.0)
    assert comparison.sigmas == pytest.approx(abs(math.log(ratio)) / sd)


def check(*arguments):
    from orthoscale.cli.check import check as command

    return CliRunner().invoke(command, [str(a) for a in arguments])


def test_check_agrees_disagrees_and_says_so(tmp_path, boxes):
    path = picture(tmp_path / "a.tif", crs="EPSG:32632", transform=UTM)
    done = check(path, "--detections", boxes, "--fleet", "DE")
    assert done.exit_code == 0 and "agrees" in done.stdout and "UTM zone 32N" in done.stdout
    wrong = picture(tmp_path / "a.tif", crs="EPSG:32632", transform=UTM * Affine.scale(1 / 0.3048))
    done = check(wrong, "--detections", boxes, "--fleet", "DE", "--json")
    (found,) = json.loads(done.stdout)["comparisons"]
    assert done.exit_code == 4 and found["verdict"] == "disagrees" and "feet" in found["guesses"][0]
    assert found["claimed"] == pytest.approx(GSD / 0.3048, rel=1e-3)


def test_check_knows_a_map_that_stretches_the_ground(tmp_path, boxes):
    """Ground metres as the pixel size of Web Mercator at 60 degrees: "perhaps the image was halved", it said."""
    mercator = Affine(GSD, 0, 1_000_000, 0, -GSD, 8_399_738)
    path = picture(tmp_path / "a.tif", crs="EPSG:3857", transform=mercator)
    done = check(path, "--detections", boxes, "--fleet", "DE", "--json")
    (found,) = json.loads(done.stdout)["comparisons"]
    assert done.exit_code == 4 and "Pseudo-Mercator needs it 2 times as large there" in found["guesses"][0]
    path = picture(tmp_path / "a.tif", crs="EPSG:3857", transform=mercator * Affine.scale(2))
    done = check(path, "--detections", boxes, "--fleet", "DE", "--json")
    assert done.exit_code == 0 and not json.loads(done.stdout)["comparisons"][0]["guesses"]


def test_check_of_a_scale_that_contradicts_itself_is_no_agreement(tmp_path, boxes):
    """A known distance half as long again as the vehicles say: neither agrees with a claim between the two."""
    path = picture(tmp_path / "a.tif", crs="EPSG:32632", transform=UTM * Affine.scale(1.36))
    told = ("--known-distance", f"0,0 200,0 {200 * 1.5 * GSD} 0.1")
    done = check(path, "--detections", boxes, "--fleet", "DE", *told)
    assert isinstance(done.exception, EvidenceDisagrees) and "conflict" in str(done.exception)
    assert "agrees" not in done.stdout


def test_a_claim_is_compared_on_its_side_of_a_lopsided_interval():
    scale = Scale(0.10, "m/px", (0.09, 0.15), {"sampling": 0.12}, {}, (1, 0), 0.0, "DE", "fair", np.ones(9, bool), [])
    claims = [
        SimpleNamespace(gsd_m=gsd, usable=True, unit_known=True, why="", mistakes=())
        for gsd in (0.088, 0.092, 0.145, 0.155)
    ]
    found = [own_claim(SimpleNamespace(claimed=claim), scale).verdict for claim in claims]
    assert found == ["doubtful", "agrees", "agrees", "doubtful"]


@pytest.mark.parametrize(
    "kinds, by",
    [([], "vehicles"), (["map"], "vehicles and map"), (["map", "bays", "dashes"], "vehicles, map, bays and dashes")],
)
def test_what_a_claim_is_compared_with_is_named_as_people_list_things(kinds, by):
    scale = Scale(0.10, "m/px", (0.09, 0.11), dict.fromkeys(["sampling", *kinds], 0.05), {}, (9, 0), 0.0, "DE", "fair",
                  np.ones(9, bool), [], evidence=tuple(Evidence(kind, 0.1, 0.05, "") for kind in kinds))  # fmt: skip
    claim = SimpleNamespace(claimed=SimpleNamespace(gsd_m=0.1, usable=True, unit_known=True, why="", mistakes=()))
    assert own_claim(claim, scale).by == by


def test_a_claim_beside_an_interval_that_has_no_width_or_goes_below_nought():
    """As the paper's estimator gives of boxes that are all alike, or of few that differ much."""
    claim = SimpleNamespace(claimed=SimpleNamespace(gsd_m=0.05, usable=True, unit_known=True, why="", mistakes=()))
    every = np.ones(5, bool)
    for low, high, parts, verdict in (
        (0.1, 0.1, {"sampling": 0.0}, "disagrees"),
        (-0.02, 0.22, {"sampling": 0.6}, "agrees"),
    ):
        scale = Scale(0.10, "m/px", (low, high), parts, {}, (1, 0), 0.0, "DE", "fair", every, [""] * 5)
        assert own_claim(claim, scale).verdict == verdict


def test_a_scale_that_is_of_no_use_contradicts_no_claim():
    """Its boxes may be no vehicles: 0.22 m/px by a factor at which there were none, where the file says 0.097."""
    claim = SimpleNamespace(claimed=SimpleNamespace(gsd_m=0.097, usable=True, why="", unit_known=True, mistakes=()))
    every = np.ones(18, bool)
    for word, verdict in (("poor", "disagrees"), ("unusable", "doubtful")):
        scale = Scale(0.22, "m/px", (0.195, 0.25), {"sampling": 0.08}, {}, (1, 0), 0.0, "PH", word, every, [""] * 18)
        assert own_claim(claim, scale).verdict == verdict


@pytest.mark.parametrize(
    "unit, fits", [(1.0, "fits metres ("), (0.3048, "fits feet ("), (0.7, "fits neither metres (")]
)
def test_a_world_file_of_no_unit_is_compared_for_information_only(tmp_path, boxes, unit, fits):
    """Whatever it says: the same words from `check`, `estimate` and `fix`, and nothing is refused."""
    path = picture(tmp_path / "a.tif", transform=Affine(GSD / unit, 0, 500, 0, -GSD / unit, 900))
    words = ("--detections", boxes, "--fleet", "DE")
    done = check(path, *words)
    assert done.exit_code == 0, done.output
    said = next(line for line in done.stdout.splitlines() if "has no unit, for information only" in line)
    assert " m/px, its " in said
    assert fits in said and "disagrees" not in done.stdout and "not tied to the ground" not in done.stdout
    assert f"claim      {GSD / unit:.5g} per pixel: " in done.stdout and "of an unknown unit" in done.stdout
    estimated = orthoscale.estimate(path, fleet="DE", detections=boxes)
    sentence = own_claim(estimated.source, estimated.scale).sentence()
    assert sentence == said.strip() and estimated.to_dict()["claim"]["verdict"] == "has no unit"
    assert not [j for j in estimated.to_dict()["judgements"] if "georeferencing" in j["what"]]
    place = estimated.place()
    assert "is neither used nor kept" in place.said and "of an unknown unit" in place.said


def test_check_compares_what_nothing_ties_to_the_ground_and_says_so(tmp_path, boxes):
    local = 'LOCAL_CS["site",LOCAL_DATUM["site",32767],UNIT["metre",1],AXIS["E",EAST],AXIS["N",NORTH]]'
    path = picture(tmp_path / "a.tif", crs=local, transform=Affine(GSD, 0, 500, 0, -GSD, 900))
    done = check(path, "--detections", boxes, "--fleet", "DE")
    assert done.exit_code == 0 and "not tied to the ground" in done.stdout and f"{GSD:.5g} m/px" in done.stdout


def test_geojson_lies_on_the_copy_or_is_refused(tmp_path, boxes):
    """Of local metres nobody knows where on Earth they are, though the input lay somewhere."""
    path = picture(tmp_path / "a.tif", crs="EPSG:4326", transform=Affine(1e-6, 0, 10, 0, -7e-7, 50))
    with pytest.raises(UsageError, match="(?s)has no place on Earth.*Add --keep-origin"):
        fixed(path, tmp_path / "out.tif", boxes, also=["geojson"])
    assert not (tmp_path / "out.tif").exists(), "refused before any work"
    result = fixed(path, tmp_path / "out.tif", boxes, also=["geojson"], keep_origin=True)
    ring = json.loads((tmp_path / "out.tif.geojson").read_text())["features"][0]["geometry"]["coordinates"][0]
    assert np.allclose(ring, outlines(result, result.place(keep_origin=True))[0], atol=1e-9)
    with rasterio.open(tmp_path / "out.tif") as copy:
        left, bottom, right, top = copy.bounds
    assert ((np.array(ring) > [left, bottom]) & (np.array(ring) < [right, top])).all()


def test_geojson_has_no_longitudes_beyond_180_degrees(tmp_path, boxes):
    path = picture(tmp_path / "a.tif", crs="EPSG:4326", transform=Affine(1e-6, 0, 181, 0, -7e-7, 50))
    fixed(path, tmp_path / "out.tif", boxes, also=["geojson"], keep_origin=True)
    ring = json.loads((tmp_path / "out.tif.geojson").read_text())["features"][0]["geometry"]["coordinates"][0]
    assert np.allclose(np.array(ring)[:, 0], -179, atol=0.01)


def test_a_geocentric_system_claims_nothing(tmp_path):
    """Its first two axes were taken for east and north: a wrong size was proposed for --gsd-hint."""
    claimed = RasterSource.open(picture(tmp_path / "a.tif", "EPSG:4978", UTM)).claimed
    assert claimed.gsd_m is None and not claimed.usable and "is geocentric" in claimed.why


@pytest.mark.parametrize("crs", ["EPSG:32660", "EPSG:4326", "EPSG:3857"])
def test_shapes_on_the_180th_meridian_do_not_go_around_the_earth(tmp_path, boxes, crs):
    """Those of UTM had corners at 179.99 and -179.99; boxes saved from degrees lay beyond 180 and were not found again
    where other programs wrote them within."""
    middle = 60 + 4 * (W - 120) / 9  # of a column of boxes [px]
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(180.0, 48.0)
    x, y = abs(x), y  # -180 is the same
    step = {
        "EPSG:32660": (GSD * 0.9996, GSD * 0.9996), "EPSG:4326": (GSD / 74_632, GSD / 111_190),
        "EPSG:3857": (GSD / math.cos(math.radians(48)), GSD / math.cos(math.radians(48))),
    }[crs]  # fmt: skip
    path = picture(tmp_path / "a.tif", crs, Affine(step[0], 0, x - middle * step[0], 0, -step[1], y))
    fixed(path, tmp_path / "out.tif", boxes, also=["geojson"], keep_origin=True, save_detections=tmp_path / "b.geojson")
    for name in ("out.tif.geojson", "b.geojson"):
        text = json.loads((tmp_path / name).read_text())
        rings = np.array([feature["geometry"]["coordinates"][0] for feature in text["features"]])
        east = rings[..., 0]
        assert np.ptp(east, axis=1).max() < 1e-3 and (np.abs(east.mean(1)) < 180.0001).all()
        assert (east.mean(1) < 0).any() and (east.mean(1) > 0).any() and (np.abs(east) > 180).any()
    first = orthoscale.estimate(path, fleet="DE", detections=tmp_path / "b.geojson", anchors=["none"])
    again = orthoscale.estimate(path, fleet="DE", detections=boxes, anchors=["none"])
    assert first.scale.value == pytest.approx(again.scale.value, rel=1e-3)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("name", ["nothing", "UTM", "rotated", "south-up", "mirrored", "degrees"])
def test_headings_are_those_of_the_outlines(tmp_path, boxes, name):
    path = picture(tmp_path / "a.tif", **CASES[name][0])
    result = orthoscale.estimate(path, fleet="DE", detections=boxes, measurer="none", anchors=["none"])
    place = result.place(keep_origin=name != "nothing")
    sides = outlines(result, place)[:, 1:3] - outlines(result, place)[:, :2]
    east, north = sides[..., 0], sides[..., 1]
    if name == "degrees":
        east = east * math.cos(math.radians(50))
    longer = np.hypot(east, north).argmax(1), np.arange(len(sides))
    azimuth = np.degrees(np.arctan2(east[longer[::-1]], north[longer[::-1]]))
    off = (table(result, place)["heading_deg"] - azimuth + 90) % 180 - 90
    assert np.abs(off).max() < 0.5


@pytest.mark.parametrize("keep_origin", [False, True])
def test_outlines_are_rectangles_on_the_ground_also_of_oblong_pixels(tmp_path, boxes, keep_origin):
    """They were parallelograms, whose sides were not the vehicles'."""
    oblong = Affine(1.25 * GSD, 0, 500_000, 0, -GSD / 1.25, 5_400_000)
    path = picture(tmp_path / "a.tif", "EPSG:32632", oblong)
    result = orthoscale.estimate(path, fleet="DE", detections=boxes, measurer="none", anchors=["none"])
    place = result.place(keep_origin)
    sides = np.diff(outlines(result, place), axis=1)
    assert np.abs((sides[:, :-1] * sides[:, 1:]).sum(-1)).max() < 1e-6, "right angles"
    lengths = np.linalg.norm(sides[:, :2], axis=-1)
    members = [members[0] for members in result.votes.members]
    expected = ground_size(result.boxes[members], 1.25**2) * math.sqrt(abs(place.transform.determinant))
    assert np.sort(lengths) == pytest.approx(np.sort(expected), rel=1e-4)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_check_needs_a_claim(tmp_path, boxes):
    done = check(picture(tmp_path / "a.tif"), "--detections", boxes)
    assert isinstance(done.exception, UsageError) and "not georeferenced" in str(done.exception)


def test_the_report_of_an_estimate_compares_too(tmp_path, boxes):
    path = picture(tmp_path / "a.tif", crs="EPSG:32632", transform=UTM)
    result = orthoscale.estimate(path, detections=boxes, fleet="DE", known_distance=[f"10,10 410,10 {400 * GSD}"])
    assert comparisons(result)[0].verdict == "agrees"
    from orthoscale.report.terminal import summary

    report = result.to_dict()
    assert report["claim"]["verdict"] == "agrees" and json.dumps(report)
    assert report["drift"]["p_tilt"] > 0 and len(report["drift"]["cells"]) > 5
    assert re.search(r"\nclaim      agrees: .* give [\d.]+ m/px, ", summary(result))
    assert f"\nalso       {GSD:g} m/px from the known distance" in summary(result)
