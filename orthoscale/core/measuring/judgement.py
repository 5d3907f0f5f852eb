"""The checks for and against a scale: all that a report shows are made here, with their severity."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from ..claims import Comparison
from ..remarks import CAUTION, INFO, ON_PLACES, REFUSAL, SUPPORT, Judgement, Remark, by_severity, percent, signed
from ..scale import Scale
from ..uncertainty import explain
from ..verdicts import CHECK_LIMIT, SHAPE_LIMIT
from .measurement import Measurement
from .model_drift import ModelDrift
from .squeeze import SQUEEZE

SAMPLING = 0.02  # sampling uncertainty (one sigma) above which more vehicles would help
ROUGH = 0.06  # relative difference above which no check supports a scale, however uncertain that is
MANY_REJECTED = 0.5  # share of rejected vehicles above which the detections are doubtful
ODD_NAMED = 3  # how many of the odd frames are named
CLAIMS = {  # verdict of a claim
    "agrees": (SUPPORT, "Own georeferencing agrees"),
    "doubtful": (CAUTION, "Own georeferencing is doubtful"),
    "disagrees": (CAUTION, "Own georeferencing disagrees"),
}


def judgements(
    measured: Measurement, claim: Comparison | None = None, remarks: Iterable[Remark] | None = None
) -> tuple[Judgement, ...]:
    """The checks of the scale of `measured`, the most serious first.

    claim : comparison with the scale that the source claims. remarks : all remarks; by default those of `measured`.
    """
    made = (_vehicles, _shapes, _modes, _evidence, _places, _frames, _parts)
    found = [*(check for make in made if (check := make(measured)) is not None), *_claim(claim)]
    remarks = measured.remarks if remarks is None else remarks
    said = [r for r in remarks if r.severity in (REFUSAL, CAUTION) and not r.check]
    return by_severity([*found, *_largest(measured), *(Judgement(r.severity, "Remark", r.text) for r in said)])


def _small(scale: Scale) -> float:
    """Relative difference up to which a check supports `scale`. In a conflict the interval spans what contradicts, and
    is no measure of what the vehicles can tell."""
    return ROUGH if scale.conflict else max(scale.half_width, ROUGH)


def _vehicles(measured: Measurement) -> Judgement:
    scale = measured.scale
    used, rejected = scale.vehicles_used, sum(scale.rejected.values())
    if not used:
        return Judgement(CAUTION, "No vehicles", "the scale rests on objects of standard size alone")
    sampling = scale.parts.get("sampling")  # missing where measurements contradict each other
    few, many = (sampling or 0.0) > SAMPLING, rejected > MANY_REJECTED * (used + rejected)
    what = "Few vehicles" if few else "Many rejected" if many else "Enough vehicles"
    known = "" if sampling is None else f"; sampling error {percent(sampling)} (1 sigma)"
    severity = CAUTION if few or many else INFO if sampling is None else SUPPORT
    return Judgement(severity, what, f"{used} used, {rejected} rejected{known}")


def _shapes(measured: Measurement) -> Judgement | None:
    scale = measured.scale
    if "length" not in scale.checks:
        return None  # no vehicles
    difference = scale.checks["length"] / scale.checks["width"] - 1
    detail = f"lengths give {signed(difference)} against widths ({scale.tension:.1f} sigma)"
    if scale.tension > CHECK_LIMIT:
        severity = REFUSAL if scale.tension > SHAPE_LIMIT else CAUTION
        return Judgement(severity, "Lengths and widths disagree", detail)
    if abs(difference) > _small(scale):
        return Judgement(INFO, "Lengths and widths differ within their uncertainty", detail)
    if SQUEEZE in scale.parts:  # both are wrong, in opposite directions along x and along y
        return Judgement(INFO, "Lengths and widths agree only on average over all directions", detail)
    return Judgement(SUPPORT, "Lengths and widths agree", detail)


def _modes(measured: Measurement) -> Judgement | None:
    agreement = measured.agreement
    if agreement is None:
        return None
    (first, a), (second, b) = agreement.scales.items()
    what = f"{second.capitalize()} and {first} {'disagree' if agreement.contradicts else 'agree'}"
    # The same sign convention as in the agreement's own sentence, which is among the remarks.
    by_common = math.expm1(agreement.difference)
    common = f", {signed(by_common)} by the {agreement.common} vehicles of both" if agreement.common else ""
    detail = f"{second} gives {signed(b.value / a.value - 1)}{common} ({agreement.tension:.1f} sigma)"
    return Judgement(agreement.remark.severity if agreement.contradicts else SUPPORT, what, detail)


def _evidence(measured: Measurement) -> Judgement | None:
    scale = measured.scale
    if scale.support.conflicts:
        return Judgement(REFUSAL, "Other evidence contradicts", "; ".join(scale.support.conflicts))
    if not (compared := scale.support.compared):
        return None
    kinds = ", ".join(f"{one.kind} {signed(one.difference)} ({one.sigmas:.1f} sigma)" for one in compared)
    detail = f"against everything else: {kinds}"
    if any(one.doubtful for one in compared):
        return Judgement(CAUTION, "Other evidence is doubtful", detail)
    if max(abs(one.difference) for one in compared) > _small(scale):
        return Judgement(INFO, "Other evidence differs within its uncertainty", detail)
    return Judgement(SUPPORT, "Other evidence agrees", detail)


def _claim(claim: Comparison | None) -> Iterator[Judgement]:
    if claim is not None and claim.believed:
        severity, what = CLAIMS[claim.verdict]
        guess = "".join(f"; perhaps {why}" for why in claim.guesses)
        yield Judgement(severity, what, f"{claim.by} give {signed(claim.ratio - 1)} ({claim.sigmas:.1f} sigma){guess}")


def _places(measured: Measurement) -> Judgement | None:
    drift = measured.drift
    if drift is None and measured.modes:
        return None  # the planar measurement compares no places
    if drift is None or drift.trend is None:
        return Judgement(INFO, "Places not compared", "too few vehicles")
    if drift.drifts:
        refused = any(r.severity == REFUSAL and r.check == ON_PLACES for r in measured.remarks)
        return Judgement(REFUSAL if refused else CAUTION, "The scale drifts", f"{drift.trend.figures}, significant")
    if drift.trend.tilt > _small(measured.scale):
        return Judgement(INFO, "Drift neither found nor excluded", drift.trend.figures)
    return Judgement(SUPPORT, "No drift", f"{drift.trend.figures}, not significant")


def _frames(measured: Measurement) -> Judgement | None:
    drift = measured.drift
    if not isinstance(drift, ModelDrift) or not drift.frames:
        return None
    if not drift.odd:
        return Judgement(SUPPORT, "Frames agree", f"{len(drift.frames)} frames agree about the same vehicles")
    what = f"{len(drift.odd)} of {len(drift.frames)} frames {'stands' if len(drift.odd) == 1 else 'stand'} out"
    named = ", ".join(f"{name} ({signed(stray)})" for name, stray in drift.odd[:ODD_NAMED])
    return Judgement(CAUTION, what, named + ", …" * (len(drift.odd) > ODD_NAMED))


def _largest(measured: Measurement) -> Iterator[Judgement]:
    scale = measured.scale
    if scale.relative_sd > 0:
        part = explain(scale.parts, scale.vehicles_used, scale.fleet).parts[0]
        share = f"{100 * part.relative_sd:.1f} of {percent(scale.relative_sd)} (1 sigma)"
        yield Judgement(INFO, f"Largest uncertainty: {part.name}", f"{share}: {part.meaning}")


def _parts(measured: Measurement) -> Judgement | None:
    parts = measured.parts
    if parts is None or len(parts.known) < 2:
        return None
    if parts.contradict:
        return Judgement(REFUSAL, "Parts have different scales", parts.said)
    if parts.difference > _small(measured.scale):
        return Judgement(INFO, "Parts differ within their uncertainty", parts.said)
    return Judgement(SUPPORT, "Parts that share no point agree", parts.said)
