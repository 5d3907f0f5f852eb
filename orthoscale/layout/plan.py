"""From a lot and a list of facilities to the layout, as plain values and as a prompt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ..errors import InputError, UsageError
from ..version import __version__
from .catalogue import Facility, Request, parse_requests
from .ground import MetricOrthophoto, open_ground, read_area
from .place import Missing, PlacedFacility, arrange, holds

LAYOUT_FORMAT = "orthoscale layout 1"
LOT_INSIDE = 0.01  # share of a lot in the picture: columns and rows that are taken for metres have a few thousandths
LEAST_LOT_M2 = 1.0  # [m2] a smaller lot is in degrees


@dataclass(frozen=True)
class Layout:
    """What was placed where, and what was not and why; metres east and north of the picture's lower left corner.

    holds_low, holds_high : for each placed facility, whether it still fits where it is, clear of `avoid`, if the scale
    is at that end of its 90 % interval; None if the interval is not known.
    """

    ground: MetricOrthophoto
    lot: BaseGeometry
    avoid: BaseGeometry | None
    placed: list[PlacedFacility]
    missing: list[Missing]
    holds_low: list[bool] | None
    holds_high: list[bool] | None
    notes: tuple[str, ...]

    @property
    def free_area(self) -> float:
        """Area of the lot without `avoid` and without what was placed [m2]."""
        return _buildable(self.lot, self.avoid).area - sum(p.full_area.area for p in self.placed)


def plan(
    raster: Path,
    lot: Path,
    wishes: Sequence[str],
    *,
    catalogue: Path | None = None,
    avoid: Path | None = None,
    clearance: float = 1.0,
    scale_error: float | None = None,
    lot_pixels: bool = False,
) -> Layout:
    """Place the facilities of `wishes` (see `parse_requests`) inside `lot` on the orthophoto `raster`.

    avoid : a file of polygons to keep free. clearance : between facilities, their run-off included, and to the lot's
    edge [m]. scale_error : see `open_ground`. lot_pixels : whether coordinates of vectors and wishes are columns and
    rows. Raises InputError, UsageError.
    """
    if not (np.isfinite(clearance) and clearance >= 0):
        raise UsageError(f"--clearance must be zero or more metres, not {clearance:g}")
    requests = parse_requests(wishes, catalogue)
    ground = open_ground(raster, scale_error)
    area, notes = read_area(lot, ground, lot_pixels, LOT_INSIDE)
    if area.area < LEAST_LOT_M2:
        raise InputError(f"{lot}: a lot of {area.area:.1g} m2", "If it is in degrees, save it in the orthophoto's CRS.")
    blocked = None
    if avoid is not None:
        blocked, more = read_area(avoid, ground, lot_pixels)
        notes += more
    fixed = [_fixed(r, ground, lot_pixels) for r in requests if r.centre is not None]
    wanted = [r.facility for r in requests if r.centre is None]
    placed, missing = arrange(area, wanted, fixed, clearance, blocked)
    low = high = None
    if ground.interval is not None:
        # With a scale at the low end the lot is smaller on the ground, so facilities are larger in the picture. At the
        # high end they are smaller, so what fits at the low end fits there, too.
        low, high = (holds(_buildable(area, blocked), placed, 1 / bound) for bound in ground.interval)
    return Layout(ground, area, blocked, placed, missing, low, high, (*ground.notes, *notes))


def _buildable(lot: BaseGeometry, avoid: BaseGeometry | None) -> BaseGeometry:
    """The lot without the area to `avoid`."""
    return lot if avoid is None else lot.difference(avoid)


def _fixed(request: Request, ground: MetricOrthophoto, pixels: bool) -> PlacedFacility:
    place = np.array([request.centre])
    x, y = (ground.to_metres(place) if pixels else ground.from_crs(place))[0]
    return PlacedFacility(request.facility, (float(x), float(y)), float(request.bearing or 0.0) % 180)


def document(layout: Layout) -> dict[str, Any]:
    """The layout as plain values. Metres and degrees unless a name says px."""
    ground = layout.ground
    return {
        "format": LAYOUT_FORMAT,
        "orthophoto": str(ground.source.path),
        "gsd": ground.gsd,
        "scale_interval90": None if ground.interval is None else [ground.gsd * bound for bound in ground.interval],
        "lot_area_m2": round(layout.lot.area, 1),
        "free_area_m2": round(layout.free_area, 1),
        "north_in_picture": round(ground.north, 3),
        "facilities": [_row(layout, k) for k in range(len(layout.placed))],
        "missing": [
            {
                "code": m.facility.code,
                "name": m.facility.name,
                "why": m.sentence(),
                "fits_empty_lot": m.empty_lot,
                "short_length": _round(m.short_length),
                "short_width": _round(m.short_width),
            }
            for m in layout.missing
        ],
        "notes": list(layout.notes),
        "prompt": prompt(layout),
        "version": __version__,
    }


def _row(layout: Layout, k: int) -> dict[str, Any]:
    place, ground = layout.placed[k], layout.ground
    f = place.facility
    centre = np.array([place.centre])
    px, py = ground.to_pixels(centre)[0]
    x, y = ground.to_crs(centre)[0]
    low, high = (None, None) if ground.interval is None else ground.interval
    return {
        "number": k + 1,
        "code": f.code,
        "name": f.name,
        "length": f.length,
        "width": f.width,
        "full_length": f.full_length,
        "full_width": f.full_width,
        "bearing": round(place.bearing, 2) % 180,
        "turned_from_north": round(place.from_north, 2),
        "prefers_north_south": f.north_south,
        "east": round(place.centre[0], 3),
        "north": round(place.centre[1], 3),
        "x": float(x),
        "y": float(y),
        "column_px": round(float(px), 2),
        "row_px": round(float(py), 2),
        # True size on the ground of what is drawn as `length`, at the ends of the scale's interval.
        "length_low": None if low is None else round(f.length * low, 3),
        "length_high": None if high is None else round(f.length * high, 3),
        "width_low": None if low is None else round(f.width * low, 3),
        "width_high": None if high is None else round(f.width * high, 3),
        "fits_at_low_scale": None if layout.holds_low is None else layout.holds_low[k],
        "fits_at_high_scale": None if layout.holds_high is None else layout.holds_high[k],
        "source": f.source,
    }


def prompt(layout: Layout) -> str:
    """What to draw where, in words, for a generative renderer that also gets lines.png."""
    kinds: dict[str, tuple[Facility, list[PlacedFacility]]] = {}
    for place in layout.placed:
        kinds.setdefault(place.facility.name, (place.facility, []))[1].append(place)
    parts = []
    for facility, places in kinds.values():
        count = f"{len(places)} times " if len(places) > 1 else ""
        where = "; ".join(_where(layout, place) for place in places)
        parts.append(f"{count}{facility.look}, {facility.length:g} x {facility.width:g} m ({where})")
    return (
        "Vertical aerial photograph, true orthophoto seen from straight above, no perspective, no people, midday light "
        f"with short shadows, {100 * layout.ground.gsd:.1f} cm per pixel. Lines of the conditioning image are white "
        "paint on the ground; keep them exactly where they are. Show: " + "; ".join(parts) + ". Around them mown grass "
        "and paved paths, blending into the surroundings of the photograph."
    )


def _where(layout: Layout, place: PlacedFacility) -> str:
    x0, y0, x1, y1 = layout.lot.bounds
    across, up = (place.centre[0] - x0) / max(x1 - x0, 1e-9), (place.centre[1] - y0) / max(y1 - y0, 1e-9)
    names = [("south", "", "north")[min(int(3 * up), 2)], ("west", "", "east")[min(int(3 * across), 2)]]
    there = "".join(names) or "middle"
    return f"{there} of the lot, long side {round(place.bearing) % 180} degrees from north"


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 2)
