r"""Pictures in linear light with exact vehicles, from which the measurer's training crops are cut.

    python -m training.measurer.rendered runs/bank --count 150 --seed 1

A scene is rendered once, finely and without a camera's effects; each crop then gets a camera of its own (`chain`). Most
views are oblique, so that flanks and roofs show; a vehicle's box encloses all of it that shows, except its mirrors.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from orthoscale.detect.measurer import ANSWERS
from orthoscale.synthetic import Camera, NormalFleet, Perspective, Pose, Scene, Vehicle, make_scene, vehicle_boxes
from orthoscale.synthetic.mesh import Mesh
from orthoscale.synthetic.render import light, ortho_view
from orthoscale.synthetic.vehicle import GLASS, Bed
from orthoscale.synthetic.view import View

GSD = 0.035  # metres per pixel of the bank
EXTENT = 46.0  # side of a scene [m]
SAMPLES = 2  # per pixel, each way
BRIGHTEST = 1.2  # linear light that is stored as 255
LEANING = 0.7  # share of the views that are oblique
MOST_LEAN = 1.9  # tangent of the angle off the vertical: 62 degrees. Half of the oblique views are within 25 degrees
TUCKED = 0.25, 0.1  # how far ends and sides of real vehicles recede below their bumpers and doors, at most [m]
LOW_SUN = 0.35  # share of the scenes whose sun stands at 10 to 30 degrees
UNPAINTED = (0.2, 0.12)  # share of the rear and the front bumpers of cars
MORE_PICKUPS = 0.6
# Beds of pickups, from real ones: behind double cabs, extended cabs and single cabs.
BEDS = ((0.6, 0.25, 0.34), (0.2, 0.34, 0.39), (0.2, 0.39, 0.46))  # frequency; from, to [share of the length]
OPEN, LID = 0.65, 0.2  # shares of the beds; the others have a cap
LOADED = 0.4  # share of the open beds
CLEAR = (0.4, 1.0)  # factor on the sky's light: with little of it, shadows are black
OVERCAST = 0.12  # share of the scenes without cast shadows
PALE = 0.3  # share of the scenes whose ground is as light as sunlit concrete or white paint
PALE_ALBEDO = 0.35, 0.7
FLAT = 0.02  # [m] faces up to this height are ground
BRIGHT_GLASS = 0.5  # share of the vehicles whose windows are not nearly black
FOCAL = 6.0  # focal length of oblique views, in picture widths: nearly parallel rays
FLEET = NormalFleet((4.45, 1.79, 1.58), (0.52, 0.10, 0.18))
LORRY_HEIGHT = 2.5  # effective height of lorries in oblique views [m], as in `orthoscale.synthetic.labels`
STRIP = 0.35  # depth of the strip inside an edge that decides whether the edge is seen [m]
SEEN = 0.6  # share of the vehicle's part of that strip which must be visible
VISIBLE = 0.3  # visible share of a vehicle from which it is used for training
MIRRORS = 0.02  # [m] farther than this outside the body there are only mirrors


@dataclass(frozen=True)
class Rendered:
    """One picture.

    light : (H, W, 3) uint8, 255 sqrt(linear / BRIGHTEST), red green blue.
    boxes : (N, 5) centre x, centre y, length, width [px], direction of the front, clockwise on screen [rad].
    kind : (N,) index into ANSWERS. seen : (N, 4) bool, rear, front, left, right edge (left of who looks ahead).
    """

    light: np.ndarray
    boxes: np.ndarray
    kind: np.ndarray
    seen: np.ndarray

    def save(self, file: Path) -> None:
        partial = file.with_suffix(".partial")
        with partial.open("wb") as out:
            np.savez(out, light=self.light, boxes=self.boxes, kind=self.kind, seen=self.seen)
        partial.replace(file)

    @classmethod
    def load(cls, file: Path) -> Rendered:
        with np.load(file) as stored:
            return cls(*(stored[name] for name in ("light", "boxes", "kind", "seen")))


def varied(vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
    """The vehicle with bumpers that protrude more or less, some of them unpainted, and blunter or rounder in plan. Of
    the high ones, more become pickups than in the fleet."""
    if vehicle.shape in ("suv", "van") and vehicle.length > 4.6 and rng.random() < MORE_PICKUPS:
        vehicle = replace(vehicle, shape="pickup")
    pickup = vehicle.shape == "pickup"
    if pickup:
        vehicle = replace(vehicle, bed=_bed(vehicle, rng))
    roundest = 1.3 if vehicle.shape in ("van", "pickup") else 1.75
    plain = [
        tuple(np.full(3, rng.choice([0.02, 0.06, 0.25, 0.5]))) if rng.random() < share else None
        for share in ((0.8, 0.4) if pickup else UNPAINTED)
    ]
    return replace(
        vehicle,
        shoulder=float(rng.uniform(0.05, 0.25 if pickup else 0.2)),
        corner=float(rng.uniform(0.6, roundest)),
        bumpers=(plain[0], plain[1]),
        tucked=(float(rng.uniform(0, TUCKED[0])), float(rng.uniform(0, TUCKED[1]))),
    )


def _bed(vehicle: Vehicle, rng: np.random.Generator) -> Bed:
    """The bed of a pickup: open, with a liner, of its paint or dusty, or covered."""
    _, low, high = BEDS[rng.choice(len(BEDS), p=[share for share, *_ in BEDS])]
    share, kind = rng.uniform(low, high), rng.random()
    if kind < OPEN:
        plain = [(0.03, 0.03, 0.032), vehicle.paint, (0.2, 0.18, 0.15)][rng.choice(3, p=[0.5, 0.35, 0.15])]
        loads = int(rng.integers(1, 4)) if rng.random() < LOADED else 0
        return Bed(share, floor=plain, depth=rng.uniform(0.35, 0.5), loads=loads)
    black, white = (0.015, 0.015, 0.015), (0.7, 0.7, 0.68)
    if kind < OPEN + LID:
        return Bed(share, cover=black if rng.random() < 0.8 else vehicle.paint)
    return Bed(share, cover=[vehicle.paint, white, black][rng.choice(3, p=[0.6, 0.25, 0.15])], cap=True)


def glaze(mesh: Mesh, rng: np.random.Generator) -> None:
    """Give half of the vehicles of a mesh brighter windows, as with a reflection of the sky or bright seats."""
    glass = np.isclose(mesh.colour, GLASS).all(1) & (mesh.owner >= 0)
    for vehicle in np.unique(mesh.owner[glass]):
        if rng.random() < BRIGHT_GLASS:
            tint = np.array([0.9, 1.0, 1.05]) * rng.uniform(0.9, 1.1, 3)
            mesh.colour[glass & (mesh.owner == vehicle)] = np.exp(rng.uniform(np.log(0.02), np.log(0.3))) * tint


def bleached(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene on ground nearly as light as white vehicles, whose edges then hardly show."""
    scenery = scene.scenery
    flat = (scenery.corners[..., 2] < FLAT).all(1) & (scenery.colour.mean(1) < PALE_ALBEDO[0])
    ground, grey = np.array(scene.ground[1], float), rng.uniform(0, 0.7)

    def pale(colour: np.ndarray, level: float) -> np.ndarray:
        hue = colour / colour.mean(-1, keepdims=True)
        return level * (grey + (1 - grey) * hue)

    level = rng.uniform(*PALE_ALBEDO)
    colour = scenery.colour.copy()
    colour[flat] = pale(colour[flat], level)
    ground = pale(ground, level * rng.uniform(0.6, 1.0))
    return replace(scene, scenery=replace(scenery, colour=colour), ground=(scene.ground[0], ground))


def random_view(scene: Scene, rng: np.random.Generator) -> View:
    """A view straight down or oblique, at GSD metres per pixel."""
    if rng.random() > LEANING:
        return ortho_view(scene, GSD)
    size = round(scene.extent_m / GSD)
    lean, yaw = np.arctan(MOST_LEAN * rng.random() ** 2), rng.uniform(0, 2 * np.pi)
    slant = GSD * FOCAL * size
    centre = slant * np.array([-np.sin(lean) * np.cos(yaw), -np.sin(lean) * np.sin(yaw), np.cos(lean)])
    return Perspective(Camera(FOCAL * size, size, size), Pose.looking(centre, yaw, np.pi / 2 - lean))


def directed_boxes(vehicles: tuple[Vehicle, ...], view: View, height: float = 0.8) -> np.ndarray:
    """(N, 5) boxes of `vehicle_boxes`, with the angle of the direction of the front."""
    boxes = vehicle_boxes(vehicles, view, height).xylwa
    ends = np.array([[[v.x, v.y, 0.4], [v.x + np.cos(v.heading), v.y + np.sin(v.heading), 0.4]] for v in vehicles])
    ahead = np.diff(view.project(ends.reshape(-1, 2, 3)), axis=1)[:, 0]
    turned = (np.c_[np.cos(boxes[:, 4]), np.sin(boxes[:, 4])] * ahead).sum(1) < 0
    return np.c_[boxes[:, :4], boxes[:, 4] + np.pi * turned]


def silhouettes(scene: Scene, view: View) -> tuple[np.ndarray, list[np.ndarray]]:
    """Silhouettes of vehicles in `view`, without occlusion by other things: (N, 5) the boxes around them, directed to
    the front; and for each the corners (F, CORNERS, 2) of its faces in the view. Mirrors are left out."""
    boxes, outlines = directed_boxes(scene.vehicles, view), []
    for k, vehicle in enumerate(scene.vehicles):
        faces = scene.mesh.corners[scene.mesh.owner == k]
        ahead = np.array([np.cos(vehicle.heading), np.sin(vehicle.heading)])
        aside = (faces[..., :2] - (vehicle.x, vehicle.y)) @ (-ahead[1], ahead[0])
        body = faces[(np.abs(aside) < vehicle.width / 2 + MIRRORS).all(1)]
        seen = view.project(body)
        along = np.array([np.cos(boxes[k, 4]), np.sin(boxes[k, 4])])
        axes = np.stack([along, [-along[1], along[0]]])
        on_axes = seen.reshape(-1, 2) @ axes.T
        low, high = on_axes.min(0), on_axes.max(0)
        boxes[k, :2], boxes[k, 2:4] = (low + high) / 2 @ axes, high - low
        outlines.append(seen)
    return boxes, outlines


def in_sight(boxes: np.ndarray, outlines: Sequence[np.ndarray], owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4) bool, see `Rendered.seen`, and (N,) the visible share of each vehicle. outlines : of `silhouettes`.
    owner : (H, W) the vehicle that each pixel shows."""
    seen, share = np.zeros((len(boxes), 4), bool), np.zeros(len(boxes))
    for k, (x, y, length, across, angle) in enumerate(boxes):
        if not (0 < x < owner.shape[1] and 0 < y < owner.shape[0]):
            continue
        reach = int(np.hypot(length, across) / 2) + 2
        x0, y0, x1, y1 = max(int(x) - reach, 0), max(int(y) - reach, 0), int(x) + reach, int(y) + reach
        mine = owner[y0:y1, x0:x1] == k
        whole = np.zeros((y1 - y0, x1 - x0), np.uint8)  # the vehicle alone, also beyond the picture
        for face in outlines[k]:
            cv2.fillPoly(whole, [np.round(face - (x0, y0)).astype(np.int32)], 1)
        there = np.zeros(whole.shape, bool)
        there[: mine.shape[0], : mine.shape[1]] = mine
        columns, rows = np.meshgrid(np.arange(x0, x1) + 0.5 - x, np.arange(y0, y1) + 0.5 - y)
        along, aside = (columns * c + rows * s for c, s in
                        ((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))))  # fmt: skip
        for edge, depth in enumerate([length / 2 + along, length / 2 - along, across / 2 + aside, across / 2 - aside]):
            strip = (depth < STRIP / GSD) & (whole > 0)
            seen[k, edge] = strip.any() and there[strip].mean() > SEEN
        share[k] = there[whole > 0].mean() if whole.any() else 0
    return seen, share


def rendered(seed: int, overcast: bool | None = None) -> Rendered:
    """One scene; the same for the same seed. overcast : without cast shadows, or with them; None: by chance."""
    rng = np.random.default_rng([seed, 16])
    style = str(rng.choice(["carpark", "city", "suburb", "village", "industrial"], p=[0.35, 0.2, 0.2, 0.1, 0.15]))
    scene = make_scene(int(rng.integers(1 << 40)), FLEET, EXTENT, int(rng.integers(25, 70)), style)
    scene = replace(scene, vehicles=tuple(varied(v, rng) for v in scene.vehicles))
    pale = np.random.default_rng([seed, 17])  # a generator of its own, so that other scenes stay the same
    if pale.random() < PALE:
        scene = bleached(scene, pale)
    if rng.random() < LOW_SUN:
        azimuth, height = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(10, 30))
        sun = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
        # Upright surfaces and the camera's exposure compensate for the little light on level ground.
        scene = replace(scene, sun=sun, sunlight=scene.sunlight * 1.5, skylight=scene.skylight * rng.uniform(0.3, 1.1))
    else:
        scene = replace(scene, skylight=scene.skylight * rng.uniform(*CLEAR))
    by_chance = rng.random() < OVERCAST
    if by_chance if overcast is None else overcast:
        scene = replace(scene, sunlight=scene.sunlight * 0.05, skylight=scene.skylight * 2.4)
    glaze(scene.mesh, rng)
    view = random_view(scene, rng)
    linear, owner = light(scene, view.enlarged(SAMPLES))
    linear = cv2.resize(linear, (view.width, view.height), interpolation=cv2.INTER_AREA)
    owner = owner[1::SAMPLES, 1::SAMPLES]
    boxes, outlines, kinds = np.empty((0, 5)), [], []
    if scene.vehicles:
        boxes, outlines = silhouettes(scene, view)
        kinds = [ANSWERS.index(v.shape) if v.shape in ANSWERS else 0 for v in scene.vehicles]
    seen, share = in_sight(boxes, outlines, owner)
    lorries = tuple(Vehicle(x, y, a, length, width, 3.0) for x, y, length, width, a in scene.lorries)
    if lorries:
        boxes = np.r_[boxes, directed_boxes(lorries, view, LORRY_HEIGHT)]
        kinds += [ANSWERS.index("larger")] * len(lorries)
        seen, share = np.r_[seen, np.ones((len(lorries), 4), bool)], np.r_[share, np.ones(len(lorries))]
    near = (share > VISIBLE) & ((boxes[:, :2] > 0) & (boxes[:, :2] < (view.width, view.height))).all(1)
    coded = (255 * np.sqrt(np.clip(linear / BRIGHTEST, 0, 1)) + rng.random(linear.shape)).clip(0, 255).astype(np.uint8)
    return Rendered(coded, boxes[near], np.array(kinds, int)[near], seen[near])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder; scenes that it has already are left as they are")
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for number in range(options.count):
        file = options.out / f"scene_{options.seed:03d}_{number:04d}.npz"
        if not file.exists():
            rendered(1000 * options.seed + number).save(file)


if __name__ == "__main__":
    main()
