"""Measures vehicles in the frames of a reconstruction: each box with its own camera, distortion and ground.

The ruler is calibrated at the same time (`projection.self_calibration`): the boxes' effective height and margin follow
from vehicles seen in steep and flat views, near and far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...errors import TooLittleEvidence
from ..anchors import AnchorVote
from ..boxes import Boxes
from ..detections import Detections
from ..fleet import Fleet
from ..pooling.usable import MIN_VEHICLES
from ..projection import decoupled
from ..projection.exact import BODIES, FLAT, Hull, ground_size
from ..projection.height import lean
from ..projection.own_ruler import HEIGHT, MARGIN, SHAPE, OwnRuler, SeenBoxes
from ..projection.self_calibration import self_calibrated, trends
from ..projection.view import LOWEST_ELEVATION, Views
from ..scale import Scale
from ..source import PosedSet
from ..votes import Votes, view_weights
from .footing import Footing
from .geometry import Geometry, Observation, larger_by
from .in_view import frames_in_view, pictures_with_boxes
from .measurement import Findings, SelfCalibration
from .method import VARIANTS_BY_NAME, Method
from .model_drift import model_drift
from .parallax import standing_in_model
from .surroundings import Standards, objects_in_model, rows_in_model, world_axes
from .systematic import of_height

ROUNDS = 6  # of projection and pooling; the projection depends on the scale only through the vehicles' height
SETTLED = 1e-4  # relative change of the scale at which the rounds end
HEIGHT_SD = 0.25  # how far a detector's effective height strays from its card between scenes (one sigma) [m]
# How far the effective height of one view's box strays from its mean, one sigma [m]: sides in the shade are left out in
# some views, and roofs differ. In views of 48 vehicles of `sheffield` that lean by 0.5 to 1, it strays by 0.15 m in
# width and 0.18 m in length, more than the stated sigmas; heights of cars vary by 0.18 m.
VIEW_HEIGHT_SD = 0.25
LEAST_SIZE = 0.5  # [m] least size of a vehicle that relative errors are taken of
NO_GROUND = "no ground under the box, or too low an elevation angle"
CALLED_IN_FRAMES = "boxes on the ground"


@dataclass(frozen=True)
class FramesGeometry:
    """The `Geometry` of boxes in frames, each with its own camera: the part common to all projections.

    source : of the frames. found : all detections in them. views : of the boxes, on the ground on which the vehicles
    stand. footing : that ground, for the vehicles and for everything else that is measured on it. card : the ruler of
    the detector's card. ruler : the one measured by, at first the card's.
    """

    source: PosedSet
    found: Detections
    fleet: Fleet
    boxes: Boxes
    picture: np.ndarray
    views: Views
    lost: Mapping[str, int]
    footing: Footing
    card: OwnRuler
    ruler: OwnRuler
    projection: str = "exact"
    called: str = CALLED_IN_FRAMES
    repeated: bool = True
    rounds: int = ROUNDS
    settled: float = SETTLED

    @classmethod
    def of(cls, source: PosedSet, found: Detections, fleet: Fleet, method: Method) -> ExactGeometry | OtherGeometry:
        """The geometry of the boxes `found` in the frames of a reconstruction, with the projection of `method`.

        Raises TooLittleEvidence.
        """
        parts, names, views, places = [], [], [], []
        lost = found.uncounted
        for name, boxes in found.boxes.items():
            if not len(boxes):
                continue
            view, place, ok = source.views(name, boxes.centre)
            parts.append(boxes[ok])
            names += [name] * int(ok.sum())
            views.append(view[ok])
            places.append(place[ok])
            lost[NO_GROUND] = lost.get(NO_GROUND, 0) + int((~ok).sum())
        if len(names) < MIN_VEHICLES:
            raise TooLittleEvidence(f"{len(names)} {CALLED_IN_FRAMES}, {MIN_VEHICLES} are needed")
        boxes, place, view = Boxes.concatenate(parts), np.concatenate(places), Views.concatenate(views)
        sides = np.median(boxes.sides * view.unit_per_pixel[:, None], axis=0)
        shown = shown_in_frames(source, found, boxes, place)
        footing = standing_in_model(source, np.array(names), place, sides, shown)
        view = replace(view, ground=view.ground * (1 + footing.lower)[:, None]).with_focal(source.focal.ratio)
        card = card_of(found)
        projection = method.projection or "exact"
        chosen = ExactGeometry if projection == "exact" else OtherGeometry
        return chosen(
            source=source,
            found=found,
            fleet=fleet,
            boxes=boxes,
            picture=np.array(names),
            views=view,
            lost=lost,
            footing=footing,
            card=card,
            ruler=card,
            projection=projection,
        )

    @property
    def unit(self) -> str:
        """The unit of the source's scale."""
        return self.source.unit

    @property
    def place(self) -> np.ndarray:
        """(M, 3) places of the boxes on the ground on which the vehicles stand [source units]."""
        return self.footing.place

    @cached_property
    def pixel(self) -> np.ndarray:
        """(M,) ground size of one detector pixel at each box [source units]."""
        return self.views.unit_per_pixel / self.found.zoom

    @property
    def typical_length(self) -> float:
        """Median length of the boxes on the ground [source units]."""
        return float(np.median(self.boxes.length * self.views.unit_per_pixel))

    @cached_property
    def along(self) -> np.ndarray:
        """(M, 3) unit vectors along the boxes' long sides, in world coordinates."""
        return world_axes(self.source, self.picture, self.boxes, self.views)

    @cached_property
    def leaning(self) -> np.ndarray:
        """(M, 2) how much of a vehicle's height each box shows along length and width, from `height.lean`."""
        return lean(self.boxes, self.views)

    def boxes_seen(self, metres_per_unit: float) -> SeenBoxes:
        """The boxes with their views, at this scale."""
        return SeenBoxes(self.boxes, self.views, self.found.zoom, metres_per_unit)

    def shown(self, place: np.ndarray) -> np.ndarray:
        """(N,) number of frames that show the places (N, 3)."""
        return shown_in_frames(self.source, self.found, self.boxes, place)

    def surroundings(
        self, seen: Observation, vehicles: Votes, metres_per_unit: float, standards: Standards, country: str
    ) -> Sequence[AnchorVote]:
        """Objects of standard size, and rows of parked vehicles."""
        objects = objects_in_model(
            self.source, self.found.objects, self.found.zoom, metres_per_unit, standards, self.footing
        )
        return [*objects, *rows_in_model(vehicles, self.along[seen.solved], standards, country, self.footing)]

    def _findings(
        self, seen: Observation, by_card: np.ndarray, by_ruler: np.ndarray, vehicles: Votes, scale: Scale
    ) -> Findings:
        """From two sizes (M, 2) of the boxes, without the margin: by the detector's card, and by `ruler`."""
        ok = seen.solved
        elevation, members = np.degrees(self.views.elevation[ok]), vehicles.counted(scale.used)
        changes = trends(by_card[ok], by_ruler[ok], elevation, self.pixel[ok], members)
        plan, weights = self.source.ground.plane(vehicles.place), view_weights(self.boxes.sigma, seen.lasting)
        return Findings(
            SelfCalibration(self.ruler, self.card, changes),
            model_drift(by_ruler[ok], weights[ok], self.picture[ok], vehicles, scale, plan),
        )


@dataclass(frozen=True)
class ExactGeometry(FramesGeometry):
    """With the exact projection. Its ruler is calibrated between rounds."""

    def observe(self, metres_per_unit: float) -> Observation:
        """Sizes by the current ruler; the margin comes off the boxes before they are projected."""
        ruler, known, boxes = self.ruler, self.found.ruler, self.boxes_seen(metres_per_unit)
        size, slopes = ruler.size(boxes), ruler.slopes(boxes)
        solved = np.isfinite(size).all(1)
        if not np.isfinite(slopes[solved]).all((1, 2)).any():  # boxes so small that they may be nothing but margin
            return Observation(np.full_like(size, np.nan), known)
        sd = ruler.relative_sd(size[solved], slopes[solved])
        per_pixel = np.median(self.pixel[solved, None] / size[solved], axis=0)
        margin_sd = sd[:, MARGIN] / per_pixel
        left = replace(known, margin=(0.0, 0.0), margin_sd=(float(margin_sd[0]), float(margin_sd[1])))  # already off
        by_body = np.sqrt(sd[:, HEIGHT] ** 2 + np.square(sd[:, SHAPE]).sum(1))
        left_of_card = ruler.left_of_height(self.card, size[solved], slopes[solved])
        systematic = of_height(by_body, left_of_card).and_shared(self._shared(boxes, size))
        lasting = of_each_view(self.footing.each, self.leaning, size * metres_per_unit)
        return Observation(size, left, systematic, lasting)

    def _shared(self, boxes: SeenBoxes, size: np.ndarray) -> dict[str, np.ndarray]:
        """The errors from the ground and the focal length, as in `Systematic.shared`. size : (M, 2) of the `boxes`
        [units]."""
        if not self.source.focal.sd:
            return self.footing.alike
        longer = self.ruler.size(replace(boxes, views=self.views.with_focal(1 + self.source.focal.sd)))
        return {**self.footing.alike, "focal length": larger_by(longer, size)}

    def refined(self, seen: Observation, votes: Votes, scale: Scale) -> Geometry:
        """The same with the ruler by which vehicles have the same size in all their views."""
        boxes = self.boxes_seen(scale.value)[seen.solved]
        return replace(self, ruler=self_calibrated(boxes, votes.counted(scale.used), self.card, self.ruler))

    def findings(self, seen: Observation, vehicles: Votes, scale: Scale) -> Findings:
        """The ruler, and how the scale changes from frame to frame and from place to place."""
        by_card = self.card.size(self.boxes_seen(scale.value))
        return self._findings(seen, by_card, seen.size, vehicles, scale)


@dataclass(frozen=True)
class OtherGeometry(FramesGeometry):
    """With another projection of `method.VARIANTS_BY_NAME`, which uses no effective height or one of its own; and with
    the ruler of the detector's card."""

    def observe(self, metres_per_unit: float) -> Observation:
        """Sizes of the boxes as they are, with their margin."""
        variant = VARIANTS_BY_NAME[self.projection]
        if variant is None:  # planar
            size = ground_size(self.boxes, self.views, metres_per_unit, Hull(height=FLAT))
        else:
            length, width, height = self.fleet.mean.tolist()
            size = decoupled.ground_size(self.boxes, self.views, (length, width, height), variant)
        ok = np.isfinite(size).all(1)
        by_height = of_height(height_share(size[ok], self.leaning[ok], HEIGHT_SD / metres_per_unit))
        lasting = of_each_view(self.footing.each, self.leaning, size * metres_per_unit)
        return Observation(size, self.found.ruler, by_height.and_shared(self.footing.alike), lasting)

    def refined(self, seen: Observation, votes: Votes, scale: Scale) -> Geometry:
        """There is nothing to refine."""
        return self

    def findings(self, seen: Observation, vehicles: Votes, scale: Scale) -> Findings:
        """How the scale changes from frame to frame and from place to place."""
        size = seen.size - self.card.margin * self.pixel[:, None]
        return self._findings(seen, size, size, vehicles, scale)


def shown_in_frames(source: PosedSet, found: Detections, boxes: Boxes, place: np.ndarray) -> np.ndarray:
    """(N,) number of processed frames that show the whole of a vehicle at each place (N, 3), if it is as large as a
    typical one of `boxes`."""
    border = float(np.median(boxes.length)) / 2
    return frames_in_view(source, pictures_with_boxes(found), place, border, LOWEST_ELEVATION)


def card_of(found: Detections) -> OwnRuler:
    """The ruler of the card of the network that measured the boxes `found`."""
    known, height_sd, body = found.ruler, (HEIGHT_SD, HEIGHT_SD), BODIES[found.body]
    return OwnRuler.of_card(found.effective_height, known.margin, height_sd, known.margin_sd, body, found.undercut)


def of_each_view(ground: np.ndarray, leaning: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(M, 2) relative one-sigmas of lengths and widths from the uncertainty of the ground under a vehicle, and of the
    effective height in one view: flat views are less certain than steep ones.

    ground : (M,) the former, relative. leaning : (M, 2) from `height.lean`. size : (M, 2) [m].
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.hypot(ground[:, None], VIEW_HEIGHT_SD * leaning / np.maximum(size, LEAST_SIZE))


def height_share(size: np.ndarray, leaning: np.ndarray, height_sd: float) -> np.ndarray:
    """(2,) relative one-sigmas of lengths and widths from that of the effective height, `height_sd` [units].

    size : (N, 2) as measured [units]. leaning : (N, 2) from `height.lean`.
    """
    if not len(size):
        return np.zeros(2)
    return np.median(leaning * height_sd / size, axis=0)
