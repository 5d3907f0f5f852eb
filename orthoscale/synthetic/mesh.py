"""Meshes: everything in a synthetic scene is a list of flat convex polygons in metres, z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from .texture import MATERIALS

CORNERS = 12
"""Corners stored per face; faces with fewer repeat their last one."""

Colour = Sequence[float] | np.ndarray
"""Linear albedo, red green blue, 0..1; (3,) or one per face (F, 3)."""

Surface = tuple[str, Colour]
"""What something is made of: a material of `texture.MATERIALS` and its colour."""


@dataclass(frozen=True)
class Mesh:
    """F flat convex faces.

    corners : (F, CORNERS, 3) [m], counter-clockwise seen from the visible side; the last corner repeats.
    material : (F,) int, index into `texture.MATERIALS`.
    colour : (F, 3) linear albedo.
    gloss : (F,) 0 (matt) .. 1 (glass, lacquer).
    owner : (F,) int, index of the vehicle that the face belongs to, -1 for everything else.
    along : (F, 3) unit vector of the texture's u axis; v is normal x u.
    origin : (F, 3) [m] where the texture's u and v are zero.
    """

    corners: np.ndarray
    material: np.ndarray
    colour: np.ndarray
    gloss: np.ndarray
    owner: np.ndarray
    along: np.ndarray
    origin: np.ndarray

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def normal(self) -> np.ndarray:
        """(F, 3) unit normals, by Newell's method, which allows repeated corners."""
        a, b = self.corners, np.roll(self.corners, -1, axis=1)
        n = np.cross(a - a[:, :1], b - a[:, :1]).sum(1)
        return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)

    def placed(self, x: float, y: float, heading: float = 0.0, z: float = 0.0) -> Mesh:
        """The mesh rotated counter-clockwise by `heading` [rad] about the origin, then moved."""
        cos, sin = np.cos(heading), np.sin(heading)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        shift = np.array([x, y, z])
        return replace(
            self, corners=self.corners @ turn.T + shift, along=self.along @ turn.T, origin=self.origin @ turn.T + shift
        )

    def owned(self, owner: int) -> Mesh:
        """The same faces, as parts of the vehicle with the index `owner`."""
        return replace(self, owner=np.full(len(self), owner))


def join(meshes: Sequence[Mesh]) -> Mesh:
    """All faces of `meshes`, in order."""
    if not meshes:
        return faces(np.empty((0, 3, 3)), "plain", (0, 0, 0))
    return Mesh(*(np.concatenate([getattr(m, f.name) for m in meshes]) for f in fields(Mesh)))


def faces(
    corners: np.ndarray,
    material: str,
    colour: Colour,
    gloss: float = 0.0,
    along: np.ndarray | None = None,
    origin: np.ndarray | None = None,
) -> Mesh:
    """F faces of n corners each, (F, n, 3) or (n, 3); textures run along the first edge from the first corner."""
    corners = np.asarray(corners, float)
    corners = corners[None] if corners.ndim == 2 else corners
    count, n = corners.shape[:2]
    if along is None:
        edge = corners[:, 1] - corners[:, 0]
        along = edge / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-12)
    if origin is None:
        origin = corners[:, 0]
    return Mesh(
        np.concatenate([corners, np.repeat(corners[:, -1:], CORNERS - n, 1)], 1),
        np.full(count, MATERIALS.index(material)),
        np.broadcast_to(np.asarray(colour, float), (count, 3)).copy(),
        np.full(count, gloss),
        np.full(count, -1),
        np.broadcast_to(along, (count, 3)).copy(),
        np.broadcast_to(origin, (count, 3)).copy(),
    )


def at_height(outline: np.ndarray, z: float | np.ndarray) -> np.ndarray:
    """Plan points (n, 2) lifted to height z: (n, 3)."""
    outline = np.asarray(outline, float)
    return np.column_stack([outline, np.broadcast_to(z, len(outline))])


def loft(low: np.ndarray, high: np.ndarray, material: str, colour: Colour, gloss: float = 0.0) -> Mesh:
    """The band between two rings of n points (n, 3), counter-clockwise from above: n faces looking outwards."""
    quads = np.stack([low, np.roll(low, -1, 0), np.roll(high, -1, 0), high], 1)
    return faces(quads, material, colour, gloss)


def rectangle(length: float, width: float) -> np.ndarray:
    """(4, 2) plan of a rectangle about the origin, counter-clockwise, the first edge along +x."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [length / 2, width / 2]


def rounded(length: float, width: float, front: float, rear: float) -> np.ndarray:
    """(12, 2) plan of a rectangle with rounded corners of radius `front` (at +x) and `rear`, counter-clockwise."""
    points = []
    for sx, sy, r in ((-1, -1, rear), (1, -1, front), (1, 1, front), (-1, 1, rear)):
        x, y, cut = sx * length / 2, sy * width / 2, r * (1 - np.sqrt(0.5))
        arc = [(x - sx * r, y), (x - sx * cut, y - sy * cut), (x, y - sy * r)]
        points += arc if sx == sy * -1 else arc[::-1]
    return np.array(points)


def disc(radius: float, points: int = 10) -> np.ndarray:
    """(points, 2) plan of a regular polygon about the origin, counter-clockwise; at most `CORNERS` points."""
    angle = np.arange(points) * 2 * np.pi / points
    return radius * np.stack([np.cos(angle), np.sin(angle)], 1)


def patch(outline: np.ndarray, z: float, material: str, colour: Colour, gloss: float = 0.0) -> Mesh:
    """A horizontal face over a convex plan (n, 2)."""
    return faces(at_height(outline, z), material, colour, gloss)


def pavement(
    x: tuple[float, float], y: tuple[float, float], z: float, material: str, colour: Colour, piece: float = 8.0
) -> Mesh:
    """An axis-parallel rectangle of ground, in pieces so that those behind a camera can be left out.

    All pieces share one texture origin.
    """
    nx, ny = (max(1, int(np.ceil((b - a) / piece))) for a, b in (x, y))
    gx, gy = np.linspace(*x, nx + 1), np.linspace(*y, ny + 1)
    x0, y0 = (g.ravel() for g in np.meshgrid(gx[:-1], gy[:-1]))
    x1, y1 = (g.ravel() for g in np.meshgrid(gx[1:], gy[1:]))
    plan = np.stack([np.stack([x0, y0], 1), np.stack([x1, y0], 1), np.stack([x1, y1], 1), np.stack([x0, y1], 1)], 1)
    corners = np.concatenate([plan, np.full((*plan.shape[:2], 1), z)], 2)
    return faces(corners, material, colour, along=np.array([1.0, 0, 0]), origin=np.array([x[0], y[0], 0.0]))


def prism(
    outline: np.ndarray, low: float, high: float, walls: Surface, top: Surface | None = None, gloss: float = 0.0
) -> Mesh:
    """Upright walls over a convex plan (n, 2) from height `low` to `high`, and a lid (like the walls by default)."""
    sides = loft(at_height(outline, low), at_height(outline, high), *walls, gloss)
    return join([sides, patch(outline, high, *(walls if top is None else top), gloss)])


def gable(
    length: float, width: float, eaves: float, ridge: float, walls: Surface, roof: Surface, overhang: float = 0.4
) -> Mesh:
    """A house about the origin: walls to the eaves, two roof slopes with the ridge along x, triangular gables."""
    x, y = length / 2, width / 2
    body = loft(at_height(rectangle(length, width), 0), at_height(rectangle(length, width), eaves), *walls)
    gable_end = np.array([[x, -y, eaves], [x, y, eaves], [x, 0, ridge]])
    drop = (ridge - eaves) / y * overhang
    x, y, low = x + overhang, y + overhang, eaves - drop
    slope = np.array([[-x, -y, low], [x, -y, low], [x, 0, ridge], [-x, 0, ridge]])
    both_ways = np.array([[[1, 1, 1]], [[-1, -1, 1]]])
    return join([body, faces(gable_end * both_ways, *walls), faces(slope * both_ways, *roof)])


def hip(
    length: float, width: float, eaves: float, ridge: float, walls: Surface, roof: Surface, overhang: float = 0.4
) -> Mesh:
    """As `gable`, but sloping on all four sides."""
    body = loft(at_height(rectangle(length, width), 0), at_height(rectangle(length, width), eaves), *walls)
    x, y = length / 2 + overhang, width / 2 + overhang
    low, r = eaves - (ridge - eaves) / (width / 2) * overhang, max(length - width, 0.2) / 2
    side = np.array([[-x, -y, low], [x, -y, low], [r, 0, ridge], [-r, 0, ridge]])
    end = np.array([[x, -y, low], [x, y, low], [r, 0, ridge], [r, 0, ridge]])
    both_ways = np.array([[[1, 1, 1]], [[-1, -1, 1]]])
    return join([body, faces(side * both_ways, *roof), faces(end * both_ways, *roof)])


def dome(
    rng: np.random.Generator,
    centre: tuple[float, float, float],
    radius: float,
    height: float,
    colour: Colour,
    rings: int = 4,
    segments: int = 9,
    ragged: float = 0.14,
    material: str = "leaves",
) -> Mesh:
    """An irregular ellipsoid of triangles, without its lowest part: a bush, a boulder, one bough of a tree."""
    polar = np.linspace(0.12, 0.68, rings)[:, None] * np.pi
    azimuth = (np.arange(segments) + 0.5 * np.arange(rings)[:, None]) * 2 * np.pi / segments
    unit = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth], -1)
    shell = unit * (1 + ragged * rng.standard_normal((rings, segments, 1)).clip(-2, 2))
    shell = shell * [radius, radius, height] + np.array(centre)
    top = np.array(centre) + [0, 0, height * (1 + ragged * rng.uniform(-1, 1))]
    following = np.roll(shell, -1, axis=1)
    triangles = [np.stack([shell[0], following[0], np.broadcast_to(top, (segments, 3))], 1)]
    for k in range(1, rings):
        # Each ring is rotated by half a segment, so that the band between two consists of two rows of triangles.
        low, low_next, high, high_next = shell[k], following[k], shell[k - 1], following[k - 1]
        triangles += [np.stack([low, high_next, high], 1), np.stack([low, low_next, high_next], 1)]
    corners = np.concatenate(triangles)
    tone = np.asarray(colour, float) * rng.uniform(0.8, 1.25, (len(corners), 1))
    return faces(corners, material, tone)
