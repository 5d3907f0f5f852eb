"""The parts of the uncertainty of a scale, and what would halve it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .control import READING_SD
from .fleet import WORLD

MEANINGS = {
    "sampling": "the sizes of vehicles scatter, and their number is limited",
    "fleet": "the mean size of the vehicles at that place is uncertain",
    "margin": "box bias: how much boxes over- or undershoot vehicles varies from scene to scene",
    "geometry": "the height of the ground under the vehicles, and up to what height boxes enclose them",
    "drift": "the scale changes from place to place",
    "squeeze": "pixels are not square on the ground: lengths differ along x and along y",
    "conflict": "measurements that contradict each other",
    "known distance": "the known distance itself",
    "ground control": "the control points themselves",
    "GPS positions": "the receiver's errors drift, the flight covers a limited area, and the model may be bent",
    "map": "the match with the map, and what the map shows",
    "parking bays": "the width of parking bays at one place",
}
OF_AN_ANCHOR = "how well its size is known, and measured in the pictures"  # the meaning of any kind of anchor
# A country's mean is known about twice as well as the world's (fleet table: 2 to 3 % against 5.6 %).
COUNTRY_SHARE = 0.5
NOTABLE_SHARE = 0.05  # share of the variance below which a part is not worth a remedy
FINEST = 5e-4  # least relative one sigma that is asked of a known distance: 1 cm in KNOWN_METRES
# [m] length of the distance in the example. In coarse pictures it is the least multiple of this of which reading the
# two points takes at most half of the sigma.
KNOWN_METRES = 20.0


@dataclass(frozen=True)
class Part:
    """One part. relative_sd : one sigma, relative to the scale. share : of the variance."""

    name: str
    relative_sd: float
    share: float
    meaning: str


@dataclass(frozen=True)
class Remedy:
    """What would help. do : in words. leaves : relative one-sigma of the scale afterwards."""

    do: str
    leaves: float


@dataclass(frozen=True)
class Explanation:
    """relative_sd : of the scale. parts : of that, the largest first. remedies : the best first.
    halve : a sentence that says what would halve the uncertainty."""

    relative_sd: float
    parts: tuple[Part, ...]
    remedies: tuple[Remedy, ...]
    halve: str


def explain(parts: Mapping[str, float], vehicles_used: int, fleet: str, pixel: float = 0.0) -> Explanation:
    """Explains the `parts` of a scale's uncertainty (relative one-sigmas), given its vehicles and its fleet's code.

    pixel : size of a pixel in which distances are read [m]; 0 if they are given in coordinates.
    """
    variance = float(sum(sd**2 for sd in parts.values()))
    if not variance:  # by the paper's estimator, which knows nothing but the scatter of the vehicles
        return Explanation(0.0, (), (), "The vehicles are all of one size, and nothing else is taken as uncertain.")
    share = {name: sd**2 / variance for name, sd in parts.items()}
    named = tuple(
        Part(name, parts[name], share[name], MEANINGS.get(name, OF_AN_ANCHOR))
        for name in sorted(parts, key=lambda name: -parts[name])
        if parts[name] > 0
    )
    total = float(np.sqrt(variance))
    if "conflict" in parts:
        first = "First find out which measurement is wrong: more of them do not help while two contradict each other."
        return Explanation(total, named, (), first)
    removable = {
        f"measure four times as many vehicles ({4 * vehicles_used} instead of {vehicles_used})": ("sampling", 0.75),
        "use a detector with half the box bias": ("margin", 0.75),
        "use steeper views, or more ground points under the vehicles": ("geometry", 0.75),
        "straighten the input, or measure its parts separately": ("drift", 1.0),
    }
    if fleet == WORLD:
        removable["name the country (--fleet)"] = ("fleet", 1 - COUNTRY_SHARE**2)
    remedies = [
        Remedy(do, float(np.sqrt(max(variance - part * parts[name] ** 2, 0))))
        for do, (name, part) in removable.items()
        if share.get(name, 0) > NOTABLE_SHARE
    ]
    remedies.sort(key=lambda remedy: remedy.leaves)
    return Explanation(total, named, tuple(remedies), _halve(variance, parts.get("drift", 0.0), remedies, pixel))


def _halve(variance: float, drift: float, remedies: list[Remedy], pixel: float) -> str:
    """The sentence on what would halve the uncertainty. A measurement with one sigma s reduces a variance v to
    1 / (1 / v + 1 / s^2), but does not remove drift. So v, the variance without drift, must fall to a quarter of the
    whole variance less that of the drift."""
    total = np.sqrt(variance)
    best = "; ".join(remedy.do for remedy in remedies if remedy.leaves <= total / 2)
    rest, left = variance - drift**2, variance / 4 - drift**2
    if left <= 0:
        alone = f"this alone would: {best}" if best else "nothing below would do so alone"
        return f"No known distance halves it while the scale drifts; {alone}."
    needed = float(1 / np.sqrt(1 / left - 1 / rest))
    if needed < FINEST:
        return "It is known as well as pictures can be measured: no known distance would halve it."
    reading = np.sqrt(2) * READING_SD * pixel
    metres = KNOWN_METRES * max(np.ceil(2 * reading / needed / KNOWN_METRES), 1)
    across = f"{metres:g} m known to {100 * np.sqrt((metres * needed) ** 2 - reading**2):.0f} cm"
    halve = f"A known distance good to {100 * needed:.1f} % would halve it ({across}: --known-distance)"
    if not remedies:
        return halve + "."
    return halve + (f"; so would this alone: {best}." if best else "; nothing below would do so alone.")
