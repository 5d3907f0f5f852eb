"""Random training crops: first geometry (one affine map), then light and sensor.

A crop is drawn so that its vehicles come out 11 to 75 px long, at any rotation, mirrored or not, with the slight
anisotropy and lean that oblique views and bent orthophotos have. Half of the crops of scenes without vehicles get some
pasted in, and half get glints.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from .data import LabelledImage
from .geometry import LENGTH_RANGE, MAX_ENLARGEMENT, transform_boxes, warp
from .paste import paste
from .targets import CROP, encode

# Instead of LENGTH_RANGE for ground without vehicles [px]: the scale search also looks at twice the right zoom.
BARE_RANGE = (11.0, 150.0)
PASTED = 0.5  # share of the crops without vehicles that get some
GLINTING = 0.5  # share of the crops without vehicles that get glints
DECEIVING = 0.5  # share of the crops of pictures with lookalikes that are centred on these, not on vehicles
SHADED = 0.35  # share of the crops with shadows cast on them
# Shares of the crops whose colours are changed or lost, whose contrast is stretched, that are enlarged from fewer
# pixels, and that are sharpened.
COLOURED, STRETCHED, ENLARGED, SHARPENED = 0.4, 0.25, 0.15, 0.25
# Share of the crops that are stretched along one axis, and by how much (one sigma, log). This gives vehicles of other
# shapes than in the training scenes; without it, a detector partly draws unusual shapes back to the usual one.
RESHAPED, SHAPES_SD = 0.3, 0.12


def crops(images: list[LabelledImage], weights: dict[str, float], seed: int) -> Iterator[tuple[np.ndarray, ...]]:
    """Endless (image (3, CROP, CROP) uint8 RGB, *targets of :func:`encode`), scenes drawn by weight."""
    rng = np.random.default_rng(seed)
    by_scene: dict[str, list[LabelledImage]] = {}
    for image in images:
        by_scene.setdefault(image.scene, []).append(image)
    names = list(by_scene)
    p = np.array([weights.get(name, 0.1) for name in names])
    p /= p.sum()
    donors = [image for image in images if len(image.vehicles)]
    while True:
        members = by_scene[names[rng.choice(len(names), p=p)]]
        yield crop(members[rng.integers(len(members))], rng, donors)


def crop(
    image: LabelledImage, rng: np.random.Generator, donors: list[LabelledImage] | None = None
) -> tuple[np.ndarray, ...]:
    """One random crop of `image` with its targets; vehicles of `donors` may be pasted into one without vehicles."""
    vehicles = image.vehicles
    lengths = LENGTH_RANGE if len(vehicles) else BARE_RANGE
    scale = np.exp(rng.uniform(*np.log(lengths))) / (image.median_length or image.usual_length)
    if scale > MAX_ENLARGEMENT:
        scale = MAX_ENLARGEMENT * rng.uniform(0.6, 1.0)
    shown = image.lookalikes if len(image.lookalikes) and rng.random() < DECEIVING else vehicles
    if len(shown) and rng.random() < 0.7:
        centre = shown[rng.integers(len(shown)), :2] + rng.uniform(-0.4, 0.4, 2) * CROP / scale
    else:
        centre = rng.uniform(0, 1, 2) * (image.width, image.height)
    # Keep most of the crop inside the picture: there is nothing to learn outside.
    half = np.minimum(0.45 * CROP / scale, np.array([image.width, image.height]) / 2)
    centre = np.clip(centre, half, (image.width, image.height) - half)
    turn = rng.uniform(0, 2 * np.pi)
    linear = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear = linear @ np.diag([rng.choice([-1.0, 1.0]), 1.0])
    if rng.random() < 0.4:
        linear = linear @ (np.eye(2) + rng.normal(0, 0.05, (2, 2)))
    if rng.random() < RESHAPED:
        longer = np.exp(rng.normal(0, SHAPES_SD) / 2)
        linear = np.diag([longer, 1 / longer]) @ linear
    shift = CROP / 2 - linear @ centre

    pixels, boxes = warp(image, linear, shift, scale, rng), transform_boxes(image.boxes, linear, shift)
    is_vehicle = image.is_vehicle
    if not is_vehicle.any() and rng.random() < GLINTING:
        pixels = glints(pixels, rng)
    if donors and not is_vehicle.any() and rng.random() < PASTED:
        pixels, added = paste(pixels, boxes, donors, rng)
        boxes, is_vehicle = np.r_[boxes, added], np.r_[is_vehicle, np.ones(len(added), bool)]
    lit = photometric(pixels, rng)
    return np.ascontiguousarray(lit.transpose(2, 0, 1)), *encode(boxes, is_vehicle)


def glints(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Bright (or dark) specks, elongated in one direction, like glints of the sun on water; uint8 in and out.

    They are where a random field is high. The network took the glints of a river, magnified, for white cars.
    """
    size = np.exp(rng.uniform(*np.log((2.0, 12.0))))  # about the specks' half width [px]
    field = rng.standard_normal((CROP, CROP), np.float32)
    field = cv2.GaussianBlur(field, (0, 0), sigmaX=size * rng.uniform(1.0, 3.0), sigmaY=size)
    turn = cv2.getRotationMatrix2D((CROP / 2, CROP / 2), rng.uniform(0, 180), 1.0)
    field = cv2.warpAffine(field, turn, (CROP, CROP), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    field = field / field.std() - rng.uniform(1.0, 2.5)
    speck = np.clip(field / rng.uniform(0.1, 0.8), 0, 1)[..., None] * np.float32(rng.uniform(0.5, 1.0))
    colour = np.float32(rng.uniform(200, 255, 3) if rng.random() < 0.8 else rng.uniform(0, 255, 3))
    return (pixels + speck * (colour - pixels)).astype(np.uint8)


def edge_shadow(rng: np.random.Generator) -> np.ndarray:
    """(CROP, CROP) float32, 1 in the shadow of something outside the crop, 0 in the sun."""
    corners = rng.uniform(-0.3, 1.3, (4, 2)) * CROP
    mask = np.zeros((CROP, CROP), np.float32)
    cv2.fillConvexPoly(mask, cv2.convexHull(corners.astype(np.int32)), 1.0)
    return cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.6, 3))


COARSER = 8  # factor by which the grid is coarser on which the shadow of whole crowns is drawn


def leaves(rng: np.random.Generator) -> np.ndarray:
    """(CROP, CROP) float32, 1 in the shadow of trees, 0 in the sun and in the flecks of sun that come through.

    Without this the network overlooked vehicles parked below trees.
    """
    cover = np.ones((CROP, CROP), np.float32)
    for size, share in ((rng.uniform(20, 60), rng.uniform(0.3, 0.9)), (rng.uniform(1.5, 6), rng.uniform(0.7, 1.0))):
        coarser = COARSER if size > 2 * COARSER else 1  # so smooth a field needs no more pixels
        field = rng.standard_normal((CROP // coarser, CROP // coarser), np.float32)
        field = cv2.GaussianBlur(field, (0, 0), size / coarser, borderType=cv2.BORDER_REFLECT)
        field = cv2.resize(field, (CROP, CROP), interpolation=cv2.INTER_CUBIC)
        field = (field - np.quantile(field, 1 - share)) / field.std()
        cover *= np.clip(0.5 + field / rng.uniform(0.2, 1.0), 0, 1).astype(np.float32)
    return cover


def photometric(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Changes of light, haze, cast shadows, colour, and the processing by cameras and orthophoto software; uint8 in and
    out."""
    x = pixels.astype(np.float32) / 255
    if rng.random() < 0.8:
        x **= np.float32(np.exp(rng.normal(0, 0.35)))
        x *= (rng.uniform(0.65, 1.3) * (1 + rng.normal(0, 0.09, 3))).astype(np.float32)
        x += np.float32(rng.uniform(-0.1, 0.1))
    if rng.random() < 0.12:  # haze
        x += np.float32(rng.uniform(0.1, 0.5)) * (np.float32(rng.uniform(0.6, 0.9)) - x)
    if rng.random() < SHADED:
        light = np.float32(rng.uniform(0.2, 0.7) * np.array([0.93, 0.98, 1.09]))  # only light of the sky, bluish
        cover = leaves(rng) if rng.random() < 0.6 else edge_shadow(rng)
        x *= 1 + (light - 1) * cover[..., None]
    if rng.random() < COLOURED:  # none at all in a third
        share = np.float32(0 if rng.random() < 1 / 3 else rng.uniform(0.3, 1.7))
        x = share * x + (1 - share) * x.mean(2, keepdims=True)
    if rng.random() < STRETCHED:
        x = stretch(x, rng)
    x = sensed(np.clip(x, 0, 1), rng)
    x = np.round(x * 255).astype(np.uint8)
    if rng.random() < 0.3:
        _, jpeg = cv2.imencode(".jpg", x, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 92))])
        x = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    return x


def stretch(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Contrast stretched as in orthophotos, until some shadows are black and some light things white."""
    low, high = np.quantile(x[::4, ::4], (rng.uniform(0, 0.06), 1 - rng.uniform(0, 0.06)))
    return (x - np.float32(low)) / np.float32(max(high - low, 0.1))


def sensed(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each by chance: blurred, enlarged from fewer pixels, sharpened until edges have halos, noisy; float32 0..1 in and
    out."""
    if rng.random() < 0.3:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.3, 1.4))
    if rng.random() < ENLARGED:
        side = round(CROP / rng.uniform(1.2, 2.5))
        few = cv2.resize(x, (side, side), interpolation=cv2.INTER_AREA)
        x = cv2.resize(few, (CROP, CROP), interpolation=int(rng.choice((cv2.INTER_LINEAR, cv2.INTER_CUBIC))))
    if rng.random() < SHARPENED:
        x += np.float32(rng.uniform(0.5, 2.5)) * (x - cv2.GaussianBlur(x, (0, 0), rng.uniform(0.6, 1.6)))
    if rng.random() < 0.3:
        noise = rng.standard_normal(x.shape, np.float32)
        x += np.float32(rng.uniform(0.005, 0.04)) * noise
    return np.clip(x, 0, 1)
