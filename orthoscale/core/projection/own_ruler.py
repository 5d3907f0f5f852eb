"""A reconstruction's own ruler: the height up to which boxes enclose vehicles, the margin, and the vehicles' shape.

`self_calibration` fits it to how sizes change from view to view; the detector's card gives one, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..boxes import Boxes
from ..by_value import ByValue
from .exact import BEND, BODIES, FLAT, Hull, ground_size, size_by_ends_and_sides
from .view import Views

HEIGHT, MARGIN, UNDERCUT, LEAN, CORNER = range(5)  # columns of `OwnRuler.value`
SHAPE = (UNDERCUT, LEAN, CORNER)
BODY = (HEIGHT, *SHAPE)  # columns of what boxes enclose
# Finite differences for the slopes: [m], [detector px], [m], [1/m], share of the width. About as large as the
# uncertainty of each: smaller ones change nothing in a box that hides what leans in, which would then seem certain.
DIFFERENCES = (0.2, 0.25, 0.1, 0.1, 0.07)
HIGHEST = 2.2  # of the effective height [m]: the roof of a van
MOST_UNDERCUT = 1.0  # [m]
LOWEST, LARGEST = (0.0, -np.inf, 0.0, -1.0, 0.0), (HIGHEST, np.inf, MOST_UNDERCUT, 1.0, 0.3)
# Prior one sigma of how far vehicles' shapes deviate from the hull's: their lean by lengths and widths
# (`Hull.end_lean`, `Hull.side_lean`), and the corner. Roofs of saloons begin 0.44 and end 0.28 of the length from the
# bumpers, those of vans 0.16 and 0.01; sides lean in by 0.14 of the width up to a saloon's roof, 0.05 up to a van's.
LEAN_SD = (0.1, 0.08)
KNOWN_UNDERCUT_SD = 0.12  # how far vehicles' undercuts deviate from that on a card [m]
CORNER_SD = 0.07


@dataclass(frozen=True)
class SeenBoxes:
    """N boxes in frames, with the viewing geometry of each.

    zoom : detector pixels per picture pixel. metres_per_unit : the scale so far, needed for the bodies' heights [m].
    """

    boxes: Boxes
    views: Views
    zoom: float
    metres_per_unit: float

    def __getitem__(self, some: np.ndarray) -> SeenBoxes:
        return replace(self, boxes=self.boxes[some], views=self.views[some])


@dataclass(frozen=True, eq=False)
class OwnRuler(ByValue):
    """A ruler for lengths and for widths: height [m], margin [detector px], undercut [m], lean [1/m], corner [of the
    width].

    A vehicle is widest above the ground; below, it recedes into its own shade. In steep views its outline is that of
    the waist on all sides, which is its true size. In flatter views the near side ends on the ground, `undercut`
    further in, and only then does height make a box larger. Fitting a straight line to the flat views alone, as for a
    body with upright sides, would remove too much everywhere: on `sheffield` 11 % of the widths.

    value : (2, 5) by axis, in that order. covariance : (2, 5, 5) of these, by axis. views : number of boxes to which
    they were fitted, 0 for the detector's own values. body : the hull to which height, lean and corner belong.
    """

    value: np.ndarray
    covariance: np.ndarray
    views: int = 0
    body: Hull = Hull()

    @classmethod
    def of_card(
        cls,
        height: Sequence[float],
        margin: Sequence[float],
        height_sd: Sequence[float],
        margin_sd: Sequence[float],
        body: Hull = BODIES["car"],
        undercut: Sequence[float] = (0.0, 0.0),
    ) -> OwnRuler:
        """The ruler of the detector's card; (2,) each, for lengths and for widths. An undercut of 0 has no sigma."""
        leans = body.end_lean, body.side_lean
        value = [[h, m, u, k, body.corner] for h, m, u, k in zip(height, margin, undercut, leans, strict=True)]
        under = KNOWN_UNDERCUT_SD if any(undercut) else 0.0
        sd = [[h, m, under, lean, CORNER_SD] for h, m, lean in zip(height_sd, margin_sd, LEAN_SD, strict=True)]
        return cls(np.array(value, float), np.array([np.diag(np.square(one)) for one in sd]), body=body)

    @property
    def height(self) -> np.ndarray:
        """(2,) [m]."""
        return self.value[:, HEIGHT]

    @property
    def margin(self) -> np.ndarray:
        """(2,) [detector px]."""
        return self.value[:, MARGIN]

    @property
    def undercut(self) -> np.ndarray:
        """(2,) [m]."""
        return self.value[:, UNDERCUT]

    @property
    def body_alone(self) -> OwnRuler:
        """The same without the margin, which stays in the boxes."""
        value, covariance = self.value.copy(), self.covariance.copy()
        value[:, MARGIN] = covariance[:, MARGIN] = covariance[:, :, MARGIN] = 0.0
        return replace(self, value=value, covariance=covariance)

    @property
    def expects_undercut(self) -> bool:
        """Whether the undercut has a sigma, as on a card with an undercut."""
        return bool(self.covariance[:, UNDERCUT, UNDERCUT].any())

    @property
    def sd(self) -> np.ndarray:
        """(2, 5) one-sigmas, as `value`."""
        return np.sqrt(np.einsum("kii->ki", self.covariance))

    @property
    def hulls(self) -> tuple[Hull, Hull]:
        """The bodies by which lengths and by which widths are measured."""
        along, across = (
            replace(self.body, height=height, end_lean=lean, side_lean=lean, corner=corner)
            for height, _, _, lean, corner in self.value.tolist()
        )
        return along, across

    def size(self, seen: SeenBoxes) -> np.ndarray:
        """(N, 2) length and width on the ground [units], the margin taken off; NaN where no vehicle gives the box.

        The margin is taken off the box before it is projected: seen obliquely, a pixel covers more ground along the
        viewing direction than across it.
        """
        return self._size(_WithoutMargin(seen, self.margin, self.body))

    def _size(self, tight: _WithoutMargin) -> np.ndarray:
        """As `size`, of boxes from which the margin was taken off."""
        views, metres_per_unit = tight.views, tight.metres_per_unit
        size = size_by_ends_and_sides(tight.boxes, views, metres_per_unit, self.hulls)
        if self.undercut.any():
            above = -(views.ground * views.normal).sum(1, keepdims=True)  # (N, 1) the camera over the ground
            waist_height = np.minimum(self.height, (BEND, self.body.belt))  # up to where ends and sides stand straight
            nearer = 1 - waist_height / metres_per_unit / above  # the waist is closer to the camera than the ground
            size = np.minimum(size + self.undercut / metres_per_unit, np.maximum(tight.outline * nearer, size))
        size[tight.swapped] = np.nan
        return size

    def slopes(self, seen: SeenBoxes, columns: Iterable[int] = range(len(DIFFERENCES))) -> np.ndarray:
        """(N, 2 axes, 5) by how much the size falls per unit of each of `value` [units]; 0 except for `columns`."""
        out, tight = np.zeros((len(seen.boxes), 2, len(DIFFERENCES))), _WithoutMargin(seen, self.margin, self.body)
        for k in columns:
            change = np.zeros(len(DIFFERENCES))
            change[k] = DIFFERENCES[k]
            least, most = np.minimum(LOWEST, self.value), np.maximum(LARGEST, self.value)  # a card's may lie beyond
            low, high = (np.clip(self.value + sign * change, least, most) for sign in (-1, 1))
            ends = (replace(self, value=value) for value in (low, high))
            less, more = (end.size(seen) if k == MARGIN else end._size(tight) for end in ends)
            out[:, :, k] = (less - more) / (high - low)[:, k]
        return out

    def relative_sd(self, size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """(2 axes, 5) relative one-sigmas common to all sizes, from the uncertainty of each of `value`.

        The values are fitted together and their errors may cancel, so these are scaled: their squares add up to the
        joint variance.
        """
        share = _median_share(size, slopes)
        together = np.einsum("ki,kij,kj->k", share, self.covariance, share)
        alone = (share * self.sd) ** 2
        return np.sqrt(alone * (together / np.maximum(alone.sum(1), 1e-30))[:, None])

    def size_and_sd(self, seen: SeenBoxes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sizes (N, 2) as `size`, NaN also where a slightly different body could not give the box; (2,) relative
        one-sigmas common to all lengths and to all widths, from the uncertainty of bodies and of what boxes enclose;
        and the `slopes` (N, 2, 5) for these bodies."""
        size, slopes = self.size(seen), self.slopes(seen, BODY)
        ok = np.isfinite(size).all(1) & np.isfinite(slopes).all((1, 2))
        sd = np.sqrt(np.square(self.relative_sd(size[ok], slopes[ok])).sum(1)) if ok.any() else np.zeros(2)
        return np.where(ok[:, None], size, np.nan), sd, slopes

    def left_of_height(self, card: OwnRuler, size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """(2,) correlation of the errors of lengths and of widths from bodies with the error of the card's height.

        After the fit, the error of the height, h - fitted, is independent of fitted - card. So its covariance with
        h - card is its own variance, and that of any other error is its covariance with h - fitted. It is 1 for the
        card itself if no value but the height matters. It is never below zero: bodies are not known well enough to say
        that two errors cancel in a mean.
        """
        share = _median_share(size, slopes)[:, BODY]
        covariance = self.covariance[:, BODY][:, :, BODY]
        with_height = np.einsum("ki,ki->k", share, covariance[:, :, 0])
        variance = np.einsum("ki,kij,kj->k", share, covariance, share)
        return np.clip(with_height / (np.sqrt(np.maximum(variance, 1e-30)) * card.sd[:, HEIGHT]), 0, 1)

    def document(self, card: OwnRuler) -> dict[str, Any]:
        """The fitted values as plain numbers, beside those of the detector's `card`."""
        return {
            "views": self.views,
            **{
                name: {
                    "card": card.value[:, k].tolist(),
                    "fitted": self.value[:, k].tolist(),
                    "sd": self.sd[:, k].tolist(),
                }
                for k, name in enumerate(("effective_height", "margin_px", "undercut", "lean_per_m", "corner"))
            },
        }


class _WithoutMargin:
    """Boxes from which a `margin` (2,) was taken off. swapped : (N,) bool, those whose longer side would become the
    shorter one; they are left as they are."""

    def __init__(self, seen: SeenBoxes, margin: np.ndarray, body: Hull):
        self.views, self.metres_per_unit, self.body = seen.views, seen.metres_per_unit, body
        xylwa = seen.boxes.xylwa.copy()
        # A share of the box, not a length: boxes from above are in model units, however large these are.
        xylwa[:, 2:4] = np.maximum(seen.boxes.sides - margin / seen.zoom, 1e-6 * seen.boxes.sides)
        self.swapped = xylwa[:, 2] < xylwa[:, 3]  # `Boxes` would call the shorter side the width
        xylwa[self.swapped, 2:4] = seen.boxes.sides[self.swapped]
        self.boxes = Boxes(xylwa, seen.boxes.score)

    @cached_property
    def outline(self) -> np.ndarray:
        """(N, 2) length and width of vehicles that are no more than an outline on the ground [units]."""
        return ground_size(self.boxes, self.views, self.metres_per_unit, replace(self.body, height=FLAT))


def _median_share(size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """(2 axes, 5) median, over sizes (N, 2), of the relative fall of a size per unit of each of a ruler's values, from
    the `slopes` (N, 2, 5)."""
    return np.nanmedian(slopes / size[..., None], axis=0)
