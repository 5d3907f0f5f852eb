"""The summary of a search in the terminal: a few labelled lines for each photo."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def summary(text: dict[str, Any], out: Path) -> str:
    """Lines for the document of `outcome.document`, and what was written to the folder `out`."""
    lines: list[str] = []
    for photo in text["photos"]:
        lines += [f"photo      {photo['photo']}", *_lines(photo)]
    lines += [f"note       {note}" for note in text["notes"]]
    files = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    lines.append(f"written    {out}: {', '.join(files)}")
    return "\n".join(lines)


def _lines(photo: dict[str, Any]) -> list[str]:
    claimed = photo.get("claimed_scale")
    before = [] if claimed is None else [f"scale      {claimed['by']} {_cm(claimed)} cm/px"]
    if not photo["located"]:
        return [*before, f"place      {photo['problem'].removeprefix(photo['photo'] + ': ')}"]
    lon, lat = photo["foot"]
    x, y = photo["foot_crs"]
    place = f"place      {lon:.6f}, {lat:.6f} (below the camera; x {x:.2f}, y {y:.2f} on the map)"
    heading = f"heading    {round(photo['heading_deg'], 1) % 360:.1f} degrees"
    if photo["altitude_m"] is not None:
        heading += f"; altitude {_metres(photo['altitude_m'])} m"
    matches = f"matches    {photo['inliers']}, {photo['needed']} needed; score {photo['score']:.2f}"
    scale = [*before, f"           map {_cm(photo['map_scale'])} cm/px"]
    if photo["together"] is not None:
        scale.append(f"           together {_cm(photo['together'])} cm/px")
    lines = [place, heading, matches, *scale, f"           {photo['agreement']['said']}"]
    if "exif_position" in photo:
        lines.append(f"EXIF       its position is {photo['exif_position']['metres_away']:.1f} m away")
    return lines


def _cm(scale: dict[str, float]) -> str:
    return f"{100 * scale['value']:.4g} ({100 * scale['low']:.4g} to {100 * scale['high']:.4g})"


def _metres(value: dict[str, float]) -> str:
    return f"{value['value']:.1f} ({value['low']:.1f} to {value['high']:.1f})"
