"""The summary of a search in the terminal: a few labelled lines for each photo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..core.scale import with_interval


def summary(text: dict[str, Any], out: Path) -> list[str]:
    """Lines for the result `text` of `outcome.document`, and the names of the files in the folder `out`."""
    lines: list[str] = []
    for photo in text["photos"]:
        lines += [f"photo      {photo['photo']}", *_lines(photo)]
    lines += [f"note       {note}" for note in text["notes"]]
    files = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    lines.append(f"written    {out}: {', '.join(files)}")
    return lines


def _lines(photo: dict[str, Any]) -> list[str]:
    claimed = photo.get("claimed_scale")
    before = [] if claimed is None else [f"scale      {claimed['by']} {_cm(claimed)}"]
    if not photo["located"]:
        return [*before, f"place      {photo['problem'].removeprefix(photo['photo'] + ': ')}"]
    lon, lat = photo["foot"]
    x, y = photo["foot_crs"]
    place = f"place      longitude {lon:.6f}, latitude {lat:.6f} (below the camera; x {x:.2f}, y {y:.2f} on the map)"
    heading = f"heading    {round(photo['heading_deg'], 1) % 360:.1f} degrees"
    if photo["altitude_m"] is not None:
        heading += f"; altitude {with_interval(*_ends(photo['altitude_m']), 'm')}"
    matches = f"matches    {photo['inliers']}, {photo['needed']} needed; score {photo['score']:.2f}"
    scale = [*before, f"           map {_cm(photo['map_scale'])}"]
    if photo["together"] is not None:
        scale.append(f"           together {_cm(photo['together'])}")
    lines = [place, heading, matches, *scale, f"           {photo['agreement']['said']}"]
    if "exif_position" in photo:
        lines.append(f"EXIF       its position is {photo['exif_position']['metres_away']:.1f} m away")
    return lines


def _cm(scale: dict[str, float]) -> str:
    value, low, high = _ends(scale)
    return with_interval(100 * value, 100 * low, 100 * high, "cm/px")


def _ends(value: dict[str, float]) -> tuple[float, float, float]:
    return value["value"], value["low"], value["high"]
