"""One photo over level ground: from the boxes of its vehicles to scale, altitude, GSD and footprint.

The unit is chosen so that the pooled scale is the paper's ``s`` (arXiv 2603.07535): metres per pixel of the nadir view
from the same altitude. Then altitude = s f, ground sampling distance r = s / |sin pitch|, footprint = r W_img. Vehicles
are measured by the exact projection, not by the paper's. To propagate the uncertainties of pitch, roll, focal length
and the detector's effective height, measuring is repeated with each of them changed a little.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.anchors import AnchorVote
from ..core.boxes import Boxes
from ..core.by_value import ByValue
from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.measuring.geometry import Geometry, Observation, larger_by
from ..core.measuring.measure import measure as measure_boxes
from ..core.measuring.measurement import Findings
from ..core.measuring.oblique import ROUNDS, SETTLED, card_of, of_each_view
from ..core.measuring.surroundings import Standards
from ..core.measuring.systematic import Systematic
from ..core.normal import Z90
from ..core.pooling.usable import MIN_VEHICLES
from ..core.projection.height import lean
from ..core.projection.own_ruler import SeenBoxes
from ..core.projection.view import LOWEST_ELEVATION, Views
from ..core.scale import PER_PIXEL, Scale, decimals
from ..core.votes import Votes
from ..errors import TooLittleEvidence
from .photo import RIGHT, Photo


@dataclass(frozen=True)
class Interval90:
    """A value with its 90 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def log_normal(cls, value: float, sd: float) -> Interval90:
        """A value and its 90 % interval, for one sigma `sd` of its logarithm."""
        return cls(float(value), float(value * np.exp(-Z90 * sd)), float(value * np.exp(Z90 * sd)))

    def __str__(self) -> str:
        places = decimals((self.high - self.low) / 2)
        return f"{self.value:.{places}f} ({self.low:.{places}f} to {self.high:.{places}f})"

    def __mul__(self, factor: float) -> Interval90:
        return Interval90(self.value * factor, self.low * factor, self.high * factor)


@dataclass(frozen=True, eq=False)
class PhotoScale(ByValue):
    """The scale by the vehicles of a photo, or of several photos from one altitude, with what follows from it.

    scale : metres per pixel of the nadir view from the same altitude, with `used` and `reasons` by box.
    altitude : over the ground where the vehicles stand [m]. gsd : average, r = s / |sin pitch| [m/px].
    footprint : r times the picture's width and height [m].
    boxes : (N,) those that were measured; picture : (N,) the name of each one's photo.
    overlap : how many of the photos show a place, on average; there are that many times fewer vehicles than boxes.
    shared : change of the sizes [log] if pitch, roll or focal length were one sigma off, by cause.
    """

    photo: Photo
    scale: Scale
    altitude: Interval90
    gsd: Interval90
    footprint: tuple[Interval90, Interval90]
    boxes: Boxes = field(repr=False)
    picture: np.ndarray = field(repr=False)
    overlap: float = 1.0
    shared: Mapping[str, np.ndarray] = field(default_factory=dict, repr=False)

    @property
    def nadir_gsd(self) -> Interval90:
        """The `scale` with its interval [m/px]."""
        return Interval90(self.scale.value, *self.scale.interval90)

    def overlapping(self, overlap: float) -> PhotoScale:
        """The same if `overlap` of the photos show each place, so that vehicles are counted repeatedly: the sampling
        part of the interval grows by the square root of `overlap`."""
        scale = _thinned(self.scale, overlap) if overlap > 1 else self.scale
        return _assembled(self.photo, scale, self.shared, self.boxes, self.picture, overlap)

    def outline(self) -> np.ndarray | None:
        """(4, 2) the picture's corners on level ground [m], or None, as `Photo.outline`."""
        return self.photo.outline(self.altitude.value)


@dataclass(frozen=True)
class PhotoGeometry:
    """A `Geometry` of boxes in photos over level ground, in pixels of the nadir view from the same altitude.

    views : how each box is seen. off : how it would be seen if pitch, roll or focal length were one sigma more, by
    cause.
    """

    found: Detections
    boxes: Boxes
    picture: np.ndarray
    views: Views
    off: Mapping[str, Views]
    unit: str = PER_PIXEL
    projection: str = "exact"
    called: str = "usable vehicles"
    repeated: bool = False
    rounds: int = ROUNDS
    settled: float = SETTLED

    @classmethod
    def of(cls, photos: Sequence[Photo], found: Detections) -> PhotoGeometry:
        """The geometry of the boxes `found` in `photos` where these see the ground steeply enough. Raises
        TooLittleEvidence if there are none."""
        seen = [(p, found.boxes.get(p.name, Boxes.empty())) for p in photos]
        usable = [(p, b[p.views(b.centre, 1.0)[1]]) for p, b in seen if len(b)]
        if not any(len(b) for _, b in usable):
            text = f"0 usable vehicles, {MIN_VEHICLES} are needed"
            if usable:
                number = sum(len(b) for _, b in seen)
                text += f"; none of {number} boxes is seen from more than {LOWEST_ELEVATION:g} degrees "
                text += f"({usable[0][0].attitude})"
            raise TooLittleEvidence(text)
        return cls(
            found=found,
            boxes=Boxes.concatenate([b for _, b in usable]),
            picture=np.array([p.name for p, b in usable for _ in range(len(b))]),
            views=_together(usable, lambda photo: photo),
            off={
                "pitch": _together(usable, lambda photo: photo.turned(RIGHT, photo.up_sd)),
                "roll": _together(usable, lambda photo: photo.turned(_sideways(photo.up), photo.up_sd)),
                "focal": _together(usable, lambda photo: photo.refocused(1 + photo.lens.sd)),
            },
        )

    @property
    def pixel(self) -> np.ndarray:
        """(M,) ground size of one detector pixel at each box [px of the nadir view]."""
        return self.views.unit_per_pixel / self.found.zoom

    @property
    def place(self) -> np.ndarray:
        """(M, 3) where the boxes stand on level ground [px of the nadir view]."""
        return self.views.ground

    @property
    def lost(self) -> dict[str, int]:
        """Empty: boxes that cannot be measured were left out before."""
        return {}

    @property
    def typical_length(self) -> float:
        """Median length of the boxes on the ground [px of the nadir view]."""
        return float(np.median(self.boxes.length * self.views.unit_per_pixel))

    def observe(self, metres_per_unit: float) -> Observation:
        """See `Geometry.observe`. For the uncertainty of attitude, lens and effective height, the boxes are measured
        again with each a little off."""
        ruler = card_of(self.found).body_alone
        seen = SeenBoxes(self.boxes, self.views, self.found.zoom, metres_per_unit)
        size, by_body, _ = ruler.size_and_sd(seen)
        if not np.isfinite(size).all(1).any():
            return Observation(size, self.found.ruler)
        shared = {name: larger_by(ruler.size(replace(seen, views=v)), size) for name, v in self.off.items()}
        lasting = of_each_view(np.zeros(len(size)), lean(self.boxes, self.views), size * metres_per_unit)
        return Observation(size, self.found.ruler, Systematic(by_body, shared), lasting)

    def shown(self, place: np.ndarray) -> None:
        """None: the photo shows all."""

    def surroundings(
        self, seen: Observation, vehicles: Votes, metres_per_unit: float, standards: Standards, country: str
    ) -> Sequence[AnchorVote]:
        """None: photos are not searched for other evidence."""
        return ()

    def refined(self, seen: Observation, votes: Votes, scale: Scale) -> Geometry:
        """There is nothing to refine."""
        return self

    def findings(self, seen: Observation, vehicles: Votes, scale: Scale) -> Findings:
        """Nothing."""
        return Findings()


def measure(photos: Sequence[Photo], found: Detections, fleet: Fleet) -> PhotoScale:
    """One scale from the vehicles of `photos`: either a single photo, or several of different ground, taken with one
    lens from one altitude. Raises TooLittleEvidence."""
    try:
        got = measure_boxes(PhotoGeometry.of(photos, found), fleet)
    except TooLittleEvidence as error:
        hint = error.hint or "Give photos that show more vehicles, or pool those of one altitude with --together."
        raise TooLittleEvidence(error.message, hint) from error
    return _assembled(photos[0], got.scale, got.pooled.systematic.shared, got.boxes, got.picture, 1.0)


def _together(usable: Sequence[tuple[Photo, Boxes]], changed: Callable[[Photo], Photo]) -> Views:
    """How all boxes would be seen, in pixels of the nadir view, if each photo were `changed`."""
    parts = [(changed(photo), boxes) for photo, boxes in usable]
    return Views.concatenate([photo.views(boxes.centre, photo.lens.focal_px)[0] for photo, boxes in parts])


def _sideways(up: np.ndarray) -> np.ndarray:
    """(3,) the axis about which the camera tilts to its side."""
    axis = np.cross(up, RIGHT)
    return axis / np.linalg.norm(axis)


def _thinned(scale: Scale, overlap: float) -> Scale:
    """`scale` with the sampling part that `overlap` times fewer vehicles would give."""
    return scale.with_parts({**scale.parts, "sampling": scale.parts["sampling"] * float(np.sqrt(overlap))})


def _assembled(
    photo: Photo, scale: Scale, shifts: Mapping[str, np.ndarray], boxes: Boxes, picture: np.ndarray, overlap: float
) -> PhotoScale:
    """Altitude, GSD and footprint from the scale. Focal length enters both scale and altitude, pitch both scale and
    GSD; so these two parts of the error are added with their signs before squaring."""
    own = {name: -float(np.dot(scale.weights, s)) for name, s in shifts.items()}  # of the log scale

    def following(value: float, name: str, extra: float) -> Interval90:
        sd = np.sqrt(max(scale.relative_sd**2 - own[name] ** 2, 0) + (own[name] + extra) ** 2)
        return Interval90(float(value), *scale.interval_of(value, float(sd)))

    above = scale.value * photo.lens.focal_px
    altitude = following(above, "focal", np.log1p(photo.lens.sd))
    average, tilted = photo.gsd_from(above), photo.turned(RIGHT, photo.up_sd).gsd_from(above)
    gsd = following(average, "pitch", np.log(tilted / average))
    footprint = gsd * photo.tags.width, gsd * photo.tags.height
    return PhotoScale(photo, scale, altitude, gsd, footprint, boxes, picture, overlap, shared=shifts)
