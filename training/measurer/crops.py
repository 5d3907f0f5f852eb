"""Training examples of the measurer: crops along an inaccurate box, and where the edges are in them.

Rendered vehicles have exact edges. Real ones have boxes by people and detectors, whose sizes scatter and whose margin
differs from scene to scene; the likelihood (`network.loss`), which knows the scene, takes account of that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orthoscale.core.angles import axis_angle
from orthoscale.detect.measurer import ANSWERS, CROP_HEIGHT, CROP_WIDTH, crop, pixels_per_crop_pixel

from . import real
from .chain import photograph, pyramid
from .real import NONE, SCENES
from .rendered import Rendered

RENDERED = -1  # scene number of rendered vehicles, with exact edges
HAND = len(SCENES)  # scene number of all vehicles whose edges were read by eye, whatever the place
NO_EDGES = -2  # scene number of vehicles of which only the kind is learnt
SHARES = {"rendered": 0.47, "real": 0.1, "hand": 0.23, "kind": 0.1, "ground": 0.1}
# Share of each kind among the examples of "kind", as far as available: about as many pickups and vans as cars, so that
# the result does not depend on their shares in the cities of the training data.
OF_KINDS = {"car": 0.3, "pickup": 0.3, "van": 0.25, "larger": 0.1, "none": 0.05}
COARSE = 25.0  # length of a vehicle in a coarse picture, at most [px]
GROUND = 0.06  # share of the rendered examples that show no vehicle
HELD_OUT = 10  # number of rendered pictures that are held out for `evaluate`


@dataclass(frozen=True)
class Example:
    """One crop and what is known about it.

    pixels : (CROP_HEIGHT, CROP_WIDTH, 3) uint8.
    edges : (4,) -x, +x, -y, +y [crop px from the crop's centre]. turn : of the
    vehicle against the crop [rad]. seen : (4,) bool. kind : index into ANSWERS, or real.UNKNOWN. scene : index into
    SCENES, RENDERED, HAND or NO_EDGES. step : crop pixels per pixel of the labelled picture.
    """

    pixels: np.ndarray
    edges: np.ndarray
    turn: float
    seen: np.ndarray
    kind: int
    scene: int
    step: float


def proposal(box: np.ndarray, rng: np.random.Generator, good: bool = False) -> np.ndarray:
    """(5,) a box as a detector might propose it for the vehicle in `box`: with errors of place, angle and size, and in
    either direction. A third of them, or all if `good`, are as accurate as after a first pass."""
    fair = 1.0 if rng.random() < 0.65 and not good else 0.2
    size = np.exp(fair * rng.uniform(np.log(0.75), np.log(1.35)) + fair * rng.normal(0, [0.03, 0.07])) * box[2:4]
    along, across = fair * rng.uniform(-0.1, 0.1) * box[2], fair * rng.uniform(-0.2, 0.2) * box[3]
    cos, sin = np.cos(box[4]), np.sin(box[4])
    turn = np.deg2rad(fair * rng.uniform(-6, 6)) + np.pi * rng.integers(2)
    return np.array([box[0] + cos * along - sin * across, box[1] + sin * along + cos * across, *size, box[4] + turn])


def edges_in_crop(box: np.ndarray, proposed: np.ndarray) -> tuple[np.ndarray, float]:
    """Edges (4,) of `box` in the crop of `proposed` [crop px] and its turn against it [rad], within a quarter turn:
    the inverse of `orthoscale.detect.measurer.placed`."""
    step = pixels_per_crop_pixel(proposed)
    cos, sin = np.cos(proposed[4]), np.sin(proposed[4])
    x, y = np.array([[cos, sin], [-sin, cos]]) @ (box[:2] - proposed[:2]) / step
    length, width = box[2:4] / step / 2
    turn = axis_angle(box[4] - proposed[4])
    return np.array([x - length, x + length, y - width, y + width]), turn


BACKWARDS = [1, 0, 3, 2]  # order of edges (rear, front, left, right) if a vehicle is seen in the opposite direction
CROPS = 3  # cut from each window
BOXED_AS_SHOWN = 0.7  # share of the crops of partly hidden vehicles that are cut around the visible part


def examples(
    levels: list[np.ndarray],
    box: np.ndarray,
    seen: np.ndarray,
    kind: int,
    scene: int,
    rng: np.random.Generator,
    others: np.ndarray | None = None,
) -> Iterator[Example]:
    """Random crops of one vehicle as one camera took it. levels : `pyramid` of the picture. box : (5,) in it, directed
    to the front. seen : (4,) rear, front, left, right. others : see `photograph`."""
    length = box[2]
    shot = photograph(levels, box, rng, scene == RENDERED, others)
    pixels, box, seen = shot.pixels, shot.box, seen & ~shot.hidden
    if rng.random() < 0.06:  # the picture ends here
        pixels, seen = _cut(pixels, box, seen, rng)
    for _ in range(CROPS):
        # Detectors box the visible part of a vehicle; the measurer's last pass is along the result of those before.
        proposed = proposal(shot.shown if rng.random() < BOXED_AS_SHOWN else box, rng)
        edges, turn = edges_in_crop(box, proposed)
        backwards = np.cos(proposed[4] - box[4]) < 0
        order = seen[BACKWARDS] if backwards else seen
        cut = crop(pixels, proposed)
        if rng.random() < 0.5:
            cut, edges, turn = cut[::-1], np.array([*edges[:2], -edges[3], -edges[2]]), -turn
            order = order[[0, 1, 3, 2]]
        inside = np.abs(edges) < [CROP_WIDTH / 2, CROP_WIDTH / 2, CROP_HEIGHT / 2, CROP_HEIGHT / 2]
        step = box[2] / length / pixels_per_crop_pixel(proposed)
        yield Example(np.ascontiguousarray(cut), edges, turn, order & inside, kind, scene, step)


def _cut(
    pixels: np.ndarray, box: np.ndarray, seen: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The window cut off at a line through it; edges beyond the line are not seen."""
    quarter = int(rng.integers(4))
    way = np.array([np.cos(quarter * np.pi / 2), np.sin(quarter * np.pi / 2)])
    at = box[:2] @ way + rng.uniform(0.15, 0.7) * box[2]
    ahead = np.array([np.cos(box[4]), np.sin(box[4])])
    aside = np.array([-ahead[1], ahead[0]])
    ends = box[:2] + np.stack([-ahead * box[2], ahead * box[2], -aside * box[3], aside * box[3]]) / 2
    seen = seen & (ends @ way < at)
    x, y = np.meshgrid(np.arange(pixels.shape[1]) + 0.5, np.arange(pixels.shape[0]) + 0.5)
    pixels = np.where((x * way[0] + y * way[1] < at)[..., None], pixels, 114).astype(np.uint8)
    return pixels, seen


class Examples:
    """Endless random examples.

    bank : folder of rendered pictures (`rendered`) and real vehicles (`real`); the first `held_out` rendered pictures
    are never taken.
    """

    def __init__(self, bank: Path, seed: int, held_out: int = HELD_OUT) -> None:
        self._rng = np.random.default_rng([seed, 616])
        pictures = [Rendered.load(file) for file in sorted(bank.glob("scene_*.npz"))[held_out:]]
        self._rendered = [(pyramid(p.light), p) for p in pictures if len(p.boxes)]
        if SHARES["rendered"] and not self._rendered:
            raise ValueError(f"{bank}: no rendered picture with vehicles beside the {held_out} that are held out")
        self._real, self._ground = {}, []
        for file in sorted(bank.glob("real_*.npz")):
            found = real.load(file)
            scene = file.stem.removeprefix("real_")
            if scene in SCENES:
                self._real[SCENES.index(scene)] = [p for p in found if p.kind != NONE]
            self._ground += [p for p in found if p.kind == NONE]
        self._hand = [found for file in sorted(bank.glob("hand_*.npz")) if (found := real.load(file))]
        self._often = _often(self._hand)
        told = [patch for file in sorted(bank.glob("kind_*.npz")) for patch in real.load(file)]
        by_kind = {kind: [p for p in told if p.kind == ANSWERS.index(kind)] for kind in OF_KINDS}
        # Most pickups are from chips; fine and coarse pictures of a kind have equal weight.
        self._told = {
            kind: [group for group in ([p for p in some if (p.box[2] < COARSE) == small] for small in (0, 1)) if group]
            for kind, some in by_kind.items() if some
        }  # fmt: skip

    def __iter__(self) -> Iterator[Example]:
        rng = self._rng
        there = {"rendered": True, "real": bool(self._real), "hand": bool(self._hand), "kind": bool(self._told),
                 "ground": bool(self._ground)}  # fmt: skip
        shares = np.array([share * there[source] for source, share in SHARES.items()])
        of_kinds = np.array([OF_KINDS[kind] for kind in self._told])
        while True:
            source = rng.choice(list(SHARES), p=shares / shares.sum())
            if source == "rendered":
                yield from self._of_rendered(rng)
                continue
            if source == "real":
                scene = int(rng.choice(list(self._real)))
                patches = self._real[scene]
            elif source == "hand":
                scene, patches = HAND, self._hand[rng.choice(len(self._hand), p=self._often)]
            elif source == "kind":
                groups = self._told[rng.choice(list(self._told), p=of_kinds / of_kinds.sum())]
                scene, patches = NO_EDGES, groups[rng.choice(len(groups), p=_often(groups))]
            else:
                scene, patches = NO_EDGES, self._ground
            patch = patches[rng.integers(len(patches))]
            whole = np.full(4, patch.whole and patch.kind != NONE)
            yield from examples(
                pyramid(patch.pixels), patch.box, whole, patch.kind, scene, rng, self._cover(scene, rng)
            )

    def _cover(self, scene: int, rng: np.random.Generator) -> np.ndarray | None:
        """Ground to cover part of a vehicle with; None if nothing is learnt about its edges."""
        return self._ground[rng.integers(len(self._ground))].pixels if self._ground and scene != NO_EDGES else None

    def _of_rendered(self, rng: np.random.Generator) -> Iterator[Example]:
        levels, picture = self._rendered[rng.integers(len(self._rendered))]
        k = rng.integers(len(picture.boxes))
        box, seen, kind = picture.boxes[k], picture.seen[k], int(picture.kind[k])
        if rng.random() < GROUND:
            box, seen, kind = _elsewhere(levels, picture.boxes, box[2], rng), np.zeros(4, bool), NONE
        return examples(levels, box, seen, kind, RENDERED, rng, self._cover(RENDERED, rng) if kind != NONE else None)


def _often(groups: Sequence[Sequence[real.Patch]]) -> np.ndarray:
    """(G,) share of each group: one with few vehicles is not shown so often that it would be memorised."""
    often = np.sqrt([len(found) for found in groups])
    return often / max(often.sum(), 1e-9)


def _elsewhere(levels: list[np.ndarray], boxes: np.ndarray, length: float, rng: np.random.Generator) -> np.ndarray:
    """(5,) a box where there is no vehicle."""
    height, width = levels[0].shape[:2]
    while True:
        place = real.clear_place(width, height, boxes, length, rng)
        if place is not None:
            return np.array([*place, length * rng.uniform(0.8, 1.2), 0.42 * length, rng.uniform(0, 2 * np.pi)])


def batch(examples: list[Example]) -> dict[str, np.ndarray]:
    """Arrays as input of `network.loss`."""
    return {
        "pixels": np.stack([e.pixels for e in examples]).transpose(0, 3, 1, 2),
        "edges": np.array([e.edges for e in examples], np.float32),
        "turn": np.array([e.turn for e in examples], np.float32),
        "seen": np.array([e.seen for e in examples], np.float32),
        "kind": np.array([e.kind for e in examples]),
        "scene": np.array([e.scene for e in examples]),
        "step": np.array([e.step for e in examples], np.float32),
    }
