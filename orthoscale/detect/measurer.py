"""The measurer: a second network that looks at a found vehicle once more and says where its four edges are.

It sees a crop along the vehicle's axis, `CROP_LENGTHS` times as long as its box and half as wide, at `CROP_WIDTH` x
`CROP_HEIGHT` px whatever the picture's resolution. The exported network averages over the crop's mirrors, so that it
does not matter which way a vehicle points or in which hand a picture is; each of `PASSES_EACH` passes is cut along what
the last one found, so that the answer does not follow the box that was proposed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from ..core.boxes import KINDS, Boxes
from ..core.ruler import Ruler
from ..core.source import NO_DATA_GREY, Picture
from ..errors import InputError
from ..formats.reading import checked, parsed
from .detector import load_network
from .enlarged import AS_IT_IS
from .foreign import ForeignError
from .shade import SHADOW_CONTRAST, lightness

SHIPPED_MEASURER = "measurer.onnx"

CROP_WIDTH, CROP_HEIGHT = 96, 48  # of the crop that the network sees [px]
CROP_LENGTHS = 1.7  # length of the crop in lengths of the proposed box
AROUND = 0.85  # of the window that is read, from the box's centre either way, in lengths of the crop
BATCH = 32  # crops a run
# Each look leaves a quarter to a half of what the answer had of the proposed box; after four it has nothing.
PASSES_EACH = 4
# Of the length, by which an unsure edge is moved at most. Beds of pickups and bonnets in shade that were left out are
# up to a tenth of it; one that is unsure by more is anywhere.
MOVED_AT_MOST = 0.08
MOVED_SD = 1 / 3  # what a moved edge's place is uncertain by besides, as a share of the way it was moved
NO_DATA = (NO_DATA_GREY,) * 3  # beyond the picture's edge
ANSWERS = (*KINDS, "none")

OUTPUTS = ("edges", "sigma", "turn", "seen", "kind")
MEASURER_CARD, MEASURER_HINT = (
    "a measurer with an orthoscale card that can be read",
    "Export it with training.measurer.export.",
)


@dataclass(frozen=True)
class MeasurerCard:
    """What a measurer says of itself, kept in the ONNX file's metadata under ``orthoscale``.

    ruler : of its boxes, in pixels of the picture, for it looks at that as it is.
    sigma_times : (2,) how many times what it states the errors of its lengths and widths are.
    effective_height : up to where its boxes enclose a vehicle seen obliquely, along length and width [m].
    undercut : how far inside its outline a vehicle meets the ground, along length and width [m]; 0 for not known.
    body : what they enclose there, one of `core.projection.exact.BODIES`.
    inward : how far an unsure edge lies inside the vehicle, in times of what its sigma exceeds a sure one's. An edge
        that may be the bonnet's or the bumper's is told between the two, and the vehicle ends at the outer one.
    sure : sigma of an edge that is told as well as it can be: share of the vehicle's length, and px of the picture.
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
        """From the text in a file's metadata; `origin` names it in the message. Raises InputError for what is none."""
        from ..formats.schemas.networks import MeasurerCardEntry

        entry = checked(
            parsed(text, origin, MEASURER_CARD, MEASURER_HINT),
            MeasurerCardEntry,
            origin,
            MEASURER_CARD,
            MEASURER_HINT,
        )
        values = {name: getattr(entry, name) for name in entry.__struct_fields__}
        return cls(**{**values, "ruler": entry.ruler.ruler})

    def sure_sigma(self, length: np.ndarray, pixel: float = 1.0) -> np.ndarray:
        """(N, 1) sigma of a sure edge of vehicles of `length` (N,) [px], looked at in pixels of `pixel` each [px]."""
        share, px = self.sure
        return np.hypot(share * length, px * pixel)[:, None]

    def outward(self, sigma: np.ndarray, length: np.ndarray, pixel: float = 1.0, soft: float = 1.0) -> np.ndarray:
        """(N, 4) how far edges of `sigma` (N, 4) are to be moved outwards [px], of vehicles of `length` (N,) [px].

        pixel : of those that were looked at [px]. soft : how many times as unsure a sure edge is there
            (`soft.softness`).
        """
        excess = sigma - soft * self.sure_sigma(length, pixel)
        return np.clip(self.inward * excess, 0.0, MOVED_AT_MOST * length[:, None])


# Which edge comes where in the order of `Measured.sigma`, once a box was turned by so many quarters.
TURNED_EDGES = np.array([[0, 1, 2, 3], [2, 3, 1, 0], [1, 0, 3, 2], [3, 2, 0, 1]])
FIRST_COLUMNS = (5, 9, 13, 13 + len(ANSWERS))  # in `Measured.rows`, of sigma, seen, kind and light; the box is before


@dataclass(frozen=True)
class Measured:
    """What the measurer says of N vehicles.

    boxes : their boxes, edge to edge; the score is the proposed box's.
    sigma : (N, 4) one standard deviation of where each edge lies [px of the picture]: at the end against the box's
        direction, at the end in it, left and right of who looks along it (image coordinates: left is -y at angle 0).
    seen : (N, 4) 0..1, how surely each edge is in sight, not under a tree or beyond the picture's edge.
    kind : (N, 5) shares of `ANSWERS`.
    light : (N,) how light its paint is, of `shade.lightness`.
    """

    boxes: Boxes
    sigma: np.ndarray
    seen: np.ndarray
    kind: np.ndarray
    light: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """(N, 19) all of it as numbers, one row a vehicle, but for the scores."""
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
        """What is told along boxes `xylwa` (N, 5) of any direction, which `Boxes` turns along the longer side.

        score : (N,) of the proposed boxes. The others are as the fields.
        """
        boxes = Boxes(xylwa, score)
        edges = TURNED_EDGES[np.round((boxes.angle - xylwa[:, 4]) / (np.pi / 2)).astype(int) % 4]
        return cls(boxes, np.take_along_axis(sigma, edges, 1), np.take_along_axis(seen, edges, 1), kind, light)

    @classmethod
    def of_rows(cls, rows: np.ndarray, score: np.ndarray) -> Measured:
        """What has these `rows` (N, 19), with the scores (N,) of the proposed boxes."""
        xylwa, sigma, seen, kind, light = np.split(rows, FIRST_COLUMNS, axis=1)
        return cls.along(xylwa, score, sigma, seen, kind, light[:, 0])

    def moved_out(self, outward: np.ndarray) -> Measured:
        """The same with edges farther out by `outward` (N, 4) [px], and less certain for that."""
        boxes = replace(self.boxes, xylwa=moved_out(self.boxes.xylwa, outward))
        return replace(self, boxes=boxes, sigma=np.hypot(self.sigma, MOVED_SD * outward))

    @property
    def size_sigma(self) -> np.ndarray:
        """(N, 2) one standard deviation of length and width [px], the two edges of each taken as independent."""
        variance = self.sigma**2
        return np.sqrt(np.stack([variance[:, :2].sum(1), variance[:, 2:].sum(1)], 1))


def pixels_per_crop_pixel(box: np.ndarray) -> float:
    """Picture pixels across one pixel of the crop of a box (5,)."""
    return CROP_LENGTHS * max(box[2], 2 * box[3]) / CROP_WIDTH


def crop(picture: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(CROP_HEIGHT, CROP_WIDTH, 3) uint8, the picture (H, W, 3) along `box` (5,), whose centre is the crop's.

    Enlarged by a cubic; reduced by averaging over `n` x `n` samples a pixel, as many as it has picture pixels each way.
    """
    step = pixels_per_crop_pixel(box)
    n = int(np.clip(np.ceil(step), 1, 16))
    fine = step / n  # picture pixels per sample
    along = fine * np.array([np.cos(box[4]), np.sin(box[4])])
    linear = np.array([[along[0], -along[1]], [along[1], along[0]]])  # from samples to the picture
    middle = np.array([n * CROP_WIDTH / 2, n * CROP_HEIGHT / 2])
    # OpenCV puts a pixel's centre at its integer index, boxes half a pixel further.
    shift = box[:2] - linear @ middle + linear @ (0.5, 0.5) - 0.5
    samples = cv2.warpAffine(
        picture, np.c_[linear, shift], (n * CROP_WIDTH, n * CROP_HEIGHT),
        flags=(cv2.INTER_CUBIC if n == 1 else cv2.INTER_LINEAR) | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT, borderValue=NO_DATA,
    )  # fmt: skip
    return samples if n == 1 else cv2.resize(samples, (CROP_WIDTH, CROP_HEIGHT), interpolation=cv2.INTER_AREA)


def placed(box: np.ndarray, edges: np.ndarray, turn: float) -> np.ndarray:
    """(5,) box in the picture from the edges (4,) in crop pixels from its centre [-x, +x, -y, +y] and its turn against
    the proposed `box` [rad]."""
    step = pixels_per_crop_pixel(box)
    centre = step * np.array([edges[0] + edges[1], edges[2] + edges[3]]) / 2
    cos, sin = np.cos(box[4]), np.sin(box[4])
    x, y = cos * centre[0] - sin * centre[1], sin * centre[0] + cos * centre[1]
    size = np.maximum(step * np.array([edges[1] - edges[0], edges[3] - edges[2]]), 1e-3)
    return np.array([box[0] + x, box[1] + y, *size, box[4] + turn])


def moved_out(boxes: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Boxes (N, 5) whose edges, in the order of `Measured.sigma`, lie farther out by `outward` (N, 4) [px]."""
    low, high = outward[:, [0, 2]], outward[:, [1, 3]]
    x, y = ((high - low) / 2).T
    cos, sin = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])
    centre = boxes[:, :2] + np.stack([cos * x - sin * y, sin * x + cos * y], 1)
    return np.column_stack([centre, boxes[:, 2:4] + low + high, boxes[:, 4]])


class Measurer:
    """Holds one network; safe to call from several threads.

    card : what it says of itself. sha256 : of its file.
    """

    def __init__(self, path: Path | None = None, threads: int = 1) -> None:
        """Load a network that `training.measurer` made, by default the shipped one.

        threads : of one run. Raises InputError for a file that cannot be read or is none.
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
        """Measure the vehicles that `boxes` propose in a picture, of which a window around each is read.

        Edges are where the network tells them; how far unsure ones are to be moved out, all of a scene's tell
        (`soft.softness`).
        enlarged : the picture is looked at so many times smaller. What is told stays in its pixels; the card's margin
            and noise are so many times as large. contrast : of shadows, at least (`shade.shadow_contrast`).
        """
        windows = [_window(picture, box, enlarged) for box in boxes.xylwa]
        return self._look(windows, boxes, looks, float(enlarged), contrast)

    def in_pixels(self, pixels: np.ndarray, boxes: Boxes, looks: int = PASSES_EACH) -> Measured:
        """Measure the vehicles that `boxes` propose in pixels (H, W, 3), uint8 RGB, that are sharp: unsure edges are
        moved out."""
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
        """windows : pixels around each vehicle, `enlarged` times fewer than the picture's, and where their first corner
        lies in the picture."""
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
    """The pixels that the looks at `box` (5,) may need, `enlarged` times fewer each way, and where their first corner
    lies. A whole number of them fits the window."""
    half = AROUND * CROP_WIDTH * pixels_per_crop_pixel(box)
    limit = np.array([picture.width, picture.height])
    low = np.clip(np.floor(box[:2] - half), 0, limit - 1).astype(int)
    size = np.clip(np.ceil(box[:2] + half), low + 1, limit).astype(int) - low
    out = np.maximum(size // enlarged.numerator, 1) * enlarged.denominator
    size = np.minimum(out * enlarged.numerator // enlarged.denominator, limit - low)
    return picture.read(*low.tolist(), *size.tolist(), *out.tolist()), low.astype(float)
