"""The report as one self-contained HTML file: no network, no scripts, pictures and charts inside."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.claims import NO_UNIT
from ..core.normal import Z90
from ..core.remarks import INFO, percent, signed
from ..formats.pictures import jpeg
from ..requests import command_line
from ..system.paths import title_of
from . import charts, places, wording
from .anchors import size_of
from .explanation import explain
from .scene import Panel, ReportPictures
from .wording import relative

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup

JPEG_QUALITY = 82
MODE_ORDER = ("planar", "oblique")
VAGUE = 20.0  # [%] one sigma of a trend that is not told: all views are from one distance, or equally steep
TRENDS = ("percent_per_10_degrees", "percent_per_pixel_doubling")  # of a vehicle's size, before and after calibration
NAMES = {  # readable names of the report's checks
    "length": "lengths only",
    "width": "widths only",
    "length_minus_width": "length − width",
}
FARTHEST_CHECK = 0.5  # relative; checks further off are shown in the JSON only: they would squeeze the others


def page(report: Mapping[str, Any], scene: ReportPictures) -> str:
    """The HTML of a report. scene : its pictures, if there are any."""
    (value, low, high), unit = wording.quantity(report, report["scale"], *report["interval90"])
    return template("page.html").render(
        report=report,
        name=title_of(report["input"]["path"], report["input"]["folder"]),
        value=value,
        low=low,
        high=high,
        unit=unit,
        within=wording.within(report),
        metres=wording.metres_of(report),
        notes=[remark["text"] for remark in report["remarks"] if remark["severity"] == INFO],
        overviews=[_picture(panel) for panel in scene.overviews],
        used=[_picture(panel) for panel in scene.used],
        rejected=[_picture(panel) for panel in scene.rejected],
        anchors=[_picture(panel) for panel in scene.anchors],
        found=[_anchor(anchor, report) for anchor in report["anchors"]],
        narrowed=wording.narrowed(report),
        kinds=wording.counted_kinds(vehicle.get("kind", "") for vehicle in report["vehicles"] if vehicle["used"]),
        reasons=wording.counted(report["vehicles_rejected"]),
        boxes=wording.counted(report["boxes_rejected"]),
        histograms=[_histogram(report, axis) for axis in ("length", "width") if report["vehicles_used"]],
        estimates=_estimates(report),
        modes={name: _mode(mode, report) for name, mode in _modes(report).items()},
        calibration=_calibration(report),
        places=_places(report),
        frames=_frames(report),
        uncertainty=explain(report),
        fleets=wording.likely_fleets(report["fleets"]),
        command=command_line(report["input"]["path"], report["settings"], report["input"]["folder"]),
    )


@cache
def template(name: str) -> Template:
    """The template `name` beside this module: its values are escaped, and a missing one is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("orthoscale.report", ".")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"percent": percent, "signed": signed}
    return environment.get_template(name)


def _picture(panel: Panel) -> dict[str, Any]:
    height, width = panel.image.shape[:2]
    return {
        "title": panel.title,
        "reason": panel.reason,
        "width": width,
        "height": height,
        "href": _jpeg(panel.image),
        "bar": panel.bar,
        "fine": panel.fine,
        "outlines": [
            {
                "points": " ".join(f"{x:.1f},{y:.1f}" for x, y in outline.points),
                "used": outline.used,
                "label": outline.label,
            }
            for outline in sorted(panel.outlines, key=lambda o: o.used)
        ],
    }


def _jpeg(image: np.ndarray) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(image, JPEG_QUALITY)).decode()


def _histogram(report: Mapping[str, Any], axis: str) -> dict[str, Any]:
    sizes = {u: np.array([v[axis] for v in report["vehicles"] if v["used"] is u], float) for u in (True, False)}
    k = ("length", "width").index(axis)
    fleet = report["fleet_sizes"]
    classes = [(c["weight"], c["mean"][k], c["sd"][k]) for c in fleet["classes"]]
    used = sizes[True]
    return {
        "name": axis,
        "chart": charts.histogram(used, sizes[False], classes, axis),
        "mean": float(used.mean()),
        "sd": float(used.std(ddof=1)),
        "fleet": fleet[axis],
    }


def _estimates(report: Mapping[str, Any]) -> Markup:
    low, high = (relative(v, report) for v in report["interval90"])
    rows = [charts.ChartRow("the answer", 0.0, (low, high), strong=True)]
    for name, value in report["checks"].items():
        if not name.endswith("_sigmas") and name not in MODE_ORDER:
            rows.append(charts.ChartRow(NAMES.get(name, name.replace("_", " ")), relative(value, report)))
    for name, mode in _modes(report).items():
        low_of_mode, high_of_mode = (relative(v, report) for v in mode["interval90"])
        rows.append(charts.ChartRow(name, relative(mode["scale"], report), (low_of_mode, high_of_mode)))
    for other in report["evidence"]:
        half = Z90 * other["relative_sd"]
        rows.append(charts.ChartRow(other["kind"], at := relative(other["scale"], report), (at - half, at + half)))
    if report["claim"] and report["claim"]["verdict"] != NO_UNIT:
        rows.append(charts.ChartRow("its georeferencing", relative(report["claim"]["claimed"], report)))
    rows = [row for row in rows if abs(row.value) < FARTHEST_CHECK]
    label = "; ".join(f"{row.name} {signed(row.value)}" for row in rows[1:])
    return charts.estimates(rows, (low, high), f"Other estimates of the scale, relative to the answer: {label}")


def _anchor(anchor: Mapping[str, Any], report: Mapping[str, Any]) -> dict[str, Any]:
    """What the page says about one anchor."""
    alone = f"{signed(relative(anchor['scale'], report))} ± {percent(Z90 * anchor['relative_sd'])}"
    pictures = f"{anchor['views']} pictures" if anchor["views"] > 1 else anchor["picture"]
    residual = f"{anchor['residual_cm']:.1f} cm"
    return {**anchor, "size": size_of(anchor), "alone": alone, "pictures": pictures, "residual": residual}


def _modes(report: Mapping[str, Any]) -> dict[str, Mapping]:
    return {name: mode for name in MODE_ORDER if (mode := report.get("modes", {}).get(name))}


def _mode(mode: Mapping[str, Any], report: Mapping[str, Any]) -> str:
    """The result of one measuring mode, in words."""
    (value, low, high), unit = wording.quantity(report, mode["scale"], *mode["interval90"])
    return f"{value} {unit}, {low} to {high} (90 %), {mode['vehicles_used']} vehicles"


def _calibration(report: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """The self-calibration of the detector's ruler: name, before and after, for lengths and widths."""
    found = report.get("calibration")
    if found is None:
        return []
    table = [
        (name, _pair(found[key]["card"], form, unit), _pair(found[key]["fitted"], form, unit))
        for name, key, form, unit in (
            ("effective height", "effective_height", "{:.2f}", " m"),
            ("margin of boxes", "margin_px", "{:+.1f}", " px"),
            ("undercut of bodies", "undercut", "{:.2f}", " m"),
        )
    ]
    trends = found["trends"]
    if trends is None:
        return table
    return table + [
        (name, _slope(*trends["before"][key]), _slope(*trends["after"][key]))
        for name, key in (("steeper by 10 degrees", TRENDS[0]), ("half as far", TRENDS[1]))
        if max(trends[when][key][1] for when in ("before", "after")) < VAGUE
    ]


def _slope(percent: float, sd: float) -> str:
    return f"{percent:+.1f} ± {sd:.1f} %".replace("-", "−")


def _pair(values: Sequence[float], form: str, unit: str) -> str:
    return ", ".join(form.format(value) for value in values).replace("-", "−") + unit


def _places(report: Mapping[str, Any]) -> Markup | None:
    found = places.regions(report)
    if len(found) < 2:
        return None
    vehicles = np.array([v["place_m"] for v in report["vehicles"] if v["used"]], float)
    return charts.place_map(vehicles, found, "Vehicles from above, and the scale of each region relative to the whole")


def _frames(report: Mapping[str, Any]) -> Markup | None:
    found = places.frames(report)
    return charts.frames(found, "Scale of each frame relative to the answer") if found else None
