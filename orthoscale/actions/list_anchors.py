"""All anchors of a source for visual inspection: as a list, as pictures, and as a GIS layer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..core.measuring.anchors import FoundAnchors
from ..core.progress import Progress
from ..core.scale import Scale
from ..core.source import Source
from ..errors import TooLittleEvidence, UsageError
from ..formats.names import write_json
from ..option import positive
from ..report.anchor_sheet import draw_anchors
from ..report.anchors import entries, write_anchor_layer
from ..requests import EstimateRequest
from ..sources.country import country_of, named_fleet
from .anchors import MOST_SOUGHT, Wanted, anchors_at, look_for_anchors, own_standards
from .boxes import effort_of
from .estimate import footing_of, measured
from .opening import source_of

# Options that have an effect where the scale is given by --scale.
WITH_A_SCALE = ("fleet", "images", "ground_cloud", "anchors", "anchor", "workers", "cache")
FORMAT_OF_LISTS = "orthoscale anchors 1"
FILES_OF_LISTS = (".png", ".json", ".gpkg")
OTHER_FORMS = (".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".gif", ".pdf", ".svg", ".html", ".csv", ".txt",
               ".geojson", ".shp", ".dxf", ".kml")  # fmt: skip
"""Endings that nobody gives to a folder."""


@dataclass(frozen=True)
class AnchorList:
    """The anchors found in a source, and the scale used for the search [m per unit]; `scale` is None if that was given
    by the user."""

    source: Source
    searched: FoundAnchors
    metres_per_unit: float
    scale: Scale | None

    def document(self) -> dict[str, Any]:
        """As plain values, the anchors as in a report."""
        kinds = {vote.anchor.kind for vote in self.searched.votes}
        return {
            "format": FORMAT_OF_LISTS,
            "input": str(self.source.path),
            "unit": self.source.unit,
            "scale": self.metres_per_unit,
            "told": self.scale is None,
            "anchors": entries(self.searched.votes, self.metres_per_unit, kinds),
            "notes": [*self.searched.notes],
        }

    def write(self, folder: Path) -> None:
        """Write anchors.json, anchors.png, and for an orthophoto anchors.gpkg into an empty folder. Raises
        OutputError."""
        for form in (".json", ".png", *([".gpkg"] if self.source.plan is not None and self.searched.votes else [])):
            self.write_one(folder / f"anchors{form}")

    def write_one(self, path: Path) -> None:
        """Write `path` in the format of its ending, one of FILES_OF_LISTS. Raises OutputError; UsageError for a GIS
        layer of a model, TooLittleEvidence for a layer without anchors."""
        told = self.document()
        if path.suffix.lower() == ".json":
            write_json(told, path)
        elif path.suffix.lower() == ".png":
            draw_anchors(told["anchors"], self.source, path)
        else:
            if self.source.plan is None:
                raise UsageError(f"{path.name}: only orthophotos have a layer of anchors", "Write .json or .png.")
            if not told["anchors"]:
                raise TooLittleEvidence(f"{path.name}: no anchors were found for the layer", "Write .json or .png.")
            place = self.source.place(self.metres_per_unit, keep_origin=True)
            write_anchor_layer(told["anchors"], place, path)


def one_file(out: Path) -> bool:
    """Whether `out` names one file of a list rather than a folder for all of them. Raises UsageError for a picture or
    a table in a format that is not written."""
    form = out.suffix.lower()
    if form in OTHER_FORMS:
        raise UsageError(
            f"--out {out}: a list of anchors is not written as {form}",
            f"Name a folder for all of its files, or one file: {', '.join(FILES_OF_LISTS)}.",
        )
    return form in FILES_OF_LISTS


def list_anchors(
    path: str | Path | Source, request: EstimateRequest, scale: float | None = None, progress: Progress | None = None
) -> AnchorList:
    """All anchors in the input at `path` of the kinds that `request` names, everywhere in it.

    scale : rough metres per unit of the source, correct to 10 %; by default the scale at which `estimate` looks for
    them, so that the anchors its result rests on are in the list. Raises what `estimate` raises.
    """
    own = own_standards(request.anchor)
    effort = replace(effort_of(request), exhaustive=True)
    if scale is None:
        if request.vehicles_only:
            raise UsageError("--estimator iqr is the paper's, for vehicles only", "Remove --estimator.")
        result = measured(path, request, progress)
        by_vehicles = result.anchors.without or result.scale  # at another scale, other anchors might be found
        country = result.method.country
        footing = footing_of(result.source, result.detections, result.fleet)
        wanted = Wanted(request.anchors, own, country, effort, progress, footing)
        found = look_for_anchors(result.source, by_vehicles, wanted)
        return AnchorList(result.source, found, by_vehicles.value, by_vehicles)
    scale = positive("--scale", scale)
    request.refuse_others(WITH_A_SCALE, "--scale says how large the input is: no vehicles are measured")
    source = source_of(path, request, progress=progress)
    request.check_for(source)
    country = country_of(source, named_fleet(request.fleet, None))
    found = anchors_at(source, scale, MOST_SOUGHT / 4, Wanted(request.anchors, own, country, effort, progress))
    return AnchorList(source, found, scale, None)
