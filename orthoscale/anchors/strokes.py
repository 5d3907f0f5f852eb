"""Painted strokes: straight bright bars on darker ground, with their ends, to a fraction of a pixel.

Neighbouring points on ridges of brightness (Steger, "An unbiased detector of curvilinear structures", PAMI 1998) with
similar directions are joined; straight groups of them are strokes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..core.angles import axis_angle, unit_vector
from ..core.linked import linked

JOINED_HEADING = np.cos(np.radians(20))  # least cosine between the directions of neighbouring ridge points of a stroke
ROUND_STROKE = 0.6  # of the curvature across: with more along, it is a blob
BENT_PX, BENT_WIDE = 0.1, 0.3  # [px] and [sigmas of the filter]: largest one sigma of points across a straight stroke
OFF_PIXEL = 0.6  # [px] from its pixel's centre, to each side, within which a ridge belongs to that pixel
STROKE_FILLED = 0.7  # points of a stroke per pixel of its length, at least
STROKE_POINTS = 0.6  # of the least length: with fewer points [px], a group is no stroke
ASTRAY_PX = 1.3  # [px] from the first line, beyond which a point does not belong to the stroke
FAINTEST_STROKE = 1.2  # [grey levels] curvature across, below which a ridge is noise
STRIP_ROWS = 512  # of a picture that are processed together
PAIRED_AT_ONCE = 500  # strokes
LOOKED_UP = 32000  # places per call of OpenCV
AS_PAINT = 0.65  # paint raises red and green by at least this share of what it raises the strongest channel
STROKE_SURROUNDINGS = 30.0  # [sigmas of the filter] half width of the window for the mean curvature around


@dataclass(frozen=True)
class Strokes:
    """(N,) strokes. centre : (N, 2) [px]. along : (N, 2) unit vector. length : from end to end [px]. apart : of double
    ones, from one line to the other [px]; None for single ones."""

    centre: np.ndarray
    along: np.ndarray
    length: np.ndarray
    apart: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.length)

    def __getitem__(self, which: np.ndarray) -> Strokes:
        apart = None if self.apart is None else self.apart[which]
        return Strokes(self.centre[which], self.along[which], self.length[which], apart)


def near_pairs(
    strokes: Strokes, reach: float, turn: float, astray: float = np.pi / 2
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of strokes whose centres are within `reach` [px], whose directions differ by up to `turn` [rad], and which
    lie up to `astray` [rad] off each other's directions; a few lie farther off. Each pair comes once, in batches of
    some strokes: in a picture full of texture there are more than fit in memory."""
    # One direction after another: with a small `astray` the search box is narrow and lies along it.
    count = int(np.ceil(np.pi / turn))
    half = np.pi / count / 2
    stretch = 1 / np.sin(min(astray + half, np.pi / 2))
    heading = np.arctan2(strokes.along[:, 1], strokes.along[:, 0]) % np.pi
    number = (heading / (2 * half)).astype(int) % count
    for which in np.unique(number):
        middle = (2 * which + 1) * half
        c, s = np.cos(middle), np.sin(middle)
        place = strokes.centre @ np.array([[c, -s * stretch], [s, c * stretch]])
        off = np.abs(axis_angle(heading - middle))
        own, other = np.flatnonzero(number == which), np.flatnonzero(off <= half + turn)
        tree = cKDTree(place[other])
        for k in range(0, len(own), PAIRED_AT_ONCE):
            some = cKDTree(place[own[k : k + PAIRED_AT_ONCE]])
            found = some.sparse_distance_matrix(tree, reach, p=np.inf, output_type="ndarray")
            i, j = own[found["i"] + k], other[found["j"]]
            each = (i < j) & (((strokes.centre[j] - strokes.centre[i]) ** 2).sum(1) <= reach**2)
            yield i[each], j[each]


def paint_light(image: np.ndarray) -> np.ndarray:
    """RGB uint8 (H, W, 3) to float32 (H, W), the mean of red and green, in which white and yellow paint are bright."""
    return (image[..., 0].astype(np.float32) + image[..., 1]) / 2


def values(picture: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values (...) of `picture` (H, W), or (..., C) of one of C channels, at `place` (..., 2) [px], bilinear."""
    flat = place.reshape(-1, 1, 2).astype(np.float32)
    # One call may hold no more than 32767 places.
    parts = [
        cv2.remap(picture, flat[k : k + LOOKED_UP], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
        for k in range(0, len(flat), LOOKED_UP)
    ]
    return np.concatenate(parts).reshape(*place.shape[:-1], *picture.shape[2:]).astype(float)


def painted(paint: np.ndarray, ground: np.ndarray) -> bool:
    """Whether `paint` (3,) differs from `ground` (3,) as white or yellow does: brighter in both red and green."""
    more = paint - ground
    return bool(more[:2].min() > AS_PAINT * max(more.max(), 1.0))


def find_strokes(light: np.ndarray, sigma: float, shortest: float, among: float = 1.0) -> Strokes:
    """The strokes in `light` (H, W), of about ``2 * sigma`` in width and at least `shortest` in length [px].

    among : least curvature of a stroke, as a share of the mean around; less is texture.
    """
    height = light.shape[0]
    margin = int(STROKE_SURROUNDINGS * sigma) + int(np.ceil(4 * sigma)) + 1
    parts = []
    for top in range(0, height, STRIP_ROWS):
        low, end = max(top - margin, 0), min(top + STRIP_ROWS, height)
        points = _ridges(light[low : end + margin], sigma, among)
        points = points[(points[:, 1] >= top - low) & (points[:, 1] < end - low)]
        points[:, [1, 3]] += low
        parts.append(points)
    rows = np.concatenate(parts) if parts else np.zeros((0, 6))
    if len(rows) < 2:
        return Strokes(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    x, y = rows[:, :2].astype(int).T
    member = _joined(light.shape, y, x, rows[:, 4:6])
    return _straight(rows[:, 2:4], member, shortest, BENT_PX + BENT_WIDE * sigma)


def _ridges(light: np.ndarray, sigma: float, among: float) -> np.ndarray:
    """(P, 6) ridge points of `light` (H, W), row by row: pixel (x, y), the ridge's place there (x, y) [px], and the
    unit vector along it (x, y)."""
    gx, gy, hxx, hxy, hyy = _derivatives(light, sigma)
    # The most negative eigenvalue of the Hessian. One pixel in ten is curved as a ridge; only there are the direction
    # across the ridge and the ridge's place computed.
    mean, mixed = (hxx + hyy) / 2, cv2.magnitude((hxx - hyy) / 2, hxy)
    least, most = mean - mixed, mean + mixed
    around = 2 * int(STROKE_SURROUNDINGS * sigma) + 1
    energy = cv2.blur(least * least + most * most, (around, around), borderType=cv2.BORDER_REFLECT)
    needed = np.maximum(FAINTEST_STROKE, among * sigma**2 * np.sqrt(np.maximum(energy, 0)))
    at = np.flatnonzero((-least * sigma**2 > needed) & (np.abs(most) < ROUND_STROKE * -least))
    gx, gy, hxx, hxy, hyy, least = (each.ravel()[at] for each in (gx, gy, hxx, hxy, hyy, least))
    turn = 0.5 * np.arctan2(hxy, (hxx - hyy) / 2) + np.pi / 2
    nx, ny = np.cos(turn), np.sin(turn)
    shift = -(gx * nx + gy * ny) / np.minimum(least, -1e-6)
    y, x = np.divmod(at, light.shape[1])
    points = np.column_stack([x, y, x + shift * nx, y + shift * ny, -ny, nx])
    return points[np.maximum(np.abs(shift * nx), np.abs(shift * ny)) <= OFF_PIXEL]


def _derivatives(light: np.ndarray, sigma: float) -> tuple[np.ndarray, ...]:
    """First and second derivatives of `light`, smoothed by `sigma` [px]: gx, gy, hxx, hxy, hyy."""
    reach = int(np.ceil(4 * sigma))
    t = np.arange(-reach, reach + 1, dtype=np.float64)
    g0 = np.exp(-(t**2) / (2 * sigma**2))
    g0 /= g0.sum()
    g1 = t / sigma**2 * g0
    g1 /= (g1 * t).sum()  # exact for the slope of a ramp
    g2 = (t**2 / sigma**4 - 1 / sigma**2) * g0
    g2 -= g2.mean()
    g2 /= (g2 * t**2).sum() / 2  # exact for the curvature of a parabola

    def filtered(kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(light, cv2.CV_32F, kx, ky, borderType=cv2.BORDER_REPLICATE)

    return filtered(g1, g0), filtered(g0, g1), filtered(g2, g0), filtered(g1, g1), filtered(g0, g2)


def _joined(shape: tuple[int, ...], y: np.ndarray, x: np.ndarray, head: np.ndarray) -> np.ndarray:
    """(P,) number of the group to which each ridge point belongs, at `y`, `x` of a picture of this `shape`."""
    width = shape[1] + 2  # with a margin, so that all points have neighbours
    at = (y + 1) * width + x + 1
    number = np.full((shape[0] + 2) * width, -1, np.int32)
    number[at] = np.arange(len(x))
    hx, hy = np.ascontiguousarray(head.T)
    ends = []
    for step in (1, width - 1, width, width + 1):
        other = number[at + step]
        own = np.flatnonzero(other >= 0)
        other = other[own]
        alike = np.abs(hx[own] * hx[other] + hy[own] * hy[other]) > JOINED_HEADING
        ends.append(np.stack([own[alike], other[alike]]))
    i, j = np.concatenate(ends, axis=1)
    return linked(i, j, len(x))


def _straight(point: np.ndarray, member: np.ndarray, shortest: float, bent: float) -> Strokes:
    """Lines through the points of each group that is long and straight enough.

    It is done twice, as the ridge of a wide bar spreads sideways at its ends: points off the first line are left out of
    the second.
    """
    size = np.bincount(member)
    kept = size[member] >= STROKE_POINTS * shortest
    for _ in range(2):
        point = point[kept]
        number = np.unique(member[kept], return_inverse=True)[1]
        member = number
        n = np.bincount(number)
        centre = np.stack([np.bincount(number, point[:, k]) for k in (0, 1)], -1) / n[:, None]
        off = point - centre[number]
        xx, xy, yy = (np.bincount(number, a * b) / n for a, b in ((off[:, 0],) * 2, off.T, (off[:, 1],) * 2))
        turn = 0.5 * np.arctan2(2 * xy, xx - yy)
        along = unit_vector(turn)
        side = np.abs(off[:, 0] * along[number, 1] - off[:, 1] * along[number, 0])
        kept = side < ASTRAY_PX
    t = (off * along[number]).sum(1)
    across = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    first, last = np.full(len(n), np.inf), np.full(len(n), -np.inf)
    np.minimum.at(first, number, t)
    np.maximum.at(last, number, t)
    centre = centre + along * ((first + last) / 2)[:, None]
    good = (last - first >= shortest) & (across < bent**2) & (n > STROKE_FILLED * (last - first))
    return Strokes(centre, along, last - first)[good]
