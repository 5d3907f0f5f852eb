"""Does a scale that something claims agree with the one that vehicles give?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.pooling.posterior import Z90
from ..core.scale import Scale
from ..errors import UsageError
from .requests import EstimateRequest
from .result import Result

if TYPE_CHECKING:
    from typing import Unpack

    from ..detect.find import Progress
    from ..sources.source import Source
    from .requests import EstimateOptions

CLEAR = 3.0  # sigmas from which a disagreement is no chance
# Factors (truth over claim) that mistakes make, and the mistake. A ratio close to one of them is a hint, no proof.
MISTAKES = (
    (0.3048, "feet were taken for metres"),
    (1 / 0.3048, "metres were taken for feet"),
    (2.0, "the image was halved and its georeferencing was not"),
    (4.0, "the image was halved twice and its georeferencing was not"),
    (0.5, "the image was enlarged and its georeferencing was not"),
    (10.0, "a decimal point is off by one place"),
    (0.1, "a decimal point is off by one place"),
)


@dataclass(frozen=True)
class Comparison:
    """A claimed scale against a recovered one, in the same unit.

    claimed_by : what claims it, for people. claimed, recovered : metres per unit.
    sd : relative one sigma of the recovered scale (and of the claim, where it has one).
    believed : False when the claim itself says that nothing ties it to the ground. why : where the claim comes from.
    """

    claimed_by: str
    claimed: float
    recovered: float
    sd: float
    believed: bool = True
    why: str = ""

    @property
    def ratio(self) -> float:
        """Recovered over claimed."""
        return self.recovered / self.claimed

    @property
    def sigmas(self) -> float:
        """How many of their common one sigma the two scales lie apart."""
        return abs(math.log(self.ratio)) / self.sd

    @property
    def verdict(self) -> str:
        """``agrees`` (within the 90 % interval), ``disagrees`` (beyond three sigmas), else ``doubtful``."""
        if self.sigmas <= Z90:
            return "agrees"
        return "disagrees" if self.sigmas > CLEAR else "doubtful"

    @property
    def guesses(self) -> list[str]:
        """Mistakes that would explain a disagreement."""
        if self.verdict == "agrees":
            return []
        return [why for factor, why in MISTAKES if abs(math.log(self.ratio / factor)) <= Z90 * self.sd]

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
        percent = f"{abs(100 * (self.ratio - 1)):.1f} % {'more' if self.ratio > 1 else 'less'}"
        text = (
            f"{self.verdict}: vehicles give {self.recovered:.4g}, {percent} "
            f"than the {self.claimed:.4g} that {self.claimed_by} ({self.sigmas:.1f} sigma)"
        )
        return text + "".join(f"; perhaps {guess}" for guess in self.guesses)


def own_claim(source: Any, scale: Scale) -> Comparison | None:
    """What the source says of its own scale against `scale`; None where it says nothing (see `georeference.Claim`)."""
    claimed = getattr(source, "claimed", None)
    if claimed is None or claimed.gsd_m is None:
        return None
    return Comparison(
        "its georeferencing claims",
        claimed.gsd_m,
        scale.value,
        scale.relative_sd,
        claimed.usable,
        claimed.why,
    )


@dataclass(frozen=True)
class Checked:
    """The scale by the vehicles, and every claim compared with it."""

    result: Result
    comparisons: list[Comparison]

    @property
    def disagrees(self) -> bool:
        """Whether a claim is off by more than CLEAR sigmas."""
        return any(comparison.verdict == "disagrees" for comparison in self.comparisons)


def check(
    path: str | Path | Source, *, progress: Progress | None = None, **options: Unpack[EstimateOptions]
) -> Checked:
    """Compare the scale that the orthophoto at `path` claims with the one that its vehicles give.

    options : those of `estimate`. Raises what that raises, and UsageError for an input that claims no scale.
    """
    return checked(path, EstimateRequest.of(options), progress)


def checked(path: str | Path | Source, request: EstimateRequest, progress: Progress | None = None) -> Checked:
    """What `request` asks of the input at `path`; see `check`."""
    from ..sources.opening import open_source
    from .estimate import measured

    source = open_source(path, request.images, request.detections is None) if isinstance(path, (str, Path)) else path
    claimed = getattr(source, "claimed", None)
    if claimed is None or claimed.gsd_m is None:
        why = "" if claimed is None else f": {claimed.why}"
        raise UsageError(f"{source.path} claims no scale{why}", "Find it by `orthoscale estimate`.")
    result = measured(source, request, progress)
    return Checked(result, comparisons(result))


def comparisons(result: Result) -> list[Comparison]:
    """All that there is to compare the result with."""
    own = own_claim(result.source, result.scale)
    return [own] if own else []
