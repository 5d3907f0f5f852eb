"""Formats the figures of a report as text, with suitable digits and units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from ..core.boxes import KINDS
from ..core.remarks import signed
from ..core.scale import decimals, interval_about
from .stored import of_plan

FLEETS_NAMED = 5  # number of likely fleets that are named
EXAMPLE_LENGTH = 10.0  # [m] in the copy, of which it is told what it may be on the ground


def counted(numbers: Mapping[str, int]) -> str:
    """How many there are of each thing: "6 low confidence, 2 too large for a car"; '' if there are none."""
    return ", ".join(f"{number} {thing}" for thing, number in numbers.items())


def counted_kinds(kinds: Iterable[str]) -> str:
    """How many vehicles are of each of `kinds`, as in `core.measuring.vehicles.VEHICLE`: "81 cars, 5 pickups, 30 of
    unknown kind"; '' where none is known."""
    number = Counter(kinds)
    told = {f"{k}{'' if k == 'larger' or number[k] == 1 else 's'}": number[k] for k in KINDS if number[k]}
    return counted(told | ({"of unknown kind": number[""]} if number[""] else {})) if told else ""


def likely_fleets(fleets: Mapping[str, float]) -> str:
    """The likeliest of `fleets` with their probabilities, given by code; '' if there was no choice."""
    likely = sorted(fleets.items(), key=lambda item: -item[1])[:FLEETS_NAMED] if len(fleets) > 1 else []
    return ", ".join(f"{code} {100 * probability:.0f} %" for code, probability in likely)


def within(report: Mapping[str, Any]) -> str:
    """The 90 % interval about the scale: "± 1.4 %", or "−2.2 to +3.0 %"."""
    text = interval_about(report["scale"], *report["interval90"])
    return text.replace("+-", "± ") if text.startswith("+-") else text.replace("-", "−")


def quantity(report: Mapping[str, Any], *values: float) -> tuple[list[str], str]:
    """`values` with the digits that the scale's uncertainty justifies (two of its own), and their unit for people."""
    unit = {"m/model-unit": "m per model unit"}.get(report["unit"], report["unit"])
    factor = 1.0
    if of_plan(report) and report["scale"] < 1:
        factor, unit = 100.0, "cm/px"
    low, high = report["interval90"]
    places = decimals((high - low) / 2 * factor)
    return [f"{value * factor:.{places}f}" for value in values], unit


def relative(scale: float, report: Mapping[str, Any]) -> float:
    """The relative difference of `scale` from the answer: 0.02 is 2 % larger."""
    return scale / report["scale"] - 1


def metres_of(report: Mapping[str, Any]) -> str:
    """What the interval means for lengths in the copy, as a sentence."""
    low, high = (EXAMPLE_LENGTH * end / report["scale"] for end in report["interval90"])
    places = min(max(decimals((high - low) / 2) - 1, 1), 3)
    return f"{EXAMPLE_LENGTH:g} m in the copy are {low:.{places}f} to {high:.{places}f} m on the ground"


def narrowed(report: Mapping[str, Any]) -> str:
    """The effect of anchors on the interval and on the scale, in words."""
    before = report.get("without_anchors")
    if not before:
        return "the scale rests on them"
    moved = signed(report["scale"] / before["scale"] - 1)
    return f"90 % interval {within(report)} with, {within(before)} without; the scale moved by {moved}"
