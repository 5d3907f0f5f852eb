"""Surface textures: small tileable pictures that multiply a face's colour, mean 1, at a known size in metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

TEXTURE_SIZE = 512
"""Texels along each side of a texture."""

BLOTCH_TEXEL_M = 0.35
"""Metres per texel of `blotch`, the slow change of tone that keeps the other textures from showing their repeats."""


def fractal(rng: np.random.Generator, slope: float, coarsest: float = 0.0) -> np.ndarray:
    """(TEXTURE_SIZE, TEXTURE_SIZE) tileable noise with amplitude ~ frequency**-slope, mean 0, standard deviation 1.

    coarsest : frequencies below this many cycles per picture are flattened, so that repeats do not show.
    """
    size = TEXTURE_SIZE
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]) * size
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) / np.maximum(f, max(coarsest, 1.0)) ** slope
    spectrum[0, 0] = 0
    noise = np.fft.irfft2(spectrum, s=(size, size))
    return (noise / noise.std()).astype(np.float32)


def _grid(u_m: float, v_m: float, texel: float, shift: float = 0.0) -> tuple[np.ndarray, ...]:
    """Cells of about u_m x v_m that tile the picture: (column, row, place in the cell along u, along v; 0..1).

    shift : share of a cell by which every other row is moved.
    """
    nu, nv = (2 * max(1, round(TEXTURE_SIZE * texel / m / 2)) for m in (u_m, v_m))
    t = np.arange(TEXTURE_SIZE) / TEXTURE_SIZE
    u, v = t[None] * nu + np.zeros((TEXTURE_SIZE, 1)), t[:, None] * nv + np.zeros((1, TEXTURE_SIZE))
    row = v.astype(int)
    u = u + shift * (row % 2)
    return u.astype(int) % nu, row, u % 1, v % 1


def _per_cell(rng: np.random.Generator, column: np.ndarray, row: np.ndarray, spread: float) -> np.ndarray:
    return 1 + spread * rng.standard_normal((row.max() + 1, column.max() + 1))[row, column]


def _lines(place: np.ndarray, width: float) -> np.ndarray:
    """1 on the seam between cells, 0 elsewhere; `width` is a share of the cell."""
    return (np.abs(place - 0.5) > 0.5 - width / 2).astype(np.float32)


@dataclass(frozen=True)
class _Noise:
    """Ingredients of materials: noise (SIZE, SIZE) from independent texels (`white`) to the smoothest, and `rng`."""

    rng: np.random.Generator
    texel: float
    white: np.ndarray
    fine: np.ndarray
    middle: np.ndarray
    slow: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, texel: float) -> _Noise:
        """For a material with `texel` metres per texel."""
        white = rng.standard_normal((TEXTURE_SIZE, TEXTURE_SIZE)).astype(np.float32)
        return cls(rng, texel, white, *(fractal(rng, s, coarsest=c) for s, c in ((0.6, 8), (1.1, 6), (1.6, 4))))


Painter = Callable[[_Noise], np.ndarray]
"""Gives (SIZE, SIZE) or (SIZE, SIZE, 3) of a material, before its mean is set to 1."""


def _plain(n: _Noise) -> np.ndarray:
    return 1 + 0.02 * n.fine


def _paint(n: _Noise) -> np.ndarray:
    return 1 + 0.015 * n.slow


def _asphalt(n: _Noise) -> np.ndarray:
    return 1 + 0.05 * n.white + 0.04 * n.fine + 0.03 * n.slow


def _worn_asphalt(n: _Noise) -> np.ndarray:
    cracks = np.exp(-((fractal(n.rng, 1.5, coarsest=5) / 0.035) ** 2)) * (n.slow > 0.2)
    repairs = np.where(n.slow > 1.5, 0.72, 1.0)
    return (1 + 0.06 * n.white + 0.07 * n.fine + 0.06 * n.middle - 0.35 * cracks) * repairs


def _concrete(n: _Noise) -> np.ndarray:
    column, row, u, v = _grid(2.5, 2.5, n.texel)
    joint = np.maximum(_lines(u, 0.02), _lines(v, 0.02))
    return (1 + 0.03 * n.white + 0.05 * n.middle) * _per_cell(n.rng, column, row, 0.04) * (1 - 0.35 * joint)


def _paving(n: _Noise) -> np.ndarray:
    column, row, u, v = _grid(0.4, 0.2, n.texel, 0.5)
    joint = np.maximum(_lines(u, 0.08), _lines(v, 0.12))
    return (1 + 0.04 * n.white + 0.05 * n.middle) * _per_cell(n.rng, column, row, 0.1) * (1 - 0.3 * joint)


def _grass(strength: float, bare: float) -> Painter:
    def paint(n: _Noise) -> np.ndarray:
        tone = 1 + strength * n.fine + 0.08 * n.white + 0.06 * n.middle
        dryness = (bare * (0.12 * n.slow + 0.08 * n.fine)).clip(-0.3, 0.6)[..., None]
        return tone[..., None] * (1 + dryness * np.array([1.1, 0.25, 0.3]))

    return paint


def _soil(n: _Noise) -> np.ndarray:
    tracks = np.exp(-((n.middle / 0.15) ** 2))
    return 1 + 0.06 * n.white + 0.12 * n.fine + 0.1 * n.slow - 0.06 * tracks


def _sand(n: _Noise) -> np.ndarray:
    ripples = np.sin(np.arange(TEXTURE_SIZE)[:, None] * 2 * np.pi * 64 / TEXTURE_SIZE + 2.5 * n.slow)
    return 1 + 0.03 * n.white + 0.05 * n.fine + 0.05 * ripples * (0.5 + 0.5 * np.tanh(n.middle))


def _grains(grain: float) -> Painter:
    def paint(n: _Noise) -> np.ndarray:
        return 1 + grain * (0.5 * n.white + cv2.GaussianBlur(n.white, (0, 0), 1.2) * 2) + 0.06 * n.slow

    return paint


def _field(n: _Noise) -> np.ndarray:
    rows = np.sin(np.arange(TEXTURE_SIZE)[None] * 2 * np.pi * 34 / TEXTURE_SIZE + 0.5 * n.slow)
    return (1 + 0.12 * rows + 0.1 * n.fine + 0.06 * n.white)[..., None] * (
        1 + 0.1 * n.middle[..., None] * [1, 0.3, 0.2]
    )


def _water(n: _Noise) -> np.ndarray:
    waves = np.sin(np.arange(TEXTURE_SIZE)[None] * 2 * np.pi * 40 / TEXTURE_SIZE + 3 * n.slow)
    return 1 + 0.04 * waves + 0.06 * n.fine + 0.08 * n.slow


def _tiles(n: _Noise) -> np.ndarray:
    column, row, u, v = _grid(0.26, 0.36, n.texel)
    roll = 0.8 + 0.4 * np.sin(np.pi * u) - 0.25 * _lines(v, 0.2)
    return roll * _per_cell(n.rng, column, row, 0.09) * (1 + 0.1 * n.slow + 0.04 * n.white)


def _corrugated(n: _Noise) -> np.ndarray:
    sheet, row, u, _ = _grid(1.0, 4.0, n.texel)
    wave = 1 + 0.16 * np.sin(2 * np.pi * u * 4)
    rust = np.clip(n.slow + 0.4 * n.fine - 1.1, 0, 1)[..., None] * np.array([-0.15, -0.4, -0.55])
    return (wave * _per_cell(n.rng, sheet, row, 0.07) * (1 + 0.03 * n.white))[..., None] * (1 + rust)


def _seam(n: _Noise) -> np.ndarray:
    sheet, row, u, _ = _grid(0.5, 6.0, n.texel)
    return (1 - 0.3 * _lines(u, 0.09) + 0.2 * _lines(u - 0.09, 0.09)) * _per_cell(n.rng, sheet, row, 0.03)


def _bitumen(n: _Noise) -> np.ndarray:
    sheet, row, u, v = _grid(1.0, 5.0, n.texel)
    puddles = np.clip(n.slow - 0.9, 0, 0.8)
    joint = np.maximum(_lines(u, 0.05), _lines(v, 0.02))
    return (
        (1 + 0.05 * n.white + 0.06 * n.fine - 0.3 * puddles) * _per_cell(n.rng, sheet, row, 0.06) * (1 - 0.25 * joint)
    )


def _leaves(n: _Noise) -> np.ndarray:
    clumps = cv2.GaussianBlur(n.white, (0, 0), 3) * 10 + cv2.GaussianBlur(n.white, (0, 0), 1.2) * 2.2 + 0.5 * n.fine
    return np.clip(1 + 0.3 * clumps, 0.2, 2.2)


def _facade(n: _Noise) -> np.ndarray:
    _, _, u, v = _grid(3.0, 3.0, n.texel)
    window = (np.abs(u - 0.5) < 0.24) & (np.abs(v - 0.55) < 0.25)
    return np.where(window, 0.25, 1.0 + 0.05 * n.slow)


def _plaster(n: _Noise) -> np.ndarray:
    return 1 + 0.04 * n.slow + 0.03 * n.fine


def _solar(n: _Noise) -> np.ndarray:
    _, _, u, v = _grid(1.0, 1.7, n.texel)
    frame = np.maximum(_lines(u, 0.06), _lines(v, 0.04))
    cell = np.maximum(_lines(u * 6 % 1, 0.08), _lines(v * 10 % 1, 0.08))
    return 1 + 4 * frame + 0.5 * cell


def _planks(n: _Noise) -> np.ndarray:
    column, row, u, _ = _grid(0.15, 3.0, n.texel)
    return _per_cell(n.rng, column, row, 0.12) * (1 - 0.4 * _lines(u, 0.15)) * (1 + 0.05 * n.fine)


PAINTED: dict[str, tuple[float, Painter]] = {
    "plain": (0.05, _plain),
    "paint": (0.05, _paint),
    "asphalt": (0.04, _asphalt),
    "worn_asphalt": (0.04, _worn_asphalt),
    "concrete": (0.03, _concrete),
    "paving": (0.02, _paving),
    "grass": (0.06, _grass(0.13, 0.5)),
    "dry_grass": (0.06, _grass(0.16, 1.0)),
    "soil": (0.05, _soil),
    "sand": (0.05, _sand),
    "gravel": (0.03, _grains(0.16)),
    "field": (0.05, _field),
    "water": (0.08, _water),
    "tiles": (0.03, _tiles),
    "corrugated": (0.03, _corrugated),
    "seam": (0.03, _seam),
    "bitumen": (0.04, _bitumen),
    "roof_gravel": (0.03, _grains(0.12)),
    "leaves": (0.03, _leaves),
    "facade": (0.06, _facade),
    "plaster": (0.04, _plaster),
    "solar": (0.02, _solar),
    "planks": (0.02, _planks),
    "rubble": (0.03, _grains(0.3)),
}
"""Metres per texel of each material, and what paints it."""
MATERIALS = tuple(PAINTED)
"""Names of the materials; a mesh stores indices into this."""


@cache
def _levels(name: str) -> tuple[np.ndarray, ...]:
    """The texture as float32 (s, s, 3) with mean 1, and its mipmaps: each half the size, down to 1 texel."""
    texel, paint = PAINTED[name]
    noise = _Noise.drawn(np.random.default_rng(MATERIALS.index(name)), texel)
    picture = np.asarray(paint(noise), np.float32)
    picture = picture[..., None] if picture.ndim == 2 else picture
    picture = np.broadcast_to(picture, (TEXTURE_SIZE, TEXTURE_SIZE, 3)).clip(0.05, None)
    levels = [(picture / picture.mean()).astype(np.float32)]
    while len(levels[-1]) > 1:
        half = len(levels[-1]) // 2
        levels.append(levels[-1].reshape(half, 2, half, 2, 3).mean((1, 3)))
    return tuple(levels)


@cache
def blotch() -> np.ndarray:
    """(SIZE, SIZE, 3) float32, the slow change of tone and hue over the ground; mean 1."""
    rng = np.random.default_rng(9)
    tone, hue = fractal(rng, 1.3), fractal(rng, 1.5)
    return (1 + 0.1 * tone[..., None] + 0.035 * hue[..., None] * np.array([1, 0, -1])).clip(0.5, 1.6).astype(np.float32)


def atlas(sample_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """All materials, each reduced until a texel is about as large as a sample of the picture (`sample_m` [m]).

    Returns (texels (T, 3) float32, and per material: offset of its first texel, side in texels, texels per metre).
    """
    return _atlas(round(float(np.log2(sample_m)) * 2) / 2)


@cache
def _atlas(octave: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    chosen, side, per_metre = [], [], []
    for name, (texel, _) in PAINTED.items():
        level = int(np.clip(round(octave - float(np.log2(texel))), 0, len(_levels(name)) - 1))
        chosen.append(_levels(name)[level].reshape(-1, 3))
        side.append(TEXTURE_SIZE >> level)
        per_metre.append(1 / (texel * 2**level))
    offset = np.cumsum([0, *[len(c) for c in chosen[:-1]]])
    return np.concatenate(chosen), offset.astype(np.int64), np.array(side), np.array(per_metre, np.float32)
