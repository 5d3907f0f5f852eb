"""How often photos are found on a map, as a function of the error of their scale (a curve in arXiv 2603.07535)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyproj

from ..actions.locate import LocateRequest, features_for, finder_for, searched
from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.progress import Progress
from ..errors import TooLittleEvidence, UsageError
from ..locate.claimed import BY_VEHICLES, BY_WORD, ClaimedScale
from ..locate.features import Features
from ..locate.outcome import LocateOutcome, foot
from ..locate.register import PlaceFinder
from ..photos.measure import Interval90, measure
from ..sources.satellite import Satellite
from ..version import __version__
from .places import PlacedSample

NEAR_M, FAR_M = 5.0, 20.0  # [m] within which a photo counts as found; the paper's are 5 and 20
LOCATING_FORMAT = "orthoscale evaluate --locate 1"
TRUE_SD = 0.06  # relative 1 sigma with which a true scale, or one with an error, is searched: 90 % are +- 10 %
ELLIPSIS, ELLIPSIS_STEP = "...", 0.1  # in --scale-errors, and the step for which it stands
ESTIMATED, TRUE = "estimated", "true"
STAGE = "Locating"


@dataclass(frozen=True)
class LocateTrial:
    """One search. error : distance of the best candidate from the true place [m], infinite without a candidate.
    answered : whether the candidate was good enough."""

    photo: str
    error: float
    answered: bool


@dataclass(frozen=True)
class Search:
    """What is searched for, where and how, all checked before the photos' vehicles are looked for, which takes long.

    errors : of the true scale, with which each photo is searched too. prior : see `LocateRequest.prior_on`. method : by
    which `finder` and `features` work. notes : for the user.
    """

    samples: Sequence[PlacedSample]
    satellite: Satellite
    request: LocateRequest
    errors: Sequence[float]
    prior: tuple[float, float, float] | None
    method: str
    finder: PlaceFinder | None
    features: Features
    notes: Sequence[str]

    @classmethod
    def of(
        cls, samples: Sequence[PlacedSample], satellite: Satellite, request: LocateRequest, errors: Sequence[float]
    ) -> Search:
        """A search for `samples` as `request` says. Raises UsageError, InputError."""
        method, finder, notes = finder_for(request)
        prior, features = request.prior_on(satellite), features_for(method)
        return cls(samples, satellite, request, errors, prior, method, finder, features, notes)


def scale_errors(text: str) -> list[float]:
    """The numbers in a text such as "-.5,0,.5"; "-.5,...,.5" stands for steps of 0.1. Raises UsageError."""
    values: list[float] = []
    words = [word.strip() for word in text.split(",")]
    try:
        for k, word in enumerate(words):
            if word == ELLIPSIS and 0 < k < len(words) - 1:
                low, high = float(words[k - 1]), float(words[k + 1])
                steps = round(abs(high - low) / ELLIPSIS_STEP)
                values += [float(v) for v in np.round(np.linspace(low, high, steps + 1)[1:-1], 6)]
            else:
                values.append(float(word))
    except ValueError:
        raise UsageError(
            f"--scale-errors {text} is not a list of numbers", "Write -.5,-.2,0,.2,.5 or -.5,...,.5."
        ) from None
    if not all(-1 < value <= 9 for value in values):
        raise UsageError(f"--scale-errors {text}: each must lie between -1 and 9", "An error of .1 is 10 % too large.")
    return values


def true_scale(placed: PlacedSample) -> ClaimedScale:
    """The scale by the true altitude."""
    photo = placed.sample.photo
    return ClaimedScale(photo, Interval90.log_normal(photo.gsd_from(placed.sample.altitude), TRUE_SD), BY_WORD)


def estimated_scale(placed: PlacedSample, found: Detections, fleet: Fleet) -> ClaimedScale | None:
    """The scale by the vehicles; None if there are too few."""
    try:
        got = measure([placed.sample.photo], found, fleet)
    except TooLittleEvidence:
        return None
    return ClaimedScale(placed.sample.photo, got.gsd, BY_VEHICLES, got)


def document(
    search: Search,
    found: Detections,
    fleet: Fleet,
    notes: Sequence[str] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Success with the vehicles' scale, with the true one, and with errors of the true one, as plain values."""
    samples = search.samples
    estimated = [estimated_scale(each, found, fleet) for each in samples]
    trials: dict[str, list[tuple[PlacedSample, ClaimedScale]]] = {
        ESTIMATED: [(s, e) for s, e in zip(samples, estimated, strict=True) if e is not None],
        TRUE: [(s, true_scale(s)) for s in samples],
    }
    trials |= {f"{error:+g}": [(s, true_scale(s).times(1 + error)) for s in samples] for error in search.errors}
    total, done = sum(map(len, trials.values())), 0
    rows, lines = [], []
    for name, some in trials.items():
        results = []
        for each, claimed in some:
            outcome = searched(claimed, search.satellite, search.features, search.request, search.prior, search.finder)
            results.append(_found(each, outcome))
            done += 1
            if progress:
                progress(STAGE, done, total)
        lines.append({"scale": name, **summary(results, len(samples))})
        rows += [{"scale": name, **vars(one)} for one in results]
    ratios = [e.gsd.value / true_scale(s).gsd.value for s, e in zip(samples, estimated, strict=True) if e is not None]
    return {
        "format": LOCATING_FORMAT,
        "photos": len(samples),
        "satellite": str(search.satellite.source.path),
        "method": search.method,
        "fleet": fleet.code,
        "near_m": NEAR_M,
        "far_m": FAR_M,
        "used_ratio": len(ratios) / len(samples),
        "estimated_over_true": None if not ratios else [float(q) for q in np.percentile(ratios, [5, 50, 95])],
        "success": lines,
        "notes": [*notes, *search.notes],
        "version": __version__,
        "rows": [row | {"error": None if np.isinf(row["error"]) else round(row["error"], 2)} for row in rows],
    }


def _found(each: PlacedSample, outcome: LocateOutcome) -> LocateTrial:
    name = each.sample.photo.name
    if outcome.registration is None or not outcome.registration.candidates:
        return LocateTrial(name, float("inf"), False)
    below = foot(outcome.registration.candidates[0])
    error = float(pyproj.Geod(ellps="WGS84").inv(*each.lon_lat, *below)[2])
    return LocateTrial(name, error, outcome.located is not None)


def summary(results: Sequence[LocateTrial], photos: int) -> dict[str, Any]:
    """One line of the table, as shares of all `photos`: the best candidate within NEAR_M and FAR_M, good enough or not;
    answers, and right answers; and the number of wrong answers (beyond FAR_M)."""
    error = np.array([each.error for each in results])
    answered = np.array([each.answered for each in results], bool)
    return {
        "searched": len(results),
        "best_near": float((error < NEAR_M).sum() / photos),
        "best_far": float((error < FAR_M).sum() / photos),
        "answered": float(answered.sum() / photos),
        "near": float((answered & (error < NEAR_M)).sum() / photos),
        "far": float((answered & (error < FAR_M)).sum() / photos),
        "wrong": int((answered & (error >= FAR_M)).sum()),
    }


def table(text: Mapping[str, Any]) -> list[str]:
    """The curve as lines for a terminal."""
    near, far = f"{NEAR_M:g} m", f"{FAR_M:g} m"
    heads = ("scale", "searched", f"best {near}", f"best {far}", "answered", near, far, "wrong")
    lines = ["".join(f"{head:>11s}" for head in heads)]
    for each in text["success"]:
        shares = [f"{100 * each[k]:.0f} %" for k in ("best_near", "best_far", "answered", "near", "far")]
        cells = [each["scale"], str(each["searched"]), *shares, str(each["wrong"])]
        lines.append("".join(f"{cell:>11s}" for cell in cells))
    lines.append(f"used       {100 * text['used_ratio']:.0f} % of {text['photos']} photos have enough vehicles")
    if text["estimated_over_true"] is not None:
        low, middle, high = text["estimated_over_true"]
        lines.append(f"ratio      estimated over true scale {middle:.3f} in the median ({low:.3f} to {high:.3f})")
    lines += [f"note       {note}" for note in text["notes"]]
    return lines
