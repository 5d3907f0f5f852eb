"""Drift of the scale across an orthophoto: a gradient of vehicle sizes where it is tilted, a bowl where it is bent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..remarks import CAUTION, REFUSAL, Remark
from ..scale import Scale
from ..verdicts import UNUSABLE, one_step_below, worst

FEWEST = 40  # vehicles; with fewer no gradient that a picture may have could be told from chance
PER_CELL = 6.0  # vehicles wanted in a cell of the map
MOST_CELLS = 8  # along the longer side
CHANCE = 0.01  # that vehicles without any drift are said to show one; tests share it
SCATTER = 0.01  # least that vehicles' sizes scatter; those of one model, seen sharply, do by about as much
NOTABLE = 0.01  # relative change across the picture below which nobody need know
EVEN_SD = 12**-0.5  # one sigma of what is spread evenly over a range of 1 (uniform distribution)
TO_MEND = "Straighten the input, measure its parts by themselves, or see whether vehicles differ from place to place"


@dataclass(frozen=True)
class Drift:
    """How the scale changes over one picture, relative to the whole picture's scale.

    cells : (C, 5) per cell of the map with vehicles in it: centre x, centre y [px], vehicles, relative deviation of the
        local scale, its one sigma. cell : (2,) size of a cell [px].
    tilt : relative change of the scale from one end of the picture to the other, along the steepest direction.
    direction : of that increase [rad], from +x, clockwise on screen. tilt_sd : one sigma of the change.
    bend : relative range of what a curvature adds to that.
    p_tilt, p_bend : probability of a gradient, and of a curvature besides it, as large as found, if there were none.
    """

    cells: np.ndarray = field(repr=False)
    cell: tuple[float, float]
    tilt: float
    tilt_sd: float
    direction: float
    p_tilt: float
    bend: float
    p_bend: float

    @property
    def tilts(self) -> bool:
        """Whether the gradient is more than chance makes, and large enough to matter."""
        return self.p_tilt < CHANCE / 2 and self.tilt >= NOTABLE

    @property
    def bends(self) -> bool:
        """Whether the curvature is."""
        return self.p_bend < CHANCE / 2 and self.bend >= NOTABLE

    @property
    def drifts(self) -> bool:
        """Whether there is a drift: the one decision that every output prints."""
        return self.tilts or self.bends

    @property
    def amplitude(self) -> float:
        """Relative difference of the scale between its extremes; 0 without a significant drift."""
        return float(np.hypot(self.tilt if self.tilts else 0.0, self.bend if self.bends else 0.0))

    @property
    def warnings(self) -> list[str]:
        """The remark, if there is one."""
        return [self.remark] if self.drifts else []

    @property
    def remark(self) -> str:
        """A warning in words, empty without a drift."""
        found = []
        if self.tilts:
            octant = round(self.direction / (np.pi / 4)) % 8
            names = ("right", "lower right", "bottom", "lower left", "left", "upper left", "top", "upper right")
            found.append(f"grows by {100 * self.tilt:.1f} % towards the {names[octant]} (p = {self.p_tilt:.1g})")
        if self.bends:
            found.append(f"is bent by {100 * self.bend:.1f} % (p = {self.p_bend:.1g})")
        if not found:
            return ""
        why = "the orthophoto may be tilted or bent, or its vehicles differ from place to place"
        return f"the scale {' and '.join(found)}: {why}"


def with_drift(scale: Scale, amplitude: float, warnings: Sequence[str]) -> Scale:
    """`scale` as it holds for any one place of its source, if it differs by `amplitude` (relative) between extremes.

    The difference of one place from the mean is one more part of the uncertainty, EVEN_SD of the amplitude, as for a
    change that is spread evenly; interval and verdict follow. The verdict is at least one step lower where the change
    is larger than the 90 % interval is wide: then places exclude each other's scale. Where it becomes ``unusable``, no
    single scale describes the source, and the `warnings` refuse it.
    """
    word = scale.verdict
    if amplitude > 0:
        low, high = scale.interval90
        lowered = amplitude > (high - low) / scale.value
        scale = scale.with_parts({**scale.parts, "drift": EVEN_SD * amplitude})
        scale = replace(scale, verdict=worst(scale.verdict, one_step_below(word) if lowered else word))
    refused = scale.verdict == UNUSABLE != word
    said = [Remark(REFUSAL if refused else CAUTION, text, TO_MEND if refused else "") for text in warnings]
    return scale.remarked(*said)


def drift(vehicles: np.ndarray, width: float, height: float) -> Drift | None:
    """The drift of the scale within a picture of `width` x `height` px, or None for fewer than 40 vehicles.

    vehicles : the `vehicle_table` of the picture.

    Vehicles of one place resemble each other (a taxi rank, a works car park), so the observations are the means of
    cells: a plane and a full quadratic are fitted to them, and judged by how the cells scatter about them (F-tests).
    """
    used = vehicles[vehicles["used"]]
    if len(used) < FEWEST:
        return None
    place, deviation = np.stack([used["x_unit"], used["y_unit"]], -1), used["scale_deviation"]
    cells, cell = _cells(place, deviation, width, height)
    extent = max(width, height)
    x, y = ((cells[:, :2] - (width / 2, height / 2)) / extent).T  # -1/2 to 1/2 along the longer side
    plane = np.stack([np.ones_like(x), x, y], 1)
    bowl = np.column_stack([plane, x * x, x * y, y * y])
    flat_fit, plane_fit, bowl_fit = (_Fit.of(terms, cells) for terms in (plane[:, :1], plane, bowl))
    p_tilt, p_bend = plane_fit.p_against(flat_fit), bowl_fit.p_against(plane_fit)
    gradient = plane_fit.coefficients[1:]
    direction = float(np.arctan2(gradient[1], gradient[0]))
    along = np.array([np.cos(direction), np.sin(direction)])
    length = float(np.abs(along) @ (width, height)) / extent
    tilt = float(np.hypot(*gradient)) * length
    tilt_sd = float(np.sqrt(along @ plane_fit.covariance[1:, 1:] @ along)) * length
    fitted = bowl_fit.fitted
    bend = float(np.ptp(fitted - plane_fit.fitted))
    return Drift(cells, cell, tilt, tilt_sd, direction, p_tilt, bend, p_bend)


def _cells(place: np.ndarray, deviation: np.ndarray, width: float, height: float) -> tuple[np.ndarray, tuple]:
    side = np.sqrt(width * height * PER_CELL / len(place))
    side = max(side, max(width, height) / MOST_CELLS)
    count = np.maximum(np.round([width / side, height / side]), 1).astype(int)
    cell = np.array([width, height]) / count
    column, row = np.clip((place / cell).astype(int), 0, count - 1).T
    scatter = max(float(deviation.std()), SCATTER)  # boxes that are all alike would have none, and be infinitely sure
    cells = []
    for key in np.unique(row * count[0] + column):
        here = row * count[0] + column == key
        n = int(here.sum())
        centre = (key % count[0] + 0.5) * cell[0], (key // count[0] + 0.5) * cell[1]
        cells.append((*centre, n, deviation[here].mean(), scatter / np.sqrt(n)))
    return np.array(cells), (float(cell[0]), float(cell[1]))


@dataclass(frozen=True)
class _Fit:
    """Weighted least squares over cells; a cell counts for its vehicles."""

    coefficients: np.ndarray
    covariance: np.ndarray
    fitted: np.ndarray
    chi2: float
    freedom: int

    @classmethod
    def of(cls, terms: np.ndarray, cells: np.ndarray) -> _Fit:
        root = 1 / cells[:, 4]
        a, b = terms * root[:, None], cells[:, 3] * root
        coefficients = np.linalg.lstsq(a, b, rcond=None)[0]
        chi2 = float(((b - a @ coefficients) ** 2).sum())
        freedom = len(cells) - int(np.linalg.matrix_rank(a))
        # Where cells scatter more than their vehicles explain, the fit is known less well.
        excess = max(1.0, chi2 / freedom) if freedom > 0 else 1.0
        return cls(coefficients, np.linalg.pinv(a.T @ a) * excess, terms @ coefficients, chi2, freedom)

    def p_against(self, simpler: _Fit) -> float:
        """Probability of so much better a fit than `simpler`'s by chance (F-test), 1 without cells enough to say."""
        from scipy.special import fdtrc

        more = simpler.freedom - self.freedom
        if self.freedom < 3 or more < 1:
            return 1.0
        noise = max(self.chi2 / self.freedom, 1.0)  # cells cannot scatter less than their vehicles
        return float(fdtrc(more, self.freedom, (simpler.chi2 - self.chi2) / more / noise))
