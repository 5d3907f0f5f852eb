"""What a person should make of a report: the answer in words, and the checks that speak for or against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, log
from typing import Any

from ..core.pooling.posterior import Z90
from ..core.scale import decimals
from ..core.verdicts import CHECK_LIMIT
from .document import of_plan
from .explanation import explain
from .places import frames, trend

FIT = {  # verdict: what the scale is fit for
    "good": "Suitable for metric layouts and checks.",
    "fair": "Suitable where this tolerance is acceptable.",
    "poor": "Suitable for a rough idea only.",
    "unusable": "Not suitable for use.",
}
SAMPLING = 0.02  # one sigma from which more vehicles would help
ROUGH = 0.06  # relative difference from which no tick is given, however little is known
MANY_REJECTED = 0.5  # share of the vehicles from which one wonders what the detector found
MODES_NOISE = 0.03  # relative difference between the planar and the oblique measurement that is put down to noise


@dataclass(frozen=True)
class Check:
    """state : 'ok', 'look' (a person should), or 'none' (says neither). what : in short. detail : the figures."""

    state: str
    what: str
    detail: str


def half_width(report: Mapping[str, Any]) -> float:
    """Half of the 90 % interval, relative to the scale."""
    low, high = report["interval90"]
    return (high - low) / 2 / report["scale"]


def quantity(report: Mapping[str, Any], *values: float) -> tuple[list[str], str]:
    """`values` with as many digits as the scale deserves (two of its uncertainty), and their unit for people."""
    unit = {"m/model-unit": "m per model unit"}.get(report["unit"], report["unit"])
    factor = 1.0
    if of_plan(report) and report["scale"] < 1:
        factor, unit = 100.0, "cm/px"
    uncertainty = half_width(report) * report["scale"] * factor
    places = decimals(uncertainty)
    return [f"{value * factor:.{places}f}" for value in values], unit


def relative(scale: float, report: Mapping[str, Any]) -> float:
    """How much larger `scale` is than the answer: 0.02 is 2 %."""
    return scale / report["scale"] - 1


def checks(report: Mapping[str, Any]) -> list[Check]:
    """What speaks for the scale, or against it: first what a person should look at, then in the order of asking."""
    made = [_vehicles, _shapes, _modes, _evidence, _claim, _places, _frames, _largest]
    # What a model's drift has to say, the checks of places and frames say.
    told = {*report["notes"], *(report.get("drift") or {}).get("remarks", [])}
    remarks = [remark for remark in report["remarks"] if remark not in told]
    found = [check for make in made if (check := make(report))] + [
        Check("look", "Remark", remark) for remark in remarks
    ]
    return sorted(found, key=lambda check: ("look", "ok", "none").index(check.state))


def _vehicles(report: Mapping[str, Any]) -> Check:
    used, rejected = report["vehicles_used"], sum(report["vehicles_rejected"].values())
    if not used:
        return Check("look", "No vehicles", "the scale rests on things of standard size alone")
    sampling = report["uncertainty"].get("sampling", 0.0)
    few, many = sampling > SAMPLING, rejected > MANY_REJECTED * (used + rejected)
    what = "Few vehicles" if few else "Many rejected" if many else "Enough vehicles"
    detail = f"{used} used, {rejected} rejected; sampling error {percent(sampling)}"
    return Check("look" if few or many else "ok", what, detail)


def _shapes(report: Mapping[str, Any]) -> Check | None:
    check = report["checks"]
    if "length" not in check:
        return None  # no vehicles
    difference, tension = check["length"] / check["width"] - 1, check["tension_sigmas"]
    ok = tension <= CHECK_LIMIT
    what = "Lengths and widths agree" if ok else "Lengths and widths disagree"
    return Check("ok" if ok else "look", what, f"lengths give {signed(difference)} ({tension:.1f} sigma)")


def _places(report: Mapping[str, Any]) -> Check | None:
    found = trend(report)
    if found is None and not of_plan(report) and not report.get("drift"):
        return None  # nobody compared them
    if found is None:
        return Check("none", "Places not compared", "too few vehicles for it")
    known = "" if found.sd is None else f" ± {100 * Z90 * found.sd:.1f}"
    figures = f"{100 * found.change:.1f}{known} % from side to side"
    if found.drifts is None:
        return Check("none", "Places compared", figures)
    if found.drifts:
        return Check("look", "The scale drifts", figures + ", significant")
    if found.change > max(half_width(report), ROUGH):
        return Check("none", "Drift neither found nor excluded", figures)
    return Check("ok", "No drift", figures + ", not significant")


def _frames(report: Mapping[str, Any]) -> Check | None:
    found = frames(report)
    if not found:
        return None
    odd = sorted((frame for frame in found if frame.odd), key=lambda frame: -abs(frame.deviation))
    if not odd:
        return Check("ok", "Frames agree", f"{len(found)} frames agree about the same vehicles")
    what = f"{len(odd)} of {len(found)} frames {'stands' if len(odd) == 1 else 'stand'} out"
    named = ", ".join(f"{frame.name} ({signed(exp(frame.deviation) - 1)})" for frame in odd[:3])
    return Check("look", what, named + ", …" * (len(odd) > 3))


def _claim(report: Mapping[str, Any]) -> Check | None:
    claim = report.get("claim")
    if not claim:
        return None
    states = {"agrees": ("ok", "Own georeferencing agrees"), "doubtful": ("look", "Own georeferencing is doubtful")}
    state, what = states.get(claim["verdict"], ("look", "Own georeferencing disagrees"))
    if not claim["believed"]:
        return None
    guess = "".join(f"; perhaps {why}" for why in claim["guesses"])
    return Check(state, what, f"vehicles give {signed(claim['ratio'] - 1)} ({claim['sigmas']:.1f} sigma){guess}")


def _modes(report: Mapping[str, Any]) -> Check | None:
    modes = report.get("modes") or {}
    if not (modes.get("planar") and modes.get("oblique")):
        return None
    difference = modes["oblique"]["scale"] / modes["planar"]["scale"] - 1
    agreement = report.get("agreement")
    ok = abs(difference) <= MODES_NOISE if agreement is None else not agreement["contradicts"]
    what = "Planar and oblique agree" if ok else "Planar and oblique disagree"
    sigmas = "" if agreement is None else f" ({agreement['sigmas']:.1f} sigma)"
    return Check("ok" if ok else "look", what, f"oblique frames give {signed(difference)}{sigmas}")


def _evidence(report: Mapping[str, Any]) -> Check | None:
    others = report.get("evidence")
    if not others:
        return None
    kinds = ", ".join(f"{e['kind']} gives {signed(relative(e['scale'], report))}" for e in others)
    conflict = report["checks"].get("conflict_sigmas", 0.0)
    if conflict:
        return Check("look", "Other evidence contradicts", f"{kinds} ({conflict:.1f} sigma)")
    if max(abs(relative(e["scale"], report)) for e in others) > max(half_width(report), ROUGH):
        return Check("none", "Other evidence differs within its uncertainty", kinds)
    return Check("ok", "Other evidence agrees", kinds)


def narrowed(report: Mapping[str, Any]) -> str:
    """What anchors did to the interval, in words."""
    before = report.get("without_anchors")
    if not before:
        return "the scale rests on them"
    low, high = before["interval90"]
    change = signed(report["scale"] / before["scale"] - 1)
    half = percent((high - low) / 2 / before["scale"])
    return f"90 % interval ± {percent(half_width(report))} with, ± {half} without; the scale moved by {change}"


def _largest(report: Mapping[str, Any]) -> Check:
    explained = explain(report)
    part = explained["parts"][0]
    share = f"{100 * part['relative_sd']:.1f} of {percent(explained['relative_sd'])} (1 sigma)"
    return Check("none", f"Largest uncertainty: {part['name']}", f"{share}: {part['meaning']}")


def metres_of(report: Mapping[str, Any], length: float = 10.0) -> str:
    """What the interval means for a length of so many metres in the copy."""
    half = log(report["interval90"][1] / report["interval90"][0]) / 2
    return f"{length:g} m in the copy are {length * exp(-half):.1f} to {length * exp(half):.1f} m on the ground"


def percent(value: float) -> str:
    """A share with one decimal: 0.0123 is ``1.2 %``."""
    return f"{100 * value:.1f} %"


def signed(value: float) -> str:
    """As `percent`, with its sign; a true minus, as it is printed."""
    return f"{100 * value:+.1f} %".replace("-", "−")
