"""Boxes with known truth: vehicles seen by a camera, and vehicles of a fleet in an orthophoto."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoscale.core.boxes import KINDS, Boxes
from orthoscale.core.fleet import MEAN_CORRELATION, Fleet
from orthoscale.core.pooling.observed import CALLED_ANYTHING
from orthoscale.core.projection.exact import BODIES, Hull
from orthoscale.core.projection.own_ruler import OwnRuler, SeenBoxes
from orthoscale.core.projection.self_calibration import self_calibrated
from orthoscale.core.projection.view import Views
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import Votes
from orthoscale.synthetic.vehicle import Vehicle

from .camera import simple_views

SMALLEST = 5.0  # px: narrower boxes are not detected
PITCHES = (-90, -75, -60, -45, -30)
UNIT = 0.07  # metres; unit of the views. Nothing depends on it, and models do not know it
# Vans that fleets of cars leave out: 11 % of the light vehicles of Europe (ACEA: 30 of 280 million). Length and width
# [m], mean and spread between vehicles, are those of two segments in the table of fleets: medium (Transit Custom,
# Vivaro), and large (Transit, Sprinter, Crafter).
VAN_SHARE = 0.11
# Each place has its own shares of vehicle kinds in a class (people carriers with a bonnet, vans without), which vary as
# if they came from this many vehicles.
KINDS_LIKE = 5.0
CLASS_MEAN, CLASS_SPREAD = 0.02, 0.15  # errors of the tables' means and spreads per class, one sigma of the logarithm
LEFT_OF_HIDDEN = (0.5, 0.95)  # visible share of the length of a vehicle partly under a tree
VANS = np.array([[[5.00, 1.96], [0.13, 0.04]], [[5.75, 2.03], [0.35, 0.04]]])


@dataclass(frozen=True)
class Flight:
    """A camera and the altitudes [m] it flies at."""

    name: str
    focal_px: float
    image_size: tuple[float, float]
    altitude: tuple[float, float]


DENSEUAV = Flight("DenseUAV", 1000.0, (1440.0, 1080.0), (80.0, 100.0))
VISLOC = Flight("UAV-VisLoc", 4000.0, (4000.0, 3000.0), (300.0, 600.0))


@dataclass(frozen=True)
class Body:
    """The body that a box encloses: points of an outline, in shares of length and width, at heights [m]."""

    name: str
    size: tuple[float, float]  # length, width [m]
    plan: np.ndarray  # (P, 2)
    heights: np.ndarray  # (P,) [m]

    @classmethod
    def of(cls, name: str, hull: Hull, size: tuple[float, float] = (4.4, 1.9)) -> Body:
        return cls(name, size, *hull.outline())

    @property
    def height(self) -> float:
        return float(self.heights.max())


def cuboid(height: float) -> Hull:
    """A cuboid of `height` [m] as a hull."""
    return replace(BODIES["cuboid"], height=height)


@dataclass(frozen=True)
class Seen:
    """Boxes of one flight, with the altitude [m] for each box, the camera and its pitch [rad]."""

    boxes: Boxes
    altitude: np.ndarray
    flight: Flight
    pitch: float

    def views(self, pitch_error: float = 0.0, focal_error: float = 0.0, unit: float = 1.0) -> Views:
        """The boxes' views in units of `unit` metres, by a camera assumed with these errors [rad, share]."""
        f, size = self.flight.focal_px * (1 + focal_error), self.flight.image_size
        return simple_views(self.boxes.centre, size, f, self.pitch + pitch_error, self.altitude / unit)


def fly(rng: np.random.Generator, n: int, flight: Flight, pitch_deg: float, body: Body, tight: bool = False) -> Seen:
    """Boxes of about `n` vehicles, parked in any direction, spread evenly over the image.

    A box lies along the vehicle's heading in the image; with `tight` it is the silhouette's rectangle of least area
    instead. Vehicles that the image cuts off, that are too small, or whose box is wider than long are left out.
    """
    pitch = np.radians(pitch_deg)
    altitude = rng.uniform(*flight.altitude, n)
    extent = np.array(flight.image_size)
    views = simple_views(rng.uniform(0, extent, (n, 2)), flight.image_size, flight.focal_px, pitch, altitude)
    right = np.array([1.0, 0.0, 0.0])  # lies in the ground plane: no roll
    heading = rng.uniform(0, 2 * np.pi, n)[:, None]
    along = np.cos(heading) * right + np.sin(heading) * np.cross(views.normal, right)
    across = np.cross(views.normal, along)

    def project(points: np.ndarray) -> np.ndarray:
        return points[..., :2] / points[..., 2:] * flight.focal_px + extent / 2

    offset = body.plan * body.size
    points = views.ground[:, None] + offset[:, :1] * along[:, None] + offset[:, 1:] * across[:, None]
    seen = project(points + body.heights[:, None] * views.normal[:, None])
    tip = project(views.ground + 1e-3 * along) - project(views.ground)
    angle = np.arctan2(tip[:, 1], tip[:, 0])
    low, high = _extents(seen, angle)
    if tight:
        i, j = np.triu_indices(len(body.plan), 1)
        edges = seen[:, j] - seen[:, i]
        candidates = np.arctan2(edges[..., 1], edges[..., 0])
        areas = np.stack([np.prod(np.subtract(*_extents(seen, a)), axis=1) for a in candidates.T], 1)
        angle = candidates[np.arange(n), np.argmin(areas, 1)]
        low, high = _extents(seen, angle)
    middle, sides = (low + high) / 2, high - low
    keep = (sides[:, 0] >= sides[:, 1]) | tight
    cos, sin = np.cos(angle), np.sin(angle)
    centre = np.stack([middle[:, 0] * cos - middle[:, 1] * sin, middle[:, 0] * sin + middle[:, 1] * cos], -1)
    with np.errstate(invalid="ignore"):
        keep &= (views.ground[:, 2] > 0) & (sides.min(1) >= SMALLEST)
        keep &= ((seen >= 0) & (seen <= extent)).all((1, 2))
    boxes = Boxes(np.column_stack([centre, sides, angle])[keep], np.ones(int(keep.sum())))
    return Seen(boxes, altitude[keep], flight, pitch)


def _extents(points: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) lowest and highest coordinates of points (N, P, 2) in axes rotated by `angle` (N,)."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned = np.stack([points[..., 0] * cos + points[..., 1] * sin, points[..., 1] * cos - points[..., 0] * sin], -1)
    return turned.min(1), turned.max(1)


MESHES = {  # of the synthetic scenes: shape, length, width, height [m]
    "sedan": (4.6, 1.8, 1.45),
    "hatch": (4.0, 1.75, 1.48),
    "suv": (4.6, 1.88, 1.68),
    "van": (5.3, 1.98, 1.98),
    "pickup": (5.4, 1.9, 1.8),
}


def car_mesh(shape: str, reach: float = np.inf) -> Body:
    """The part below `reach` [m] of a mesh with wheels, bumpers and slanting panes, without its mirrors."""
    length, width, height = MESHES[shape]
    mesh = Vehicle(0, 0, 0, length, width, height, shape).mesh(np.random.default_rng(0))
    a, b = mesh.corners.reshape(-1, 3), np.roll(mesh.corners, -1, axis=1).reshape(-1, 3)
    crosses = (a[:, 2] - reach) * (b[:, 2] - reach) < 0 if np.isfinite(reach) else np.zeros(len(a), bool)
    a_cut, b_cut = a[crosses], b[crosses]
    t = (reach - a_cut[:, 2:]) / (b_cut[:, 2:] - a_cut[:, 2:]) if crosses.any() else np.empty((0, 1))
    points = np.unique(np.concatenate([a[a[:, 2] <= reach], a_cut + t * (b_cut - a_cut)]).round(4), axis=0)
    points = points[np.abs(points[:, 1]) <= width / 2 + 1e-3]
    return Body(shape, (length, width), points[:, :2] / (length, width), points[:, 2])


def cut(body: Body, height: float) -> Body:
    """The part of a body below `height` [m], which a detector of that effective height encloses; walls between the
    body's levels are straight."""
    slabs = np.unique(body.heights)
    plans = [body.plan[body.heights == h] for h in slabs]
    below = [k for k, h in enumerate(slabs) if h < height]
    last = below[-1]
    if last + 1 == len(slabs):
        return body
    t = (height - slabs[last]) / (slabs[last + 1] - slabs[last])
    top = plans[last] + t * (plans[last + 1] - plans[last])
    levels = [slabs[k] for k in below] + [height]
    return Body(body.name, body.size, np.concatenate([*plans[: last + 1], top]), np.repeat(levels, len(top)))


def found_ruler(flights: list[Seen], body: str) -> OwnRuler:
    """Height, lean and corner for which a vehicle gets one size at all pitches, found as in a reconstruction: without
    metres, here from groups of boxes of one vehicle. body : assumed shape, one of BODIES."""
    boxes, views = (
        Boxes.concatenate([s.boxes for s in flights]),
        Views.concatenate([s.views(unit=UNIT) for s in flights]),
    )
    groups = np.array_split(np.random.default_rng(0).permutation(len(boxes)), len(boxes) // 20)
    card = OwnRuler.of_card((0.8, 0.8), (0.0, 0.0), (0.6, 0.6), (1e-3, 1e-3), BODIES[body])
    return self_calibrated(SeenBoxes(boxes, views, 1.0, UNIT), groups, card)


def _vehicles_of_place(rng: np.random.Generator, fleet: Fleet) -> float:
    """A random number of vehicles from which a place's shares are as if drawn (`market_segments.PlaceKind`)."""
    kinds = fleet.place_vehicles
    return float(rng.choice([kind.vehicles for kind in kinds], p=[kind.probability for kind in kinds]))


def place_of(rng: np.random.Generator, fleet: Fleet) -> Fleet:
    """The vehicles of one place of a country: with its own shares of all classes, and its own models in each class.

    An unusual place is simulated by few draws from its country's shares, which does not favour classes that are rare
    there; see `with_most` for those.
    """
    weight = np.array([c.weight for c in fleet.every_class])
    weight = weight / weight.sum()
    number = _vehicles_of_place(rng, fleet)
    shares = rng.dirichlet(number * weight)
    classes = []
    for c, country, share in zip(fleet.every_class, weight, shares, strict=True):
        mean = rng.multivariate_normal(c.mean, c.covariance / (number * country + 1))
        classes.append(replace(c, weight=float(share), mean=mean))
    return replace(fleet, classes=tuple(classes), three_wheelers=None)


def not_quite(rng: np.random.Generator, place: Fleet) -> Fleet:
    """`place` with errors in its classes' sizes, as large as the pooling assumes for tables."""
    classes = []
    for c in place.classes:
        off = rng.standard_normal(3)
        off[1] = 0.6 * off[0] + 0.8 * off[1]
        spread = np.exp(CLASS_SPREAD * rng.standard_normal())
        classes.append(replace(c, mean=c.mean * np.exp(CLASS_MEAN * off), sd=c.sd * spread))
    return replace(place, classes=tuple(classes))


@dataclass(frozen=True)
class Vans:
    """Vans at a place, which are not in its fleet: their share of the vehicles, and the share of large ones among
    them."""

    share: float = 0.0
    large: float = 0.5

    @classmethod
    def of_place(cls, rng: np.random.Generator, fleet: Fleet) -> Vans:
        """A random share of vans at a place, which varies like the classes of `fleet`, and a random share of large
        ones."""
        number = _vehicles_of_place(rng, fleet)
        return cls(rng.beta(number * VAN_SHARE, number * (1 - VAN_SHARE)), rng.random())

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, 2) lengths and widths [m]."""
        mean, sd = VANS[(rng.random(n) < self.large).astype(int)].transpose(1, 0, 2)
        return rng.normal(mean, sd)


def called(rng: np.random.Generator, kinds: np.ndarray, ruler: Ruler) -> np.ndarray:
    """(N, 4) probabilities of kinds that a measurer gives to vehicles of true `kinds` (N,), indices into `boxes.KINDS`,
    or -1 for boxes without a vehicle, which get any kind. Each place has its own rates of confusion."""
    many = len(KINDS)
    table = (1 - CALLED_ANYTHING) * np.array(ruler.kinds) + CALLED_ANYTHING / many
    rows = np.array([*(rng.dirichlet(ruler.kinds_vehicles * row) for row in table), rng.dirichlet(np.ones(many))])
    name = (rng.random((len(kinds), 1)) > np.cumsum(rows[kinds], 1)).sum(1).clip(max=many - 1)
    sure = rng.beta(9, 1, (len(kinds), 1))
    return sure * np.eye(many)[name] + (1 - sure) / many


def car_park(
    rng: np.random.Generator,
    fleet: Fleet,
    n: int,
    gsd: float,
    ruler: Ruler,
    vans: Vans = Vans(),
    false: float = 0.0,
    most: tuple[str, float] | None = None,
    hidden: float = 0.0,
    exact: bool = True,
) -> Votes:
    """Votes of `n` boxes in an orthophoto of `gsd` [m/px]; with kinds if `ruler` has a table of them.

    Unknown quantities are drawn anew for each scene, with the uncertainties that `fleet` and `ruler` claim: the place's
    mean sizes, the margin, the boxes' bias, the shrinkage. `vans` stand among the fleet's vehicles; `false`, a share of
    the boxes, are not vehicles. Scores are high for vehicles and low for false boxes, with much overlap. most : a class
    and its share at this place, whatever the country's. hidden : share of the vehicles of which only a part of the
    length is visible. exact : whether the tables of the fleet's classes are exact.
    """
    of_kinds, of_hidden, of_tables = rng.spawn(3)  # so that boxes are the same with and without
    unknown = fleet.mean_sd[:2] / fleet.mean[:2]
    stray = np.sqrt(MEAN_CORRELATION) * rng.standard_normal() + np.sqrt(1 - MEAN_CORRELATION) * rng.standard_normal(2)
    place = place_of(rng, fleet)
    if most is not None:
        place = with_most(place, *most)
    if not exact:
        place = not_quite(of_tables, place)
    size, pick = place.sample_of_classes(rng, n)
    size = size[:, :2] * np.exp(unknown * stray)
    van = rng.random(n) < vans.share
    size[van] = vans.sample(rng, int(van.sum()))
    bias, margin = rng.normal(0, ruler.bias_sd), rng.normal(ruler.margin, ruler.margin_sd)
    shrink = np.asarray(ruler.shrink) + np.asarray(ruler.shrink_sd) * rng.standard_normal()
    drawn = size * (np.asarray(ruler.usual) / size) ** shrink
    px = drawn / gsd * np.exp(bias) + margin + rng.normal(0, ruler.noise, (n, 2))
    px[:, 0] *= np.where(of_hidden.random(n) < hidden, of_hidden.uniform(*LEFT_OF_HIDDEN, n), 1.0)
    wrong = rng.random(n) < false
    length = rng.uniform(1.0, 7.0, int(wrong.sum())) / gsd
    px[wrong] = np.stack([length, length * rng.uniform(0.25, 1.0, len(length))], -1)
    px = np.sort(np.maximum(px, 1.0), axis=1)[:, ::-1]
    score = np.where(wrong, rng.beta(2, 3, n), rng.beta(6, 2, n))
    votes = Votes(px.copy(), np.ones(n), np.ones(n, int), np.zeros((n, 2)), score, [np.array([k]) for k in range(n)])
    if not ruler.kinds:
        return votes
    shares = np.array([of_kinds.dirichlet(KINDS_LIKE * c.kinds + 1e-9) for c in place.classes])[pick]
    kind = (of_kinds.random((n, 1)) > np.cumsum(shares, 1)).sum(1).clip(max=len(KINDS) - 1)
    kind[van], kind[wrong] = KINDS.index("van"), -1
    return replace(votes, kinds=called(of_kinds, kind, ruler))


def with_most(place: Fleet, name: str, share: float) -> Fleet:
    """`place` with the class `name` having this `share` of the vehicles."""
    rest = sum(c.weight for c in place.classes if c.name != name)
    return replace(
        place,
        classes=tuple(
            replace(c, weight=share if c.name == name else (1 - share) * c.weight / rest) for c in place.classes
        ),
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])
