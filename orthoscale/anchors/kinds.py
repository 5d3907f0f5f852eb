"""The table of anchor kinds and their finders. A finder's module is imported when its kind is searched for."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..core.anchors import AnchorFinder, Standard


@dataclass(frozen=True)
class Kind:
    """finder : module of this package and name in it, such as "courts:TENNIS". It is an `AnchorFinder`, or a callable
    that makes one; if the callable takes `standards`, the finder can look for a user's own sizes, too.
    proven : whether the kind is looked for by default, as its false finds were counted (docs/anchors.md).
    """

    finder: str
    proven: bool = False


ANCHOR_KINDS: dict[str, Kind] = {
    "tennis court": Kind("courts:TENNIS", proven=True),
    "volleyball court": Kind("courts:VOLLEYBALL"),
    "basketball court": Kind("courts:BASKETBALL"),
    "handball court": Kind("courts:HANDBALL"),
    "padel court": Kind("padel:PadelCourts"),
    "football pitch": Kind("courts:FOOTBALL"),
    "gridiron": Kind("gridiron:Gridirons"),
    "running track": Kind("running:RunningTracks"),
    "track oval": Kind("ovals:TrackOvals"),
    "railway track": Kind("rails:RailTracks"),
    "zebra crossing": Kind("crossings:ZebraCrossings", proven=True),
    "lane dashes": Kind("dashes:LaneDashes", proven=True),
    "parking bays": Kind("bays:ParkingBays", proven=True),
    "container": Kind("containers:ContainerRows"),
}

ALL, NO_KIND, PROVEN = "all", "none", "proven"  # choices of `--anchors` beside kinds


def slug(kind: str) -> str:
    """A kind as it is written on the command line: ``tennis-court``."""
    return kind.replace(" ", "-")


def chosen(choices: Sequence[str], own: Collection[str] = ()) -> list[str]:
    """The kinds with a finder that `choices` of `--anchors` select, and those of a user's `own` standards, in the order
    of the table."""
    if NO_KIND in choices:
        return []
    return [
        kind
        for kind, about in ANCHOR_KINDS.items()
        if kind in own or ALL in choices or slug(kind) in choices or (PROVEN in choices and about.proven)
    ]


def finder(kind: str, own: Mapping[str, tuple[Standard, ...]]) -> AnchorFinder:
    """The finder of a kind; it looks for the user's `own` standards of that kind, if any."""
    module, _, name = ANCHOR_KINDS[kind].finder.partition(":")
    found = getattr(import_module(f".{module}" if "." not in module else module, __package__), name)
    if callable(found) and kind in own and "standards" in inspect.signature(found).parameters:
        found = found(standards=own[kind])
    elif callable(found):
        found = found()
    made: AnchorFinder = found
    return made
