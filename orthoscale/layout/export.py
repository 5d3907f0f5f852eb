"""The files of a layout: vectors for GIS, a drawing for CAD, rasters on the orthophoto's own grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely
from rasterio.windows import Window as RasterWindow

from ..formats.degrees import WGS_84, about_meridian, to_degrees
from ..formats.names import write_json
from ..formats.pictures import write_png
from ..formats.vector import write_layer
from ..sources.gdal import guarded
from ..sources.georeference import LOCAL_CRS
from . import draw
from .place import rings
from .plan import Layout, document, prompt

TILE_PX = 256


def write(layout: Layout, folder: Path) -> None:
    """Write into the empty `folder`: layout.json, layout.gpkg, layout.geojson, layout.dxf, mask.tif, lines.tif,
    lines.png, lot.png, overlay.png, prompt.txt. Raises OSError."""
    values = document(layout)
    write_json(values, folder / "layout.json")
    (folder / "prompt.txt").write_text(prompt(layout) + "\n", encoding="utf-8")
    write_vectors(layout, folder, values["facilities"])
    write_dxf(layout, folder / "layout.dxf")
    write_pictures(layout, folder)


def write_vectors(layout: Layout, folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write layout.gpkg in the orthophoto's CRS, with layers facilities, run_off, lines and lot; and layout.geojson
    with the playing areas, in longitude and latitude if the orthophoto has a place on Earth, else in its own
    coordinates, whose CRS it names."""
    ground = layout.ground
    crs = ground.crs  # a world file alone has none
    in_crs = partial(shapely.transform, transformation=ground.to_crs)
    package = folder / "layout.gpkg"
    lot = [{"what": "lot", "area_m2": round(layout.lot.area, 1)}]
    write_layer(package, "lot", [in_crs(layout.lot)], lot, "MultiPolygon", crs)
    if not layout.placed:
        return
    areas = [in_crs(p.area) for p in layout.placed]
    write_layer(package, "facilities", areas, rows, "Polygon", crs)
    write_layer(package, "run_off", [in_crs(p.full_area) for p in layout.placed], rows, "Polygon", crs)
    drawn = [(k, line) for k, p in enumerate(layout.placed, 1) for line in map(p.on_ground, p.facility.lines)]
    painted = [in_crs(shapely.LineString(line)) for _, line in drawn]
    write_layer(package, "lines", painted, [{"number": k} for k, _ in drawn], "LineString", crs)
    on_earth = ground.source.claimed.usable
    if on_earth:
        there = to_degrees(ground.crs)
        areas = [shapely.transform(a, lambda c: about_meridian(np.column_stack(there.transform(*c.T)))) for a in areas]
    write_layer(
        folder / "layout.geojson", "facilities", areas, rows, "Polygon", WGS_84 if on_earth else crs or LOCAL_CRS
    )


def write_dxf(layout: Layout, path: Path) -> None:
    """Write a drawing in metres, east and north of the orthophoto's lower left corner, with layers LOT, RUN_OFF,
    FACILITIES, LINES and LABELS."""
    import ezdxf

    drawing = ezdxf.new("R2010", units=ezdxf.units.M)
    for name, colour in (("LOT", 2), ("RUN_OFF", 8), ("FACILITIES", 3), ("LINES", 7), ("LABELS", 5)):
        drawing.layers.add(name, color=colour)
    space = drawing.modelspace()

    def ring(points: np.ndarray, layer: str) -> None:
        space.add_lwpolyline(points.tolist(), close=True, dxfattribs={"layer": layer})

    for edge in rings(layout.lot):
        ring(edge[:-1], "LOT")
    for number, place in enumerate(layout.placed, 1):
        ring(shapely.get_coordinates(place.full_area)[:-1], "RUN_OFF")
        ring(place.on_ground(place.facility.outline), "FACILITIES")
        for line in place.facility.lines:
            space.add_lwpolyline(place.on_ground(line).tolist(), dxfattribs={"layer": "LINES"})
        label = space.add_text(f"{number} {place.facility.name}", height=1.0, dxfattribs={"layer": "LABELS"})
        label.set_placement(place.centre, align=ezdxf.enums.TextEntityAlignment.MIDDLE_CENTER)
    drawing.saveas(path)


def write_pictures(layout: Layout, folder: Path) -> None:
    """Write mask.tif and lines.tif on the orthophoto's grid; lines.png, mask.png and lot.png (all of the same part, for
    a renderer); and overlay.png for people."""
    ground, source = layout.ground, layout.ground.source
    window = draw.window_of(ground, layout.lot)
    numbers = draw.mask(ground, layout.placed, window)
    lines = draw.lines(ground, layout.placed, window)
    _write_grid(layout, folder / "mask.tif", numbers, window, ("playing area", "with run-off"))
    _write_grid(layout, folder / "lines.tif", lines[None], window, ("painted lines",))
    write_png(folder / "lines.png", lines)
    write_png(folder / "mask.png", np.minimum(numbers[0], 255).astype(np.uint8))
    size = window.width, window.height
    write_png(folder / "lot.png", source.read(window.x, window.y, *size, *size))
    write_png(folder / "overlay.png", draw.overlay(ground, layout.lot, layout.placed, window))


def _write_grid(layout: Layout, path: Path, bands: np.ndarray, window: draw.Window, names: Sequence[str]) -> None:
    """Write a GeoTIFF of the orthophoto's size; outside of `window` it is 0 and takes no space."""
    ground = layout.ground
    with (
        guarded(),
        rasterio.open(
            path,
            "w",
            driver="GTiff",
            width=ground.source.width,
            height=ground.source.height,
            count=len(bands),
            dtype=bands.dtype.name,
            crs=ground.crs,
            transform=ground.transform,
            tiled=True,
            blockxsize=TILE_PX,
            blockysize=TILE_PX,
            compress="deflate",
            sparse_ok=True,
            bigtiff="IF_SAFER",
        ) as out,
    ):
        out.write(bands, window=RasterWindow(window.x, window.y, window.width, window.height))
        out.descriptions = tuple(names)
