"""The result of measuring one source: the vehicles found, and the scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.boxes import Boxes
from ..core.brief import Brief
from ..core.remarks import REFUSAL
from ..core.scale import Scale
from ..core.source import Placement
from ..core.verdicts import UNUSABLE
from ..core.votes import Votes
from ..errors import EvidenceDisagrees, TooLittleEvidence
from .measured import MeasuredSource

FORCED = "write anyway with `orthoscale fix --force`."


@dataclass(frozen=True, repr=False)
class Result(MeasuredSource, Brief):
    """A measured source; what `fix` writes and every report shows.

    ``result.scale`` is the answer, ``result.vehicles`` a table of the vehicles (``pandas.DataFrame(result.vehicles)``),
    ``result.to_dict()`` the report as plain values.
    """

    @property
    def projection(self) -> str:
        """The projection that was used: the one asked for, or what fits the source."""
        return self.measured.projection

    def brief(self) -> list[tuple[str, str]]:
        """The lines that printing it shows: label and text."""
        scale = self.scale
        said = [remark.text for remark in self.remarks]
        remarks = f"{len(said)}, the first: {said[0]}" if said else "none"
        return [
            *scale.brief(),
            ("fleet", f"{scale.fleet} ({self.fleet.name})"),
            ("input", str(self.source.path)),
            ("remarks", remarks),
        ]

    def to_dict(self) -> dict[str, Any]:
        """The report (what `fix` writes as JSON) as plain values; see `report.document.document`."""
        from .document import document

        return document(self)

    def place(self, keep_origin: bool = False) -> Placement:
        """The georeferencing of an orthophoto's copy: from the map on which it was found, else local metres, or with
        `keep_origin` the input's own place."""
        assert self.source.plan is not None, "reconstructions have none"
        metres_per_pixel = self.scale.value
        return self.on_map.place(metres_per_pixel) or self.source.plan.place(metres_per_pixel, keep_origin)

    @property
    def scale(self) -> Scale:
        """The scale, its interval and its verdict."""
        return self.measured.scale

    @property
    def votes(self) -> Votes:
        """The vehicles' measurements that were pooled."""
        return self.measured.votes

    @property
    def vehicles(self) -> np.ndarray:
        """(N,) structured array with a row for each vehicle, sizes in metres (`core.measuring.vehicles.VEHICLE`)."""
        return self.measured.vehicles

    @property
    def boxes(self) -> Boxes:
        """All boxes that entered the projection, of all pictures."""
        return self.measured.boxes

    @property
    def picture(self) -> np.ndarray:
        """(M,) name of each box's picture."""
        return self.measured.picture

    @property
    def rejected_boxes(self) -> dict[str, int]:
        """Boxes that never became votes, by reason."""
        return self.measured.rejected_boxes

    @property
    def disagreement(self) -> EvidenceDisagrees | None:
        """The first contradiction, None if there is none; raised by `require_useful` and by the command line."""
        said = (*self.scale.remarks, *self.source.notes)
        refusal = next((remark for remark in said if remark.severity == REFUSAL), None)
        if refusal is None:
            return None
        return EvidenceDisagrees(f"{self.source.path}: {refusal.text}", f"{refusal.hint}, or {FORCED}")

    @property
    def useful(self) -> bool:
        """Whether `require_useful` raises nothing."""
        return self.disagreement is None and self.scale.verdict != UNUSABLE

    def require_useful(self) -> None:
        """Raise TooLittleEvidence for a scale too uncertain to be written, EvidenceDisagrees for a contradiction."""
        if (disagreement := self.disagreement) is not None:
            raise disagreement
        if self.scale.verdict == UNUSABLE:
            low, high = self.scale.interval90
            raise TooLittleEvidence(
                f"{self.source.path}: the scale is only known to lie between {low:.4g} and {high:.4g} "
                f"{self.scale.unit}",
                self._cures,
            )

    @property
    def _cures(self) -> str:
        """What the user has not done yet that may make too uncertain a scale useful, as a hint."""
        cures = []
        if "fleet" not in self.settings:
            cures.append("name the country's fleet (--fleet)")
        swept = self.detections.swept
        if swept is not None and swept.zoom_choice is not None:  # the search may have found other things
            claimed = self.source.claimed
            told = claimed is not None and claimed.gsd_m is not None and claimed.usable and self.source.plan is not None
            size = f"{claimed.gsd_m:.3g}, as its georeferencing claims" if claimed and told else "METRES_PER_PIXEL"
            cures.append(f"say roughly how large a pixel is (--gsd-hint {size})")
        text = ", ".join([*cures, "give a scene with more vehicles", f"or {FORCED}"])
        return text[0].upper() + text[1:]
