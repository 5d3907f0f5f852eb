"""Windows of the map that an embedding network finds most similar to the photo (the paradigm of arXiv 2603.07535).

The map is cut into squares as large as the photo's ground, each shifted by half of its side. The user supplies the
network and its card: an ONNX file with one image as input and one vector as output. It runs in a process of its own.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..detect.cache import RASTER_CODE, Kept, content_key
from ..detect.detector import load_network
from ..detect.foreign import ForeignError
from ..detect.output_forms import IMAGENET, Normalisation
from ..errors import InputError
from ..formats.reading import decoded
from .correlate import Peak
from .ground import GroundImage
from .maps import MapFeatures, MapGrid
from .register import Way

WINDOW_STRIDE = 0.5  # of a window's side by which the next one is shifted; as in the paper
EMBEDDING_METADATA = "orthoscale"  # key of the ONNX file's metadata that holds the card
EMBEDDING_SIZE = 224  # [px] side of the network's input, if neither file nor card gives it
EMBEDDING_CARD, EMBEDDING_HINT = (
    "a card of an embedding network",
    "See docs/locate.md: its name, size and normalisation, all optional.",
)
EMBEDDING_CODE = ("locate/retrieval.py", "locate/maps.py", *RASTER_CODE)


@dataclass(frozen=True)
class EmbeddingCard:
    """The card of an embedding network. size : side of its square input [px]."""

    name: str
    size: int
    normalisation: Normalisation


class Embedding:
    """A network that makes a unit vector from a picture. notes : what was assumed about it."""

    def __init__(self, path: Path):
        """Load the network at `path`. Raises InputError for any other file."""
        self.path, content, self._network = load_network(path, "", os.cpu_count() or 1)
        self.sha256 = hashlib.sha256(content).hexdigest()
        self.notes: list[str] = []
        inputs, outputs, metadata = self._network.said
        if len(inputs) != 1 or inputs[0][1] != "tensor(float)" or len(inputs[0][2]) != 4 or len(outputs) < 1:
            raise InputError(f"{path}: not a network with one image as its input", "Export it as [1, 3, H, W] floats.")
        self.card = self._card(inputs[0][2], metadata.get(EMBEDDING_METADATA))

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """(D,) unit vector of `image`, RGB uint8 (h, w, 3), resampled to the network's size. Raises InputError."""
        how, side = self.card.normalisation, self.card.size
        smaller = cv2.INTER_AREA if min(image.shape[:2]) > side else cv2.INTER_CUBIC
        pixels = cv2.resize(image, (side, side), interpolation=smaller).astype(np.float32)
        pixels = pixels if how.channels == "RGB" else pixels[..., ::-1]
        scaled = (pixels - np.array(how.mean, np.float32)) / np.array(how.std, np.float32)
        try:
            vector = self._network.run(scaled.transpose(2, 0, 1)[None])[0].astype(np.float32).ravel()
        except ForeignError as error:
            raise InputError(
                f"{self.path}: the network fails on an image of {side} px ({error})", EMBEDDING_HINT
            ) from error
        length = float(np.linalg.norm(vector))
        if not (np.isfinite(length) and length > 0):
            raise InputError(f"{self.path}: the network's vector is zero or not a number", "Export it again.")
        return vector / length

    def _card(self, shape: Sequence[object], text: str | None) -> EmbeddingCard:
        fixed = shape[2] if isinstance(shape[2], int) and shape[2] > 0 and shape[2] == shape[3] else None
        if text is None:
            size = fixed or EMBEDDING_SIZE
            self.notes.append(
                f"{self.path.name} has no card: its input is taken as {size} x {size} px, normalised as for ImageNet"
            )
            return EmbeddingCard(self.path.stem, size, IMAGENET)
        from msgspec import UNSET, structs

        from ..formats.schemas.networks import EmbeddingCardEntry

        origin = f"{self.path}: its card"
        entry = decoded(text, EmbeddingCardEntry, origin, EMBEDDING_CARD, EMBEDDING_HINT)
        how = entry.normalisation
        normalisation = IMAGENET if how is UNSET else Normalisation(**structs.asdict(how))
        size = fixed or (EMBEDDING_SIZE if entry.size is None else entry.size)
        return EmbeddingCard(entry.name or self.path.stem, size, normalisation)


@dataclass(frozen=True)
class Retrieval:
    """A `register.PlaceFinder`: the windows most similar to the photo, by the networks `photo` and `ground` for either
    side."""

    photo: Embedding
    ground: Embedding
    cache: bool
    notes: tuple[str, ...] = ()

    @classmethod
    def open(cls, photo: Path, ground: Path | None, cache: bool) -> Retrieval:
        """Load one network for both sides, or two. Raises InputError."""
        one = Embedding(photo)
        other = one if ground is None else Embedding(ground)
        return cls(one, other, cache, tuple(dict.fromkeys([*one.notes, *other.notes])))

    def __call__(
        self,
        ways: Sequence[Way],
        mapped: MapFeatures,
        area: tuple[int, int, int, int],
        apart: float,
        most: int,
        step: Callable[[int, int], None] | None = None,
    ) -> list[Peak]:
        """See `register.PlaceFinder`. `apart` is not used: the stride sets how far windows are apart."""
        grid, stride = mapped.grid, mapped.features.stride
        squares = [central_square(way.template.image) for way in ways]
        side = int(np.median([len(square) for square in squares]))
        ours = np.array([self.photo(square) for square in squares])
        places = centres(area, side / stride)
        windows = self._windows(grid, side)
        theirs = []
        for k, place in enumerate(places):
            theirs.append(windows(*(int(v) for v in np.rint(place * stride - side / 2))))
            if step:
                step(k + 1, len(places))
        alike = np.array(theirs) @ ours.T
        order = np.argsort(-alike.max(1))[:most]
        return [
            Peak(float(alike[k].max()), int(alike[k].argmax()), int(places[k][0]), int(places[k][1])) for k in order
        ]

    def _windows(self, grid: MapGrid, side: int) -> Callable[[int, int], np.ndarray]:
        """A function that gives the vector of the window of `side` px of `grid` at a row and a column; vectors are kept
        for the next photo."""
        settings = {"network": self.ground.sha256, "card": repr(self.ground.card), "gsd": grid.gsd, "side": side}
        kept = Kept(content_key([grid.satellite.source], settings, EMBEDDING_CODE) if self.cache else None)

        def vector(row: int, column: int) -> np.ndarray:
            name = f"{row},{column}"
            if (content := kept.content(name)) is not None:
                return np.frombuffer(content, np.float32)
            made = self.ground(grid.read(column, row, side, side)[0])
            kept.keep(name, made.tobytes())
            return made

        return vector


def central_square(image: GroundImage) -> np.ndarray:
    """(S, S, 3) the largest square about the middle of a turned picture in which every pixel is valid."""
    rows, columns = np.nonzero(image.valid)
    row, column = (int(each.min() + each.max() + 1) // 2 for each in (rows, columns))
    low, high = 1, min(row, column, image.valid.shape[0] - row, image.valid.shape[1] - column)
    while low < high:  # a smaller square about the same middle lies in a larger one
        half = (low + high + 1) // 2
        if image.valid[row - half : row + half, column - half : column + half].all():
            low = half
        else:
            high = half - 1
    return image.pixels[row - low : row + low, column - low : column + low]


def centres(area: tuple[int, int, int, int], side: float) -> np.ndarray:
    """(N, 2) rows and columns of the middles of squares of `side` that cover `area` (row, column, height, width)
    [cells], each shifted by at most WINDOW_STRIDE of its side."""
    top, left, height, width = area
    along = [np.linspace(0, size, max(2, int(np.ceil(size / (WINDOW_STRIDE * side))) + 1)) for size in (height, width)]
    rows, columns = np.meshgrid(top + along[0], left + along[1], indexing="ij")
    return np.column_stack([rows.ravel(), columns.ravel()])
