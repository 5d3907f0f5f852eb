"""The measurer: a second network that looks at a detected vehicle once more and locates its four edges.

It sees a crop along the vehicle's axis, `CROP_LENGTHS` times as long as its box and half as wide as that, at
`CROP_WIDTH` x `CROP_HEIGHT` px whatever the picture's resolution. The exported network averages over the crop's
mirrors, so that it does not matter which way a vehicle points or whether a picture is mirrored. Each of `PASSES_EACH`
passes cuts its crop along the box that the last one found, so that the result does not depend on the proposed box.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from ..core.angles import quarter_turn, unit_vector
from ..core.boxes import KINDS, Boxes
from ..core.ruler import Ruler
from ..core.source import NO_DATA_GREY, Picture
from ..errors import InputError
from ..formats.reading import decoded
from .detector import load_network
from .enlarged import AS_IT_IS
from .foreign import ForeignError
from .shade import SHADOW_CONTRAST, lightness

SHIPPED_MEASURER = "measurer.onnx"

CROP_WIDTH, CROP_HEIGHT = 96, 48  # of the crop that the network sees [px]
CROP_LENGTHS = 1.7  # length of the crop in lengths of the proposed box
AROUND = 0.85  # half side of the window that is read around the box's centre, in lengths of the crop
BATCH = 32  # crops per run
# Each pass leaves a quarter to a half of the proposed box's influence on the result; after four none is left.
PASSES_EACH = 4
# An unsure edge is moved by at most this share of the length. Pickup beds and shaded bonnets that were left out are up
# to a tenth of it; an edge that is unsure by more may be anywhere.
MOVED_AT_MOST = 0.08
MOVED_SD = 1 / 3  # additional uncertainty of a moved edge (one sigma), as a share of the distance that it was moved
NO_DATA = (NO_DATA_GREY,) * 3  # beyond the picture's edge
ANSWERS = (*KINDS, "none")

OUTPUTS = ("edges", "sigma", "turn", "seen", "kind")
MEASURER_CARD, MEASURER_HINT = (
    "a measurer with an orthoscale card that can be read",
    "Export it with training.measurer.export.",
)


@dataclass(frozen=True)
class MeasurerCard:
    """A measurer's description, stored in the ONNX file's metadata under ``orthoscale``.

    ruler : of its boxes, in pixels of the picture, since it works at the picture's own resolution.
    sigma_times : (2,) factors by which the errors of its lengths and widths exceed the sigmas that it states.
    effective_height : the height up to which its boxes enclose a vehicle seen obliquely, along length and width [m].
    undercut : how far inside its outline a vehicle meets the ground, along length and width [m]; 0 if unknown.
    body : the shape that its boxes enclose in oblique views, one of `core.projection.exact.BODIES`.
    inward : how far an unsure edge lies inside the vehicle, per unit by which its sigma exceeds a sure edge's. An edge
        that may be either the bonnet's or the bumper's is placed between the two, but the vehicle ends at the outer.
    sure : sigma of an edge that is as sure as can be: share of the vehicle's length, and px of the picture.
    """

    name: str
    ruler: Ruler
    sigma_times: tuple[float, float]
    effective_height: tuple[float, float]
    body: str
    undercut: tuple[float, float] = (0.0, 0.0)
    inward: float = 0.0
    sure: tuple[float, float] = (0.0, 0.0)
    training: str = ""
    licence: str = ""

    @classmethod
    def from_json(cls, text: str, origin: str) -> MeasurerCard:
        """Parse the text in a file's metadata; messages call it `origin`. Raises InputError if it is not a card."""
        from msgspec import structs

        from ..formats.schemas.networks import MeasurerCardEntry

        entry = decoded(text, MeasurerCardEntry, origin, MEASURER_CARD, MEASURER_HINT)
        return cls(**structs.asdict(entry) | {"ruler": entry.ruler.ruler})

    def sure_sigma(self, length: np.ndarray, pixel: float = 1.0) -> np.ndarray:
        """(N, 1) sigma of a sure edge of vehicles of `length` (N,) [px], seen in pixels of the size `pixel` [px]."""
        share, px = self.sure
        return np.hypot(share * length, px * pixel)[:, None]

    def outward(self, sigma: np.ndarray, length: np.ndarray, pixel: float = 1.0, soft: float = 1.0) -> np.ndarray:
        """(N, 4) how far to move edges of `sigma` (N, 4) outwards [px], for vehicles of `length` (N,) [px].

        pixel : size of the pixels that were looked at [px of the picture]. soft : factor by which the sigma of a sure
            edge exceeds that in a sharp picture (`soft.softness`).
        """
        excess = sigma - soft * self.sure_sigma(length, pixel)
        return np.clip(self.inward * excess, 0.0, MOVED_AT_MOST * length[:, None])


# Row k: the order of the edges, as in `Measured.sigma`, after a box was turned by k quarters.
TURNED_EDGES = np.array([[0, 1, 2, 3], [2, 3, 1, 0], [1, 0, 3, 2], [3, 2, 0, 1]])
FIRST_COLUMNS = (5, 9, 13, 13 + len(ANSWERS))  # of sigma, seen, kind and light in `Measured.rows`, after the box


@dataclass(frozen=True)
class Measured:
    """The measurer's results for N vehicles.

    boxes : their boxes, edge to edge; the score is the proposed box's.
    sigma : (N, 4) one standard deviation of each edge's position [px of the picture]. In the box's own axes the edges
        are -x, +x, -y, +y: both ends, then left and right side as seen along its direction (image coordinates, y down).
    seen : (N, 4) 0..1, the probability that each edge is visible, not under a tree or beyond the picture's edge.
    kind : (N, 5) probabilities of `ANSWERS`.
    light : (N,) how light its paint is, as in `shade.lightness`.
    """

    boxes: Boxes
    sigma: np.ndarray
    seen: np.ndarray
    kind: np.ndarray
    light: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """(N, 19) all of it but the scores as numbers, one row per vehicle."""
        return np.column_stack([self.boxes.xylwa, self.sigma, self.seen, self.kind, self.light])

    @classmethod
    def along(
        cls,
        xylwa: np.ndarray,
        score: np.ndarray,
        sigma: np.ndarray,
        seen: np.ndarray,
        kind: np.ndarray,
        light: np.ndarray,
    ) -> Measured:
        """Results given along boxes `xylwa` (N, 5) of any direction; `Boxes` turns them along the longer side.

        score : (N,) of the proposed boxes. The others are as the fields.
        """
        boxes = Boxes(xylwa, score)
        edges = TURNED_EDGES[np.round((boxes.angle - xylwa[:, 4]) / (np.pi / 2)).astype(int) % 4]
        return cls(boxes, np.take_along_axis(sigma, edges, 1), np.take_along_axis(seen, edges, 1), kind, light)

    @classmethod
    def of_rows(cls, rows: np.ndarray, score: np.ndarray) -> Measured:
        """The inverse of `rows` (N, 19), with the scores (N,) of the proposed boxes."""
        xylwa, sigma, seen, kind, light = np.split(rows, FIRST_COLUMNS, axis=1)
        return cls.along(xylwa, score, sigma, seen, kind, light[:, 0])

    def moved_out(self, outward: np.ndarray) -> Measured:
        """The same with edges farther out by `outward` (N, 4) [px], and accordingly less certain."""
        boxes = replace(self.boxes, xylwa=moved_out(self.boxes.xylwa, outward))
        return replace(self, boxes=boxes, sigma=np.hypot(self.sigma, MOVED_SD * outward))

    @property
    def size_sigma(self) -> np.ndarray:
        """(N, 2) one standard deviation of length and width [px], if the two edges of each are independent."""
        variance = self.sigma**2
        return np.sqrt(np.stack([variance[:, :2].sum(1), variance[:, 2:].sum(1)], 1))


def pixels_per_crop_pixel(box: np.ndarray) -> float:
    """Picture pixels across one pixel of the crop of a box (5,)."""
    return CROP_LENGTHS * max(box[2], 2 * box[3]) / CROP_WIDTH


def crop(picture: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(CROP_HEIGHT, CROP_WIDTH, 3) uint8, the picture (H, W, 3) along `box` (5,), whose centre is the crop's.

    Enlarged by cubic interpolation; reduced by averaging over `n` x `n` samples for each crop pixel, `n` being the
    number of picture pixels across it.
    """
    step = pixels_per_crop_pixel(box)
    n = int(np.clip(np.ceil(step), 1, 16))
    fine = step / n  # picture pixels per sample
    along = fine * unit_vector(box[4])
    linear = np.column_stack([along, quarter_turn(along)])  # from samples to the picture
    middle = np.array([n * CROP_WIDTH / 2, n * CROP_HEIGHT / 2])
    # OpenCV puts a pixel's centre at its integer index, our boxes put it half a pixel further.
    shift = box[:2] - linear @ middle + linear @ (0.5, 0.5) - 0.5
    samples = cv2.warpAffine(
        picture, np.c_[linear, shift], (n * CROP_WIDTH, n * CROP_HEIGHT),
        flags=(cv2.INTER_CUBIC if n == 1 else cv2.INTER_LINEAR) | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT, borderValue=NO_DATA,
    )  # fmt: skip
    return samples if n == 1 else cv2.resize(samples, (CROP_WIDTH, CROP_HEIGHT), interpolation=cv2.INTER_AREA)


def placed(box: np.ndarray, edges: np.ndarray, turn: float) -> np.ndarray:
    """(5,) box in the picture. edges : (4,) -x, +x, -y, +y from the crop's centre [crop px]. turn : of the box against
    the proposed `box` (5,) [rad]."""
    step = pixels_per_crop_pixel(box)
    x, y = step * np.array([edges[0] + edges[1], edges[2] + edges[3]]) / 2
    along = unit_vector(box[4])
    size = np.maximum(step * np.array([edges[1] - edges[0], edges[3] - edges[2]]), 1e-3)
    return np.array([*(box[:2] + (x * along + y * quarter_turn(along))), *size, box[4] + turn])


def moved_out(boxes: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Boxes (N, 5) whose edges, in the order of `Measured.sigma`, lie farther out by `outward` (N, 4) [px]."""
    low, high = outward[:, [0, 2]], outward[:, [1, 3]]
    shift, along = (high - low) / 2, unit_vector(boxes[:, 4])
    centre = boxes[:, :2] + (shift[:, :1] * along + shift[:, 1:] * quarter_turn(along))
    return np.column_stack([centre, boxes[:, 2:4] + low + high, boxes[:, 4]])


class Measurer:
    """Holds one network; safe to call from several threads.

    card : its description. sha256 : of its file.
    """

    def __init__(self, path: Path | None = None, threads: int = 1) -> None:
        """Load a network that `training.measurer` made, by default the shipped one.

        threads : of one run. Raises InputError for a file that cannot be read or is not a measurer.
        """
        self._path, content, self._network = load_network(path, SHIPPED_MEASURER, threads)
        inputs, outputs, metadata = self._network.said
        if [name for name, *_ in inputs] != ["crops"] or tuple(name for name, *_ in outputs) != OUTPUTS:
            raise InputError(f"{self._path}: not a measurer", MEASURER_HINT)
        self.card = MeasurerCard.from_json(metadata.get("orthoscale", ""), str(self._path))
        self.sha256 = hashlib.sha256(content).hexdigest()

    def _run(self, crops: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Edges (N, 4) and their sigmas (N, 4) [crop px], turn (N,) [rad], seen (N, 4), kind (N, 5)."""
        batches = [np.stack(crops[k : k + BATCH]).transpose(0, 3, 1, 2) for k in range(0, len(crops), BATCH)]
        try:
            parts = [self._network.run(batch.astype(np.float32)) for batch in batches]
        except ForeignError as error:
            raise InputError(f"{self._path}: the network fails on a crop ({error})", MEASURER_HINT) from error
        return [np.concatenate(part).astype(float) for part in zip(*parts, strict=True)]

    def __call__(
        self,
        picture: Picture,
        boxes: Boxes,
        looks: int = PASSES_EACH,
        enlarged: Fraction = AS_IT_IS,
        contrast: float = SHADOW_CONTRAST,
    ) -> Measured:
        """Measure the vehicles that `boxes` propose in a picture. Only a window around each is read.

        Edges stay where the network places them. How far unsure ones have to be moved out depends on all vehicles of
        the scene (`soft.softness`), so the caller does it.
        enlarged : factor by which the picture is reduced first. Results are in pixels of the picture all the same; the
            card's margin and noise grow by this factor. contrast : of shadows, at least (`shade.shadow_contrast`).
        """
        windows = [_window(picture, box, enlarged) for box in boxes.xylwa]
        return self._look(windows, boxes, looks, float(enlarged), contrast)

    def in_pixels(self, pixels: np.ndarray, boxes: Boxes, looks: int = PASSES_EACH) -> Measured:
        """Measure the vehicles that `boxes` propose in sharp pixels (H, W, 3), uint8 RGB, and move unsure edges out."""
        told = self._look([(pixels, np.zeros(2))] * len(boxes), boxes, looks)
        return told.moved_out(self.card.outward(told.sigma, told.boxes.length))

    def _look(
        self,
        windows: Sequence[tuple[np.ndarray, np.ndarray]],
        boxes: Boxes,
        looks: int,
        enlarged: float = 1.0,
        contrast: float = SHADOW_CONTRAST,
    ) -> Measured:
        """windows : pixels around each vehicle, the picture reduced by `enlarged`, and where their first corner lies in
        the picture."""
        if not len(boxes):
            return Measured(boxes, np.empty((0, 4)), np.empty((0, 4)), np.empty((0, len(ANSWERS))), np.empty(0))
        corner = np.array([[*at, 0, 0, 0] for _, at in windows], float)
        units = np.array([enlarged] * 4 + [1.0])
        proposed = (boxes.xylwa - corner) / units
        for _ in range(looks):
            steps = np.array([pixels_per_crop_pixel(box) for box in proposed])
            crops = [crop(pixels, box) for (pixels, _), box in zip(windows, proposed, strict=True)]
            edges, sigma, turn, seen, kind = self._run(crops)
            cut_along = proposed
            proposed = np.array([placed(*each) for each in zip(proposed, edges, turn, strict=True)])
        sizes = cut_along[:, 2:4] / steps[:, None]
        light = np.array([lightness(*each, contrast) for each in zip(crops, sizes, strict=True)])
        sigma = enlarged * sigma * steps[:, None]
        return Measured.along(proposed * units + corner, boxes.score, sigma, seen, kind, light)


def _window(picture: Picture, box: np.ndarray, enlarged: Fraction) -> tuple[np.ndarray, np.ndarray]:
    """The pixels that the looks at `box` (5,) may need, reduced by `enlarged`, and where their first corner lies in the
    picture. The window is a whole number of reduced pixels wide and high."""
    half = AROUND * CROP_WIDTH * pixels_per_crop_pixel(box)
    limit = np.array([picture.width, picture.height])
    low = np.clip(np.floor(box[:2] - half), 0, limit - 1).astype(int)
    size = np.clip(np.ceil(box[:2] + half), low + 1, limit).astype(int) - low
    out = np.maximum(size // enlarged.numerator, 1) * enlarged.denominator
    size = np.minimum(out * enlarged.numerator // enlarged.denominator, limit - low)
    return picture.read(*low.tolist(), *size.tolist(), *out.tolist()), low.astype(float)
