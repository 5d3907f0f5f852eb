"""The country is proposed by the input: by its georeferencing, OpenSfM's reference, or GPS in EXIF; a name wins."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.transform import from_origin
from support.drawings import Drawing
from support.photos import write_photo

from orthoscale.core.boxes import Boxes
from orthoscale.countries import with_article
from orthoscale.sources.country import country_of, fleet_at, named_fleet
from orthoscale.sources.georeference import LOCAL_CRS
from orthoscale.sources.location import Location, location_in, location_of
from orthoscale.sources.opening import open_source
from orthoscale.sources.picture_file import PictureFile


def orthophoto(path, crs, west, north, pixel):
    profile = {"driver": "GTiff", "width": 400, "height": 300, "count": 3, "dtype": "uint8"}
    with rasterio.open(path, "w", crs=crs, transform=from_origin(west, north, pixel, pixel), **profile) as file:
        file.write(np.full((3, 300, 400), 90, np.uint8))
    return open_source(path)


@pytest.mark.parametrize(
    ("crs", "west", "north", "pixel", "country"),
    [("EPSG:32651", 283_000, 1_615_000, 0.1, "PH"), ("EPSG:2180", 360_000, 500_000, 0.1, "PL"),
     ("EPSG:4326", -97.74, 30.27, 1e-6, "US"), ("EPSG:3857", 950_700, 6_004_600, 0.15, "CH"),
     ("EPSG:4326", 182.0, 67.0, 1e-6, "RU")],
)  # fmt: skip
def test_georeferencing_names_the_country(tmp_path, crs, west, north, pixel, country):
    fleet, notes = fleet_at(location_of(orthophoto(tmp_path / "a.tif", crs, west, north, pixel)))
    assert fleet.code == country and "its georeferencing is in" in notes[0] and "--fleet" in notes[0]


@pytest.mark.parametrize(("crs", "west", "north"), [("EPSG:32630", 0, 0), (LOCAL_CRS, 5000, 5000), (None, 0, 30)])
def test_georeferencing_that_is_not_to_be_believed_names_none(tmp_path, crs, west, north):
    """Not OpenDroneMap's placeholder in Spain's zone, nor local metres."""
    assert location_of(orthophoto(tmp_path / "a.tif", crs, west, north, 0.1)) is None
    fleet, notes = fleet_at(None)
    assert fleet.code == "WORLD" and "name it with --fleet" in notes[0], (
        "nobody learns otherwise why it is so uncertain"
    )


@pytest.mark.parametrize(("code", "name"), [("US", "the United States"), ("PH", "the Philippines"), ("NP", "Nepal")])
def test_a_country_is_named_as_in_a_sentence(code, name):
    assert with_article(code) == name


def test_the_place_of_a_picture_is_its_gps_position(tmp_path):
    plain = write_photo(tmp_path / "a.jpg")
    placed = write_photo(tmp_path / "b.jpg", gps=(139.7, 35.7))
    (tmp_path / "c.jpg").write_text("no picture")
    found = location_in([plain, tmp_path / "c.jpg", placed])
    assert (found.longitude, found.latitude) == pytest.approx((139.7, 35.7), abs=1e-4)
    assert fleet_at(found)[0].code == "JP" and "b.jpg" in found.told_by
    assert location_in([plain]) is None
    assert fleet_at(location_of(open_source(placed)))[0].code == "JP"
    drawn, photo = Drawing(64, 48, Boxes.empty()), PictureFile("b.jpg", placed, 64, 48)  # one without a file, and one
    assert location_of(SimpleNamespace(plan=None, path=tmp_path, pictures=[drawn])) is None
    assert location_of(SimpleNamespace(plan=None, path=tmp_path, pictures=[drawn, photo])) == found


def test_a_reconstruction_lies_where_opensfm_says(tmp_path):
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg")
    source = open_source(tmp_path / "a.jpg")
    for text, country in (({"longitude": 24.7, "latitude": 59.4, "altitude": 0}, "EE"), ({"longitude": 400}, None)):
        (tmp_path / "reference_lla.json").write_text(json.dumps(text))
        found = location_of(source)
        assert (found and fleet_at(found)[0].code) == country


def test_a_name_wins_and_the_sea_has_no_country():
    assert named_fleet("DE", None).code == "DE" and named_fleet(None, None) is None
    at_sea, notes = fleet_at(Location(-30.0, 30.0, "the GPS position in x.jpg"))
    assert at_sea.code == "WORLD" and notes == ("the GPS position in x.jpg is not in any country: fleet world",)


@pytest.mark.parametrize(
    ("name", "country"),
    [(None, "PL"), ("DE", "DE"), ("US_TX", "US"), ("DE_new", "DE"), ("BT", "BT"), ("world", "PL"), ("EU", "PL"),
     ("GCC", "PL")],
)  # fmt: skip
def test_a_named_country_also_says_whose_standards_hold(tmp_path, name, country):
    """They were those of the place, and the vehicles those of the fleet."""
    source = orthophoto(tmp_path / "a.tif", "EPSG:2180", 360_000, 500_000, 0.1)
    assert country_of(source, named_fleet(name, None)) == country
    nowhere = orthophoto(tmp_path / "b.tif", None, 0, 300, 1)
    assert country_of(nowhere, named_fleet(name, None)) == ("" if country == "PL" else country)


@pytest.mark.parametrize(("entry", "country"), [({}, "PL"), ({"country": "DE"}, "DE")])
def test_a_fleet_file_says_whose_standards_hold_where_it_names_a_country(tmp_path, entry, country):
    sizes = {"length": [4.4, 0.4], "width": [1.8, 0.1], "height": [1.5, 0.1], "mean_sd": [0.05, 0.02, 0.02]}
    (tmp_path / "own.json").write_text(json.dumps({"name": "ours", "source": "measured", **sizes, **entry}))
    source = orthophoto(tmp_path / "a.tif", "EPSG:2180", 360_000, 500_000, 0.1)
    assert country_of(source, named_fleet(tmp_path / "own.json", None)) == country
