"""The scale of a reconstruction by the GPS positions in the tags of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from ..core.gps import MOST_SD, bend, by_positions, mirrored
from ..core.remarks import percent
from ..core.source import FilePicture, GpsScale
from ..errors import InputError, OrthoscaleError

if TYPE_CHECKING:
    from ..core.evidence import Evidence
    from ..core.source import PosedSet
    from .tags import Tags

MOST_POSITIONS = 300  # positions of a flight, evenly chosen, that are read and fitted: more repeat the same slow errors
TAKEN = "%Y:%m:%d %H:%M:%S"  # EXIF 2.32, DateTimeOriginal
SPACING = 3.0  # [s] between frames whose tags have no time: mapping drones take one every 2 to 5 s
SAID = 2.0  # sigmas from which a bend is told; a judgement
UPSIDE_DOWN = (
    "the altitudes of its frames do not count: they, or those of the lowest, fall where its cameras rise, as those "
    "below the sea do whose sign is lost"
)
UNHEARD = "the GPS positions of its frames do not count"


def gps_scale(source: PosedSet) -> GpsScale:
    """The scale of `source` by the positions of its frames, or why there is none."""
    names, tags = _tagged(source)
    if not names:
        return GpsScale()
    centres, seconds = np.array([source.centre(name) for name in names]), _seconds(tags)
    try:
        units = source.ground.plane(centres)
    except OrthoscaleError:  # no ground: the measurement reports it
        return GpsScale()
    found, why = by_positions(units, _local_metres(tags), seconds)
    if found is None:
        return GpsScale(notes=(f"{UNHEARD}: {why}",) if why else ())
    return _on_ground(found, *_bend(source, found.value, centres, tags, seconds))


def _bend(
    source: PosedSet, scale: float, centres: np.ndarray, tags: Sequence[Tags], seconds: np.ndarray
) -> tuple[float, float, tuple[str, ...]]:
    """See `core.gps.bend`, of the cameras at `centres` (N, 3) [units], of `scale` metres each; and notes."""
    ground = source.ground
    places, heights = scale * ground.plane(centres), scale * (centres @ ground.up)
    above = scale * float(np.median(ground.height_above(centres)))
    altitudes = _altitudes(tags)
    notes: tuple[str, ...] = ()
    if altitudes is not None and source.bend_sd > 0 and mirrored(places, heights, altitudes):
        altitudes, notes = None, (UPSIDE_DOWN,)
    return *bend(places, heights, altitudes, seconds, above, source.bend_sd), notes


def _on_ground(found: Evidence, bent: float, sd: float, notes: tuple[str, ...]) -> GpsScale:
    """The scale of the ground by that of the cameras, `found`, which exceeds it by `bent`, with one sigma `sd`."""
    on_ground = replace(found, value=found.value / (1 + bent), relative_sd=float(np.hypot(found.relative_sd, sd)))
    if not on_ground.relative_sd < MOST_SD:
        why = f"{UNHEARD}: they give the scale at its cameras, and how far it is bent is left open"
        return GpsScale(notes=(*notes, why))
    if abs(bent) <= SAID * sd:
        return GpsScale((on_ground,), notes)
    told = (
        f"by the altitudes of its frames the model is bent, a {'bowl' if bent > 0 else 'dome'}, as self-calibration "
        f"bends flat blocks: GPS positions give the scale at its cameras, {percent(abs(bent))} "
        f"{'more' if bent > 0 else 'less'} than on the ground; corrected"
    )
    return GpsScale((on_ground,), (told,))


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


def _altitudes(tags: Sequence[Tags]) -> np.ndarray | None:
    """(N,) altitude of each [m], over the take-off point if all have it; None unless all have one."""
    for told in ([t.relative_altitude for t in tags], [t.altitude for t in tags]):
        if None not in told:
            return np.array(told, float)
    return None


def _seconds(tags: Sequence[Tags]) -> np.ndarray:
    """(N,) time at which each was taken, after the first [s]; if one has no time, SPACING apart in their order."""
    try:
        times = [datetime.strptime(told.taken, TAKEN) for told in tags]
    except ValueError:
        return SPACING * np.arange(len(tags))
    return np.array([(time - times[0]).total_seconds() for time in times])
