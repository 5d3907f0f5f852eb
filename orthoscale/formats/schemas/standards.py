"""A user's standards of anchors, and facilities with their painted lines."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from .values import Name, Text


class AnchorStandard(Struct, forbid_unknown_fields=True):
    """The standard size of one kind of anchor, and its one sigma [m]."""

    kind: Name
    metres: Annotated[float, Meta(gt=0, lt=1e4)]
    name: Name = "your own"
    sd: Annotated[float, Meta(gt=0, lt=1e4)] | None = None
    source: Text = ""

    def __post_init__(self) -> None:
        if self.sd is not None and self.sd >= self.metres:
            raise ValueError("sd: expected less than the metres")


class AnchorStandards(Struct):
    """A user's file of standards."""

    standards: list[AnchorStandard]


Extent = Annotated[float, Meta(gt=0, le=10_000)]  # [m]
RunOff = Annotated[float, Meta(ge=0, le=10_000)]
Colour = Annotated[int, Meta(ge=0, le=255)]
Line = Annotated[list[str | Annotated[float, Meta(ge=-10_000, le=10_000)]], Meta(min_length=1, max_length=10)]


class FacilityEntry(Struct):
    """One of ``data/facilities.json`` or of a user's catalogue; see `layout.catalogue`."""

    name: Text
    source: Text
    length: Extent
    width: Extent
    ends: RunOff = 0.0
    sides: RunOff = 0.0
    north_south: bool = False
    shape: Name = ""
    lines: list[Line] = []
    both_ends: list[Line] = []
    infield: Name | None = None
    look: Text | UnsetType = UNSET
    colour: tuple[Colour, Colour, Colour] | UnsetType = UNSET

    def __post_init__(self) -> None:
        if self.length < self.width:
            raise ValueError("expected a length of no less than the width")


class Catalogue(Struct):
    """A user's facilities by their code."""

    facilities: dict[str, FacilityEntry]
