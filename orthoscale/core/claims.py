"""A claimed scale compared with the scale from vehicles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .normal import Z90
from .remarks import INFO, Remark
from .scale import PER_PIXEL, Scale
from .source import Source
from .verdicts import UNUSABLE

NO_CLOSER = 1e-9  # least relative one sigma of a scale: that of identical boxes would be zero
CLEAR = 3.0  # sigmas from which a disagreement is not due to chance
NO_UNIT = "has no unit"  # verdict on a claim in metres, feet or anything else: it is never held against an input
METRIC = 1.0  # [m per unit] of a model whose coordinates are metres
# A remark is made if the unit of a model differs from a metre by no more than this (log). Models aligned with the
# positions of a single receiver are metric within some per cent. If arbitrary units are spread evenly over two decades,
# one model in twenty-three has such a unit by chance. A judgement.
NEARLY_METRIC = 0.1
BY_ORTHOSCALE = "orthoscale wrote it"  # why a copy of a model by `fix` counts as metric
NO_PROOF = "orthoscale gave it its scale: agreement with vehicles does not confirm it"
OF_A_COPY = "agrees (orthoscale gave it)"  # verdict on such a claim, where there is no room for that sentence
NOT_TOLD = "nothing says that its coordinates are metres"  # of a reconstruction
UNITS = {"metres": 1.0, "feet": 0.3048}  # [m] units with which a claim without a unit is compared
# Factors (truth over claim) and the mistakes that cause them. A ratio close to one of them is a hint, no proof.
UNIT_MISTAKES = (
    (0.3048, "feet were taken for metres"),
    (1 / 0.3048, "metres were taken for feet"),
)
MISTAKES = (
    *UNIT_MISTAKES,
    (2.0, "the image was halved and its georeferencing was not"),
    (4.0, "the image was halved twice and its georeferencing was not"),
    (0.5, "the image was enlarged and its georeferencing was not"),
    (10.0, "a decimal point is off by one place"),
    (0.1, "a decimal point is off by one place"),
)


@dataclass(frozen=True)
class Comparison:
    """A claimed scale against a recovered one, in the same unit.

    claimed_by : what claims it, for people. claimed, recovered : metres per unit. sd : relative one sigma of the
    recovered scale (and of the claim, where it has one), on the claim's side of it. by : what recovered it. believed :
    False if nothing in the claim ties it to the ground. why : where the claim comes from. useful : False if the
    recovered scale is too uncertain to use, and so to contradict anything: its boxes may not be vehicles. unit_known
    : False if nothing says in what unit `claimed` is. unit : of both scales. mistakes : those that this claim invites,
    besides MISTAKES.
    """

    claimed_by: str
    claimed: float
    recovered: float
    sd: float
    believed: bool = True
    why: str = ""
    by: str = "vehicles"
    useful: bool = True
    unit_known: bool = True
    unit: str = PER_PIXEL
    mistakes: Sequence[tuple[float, str]] = ()

    @property
    def ratio(self) -> float:
        """Recovered over claimed."""
        return self.recovered / self.claimed

    @property
    def sigmas(self) -> float:
        """How many sigmas the two scales lie apart."""
        return abs(math.log(self.ratio)) / self.sd

    @property
    def verdict(self) -> str:
        """``agrees`` (within the 90 % interval), ``disagrees`` (beyond three sigmas of a useful scale), else
        ``doubtful``; NO_UNIT where the claim's unit is not known."""
        if not self.unit_known:
            return NO_UNIT
        if self.sigmas <= Z90:
            return "agrees"
        return "disagrees" if self.sigmas > CLEAR and self.useful else "doubtful"

    @property
    def guesses(self) -> list[str]:
        """Mistakes that would explain a disagreement."""
        if self.verdict in ("agrees", NO_UNIT):
            return []
        mistakes = (*self.mistakes, *(MISTAKES if self.unit == PER_PIXEL else UNIT_MISTAKES))
        return [why for factor, why in mistakes if abs(math.log(self.ratio / factor)) <= Z90 * self.sd]

    def document(self) -> dict[str, Any]:
        """Plain values for a report."""
        return {
            "claimed_by": self.claimed_by,
            "claimed": self.claimed,
            "recovered": self.recovered,
            "ratio": self.ratio,
            "sigmas": self.sigmas,
            "verdict": self.verdict,
            "believed": self.believed,
            "why": self.why,
            "guesses": self.guesses,
        }

    def sentence(self) -> str:
        """One line for a person."""
        if not self.unit_known:
            figures = f"{self.by} give {self.recovered:.4g} {self.unit}, {self.claimed_by} {self.claimed:.4g}"
            return f"{self.verdict}, for information only: {figures}, which {self._fits()}"
        percent = f"{abs(100 * (self.ratio - 1)):.1f} %"
        apart = "the same as" if percent == "0.0 %" else f"{percent} {'more' if self.ratio > 1 else 'less'} than"
        text = (
            f"{self.verdict}: {self.by} give {self.recovered:.4g} {self.unit}, {apart} "
            f"the {self.claimed:.4g} that {self.claimed_by} ({self.sigmas:.1f} sigma)"
        )
        return text + "".join(f"; perhaps {guess}" for guess in self.guesses)

    def stated(self) -> str:
        """What is claimed, and where that comes from."""
        return figure(self.claimed, self.unit_known, self.why, self.unit)

    def _fits(self) -> str:
        """Whether the claim would agree if it were in one of UNITS."""
        off = {name: abs(math.log(self.ratio / metres)) / self.sd for name, metres in UNITS.items()}
        told = {name: f"{name} ({sigmas:.1f} sigma)" for name, sigmas in off.items()}
        fitting = [told[name] for name, sigmas in off.items() if sigmas <= Z90]
        return f"fits {' and '.join(fitting)}" if fitting else f"fits neither {' nor '.join(told.values())}"


def figure(claimed: float, unit_known: bool, why: str, unit: str = PER_PIXEL) -> str:
    """A claimed scale [`unit` if `unit_known`, else per pixel] and `why` it is that, in words."""
    return f"{claimed:.5g} {unit if unit_known else 'per pixel'}: {why}"


def own_claim(source: Source, scale: Scale) -> Comparison | None:
    """The scale that the source claims, compared with `scale`; None where it claims none, and where
    `scale` contradicts itself."""
    claimed = source.claimed
    if claimed is None or claimed.gsd_m is None or scale.conflict:
        return None
    return Comparison(
        "its georeferencing claims",
        claimed.gsd_m,
        scale.value,
        _sd_towards(claimed.gsd_m, scale),
        claimed.usable,
        claimed.why,
        _known_by(scale),
        scale.verdict != UNUSABLE,
        claimed.unit_known,
        mistakes=claimed.mistakes,
    )


def metric_claim(source: Source, scale: Scale) -> Comparison | None:
    """The claim of one metre per unit, compared with `scale`, if a reconstruction counts as metric or its unit is
    nearly a metre; None for others, and where `scale` contradicts itself."""
    if source.posed is None or scale.conflict:
        return None
    why = source.metric_already
    if not why and abs(math.log(scale.value / METRIC)) > NEARLY_METRIC:
        return None
    return Comparison(
        "its coordinates claim" if why else "metres would have",
        METRIC,
        scale.value,
        _sd_towards(METRIC, scale),
        believed=bool(why),
        why=metric_reason(why) if why else f"{NOT_TOLD}, but its unit is nearly one",
        by=_known_by(scale),
        useful=scale.verdict != UNUSABLE,
        unit=scale.unit,
    )


def perhaps_metric(source: Source, scale: Scale) -> tuple[Remark, ...]:
    """A note on a reconstruction that does not count as metric, but whose unit is nearly a metre; () for others.

    It may have been aligned with positions that are not in its frames' tags, or that are so noisy that they give
    another scale.
    """
    claim = metric_claim(source, scale)
    if claim is None or claim.believed or not claim.useful:
        return ()
    text = (
        f"the model seems to be in metres already, aligned with GPS for instance: {claim.by} give "
        f"{scale.value:.3f} m per unit, {claim.sigmas:.1f} sigma from 1; a copy is still scaled by {scale.value:.3f}"
    )
    return (Remark(INFO, text),)


def verdict_on(source: Source, verdict: str) -> str:
    """The `verdict` of a `Comparison` on the claim of `source`, which says so where agreement proves nothing."""
    return OF_A_COPY if verdict == "agrees" and source.by_orthoscale else verdict


def metric_reason(metric_already: str) -> str:
    """Why a reconstruction claims a metre per unit, by its `Source.metric_already`."""
    return f"its coordinates are metres: {metric_already}"


def _sd_towards(claimed: float, scale: Scale) -> float:
    """Relative one sigma of `scale` on the side where the `claimed` scale lies."""
    low, high = scale.interval90  # may be asymmetric, and not even positive with the paper's estimator
    end = high if claimed > scale.value else low
    sd = abs(math.log(end / scale.value)) / Z90 if end > 0 else scale.relative_sd
    return max(sd, NO_CLOSER)


def _known_by(scale: Scale) -> str:
    """What `scale` rests on, for people."""
    by = ["vehicles"] if scale.vehicles_used else []
    by += dict.fromkeys(e.kind for e in scale.evidence if e.kind in scale.parts)
    *most, last = by or [""]
    return f"{', '.join(most)} and {last}" if most else last
