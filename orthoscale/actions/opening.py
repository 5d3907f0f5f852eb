"""Opens the inputs of a request: the source, its fleet, and what the user knows of its scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.anchors import Standard
from ..core.calibration import Calibration
from ..core.evidence import Evidence
from ..core.fleet import Fleet
from ..core.measuring.footing import BY_POINTS, Footing
from ..core.progress import Progress
from ..core.source import GpsScale, Source
from ..formats.calibration import load_calibration
from ..requests import EstimateRequest
from ..sources.country import fleet_at, named_fleet
from ..sources.location import location_of
from ..sources.opening import AN_INPUT, open_source
from ..system.paths import path_of
from .anchors import own_standards
from .control import read_control, read_distance

if TYPE_CHECKING:
    from ..sources.satellite import Satellite


@dataclass(frozen=True)
class Opened:
    """The inputs of a request, opened and checked against each other, before anything is measured.

    why : notes on how the fleet was chosen, if the user did not name it. given : the user's evidence on the scale, and
    that of the frames' GPS positions. own : the user's standards for anchors, by kind. satellite : the map that the
    source is compared with.
    """

    source: Source
    fleet: Fleet
    why: tuple[str, ...]
    calibration: Calibration | None
    given: tuple[Evidence, ...]
    own: Mapping[str, tuple[Standard, ...]]
    satellite: Satellite | None = None


def source_of(
    path: str | Path | Source, request: EstimateRequest, progress: Progress | None = None, to_measure: bool = True
) -> Source:
    """The input at `path`, opened as `request` says, after its fleet was found to be one: an input may be large. A
    source is returned as it is. progress : for reading its dense cloud. to_measure : False if only its files count, not
    what its frames show. Raises InputError, UsageError."""
    if not isinstance(path, (str, Path)) and hasattr(path, "posed"):  # isinstance would read all that a source offers
        return path
    named_fleet(request.fleet, None)
    return open_source(
        path_of(path, AN_INPUT),
        request.images,
        need_images=to_measure and request.needs_pictures,
        ground_cloud=request.ground_cloud,
        progress=progress,
        compare_frames=to_measure,
    )


def opened(path: str | Path | Source, request: EstimateRequest, progress: Progress | None = None) -> Opened:
    """The input at `path`, with all files that `request` names. progress : for reading its dense cloud.

    Raises InputError, UsageError.
    """
    known = None if request.calibration is None else load_calibration(Path(request.calibration))
    named = named_fleet(request.fleet, known)
    source = source_of(path, request, progress)
    fleet, why = (named, ()) if named is not None else fleet_at(location_of(source))
    request.check_for(source)
    given, why = given_evidence(source, request), (*why, *_gps(source, request).notes)
    own = own_standards(request.anchor)
    return Opened(source, fleet, why, known, tuple(given), own, _satellite(request.against))


def given_evidence(source: Source, request: EstimateRequest, footing: Footing = BY_POINTS) -> list[Evidence]:
    """The evidence on the scale [m per unit] from the user and from the frames' tags, on the ground of `footing`.
    Raises UsageError, InputError."""
    given = [read_distance(text, source, footing) for text in dict.fromkeys(request.known_distance)]
    if request.ground_control is not None:
        given.append(read_control(Path(request.ground_control), source, footing))
    return [*given, *_gps(source, request).evidence]


def _gps(source: Source, request: EstimateRequest) -> GpsScale:
    """The scale from the GPS positions of frames, if there are any and they count."""
    return source.gps if source.posed is not None and request.counts_gps else GpsScale()


def _satellite(path: str | Path | None) -> Satellite | None:
    """The map at `path`. Raises InputError, UsageError."""
    if path is None:
        return None
    from ..sources.satellite import Satellite

    return Satellite.open(Path(path))
