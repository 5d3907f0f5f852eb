"""An evaluation as a document of plain values, and its tables for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.pooling.paper import MIN_SCORE, MIN_VEHICLES
from ..core.progress import Progress, of_step
from ..errors import InputError, TooLittleEvidence, UsageError
from ..formats.csv_table import write_csv
from ..formats.names import write_json
from ..photos.depth.maps import Depths
from ..version import __version__
from . import score
from .methods import BY_DEPTH, EXACT, METHODS, by_depth
from .readers import Sample, read_samples

EVALUATION_FORMAT = "orthoscale evaluate 1"


def samples_of(
    path: Path, form: str | None, lens_file: Path | None, focal_px: float | None, max_pitch: float | None
) -> tuple[list[Sample], list[str]]:
    """`read_samples`, without photos whose pitch is flatter than `max_pitch` [deg]. Raises InputError, UsageError."""
    if max_pitch is not None and not -90 <= max_pitch <= 0:
        raise UsageError(f"--max-pitch must lie between -90 (straight down) and 0 (the horizon), not {max_pitch:g}")
    samples, notes = read_samples(path, form, lens_file, focal_px)
    if max_pitch is None:
        return samples, notes
    steep = [s for s in samples if s.photo.pitch <= np.radians(max_pitch)]
    if not steep:
        raise InputError(f"{path}: no photo has a pitch of {max_pitch:g} degrees or steeper", "Change --max-pitch.")
    if len(steep) < len(samples):
        notes = [*notes, f"{len(samples) - len(steep)} photos with a flatter pitch than {max_pitch:g} degrees left out"]
    return steep, notes


def document(
    samples: Sequence[Sample],
    found: Detections,
    fleet: Fleet,
    notes: Sequence[str],
    ablations: bool = False,
    sensitivity: bool = False,
    progress: Progress | None = None,
    depths: Depths | None = None,
) -> dict[str, Any]:
    """All results as plain values. Raises TooLittleEvidence if no photo was usable.

    depths : the photos' metric depth, for one more method; ablations and sensitivity are only for methods by vehicles.
    """
    refused: Counter[str] = Counter()
    methods = METHODS if depths is None else METHODS | {BY_DEPTH: by_depth(depths, refused)}
    rows = score.score(samples, found, fleet, methods, step=of_step(progress, "Measuring"))
    if refused:
        (why, _), *_ = refused.most_common(1)
        notes = [*notes, f"{refused.total()} of {len(samples)} photos without an altitude by depth; one: {why}"]
    regions = score.by_region(rows, methods)
    if not any(line["used"] for lines in regions.values() for line in lines):
        raise TooLittleEvidence(
            f"none of {len(samples)} photos shows {MIN_VEHICLES} vehicles with a score above {MIN_SCORE:g}",
            "Inspect the boxes (--save-detections), or try another resampling factor (--gsd-hint METRES_PER_PIXEL).",
        )
    text = {
        "format": EVALUATION_FORMAT,
        "photos": len(samples),
        "fleet": fleet.code,
        "detector": found.detector,
        "zoom": found.zoom,
        "min_score": MIN_SCORE,
        "min_vehicles": MIN_VEHICLES,
        "notes": list(notes),
        "regions": regions,
    }
    if ablations:
        text["ablations"] = score.ablation(samples, found, fleet, METHODS, of_step(progress, "Ablations"))
    if sensitivity:
        text["sensitivity"] = score.sensitivity(samples, found, fleet, METHODS, of_step(progress, "Wrong geometry"))
    return text | {"version": __version__, "rows": score.photo_rows(rows)}


def write(text: dict[str, Any], path: Path) -> None:
    """Write the document (.json), or the rows of its photos (.csv)."""
    if path.suffix.lower() == ".json":
        write_json(text, path)
    else:
        write_csv(path, list(text["rows"][0]), text["rows"])


def tables(text: dict[str, Any], outputs: Sequence[Path]) -> list[str]:
    """Lines of a table for each question; errors in per cent."""
    lines = [
        _line(
            "method", "region", "photos", "used", "ratio", "vehicles", "altitude", "MAPE", "median", "bias", "in 90 %"
        )
    ]
    for method, regions in text["regions"].items():
        for r in regions:
            altitude = "-" if r["altitude_m"] is None else "{0:.0f}..{2:.0f} m".format(*r["altitude_m"])
            inside = "-" if r["in_interval"] is None else f"{100 * r['in_interval']:.0f} %"
            figures = [_percent(r[k]) for k in ("mape", "median_ape")] + [_percent(r["bias"], "+")]
            ratio, vehicles = f"{100 * r['used_ratio']:.1f} %", "-" if not r["used"] else f"{r['mean_vehicles']:.1f}"
            lines.append(
                _line(method, r["region"], r["images"], r["used"], ratio, vehicles, altitude, *figures, inside)
            )
    for method in text["regions"]:
        lines += _ablation_table(text, method) + _sensitivity_table(text, method)
    lines += [f"note       {note}" for note in text["notes"]]
    lines += [f"written    {path}" for path in outputs]
    return lines


def _ablation_table(text: dict[str, Any], method: str) -> list[str]:
    mine = [a for a in text.get("ablations", []) if a["method"] == method]
    if not mine:
        return []
    in_any_case = f"; it needs {MIN_VEHICLES} in any case" if method == EXACT else ""
    lines = ["", f"{method}: MAPE (used ratio) by score above, and at least so many vehicles{in_any_case}"]
    lines.append(f"{'':8s}" + "".join(f"{count:>16d}" for count in score.VEHICLE_COUNTS))
    for min_score in score.SCORES:
        row = [a for a in mine if a["min_score"] == min_score]
        cells = (f"{_percent(a['mape'])} ({100 * a['used_ratio']:.0f} %)" for a in row)
        lines.append(f"{min_score:<8g}" + "".join(f"{cell:>16s}" for cell in cells))
    return lines


def _sensitivity_table(text: dict[str, Any], method: str) -> list[str]:
    mine = [s for s in text.get("sensitivity", []) if s["method"] == method]
    if not mine:
        return []
    lines = ["", f"{method}: MAPE (bias) when the geometry is wrong"]
    for what, form in (("pitch_deg", "pitch {:+g} deg"), ("focal", "focal length {:+.0%}")):
        for s in (s for s in mine if s["wrong"] == what):
            lines.append(f"  {form.format(s['by']):22s}{_percent(s['mape']):>9s} ({_percent(s['bias'], '+')})")
    return lines


def _percent(value: float | None, sign: str = "") -> str:
    return "-" if value is None else f"{value:{sign}.1f} %"


def _line(*cells: Any) -> str:
    widths = (9, 14, 7, 6, 8, 9, 14, 8, 8, 8, 8)
    first = f"{cells[0]!s:<{widths[0]}}{cells[1]!s:<{widths[1]}}"
    return first + "".join(f"{cell!s:>{width}}" for cell, width in zip(cells[2:], widths[2:], strict=True))
