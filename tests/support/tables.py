"""What the tables that are shipped consist of (`orthoscale/data`). The program reads them as they are."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from orthoscale.formats.schemas.fleets import Correlation, FleetEntry, Sizes
from orthoscale.formats.schemas.standards import Catalogue, Extent
from orthoscale.formats.schemas.values import Metres, Name, Sigma, Text


class Segment(Struct, rename={"class_": "class"}):
    """A market segment: its sizes [m] over `models` models on sale."""

    class_: Name
    length: Sizes
    width: Sizes
    height: Sizes
    corr_LW: Correlation
    models: Annotated[int, Meta(ge=1)]


class Fleets(Struct):
    """``fleets.json``."""

    segments: dict[str, Segment]
    fleets: dict[str, FleetEntry]


class ObjectStandard(Struct):
    """The standard size of one kind of object [m], and its source."""

    name: Text
    length: Sizes
    width: Sizes
    source: Text


class Objects(Struct):
    """``objects.json``."""

    objects: dict[str, list[ObjectStandard]]


class Stall(Struct):
    """The size of a country's parking stalls, and one sigma of their width [m]. countries : where they are used, if the
    row's key is no country. documented : whether their source was found."""

    width: Metres
    width_sd: Sigma
    length: Metres
    source: Text
    countries: list[str] = []
    documented: bool = True


class Stalls(Struct):
    """``stalls.json``."""

    stalls: dict[str, Stall]


class Aisle(Struct):
    """The aisle between parking bays of one country [m]."""

    aisle: Extent
    source: Text


class Facilities(Catalogue):
    """``facilities.json``."""

    parking: dict[str, Aisle]


TABLES = {"fleets": Fleets, "objects": Objects, "stalls": Stalls, "facilities": Facilities}
