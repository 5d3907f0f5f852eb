"""Decides by their names which classes of a detector or a file are small vehicles."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from ..tables import known_objects

# Names of the vehicles that a fleet describes, in DOTA, DIOR, FAIR1M, VEDAI, xView, COWC, COCO and orthoscale.
SMALL_VEHICLES = frozenset(
    [
        "small vehicle", "vehicle", "light vehicle", "passenger vehicle", "small car", "car", "passenger car", "sedan",
        "hatchback", "suv", "pickup", "pick up", "pickup truck", "minivan", "taxi",
    ]
)  # fmt: skip

# DOTA v1.0 in MMRotate's order: MMDeploy writes class numbers without names, and its models are mostly trained on it.
DOTA = (
    "plane", "baseball-diamond", "bridge", "ground-track-field", "small-vehicle", "large-vehicle", "ship",
    "tennis-court", "basketball-court", "storage-tank", "soccer-ball-field", "roundabout", "harbor", "swimming-pool",
    "helicopter",
)  # fmt: skip


def is_vehicle(name: str, wanted: Iterable[str] = ()) -> bool:
    """Whether a class called `name` counts: if it is one of `wanted`, or without any, has the name of a small vehicle.

    Case, plural and separators do not matter: "Small_Vehicles" is "small-vehicle".
    """
    names = {plain(w) for w in wanted} or SMALL_VEHICLES
    return plain(name) in names


def vehicle_numbers(names: Sequence[str], wanted: Iterable[str] = ()) -> list[int]:
    """The numbers of the classes in `names` that count; `wanted` may hold numbers too."""
    wanted = list(wanted)
    return [k for k, name in enumerate(names) if is_vehicle(name, wanted) or str(k) in wanted]


def object_numbers(names: Sequence[str]) -> dict[str, list[int]]:
    """The numbers of the classes in `names` that are objects of standard size, by kind."""
    numbers = {kind: [k for k, name in enumerate(names) if plain(name) == plain(kind)] for kind in known_objects()}
    return {kind: found for kind, found in numbers.items() if found}


def plain(name: str) -> str:
    """A class name without what does not distinguish classes: case, separators, the plural's s."""
    return re.sub(r"[^a-z0-9]+", " ", name.lower()).strip().removesuffix("s")
