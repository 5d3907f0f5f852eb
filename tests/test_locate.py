"""Cross-view localisation: levelling, search, verification, and what is said where a photo is not found."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin
from support.aerial import Shot, other_date, town

from orthoscale.errors import TooLittleEvidence, UsageError
from orthoscale.locate.features import GradientFeatures
from orthoscale.locate.ground import SeenPlan
from orthoscale.locate.register import Known, heading_steps, register, scale_steps
from orthoscale.locate.verify import Similarity, agreeing, needed
from orthoscale.sources.raster import RasterSource
from orthoscale.sources.satellite import Satellite

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
    """The photo of a `shot` at another date."""
    return other_date(shot.of(ground, GSD), np.random.default_rng(seed), shot.altitude / shot.focal)


@pytest.mark.parametrize("claimed", [0.9, 1.0, 1.15])
def test_an_orthophoto_is_found_with_its_scale_and_heading(ground, sky, tmp_path, claimed):
    shot = Shot((190.0, 230.0), heading=40.0, altitude=120.0)
    source = plan(tmp_path / "photo.tif", shown(ground, shot))
    gsd = shot.altitude / shot.focal
    seen = SeenPlan(source, gsd * claimed)
    got = register(seen, sky, GradientFeatures(), Known((0.8, 1.25), np.radians(45)), cache=False)
    best = got.located
    assert best is not None, got.problem
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
    true = Similarity(1.1 * np.exp(0.1j), 3 + 4j)
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
