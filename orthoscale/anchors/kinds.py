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
    """finder : in which module of this package, and by what name, such as "courts:TENNIS": an `AnchorFinder`, or what
    makes one when it is called; if it takes `standards`, it looks for other sizes than its own, too.
    proven : whether it is looked for by default: its false finds were counted (docs/anchors.md).
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

ALL, NO_KIND, PROVEN = "all", "none", "proven"  # choices beside kinds: of `--anchors`


def slug(kind: str) -> str:
    """A kind as it is written on the command line: ``tennis-court``."""
    return kind.replace(" ", "-")


def chosen(choices: Sequence[str], own: Collection[str] = ()) -> list[str]:
    """The kinds with a finder that `choices` of `--anchors` mean, and those of a user's `own` standards, in the order
    of the table."""
    if NO_KIND in choices:
        return []
    return [
        kind
        for kind, about in ANCHOR_KINDS.items()
        if kind in own or ALL in choices or slug(kind) in choices or (PROVEN in choices and about.proven)
    ]


def finder(kind: str, own: Mapping[str, tuple[Standard, ...]]) -> AnchorFinder:
    """The finder of a kind, which looks for the user's `own` standards of it where there are some."""
    module, _, name = ANCHOR_KINDS[kind].finder.partition(":")
    found = getattr(import_module(f".{module}" if "." not in module else module, __package__), name)
    if callable(found) and kind in own and "standards" in inspect.signature(found).parameters:
        found = found(standards=own[kind])
    elif callable(found):
        found = found()
    made: AnchorFinder = found
    return made
