"""The summary of measured photos in the terminal: the answer first, then a line per photo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.remarks import amount, percent
from ..core.scale import with_interval
from .measure import Interval90, PhotoScale
from .tables import PhotoOutcome

LISTED = 40  # photos that are listed
MOST_TOLD = 4  # different texts of one kind that are told


def summary(
    outcomes: Sequence[PhotoOutcome], text: Mapping[str, Any], together: PhotoScale | None, outputs: Sequence[Path]
) -> list[str]:
    """The summary, a few lines: one photo in full, many as a table."""
    if together is not None:
        lines = _in_full(together)
        lines.append(f"vehicles   {together.scale.vehicles_used} of {text['together']['boxes']} boxes used, in "
                     f"{len(outcomes)} photos, each place in {together.overlap:.1f} of them")  # fmt: skip
    elif len(outcomes) == 1:
        (only,) = outcomes
        assert only.measured is not None
        lines = [*_in_full(only.measured), f"vehicles   {only.measured.scale.vehicles_used} used", *_compared(only)]
    else:
        lines = []
    if len(outcomes) > 1:
        lines.append(f"measured   {text['measured']} of {text['photos']} photos ({100 * text['used_ratio']:.0f} %)")
        width = max(len(o.name) for o in outcomes)
        for o in outcomes[:LISTED]:
            got = o.measured
            line = (o.problem if got is None else _short(got)) + _depth(o)
            lines.append(f"  {o.name:{width}s}  {line}")
        if len(outcomes) > LISTED:
            lines.append(f"  and {len(outcomes) - LISTED} more: --out TABLE.csv has them all")
    photos = [o.photo for o in outcomes if o.photo is not None]
    lines.append(f"fleet      {text['fleet']} ({text['fleet_name']})")
    lines += _told("focal", [f"{p.lens.focal_px:.1f} px, {p.lens.source}" for p in photos])
    lines += _told("attitude", [p.attitude for p in photos])
    lines += [f"note       {note}" for note in text["notes"]]
    lines += _told("note", [note for p in photos for note in p.tags.notes])
    for got in (together, *(o.measured for o in outcomes)):
        lines += [f"{r.label:10s} {got.photo.name}: {r.text}" for r in got.scale.remarks] if got else []
    lines += [f"written    {path}" for path in outputs]
    return lines


def _in_full(got: PhotoScale) -> list[str]:
    width, height = got.footprint
    parts = ", ".join(f"{name} {100 * sd:.1f} %" for name, sd in got.scale.parts.items() if sd > 0)
    return [
        f"altitude   {_interval(got.altitude, 'm')}   ({got.scale.verdict})",
        f"GSD        {_interval(got.gsd * 100, 'cm/px')}",
        f"scale      {_interval(got.nadir_gsd * 100, 'cm/px')}, of the nadir view",
        f"footprint  {_interval(width, 'm')} wide, {_interval(height, 'm')} high",
        f"uncertain  {parts}   (1 sigma)",
    ]


def _compared(outcome: PhotoOutcome) -> list[str]:
    """The altitudes of a photo by all means, with their ratios to the one by vehicles."""
    photo, got, depth = outcome.photo, outcome.measured, outcome.depth
    assert photo is not None and got is not None
    told = photo.tags.relative_altitude
    if not told and depth is None:
        return []
    lines = [("vehicles", got.altitude.value, "")]
    if depth is not None:
        scatter = f"which scatter by {percent(depth.scatter)}"
        lines.append(("depth", depth.altitude, f"ground around {depth.vehicles} vehicles, {scatter}"))
    if told:
        lines.append(("drone", told, "the drone reports it, above its take-off point"))
    return ["compared   altitude by   metres    ratio"] + [
        f"           {name:12s} {value:7.1f}  {_ratio(outcome.ratio(value)):7s}  {note}".rstrip()
        for name, value, note in lines
    ]


def _ratio(ratio: float | None) -> str:
    return "" if ratio is None else f"{ratio:7.3f}"


def _depth(outcome: PhotoOutcome) -> str:
    """The end of a photo's line: the altitude by its depth."""
    if outcome.depth is None:
        return f"  depth: {outcome.depth_problem}" if outcome.depth_problem else ""
    ratio = outcome.ratio(outcome.depth.altitude)
    return f"  by depth {outcome.depth.altitude:.1f} m" + (f" (x {ratio:.3f})" if ratio else "")


def _short(got: PhotoScale) -> str:
    width, height = got.footprint
    return (
        f"altitude {got.altitude.value:6.1f} m ({got.altitude.low:.0f} to {got.altitude.high:.0f})  "
        f"GSD {100 * got.gsd.value:5.2f} cm  footprint {width.value:.0f} x {height.value:.0f} m  "
        f"{got.scale.vehicles_used} vehicles  {got.scale.verdict}"
    )


def _interval(m: Interval90, unit: str) -> str:
    return with_interval(m.value, m.low, m.high, unit)


def _told(what: str, texts: Sequence[str]) -> list[str]:
    """Each different text once, with the number of photos that have it."""
    counts = Counter(texts)
    many = len(counts) > 1
    told = counts.most_common(None if len(counts) == MOST_TOLD + 1 else MOST_TOLD)  # one more takes no more room
    lines = [f"{what:10s} {text}" + (f" ({amount(count, 'photos')})" if many else "") for text, count in told]
    return lines + ([f"{what:10s} and {len(counts) - len(told)} others"] if len(counts) > len(told) else [])
