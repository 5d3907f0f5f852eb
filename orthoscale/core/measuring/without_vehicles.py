"""The scale of a source with too few vehicles, from at least two kinds of other evidence that agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...errors import TooLittleEvidence
from ..boxes import Boxes
from ..evidence import SUPPORTS, Evidence
from ..pooling.combining import Combined, combined
from ..remarks import CAUTION, Remark
from ..scale import Scale
from ..verdicts import UNUSABLE, verdict
from ..votes import Sightings, gather
from .measurement import Measurement

FEWEST_KINDS = 2  # kinds of evidence that must agree: one alone may be a mistake, or follow another standard


def measured_without_vehicles(
    evidence: Sequence[Evidence], unit: str, fleet: str, dims: int, lost: Mapping[str, int]
) -> Measurement:
    """The scale by `evidence` alone, as a measurement without vehicles.

    unit : of the scale. fleet : code of the fleet that vehicles would have been compared with. dims : number of
    coordinates of a place in the source. lost : number of boxes that are not vehicles, by reason. Raises
    TooLittleEvidence for fewer than two kinds of evidence, and where no two agree on a useful scale; kinds that
    contradict each other give a scale in conflict.
    """
    if len({e.kind for e in evidence}) < FEWEST_KINDS:
        raise _too_little(", ".join(e.says for e in evidence) or "none")
    together = combined(None, {}, evidence, unit)
    value, low, high = together.summary
    judged = together.support.judged(together.posterior.spread)
    said = verdict(judged, False, together.conflict > 0, together.support.doubted)
    agreeing = _agreeing(together)
    if not together.conflict and (said == UNUSABLE or len({e.kind for e in agreeing}) < FEWEST_KINDS):
        raise _too_little("; ".join(f"{e.says}: {e.value:.4g} {unit}" for e in evidence))
    remark = Remark(CAUTION, f"no vehicles: the scale rests on {' and '.join(e.says for e in agreeing)}")
    scale = Scale(
        value=value,
        unit=unit,
        interval90=(low, high),
        parts=together.parts,
        checks={},
        weights=(0.5, 0.5),
        tension=0.0,
        fleet=fleet,
        verdict=said,
        used=np.empty(0, bool),
        reasons=[],
        remarks=(*together.remarks, *(() if together.conflict else (remark,))),
        evidence=together.evidence,
        conflict=together.conflict,
        support=together.support,
    )
    none = np.empty((0, 2))
    votes = gather(Sightings(none, np.empty(0), np.empty((0, dims)), np.empty(0)), repeated=False)
    return Measurement(Boxes.empty(), np.empty(0, str), votes, scale, dict(lost), none, projection="none")


def _too_little(known: str) -> TooLittleEvidence:
    return TooLittleEvidence(
        f"without vehicles, two kinds of evidence that agree are needed (anchors, --known-distance, --ground-control, "
        f"--against, GPS positions); given: {known}"
    )


def _agreeing(together: Combined) -> list[Evidence]:
    """The pieces of evidence that agree with the result."""
    sigmas = [
        abs(np.log(e.value / together.summary[0])) / np.hypot(e.relative_sd, together.posterior.spread)
        for e in together.evidence
    ]
    return [e for e, apart in zip(together.evidence, sigmas, strict=True) if apart < SUPPORTS]
