"""The summary of a layout in the terminal: what fits, what does not, and the uncertainty in metres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..core.scale import with_interval
from .catalogue import load
from .place import TOLERANCE
from .plan import Layout


def summary(layout: Layout, out: Path | None) -> list[str]:
    """The summary, a few lines. out : the folder that was written, if any."""
    ground = layout.ground
    count = len(layout.placed) + len(layout.missing)
    used = sum(p.full_area.area for p in layout.placed)
    lines = [
        f"placed     {len(layout.placed)} of {count} facilities on a lot of {layout.lot.area:.0f} m2, "
        f"{100 * used / layout.lot.area:.0f} % of it used"
    ]
    for k, place in enumerate(layout.placed):
        f = place.facility
        line = f"  {k + 1:2d}  {f.name}, {f.length:g} x {f.width:g} m, {_direction(place.bearing)}"
        if f.north_south and place.from_north > TOLERANCE:
            line += f", {place.from_north:.0f} degrees off north-south"
        if ground.interval is not None:
            low, high = (bound * f.length for bound in ground.interval)
            line += f"; true length {low:.2f} to {high:.2f} m (90 %)"
            if layout.holds_low is not None and not layout.holds_low[k]:
                line += ", at the low end of the scale it no longer fits"
        lines.append(line)
    for sentence in dict.fromkeys(m.sentence() for m in layout.missing):
        times = sum(m.sentence() == sentence for m in layout.missing)
        lines.append(f"missing    {f'{times} x ' if times > 1 else ''}{sentence}")
    gsd_cm = 100 * ground.gsd
    if ground.interval is None:
        lines.append(f"scale      {gsd_cm:.4g} cm/px")
    else:
        low, high = ground.interval
        lines.append(f"scale      {with_interval(gsd_cm, gsd_cm * low, gsd_cm * high, 'cm/px')}")
    lines += [f"note       {note}" for note in layout.notes]
    if out is not None:
        lines.append(f"written    {out}: see overlay.png")
    return lines


def catalogue_values(path: Path | None) -> list[dict[str, Any]]:
    """The facilities as plain values: code, name, sizes [m], alone and with run-off, and source."""
    names = ("code", "name", "length", "width", "full_length", "full_width", "source")
    return [{name: getattr(f, name) for name in names} for f in load(path).values()]


def catalogue_table(path: Path | None) -> str:
    """The facilities by code, with sizes and sources."""
    lines = []
    for f in load(path).values():
        size = f"{f.length:g} x {f.width:g} m"
        full = f"{f.full_length:.2f} x {f.full_width:.2f} m"
        lines.append(f"{f.code:12s} {f.name}, {size}, {full} with run-off\n{'':12s} {f.source}")
    lines.append("parking-CC:N two rows of N bays in all, as usual in country CC, along an aisle")
    return "\n".join(lines)


def _direction(bearing: float) -> str:
    names = ("N-S", "NNE-SSW", "NE-SW", "ENE-WSW", "E-W", "ESE-WNW", "SE-NW", "SSE-NNW")
    return names[round(bearing / 22.5) % 8]
