"""Vehicles: a full footprint up to the belt line, a narrower cabin above, and details that make them look like cars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .mesh import Colour, Mesh, at_height, disc, faces, join, loft, patch, prism, rectangle, rounded

GLASS = (0.012, 0.016, 0.02)
RUBBER = (0.012, 0.012, 0.012)
CHROME = (0.55, 0.56, 0.58)
RED = (0.3, 0.01, 0.01)

PAINTS = (
    # Share, then linear albedo: roughly as on the roads (white, black, grey, silver, blue, red, others).
    (0.26, (0.72, 0.72, 0.70)),
    (0.17, (0.012, 0.012, 0.013)),
    (0.13, (0.09, 0.095, 0.10)),
    (0.07, (0.035, 0.037, 0.04)),
    (0.14, (0.38, 0.39, 0.40)),
    (0.07, (0.02, 0.05, 0.16)),
    (0.02, (0.08, 0.22, 0.45)),
    (0.07, (0.30, 0.015, 0.02)),
    (0.03, (0.22, 0.17, 0.11)),
    (0.02, (0.02, 0.08, 0.04)),
    (0.01, (0.60, 0.40, 0.03)),
    (0.01, (0.55, 0.16, 0.02)),
)

# Bumpers and doors lean inwards and are dirty and shaded, so that real vehicles have soft edges. Measured by eye on
# pictures (training/by_hand.py), real ones of known mean size came out right, and those rendered with a shoulder of
# 0.22 m at 0.4 of the albedo came out 3 % too small.
SHOULDER = 0.13  # [m] from the footprint's edge to the decks
SHOULDER_SHADE = 0.45, 0.9  # least and largest share of the paint's albedo

# [m] Height at which bumpers reach furthest (49 CFR 581 tests them at 0.41 to 0.51 m), and height of the sills.
TUCKED_BELOW, SILL = 0.45, 0.18

CABINS = {
    # Where the rear window and the windscreen begin and end, as shares of the length from the rear bumper.
    "sedan": (0.15, 0.28, 0.56, 0.73),
    "hatch": (0.02, 0.10, 0.55, 0.73),
    "estate": (0.02, 0.08, 0.57, 0.72),
    "suv": (0.02, 0.07, 0.56, 0.71),
    "van": (0.01, 0.03, 0.68, 0.84),
    "pickup": (0.39, 0.43, 0.58, 0.71),
}


@dataclass(frozen=True)
class Bed:
    """The bed of a pickup, behind its cab.

    share : of the length, from the rear bumper to the cab: about 0.3 behind two rows of doors, 0.42 behind one.
    cover : None for an open bed; else the albedo of a lid at the rim, or of a cap as high as the cab.
    cap : whether the cover is a cap. floor : albedo of an open bed's floor and walls.
    depth : of that floor below the rim [m]; at 0 it is drawn on the deck. loads : number of things that lie in it.
    """

    share: float = 0.39
    cover: Colour | None = None
    cap: bool = False
    floor: Colour = (0.03, 0.03, 0.032)
    depth: float = 0.0
    loads: int = 0


Profile = Callable[[np.ndarray], np.ndarray]
"""Height [m] over the vehicle's own x [m]."""


@dataclass(frozen=True)
class Vehicle:
    """One vehicle on the ground z = 0.

    x, y : centre of the footprint [m]. heading : of its front, counter-clockwise from +x [rad].
    length, width, height : [m], without mirrors, as in fleets.
    shoulder : how far bumpers and doors stand out from the decks [m]. corner : factor on the plan's corner radii.
    bumpers : albedo of the rear and the front bumper, None if painted like the body.
    bed : of a pickup. tucked : how far ends and sides recede from TUCKED_BELOW down to the sills [m].
    """

    x: float
    y: float
    heading: float
    length: float
    width: float
    height: float
    shape: str = "hatch"
    paint: tuple[float, float, float] = PAINTS[0][1]
    shoulder: float = SHOULDER
    corner: float = 1.0
    bumpers: tuple[Colour | None, Colour | None] = (None, None)
    bed: Bed = Bed()
    tucked: tuple[float, float] = (0.0, 0.0)

    @property
    def belt(self) -> float:
        """Height of bonnet and boot where they meet the cabin [m]; the hull fills the footprint up to 0.7 of it."""
        return float(np.clip(0.56 * self.height, 0.7, 1.05))

    @property
    def footprint(self) -> np.ndarray:
        """(4, 2) [m] corners on the ground."""
        return self._placed(rectangle(self.length, self.width))

    @property
    def hull(self) -> np.ndarray:
        """(28, 3) [m] corners of the hull: the footprint's outline at 0.2 m and where the shoulder begins, the roof."""
        outline, roof = self._outline(), self._roof()
        low, high = (at_height(self._placed(outline), z) for z in (0.2, 0.7 * self.belt))
        return np.concatenate([low, high, at_height(self._placed(roof), self.height)])

    def _placed(self, plan: np.ndarray) -> np.ndarray:
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return plan @ np.array([[cos, sin], [-sin, cos]]) + [self.x, self.y]

    def _outline(self, inset: float = 0.0) -> np.ndarray:
        """(12, 2) [m] the footprint with rounded corners, in the vehicle's own coordinates (x ahead)."""
        front, rear = (0.12, 0.08) if self.shape == "van" else (0.28, 0.22)
        front, rear = (share * self.corner * self.width for share in (front, rear))
        return rounded(self.length - 2 * inset, self.width - 2 * inset, front, rear)

    def _stations(self) -> np.ndarray:
        """(4,) x of the rear window's foot and head, the windscreen's head and foot [m]."""
        stations = np.array(CABINS[self.shape])
        if self.shape == "pickup":
            stations[:2] += self.bed.share - stations[0]
        return (stations - 0.5) * self.length

    def _roof(self) -> np.ndarray:
        """(4, 2) [m] plan of the roof."""
        _, rear, front, _ = self._stations()
        taper = 0.08 if self.shape == "van" else 0.15
        return rectangle(front - rear, self.width - 2 * taper) + [(front + rear) / 2, 0]

    def mesh(self, rng: np.random.Generator) -> Mesh:
        """The vehicle's faces; `rng` chooses trim (roof rails, sunroof, dark roof)."""
        length, belt = self.length, self.belt
        rear_foot, _, _, screen_foot = self._stations()
        paint = np.array(self.paint)
        nose = 0.8 if self.shape not in ("van", "suv", "pickup") else 0.9

        def deck(x: np.ndarray) -> np.ndarray:
            """Height of the bonnet and boot: level to the windscreen, then falling to the nose."""
            return belt * (1 - (1 - nose) * np.clip((x - screen_foot) / (length / 2 - screen_foot), 0, 1) ** 2)

        full, shoulder = self._outline(), self._outline(self.shoulder)
        waist = at_height(full, 0.7 * deck(full[:, 0]))
        rim = at_height(shoulder, deck(shoulder[:, 0]))
        parts = [
            loft(self._low(full, SILL), self._low(full, 0.32), "paint", np.minimum(paint, 0.03)),
            loft(self._low(full, 0.32), self._low(full, TUCKED_BELOW), "paint", paint, 0.5),
            loft(self._low(full, TUCKED_BELOW), waist, "paint", paint, 0.5),
        ]
        parts += self._decks(rng, shoulder, deck, paint)
        parts += self._cabin(rng, paint, rear_foot, screen_foot)
        parts += self._trim(rng, deck, paint, screen_foot)
        parts += self._wheels()
        shade = np.tile(rng.uniform(*SHOULDER_SHADE) * paint, (len(full), 1))
        facing = np.roll(full, -1, 0) - full  # an edge that runs across faces one of the ends
        across = np.abs(facing[:, 1]) > np.abs(facing[:, 0])
        for end, bumper in zip((full[:, 0] < 0, full[:, 0] > 0), self.bumpers, strict=True):
            if bumper is not None:
                shade[across & end] = bumper
        parts.append(loft(waist, rim, "paint", shade, 0.5))
        return join(parts).placed(self.x, self.y, self.heading)

    def _low(self, outline: np.ndarray, z: float) -> np.ndarray:
        """(n, 3) the body's `outline` (n, 2) at height `z` below its waist, where it may be tucked in."""
        share = np.clip((TUCKED_BELOW - z) / (TUCKED_BELOW - SILL), 0, 1)
        return at_height(outline * (1 - 2 * share * np.array(self.tucked) / (self.length, self.width)), z)

    def _wheels(self) -> list[Mesh]:
        """Tyres and rims, as discs a few millimetres outside the body's sides, set in by half of what these recede."""
        half = self.width / 2 - self.tucked[1] / 2
        parts = []
        for axle in (-0.30 * self.length, 0.31 * self.length):
            for side in (-1, 1):
                for radius, out, colour in ((0.34, 0.004, RUBBER), (0.21, 0.008, (0.2, 0.2, 0.21))):
                    turn, up = disc(radius, 8).T
                    wheel = np.stack([axle - side * turn, np.full(8, side * (half + out)), 0.34 + up], 1)
                    parts.append(faces(wheel, "paint", colour, 0.1))
        return parts

    def _decks(self, rng: np.random.Generator, shoulder: np.ndarray, deck: Profile, paint: np.ndarray) -> list[Mesh]:
        """Bonnet, boot or bed: the top of the lower body, cut across into flat strips."""
        stations = self._stations()
        cuts = [-self.length / 2, stations[3], (stations[3] + self.length / 2) / 2, self.length / 2]
        plans = [between(shoulder, low, high) for low, high in pairwise(cuts)]
        parts = []
        if self.shape == "pickup":
            rim = self.shoulder + 0.05 if self.bed.depth else 0.0  # a sunken floor lies within the decks
            x0, x1 = -self.length / 2 + max(0.12, rim), stations[0] - 0.06
            bed = rectangle(x1 - x0, self.width - 2 * max(0.18, rim)) + [(x0 + x1) / 2, 0]
            if self.bed.depth:
                plans[:1] = around(plans[0], bed)
            parts = self._bed(rng, bed)
        decks = [faces(at_height(plan, deck(plan[:, 0])), "paint", paint, 0.7) for plan in plans]
        return decks + parts

    def _bed(self, rng: np.random.Generator, plan: np.ndarray) -> list[Mesh]:
        """A pickup's bed over `plan` (4, 2), counter-clockwise: its floor with its load, and its cover."""
        bed, parts = self.bed, []
        bottom = self.belt - bed.depth
        if bed.depth:
            # The ring is clockwise, so that the walls face inwards.
            parts = [loft(at_height(plan[::-1], bottom), at_height(plan[::-1], self.belt), "paint", bed.floor)]
        parts.append(patch(plan, bottom + 0.012, "corrugated", bed.floor))
        low, high = plan.min(0), plan.max(0)
        for _ in range(bed.loads):
            size = rng.uniform(0.25, 0.7, 2) * (high - low)
            middle = low + size / 2 + rng.random(2) * (high - low - size)
            red, green, blue = rng.uniform(0.02, 0.7) * rng.uniform(0.6, 1.0, 3)
            top = bottom + rng.uniform(0.1, 0.7)
            parts.append(prism(rectangle(*size) + middle, bottom, top, ("paint", (red, green, blue))))
        if bed.cover is not None:
            lid = at_height(plan, self.belt + 0.03)
            if bed.cap:
                lid = at_height(rectangle(*(high - low - [0.0, 0.16])) + (low + high) / 2, self.height - 0.05)
                parts.append(loft(at_height(plan, self.belt), lid, "paint", bed.cover, 0.6))
            parts.append(faces(lid, "paint", bed.cover, 0.6 if bed.cap else 0.2))
        return parts

    def _cabin(self, rng: np.random.Generator, paint: np.ndarray, rear_foot: float, screen_foot: float) -> list[Mesh]:
        roof = self._roof()
        length, width = np.ptp(roof, 0)
        base = rectangle(screen_foot - rear_foot, self.width - 0.16) + [(screen_foot + rear_foot) / 2, 0]
        low, eave = at_height(base, self.belt), at_height(roof, self.height - 0.06)
        rim = at_height(rounded(length, width, 0.15, 0.15) + roof.mean(0), self.height - 0.06)
        crown = at_height(rounded(length - 0.14, width - 0.14, 0.12, 0.12) + roof.mean(0), self.height)
        sides = np.stack([low, np.roll(low, -1, 0), np.roll(eave, -1, 0), eave], 1)
        top = paint if rng.random() > 0.08 else GLASS
        parts = [
            faces(sides, "paint", paint, 0.6),
            faces(eave, "paint", top, 0.6),
            faces(crown, "paint", top, 0.6),
            loft(rim, crown, "paint", top, 0.8),
        ]
        # Side of the cabin (right, front, left, rear), begin and end along it, frame below and above; as shares.
        panes = [(1, 0.07, 0.93, 0.05)]
        if self.shape == "van" and rng.random() < 0.5:  # a cargo van: glass beside the front seats only
            panes += [(0, 0.80, 0.96, 0.12), (2, 0.04, 0.20, 0.12)]
        else:
            panes += [(0, 0.05, 0.53, 0.12), (0, 0.57, 0.95, 0.12), (2, 0.05, 0.43, 0.12), (2, 0.47, 0.95, 0.12)]
            panes += [(3, 0.08, 0.92, 0.14)]
        return parts + [_pane(sides[side], (begin, end), frame) for side, begin, end, frame in panes]

    def _trim(self, rng: np.random.Generator, deck: Profile, paint: np.ndarray, screen_foot: float) -> list[Mesh]:
        half, front, roof = self.width / 2, self.length / 2, self._roof()
        size, centre, parts = np.ptp(roof, 0), roof.mean(0), []
        for side in (-1, 1):
            lamp = np.array([[front - 0.42, half - 0.16], [front - 0.18, half - 0.40], [front - 0.1, half - 0.34],
                             [front - 0.24, half - 0.11]]) * [1, side]  # fmt: skip
            lamp = lamp if side > 0 else lamp[::-1]
            parts.append(faces(at_height(lamp, deck(lamp[:, 0]) + 0.012), "paint", (0.5, 0.5, 0.5), 0.6))
            y0, y1 = sorted((side * (half - 0.3), side * (half - 0.08)))
            x, z = -self.length / 2 - 0.004, 0.7 * self.belt + 0.004
            tail = np.array(
                [[x, y1, z], [x, y0, z], [x + 0.07, y0, z + 0.3 * self.belt], [x + 0.07, y1, z + 0.3 * self.belt]]
            )
            parts.append(faces(tail, "paint", RED, 0.4))
            mirror = rectangle(0.12, 0.2) + [screen_foot - 0.28, side * (half + 0.06)]
            parts.append(prism(mirror, self.belt - 0.02, self.belt + 0.13, ("paint", paint), gloss=0.4))
        if rng.random() < 0.2 and self.shape in ("sedan", "hatch", "suv", "estate"):
            sunroof = rectangle(min(0.9, 0.5 * size[0]), 0.62 * size[1]) + centre + [0.12 * size[0], 0]
            parts.append(patch(sunroof, self.height + 0.008, "paint", GLASS, 1.0))
        if rng.random() < 0.4 and self.shape in ("suv", "estate", "van"):
            dark = RUBBER if rng.random() < 0.6 else CHROME
            for side in (-1, 1):
                rail = rectangle(0.85 * size[0], 0.05) + centre + [0, side * (size[1] / 2 - 0.1)]
                parts.append(prism(rail, self.height - 0.05, self.height + 0.02, ("paint", dark)))
        return parts


def _pane(quad: np.ndarray, along: tuple[float, float], edge: float) -> Mesh:
    """Glass set 8 mm in front of a cabin side; `along` and `edge` are shares of its first edge and of its height."""
    a, b, c, d = quad
    points = np.array(
        [(1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
         for u, v in ((along[0], edge), (along[1], edge), (along[1], 1 - edge), (along[0], 1 - edge))]
    )  # fmt: skip
    normal = np.cross(b - a, d - a)
    return faces(points + 0.008 * normal / np.linalg.norm(normal), "paint", GLASS, 1.0)


def between(plan: np.ndarray, low: float, high: float) -> np.ndarray:
    """The part of a convex plan (n, 2) with low <= x <= high."""
    for limit, side in ((low, -1.0), (high, 1.0)):
        room = limit * side - plan[:, 0] * side
        kept = []
        for p, q, here, there in zip(plan, np.roll(plan, -1, 0), room, np.roll(room, -1), strict=True):
            if here >= 0:
                kept.append(p)
            if here * there < 0:
                kept.append(p + (q - p) * here / (here - there))
        plan = np.array(kept)
    return plan


def around(plan: np.ndarray, hole: np.ndarray) -> list[np.ndarray]:
    """The parts of a convex plan (n, 2) around an axis-parallel rectangle (4, 2): behind, on both sides and ahead."""
    (x0, y0), (x1, y1) = hole.min(0), hole.max(0)
    middle = between(plan, x0, x1)[:, ::-1]
    beside = [between(middle, low, high)[:, ::-1] for low, high in ((-np.inf, y0), (y1, np.inf))]
    return [between(plan, -np.inf, x0), *beside, between(plan, x1, np.inf)]


def choose(rng: np.random.Generator, length: float, height: float) -> tuple[str, tuple[float, float, float]]:
    """A shape that suits the size [m], and a paint."""
    if height > 1.78:
        shape = rng.choice(["van", "suv", "pickup"], p=[0.6, 0.2, 0.2])
    elif height > 1.58:
        shape = rng.choice(["suv", "van", "pickup"], p=[0.75, 0.15, 0.1] if length > 4.7 else [0.85, 0.15, 0])
    elif length < 4.1:
        shape = "hatch"
    else:
        shape = rng.choice(["sedan", "hatch", "estate"], p=[0.5, 0.3, 0.2])
    shares = np.array([share for share, _ in PAINTS])
    paint = np.array(PAINTS[rng.choice(len(PAINTS), p=shares / shares.sum())][1])
    if shape == "van" and rng.random() < 0.5:
        paint = np.array(PAINTS[0][1])
    red, green, blue = (paint * rng.uniform(0.97, 1.03, 3) * rng.uniform(0.8, 1.15)).clip(0, 0.85)
    return str(shape), (red, green, blue)
