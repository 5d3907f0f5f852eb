"""The outcome of the search for each photo, as plain values: places on Earth, scales, candidates, and messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyproj

from ..errors import EvidenceDisagrees, InputError, OrthoscaleError, TooLittleEvidence
from ..photos.measure import Interval90
from ..sources.satellite import Satellite
from .claimed import ClaimedScale
from .opinions import Opinions, opinions
from .register import Candidate, Registration

FORMAT_OF_LOCATED = "orthoscale locate 1"


@dataclass(frozen=True)
class LocateOutcome:
    """One photo: its scale and what the search found, or the error before that. seconds : duration of the search
    [s]."""

    name: str
    claimed: ClaimedScale | None
    registration: Registration | None
    error: OrthoscaleError | None = None
    seconds: float = 0.0

    @property
    def located(self) -> Candidate | None:
        """Where the photo was taken; None if that is not known."""
        return self.registration.located if self.registration else None

    @property
    def problem(self) -> OrthoscaleError | None:
        """Why the photo was not located, as an error with its exit code; None if it was."""
        if self.error is not None:
            return self.error
        assert self.registration is not None
        if not self.registration.problem:
            return None
        if self.registration.ambiguous:
            hint = "Give a prior (--prior LON,LAT,RADIUS) or the heading (--heading)."
            return EvidenceDisagrees(f"{self.name}: {self.registration.problem}", hint)
        return TooLittleEvidence(
            f"{self.name}: not located: {self.registration.problem}",
            "Its candidates are written; check the scale (--gsd), the heading (--heading search) and the map.",
        )

    @property
    def scales(self) -> Opinions | None:
        """The scale before the search and the map's; None if the photo was not located."""
        if self.located is None or self.claimed is None or self.registration is None:
            return None
        return opinions(self.claimed, self.located.scale, self.registration.scale_sd)


def footprint(outcome: LocateOutcome, candidate: Candidate) -> np.ndarray | None:
    """(4, 2) longitude and latitude of the photo's corners at a `candidate`, clockwise from the upper left; None if a
    corner lies near the horizon."""
    assert outcome.claimed is not None
    corners = outcome.claimed.levelled.corners
    return None if corners is None else candidate.lon_lat(corners)


def foot(candidate: Candidate) -> np.ndarray:
    """(2,) longitude and latitude of the point below the camera."""
    return candidate.lon_lat(np.zeros((1, 2)))[0]


def all_failed(outcomes: Sequence[LocateOutcome]) -> OrthoscaleError | None:
    """The error to end with if no photo was located: the problem of the only photo, or the gravest of several; else
    None."""
    problems = [problem for outcome in outcomes if (problem := outcome.problem) is not None]
    if len(problems) < len(outcomes):
        return None
    if len(problems) == 1:
        return problems[0]
    order = (EvidenceDisagrees, TooLittleEvidence, InputError)
    worst = min(problems, key=lambda p: next((k for k, kind in enumerate(order) if isinstance(p, kind)), len(order)))
    return type(worst)(f"none of {len(problems)} photos was located; {worst.message}", worst.hint)


def document(outcomes: Sequence[LocateOutcome], satellite: Satellite, told: dict[str, Any]) -> dict[str, Any]:
    """All results, as in `located.json`. told : further entries, on the search as a whole."""
    return {
        "format": FORMAT_OF_LOCATED,
        "satellite": str(satellite.source.path),
        "crs": satellite.crs.name,
        **told,
        "located": sum(outcome.located is not None for outcome in outcomes),
        "photos": [entry(outcome, satellite) for outcome in outcomes],
    }


def entry(outcome: LocateOutcome, satellite: Satellite) -> dict[str, Any]:
    """The entry of one photo: places are [longitude, latitude], lengths in metres, headings clockwise from north."""
    problem, best, scales = outcome.problem, outcome.located, outcome.scales
    values: dict[str, Any] = {
        "photo": outcome.name,
        "located": best is not None,
        "problem": "" if problem is None else problem.message,
        "exit_code": 0 if problem is None else problem.exit_code,
    }
    claimed, got = outcome.claimed, outcome.registration
    if claimed is not None:
        source = claimed.photo.lens.source if claimed.focal_known else "not known"
        values |= {"attitude": claimed.photo.attitude, "focal_source": source}
        values["claimed_scale"] = {"by": claimed.by, **asdict(claimed.gsd)}
    if best is not None and claimed is not None and scales is not None and got is not None:
        below, outline = foot(best), footprint(outcome, best)
        height = Interval90.log_normal(claimed.levelled.altitude * best.scale, got.scale_sd)
        values |= {
            "foot": below.tolist(),
            "foot_crs": satellite.in_crs(below)[0].tolist(),
            "middle": best.middle.tolist(),
            "footprint": None if outline is None else outline.tolist(),
            "heading_deg": round(float(np.degrees(best.heading)), 2) % 360,
            "altitude_m": asdict(height) if claimed.focal_known else None,
            "inliers": best.inliers,
            "score": round(best.score, 4),
            "map_scale": asdict(scales.matched),
            "together": None if scales.together is None else asdict(scales.together),
            "agreement": {"sigmas": round(scales.sigmas, 2), "contradict": scales.contradict, "said": scales.said},
        }
        exif = claimed.photo.tags.lon_lat
        if exif is not None:
            away = pyproj.Geod(ellps="WGS84").inv(*exif, *below)[2]
            values["exif_position"] = {"place": list(exif), "metres_away": round(float(away), 2)}
    if got is not None:
        values["needed"] = got.needed
        values["candidates"] = candidate_rows(outcome, satellite)
    return values


def candidate_rows(outcome: LocateOutcome, satellite: Satellite) -> list[dict[str, Any]]:
    """A row for each verified place, best first."""
    assert outcome.registration is not None
    rows = []
    for rank, each in enumerate(outcome.registration.candidates, 1):
        x, y = satellite.in_crs(each.middle)[0]
        below = foot(each)
        rows.append(
            {
                "photo": outcome.name,
                "rank": rank,
                "inliers": each.inliers,
                "needed": outcome.registration.needed,
                "score": round(each.score, 4),
                "longitude": round(float(each.middle[0]), 8),
                "latitude": round(float(each.middle[1]), 8),
                "x": round(float(x), 3 if abs(x) > 400 else 8),
                "y": round(float(y), 3 if abs(y) > 400 else 8),
                "foot_longitude": round(float(below[0]), 8),
                "foot_latitude": round(float(below[1]), 8),
                "heading_deg": round(float(np.degrees(each.heading)), 2) % 360,
                "scale": round(each.scale, 5),
            }
        )
    return rows
