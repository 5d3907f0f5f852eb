"""A report's uncertainty in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ..core import uncertainty
from ..core.remarks import percent
from ..core.scale import PER_PIXEL
from ..errors import InputError
from ..formats.reading import reason

REPORT_WANTED = "Give the report.json that `fix` wrote."


def explain(report: Mapping[str, Any]) -> dict[str, Any]:
    """The explanation that `core.uncertainty` gives of a report (`document`), with its scale, verdict and remarks.

    Raises InputError if the report lacks what it needs.
    """
    try:
        scale, unit = float(report["scale"]), str(report["unit"])
        parts = {str(name): float(sd) for name, sd in report["uncertainty"].items()}
        used, fleet = int(report["vehicles_used"]), str(report["fleet"])
        said = [str(remark["text"]) for remark in report.get("remarks", [])]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"not a report of orthoscale: {reason(error)}", REPORT_WANTED) from error
    try:
        found = asdict(uncertainty.explain(parts, used, fleet, scale if unit == PER_PIXEL else 0.0))
    except ValueError as error:
        raise InputError(f"the report cannot be used here: {error}", REPORT_WANTED) from error
    return {"scale": scale, "unit": unit, "verdict": str(report.get("verdict", "")), **found, "remarks": said}


def in_words(explanation: Mapping[str, Any]) -> str:
    """The explanation as text."""
    e = explanation
    lines = [
        f"The scale is {e['scale']:.5g} {e['unit']}, known to +- {percent(e['relative_sd'])} (1 sigma).",
        "",
        "Where that comes from, as shares of the variance:",
        *(
            f"  {100 * p['share']:3.0f} %  {p['name']} ({percent(p['relative_sd'])}): {p['meaning']}"
            for p in e["parts"]
        ),
        "",
        e["halve"],
    ]
    if e["remedies"]:
        lines += ["", "What else would help, and the uncertainty (1 sigma) that it would leave:"]
        lines += [f"  {percent(r['leaves'])}  {r['do']}" for r in e["remedies"]]
    if e["remarks"]:
        lines += ["", "Noted in the report:", *(f"  {remark}" for remark in e["remarks"])]
    return "\n".join(lines)
