"""Simulated blocks of frames over parked vehicles: terrain, roofs, tree crowns, sparse points, a perfect detector's
boxes.

Nothing is rendered: the true cameras project outlines of vehicles, and random sparse points lie where feature matching
finds them (roofs, crowns, rough ground; few on bare asphalt). So a block takes a second, and its truth is exact.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import Detections
from orthoscale.core.fleet import MEAN_CORRELATION, Fleet
from orthoscale.core.market_segments import PlaceKind
from orthoscale.core.measuring.oblique import HEIGHT_SD
from orthoscale.core.projection.exact import BEND
from orthoscale.core.projection.own_ruler import CORNER_SD, LEAN_SD
from orthoscale.core.ruler import Ruler
from orthoscale.sources.colmap import ColmapSource
from orthoscale.synthetic.model import SceneToModel

from .bodies import CAR, CAR_CORNER, body
from .flights import enclosing
from .simulate import Vans, place_of

KINDS = ("nadir", "oblique", "grid", "strip")
WIDTH, HEIGHT = 1200, 900
HEIGHT_ENCLOSED = 0.8  # [m]
RULER = Ruler(margin_sd=(0.3, 0.3), bias_sd=(0.01, 0.015), noise=(0.8, 0.6))
EXACT = replace(RULER, margin_sd=(1e-3, 1e-3), bias_sd=(0.0, 0.0), shrink_sd=(0.0, 0.0))  # nothing about it is unknown
LOWEST_ENCLOSED, MOST_CORNER = 0.1, 0.3  # [m], [of the width]
SEEN = 0.8  # share of a vehicle's views in which it is found
POINT_NOISE = 0.06  # [m] noise of a sparse point; GRASS: mean height of those on rough ground
GRASS = 0.15
DECK_REACH = 0.44  # of the extent; vehicles stand within 0.42 of it
SPEED_SPREAD = 0.2  # of the logarithm of vehicles' speeds
DENSE_PER_M2, DENSE_NOISE = 8.0, 0.04  # points of a dense cloud, thinned; their noise [m]


@dataclass(frozen=True)
class Conditions:
    """The properties of a block.

    kind : one of KINDS. points : number of sparse points. crowns, roofs : share of the area that they cover. slope : of
    the ground. relief : amplitude of its waves [m]. focal : relative error of the model's focal length, too long (in
    nadir flights heights are then too large by as much). bare : share of points missing where vehicles stand.
    deck : height of a parking deck under all vehicles [m]. speed : how far vehicles drive from frame to frame [m].
    """

    kind: str = "nadir"
    points: int = 4000
    crowns: float = 0.1
    roofs: float = 0.1
    slope: float = 0.0
    relief: float = 0.0
    focal: float = 0.0
    bare: float = 0.8
    vehicles: int = 40
    altitude: float = 70.0
    extent: float = 160.0
    deck: float = 0.0
    speed: float = 0.0

    @classmethod
    def drawn(cls, rng: np.random.Generator, kind: str) -> Conditions:
        """Random conditions of typical flights."""
        straight_down = kind in ("nadir", "strip")
        return cls(
            kind=kind,
            points=int(np.exp(rng.uniform(np.log(120), np.log(6000)))),
            crowns=rng.uniform(0, 0.5) if rng.random() < 0.7 else rng.uniform(0.5, 1.5),
            roofs=rng.uniform(0, 0.35),
            slope=rng.uniform(0, 0.06),
            relief=rng.uniform(0, 1.5),
            focal=float(rng.choice([0.0, 0.1, 0.2])) if straight_down else 0.0,
            bare=rng.uniform(0.5, 0.98),
            vehicles=int(np.exp(rng.uniform(np.log(10), np.log(90)))),
            altitude=rng.uniform(45, 110),
        )


@dataclass(frozen=True)
class Block:
    """source : a reconstruction. found : the boxes. metres_per_unit : the true scale."""

    source: ColmapSource
    found: Detections
    metres_per_unit: float
    terrain_error: np.ndarray  # [share of the camera's height] of the ground under each vehicle


class _KnownFleet(Fleet):
    """A fleet that is the same at all places."""

    place_vehicles = (PlaceKind(1e6, 1.0),)


def exactly(fleet: Fleet) -> Fleet:
    """`fleet` without any uncertainty."""
    own = {field.name: getattr(fleet, field.name) for field in fields(fleet)}
    return _KnownFleet(**{**own, "mean_sd": np.full(3, 1e-6), "shares_sd": 0.0})


def fly(
    rng: np.random.Generator,
    fleet: Fleet,
    conditions: Conditions,
    unsure: bool = True,
    ruler: Ruler = RULER,
    dense: bool = False,
) -> Block:
    """A random block. unsure : with errors as large as the uncertainties that `fleet`, `ruler` and the program claim
    (`_Boxing`); else all vehicles are the fleet's, and boxes are as on the card. dense : with a dense cloud of the same
    ground; all else stays the same."""
    c = conditions
    terrain = _Terrain.drawn(rng, c)
    if c.deck:
        terrain = replace(terrain, deck=c.deck, reach=DECK_REACH * c.extent)
    size, place, heading = _vehicles(rng, fleet, c, terrain, unsure)
    axes = np.stack(
        [np.stack([np.cos(heading), np.sin(heading)], -1), np.stack([-np.sin(heading), np.cos(heading)], -1)], 1
    )
    ends = place[:, None] + np.array([-0.25, 0.25])[:, None] * axes[:, :1]
    ends = np.dstack([ends, terrain(ends)])

    focal = 900.0
    cameras = _cameras(rng, c)
    world = SceneToModel.drawn(rng, float(np.exp(rng.uniform(np.log(0.1), np.log(20)))))
    stretch = np.array([1.0, 1.0, 1 + c.focal])  # what a longer focal length does to a model seen straight from above
    sparse, things = _sparse(rng, c, terrain, place)
    source = _source(world, cameras, stretch, sparse, focal * (1 + c.focal))
    if dense:
        cloud = _dense(np.random.default_rng(len(sparse)), c, terrain, things, size, place, axes)
        source = replace(source, cloud=_Cloud(world.points(cloud * stretch)))

    velocity = np.zeros((len(place), 2))  # [m per frame]
    if c.speed:
        velocity = c.speed * np.exp(rng.normal(0, SPEED_SPREAD, (len(place), 1))) * axes[:, 0]
    boxing = _Boxing.drawn(rng, ruler) if unsure else _Boxing()
    outlines = [place[:, None] + (plan * boxing.seen(size)[:, None]) @ axes for plan, _ in boxing.bodies]
    points = [
        np.dstack([flat, terrain(flat) + heights]) for flat, (_, heights) in zip(outlines, boxing.bodies, strict=True)
    ]
    frames: dict[str, Boxes] = {}
    above: dict[str, Boxes] = {}
    pictures = {picture.image: picture for picture in source.ground_pictures}
    for k, (name, (rotation, centre)) in enumerate(zip(source.picture_names, cameras, strict=True)):
        driven = place + k * velocity
        moved = np.column_stack([driven - place, terrain(driven) - terrain(place)])[:, None]
        seen = [_project(p + moved, rotation, centre, focal) for p in (*points, ends)]
        inside = np.all([((p > 3) & (p < [WIDTH - 3, HEIGHT - 3])).all((1, 2)) for p in seen], axis=0)
        inside &= rng.random(len(place)) < SEEN
        noise = rng.normal(0, ruler.noise, (len(place), 2))[inside]
        seen = [p[inside] for p in seen]
        frames[name] = boxing.boxes(seen, noise)
        if name not in pictures:
            continue
        picture = pictures[name]
        mapped = []
        for pixels in seen:
            _, lies, ok = source.views(name, pixels.reshape(-1, 2))
            plan = (source.ground.plane(lies) - picture.origin) @ picture.axes.T / picture.unit_per_pixel
            plan[~ok] = np.nan
            mapped.append(plan.reshape(pixels.shape))
        whole = np.all([((p > 0) & (p < [picture.width, picture.height])).all((1, 2)) for p in mapped], axis=0)
        above[picture.name] = boxing.boxes([p[whole] for p in mapped], noise[whole])  # the same pixels, warped
    plain = Detections(frames, 1.0, ruler, (HEIGHT_ENCLOSED,) * 2, "perfect")
    stands = world.points(np.column_stack([place, terrain(place)]) * stretch)
    error = source.ground.height_above(stands) / source.ground.camera_height
    return Block(source, replace(plain, planar=replace(plain, boxes=above)), world.metres_per_unit, error)


@dataclass(frozen=True)
class _Boxing:
    """How the boxes of one flight relate to its vehicles; by default as on the card. (2,) are of lengths and widths.

    bias : relative. margin : [px]. shrink : shrinkage towards the `usual` sizes [m]. heights : up to which boxes
    enclose the ends of vehicles, and their sides [m]. lean : of ends and sides, and corner, as in `Hull`.
    """

    bias: np.ndarray = field(default_factory=lambda: np.zeros(2))
    margin: np.ndarray = field(default_factory=lambda: np.zeros(2))
    shrink: np.ndarray = field(default_factory=lambda: np.zeros(2))
    usual: tuple[float, float] = RULER.usual
    heights: tuple[float, float] = (HEIGHT_ENCLOSED, HEIGHT_ENCLOSED)
    lean: tuple[float, float] = (0.0, 0.0)
    corner: float = CAR_CORNER

    @classmethod
    def drawn(cls, rng: np.random.Generator, ruler: Ruler) -> _Boxing:
        """With random errors as large as the claimed uncertainties: of boxes by `ruler`, of bodies by the
        self-calibration."""
        heights = np.maximum(HEIGHT_ENCLOSED + rng.normal(0, HEIGHT_SD, 2), LOWEST_ENCLOSED)
        lean = rng.normal(0, LEAN_SD)
        return cls(
            rng.normal(0, ruler.bias_sd),
            rng.normal(0, ruler.margin_sd),
            rng.standard_normal() * np.array(ruler.shrink_sd),
            ruler.usual,
            (float(heights[0]), float(heights[1])),
            (float(lean[0]), float(lean[1])),
            float(np.clip(rng.normal(CAR_CORNER, CORNER_SD), 0, MOST_CORNER)),
        )

    def seen(self, size: np.ndarray) -> np.ndarray:
        """(N, 2) sizes of vehicles of `size` (N, 2) [m] after shrinkage."""
        return size * (np.array(self.usual) / size) ** self.shrink

    @cached_property
    def bodies(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """The bodies that boxes enclose at vehicles' ends, and at their sides: see `bodies.body`."""
        levels = np.array([ring[0] for ring in CAR])
        rings: list[tuple[float, float, float, float]] = []
        for height in sorted({*levels.tolist(), BEND}):
            front, rear, side = (float(np.interp(height, levels, [ring[k] for ring in CAR])) for k in (1, 2, 3))
            end, flank = (max(0.0, height - BEND) * lean for lean in self.lean)
            rings.append((height, min(front - end, 0.5), max(rear + end, -0.5), min(side - flank, 0.5)))
        return tuple(body(tuple(rings), height, self.corner) for height in self.heights)

    def boxes(self, seen: list[np.ndarray], more: np.ndarray) -> Boxes:
        """seen : (N, P, 2) pixels of the two `bodies` of each vehicle, and (N, 2, 2) of its axis. more : (N, 2) noise
        of length and width [px]."""
        rows = []
        for at_ends, at_sides, axis in zip(*seen, strict=True):
            heading = axis[1] - axis[0]
            long, wide = enclosing(at_ends, heading, 0.0), enclosing(at_sides, heading, 0.0)
            rows.append([*long[:3], wide[3], long[4]])
        xylwa = np.array(rows, float).reshape(-1, 5)
        xylwa[:, 2:4] = np.maximum(xylwa[:, 2:4] * np.exp(self.bias) + self.margin + more, 1.0)
        swapped = xylwa[:, 2] < xylwa[:, 3]
        return Boxes(xylwa[~swapped], np.full(int((~swapped).sum()), 0.9))


@dataclass(frozen=True)
class _Terrain:
    """Heights of the ground [m]."""

    slope: np.ndarray
    waves: np.ndarray  # (K, 4) amplitude, two wave numbers, phase
    deck: float = 0.0  # height of a level deck [m], up to `reach` [m] from the middle along both axes
    reach: float = 0.0

    @classmethod
    def drawn(cls, rng: np.random.Generator, c: Conditions) -> _Terrain:
        turn = rng.uniform(0, 2 * np.pi)
        number = 2 * np.pi / rng.uniform(90, 250, (3, 1)) * rng.choice([-1, 1], (3, 2)) * rng.uniform(0.3, 1, (3, 2))
        waves = np.column_stack([rng.normal(0, c.relief / np.sqrt(3), 3), number, rng.uniform(0, 2 * np.pi, 3)])
        return cls(c.slope * np.array([np.cos(turn), np.sin(turn)]), waves)

    def __call__(self, xy: np.ndarray) -> np.ndarray:
        out = xy @ self.slope
        for amplitude, kx, ky, phase in self.waves:
            out = out + amplitude * np.sin(kx * xy[..., 0] + ky * xy[..., 1] + phase)
        return np.where((np.abs(xy) < self.reach).all(-1), self.deck, out)


def _vehicles(
    rng: np.random.Generator, fleet: Fleet, c: Conditions, terrain: _Terrain, unsure: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 2) sizes [m], places and (N,) headings of vehicles that stand side by side in a few lots."""
    size = (place_of(rng, fleet) if unsure else fleet).sample(rng, c.vehicles)[:, :2]
    if unsure:
        unknown = fleet.mean_sd[:2] / fleet.mean[:2]
        r = MEAN_CORRELATION
        size = size * np.exp(unknown * (np.sqrt(r) * rng.standard_normal() + np.sqrt(1 - r) * rng.standard_normal(2)))
        vans = Vans.of_place(rng, fleet)
        van = rng.random(len(size)) < vans.share
        size[van] = vans.sample(rng, int(van.sum()))
    place, heading = [], []
    while len(place) < c.vehicles:
        corner, turn = rng.uniform(-0.35, 0.35, 2) * c.extent, rng.uniform(0, np.pi)
        along = np.array([np.cos(turn), np.sin(turn)])
        for k in range(int(rng.integers(3, 12))):
            spot = corner + 3.0 * k * along
            if np.abs(spot).max() < 0.42 * c.extent and all(np.linalg.norm(spot - p) > 2.9 for p in place):
                if place and min(np.linalg.norm(spot - p) for p in place) < 5.5 and k == 0:
                    break
                place.append(spot)
                heading.append(turn + np.pi / 2)
    return size, np.array(place[: c.vehicles]), np.array(heading[: c.vehicles])


def _cameras(rng: np.random.Generator, c: Conditions) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotations `camera_from_world` and centres [m] of the true cameras."""

    def looking(x: float, y: float, pitch: float, yaw: float) -> tuple[np.ndarray, np.ndarray]:
        pitch, yaw = np.radians(pitch), np.radians(yaw)
        ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        forward = ahead * np.cos(pitch) - np.array([0, 0, np.sin(pitch)])
        right = np.cross(ahead, [0.0, 0, 1])
        rotation = np.stack([right, np.cross(forward, right), forward])
        back = c.altitude / np.tan(pitch)
        return rotation, np.array([x, y, 0.0]) - back * ahead + [0, 0, c.altitude + rng.normal(0, 0.5)]

    grid = np.linspace(-0.4, 0.4, 5) * c.extent
    wander = 0.0 if c.focal else 1.5
    straight = [
        (x, y, min(90.0, 90 - abs(rng.normal(0, wander))), 180 * (k % 2)) for k, y in enumerate(grid) for x in grid
    ]
    if c.kind == "nadir":
        poses = straight
    elif c.kind == "strip":
        poses = [
            (x, rng.normal(0, 1), 90 - abs(rng.normal(0, wander)), 0.0) for x in np.linspace(-0.5, 0.5, 12) * c.extent
        ]
    else:
        pitch = rng.uniform(50, 75)
        poses = [(x, y, pitch + rng.normal(0, 1), 180 * (k % 2)) for k, y in enumerate(grid) for x in grid]
        if c.kind == "grid":
            poses += [(x, y, pitch + rng.normal(0, 1), 90 + 180 * (k % 2)) for k, x in enumerate(grid) for y in grid]
    return [looking(*pose) for pose in poses]


class _Things(NamedTuple):
    """Roofs or tree crowns: (K, 2) centres, their radius, (K,) heights of their tops and their roughness [m]."""

    middles: np.ndarray
    reach: float
    tops: np.ndarray
    rough: float


def _sparse(
    rng: np.random.Generator, c: Conditions, terrain: _Terrain, vehicles: np.ndarray
) -> tuple[np.ndarray, list[_Things]]:
    """(points, 3) sparse points [m]: of the ground, roofs, crowns, vehicles, and outliers; and the roofs and crowns."""
    half = 0.7 * c.extent
    xy = rng.uniform(-half, half, (6 * c.points, 2))
    roofs = rng.uniform(-half, half, (int(c.roofs * 4 * half**2 / 120) + 1, 2))
    crowns = rng.uniform(-half, half, (int(c.crowns * 4 * half**2 / 30) + 1, 2))

    def clear(middles: np.ndarray, reach: float) -> np.ndarray:
        return middles[np.linalg.norm(middles[:, None] - vehicles, axis=2).min(1) > reach]

    roofs, crowns = clear(roofs, 9.0), clear(crowns, 3.2)
    over = rng.normal(0, POINT_NOISE, len(xy)) + rng.exponential(GRASS, len(xy)) * (rng.random(len(xy)) < 0.6)
    nearest = np.linalg.norm(xy[:, None] - vehicles, axis=2).min(1)
    chance = np.where(nearest < 12, 1 - c.bare, 1.0) * 0.3
    car = nearest < 1.0
    over[car], chance[car] = rng.uniform(0.6, 1.5, int(car.sum())), 0.3
    things = []
    for middles, reach, low, high, rough in ((roofs, 5.0, 3.0, 8.0, 0.15), (crowns, 3.0, 3.0, 12.0, 1.2)):
        if not len(middles):
            continue
        apart = np.linalg.norm(xy[:, None] - middles, axis=2)
        here, which = apart.min(1) < reach, apart.argmin(1)
        things.append(_Things(middles, reach, rng.uniform(low, high, len(middles)), rough))
        over[here] = (things[-1].tops[which] * rng.uniform(0.7, 1.0, len(xy)) + rng.normal(0, rough, len(xy)))[here]
        chance[here] = 1.0
    chosen = np.flatnonzero(rng.random(len(xy)) < chance)[: c.points]
    points = np.column_stack([xy[chosen], terrain(xy[chosen]) + over[chosen]])
    stray = rng.random(len(points)) < 0.02
    points[stray, 2] += rng.normal(0, 0.1 * c.altitude, int(stray.sum()))
    return points, things


def _dense(
    rng: np.random.Generator,
    c: Conditions,
    terrain: _Terrain,
    things: list[_Things],
    size: np.ndarray,
    place: np.ndarray,
    axes: np.ndarray,
) -> np.ndarray:
    """(N, 3) points of a dense cloud [m]: ground, bodies of vehicles of `size` at `place` along `axes`, the `things`,
    1 % outliers, half of which lie up to metres below the ground, and holes where nothing matched."""
    half = 0.7 * c.extent
    xy = rng.uniform(-half, half, (int(DENSE_PER_M2 * 4 * half**2), 2))
    holes = rng.uniform(-half, half, (30, 2))
    xy = xy[cKDTree(holes).query(xy)[0] > rng.uniform(1, 6)]
    over = rng.normal(0, DENSE_NOISE, len(xy)) + rng.exponential(GRASS, len(xy)) * (rng.random(len(xy)) < 0.3)
    near = cKDTree(xy).query_ball_point(place, 4.0)
    for some, its_size, its_place, its_axes in zip(near, size, place, axes, strict=True):
        along = np.abs((xy[some] - its_place) @ its_axes.T) / (its_size / 2)
        body = np.array(some, int)[(along < 1).all(1)]
        over[body] = rng.uniform(0.7, 1.5, len(body))
    for middles, reach, tops, rough in things:
        apart, which = cKDTree(middles).query(xy)
        here = apart < reach
        over[here] = (tops[which] * rng.uniform(0.7, 1.0, len(xy)) + rng.normal(0, rough, len(xy)))[here]
    stray = rng.random(len(xy)) < 0.01
    over[stray] += rng.choice([-1, 1], int(stray.sum())) * rng.exponential(2.0, int(stray.sum()))
    return np.column_stack([xy, terrain(xy) + over])


@dataclass(frozen=True)
class _Cloud:
    """As `dense_cloud.DenseCloud`, but without a file. points : (N, 3) [model units]."""

    points: np.ndarray
    named: bool = True
    what: str = "the dense cloud"
    path: Path = Path("simulated.ply")

    def blocks(self) -> list[np.ndarray]:
        return np.array_split(self.points, 8)


def _source(
    world: SceneToModel,
    cameras: list[tuple[np.ndarray, np.ndarray]],
    stretch: np.ndarray,
    points: np.ndarray,
    focal: float,
) -> ColmapSource:
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[focal, WIDTH / 2, HEIGHT / 2], camera_id=1
    )
    model.add_camera_with_trivial_rig(camera)
    for k, (rotation, centre) in enumerate(cameras):
        turned = rotation @ world.rotation.T
        pose = np.column_stack([turned, -turned @ world.points(centre * stretch)])
        image = pycolmap.Image(name=f"{k:03d}.jpg", camera_id=1, image_id=k + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    grey = np.full(3, 128, np.uint8)
    for point in world.points(points * stretch):
        model.add_point3D(point, pycolmap.Track(), grey)
    return ColmapSource(Path("simulated"), Path("simulated"), "bin", [], [], (), model)


def _project(points: np.ndarray, rotation: np.ndarray, centre: np.ndarray, focal: float) -> np.ndarray:
    local = (points - centre) @ rotation.T
    return local[..., :2] / local[..., 2:] * focal + np.array([WIDTH, HEIGHT]) / 2
