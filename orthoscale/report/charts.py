"""The report's charts as SVG text: narrow enough to be read on a phone, without scripts, fonts or colours of their own.

The page styles their classes (`used`, `fleet`, `axis` ...). Coordinates are those of the `viewBox`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from ..core.normal import Z90
from ..core.remarks import signed
from ..core.round_numbers import round_above, round_below
from .places import LocalFrameScale, LocalRegionScale, in_percent

CHART_WIDTH = 360  # of every chart; the page shows it at 300 to 480 px, so that letters of size 12 stay readable
LETTER = 6.8  # width of a letter, about
TICK_WIDTH = 6 * LETTER + 6  # of a label such as "+20 %", with the gap to the next one
BARS = 18  # number of a histogram's bars, about
BADGE = (40.0, 30.0)  # smallest size of a region's box, for its figures
FULL_COLOUR = 3.0  # deviation at which a region has its full colour [sigmas]


@dataclass(frozen=True)
class ChartRow:
    """A value with its 90 % interval, relative to the answer: 0.02 is 2 % larger."""

    name: str
    value: float
    interval: tuple[float, float] | None = None
    strong: bool = False


def histogram(used: np.ndarray, rejected: np.ndarray, fleet: Sequence[tuple[float, float, float]], what: str) -> Markup:
    """Histogram of the measured sizes [m], with the curve of the fleet: (weight, mean, sd) of each of its classes.

    Rejected sizes outside the range of both are only counted beside the axis: they would squeeze the rest.
    """
    weight, mean, sd = np.array(fleet, float).T
    weight = weight / weight.sum()
    low, high = float((mean - 3 * sd).min()), float((mean + 3 * sd).max())
    low, high = min(low, float(used.min(initial=low))), max(high, float(used.max(initial=high)))
    step = round_above((high - low) / BARS)
    edges = np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step
    counts = [np.histogram(sizes, edges)[0] for sizes in (used, rejected)]
    beyond = int((rejected < edges[0]).sum()), int((rejected > edges[-1]).sum())
    x = np.linspace(edges[0], edges[-1], 120)
    density = (weight * np.exp(-0.5 * ((x[:, None] - mean) / sd) ** 2) / sd).sum(1) / np.sqrt(2 * np.pi)
    curve = density * len(used) * step
    top = max(float((counts[0] + counts[1]).max()), float(curve.max()), 1.0)
    left, right, base, height = 8.0, CHART_WIDTH - 8.0, 138.0, 112.0

    def px(value: float) -> float:
        return left + (value - edges[0]) / (edges[-1] - edges[0]) * (right - left)

    parts = []
    for k, edge in enumerate(edges[:-1]):
        y = base
        for kind, count in zip(("used", "rejected"), (counts[0][k], counts[1][k]), strict=True):
            if count:
                tall = count / top * height
                y -= tall
                parts.append(
                    _tag(
                        "rect", x=px(edge) + 0.7, y=y, width=px(edge + step) - px(edge) - 1.4, height=tall, class_=kind
                    )
                )
    points = " ".join(f"{px(a):.1f},{base - b / top * height:.1f}" for a, b in zip(x, curve, strict=True))
    parts.append(_tag("polyline", points=points, class_="fleet"))
    parts.append(_line(left, base, right, base))
    tick = round_above((edges[-1] - edges[0]) / 5)
    for value in np.arange(np.ceil(edges[0] / tick), edges[-1] / tick + 1e-9) * tick:
        parts.append(_line(px(value), base, px(value), base + 4))
        parts.append(_text(min(max(px(value), left + 8), right - 8), base + 17, f"{value:.3g}"))
    parts.append(_text(CHART_WIDTH / 2, base + 33, f"{what} in metres"))
    if beyond[0]:
        parts.append(_text(left, base + 33, f"← {beyond[0]}", anchor="start", class_="out"))
    if beyond[1]:
        parts.append(_text(right, base + 33, f"{beyond[1]} →", anchor="end", class_="out"))
    middle = float(np.mean(used)) if len(used) else float("nan")
    label = f"{what}: mean of {len(used)} vehicles {middle:.2f} m, of the fleet {float(weight @ mean):.2f} m"
    return _svg(base + 38, parts, label)


def estimates(rows: Sequence[ChartRow], band: tuple[float, float], label: str) -> Markup:
    """Values, one below the other, on one axis in per cent of the answer; the grey `band` is its 90 % interval."""
    ends = [*band, *(v for row in rows for v in (row.value, *(row.interval or ())))]
    reach = min(max(1.1 * max(map(abs, ends)), 0.02), 0.6)
    left, right, step, top = 18.0 + LETTER * max(len(row.name) for row in rows), CHART_WIDTH - 58.0, 25.0, 6.0
    bottom = top + step * len(rows)

    def px(value: float) -> float:
        return (left + right) / 2 + min(max(value, -reach), reach) / reach * (right - left) / 2

    parts = [_tag("rect", x=px(band[0]), y=top, width=px(band[1]) - px(band[0]), height=bottom - top, class_="band")]
    parts.append(_line(px(0), top, px(0), bottom))
    for k, row in enumerate(rows):
        y = top + step * (k + 0.5)
        kind = "strong" if row.strong else ""
        parts.append(_text(left - 10, y + 4, row.name, anchor="end", class_=kind))
        if row.interval is not None:
            parts.append(_tag("line", x1=px(row.interval[0]), y1=y, x2=px(row.interval[1]), y2=y, class_="interval"))
        parts.append(_tag("circle", cx=px(row.value), cy=y, r=5 if row.strong else 4, class_="used"))
        if row.value:
            parts.append(_text(CHART_WIDTH, y + 4, signed(row.value), anchor="end", class_=kind))
    parts.append(_line(left, bottom, right, bottom))
    for value in _ticks(reach, most=(right - left) / TICK_WIDTH):
        parts.append(_line(px(value), bottom, px(value), bottom + 4))
        parts.append(_text(px(value), bottom + 17, _tick(value)))
    return _svg(bottom + 22, parts, label)


def place_map(vehicles: np.ndarray, regions: Sequence[LocalRegionScale], label: str) -> Markup:
    """Vehicles (N, 2) [m] from above, and the deviation of each region's scale from the overall scale in per cent.

    A region is coloured by its deviation in sigmas: what may be chance stays pale.
    """
    edges = np.array([(r.x + s * r.width / 2, r.y + s * r.height / 2) for r in regions for s in (-1, 1)])
    low, high = np.minimum(vehicles.min(0), edges.min(0)), np.maximum(vehicles.max(0), edges.max(0))
    border = 0.02 * max(float((high - low).max()), 1e-9)
    low, high = low - border, high + border
    zoom = min((CHART_WIDTH - BADGE[0]) / (high[0] - low[0]), 320 / (high[1] - low[1]))
    shift = (CHART_WIDTH - zoom * (high[0] - low[0])) / 2

    def px(x: float, y: float) -> tuple[float, float]:
        return shift + (x - low[0]) * zoom, BADGE[1] / 2 + (high[1] - y) * zoom

    height = zoom * (high[1] - low[1]) + BADGE[1]
    parts = [_tag("rect", x=0, y=0, width=CHART_WIDTH, height=height, rx=4, class_="paper")]
    for region in regions:
        x, y = px(region.x, region.y)
        wide, tall = max(region.width * zoom, BADGE[0]), max(region.height * zoom, BADGE[1])
        colour = "larger" if region.deviation > 0 else "smaller"
        box = {"x": x - wide / 2, "y": y - tall / 2, "width": wide, "height": tall, "rx": 3}
        parts.append(_tag("rect", **box, class_="ground"))
        parts.append(
            _tag("rect", **box, class_=colour, fill_opacity=f"{0.7 * strength(region.deviation, region.sd):.2f}")
        )
    for vehicle in vehicles:
        x, y = px(*vehicle)
        parts.append(_tag("circle", cx=x, cy=y, r=2, class_="dot"))
    for region in regions:
        x, y = px(region.x, region.y)
        larger, half = in_percent(region.deviation, region.sd)
        parts.append(_text(x, y - 2, f"{larger:+.1f}".replace("-", "−"), class_="strong halo"))
        parts.append(_text(x, y + 12, f"± {half:.1f}", class_="halo"))
    return _svg(height, parts, label)


def strength(deviation: float, sd: float) -> float:
    """Strength of a region's colour, 0 to 1: pale for what may be chance, full from FULL_COLOUR sigmas on."""
    return min(abs(deviation) / sd / FULL_COLOUR, 1.0) ** 2 if sd > 0 else 0.0


def frames(rows: Sequence[LocalFrameScale], label: str) -> Markup:
    """One mark for each frame, in the order of `rows`, with its 90 % interval; odd frames stand out."""
    reach = min(max(1.05 * max(abs(np.expm1(row.deviation)) for row in rows), 0.04), 0.5)
    left, right, top, height = 46.0, CHART_WIDTH - 4.0, 6.0, 120.0

    def py(value: float) -> float:
        return top + height / 2 - min(max(value, -reach), reach) / reach * height / 2

    def py_of_log(value: float) -> float:
        return py(float(np.expm1(value)))

    parts = []
    for value in _ticks(reach):
        parts.append(_line(left, py(value), right, py(value)))
        parts.append(_text(left - 4, py(value) + 4, _tick(value), anchor="end"))
    for k, row in enumerate(rows):
        x = left + (k + 0.5) / len(rows) * (right - left)
        y0, y1 = (py_of_log(row.deviation + side * Z90 * row.sd) for side in (1, -1))
        parts.append(_tag("line", x1=x, y1=y0, x2=x, y2=y1, class_="interval thin"))
        parts.append(_tag("circle", cx=x, cy=py_of_log(row.deviation), r=2.5, class_="rejected" if row.odd else "used"))
    parts.append(_text(left, top + height + 16, rows[0].name, anchor="start"))
    if len(rows) > 1:
        parts.append(_text(right, top + height + 16, rows[-1].name, anchor="end"))
    return _svg(top + height + 22, parts, label)


def _ticks(reach: float, most: float = np.inf) -> np.ndarray:
    """Round numbers from -`reach` to `reach`, three to five of them; three where that is more than `most`."""
    step = round_below(reach)
    step *= np.floor(reach / step) if 2 * reach / step > most else 1
    return np.arange(np.ceil(-reach / step), np.floor(reach / step) + 1) * step


def _tick(value: float) -> str:
    return "0" if abs(value) < 1e-9 else f"{100 * value:+.3g} %".replace("-", "−")


def _svg(height: float, parts: Sequence[Markup], label: str) -> Markup:
    head = Markup('<svg viewBox="0 0 {} {:.0f}" role="img" aria-label="{}" class="chart">')
    head = head.format(CHART_WIDTH, height, label)
    return head + Markup("").join(parts) + Markup("</svg>")


def _line(x1: float, y1: float, x2: float, y2: float) -> Markup:
    return _tag("line", x1=x1, y1=y1, x2=x2, y2=y2, class_="axis")


def _text(x: float, y: float, text: str, anchor: str = "middle", class_: str = "") -> Markup:
    return Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}" class="{}">{}</text>').format(
        x, y, anchor, class_, text
    )


def _tag(name: str, **attributes: float | str) -> Markup:
    written = (
        f' {key.rstrip("_").replace("_", "-")}="'
        + (f"{value:.1f}" if isinstance(value, (int, float)) else str(escape(value)))
        + '"'
        for key, value in attributes.items()
    )
    # Values are escaped one by one: `Markup.format` takes ten times as long.
    return Markup(f"<{name}{''.join(written)}/>")
