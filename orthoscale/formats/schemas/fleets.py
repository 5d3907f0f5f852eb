"""Fleets of vehicles, and calibrations."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from ...core.market_segments import AXES
from .networks import RulerEntry
from .values import Metres, Name, Sigma, Text, Weight

Sizes = tuple[Metres, Sigma]  # mean and one sigma between vehicles
Country = Annotated[str, Meta(pattern="^[A-Z]{2}$")]  # ISO 3166
Correlation = Annotated[float, Meta(gt=-1, lt=1)]


WIDEST = 0.5  # largest sigma of a size, as a share of it: sizes must be positive


def _check_sizes(entry: FleetEntry | MixturePart) -> None:
    for axis in AXES:
        mean, sd = getattr(entry, axis)
        if sd > WIDEST * mean:
            raise ValueError(f"{axis}: expected a mean and a sigma of at most half of it")
    if entry.length[0] < entry.width[0]:
        raise ValueError("length: expected no less than the width")


class MixturePart(Struct, rename={"class_": "class"}):
    """One class of a mixture: mean and one sigma of its sizes [m], and its weight, a share of the fleet."""

    class_: Name
    length: Sizes
    width: Sizes
    height: Sizes
    weight: Weight = 1.0
    corr_LW: Correlation | UnsetType = UNSET


class FleetEntry(Struct):
    """An entry of ``data/fleets.json``, and a user's file; see `core.fleet.Fleet`."""

    name: Text
    source: Text
    length: Sizes
    width: Sizes
    height: Sizes
    mean_sd: tuple[Sigma, Sigma, Sigma]
    shares: dict[str, Weight] | UnsetType = UNSET
    mixture: list[MixturePart] | None = None
    corr_LW: Correlation | UnsetType = UNSET
    year: Annotated[int, Meta(ge=0, le=9999)] = 0
    shares_source: Text = ""
    country: Country | UnsetType = UNSET

    def __post_init__(self) -> None:
        _check_sizes(self)
        for part in self.mixture or ():
            _check_sizes(part)
        for axis, sd in zip(AXES, self.mean_sd, strict=True):
            if sd > WIDEST * getattr(self, axis)[0]:
                raise ValueError(f"mean_sd: expected at most half of the {axis}")
        if self.shares is not UNSET and not sum(self.shares.values()) > 0:
            raise ValueError("expected shares with at least one above zero")
        if self.mixture and not sum(part.weight for part in self.mixture) > 0:
            raise ValueError("expected a mixture with at least one weight above zero")


class CalibrationEntry(Struct):
    """`core.calibration.Calibration`."""

    kind: Literal["orthoscale calibration 1"]
    detector: Text
    detector_sha256: Name
    ruler: RulerEntry
    fleet: FleetEntry | None
    made_from: dict[str, Any]
