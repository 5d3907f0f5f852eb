"""Calibrations as JSON files."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..core.calibration import Calibration
from ..system.paths import path_of
from .names import write_json
from .reading import checked, read_plain

CALIBRATION_FORMAT = "orthoscale calibration 1"
A_CALIBRATION = "the path of a calibration"


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write `calibration` as JSON, for `load_calibration` and `--calibration`. Raises UsageError if `path` is no path,
    OSError."""
    write_json(calibration_values(calibration), path_of(path, A_CALIBRATION))


def calibration_values(calibration: Calibration) -> dict[str, Any]:
    """Plain values, as in the file."""
    return {
        "kind": CALIBRATION_FORMAT,
        "detector": calibration.detector,
        "detector_sha256": calibration.detector_sha256,
        "ruler": asdict(calibration.ruler),
        "fleet": calibration.fleet_entry,
        "made_from": calibration.made_from,
    }


def load_calibration(path: str | Path) -> Calibration:
    """Read what `save_calibration` wrote. Raises InputError for any other file, UsageError if `path` is no path."""
    from .schemas.fleets import CalibrationEntry

    path = path_of(path, A_CALIBRATION)
    hint = "Make one: orthoscale calibrate ORTHO --out FILE.json"
    text = read_plain(path, "a calibration", hint)
    entry = checked(text, CalibrationEntry, str(path), "a calibration", hint)
    return Calibration(
        detector=entry.detector,
        detector_sha256=entry.detector_sha256,
        ruler=entry.ruler.ruler,
        fleet_entry=text["fleet"],
        made_from=entry.made_from,
        called=str(path),
    )
