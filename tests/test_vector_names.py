"""Vector files keep the names that they are given, also those that an address on the web could not have."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from rasterio.crs import CRS

from orthoscale.core.boxes import Boxes
from orthoscale.formats.detections.geo import read_geopackage, write_geopackage
from orthoscale.formats.vector import write_layer
from orthoscale.layout.ground import _polygons

ODD = ["a;b", "new!/a", ";/a", "a\tb", "a\nb", "what?", os.fsdecode(b"\xff")]
SQUARE = shapely.box(0, 0, 4, 3)


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.fixture(params=ODD)
def odd(request, tmp_path):
    """A path without its ending, whose folder is there."""
    path = tmp_path / request.param
    path.parent.mkdir(exist_ok=True)
    return path


@pytest.mark.parametrize("ending", [".gpkg", ".geojson"])
def test_layers_are_written_under_the_name_that_was_given(odd, tmp_path, ending):
    path = odd.with_name(odd.name + ending)
    layers = ["places", "again"] if ending == ".gpkg" else ["places"]
    for layer in layers:
        write_layer(path, layer, [SQUARE], [{"a": 1}], "Polygon", "EPSG:32632")
    assert files(tmp_path) == [str(path.relative_to(tmp_path))]
    moved = path.rename(tmp_path / f"plain{ending}")
    assert len(found := pyogrio.list_layers(moved)) == len(layers)
    assert len(pyogrio.raw.read(moved, layer=found[-1, 0])[2]) == 1


@pytest.mark.parametrize(
    ("crs", "code"),
    [
        *((crs, "EPSG:32632") for crs in ("EPSG:32632", CRS.from_epsg(32632), pyproj.CRS.from_epsg(32632))),
        *((crs, None) for crs in (None, CRS())),
    ],
)
def test_a_layer_has_the_crs_that_was_given_in_any_form(tmp_path, crs, code):
    path = tmp_path / "a.gpkg"
    write_layer(path, "places", [SQUARE], [{"a": 1}], "Polygon", crs)
    assert pyogrio.read_info(path)["crs"] == code


def test_two_slashes_at_the_start_name_no_server(tmp_path):
    path = Path(f"/{tmp_path}/a.gpkg")
    write_layer(path, "places", [SQUARE], [{"a": 1}], "Polygon", "EPSG:32632")
    assert files(tmp_path) == ["a.gpkg"] and _polygons(path)[0].equals(SQUARE)


def test_boxes_are_read_and_written_under_the_name_that_was_given(odd, tmp_path):
    path = odd.with_name(odd.name + ".gpkg")
    boxes = Boxes(np.array([[50.0, 40, 30, 15, 0.2]]), np.array([0.9]))
    write_geopackage(path, {"a.tif": boxes}, None, {"detector": "one"})
    assert files(tmp_path) == [str(path.relative_to(tmp_path))]
    (item,), note = read_geopackage(path, None)
    assert note == {"detector": "one"}


@pytest.mark.parametrize("ending", [".gpkg", ".geojson", ".shp"])
def test_a_lot_is_read_under_its_name(odd, tmp_path, ending):
    pyogrio.raw.write(
        tmp_path / f"lot{ending}",
        np.array([shapely.to_wkb(SQUARE)], object),
        [np.array([1])],
        ["a"],
        geometry_type="Polygon",
        crs="EPSG:4326" if ending == ".geojson" else "EPSG:32632",
    )
    for path in tmp_path.glob("lot.*"):
        path.rename(odd.with_name(odd.name + path.suffix))
    before = files(tmp_path)
    area, crs, _ = _polygons(odd.with_name(odd.name + ending))
    assert area.equals(SQUARE) and crs
    assert files(tmp_path) == before
