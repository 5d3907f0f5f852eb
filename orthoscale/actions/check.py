"""Compares a claimed scale with the scale from vehicles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.brief import Brief
from ..core.claims import NO_PROOF, NOT_TOLD, Comparison, metric_claim, own_claim
from ..core.remarks import INFO, Remark
from ..core.source import Source
from ..errors import EvidenceDisagrees, UsageError
from ..report.result import Result
from ..requests import EstimateRequest
from .estimate import OnBoxes, measured
from .opening import source_of

if TYPE_CHECKING:
    from typing import Unpack

    from ..core.progress import Progress
    from ..requests import EstimateOptions

CHECK_FORMAT = "orthoscale check 1"
FIND_IT = "Find it with `orthoscale estimate`"


@dataclass(frozen=True, repr=False)
class Checked(Brief):
    """The scale from the vehicles, and every claim compared with it."""

    result: Result
    comparisons: list[Comparison]

    @property
    def disagrees(self) -> bool:
        """Whether a claim is off by more than CLEAR sigmas."""
        return any(comparison.verdict == "disagrees" for comparison in self.comparisons)

    def require_agreement(self) -> None:
        """Raise EvidenceDisagrees if measurements of the scale contradict each other or a claim; TooLittleEvidence if
        the scale is too uncertain to be compared with a claim."""
        if (disagreement := self.result.disagreement) is not None:
            raise disagreement
        for comparison in self.comparisons:
            if comparison.verdict == "disagrees":
                raise EvidenceDisagrees(comparison.sentence())
        self.result.require_useful()

    def brief(self) -> list[tuple[str, str]]:
        """The comparison with each claim, then the result in brief."""
        return [*(("claim", one.sentence()) for one in self.comparisons), *self.result.brief()]

    def to_dict(self) -> dict[str, Any]:
        """Plain values: each comparison, and the scale from the vehicles; what `orthoscale check --json` prints."""
        scale = self.result.scale
        return {
            "format": CHECK_FORMAT,
            "comparisons": [comparison.document() for comparison in self.comparisons],
            **scale.document(),
            "fleet": scale.fleet,
            "remarks": [remark.document() for remark in self.result.remarks],
        }


def check(
    path: str | Path | Source, *, progress: Progress | None = None, **options: Unpack[EstimateOptions]
) -> Checked:
    """Compare the scale that the orthophoto or metric reconstruction at `path` claims with that of its vehicles.

    options : those of `estimate`. Raises what that raises, and UsageError for an input that claims no scale.
    """
    return checked(path, EstimateRequest.of(options), progress)


def checked(
    path: str | Path | Source,
    request: EstimateRequest,
    progress: Progress | None = None,
    on_boxes: OnBoxes | None = None,
) -> Checked:
    """Check the input at `path` as `request` says; see `check`. on_boxes : as in `measured`."""
    source = source_of(path, request, progress)
    require_claim(source)
    result = measured(source, request, progress, on_boxes)
    found = comparisons(result)
    if source.posed is not None and source.by_orthoscale:  # an orthophoto's metadata say so
        scale = result.scale.remarked(Remark(INFO, NO_PROOF))
        result = replace(result, measured=replace(result.measured, scale=scale))
    if source.posed is not None and not found and not source.metric_already:
        result.require_useful()
        scale = result.scale
        by = f"{scale.text()}, 90 % {scale.text(*scale.interval90)}"
        raise UsageError(f"{source.path} claims no scale: {NOT_TOLD}; it has {by}", "Convert it to metres with `fix`.")
    return Checked(result, found)


def require_claim(source: Source) -> None:
    """Raise UsageError if `source` claims no scale to compare with. Never for a reconstruction: only once its scale is
    measured is it known whether its unit is nearly a metre."""
    if source.posed is not None:
        return
    claimed = source.claimed
    if claimed is None or claimed.gsd_m is None:
        why = "" if claimed is None else f": {claimed.why}"
        raise UsageError(f"{source.path} claims no scale{why}", f"{FIND_IT}.")


def comparisons(result: Result) -> list[Comparison]:
    """The claims of its source, compared with the result."""
    own = own_claim(result.source, result.scale) or metric_claim(result.source, result.scale)
    return [own] if own else []
