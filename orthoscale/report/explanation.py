"""A report's uncertainty in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ..core import uncertainty
from ..core.remarks import percent
from ..core.scale import PER_PIXEL

EXPLANATION_FORMAT = "orthoscale explain 1"


def explain(report: Mapping[str, Any]) -> dict[str, Any]:
    """The explanation that `core.uncertainty` gives of a report (`document`), with its scale, verdict and remarks."""
    scale, unit, used, fleet = (report[name] for name in ("scale", "unit", "vehicles_used", "fleet"))
    found = asdict(uncertainty.explain(report["uncertainty"], used, fleet, scale if unit == PER_PIXEL else 0.0))
    said = [remark["text"] for remark in report["remarks"]]
    told = {"format": EXPLANATION_FORMAT, "scale": scale, "unit": unit, "verdict": report["verdict"]}
    return {**told, **found, "remarks": said}


def in_words(explanation: Mapping[str, Any]) -> list[str]:
    """The explanation as lines of text."""
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
    return lines
