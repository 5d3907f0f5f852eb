"""A scale, its interval, and the parts of its uncertainty."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .brief import Brief
from .by_value import ByValue
from .evidence import Evidence, Support
from .normal import Z90
from .remarks import Remark, by_severity
from .verdicts import CHECK_LIMIT, UNUSABLE, verdict, worst

PER_PIXEL = "m/px"  # the unit of a plan's scale: its ground sampling distance


def decimals(uncertainty: float) -> int:
    """Number of decimal places that shows two digits of the uncertainty; 6 for an exact figure."""
    return max(0, 1 - int(np.floor(np.log10(uncertainty)))) if uncertainty > 0 else 6


def with_interval(value: float, low: float, high: float, unit: str) -> str:
    """A value with its 90 % interval, for people: with no more digits than its uncertainty justifies."""
    places = decimals((high - low) / 2)
    return f"{value:.{places}f} {unit} (90 %: {low:.{places}f} to {high:.{places}f})"


@dataclass(frozen=True, eq=False, repr=False)
class Scale(ByValue, Brief):
    """Metres per unit of the source, and how well that is known.

    value : metres per pixel of an orthophoto, or per unit of a model.
    interval90 : (low, high), contains the truth nine times in ten; not always symmetric.
    parts : relative one-sigma of each source of uncertainty, by its name: one of `uncertainty.MEANINGS`, or a kind of
        anchors.
    by_vehicles : `parts` by the vehicles alone, before other evidence; empty where these are the same.
    checks : the scale from lengths alone, from widths alone and, where these differ, from length minus width
        (free of a symmetric margin).
    weights : of lengths and widths in the scale by the vehicles; they sum to 1.
    tension : sigmas between the scale from lengths and that from widths.
    conflict : sigmas between the two measurements (vehicles, evidence) that contradict each other most, 0 if none do.
    larger_share : share of larger vehicles (vans, pickups beyond the fleet's own) among the vehicles.
    fleets : probability of each candidate fleet that is at all likely; one entry if there are no candidates.
    evidence : the measurements besides the vehicles. support : how far they support the scale.
    remarks : what speaks against it, limits it or was found on the way.
    used : (N,) bool, votes that count. reasons : (N,) why the others do not ('' where used).
    """

    value: float
    unit: str
    interval90: tuple[float, float]
    parts: dict[str, float]
    checks: dict[str, float]
    weights: tuple[float, float]
    tension: float
    fleet: str
    verdict: str
    used: np.ndarray = field(repr=False)
    reasons: list[str] = field(repr=False)
    remarks: tuple[Remark, ...] = ()
    larger_share: float = 0.0
    fleets: Mapping[str, float] = field(default_factory=dict)
    evidence: tuple[Evidence, ...] = ()
    conflict: float = 0.0
    support: Support = Support()
    by_vehicles: Mapping[str, float] = field(default_factory=dict)

    def answer(self) -> list[tuple[str, str]]:
        """The scale in words, as lines of label and text, in ASCII, which every terminal can show."""
        within = f"{self.verdict} (90 % within {self.within})"
        return [("scale", f"{self.text()}  {within}"), ("90 %", self.text(*self.interval90))]

    def brief(self) -> list[tuple[str, str]]:
        """The lines that printing it shows: label and text."""
        rejected = sum(self.rejected.values())
        return [*self.answer(), ("vehicles", f"{self.vehicles_used} used, {rejected} rejected")]

    def document(self) -> dict[str, Any]:
        """What lists of results show of it, as JSON values."""
        return {
            "scale": self.value,
            "unit": self.unit,
            "interval90": list(self.interval90),
            "verdict": self.verdict,
            "vehicles_used": self.vehicles_used,
        }

    @property
    def relative_sd(self) -> float:
        """One sigma of the value as a share of it: all parts together, taken as independent."""
        return float(np.sqrt(sum(sd**2 for sd in self.parts.values())))

    @property
    def within(self) -> str:
        """The 90 % interval about the value, for people: see `interval_about`."""
        return interval_about(self.value, *self.interval90)

    @property
    def half_width(self) -> float:
        """Half of the 90 % interval, relative to the value."""
        low, high = self.interval90
        return (high - low) / 2 / self.value

    def with_parts(self, parts: dict[str, float]) -> Scale:
        """The same value with other `parts` of its uncertainty: the interval becomes wider or narrower accordingly, the
        verdict never better than before."""
        changed = replace(self, parts=parts)
        now = changed.relative_sd
        judged, doubted = self.support.judged(now), self.support.doubted
        word = worst(self.verdict, verdict(judged, self.tension > CHECK_LIMIT, self.conflict > 0, doubted))
        return replace(changed, interval90=self.interval_of(self.value, now), verdict=word)

    def interval_of(self, value: float, sd: float) -> tuple[float, float]:
        """The 90 % interval of a `value` derived from the scale, with relative one-sigma `sd`: as skewed as the scale's
        own."""
        if not self.relative_sd:
            return float(value * np.exp(-Z90 * sd)), float(value * np.exp(Z90 * sd))
        low, high = (value * (end / self.value) ** (sd / self.relative_sd) for end in self.interval90)
        return float(low), float(high)

    def remarked(self, *remarks: Remark, at_best: str | None = None) -> Scale:
        """The same with these `remarks` added, and a verdict no better than `at_best`."""
        word = self.verdict if at_best is None else worst(self.verdict, at_best)
        return replace(self, verdict=word, remarks=by_severity((*self.remarks, *remarks)))

    def contradicted_by(self, others: Sequence[Scale]) -> Scale:
        """The same value where `others` contradict it and nobody knows which is right: ``unusable``, and not averaged,
        with an interval that covers those of all."""
        ends = [end for scale in (self, *others) for end in scale.interval90]
        low, high = min(ends), max(ends)
        spread = max(float(np.log(high / low)) / (2 * Z90), self.relative_sd)
        return replace(self, interval90=(low, high), parts={"conflict": spread}, verdict=UNUSABLE)

    def text(self, *values: float) -> str:
        """`values` in the scale's unit, by default its own value, to two significant digits of the uncertainty; below 1
        m/px also in centimetres."""
        values = values or (self.value,)
        places = decimals(self.half_width * self.value)
        metres = f"{' to '.join(f'{value:.{places}f}' for value in values)} {self.unit}"
        if self.unit != PER_PIXEL or self.value >= 1:
            return metres
        return f"{metres} ({' to '.join(f'{100 * value:.{max(places - 2, 0)}f}' for value in values)} cm)"

    @property
    def vehicles_used(self) -> int:
        """Number of vehicles from which the value was computed."""
        return int(self.used.sum())

    @property
    def rejected(self) -> dict[str, int]:
        """How many votes were set aside, by reason."""
        return dict(Counter(filter(None, self.reasons)).most_common())


def interval_about(value: float, low: float, high: float) -> str:
    """An interval about a value, relative to it: "+-1.4 %", or "-2.2 to +3.0 %" where it is not symmetric; small ones
    with two digits. In ASCII, which every terminal can write."""
    places = max(1, min(decimals(100 * (high - low) / 2 / value), 4)) if high > low else 1
    below, above = (f"{100 * (end / value - 1):+.{places}f}" for end in (low, high))
    return f"+-{above[1:]} %" if below[1:] == above[1:] else f"{below} to {above} %"
