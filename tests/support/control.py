"""Points with known coordinates in metres, marked in the pictures of the flight of `models.make_model`."""

import numpy as np
import pyproj

from .flights import UNIT

PLACES = np.array([[-6, -5, 0.4], [5, -4, 2.5], [6, 6, 0.0], [-4, 5, 1.5]])  # roofs and ground, up to 12.5 m [units]
LON, LAT = 9.1, 48.7  # at the middle of UTM zone 32, whose metres are 0.04 % longer there


def on_map(metres, system):
    """(N, 3) `metres` east, north and up of LON, LAT, in a coordinate reference system; heights in metres."""
    lon, lat = np.radians([LON, LAT])
    east = np.array([-np.sin(lon), np.cos(lon), 0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    there = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(LON, LAT, 300.0)
    earth = np.array(there) + metres @ np.array([east, np.cross(up, east), up])
    to_map = pyproj.Transformer.from_crs("EPSG:4978", pyproj.CRS.from_user_input(system).to_3d(), always_xy=True)
    return np.column_stack(to_map.transform(*earth.T))


def marked(path, source, turn, header="EPSG:32632", system="EPSG:32632", pictures=None, named=str):
    """Write a list of marks of PLACES in `pictures`, all by default. named : from a picture's name to that in the
    list."""
    lines = [header, "# X Y Z COLUMN ROW PICTURE NAME", ""]
    for number, (place, known) in enumerate(zip(PLACES, on_map(UNIT * PLACES, system), strict=True)):
        for name in source.picture_names if pictures is None else pictures:
            (pixel,) = source.project(name, place[None] @ turn.T)
            if shows(source, name, place @ turn.T):
                lines.append(" ".join(map(str, [*known, *pixel, named(name), f"gcp{number}", "extra"])))
    path.write_text("\n".join(lines))
    return path


def shows(source, name, place):
    """Whether the picture shows the place, at most 40 degrees off its axis: lens distortion can fold places far outside
    back into the picture."""
    (pixel,) = source.project(name, place[None])
    off = source.rotation(name) @ (place - source.centre(name))
    inside = bool((pixel > 0).all() and (pixel < source.image_size(name)).all())
    return inside and off[2] > np.cos(np.radians(40)) * np.linalg.norm(off)
