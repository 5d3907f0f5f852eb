"""Agreement of two measurements of the scale of one model, and their combination."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..evidence import Support
from ..normal import Z90, median_sd
from ..remarks import INFO, REFUSAL, Remark
from ..scale import Scale
from ..verdicts import CHECK_LIMIT, verdict

CONTRADICTION = 2.6  # sigmas above which two measurements of one scale contradict each other; by chance in 1 %
OWN = ("sampling", "margin", "geometry")  # parts of the uncertainty that two measurements of one model do not share
# Least relative one sigma between one network's boxes of vehicles in two sets of pictures. An assumption: on the two
# real scenes the vehicles measured both ways differ by 3.5 % and 1.8 % at most. The margins of two networks are
# independent.
OWN_MARGIN = 0.015
MIN_COMMON = 5  # number of vehicles measured both ways from which only these are compared


@dataclass(frozen=True)
class Agreement:
    """Two measurements of the scale of one model, compared.

    scales : the two by name. difference, sd : log of second over first by the vehicles in common, and its one sigma.
    common : number of these vehicles, 0 if the difference is that of the scales. apart, apart_sd : log of second scale
    over first, by all vehicles of each, and its one sigma. mixes_sd : one sigma of a further difference of the scales,
    because the two count different vehicles of different mixes; 0 unless the vehicles in common agree. cause : of a
    contradiction, in words. spared : the name of the one that this cause does not affect.
    """

    scales: dict[str, Scale]
    difference: float
    sd: float
    apart: float
    apart_sd: float
    common: int = 0
    mixes_sd: float = 0.0
    cause: str = ""
    spared: str = ""

    @property
    def tension(self) -> float:
        """Sigmas between the two: by the vehicles in common, or by all vehicles of each, whichever is more."""
        return max(abs(self.difference) / self.sd, abs(self.apart) / float(np.hypot(self.apart_sd, self.mixes_sd)))

    @property
    def by_others(self) -> bool:
        """Whether the scales differ because of vehicles that only one of the two counts, not by how they measure."""
        return self.mixes_sd > 0 and abs(self.apart) > CONTRADICTION * self.apart_sd

    @property
    def surer(self) -> str:
        """The name of the one that the cause of a contradiction does not affect, if there is such; else of the more
        certain one."""
        return self.spared or min(self.scales, key=lambda name: self.scales[name].relative_sd)

    @property
    def contradicts(self) -> bool:
        """Whether the two differ by more than CONTRADICTION sigmas."""
        return self.tension > CONTRADICTION

    @property
    def remark(self) -> Remark:
        """The sentence, and how serious it is."""
        hint = "Inspect the boxes (--save-detections) and the poses, or choose one mode with --mode"
        return Remark(REFUSAL if self.contradicts else INFO, self.sentence(), hint if self.contradicts else "")

    def sentence(self) -> str:
        """In words."""
        (first, a), (second, b) = self.scales.items()
        parts = f"{100 * np.expm1(self.difference):+z.1f} %"
        if self.common:
            parts = f"{parts} on the {self.common} vehicles measured both ways"
            parts = f"{100 * np.expm1(self.apart):+z.1f} %, and {parts}"
        so = "; the two contradict each other" if self.contradicts else ""
        if self.cause:
            so = f"{so}: {self.cause}"
        if self.by_others and not self.contradicts:
            so = "; the difference comes from vehicles that only one of them counts"
        return f"{second} gives {b.value:.5g} {b.unit}, {first} {a.value:.5g}: {parts}, {self.tension:.1f} sigma{so}"


def compare(scales: dict[str, Scale], ratio: np.ndarray | None = None, one_network: bool = True) -> Agreement:
    """The agreement of two scales of one source.

    ratio : (K, 2) log ratio of the size by the first to that by the second, for lengths and widths of the vehicles that
    both measured. With enough of them the vehicles' true sizes cancel, and so does the fleet. If these agree, the two
    modes measure alike, and a remaining difference of the scales comes from the other vehicles, whose mix each mode
    estimates by itself (`mixes_sd`, the fleet's part of both). Without vehicles in common, sampling is taken as
    independent, which tolerates a larger difference than the same vehicles should have. one_network : both use boxes of
    one network, and most of its error is common to both; the errors of two networks are independent, like geometry.
    Fleet, margin and other evidence cancel as far as both scales rest on them: a scale that also rests on a known
    distance differs from one by vehicles alone by the fleet's error.
    """
    a, b = scales.values()
    own = sum(_own_variance(scale.parts, one_network) for scale in (a, b))
    sampling = sum(scale.parts.get("sampling", 0.0) ** 2 for scale in (a, b))
    shared = (a.parts.keys() | b.parts.keys()) - {"geometry", "sampling", *(() if one_network else ("margin",))}
    left = sum((a.parts.get(name, 0.0) - b.parts.get(name, 0.0)) ** 2 for name in shared)
    apart = float(np.log(b.value / a.value)), float(np.sqrt(own + sampling + left))
    if ratio is None or len(ratio) < MIN_COMMON:
        return Agreement(scales, *apart, *apart)
    each = of_scales(scales, ratio)
    # Other evidence on the scale does not make the vehicles' sizes more certain, so their own parts count in full.
    own = sum(_own_variance(scale.by_vehicles or scale.parts, one_network) for scale in (a, b))
    own += median_sd(each) ** 2
    difference, sd = float(np.median(each)), float(np.sqrt(own))
    alike = abs(difference) < CONTRADICTION * sd
    mixes = float(np.hypot(a.parts.get("fleet", 0.0), b.parts.get("fleet", 0.0))) if alike else 0.0
    return Agreement(scales, difference, sd, *apart, len(each), mixes)


def _own_variance(parts: Mapping[str, float], one_network: bool) -> float:
    """Variance of the errors that one of two measurements does not share with the other, except sampling; from the
    `parts` of its uncertainty."""
    margin = 0.0 if one_network else parts.get("margin", 0.0)
    return parts.get("geometry", 0.0) ** 2 + max(margin, OWN_MARGIN) ** 2


def of_scales(scales: dict[str, Scale], ratio: np.ndarray) -> np.ndarray:
    """(K,) log of the second scale over the first by each vehicle of size ratio `ratio` (K, 2), as in `compare`."""
    a, b = scales.values()
    return ratio @ (np.add(a.weights, b.weights) / 2)


def alone(agreement: Agreement) -> str | None:
    """The name of the scale that is used alone: one that other evidence contradicts, or the surer one of two that
    contradict each other. None if both are pooled."""
    contradicted = (name for name, scale in agreement.scales.items() if scale.conflict)
    return next(contradicted, agreement.surer if agreement.contradicts else None)


def together(agreement: Agreement) -> Scale:
    """The pooled scale: the first, shifted towards the second by its weight; or the one that is used `alone`. Its
    tension is the larger of the two, and it has the remarks on either, with the name of that one unless they hold for
    both.

    Weights are the inverse variances of the errors that are not shared. Vehicles, detector and ground are largely the
    same, so no part of the uncertainty becomes smaller than its weighted mean. A difference that exceeds their own
    uncertainties is attributed to the mix of vehicles (DerSimonian and Laird 1986).
    """
    if (name := alone(agreement)) is not None:
        return _one_alone(agreement, name)
    a, b = agreement.scales.values()
    own = np.array([sum(v**2 for k, v in s.parts.items() if k in OWN) for s in (a, b)])
    weight = (1 / own) / (1 / own).sum()
    log_value = float(weight @ np.log([a.value, b.value]))
    names = {**a.parts, **b.parts}  # one pass may see parking rows where the other does not
    parts = {name: float(weight @ [s.parts.get(name, 0.0) for s in (a, b)]) for name in names}
    more = float(weight.prod() * max(agreement.apart**2 - agreement.apart_sd**2, 0.0))
    parts["fleet"] = float(np.hypot(parts.get("fleet", 0.0), np.sqrt(more)))
    sd = float(np.sqrt(sum(v**2 for v in parts.values())))
    support = Support(a.support.compared or b.support.compared, max(a.support.unproven, b.support.unproven))
    doubted = a.support.doubted or b.support.doubted
    tension = max(a.tension, b.tension)
    return replace(
        a,
        value=float(np.exp(log_value)),
        interval90=(float(np.exp(log_value - Z90 * sd)), float(np.exp(log_value + Z90 * sd))),
        parts=parts,
        tension=tension,
        verdict=verdict(support.judged(sd), tension > CHECK_LIMIT, conflict=False, doubted=doubted),
        remarks=tuple(dict.fromkeys(remark for name in agreement.scales for remark in _named(agreement.scales, name))),
        checks=a.checks | _values(agreement),
        evidence=a.evidence or b.evidence,
        support=support,
    )


def _one_alone(agreement: Agreement, name: str) -> Scale:
    """The scale `name` alone. Unless other evidence contradicts it, this is because the two contradict each other: then
    they are not averaged, and the interval covers both, as with other evidence (`combining`)."""
    stands = agreement.scales[name]
    stands = replace(stands, checks=stands.checks | _values(agreement), remarks=_named(agreement.scales, name))
    return stands if stands.conflict else stands.contradicted_by(list(agreement.scales.values()))


def _values(agreement: Agreement) -> dict[str, float]:
    """The values of both scales, by name."""
    return {name: scale.value for name, scale in agreement.scales.items()}


def _named(scales: dict[str, Scale], name: str) -> tuple[Remark, ...]:
    """The remarks on the scale `name`; those that not all `scales` have begin with this name."""
    return tuple(
        remark if all(remark in s.remarks for s in scales.values()) else replace(remark, text=f"{name}: {remark.text}")
        for remark in scales[name].remarks
    )
