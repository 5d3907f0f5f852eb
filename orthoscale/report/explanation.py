"""In plain words: where the uncertainty of a scale comes from, and what would halve it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InputError
from ..formats.reading import reason

MEANINGS = {
    "sampling": "the sizes of vehicles scatter, and their number is limited",
    "fleet": "the mean size of the vehicles at that place is uncertain",
    "margin": "box bias: how much boxes over- or undershoot vehicles varies from scene to scene",
    "geometry": "the height of the ground under the vehicles, and up to what height boxes enclose them",
    "conflict": "measurements that contradict each other",
    "known distance": "the known distance itself",
    "ground control": "the control points themselves",
    "parking bays": "the width of parking bays at one place",
}
OF_AN_ANCHOR = "how well its size is known, and measured in the pictures"
WITHOUT_COUNTRY = ("WORLD", "auto")
COUNTRY_SHARE = (
    0.5  # a country's mean is known about twice as well as the world's (fleet table: 2 to 3 % against 5.6 %)
)
NOTABLE_SHARE = 0.05  # share of the variance below which a part is not worth a remedy


def explain(report: Mapping[str, Any]) -> dict[str, Any]:
    """From a report (`document`): the parts by their share of the variance, and remedies with what each would leave.

    Returns ``{"relative_sd", "parts": [{name, relative_sd, share, meaning}], "remedies": [{"do", "leaves"}], "halve"}``
    with one-sigmas relative to the scale; "halve" is the sentence that says what would halve the uncertainty.
    Raises InputError where that is not in it.
    """
    try:
        scale, unit = float(report["scale"]), str(report["unit"])
        parts = {str(name): float(sd) for name, sd in report["uncertainty"].items()}
        used, fleet = int(report["vehicles_used"]), str(report["fleet"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"not a report of orthoscale: {reason(error)}", "Give the report.json that `fix` wrote."
        ) from error
    variance = sum(sd**2 for sd in parts.values())
    if not (np.isfinite(variance) and variance > 0 and scale > 0):
        raise InputError("the report has no uncertainty to explain", "Give the report.json that `fix` wrote.")
    total = float(np.sqrt(variance))
    share = {name: sd**2 / variance for name, sd in parts.items()}

    # A measurement with sd s leaves 1 / sqrt(1 / total^2 + 1 / s^2); half of the total is left by total / sqrt(3).
    needed = total / np.sqrt(3)
    remedies: list[dict[str, Any]] = []

    def remedy(do: str, removed: float) -> None:
        remedies.append({"do": do, "leaves": float(np.sqrt(max(variance - removed, 0)))})

    if share.get("sampling", 0) > NOTABLE_SHARE:
        remedy(f"measure four times as many vehicles ({4 * used} instead of {used})", 0.75 * parts["sampling"] ** 2)
    if share.get("fleet", 0) > NOTABLE_SHARE and fleet in WITHOUT_COUNTRY:
        remedy("name the country (--fleet)", (1 - COUNTRY_SHARE**2) * parts["fleet"] ** 2)
    if share.get("margin", 0) > NOTABLE_SHARE:
        remedy("use a detector with half the box bias", 0.75 * parts["margin"] ** 2)
    if share.get("geometry", 0) > NOTABLE_SHARE:
        remedy("use steeper views, or more ground points under the vehicles", 0.75 * parts["geometry"] ** 2)
    remedies.sort(key=lambda r: r["leaves"])
    best = [r["do"] for r in remedies if r["leaves"] <= total / 2]
    across = f"20 m known to {100 * 20 * needed:.0f} cm"
    halve = f"A known distance good to {100 * needed:.1f} % would halve it ({across}: --known-distance)"
    halve += f"; so would this alone: {'; '.join(best)}." if best else "; nothing below would do so alone."
    if "conflict" in parts:
        remedies, halve = (
            [],
            "First find out which measurement is wrong: more of them do not help while two contradict each other.",
        )
    return {
        "scale": scale,
        "unit": unit,
        "verdict": str(report.get("verdict", "")),
        "relative_sd": total,
        "parts": [
            {
                "name": n,
                "relative_sd": parts[n],
                "share": share[n],
                "meaning": MEANINGS.get(n, f"{n}: {OF_AN_ANCHOR}"),
            }
            for n in sorted(parts, key=lambda n: -parts[n])
            if parts[n] > 0
        ],
        "remedies": remedies,
        "halve": halve,
        "remarks": [str(r) for r in report.get("remarks", [])],
    }


def in_words(explanation: Mapping[str, Any]) -> str:
    """The explanation as a person reads it."""
    e = explanation
    lines = [
        f"The scale is {e['scale']:.5g} {e['unit']}, known to +- {100 * e['relative_sd']:.1f} % (1 sigma).",
        "",
        "Where that comes from, as shares of the variance:",
        *(
            f"  {100 * p['share']:3.0f} %  {p['name']} ({100 * p['relative_sd']:.1f} %): {p['meaning']}"
            for p in e["parts"]
        ),
        "",
        e["halve"],
    ]
    if e["remedies"]:
        lines += ["", "What else would help, and the uncertainty (1 sigma) that it would leave:"]
        lines += [f"  {100 * r['leaves']:.1f} %  {r['do']}" for r in e["remedies"]]
    if e["remarks"]:
        lines += ["", "Noted in the report:", *(f"  {remark}" for remark in e["remarks"])]
    return "\n".join(lines)
