"""Renders pictures of a scene: a depth buffer finds the face that each sample sees, then these faces are lit.

Faces cover exactly the samples whose centres they contain, so that a vehicle in the picture is as long and wide as
in the truth. A picture is drawn at twice its size and reduced by area averaging.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np

from ..core.angles import quarter_turn
from ..core.boxes import Boxes
from .mesh import Mesh, faces, join
from .scene import Scene
from .texture import BLOTCH_TEXEL_M, atlas, blotch
from .vehicle import Vehicle
from .view import Camera, Ortho, Perspective, Pose, View

SUPERSAMPLING = 2
"""Samples along each side of a pixel."""

SHADE_CELL_M = 0.1
"""Cell size of the map of shadows [m]."""

STAND_OFF_M = 0.2
"""Shadow is looked up this far before a face, so that a wall is not its own shadow."""

LIFT_M, PENUMBRA_M = 0.17, 0.12
"""A face lies in the shade up to `LIFT_M` below the height of the shadow, and in full sun `PENUMBRA_M` above that."""

FRAGMENTS_AT_ONCE = 1 << 19
HAZY_SKY = (0.75, 0.82, 0.9)

# Columns of the table from `_table`: the properties of its face that a sample needs.
NEARNESS = slice(0, 3)
TEXTURE_U, TEXTURE_V = slice(3, 7), slice(7, 11)  # unit vector in the face, and its dot product with the origin
IN_SUN, IN_SHADE = slice(11, 14), slice(14, 17)  # light, red green blue
PLAN_NORMAL = slice(17, 19)
BLOTCHED = slice(19, 20)  # how much the slow change of tone, `blotch`, shows


def surface(mesh: Mesh, view: View) -> tuple[np.ndarray, np.ndarray]:
    """The face that each pixel's centre sees.

    Returns face (H, W) int32, index into the mesh, -1 for none; and (F, 3) nearness planes, see `view`.
    """
    corners, normal = mesh.corners, mesh.normal
    shown = view.faces_viewer(normal, corners[:, 0]) & view.in_front(corners).all(1)
    pixels = view.project(corners)
    low, high = pixels.min(1), pixels.max(1)
    shown &= ((high > 0) & (low < [view.width, view.height])).all(1)
    which = np.flatnonzero(shown)
    planes = np.zeros((len(mesh), 3))
    planes[which] = view.nearness(normal[which], corners[which, 0])
    buffer = np.full(view.width * view.height, -1, np.int64)
    for polygon, row, left, count in _spans(pixels[which], view.width, view.height):
        _fill(buffer, which[polygon], planes[which[polygon]], left, row, count, view.width)
    face = np.where(buffer < 0, -1, buffer & 0xFFFFFFFF).astype(np.int32)
    return face.reshape(view.height, view.width), planes


def _spans(pixels: np.ndarray, width: int, height: int) -> Iterator[tuple[np.ndarray, ...]]:
    """The pixel rows of convex polygons (F, V, 2): yields (polygon, row, first column, length) of spans, in batches.

    A pixel belongs to a polygon if its centre lies inside; adjacent polygons share no pixel and leave none out.
    """
    top, bottom = pixels[..., 1].min(1), pixels[..., 1].max(1)
    first = np.ceil(top - 0.5).clip(0, height).astype(int)
    rows = np.ceil(bottom - 0.5).clip(0, height).astype(int) - first
    offset = np.cumsum(rows) - rows
    polygon = np.repeat(np.arange(len(pixels)), rows)
    row = np.arange(len(polygon)) - offset[polygon] + first[polygon]
    x, y = pixels[..., 0], pixels[..., 1]
    x_next, y_next = np.roll(x, -1, 1), np.roll(y, -1, 1)
    # Counter-clockwise outlines run downwards on their left and upwards on their right.
    sides = []
    for x0, y0, x1, y1 in ((x, y, x_next, y_next), (x_next, y_next, x, y)):
        begin, end = (np.ceil(v - 0.5).clip(0, height).astype(int) for v in (y0, y1))
        f, v = np.nonzero(end > begin)
        begin, count = begin[f, v], (end - begin)[f, v]
        edge = np.repeat(np.arange(len(f)), count)
        r = np.arange(len(edge)) - (np.cumsum(count) - count)[edge] + begin[edge]
        f, v = f[edge], v[edge]
        slope = (x1[f, v] - x0[f, v]) / (y1[f, v] - y0[f, v])
        crossing = np.zeros(len(polygon))
        crossing[offset[f] + r - first[f]] = x0[f, v] + (r + 0.5 - y0[f, v]) * slope
        sides.append(np.ceil(crossing - 0.5).clip(0, width).astype(int))
    left, right = sides
    keep = right > left
    polygon, row, left, count = polygon[keep], row[keep], left[keep], (right - left)[keep]
    portion = np.cumsum(count) // FRAGMENTS_AT_ONCE
    cuts = [0, *(np.flatnonzero(np.diff(portion)) + 1), len(count)]
    for a, b in pairwise(cuts):
        yield polygon[a:b], row[a:b], left[a:b], count[a:b]


def _fill(
    buffer: np.ndarray,
    face: np.ndarray,
    plane: np.ndarray,
    left: np.ndarray,
    row: np.ndarray,
    count: np.ndarray,
    width: int,
) -> None:
    """Enter spans of faces into the buffer of (nearness, face) keys; the nearest face stays."""
    a, b, c = plane.T
    start = (a * (left + 0.5) + b * (row + 0.5) + c).astype(np.float32)
    step = np.arange(count.sum(), dtype=np.int32) - np.repeat((np.cumsum(count) - count).astype(np.int32), count)
    nearness = np.repeat(start, count) + np.repeat(a.astype(np.float32), count) * step.astype(np.float32)
    # Positive floats sort like the integers with the same bits.
    key = np.maximum(nearness, 0).view(np.int32).astype(np.int64) << 32
    key |= np.repeat(face, count)
    np.maximum.at(buffer, np.repeat(row * width + left, count) + step, key)


@dataclass(frozen=True)
class Shade:
    """What hides the light from each place, on the grid of `view`.

    sun : (H, W) [m], the height up to which a place is in shadow. sky : (H, W) [m], blurred heights around each place.
    """

    view: Ortho
    sun: np.ndarray
    sky: np.ndarray

    def at(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 1) shares of the sun's and of the sky's light, 0..1, that reach places (H, W) [m]."""
        cell = self.view.gsd_m
        column = ((x - self.view.x0) / cell - 0.5).astype(np.float32)
        row = ((self.view.y0 - y) / cell - 0.5).astype(np.float32)
        dark, around = (
            cv2.remap(heights, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
            for heights in (self.sun, self.sky)
        )
        sun = np.clip((z + LIFT_M - dark) / PENUMBRA_M, 0, 1)
        sky = 1 - 0.45 * np.clip((around - z) / 1.2, 0, 1)
        return sun[..., None], sky[..., None]


@lru_cache(maxsize=2)
def shade(scene: Scene) -> Shade:
    """The scene's map of shadows: heights seen from above, extended away from the sun while falling at its slope."""
    reach = scene.extent_m / 2 + 20
    cell = max(SHADE_CELL_M, 2 * reach / 2600)
    size = int(2 * reach / cell)
    view = Ortho(-reach, reach, cell, size, size)
    face, planes = surface(scene.mesh, view)
    y, x = np.indices(face.shape, np.float32) + 0.5
    near = planes.astype(np.float32)[face]
    height = np.where(face < 0, 0, view.position(x, y, near[..., 0] * x + near[..., 1] * y + near[..., 2])[2])
    height = np.maximum(height, 0).astype(np.float32)
    away = -scene.sun[:2] / np.hypot(*scene.sun[:2])
    fall = scene.sun[2] / np.hypot(*scene.sun[:2])
    sun, step = height, 1.0
    while step * cell * fall < height.max(initial=0):
        move = np.array([[1, 0, away[0] * step], [0, 1, -away[1] * step]])
        moved = cv2.warpAffine(sun, move, (size, size), flags=cv2.INTER_LINEAR)
        sun = np.maximum(sun, moved - step * cell * fall)
        step *= 2
    sky = cv2.GaussianBlur(np.minimum(height, 3.0), (0, 0), 0.45 / cell)
    return Shade(view, cv2.GaussianBlur(sun, (0, 0), 0.7), sky)


def light(scene: Scene, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Linear light (H, W, 3) float32 that reaches each pixel's centre, and the owner (H, W) of the face it sees."""
    mesh, face, planes = _seen(scene, view)
    table = _table(mesh, planes, scene, view)
    texels, offset, side, per_metre = atlas(view.sample_m())
    shadows, tint = shade(scene), blotch()
    out = np.empty((view.height, view.width, 3), np.float32)
    strip = max(1, (1 << 17) // view.width)
    for r in range(0, view.height, strip):
        f = face[r : r + strip]
        y = np.arange(r, r + len(f), dtype=np.float32)[:, None] + 0.5
        x = np.arange(view.width, dtype=np.float32)[None] + 0.5
        t = table[f]
        a, b, c = np.moveaxis(t[..., NEARNESS], -1, 0)
        nearness = a * x + b * y + c
        px, py, pz = view.position(x, y, np.maximum(nearness, 1e-6))
        m = mesh.material[f]
        mask, texture_at = side[m] - 1, []
        for column in (TEXTURE_U, TEXTURE_V):
            ex, ey, ez, zero = np.moveaxis(t[..., column], -1, 0)
            metres = px * ex + py * ey + pz * ez - zero
            texture_at.append(np.floor(metres * per_metre[m]).astype(np.int64) & mask)
        texture = texels[offset[m] + texture_at[1] * side[m] + texture_at[0]]
        nx, ny = np.moveaxis(t[..., PLAN_NORMAL], -1, 0) * STAND_OFF_M
        in_sun, in_shade = shadows.at(px + nx, py + ny, pz)
        tone = 1 + t[..., BLOTCHED] * (_tiled(tint, px / BLOTCH_TEXEL_M, py / BLOTCH_TEXEL_M) - 1)
        out[r : r + strip] = (t[..., IN_SUN] * in_sun + t[..., IN_SHADE] * in_shade) * texture * tone
        out[r : r + strip][nearness <= 1e-6] = HAZY_SKY
    return out, mesh.owner[face]


def depth(scene: Scene, view: Perspective) -> np.ndarray:
    """(H, W) float64 depth along the optical axis of what each pixel's centre sees [m]; NaN for the sky.

    Raises ValueError for a camera with distortion.
    """
    if view.camera.k1:
        raise ValueError("depth is drawn for cameras without distortion")
    _, face, planes = _seen(scene, view)
    y, x = np.indices(face.shape) + 0.5
    a, b, c = np.moveaxis(planes[face], -1, 0)
    nearness = a * x + b * y + c
    return np.where(nearness > 1e-6, 1 / np.maximum(nearness, 1e-6), np.nan)


def _seen(scene: Scene, view: View) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """The scene's mesh with its infinite ground as face 0, and the result of `surface` for it, with the ground where
    nothing else is seen."""
    ground = faces(np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 1.0, *scene.ground)
    mesh = join([ground, scene.mesh])
    face, planes = surface(mesh, view)
    planes[:1] = view.nearness(np.array([[0.0, 0, 1]]), np.zeros((1, 3)))
    return mesh, np.maximum(face, 0), planes


def _tiled(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A tiling picture interpolated at `x`, `y` [texels]."""
    size = len(picture)
    x, y = (np.mod(w, size).astype(np.float32) for w in (x, y))
    return cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def _table(mesh: Mesh, planes: np.ndarray, scene: Scene, view: View) -> np.ndarray:
    """(F, 20) float32, a row for each face; see `NEARNESS` and the columns after it."""
    normal = mesh.normal
    across = np.cross(normal, mesh.along)
    middle = mesh.corners[:, :3].mean(1)
    viewer = view.towards(middle)
    half = viewer + scene.sun
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    facing = (normal @ scene.sun).clip(0, None)[:, None]
    up = 0.5 + 0.5 * normal[:, 2:]
    gloss = mesh.gloss[:, None]
    # Lacquer and glass mirror a few per cent of the sky, more at grazing angles (Schlick), and a soft sun.
    mirror = gloss * (0.04 + 0.5 * (1 - np.abs((normal * viewer).sum(1, keepdims=True))) ** 4)
    glint = gloss * 0.25 * ((normal * half).sum(1, keepdims=True).clip(0, None) ** 60)
    sunny = scene.sunlight * (mesh.colour * facing + glint * (facing > 0))
    skylit = scene.skylight * (mesh.colour * (0.75 * up + 0.25) + mirror)
    return np.concatenate(
        [planes, mesh.along, (mesh.along * mesh.origin).sum(1, keepdims=True),
         across, (across * mesh.origin).sum(1, keepdims=True), sunny, skylit, normal[:, :2], 1 - np.sign(gloss)], 1
    ).astype(np.float32)  # fmt: skip


@dataclass(frozen=True)
class Look:
    """How a camera turns light into pixel values.

    exposure : factor on the light. balance : (3,) factors on red, green, blue. saturation, contrast : 1 is neutral.
    haze : share of grey veil. blur_px : standard deviation of the blur by lens and motion. sharpen : strength of the
    camera's own sharpening. noise : standard deviation [of 255]. vignette : loss of light in the corners.
    """

    exposure: float = 1.0
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    saturation: float = 1.0
    contrast: float = 1.0
    haze: float = 0.0
    blur_px: float = 0.35
    sharpen: float = 0.0
    noise: float = 1.5
    vignette: float = 0.0

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Look:
        """A random camera, on a random day."""
        return cls(
            exposure=float(np.exp(rng.normal(0.3, 0.35))),
            balance=tuple(np.exp(rng.normal(0, 0.03, 3)) * [1, 1, 1]),
            saturation=float(rng.uniform(0.7, 1.3)),
            contrast=float(rng.uniform(0.95, 1.4)),
            haze=float(rng.uniform(0, 0.12) * (rng.random() < 0.4)),
            blur_px=float(rng.choice([rng.uniform(0.25, 0.6), rng.uniform(0.5, 1.2)], p=[0.6, 0.4])),
            sharpen=float(rng.choice([0.0, rng.uniform(0.2, 0.9)])),
            noise=float(rng.choice([rng.uniform(0.3, 2.0), rng.uniform(1.5, 4.5)], p=[0.7, 0.3])),
            vignette=float(rng.uniform(0, 0.25) * (rng.random() < 0.3)),
        )

    def develop(self, linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Linear light (H, W, 3) to uint8 RGB."""
        height, width = linear.shape[:2]
        x = linear * (np.array(self.balance, np.float32) * self.exposure)
        if self.vignette:
            gx, gy = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)
            x *= 1 - self.vignette / 2 * (gx[None, :, None] ** 2 + gy[:, None, None] ** 2)
        x = x * (1 - self.haze) + 0.45 * self.haze
        x = cv2.GaussianBlur(x, (0, 0), self.blur_px) if self.blur_px > 0.2 else x
        # A tone curve whose shoulder keeps highlights from clipping hard, then the display's gamma.
        x = np.sqrt(np.maximum(x * (1 + x / 2.2) / (1 + x), 0)) ** 0.95
        grey = cv2.cvtColor(x, cv2.COLOR_RGB2GRAY)[..., None]
        x = (grey + self.saturation * (x - grey) - 0.45) * self.contrast + 0.45
        if self.sharpen:
            x = x + self.sharpen * (x - cv2.GaussianBlur(x, (0, 0), 1.2))
        grain = rng.standard_normal((height, width, 1), np.float32) * self.noise / 255
        grain = grain + rng.standard_normal(x.shape, np.float32) * (self.noise * 0.4 / 255)
        return ((x + grain) * 255 + 0.5).clip(0, 255).astype(np.uint8)


def render(scene: Scene, view: View, seed: int = 0, look: Look | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The picture (H, W, 3) uint8 RGB, and the vehicle that each pixel sees (H, W) int, -1 for none. As a pixel has no
    sample at its centre, the one to the right and below it counts."""
    rng = np.random.default_rng([seed, 77])
    look = Look.drawn(rng) if look is None else look
    ideal = view.ideal()
    linear, owner = light(scene, ideal.enlarged(SUPERSAMPLING))
    linear = cv2.resize(linear, (ideal.width, ideal.height), interpolation=cv2.INTER_AREA)
    owner = owner[1::SUPERSAMPLING, 1::SUPERSAMPLING]
    if isinstance(view, Perspective) and ideal is not view:
        y, x = np.indices((view.height, view.width)) + 0.5
        place = view.undistorted(np.stack([x, y], -1)) * view.camera.focal_px
        at = (place + np.array([ideal.width, ideal.height]) / 2 - 0.5).astype(np.float32)
        linear = cv2.remap(linear, at[..., 0], at[..., 1], cv2.INTER_CUBIC).clip(0, None)
        owner = cv2.remap(owner.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_NEAREST).astype(int)
    return look.develop(linear, rng), owner


def ortho_view(scene: Scene, gsd_m: float) -> Ortho:
    """The view of the whole scene at `gsd_m` metres per pixel."""
    size = max(1, round(scene.extent_m / gsd_m))
    return Ortho(-size * gsd_m / 2, size * gsd_m / 2, gsd_m, size, size)


def render_ortho(scene: Scene, gsd_m: float, seed: int = 0, look: Look | None = None) -> tuple[np.ndarray, Boxes]:
    """A true orthophoto of the whole scene: (image (H, W, 3) uint8 RGB, the boxes of all vehicles in it)."""
    view = ortho_view(scene, gsd_m)
    image, _ = render(scene, view, seed, look)
    boxes = vehicle_boxes(scene.vehicles, view)
    return image, boxes[boxes.inside(view.width, view.height)]


def render_frame(scene: Scene, camera: Camera, pose: Pose, seed: int = 0, look: Look | None = None) -> np.ndarray:
    """One frame of a flight, (H, W, 3) uint8 RGB.

    Its truth is ``vehicle_boxes(scene.vehicles, Perspective(camera, pose))``.
    """
    return render(scene, Perspective(camera, pose), seed, look)[0]


def vehicle_boxes(vehicles: tuple[Vehicle, ...], view: View, effective_height_m: float = 0.8) -> Boxes:
    """The box of every vehicle as a detector would draw it, in the order of `vehicles`, whether visible or not.

    Its long side lies along the projected heading, and it just encloses the footprint on the ground and the same
    rectangle at `effective_height_m`. In a true orthophoto that is the footprint.
    """
    if not vehicles:
        return Boxes.empty()
    plan = np.stack([v.footprint for v in vehicles])
    solid = np.stack([np.insert(plan, 2, z, axis=2) for z in (0.0, effective_height_m)], 1).reshape(-1, 8, 3)
    corners = view.project(solid)
    ahead = corners[:, [1, 2, 5, 6]].mean(1) - corners[:, [0, 3, 4, 7]].mean(1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    aside = quarter_turn(ahead)
    along, across = (np.einsum("nkc,nc->nk", corners, axis) for axis in (ahead, aside))
    centre = [(v.max(1) + v.min(1))[:, None] / 2 * axis for v, axis in ((along, ahead), (across, aside))]
    xylwa = np.column_stack([sum(centre), np.ptp(along, 1), np.ptp(across, 1), np.arctan2(ahead[:, 1], ahead[:, 0])])
    return Boxes(xylwa, np.ones(len(vehicles)))
