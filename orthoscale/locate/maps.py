"""The map on a square grid in metres, and its dense features tile by tile, cached for the next photo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import cv2
import numpy as np

from ..core.evenly import evenly
from ..core.source import NO_DATA_GREY
from ..detect.cache import RASTER_CODE, Kept, content_key
from ..sources.satellite import Satellite
from .features import Features
from .ground import has_data

FEATURE_TILE = 96  # [cells] side of a tile of features
GRID_STEP = 2**0.5  # ratio of the resolutions at which a map's features are made: photos of similar sizes share them
# Code that determines a map's features, for the cache:
FEATURE_CODE = ("locate/maps.py", "locate/features.py", "locate/ground.py", *RASTER_CODE)
IN_MEMORY = 64  # tiles; 75 MB with 64 channels
SAMPLED_TILES = 24  # tiles from which `Usual` is computed


@dataclass(frozen=True)
class MapGrid:
    """A georeferenced map on a grid of square pixels of `gsd` ground metres; x right and y down from its corner.

    pixel : (2,) size on the ground of the map's own pixels, across and down, at the map's middle [m].
    """

    satellite: Satellite
    gsd: float
    pixel: np.ndarray

    @classmethod
    def of(cls, satellite: Satellite, finest: float) -> MapGrid:
        """The grid whose gsd is the smallest of a fixed series that is not finer than `finest` [m/px], nor than the
        map."""
        pixel = satellite.pixel_size(np.array([satellite.source.width, satellite.source.height]) / 2)
        own = float(np.sqrt(pixel.prod()))
        steps = max(0, int(np.ceil(np.log(finest / own) / np.log(GRID_STEP) - 1e-9)))
        return cls(satellite, own * GRID_STEP**steps, pixel)

    @property
    def size(self) -> np.ndarray:
        """(2,) width and height [px of the grid]."""
        return np.array([self.satellite.source.width, self.satellite.source.height]) * self.pixel / self.gsd

    def map_pixel(self, place: np.ndarray) -> np.ndarray:
        """(N, 2) the map's own pixels at places (N, 2) on the grid."""
        return np.asarray(place) * self.gsd / self.pixel

    def place_of(self, map_pixel: np.ndarray) -> np.ndarray:
        """(N, 2) places on the grid of the map's own pixels (N, 2)."""
        return np.asarray(map_pixel) * self.pixel / self.gsd

    def read(self, x: int, y: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """RGB uint8 (height, width, 3) of a window of the grid, and (height, width) bool where the map has data; the
        window may reach beyond the map. Raises InputError where the map is damaged."""
        source = self.satellite.source
        whole = np.array([source.width, source.height])
        corners = self.map_pixel(np.array([[x, y], [x + width, y + height]], float))
        low = np.clip(np.floor(corners[0]).astype(int) - 1, 0, whole)
        high = np.clip(np.ceil(corners[1]).astype(int) + 1, 0, whole)
        span = high - low
        if (span < 1).any():
            return np.full((height, width, 3), NO_DATA_GREY, np.uint8), np.zeros((height, width), bool)
        out = np.maximum(np.rint(span * self.pixel / self.gsd).astype(int), 1)
        part = source.read(*(int(v) for v in (*low, *span, *out)))
        known = has_data(part).astype(np.uint8)
        zoom = span * self.pixel / self.gsd / out  # grid pixels per pixel of `part`, nearly 1
        start = self.place_of(low) - (x, y)
        to_out = np.array([[zoom[0], 0, start[0] + zoom[0] / 2 - 0.5], [0, zoom[1], start[1] + zoom[1] / 2 - 0.5]])
        pixels = cv2.warpAffine(part, to_out, (width, height), borderMode=cv2.BORDER_REPLICATE)
        valid = cv2.warpAffine(known, to_out, (width, height), flags=cv2.INTER_NEAREST)
        return pixels, valid > 0


@dataclass(frozen=True)
class Usual:
    """What is usual on a map: the mean (C,) of its features, and the basis (K, C) in which they are uncorrelated and of
    equal variance. Features are whitened by it, so that unusual places count most."""

    mean: np.ndarray
    basis: np.ndarray

    @classmethod
    def of(cls, samples: Sequence[np.ndarray], channels: int) -> Usual:
        """From features (C, H, W), keeping at most `channels`, those that vary most. Zero vectors do not count."""
        rows = np.concatenate([f[:, np.abs(f).sum(0) > 0].T for f in samples]).astype(np.float64)
        if len(rows) < 2:
            return cls(np.zeros(samples[0].shape[0], np.float32), np.eye(samples[0].shape[0], dtype=np.float32))
        spread, axes = np.linalg.eigh(np.cov(rows.T))
        keep = np.argsort(spread)[::-1][:channels]
        floor = 0.01 * spread.max()  # channels that hardly vary are noise, and stay small
        basis = axes[:, keep].T / np.sqrt(spread[keep] + floor)[:, None]
        return cls(rows.mean(0).astype(np.float32), basis.astype(np.float32))

    def of_features(self, features: np.ndarray) -> np.ndarray:
        """(K, H, W) whitened unit vectors of features (C, H, W); zero vectors stay zero."""
        nil = np.abs(features).sum(0) == 0
        turned = np.tensordot(self.basis, features - self.mean[:, None, None], 1)
        turned /= np.linalg.norm(turned, axis=0) + 1e-6
        turned[:, nil] = 0
        return turned.astype(np.float32)


class MapFeatures:
    """The dense features of a map on a `MapGrid`, made when needed and kept in the user's cache."""

    def __init__(self, grid: MapGrid, features: Features, channels: int, cache: bool = True):
        self.grid, self.features, self._cache = grid, features, cache
        self._tile = lru_cache(IN_MEMORY)(self._made_tile)
        self._channels = channels
        key = content_key([grid.satellite.source], {"features": features.key, "gsd": grid.gsd}, FEATURE_CODE)
        self._kept = Kept(key if cache else None)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the map [cells]."""
        width, height = np.ceil(self.grid.size / self.features.stride).astype(int)
        return int(height), int(width)

    @cached_property
    def usual(self) -> Usual:
        """What is usual on this map, from a sample of its tiles."""
        rows, columns = (range(0, side, FEATURE_TILE) for side in self.shape)
        tiles = [(r, c) for r in rows for c in columns]
        return Usual.of([self._tile(*tiles[k]) for k in evenly(len(tiles), SAMPLED_TILES)], self._channels)

    def window(self, row: int, column: int, height: int, width: int) -> np.ndarray:
        """(K, height, width) unit vectors of a window [cells]; zero where it reaches beyond the map."""
        found = np.zeros((len(self.usual.mean), height, width), np.float32)
        tops, lefts = (
            range(max(start, 0) // FEATURE_TILE * FEATURE_TILE, min(start + side, whole), FEATURE_TILE)
            for start, side, whole in zip((row, column), (height, width), self.shape, strict=True)
        )
        for r, c in product(tops, lefts):
            top, left = max(r, row), max(c, column)
            low, right = min(r + FEATURE_TILE, row + height), min(c + FEATURE_TILE, column + width)
            part = self._tile(r, c)[:, top - r : low - r, left - c : right - c]
            found[:, top - row : low - row, left - column : right - column] = part
        return self.usual.of_features(found)

    def finer(self, finest: float) -> MapFeatures:
        """Features of the same map on the grid not finer than `finest` [m/px], with the `usual` of this one."""
        grid = MapGrid.of(self.grid.satellite, finest)
        fine = MapFeatures(grid, self.features, self._channels, self._cache)
        fine.usual = self.usual
        return fine

    def _made_tile(self, row: int, column: int) -> np.ndarray:
        """(C, FEATURE_TILE, FEATURE_TILE) features of one tile, in half precision as they are kept."""
        name = f"{row},{column}"
        if (content := self._kept.content(name)) is not None:
            return np.frombuffer(content, np.float16).reshape(-1, FEATURE_TILE, FEATURE_TILE)
        stride = self.features.stride
        edge = -(-self.features.border // stride)
        side = (FEATURE_TILE + 2 * edge) * stride
        pixels, valid = self.grid.read((column - edge) * stride, (row - edge) * stride, side, side)
        inner = slice(edge, edge + FEATURE_TILE)
        made = self.features.of(pixels, valid)[:, inner, inner].astype(np.float16)
        self._kept.keep(name, made.tobytes())
        return made
