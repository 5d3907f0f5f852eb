"""The report as one JSON document; everything a person sees is drawn from it or from the same result."""

from __future__ import annotations

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..check import own_claim
from ..drift import Drift
from ..pipeline import Result

PACKAGES = ("numpy", "scipy", "opencv-python-headless", "onnxruntime", "pycolmap", "rasterio")


def document(result: Result) -> dict[str, Any]:
    """`result` as plain values. Lengths in metres unless a name says px or unit; intervals are 90 %."""
    scale, found, votes = result.scale, result.detections, result.votes
    return {
        "scale": scale.value,
        "unit": scale.unit,
        "interval90": list(scale.interval90),
        "verdict": scale.verdict,
        "vehicles_used": scale.vehicles_used,
        "vehicles_rejected": scale.rejected,
        "boxes_rejected": result.rejected_boxes,
        "fleet": scale.fleet,
        "fleet_name": result.fleet.name,
        "fleet_source": result.fleet.source,
        "uncertainty": {name: sd for name, sd in scale.parts.items()},
        "checks": {**scale.checks, "tension_sigmas": scale.tension},
        "weights": {"length": scale.weights[0], "width": scale.weights[1]},
        "remarks": remarks(result),
        "detector": {
            "name": found.detector,
            "sha256": found.detector_sha256,
            "zoom": found.zoom,
            "effective_height": list(found.effective_height),
            "margin_px": list(found.ruler.margin),
        },
        "sweep": None
        if found.swept is None
        else {"tiles": len(found.swept.tiles), "of": found.swept.total, "from_cache": found.swept.from_cache},
        "claim": None if (claim := own_claim(result.source, scale)) is None else claim.document(),
        "drift": None if result.drift is None else _drift(result.drift),
        "zoom_search": None
        if result.zoom_choice is None
        else {
            "vehicle_px": result.zoom_choice.vehicle_px,
            "votes": result.zoom_choice.votes,
            "runner_up": result.zoom_choice.rival,
        },
        **result.measured.findings,
        "input": {"path": str(result.source.path), "sha256": result.source.content_hash()},
        "versions": {
            "orthoscale": __version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
        },
        "seconds": round(result.seconds, 2),
        "vehicles": [
            {
                "length": float(votes.size[k, 0] * scale.value),
                "width": float(votes.size[k, 1] * scale.value),
                "place_unit": [float(v) for v in votes.place[k]],
                "views": int(votes.views[k]),
                "score": round(float(votes.score[k]), 3),
                "used": bool(scale.used[k]),
                "reason": scale.reasons[k],
                "boxes": [
                    {
                        "picture": str(result.picture[m]),
                        "xylwa_px": [round(float(v), 3) for v in result.boxes.xylwa[m]],
                    }
                    for m in votes.members[k]
                ],
            }
            for k in range(len(votes))
        ],
    }


def remarks(result: Result) -> list[str]:
    """What a reader should know beside the figures."""
    drift = [result.drift.remark] if result.drift is not None and result.drift.remark else []
    return [*result.scale.remarks, *drift, *result.source.notes]


def _drift(drift: Drift) -> dict[str, Any]:
    names = ("x_px", "y_px", "vehicles", "deviation", "sd")
    return {
        "tilt": drift.tilt,
        "tilt_sd": drift.tilt_sd,
        "direction_deg": float(np.degrees(drift.direction)),
        "p_tilt": drift.p_tilt,
        "p_bend": drift.p_bend,
        "cells": [dict(zip(names, map(float, cell), strict=True)) for cell in drift.cells],
    }


def write_json(report: dict[str, Any], path: Path) -> None:
    path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
