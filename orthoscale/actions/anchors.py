"""Anchors in a source: which kinds are searched for, at what scale, and what was found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..anchors import kinds
from ..core.anchors import AnchorVote, Standard
from ..core.measuring.anchors import FoundAnchors, votes_in_model, votes_in_plan
from ..core.measuring.footing import BY_POINTS, Footing
from ..core.measuring.objects import in_words
from ..core.measuring.without_vehicles import FEWEST_KINDS
from ..core.normal import Z90
from ..core.progress import Progress, of_step
from ..core.scale import Scale
from ..core.source import GroundView, Picture, Source
from ..detect.effort import Effort
from ..errors import UsageError, shown
from ..formats.points import number
from ..formats.reading import reason
from ..requests import BOXED

BEYOND_SIGMAS = 2.0  # sizes are searched this many sigmas beyond the ends of the vehicles' 90 % interval
LEAST_SOUGHT, MOST_SOUGHT = 0.02, 0.2  # limits of the relative one-sigma passed to finders: what they are made for
OWN_SD = 0.005  # relative one-sigma of a user's own standard: bays are painted to a centimetre or two
FRAMES_EACH = 4  # frames of a model that show an anchor, about: its search ends after this many times more finds
LADDER = (0.03, 0.6)  # [m/px] range of scales tried when the scale is unknown: what drones and planes give
RUNG_SD = 0.1  # relative one-sigma of each scale tried: finders look two of them to either side
SAME_ON_RUNGS = 0.03  # finds at two scales of the ladder are one anchor if their sizes differ by less (relative)
STANDARD_HINT = (
    "Expected a kind and its size in metres: bay=2.5, or with its sigma bay=2.5,0.02; or a JSON file of standards, "
    "see docs/anchors.md."
)


def kinds_of_boxes(choices: Sequence[str]) -> set[str]:
    """The kinds of anchors that are measured by their boxes alone, of those that `choices` of `--anchors` allow."""
    every = set(map(in_words, BOXED))
    if kinds.NO_KIND in choices:
        return set()
    whole = {kinds.ALL, kinds.PROVEN} & set(choices)
    return every if whole else {kind for kind in every if kinds.slug(kind) in choices}


def own_standards(told: Sequence[str]) -> dict[str, tuple[Standard, ...]]:
    """A user's standards by kind, from options KIND=METRES[,SIGMA] and from files. Raises UsageError, InputError."""
    found: dict[str, tuple[Standard, ...]] = {}
    for text in told:
        more = _of_file(Path(text)) if text.lower().endswith(".json") else _of_words(text)
        for kind, standard in more:
            found[kind] = (*found.get(kind, ()), standard)
    return found


@dataclass(frozen=True)
class Wanted:
    """Which anchors are searched for, and how. choices : of `--anchors`. own : a user's standards by kind, which
    replace those of the finders. country : ISO code, empty if unknown. effort, progress : as in `find_vehicles`.
    footing : the ground of a reconstruction."""

    choices: Sequence[str]
    own: Mapping[str, tuple[Standard, ...]] = field(default_factory=dict)
    country: str = ""
    effort: Effort = Effort()
    progress: Progress | None = None
    footing: Footing = BY_POINTS

    @property
    def kinds(self) -> list[str]:
        """The kinds that the choices name."""
        return kinds.chosen(self.choices, self.own)


def look_for_anchors(source: Source, scale: Scale, wanted: Wanted) -> FoundAnchors:
    """The anchors in `source`, given the `scale` from its vehicles; see `anchors_at`."""
    low, high = scale.interval90
    sd = float(np.log(high / low)) / (2 * Z90)
    # Finders search two of their sigmas to either side.
    sd = float(np.clip((Z90 + BEYOND_SIGMAS) / 2 * sd, LEAST_SOUGHT, MOST_SOUGHT))
    return replace(anchors_at(source, scale.value, sd, wanted), without=scale)


def anchors_at(source: Source, metres_per_unit: float, sd: float, wanted: Wanted, share: float = 1.0) -> FoundAnchors:
    """The anchors in `source`, whose scale is roughly `metres_per_unit`, within twice its relative one-sigma `sd`. An
    orthophoto is searched as it is, a reconstruction in its ground pictures. share : of the usual effort."""
    from ..anchors.search import ENOUGH_ANCHORS, MOST_PIXELS, Sought, search

    views = _views(source) if wanted.kinds else {}
    if not views:
        return FoundAnchors()
    if source.plan is not None and source.claimed.aspect != 1:
        return FoundAnchors(notes=("no anchors were looked for: pixels are not square",))
    pictures = [(picture, metres_per_unit * unit) for picture, unit in views.values()]
    finest = min(gsd for _, gsd in pictures)
    sought, notes = [], []
    for kind in wanted.kinds:
        finder = kinds.finder(kind, wanted.own)
        if finest > finder.coarsest:
            notes.append(f"{kind}: too small to be seen at {finest:.2g} m/px, not looked for")
        else:
            sought.append(Sought(finder, pictures))
    found = search(
        sought,
        sd,
        wanted.country,
        wanted.effort,
        share * MOST_PIXELS,
        ENOUGH_ANCHORS * (1 if source.posed is None else FRAMES_EACH),
        of_step(wanted.progress, "Looking for anchors"),
    )
    if source.posed is not None:
        ground: dict[str, GroundView] = {view.name: view for view in source.ground_pictures}
        votes = votes_in_model(found, ground, source.centre, 4 * sd, wanted.footing)
    else:
        votes = votes_in_plan(found, 4 * sd)
    votes = [vote.of(wanted.own.get(vote.anchor.kind)) for vote in votes]
    return FoundAnchors(tuple(found), tuple(votes), notes=tuple(notes))


def at_any_scale(source: Source, rough: tuple[float, float] | None, wanted: Wanted, known: int = 0) -> FoundAnchors:
    """The anchors in `source`, whose scale is unknown: searched for at each scale of a ladder.

    rough : metres per unit and its relative one-sigma, if there is an estimate; else all of LADDER is tried. known :
    number of kinds of other evidence. Nothing is searched for if these and the anchors together are too few kinds.
    """
    units = [unit for _, unit in _views(source).values()]
    if not units or not wanted.kinds or len(wanted.kinds) + known < FEWEST_KINDS:
        return FoundAnchors()
    if rough is None:
        low, high = (math.log(gsd / float(np.median(units))) for gsd in LADDER)
    else:
        low, high = (math.log(rough[0]) + k * rough[1] for k in (-2, 2))
    count = max(1, math.ceil((high - low) / (4 * RUNG_SD)))
    edges = np.linspace(low, high, count + 1)
    found: dict[str, list[AnchorVote]] = {}
    scales = np.exp((edges[:-1] + edges[1:]) / 2).tolist()
    rungs = [anchors_at(source, scale, RUNG_SD, wanted, 1 / count) for scale in scales]
    for vote in (vote for rung in rungs for vote in rung.votes):
        found.setdefault(vote.anchor.kind, []).append(vote)
    votes = [vote for these in found.values() for vote in _one_thing_once(these, high - low)]
    every = tuple(anchor for rung in rungs for anchor in rung.anchors)
    # What is too small at the first scale, the finest, was never looked for; else there is nothing to say.
    return FoundAnchors(every, tuple(votes), notes=rungs[0].notes)


def _one_thing_once(votes: Sequence[AnchorVote], window: float) -> list[AnchorVote]:
    """Anchors of one kind; those found at several scales in one place and of one size are merged into one, with the
    standards of all."""
    kept: list[AnchorVote] = []
    for vote in sorted(votes, key=lambda v: (v.anchor.false, v.relative_sd)):
        for k, other in enumerate(kept):
            near = float(np.linalg.norm(vote.place - other.place)) < other.units / 2
            if near and abs(np.log(vote.units / other.units)) < SAME_ON_RUNGS:
                both = tuple(dict.fromkeys([*other.anchor.standards, *vote.anchor.standards]))
                unlike = set(other.anchor.unlike) & set(vote.anchor.unlike)
                kept[k] = replace(other, anchor=replace(other.anchor, standards=both, unlike=tuple(sorted(unlike))))
                break
        else:
            kept.append(replace(vote, window=window))
    return kept


def _views(source: Source) -> dict[str, tuple[Picture, float]]:
    """The pictures that show the ground from above, each with its source units per pixel, by name."""
    if source.plan is not None:
        return {source.name: (source, 1.0)}
    return {view.name: (view, view.unit_per_pixel) for view in source.ground_pictures if view.frame is not None}


def _of_words(text: str) -> list[tuple[str, Standard]]:
    name, _, figures = text.partition("=")
    try:
        metres, *sd = (number(word) for word in figures.split(","))
        if not 0 < metres < 1e4 or len(sd) > 1 or (sd and not 0 < sd[0] < metres):
            raise ValueError("expected positive metres, and at most one sigma")
    except (ValueError, OverflowError) as error:
        raise UsageError(f"--anchor {shown(text)!r}: {reason(error)}", STANDARD_HINT) from error
    return [(_kind(name), _standard("your own", metres, sd[0] if sd else None, "given by --anchor"))]


def _of_file(path: Path) -> list[tuple[str, Standard]]:
    from ..formats.reading import read
    from ..formats.schemas.standards import AnchorStandards

    entries = read(path, AnchorStandards, "a file of standards", STANDARD_HINT).standards
    return [(_kind(e.kind), _standard(e.name, e.metres, e.sd, e.source or str(path))) for e in entries]


def _standard(name: str, metres: float, sd: float | None, source: str) -> Standard:
    return Standard(name, metres, OWN_SD if sd is None else sd / metres, source)


def _kind(name: str) -> str:
    """The kind that a user's word means: its full name, or a part that occurs in no other name. Raises UsageError."""
    word = name.strip().lower().replace("-", " ").replace("_", " ")
    known = [*kinds.ANCHOR_KINDS]
    meant = [kind for kind in known if kind == word] or [kind for kind in known if word and word in kind]
    if len(meant) != 1:
        raise UsageError(
            f"--anchor: no kind of anchor is called {shown(name)!r}"
            if not meant
            else f"--anchor: {shown(name)!r} may be {' or '.join(meant)}",
            f"Kinds: {', '.join(map(kinds.slug, known))}.",
        )
    return meant[0]
