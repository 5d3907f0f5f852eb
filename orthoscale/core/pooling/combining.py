"""The vehicles and other evidence, combined to one scale.

Pieces of evidence that agree are combined; contradictions are reported and never averaged.

An anchor may follow one of several standards, or be a false find. So it is a mixture of scales, and the vehicles decide
between its components. It never overrules the vehicles alone: a component further from them than CONFLICT_LIMIT does
not count unless other evidence agrees with it. A nearer one counts by its probability; the posterior may then have two
modes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import ndtr, ndtri

from ..evidence import BY_CONTROL, BY_DISTANCE, BY_GPS, BY_MAP, CONFLICT_LIMIT, SUPPORTS, Compared, Evidence, Support
from ..normal import Z90
from ..remarks import CAUTION, INFO, ON_EVIDENCE, REFUSAL, Remark
from .posterior import Posterior

STRONG = 0.05  # probability of a false find up to which an anchor may contradict others
# Probability of the vehicles' interval outside of which an anchor does not count by itself. It reaches CONFLICT_LIMIT
# sigmas to each side: whatever does not contradict the vehicles counts, less the more doubtful it is.
ALONE = float(1 - 2 * ndtr(-CONFLICT_LIMIT))
COMMON_AT_MOST = 0.99  # greatest share of a scale's variance that counts as common to all its sources
ANYTHING = 3.0  # one sigma of the logarithm of a scale of which nothing is known: a factor of 20
LEADING = 0.5  # share of the weight from which one measurement decides the scale
CHECK = {  # by kind, what to check where measurements contradict each other
    BY_DISTANCE: "the known distance (it may be mistyped, or not on the ground)",
    BY_CONTROL: "the ground control (its points may be mistyped, or in another grid)",
    BY_GPS: "the GPS positions (they may be from another flight; --no-gps leaves them out)",
    BY_MAP: "the place on the map (--against)",
}
CHECK_ANCHORS, CHECK_BOXES = "the anchors (--anchors)", "the boxes (--save-detections)"


@dataclass(frozen=True)
class Combined:
    """The combination of all measurements.

    conflict : sigmas between the two that contradict each other most, 0 if none do. summary : value and the ends of its
    90 % interval. In a conflict, the interval covers all of them. evidence : each piece that was given, with the scale
    that it means given the combined one. support : how far the evidence supports the scale.
    """

    posterior: Posterior
    parts: dict[str, float]
    conflict: float
    remarks: list[Remark]
    summary: tuple[float, float, float]
    evidence: tuple[Evidence, ...] = ()
    support: Support = Support()


def combined(
    vehicles: Posterior | None, parts: Mapping[str, float], evidence: Sequence[Evidence], unit: str
) -> Combined:
    """The combination of `vehicles` and all `evidence`; `parts` are the one-sigmas of the vehicles' uncertainty by
    cause, `unit` is that of all scales.

    vehicles : None if there are none; then there must be evidence, and the prior of the scale is flat. In a conflict
    the most certain measurement without doubt gives the value, or the most certain strong one if all are doubtful, and
    the interval covers all of them.
    """
    before = _anything(evidence) if vehicles is None else vehicles
    heard, unheard = _within_reach(before, evidence, unit)
    strong = [e.meant(before) for e in evidence if e.doubt <= STRONG]
    conflict, conflicts = _conflicts(vehicles, strong, unit)
    if not conflict:
        weighed = _weighed(before, parts, evidence, heard)
        support = replace(weighed.support, compared=_compared(vehicles, heard, unit))
        doubtful = [one.remark for one in support.compared if one.doubtful]
        remarks = [*doubtful, *(remark for _, remark in unheard), *weighed.remarks]
        return replace(weighed, remarks=remarks, support=support)
    seen = [] if vehicles is None else [("vehicles", vehicles)]
    every = [*seen, *((e.says, e.posterior) for e in strong)]
    certain = [*seen, *((e.says, e.posterior) for e in evidence if not e.doubt)] or every
    name, surest = min(certain, key=lambda one: one[1].spread)
    posterior, summary = _spanning([p for _, p in every], surest)
    told = tuple(e.meant(before) for e in evidence)
    whose = Remark(CAUTION, f"the scale is that of the most certain side alone, {name}; the interval covers all")
    parts, support = {"conflict": posterior.spread}, Support(conflicts=tuple(conflicts))
    refusals = [Remark(REFUSAL, text, _hint(vehicles, strong), ON_EVIDENCE) for text in support.refusals]
    remarks = [*refusals, whose, *(remark for e, remark in unheard if e.doubt > STRONG)]
    return Combined(posterior, parts, conflict, remarks, summary, told, support)


def _hint(vehicles: Posterior | None, evidence: Sequence[Evidence]) -> str:
    """What to check where the scale by `vehicles`, if there are any, and by `evidence` contradict each other."""
    what = list(dict.fromkeys(CHECK.get(e.kind, CHECK_ANCHORS) for e in evidence))
    *others, last = what if vehicles is None else [*what, CHECK_BOXES]
    return f"Check {', '.join(others)} and {last}" if others else f"Check {last}"


def _anything(evidence: Sequence[Evidence]) -> Posterior:
    """A nearly flat prior of a scale, centred on the most certain `evidence`."""
    surest = min(evidence, key=lambda e: e.relative_sd)
    return Posterior.normal(float(np.log(surest.value)), ANYTHING)


def _conflicts(vehicles: Posterior | None, evidence: Sequence[Evidence], unit: str) -> tuple[float, list[str]]:
    """Sigmas between the two measurements that contradict each other most, 0 where none do; and the figures of each
    pair that does, those furthest apart first. Two pieces of evidence are compared by the errors that they do not
    share.

    Among many pairs some are far apart by chance, so the probability of a false contradiction is divided among them
    (Bonferroni).
    """
    pairs = [(one.says, *_nearest(*one.without_shared(other)), other.says) for one, other in combinations(evidence, 2)]
    if vehicles is not None:  # of a mixture, the component nearest to the other measurement counts
        found = Posterior.normal(vehicles.centre, vehicles.spread)
        pairs += [("vehicles", *_nearest(found.blurred(-(e.common**2)), e.own), e.says) for e in evidence]
    limit = float(-ndtri(ndtr(-CONFLICT_LIMIT) / max(len(pairs), 1)))
    apart = sorted((pair for pair in pairs if pair[1] > limit), key=lambda pair: -pair[1])
    figures = [
        f"{name}: {np.exp(here):.5g} {unit}, {other_name}: {np.exp(there):.5g} {unit}, {sigmas:.1f} sigmas apart"
        for name, sigmas, here, there, other_name in apart
    ]
    return (apart[0][1] if apart else 0.0), figures


def _spanning(every: Sequence[Posterior], surest: Posterior) -> tuple[Posterior, tuple[float, float, float]]:
    """A distribution centred on `surest` and wide enough to cover `every` one; and a summary whose interval covers all
    of them."""
    low, high = min(p.quantile(0.05) for p in every), max(p.quantile(0.95) for p in every)
    spread = float(max((high - low) / (2 * Z90), surest.spread))
    summary = (float(np.exp(surest.centre)), float(np.exp(low)), float(np.exp(high)))
    return Posterior.normal(surest.centre, spread), summary


def _compared(vehicles: Posterior | None, heard: Sequence[Evidence], unit: str) -> tuple[Compared, ...]:
    """Each piece of `heard` compared with `vehicles` and the other pieces, if there are any: not with the combination
    of all, which may be little more than the piece itself."""
    found = []
    for k, e in enumerate(heard):
        others = [*heard[:k], *heard[k + 1 :]]
        if vehicles is None and not others:
            continue
        rest, common = _product(_anything(others) if vehicles is None else vehicles, others)
        shared = min(e.common**2, common)
        e = e.meant(rest)
        sd = float(np.hypot(rest.blurred(-shared).spread, np.sqrt(e.relative_sd**2 - shared)))
        found.append(Compared(e.kind, e.says, e.value, float(np.exp(rest.centre)), sd, unit, e.documented))
    return tuple(found)


def _product(vehicles: Posterior, heard: Sequence[Evidence]) -> tuple[Posterior, float]:
    """The product of `vehicles` and the evidence `heard`; and the variance in it of the error common to all that was
    seen on one ground (infinite without evidence, for vehicles have all of that error). The error is left out while
    they are combined, and added afterwards. A measurement that knows the ground better shares only a part of it."""
    if not heard:
        return vehicles, np.inf
    common = max(e.common**2 for e in heard)
    posterior = vehicles.blurred(-common) if common else vehicles
    for e in sorted(heard, key=lambda e: -e.common):
        if e.common**2 < common:
            posterior, common = posterior.blurred(common - e.common**2), e.common**2
        posterior = posterior.times_doubted(e.own, e.doubt, e.window)
    return posterior.blurred(common) if common else posterior, common


def _weighed(
    vehicles: Posterior, parts: Mapping[str, float], evidence: Sequence[Evidence], heard: Sequence[Evidence]
) -> Combined:
    """The product of `vehicles` and of the evidence `heard`, which do not contradict one another."""
    posterior, common = _product(vehicles, heard)
    value, low, high = (float(np.exp(posterior.quantile(q))) for q in (0.5, 0.05, 0.95))
    shares = _shares(vehicles, parts, [e.meant(posterior) for e in heard], posterior, common)
    told = tuple(e.meant(posterior) for e in evidence)
    proven, _ = _product(vehicles, [e for e in heard if e.documented])
    unproven = float(np.sqrt(max(proven.spread**2 - posterior.spread**2, 0.0)))
    remarks, support = _leading(heard, posterior), Support(unproven=unproven)
    return Combined(posterior, shares, 0.0, remarks, (value, low, high), told, support)


def _leading(heard: Sequence[Evidence], posterior: Posterior) -> list[Remark]:
    """A remark if GPS positions, which nobody gave on purpose, have most of the weight."""
    return [
        Remark(INFO, f"{e.says} have {100 * weight:.0f} % of the weight; --no-gps leaves them out")
        for e in heard
        if e.kind == BY_GPS and (weight := min((posterior.spread / e.own_sd) ** 2, 1.0)) > LEADING
    ]


def _within_reach(
    vehicles: Posterior, evidence: Sequence[Evidence], unit: str
) -> tuple[list[Evidence], list[tuple[Evidence, Remark]]]:
    """The evidence that counts, without its scales that lie outside of the vehicles' interval and that no other
    evidence supports; and the evidence that does not count at all, each piece with a remark."""
    low, high = (1 - ALONE) / 2, (1 + ALONE) / 2
    heard, unheard, interval = [], [], None
    for e in evidence:
        if not e.doubt:
            heard.append(e)
            continue
        interval = interval or (vehicles.quantile(low), vehicles.quantile(high))
        modes = e.posterior
        counts = (modes.mean >= interval[0]) & (modes.mean <= interval[1])
        for other in evidence:
            if other.kind != e.kind and other.doubt <= STRONG:
                mine, there = e.without_shared(other)
                apart = np.abs(mine.mean[:, None] - there.mean) / np.hypot(mine.sd[:, None], there.sd)
                counts |= (apart < SUPPORTS).any(1)
        if counts.any():
            heard.append(e.only(counts))
        else:
            e = e.meant(vehicles)
            text = (
                f"{e.says}: would give {e.value:.5g} {unit}, outside the vehicles' {100 * ALONE:.1f} % interval "
                f"({np.exp(interval[0]):.5g} to {np.exp(interval[1]):.5g}); it does not count"
            )
            unheard.append((e, Remark(CAUTION, text)))
    return heard, unheard


def _nearest(one: Posterior, other: Posterior) -> tuple[float, float, float]:
    """Sigmas between the nearest components of two mixtures, and the means of these components."""
    apart = np.abs(one.mean[:, None] - other.mean) / np.hypot(one.sd[:, None], other.sd)
    here, there = np.unravel_index(np.argmin(apart), apart.shape)
    return float(apart[here, there]), float(one.mean[here]), float(other.mean[there])


def _shares(
    vehicles: Posterior,
    parts: Mapping[str, float],
    evidence: Sequence[Evidence],
    posterior: Posterior,
    common: float,
) -> dict[str, float]:
    """One-sigmas that each source contributes to the combination; their squares add up to its variance. `common`, the
    variance that all share, counts as geometry."""
    if not evidence:
        return dict(parts)
    spreads = [vehicles.blurred(-common).spread, *(e.own_sd for e in evidence)]
    precision = np.array(spreads) ** -2.0
    weight = precision / precision.sum()
    out = {name: float(sd * weight[0]) for name, sd in parts.items()}
    for e, spread, w in zip(evidence, spreads[1:], weight[1:], strict=True):
        out[e.kind] = float(np.hypot(out.get(e.kind, 0.0), spread * w))
    common = min(common, COMMON_AT_MOST * posterior.spread**2)
    adjust = np.sqrt((posterior.spread**2 - common) / sum(sd**2 for sd in out.values()))
    out = {name: float(sd * adjust) for name, sd in out.items()}
    return out | {"geometry": float(np.hypot(out.get("geometry", 0.0), np.sqrt(common)))} if common else out
