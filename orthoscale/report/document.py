"""The report as one document of plain values, from which (with the pictures) its page and its picture are drawn."""

from __future__ import annotations

import platform
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
from ..core.scale import Scale
from ..core.verdicts import FIT
from ..version import __version__
from .anchors import entries
from .inputs import frames_of, other_files
from .measured import MeasuredSource
from .stored import FORMAT, ORTHOPHOTO, RECONSTRUCTION

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
    frames = frames_of(source)
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
        "remarks": [remark.document() for remark in remarks],
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
        "other_files": other_files(source, of.given),
        "pixel_aspect": 1.0 if source.plan is None else source.claimed.aspect,
        "versions": _versions(),
        "created": of.created.isoformat(timespec="seconds"),
        "seconds": round(of.seconds, 2),
        "vehicles": _vehicles(measured, plan),
    }


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
        "tilt": drift.trend.tilt,
        "tilt_sd": drift.trend.tilt_sd,
        "direction_deg": float(np.degrees(drift.direction)),
        "p_tilt": drift.trend.p_tilt,
        "bend": drift.trend.bend,
        "p_bend": drift.trend.p_bend,
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
