"""Locates photos on a map: finds the place where each was taken."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.brief import Brief
from ..core.progress import Progress
from ..errors import OrthoscaleError, TooLittleEvidence, UsageError
from ..locate.claimed import ClaimedScale, claimed_scales
from ..locate.features import Features, GradientFeatures
from ..locate.files import write
from ..locate.outcome import LocateOutcome, document
from ..locate.register import Known, PlaceFinder, register
from ..photos.folders import find_photos
from ..photos.looking import WITH_GSD, Looking
from ..photos.photo import GivenCamera
from ..requests import LOCATE_METHODS
from ..sources.satellite import Satellite

ANY_HEADING = "search"  # value of --heading for any heading
CANDIDATES_LISTED = 5  # number of candidates in the results


@dataclass(frozen=True, kw_only=True)
class LocateRequest:
    """The options of a search.

    prior : "LON,LAT,RADIUS", or "X,Y,RADIUS" in the map's reference system; radius in metres. heading : degrees
    clockwise from north, or "search" for any; None: `Tags.heading`, else any. gsd : average ground sampling distance of
    the photos [m/px], None to measure it by vehicles. method : one of LOCATE_METHODS. embedding, embedding_map :
    networks for `retrieval`. top : number of candidates listed. cache : keep the map's features. lens : what the user
    says of the camera. Raises UsageError.
    """

    prior: str | None = None
    heading: str | None = None
    gsd: float | None = None
    method: str = "auto"
    embedding: Path | None = None
    embedding_map: Path | None = None
    top: int = CANDIDATES_LISTED
    cache: bool = True
    lens: GivenCamera = field(default_factory=GivenCamera)
    looking: Looking = field(default_factory=Looking)

    def __post_init__(self) -> None:
        if self.method not in LOCATE_METHODS:
            raise UsageError(f"--method {self.method} is not one of {', '.join(LOCATE_METHODS)}")
        if self.embedding_map is not None and self.embedding is None:
            raise UsageError("--embedding-map is the second of two networks", "Give the one for photos: --embedding.")
        if self.embedding is not None and self.method not in ("auto", "retrieval"):
            raise UsageError(f"--embedding does nothing with --method {self.method}", "Take --method retrieval.")
        if self.embedding is None and self.method == "retrieval":
            raise UsageError("--method retrieval needs a network", "Give it: --embedding NET.onnx.")
        if self.gsd is not None:
            self.looking.refuse_others((), WITH_GSD)
        self.heading_rad(None)

    def heading_rad(self, told: float | None) -> float | None:
        """The heading to search around [rad], None for all; `told` is the heading in the photo's tags [deg]. Raises
        UsageError for a --heading that is no direction."""
        if self.heading is None:
            return None if told is None else float(np.radians(told))
        if self.heading == ANY_HEADING:
            return None
        try:
            degrees = float(self.heading)
        except ValueError:
            degrees = float("nan")
        if not -360 <= degrees <= 360:
            raise UsageError(f"--heading {self.heading} is neither a number of degrees nor {ANY_HEADING!r}")
        return float(np.radians(degrees))

    def prior_on(self, satellite: Satellite) -> tuple[float, float, float] | None:
        """Longitude, latitude [deg] and radius [m] of the prior. Raises UsageError."""
        if self.prior is None:
            return None
        try:
            x, y, radius = (float(v) for v in self.prior.split(","))
        except ValueError:
            raise UsageError(
                f"--prior {self.prior} is not LON,LAT,RADIUS or X,Y,RADIUS", "Such as --prior 8.54,47.38,1500."
            ) from None
        if not (np.isfinite([x, y]).all() and 0 < radius < np.inf):
            raise UsageError(f"--prior {self.prior}: it takes finite numbers, and the radius must be a positive one")
        if abs(x) <= 180 and abs(y) <= 90:
            return x, y, radius
        if satellite.crs.is_geographic:
            raise UsageError(
                f"--prior {self.prior} is not a longitude and latitude, the map's coordinates",
                "Give LON,LAT,RADIUS in degrees and metres.",
            )
        lon, lat = satellite.degrees(np.array([x, y]))[0].tolist()
        if not np.isfinite([lon, lat]).all():
            raise UsageError(
                f"--prior {self.prior} is not a place in {satellite.crs.name}",
                "Give LON,LAT,RADIUS, or X and Y in the map's own coordinates.",
            )
        return lon, lat, radius


@dataclass(frozen=True, repr=False)
class Located(Brief):
    """outcomes : one for each photo. satellite : the map. method : by which features. notes : for the user."""

    outcomes: list[LocateOutcome]
    satellite: Satellite
    method: str
    notes: tuple[str, ...] = ()
    top: int = CANDIDATES_LISTED

    def brief(self) -> list[tuple[str, str]]:
        """A line per photo."""
        lines = []
        for outcome in self.outcomes:
            best, problem = outcome.located, outcome.problem
            if best is None:
                lines.append((outcome.name, "" if problem is None else problem.message))
            else:
                lon, lat = best.lon_lat(np.zeros((1, 2)))[0]
                lines.append((outcome.name, f"{lon:.6f}, {lat:.6f}, {best.inliers} matches"))
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Plain values; what `orthoscale locate --json` prints."""
        return document(self.outcomes, self.satellite, {"method": self.method, "notes": list(self.notes)})

    def write(self, folder: Path) -> None:
        """Write all files into an empty folder; see `locate.files`."""
        write(self.outcomes, self.to_dict(), self.satellite, folder, self.top)


def features_for(method: str) -> Features:
    """The features by which `method` verifies candidates, and searches if it is not retrieval. Raises UsageError if
    their packages are not installed."""
    if method == "dense":
        from ..locate.dense import DenseFeatures

        return DenseFeatures()
    return GradientFeatures()


def finder_for(request: LocateRequest) -> tuple[str, PlaceFinder | None, tuple[str, ...]]:
    """The method that `request` selects, its place finder (None for correlation), and notes. Raises InputError."""
    if request.embedding is None:
        return "gradient" if request.method == "auto" else request.method, None, ()
    from ..locate.retrieval import Retrieval

    finder = Retrieval.open(request.embedding, request.embedding_map, request.cache)
    return "retrieval", finder, finder.notes


def locate(
    paths: Sequence[Path], satellite: Satellite, request: LocateRequest, progress: Progress | None = None
) -> Located:
    """Find the photos at `paths` on the map `satellite`.

    The outcome of a photo that is not located says why. Raises UsageError for a request that makes no sense, InputError
    for a damaged map or a single photo that cannot be read.
    """
    prior = request.prior_on(satellite)
    method, finder, notes = finder_for(request)
    features = features_for(method)
    photos = find_photos(paths)
    claims = claimed_scales(photos.paths, request.gsd, request.looking, progress, **request.lens)
    of_scales = [note for each in claims.values() if isinstance(each, ClaimedScale) for note in each.notes]
    outcomes = []
    for number, (name, claimed) in enumerate(claims.items(), 1):
        if isinstance(claimed, OrthoscaleError):
            outcomes.append(LocateOutcome(name, None, None, claimed))
            continue
        outcomes.append(searched(claimed, satellite, features, request, prior, finder))
        if progress:
            progress("Photos", number, len(claims))
    return Located(outcomes, satellite, method, (*notes, *photos.notes, *dict.fromkeys(of_scales)), request.top)


def searched(
    claimed: ClaimedScale,
    satellite: Satellite,
    features: Features,
    request: LocateRequest,
    prior: tuple[float, float, float] | None,
    finder: PlaceFinder | None = None,
) -> LocateOutcome:
    """The outcome for one photo; also for one that is too small on the map, so that the others go on."""
    photo = claimed.photo
    begun = time.monotonic()
    known = Known(claimed.factors, request.heading_rad(photo.tags.heading), prior)
    try:
        found = register(claimed.levelled, satellite, features, known, request.cache, finder=finder)
    except TooLittleEvidence as error:
        return LocateOutcome(photo.name, claimed, None, TooLittleEvidence(f"{photo.name}: {error.message}", error.hint))
    return LocateOutcome(photo.name, claimed, found, None, time.monotonic() - begun)
