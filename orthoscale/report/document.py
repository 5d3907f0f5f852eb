"""The report as one JSON document, from which (with the pictures) the page and the picture of a report are drawn."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from ..core.claims import own_claim
from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.measuring.anchors import FoundAnchors
from ..core.measuring.drift import Drift
from ..core.measuring.judgement import judgements
from ..core.measuring.measurement import Measurement
from ..core.measuring.model_drift import ModelDrift
from ..core.remarks import CAUTION, INFO
from ..core.scale import PER_PIXEL, Scale
from ..core.source import FilePicture, Source
from ..core.verdicts import FIT
from ..errors import InputError, shown
from ..formats.names import each_text, first_few, json_in_utf8, out_of_utf8
from ..formats.reading import LARGE, checked, read_plain
from ..sources.fingerprint import glance
from ..system.paths import absolute
from ..version import __version__
from .anchors import entries
from .measured import MeasuredSource

FORMAT = "orthoscale report 2"
# In it remarks were bare sentences, `notes` listed those that only inform, and there were no judgements.
FIRST_FORMAT = "orthoscale report 1"

ORTHOPHOTO, RECONSTRUCTION = "orthophoto", "reconstruction"  # kinds of inputs

# Parts that a report may lack (an orthophoto has no frames, few views show no trend, an older version wrote less), by
# their place in the document, and their defaults, which are those of `formats.schemas.report.Report` for what that
# checks. Everything else is in every report.
OPTIONAL: dict[tuple[str, ...], Any] = {
    ("fleets",): {},
    ("fleet_source",): "",
    ("evidence",): [],
    ("anchors",): [],
    ("without_anchors",): None,
    ("remarks",): [],
    ("judgements",): [],
    ("sweep",): None,
    ("zoom_search",): None,
    ("claim",): None,
    ("agreement",): None,
    ("modes",): {},
    ("modes", "oblique"): None,
    ("modes", "planar"): None,
    ("drift",): None,
    ("drift", "cells"): [],
    ("drift", "frames"): {},
    ("drift", "odd_frames"): [],
    ("drift", "regions"): [],
    ("drift", "trend"): None,
    ("drift", "drifts"): None,
    ("calibration",): None,
    ("calibration", "views"): 0,
    ("calibration", "undercut"): {"card": (0.0, 0.0), "fitted": (0.0, 0.0)},
    ("calibration", "trends"): None,
    ("input", "folder"): "",
    ("input", "kind"): "",
    ("frame_bytes",): {},
    ("frame_crc32",): {},
    ("other_files",): {},
    ("pixel_aspect",): 1.0,
    ("versions",): {},
    ("created",): "",
    ("seconds",): 0.0,
}

PACKAGES = ("numpy", "scipy", "opencv-python-headless", "onnxruntime", "pycolmap", "rasterio")


def document(of: MeasuredSource) -> dict[str, Any]:
    """The report as plain values. Lengths are in metres unless a name says px or unit; intervals are 90 %.

    ``vehicles[].length`` and ``width`` are those of the vehicle, without the detector's margin; ``place_m`` is its
    place on a plan, x right and y up (see `Source.from_above`). ``remarks`` and ``judgements`` are those of the core,
    with their severity (`core.remarks`).
    """
    measured, source, fleet, remarks = of.measured, of.source, of.fleet, of.remarks
    scale = measured.scale
    plan = source.from_above(measured.votes.place) * scale.value
    frames = _frames(source)
    claim = own_claim(source, scale)
    return {
        "format": FORMAT,
        "scale": scale.value,
        "unit": scale.unit,
        "interval90": list(scale.interval90),
        "verdict": scale.verdict,
        "fit": FIT[scale.verdict],
        "judgements": [asdict(judgement) for judgement in judgements(measured, claim, remarks)],
        "vehicles_used": scale.vehicles_used,
        "vehicles_rejected": scale.rejected,
        "boxes_rejected": measured.rejected_boxes,
        "fleet": scale.fleet,
        "fleet_name": fleet.name,
        "fleet_source": fleet.source,
        "fleets": dict(sorted(scale.fleets.items(), key=lambda item: -item[1])),
        "larger_vehicles": scale.larger_share,
        "evidence": [
            {"kind": e.kind, "scale": e.value, "relative_sd": e.relative_sd, "says": e.says} for e in scale.evidence
        ],
        **_anchors(of.anchors, scale),
        "method": {"projection": measured.projection, "estimator": of.method.estimator},
        "fleet_sizes": _fleet_sizes(fleet),
        "uncertainty": dict(scale.parts),
        "checks": {**scale.checks, "tension_sigmas": scale.tension, "conflict_sigmas": scale.conflict},
        "weights": {"length": scale.weights[0], "width": scale.weights[1]},
        "remarks": [{"severity": remark.severity, "text": remark.text} for remark in remarks],
        **_of_detection(of.detections),
        "claim": None if claim is None else claim.document(),
        "drift": _drift(measured.drift),
        **_of_posed(measured),
        "input": {
            "path": str(source.path),
            "kind": ORTHOPHOTO if source.plan is not None else RECONSTRUCTION,
            "sha256": source.content_hash(),
            "folder": _current_folder(),
        },
        "settings": dict(of.settings),
        "pictures": {p.name: [p.width, p.height] for p in source.pictures},
        "frame_bytes": {name: size for name, (size, _) in frames.items()},
        "frame_crc32": {name: crc for name, (_, crc) in frames.items()},
        "other_files": _other_files(source, of.given),
        "pixel_aspect": 1.0 if source.plan is None else source.claimed.aspect,
        "versions": _versions(),
        "created": of.created.isoformat(timespec="seconds"),
        "seconds": round(of.seconds, 2),
        "vehicles": _vehicles(measured, plan),
    }


def _frames(source: Source) -> dict[str, tuple[int, int]]:
    """What tells each frame of a reconstruction, which its hash does not cover, from another: see `glance`. Raises
    InputError."""
    files = () if source.posed is None else (p for p in source.pictures if isinstance(p, FilePicture))
    return {picture.name: glance(picture.path) for picture in files}


def _other_files(source: Source, given: Sequence[Path]) -> dict[str, list[int]]:
    """What tells others of the same name, see `glance`, from the files besides `source` that its report is of: the
    parts of a VRT and whatever else an orthophoto is read with, and those `given` by options. Names start from the
    source's folder, if that is on the same drive. Raises InputError."""
    own, home = absolute(source.path), absolute(source.path).parent
    files = [absolute(path) for path in (*(source.files if source.plan is not None else ()), *given)]
    # GIS programs write statistics into .aux.xml.
    others = [path for path in files if path != own and path.is_file() and not path.name.endswith(".aux.xml")]
    return {os.path.relpath(p, home) if p.drive == home.drive else str(p): [*glance(p)] for p in others}


def _of_detection(found: Detections) -> dict[str, Any]:
    """The detector, the scale search, and how much of the pictures was processed (``sweep``): None where boxes came
    from a file."""
    swept = found.swept
    choice = None if swept is None else swept.zoom_choice
    return {
        "detector": {
            "name": found.detector,
            "sha256": found.detector_sha256,
            "zoom": found.zoom,
            "effective_height": list(found.effective_height),
            "margin_px": list(found.ruler.margin),
        },
        "sweep": None
        if swept is None
        else {
            "tiles": len(swept.tiles),
            "of": swept.total,
            "from_cache": swept.from_cache,
            "looked_at": swept.looked_at,
            "why": swept.why,
        },
        "zoom_search": None
        if choice is None
        else {"vehicle_px": choice.vehicle_px, "votes": choice.votes, "runner_up": choice.rival},
    }


def _versions() -> dict[str, str]:
    """Of this program, Python, and the packages that matter."""
    packages = {name: _version(name) for name in PACKAGES}
    return {"orthoscale": __version__, "python": platform.python_version(), **packages}


def _anchors(searched: FoundAnchors, scale: Scale) -> dict[str, Any]:
    """The anchors found in the pictures, and the scale without them."""
    values: dict[str, Any] = {"anchors": entries(searched.votes, scale.value, scale.parts)}
    if searched.votes and (before := searched.without) is not None:
        values["without_anchors"] = {"scale": before.value, "interval90": list(before.interval90)}
    return values


def _vehicles(measured: Measurement, plan: np.ndarray) -> list[dict[str, Any]]:
    """Every vehicle with the boxes that show it. plan : (N, 2) their places seen from above [m]."""
    votes, scale = measured.votes, measured.scale
    return [
        {
            "length": float(row["length"]),
            "width": float(row["width"]),
            "place_m": [round(float(v), 3) for v in plan[k]],
            "place_unit": [float(v) for v in votes.place[k]],
            "views": int(row["views"]),
            "score": round(float(row["score"]), 3),
            "used": bool(row["used"]),
            "reason": scale.reasons[k],
            "kind": row["kind"],
            "boxes": [
                {
                    "picture": str(measured.picture[m]),
                    "xylwa_px": [round(float(v), 3) for v in measured.boxes.xylwa[m]],
                    "score": round(float(measured.boxes.score[m]), 3),
                }
                for m in votes.members[k]
            ],
        }
        for k, row in enumerate(measured.vehicles)
    ]


def _of_posed(measured: Measurement) -> dict[str, Any]:
    """The parts that only reconstructions have: the self-calibration, the measuring modes, and how these agree."""
    values: dict[str, Any] = {}
    if (own := measured.findings.calibration) is not None:
        values["calibration"] = {**own.ruler.document(own.card), "trends": own.trends}
    if measured.modes:
        values["modes"] = {
            name: {
                "scale": mode.scale.value,
                "interval90": list(mode.scale.interval90),
                "verdict": mode.scale.verdict,
                "vehicles_used": mode.scale.vehicles_used,
                "boxes": len(mode.boxes),
                "uncertainty": dict(mode.scale.parts),
            }
            for name, mode in measured.modes.items()
        }
    if (agreement := measured.agreement) is not None:
        values["agreement"] = {
            "difference": agreement.difference,
            "sigmas": agreement.tension,
            "common_vehicles": agreement.common,
            "contradicts": agreement.contradicts,
            "cause": agreement.cause,
        }
    return values


def _drift(drift: Drift | ModelDrift | None) -> dict[str, Any] | None:
    if drift is None:
        return None
    return drift_values(drift) if isinstance(drift, Drift) else _model_drift(drift)


def drift_values(drift: Drift) -> dict[str, Any]:
    """The drift of an orthophoto, as in the report."""
    names = ("x_px", "y_px", "vehicles", "deviation", "sd")
    return {
        "tilt": drift.tilt,
        "tilt_sd": drift.tilt_sd,
        "direction_deg": float(np.degrees(drift.direction)),
        "p_tilt": drift.p_tilt,
        "bend": drift.bend,
        "p_bend": drift.p_bend,
        "drifts": drift.drifts,
        "cell_px": list(drift.cell),
        "cells": [dict(zip(names, map(float, cell), strict=True)) for cell in drift.cells],
    }


def _model_drift(drift: ModelDrift) -> dict[str, Any]:
    return {
        "frames": {name: {"scale": f.scale, "sd": f.sd, "vehicles": f.vehicles} for name, f in drift.frames.items()},
        "odd_frames": [name for name, _ in drift.odd],
        "regions": [
            {"centre_unit": list(r.centre), "scale": r.scale, "sd": r.sd, "vehicles": r.vehicles} for r in drift.regions
        ],
        "trend": None
        if drift.trend is None
        else {
            "percent_across": 100 * drift.trend.tilt,
            "chance": drift.trend.p_tilt,
            "percent_bent": 100 * drift.trend.bend,
            "bend_chance": drift.trend.p_bend,
        },
        "drifts": drift.drifts,
    }


def replaced_frames(report: Mapping[str, Any], source: Source) -> str:
    """Says which frames of `source` are others than those that its `report` was made of; '' if none are. Raises
    InputError."""
    sizes, crcs = report.get("frame_bytes") or {}, report.get("frame_crc32") or {}  # not in reports of older versions
    others = [
        name
        for name, (size, crc) in _frames(source).items()
        if sizes.get(name, size) != size or crcs.get(name, crc) != crc
    ]
    return f"frames have changed since: {first_few(others)}" if others else ""


def replaced_files(report: Mapping[str, Any], source: Source, given: Sequence[Path] = ()) -> str:
    """Says which other files than `source`, see `_other_files`, are not those that its `report` was made of; '' if all
    are. Raises InputError."""
    known = report.get("other_files") or {}  # not in reports of older versions
    others = [name for name, now in _other_files(source, given).items() if known.get(name, now) != now]
    return f"files have changed since: {first_few(others)}" if others else ""


def of_plan(report: Mapping[str, Any]) -> bool:
    """Whether the report is of an orthophoto, not of a reconstruction. In older reports only the unit tells."""
    kind = report["input"].get("kind")
    return kind == ORTHOPHOTO if kind else report["unit"] == PER_PIXEL


def pixel_size(report: Mapping[str, Any]) -> tuple[float, float]:
    """Width and height of an orthophoto's pixel on the ground [m]; the scale is the side of a square of equal area."""
    wide = math.sqrt(report["pixel_aspect"])
    return report["scale"] * wide, report["scale"] / wide


def upgraded(report: Any) -> Any:
    """`report` converted from the first format to this one; anything else as it is.

    The judgements that it lacks are not added: only the code that measures can judge.
    """
    if (
        not isinstance(report, dict)
        or report.get("format") != FIRST_FORMAT
        or not isinstance(report.get("remarks"), list)
    ):
        return report
    notes = report.get("notes") or []
    remarks = [{"severity": INFO if text in notes else CAUTION, "text": text} for text in report["remarks"]]
    return {**report, "format": FORMAT, "fit": FIT.get(report.get("verdict", ""), ""), "remarks": remarks}


def completed(report: Mapping[str, Any]) -> dict[str, Any]:
    """`report` with the defaults of OPTIONAL for parts that are absent or null, so that readers need not check."""
    full = dict(report)
    for (*above, name), default in OPTIONAL.items():
        part: Any = full
        for key in above:
            part = part[key]
        if not isinstance(part, dict):
            continue  # the whole part is absent
        if part.get(name) is None:
            part[name] = default
        if isinstance(part[name], Mapping):
            part[name] = dict(part[name])  # a copy, so that defaults are not added to the caller's report
    return full


def write_json(report: Mapping[str, Any], path: Path) -> None:
    """Write the report as UTF-8 to `path`, from where the caller moves it into place; `in_utf8` escapes names that are
    not UTF-8. Raises OSError."""
    path.write_text(json_in_utf8(report, indent=1) + "\n", encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Read a report that `write_json` wrote, its escaped names restored. Raises InputError for anything else."""
    from ..formats.schemas.report import Report

    hint = "Give the report.json or OUT.tif.json that `orthoscale fix` wrote, or make it again."
    report = upgraded(read_plain(path, "a report", hint, LARGE))
    found = report.get("format") if isinstance(report, dict) else None
    if found != FORMAT:
        told = f"format {shown(str(found))!r}" if found else "no format"
        raise InputError(f"{path}: a report of another version ({told}, expected {FORMAT!r})", hint)
    checked(report, Report, str(path), "a report", hint)
    return each_text(report, out_of_utf8)


def _fleet_sizes(fleet: Fleet) -> dict[str, Any]:
    axes = {
        axis: {"mean": float(fleet.mean[k]), "sd": float(fleet.sd[k]), "mean_sd": float(fleet.mean_sd[k])}
        for k, axis in enumerate(("length", "width"))
    }
    classes = [
        {"name": c.name, "weight": c.weight, "mean": c.mean[:2].tolist(), "sd": c.sd[:2].tolist()}
        for c in fleet.every_class
    ]
    return {**axes, "classes": classes}


def _current_folder() -> str:
    """The current folder, from which relative paths start; '' if it was deleted."""
    try:
        return str(Path.cwd())
    except OSError:
        return ""


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
