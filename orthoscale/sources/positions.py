"""The scale of a reconstruction by the GPS positions in the tags of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from ..core.gps import by_positions
from ..core.source import FilePicture, GpsScale
from ..errors import InputError, OrthoscaleError

if TYPE_CHECKING:
    from ..core.source import PosedSet
    from .tags import Tags

MOST_POSITIONS = 300  # positions of a flight, evenly chosen, that are read and fitted: more repeat the same slow errors
TAKEN = "%Y:%m:%d %H:%M:%S"  # EXIF 2.32, DateTimeOriginal
SPACING = 3.0  # [s] between frames whose tags have no time: mapping drones take one every 2 to 5 s


def gps_scale(source: PosedSet) -> GpsScale:
    """The scale of `source` by the positions of its frames, or why there is none."""
    names, tags = _tagged(source)
    if not names:
        return GpsScale()
    try:
        units = source.ground.plane(np.array([source.centre(name) for name in names]))
    except OrthoscaleError:  # no ground: the measurement reports it
        return GpsScale()
    found, why = by_positions(units, _local_metres(tags), _seconds(tags))
    if found is None:
        return GpsScale(notes=(f"the GPS positions of its frames do not count: {why}",) if why else ())
    return GpsScale((found,))


def _tagged(source: PosedSet) -> tuple[list[str], list[Tags]]:
    """Names and tags of the available frames that have a position; of many frames only every n-th is read."""
    from .tags import read_tags

    pictures = [picture for picture in source.pictures if isinstance(picture, FilePicture)]
    names, tags = [], []
    for picture in pictures[:: max(1, -(-len(pictures) // MOST_POSITIONS))]:
        try:
            told = read_tags(picture.path)
        except InputError:
            continue
        if told.lon_lat is not None:
            names.append(picture.name)
            tags.append(told)
    return names, tags


def _local_metres(tags: Sequence[Tags]) -> np.ndarray:
    """(N, 2) east and north of their median position [m]."""
    import pyproj

    lon, lat = np.array([told.lon_lat for told in tags]).T
    lon = np.unwrap(lon, period=360)  # no jump at the 180th meridian
    local = pyproj.Proj(proj="aeqd", lon_0=float(np.median(lon)), lat_0=float(np.median(lat)), ellps="WGS84")
    return np.stack(local(lon, lat), 1)


def _seconds(tags: Sequence[Tags]) -> np.ndarray:
    """(N,) time at which each was taken, after the first [s]; if one has no time, SPACING apart in their order."""
    try:
        times = [datetime.strptime(told.taken, TAKEN) for told in tags]
    except ValueError:
        return SPACING * np.arange(len(tags))
    return np.array([(time - times[0]).total_seconds() for time in times])
