"""Drift of the scale over a source: a gradient of vehicle sizes where it is tilted, a bowl where it is bent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..angles import unit_vector
from ..by_value import ByValue
from ..normal import Z90
from ..projection.planar import square_pixels
from ..remarks import REFUSAL, Remark, percent
from ..scale import Scale
from ..verdicts import UNUSABLE, one_step_below, worst
from .surface import LOT_SIZE, LOTS_SD, Cells, SurfaceFit, bowl, plane

FEWEST = 40  # vehicles; with fewer, no realistic gradient is significant
CHANCE = 0.01  # probability of a false alarm where there is no drift; the two tests share it equally
NOTABLE = 0.01  # relative change across the picture below which a drift is not reported
EVEN_SD = 12**-0.5  # standard deviation of a uniform distribution over a range of 1
TO_MEND = "Straighten the input, measure its parts separately, or check whether vehicles differ from place to place"


@dataclass(frozen=True)
class Trend:
    """How the scale changes over a source, relative to its mean.

    tilt : the change from one end to the other, along the steepest direction. bend : how much a bowl or saddle adds to
        that. A block that its self-calibration has bent shows a bowl, a long strip a bend along it. 0 for too few
        vehicles.
    p_tilt, p_bend : p-values of the gradient, and of the curvature beside it: the probability of one as large as found
        if there were none.
    tilt_sd : one sigma of `tilt`, None where that was not computed.
    """

    tilt: float
    p_tilt: float
    bend: float = 0.0
    p_bend: float = 1.0
    tilt_sd: float | None = None

    @property
    def tilts(self) -> bool:
        """Whether the gradient is significant, and large enough to matter."""
        return self.p_tilt < CHANCE / 2 and self.tilt >= NOTABLE

    @property
    def bends(self) -> bool:
        """Whether the curvature is significant, and large enough to matter."""
        return self.p_bend < CHANCE / 2 and self.bend >= NOTABLE

    @property
    def drifts(self) -> bool:
        """Whether there is a drift; every output uses this decision."""
        return self.tilts or self.bends

    @property
    def amplitude(self) -> float:
        """Relative difference of the scale between its extremes; 0 without a significant drift."""
        return float(np.hypot(self.tilt if self.tilts else 0.0, self.bend if self.bends else 0.0))

    @property
    def figures(self) -> str:
        """Its tilt and, if it is bent, its bend, in words."""
        unsure = "" if self.tilt_sd is None else f" ± {100 * Z90 * self.tilt_sd:.1f}"
        change = f"{100 * self.tilt:.1f}{unsure} %{' (90 %)' if unsure else ''}"
        return f"{change} from side to side{f', bent by {percent(self.bend)}' if self.bends else ''}"


@dataclass(frozen=True, eq=False)
class Drift(ByValue):
    """The trend of the scale over one picture, and the map of it.

    cells : (C, 5) per cell of the map with vehicles in it: centre x, centre y [px], number of vehicles, relative
        deviation of the local scale, its one sigma, which includes the variation between lots. cell : (2,) its size
        [px].
    direction : in which the scale grows on the ground [rad], from +x, clockwise on screen.
    """

    trend: Trend
    cells: np.ndarray = field(repr=False)
    cell: tuple[float, float]
    direction: float

    @property
    def drifts(self) -> bool:
        """Whether the trend is significant, and large enough to matter."""
        return self.trend.drifts

    @property
    def amplitude(self) -> float:
        """Relative difference of the scale between its extremes; 0 without a significant drift."""
        return self.trend.amplitude

    @property
    def warnings(self) -> list[str]:
        """What speaks against a single scale, in words; empty without a drift."""
        found, trend = [], self.trend
        if trend.tilts:
            octant = round(self.direction / (np.pi / 4)) % 8
            names = ("right", "lower right", "bottom", "lower left", "left", "upper left", "top", "upper right")
            found.append(f"grows by {100 * trend.tilt:.1f} % towards the {names[octant]} (p = {trend.p_tilt:.1g})")
        if trend.bends:
            found.append(f"is bent by {100 * trend.bend:.1f} % (p = {trend.p_bend:.1g})")
        why = "the orthophoto may be tilted, bent or put together, or its vehicles differ from place to place"
        return [f"the scale {' and '.join(found)}: {why}"] if found else []


def with_drift(scale: Scale, amplitude: float, warnings: Sequence[Remark]) -> Scale:
    """`scale` as it holds at any one place of its source, where the scales of places differ by up to `amplitude`
    (relative).

    How far a place strays from the mean becomes a part of the uncertainty: EVEN_SD of the amplitude, as for a uniform
    distribution. Interval and verdict follow. Where the amplitude exceeds the width of the 90 % interval, places
    exclude each other's scale, and the verdict is lowered by one step at least. Where it becomes ``unusable``, no
    single scale describes the source, and the `warnings`, cautions, become refusals.
    """
    word = scale.verdict
    if amplitude > 0:
        low, high = scale.interval90
        lowered = amplitude > (high - low) / scale.value
        scale = scale.with_parts({**scale.parts, "drift": EVEN_SD * amplitude})
        scale = replace(scale, verdict=worst(scale.verdict, one_step_below(word) if lowered else word))
    refused = scale.verdict == UNUSABLE != word
    return scale.remarked(*(replace(w, severity=REFUSAL, hint=TO_MEND) if refused else w for w in warnings))


def drift(vehicles: np.ndarray, width: float, height: float, gsd: float, aspect: float = 1.0) -> Drift | None:
    """The drift of the scale within a picture of `width` x `height` px, or None for fewer than 40 vehicles.

    vehicles : the `vehicle_table` of the picture. gsd : [m/px]. aspect : how many times as wide as high a pixel is on
    the ground; places are converted to square pixels of the same area.

    A plane and a full quadratic are fitted to the means of cells and tested against the scatter of the cells about them
    (F-tests). The vehicles of one lot are not taken as independent (`surface`).
    """
    used = vehicles[vehicles["used"]]
    if len(used) < FEWEST:
        return None
    square = square_pixels(aspect)
    place, extent = np.stack([used["x_unit"], used["y_unit"]], -1) * square, np.array([width, height]) * square
    cells = Cells.of(place, used["scale_deviation"], np.zeros(2), extent)
    covariance = cells.covariance(LOT_SIZE / gsd)
    about = cells.place - extent / 2
    surfaces = np.ones((len(about), 1)), plane(about, extent), bowl(about, extent)
    flat_fit, plane_fit, bowl_fit = (SurfaceFit.of(terms, cells.mean, covariance) for terms in surfaces)
    gradient = plane_fit.coefficients[1:]
    direction = float(np.arctan2(gradient[1], gradient[0]))
    along = unit_vector(direction)
    length = float(np.abs(along) @ extent / extent.max())
    across, down = cells.size / square
    trend = Trend(
        tilt=float(np.hypot(*gradient)) * length,
        p_tilt=plane_fit.p_against(flat_fit),
        bend=float(np.ptp(surfaces[2] @ bowl_fit.coefficients - surfaces[1] @ plane_fit.coefficients)),
        p_bend=bowl_fit.p_against(plane_fit),
        tilt_sd=float(np.sqrt(along @ plane_fit.covariance[1:, 1:] @ along)) * length,
    )
    return Drift(
        trend=trend,
        cells=np.column_stack([cells.centre / square, cells.count, cells.mean, np.hypot(cells.sd, LOTS_SD)]),
        cell=(float(across), float(down)),
        direction=direction,
    )
