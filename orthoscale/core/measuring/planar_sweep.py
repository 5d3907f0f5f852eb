"""Measures vehicles in frames warped onto the ground (planar), as if they were an orthophoto.

This is the paper's orthophoto method without an orthophoto. It shares neither the projection nor the pictures with
`oblique`. A plan shows footprints; the relief displacement that remains near the nadir is removed, by the bodies that
`oblique` fitted to its views if it did, else by those of the detector's card.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...errors import TooLittleEvidence
from ..anchors import AnchorVote
from ..boxes import Boxes
from ..detections import Detections
from ..pooling.usable import MIN_VEHICLES
from ..projection.own_ruler import OwnRuler, SeenBoxes
from ..projection.planar import ground_size
from ..projection.view import Views
from ..scale import Scale
from ..source import NEAR_NADIR, GroundView, PosedSet
from ..votes import Votes
from .footing import Footing
from .geometry import Geometry, Observation, larger_by
from .in_view import frames_in_view, pictures_with_boxes
from .measurement import Findings
from .oblique import card_of, of_each_view
from .parallax import standing_in_model
from .surroundings import Standards, rows_in_model
from .systematic import of_height

SWEEP_ROUNDS = 3  # height contributes a few percent of a box's size, and the scale enters only there
ROOM = 1.15  # a box enlarged by this factor must lie within the frame, or the vehicle may be cut off
BORDER = 2.0  # [px of the frame]
# All ground pictures have the same pixel size, whatever height their frames were taken from. A frame that is enlarged
# looks blurred, and its boxes come out too wide: where a frame is enlarged 2.1 times, three cars on `boruszyn` are 20 %
# wider than where it hardly is. The limit is half an octave, the distance between the two detection passes.
MOST_ENLARGED = 2**0.5
TOO_COARSE = "seen from so far away that the picture of the ground is blurred"
TOO_FLAT = "cut by the frame's edge, or too low an elevation angle"
CALLED_ABOVE = "boxes near the nadir"


@dataclass(frozen=True)
class SweepGeometry:
    """A `Geometry` of boxes in ground pictures, each picture from one camera.

    flat : (M, 2) sides of the boxes on the ground [model units]. offset : (M, 2) from the point below the camera to the
    box, along its long and its short side, in camera heights. camera : (M, 1) that height over the ground [model
    units]. along : (M, 3) unit vectors along the long sides, in world coordinates. footing : the ground under the
    boxes, for them and for everything else that is measured on it. card : the ruler of the network's card. ruler : the
    one measured by. Both without the margin.
    """

    source: PosedSet
    found: Detections
    boxes: Boxes
    picture: np.ndarray
    pixel: np.ndarray
    along: np.ndarray
    flat: np.ndarray
    offset: np.ndarray
    camera: np.ndarray
    footing: Footing
    card: OwnRuler
    ruler: OwnRuler
    lost: Mapping[str, int]
    projection: str = "exact"
    called: str = CALLED_ABOVE
    repeated: bool = True
    rounds: int = SWEEP_ROUNDS
    settled: float = 0.0

    @classmethod
    def of(cls, source: PosedSet, found: Detections, fitted: OwnRuler | None = None) -> SweepGeometry:
        """The geometry of the boxes `found` in the `source.ground_pictures`. Raises TooLittleEvidence.

        fitted : the ruler fitted to boxes of the same network in frames; None for that of its card.
        """
        pictures = {picture.name: picture for picture in source.ground_pictures}
        lost = {**found.uncounted, TOO_FLAT: 0, TOO_COARSE: 0}
        parts, names = [], []
        for name, boxes in found.boxes.items():
            picture = pictures.get(name)
            if picture is None or not len(boxes):
                continue
            whole, sharp, offset = _whole(picture, boxes)
            lost[TOO_FLAT] += int((~whole).sum())
            lost[TOO_COARSE] += int((whole & ~sharp).sum())
            parts.append(_Above.of(picture, boxes[whole & sharp], offset[whole & sharp]))
            names += [name] * len(parts[-1].boxes)
        if len(names) < MIN_VEHICLES:
            raise TooLittleEvidence(f"{len(names)} {CALLED_ABOVE}, {MIN_VEHICLES} are needed")
        above = _Above.all_of(parts)
        unit_per_pixel = next(iter(pictures.values())).unit_per_pixel
        flat = ground_size(above.boxes) * unit_per_pixel
        images = np.array([pictures[name].image for name in names])
        shown = _shown(source, found, above.boxes, above.place)
        footing = standing_in_model(source, images, above.place, np.median(flat, axis=0), shown)
        farther = (1 + footing.lower)[:, None]
        card = card_of(found).body_alone
        return cls(
            source=source,
            found=found,
            boxes=above.boxes,
            picture=np.array(names),
            pixel=unit_per_pixel / found.zoom * farther[:, 0],
            along=above.along,
            flat=flat * farther,
            offset=above.offset / source.focal.ratio,
            camera=above.camera * farther * source.focal.ratio,
            footing=footing,
            card=card,
            ruler=fitted.body_alone if fitted is not None else card,
            lost=lost,
        )

    @property
    def unit(self) -> str:
        """The unit of the source's scale."""
        return self.source.unit

    @property
    def place(self) -> np.ndarray:
        """(M, 3) places of the boxes on the ground on which the vehicles stand [source units]."""
        return self.footing.place

    @property
    def typical_length(self) -> float:
        """Median length of the boxes on the ground [source units]."""
        return float(np.median(self.flat[:, 0]))

    def observe(self, metres_per_unit: float) -> Observation:
        """Sizes of the boxes, less the part due to the vehicles' height."""
        size, by_body, slopes = self.ruler.size_and_sd(self._seen(metres_per_unit))
        if not np.isfinite(size).all(1).any():
            return Observation(size, self.found.ruler)
        by_focal = {}
        if self.source.focal.sd:
            longer = self.ruler.size(self._seen(metres_per_unit, 1 + self.source.focal.sd))
            by_focal["focal length"] = larger_by(longer, size)
        left_of_card = self.ruler.left_of_height(self.card, size, slopes)
        systematic = of_height(by_body, left_of_card).and_shared({**self.footing.alike, **by_focal})
        lasting = of_each_view(self.footing.each, np.abs(self.offset), size * metres_per_unit)
        return Observation(size, self.found.ruler, systematic, lasting)

    def _seen(self, metres_per_unit: float, ratio: float = 1.0) -> SeenBoxes:
        """The boxes in their own axes, as seen by a camera that looks straight down and whose pixels are model units on
        the ground; with a focal length `ratio` times as long and a camera `ratio` times as high."""
        camera = self.camera * ratio
        ground = np.concatenate([self.offset / ratio * camera, camera], 1)
        lens = camera[:, :, None] * np.eye(2)
        middle, none = np.zeros((len(camera), 2)), np.zeros((len(camera), 1))
        boxes = Boxes(np.concatenate([middle, self.flat, none], 1), self.boxes.score)
        return SeenBoxes(boxes, Views(ground, np.tile([0.0, 0.0, -1.0], (len(camera), 1)), lens), 1.0, metres_per_unit)

    def shown(self, place: np.ndarray) -> np.ndarray:
        """(N,) number of frames that show each place (N, 3) from near the nadir."""
        return _shown(self.source, self.found, self.boxes, place)

    def surroundings(
        self, seen: Observation, vehicles: Votes, metres_per_unit: float, standards: Standards, country: str
    ) -> Sequence[AnchorVote]:
        """Rows of parked vehicles."""
        return rows_in_model(vehicles, self.along[seen.solved], standards, country, self.footing)

    def refined(self, seen: Observation, votes: Votes, scale: Scale) -> Geometry:
        """There is nothing to refine."""
        return self

    def findings(self, seen: Observation, vehicles: Votes, scale: Scale) -> Findings:
        """Nothing: the frames themselves show more."""
        return Findings()


class _Above(NamedTuple):
    """Boxes in ground pictures. place : (N, 3) on the ground of the sparse points. along, offset, camera : as in
    `SweepGeometry`, for that ground and the model's own focal length."""

    boxes: Boxes
    place: np.ndarray
    along: np.ndarray
    offset: np.ndarray
    camera: np.ndarray

    @classmethod
    def of(cls, picture: GroundView, boxes: Boxes, offset: np.ndarray) -> _Above:
        """Those of one `picture`; their offsets from below the camera in its own axes."""
        place = picture.ground(boxes.centre)
        along = picture.ground(boxes.centre + boxes.along) - place
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        own = np.stack([(offset * boxes.along).sum(1), (offset * boxes.across).sum(1)], -1)
        return cls(boxes, place, along, own, np.full((len(boxes), 1), picture.camera_height))

    @classmethod
    def all_of(cls, parts: Sequence[_Above]) -> _Above:
        """Those of all pictures."""
        boxes, *values = zip(*parts, strict=True)
        return cls(Boxes.concatenate(boxes), *map(np.concatenate, values))


def _shown(source: PosedSet, found: Detections, boxes: Boxes, place: np.ndarray) -> np.ndarray:
    """(N,) number of frames that show each place (N, 3) from near the nadir. boxes : in ground pictures."""
    pictures = {picture.name: picture for picture in source.ground_pictures}
    images = [pictures[name].image for name in pictures_with_boxes(found) if name in pictures]
    return frames_in_view(source, images, place, float(np.median(boxes.length)) / 2, NEAR_NADIR)


def _whole(picture: GroundView, boxes: Boxes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N,) bool, boxes that the frame shows whole and steeply enough; (N,) bool, boxes where the frame is not enlarged
    by more than MOST_ENLARGED; and (N, 2) their offsets from below the camera, see `GroundView.seen`."""
    centre = boxes.centre[:, None]
    corners = (centre + ROOM * (boxes.corners - centre)).reshape(-1, 2)
    with np.errstate(invalid="ignore"):
        pixels = picture.seen(corners)[0].reshape(-1, 4, 2)
        inside = ((pixels >= BORDER) & (pixels <= np.array(picture.size) - BORDER)).all((1, 2))
        first, second = pixels[:, 2] - pixels[:, 0], pixels[:, 3] - pixels[:, 1]
        area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2  # in the frame, from the diagonals
        sharp = MOST_ENLARGED**2 * area >= ROOM**2 * boxes.length * boxes.width
    offset = picture.seen(boxes.centre)[1]
    return inside & (np.linalg.norm(offset, axis=1) <= 1 / np.tan(np.radians(NEAR_NADIR))), sharp, offset
