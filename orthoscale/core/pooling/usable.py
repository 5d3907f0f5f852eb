"""Which votes can be used, how large their vehicles are, and the errors of these sizes."""

from __future__ import annotations

import numpy as np

from ...errors import TooLittleEvidence
from ..normal import of_median
from ..remarks import amount
from ..ruler import Ruler
from ..votes import Votes
from .observed import Seen

MIN_VEHICLES = 5  # arXiv 2603.07535 asks for the same
SMALLEST_SHARE = 0.3  # least share of a box that must be left once the margin is taken off
# Share of the variance of a measured box that all views of a vehicle have in common: from its paint, its shade, its
# shape. On nine vehicles of `brighton`, with 29 boxes read by eye, lengths err by 1.8 % (one sigma) from vehicle to
# vehicle and by 1.8 % from view to view of one, widths by 3.0 and 4.0 %.
OF_THE_VEHICLE = 0.5


def usable(
    votes: Votes, ruler: Ruler, of_geometry: np.ndarray | None
) -> tuple[np.ndarray, Seen, dict[str, np.ndarray]]:
    """Indices (M,) of the votes that can be used, in the order of their sizes; what is seen of their vehicles, the
    margin taken off; and by part of the uncertainty, the (2, 2) covariances of the errors common to all of them,
    without the fleet's.

    of_geometry : as for `robust.pool`. Raises TooLittleEvidence for fewer than MIN_VEHICLES.
    """
    size = votes.size - np.asarray(ruler.margin) * votes.pixel[:, None]
    index = np.flatnonzero((size > SMALLEST_SHARE * votes.size).all(1) & ~votes.fleeting)
    if len(index) < MIN_VEHICLES:
        raise TooLittleEvidence(f"{amount(len(index), 'usable vehicles')}, {MIN_VEHICLES} are needed")
    index = index[np.lexsort(size[index].T[::-1])]  # some stages take every n-th: sorted, so that order is irrelevant
    size, noise, called = size[index], vote_noise(votes, ruler)[index], _called(votes, ruler)[index]
    share_px = np.median(votes.pixel[index, None] / size, axis=0)  # one pixel as a share of length and width
    known = {
        "margin": _margin_covariance(ruler, share_px),
        "geometry": np.zeros((2, 2)) if of_geometry is None else of_geometry,
    }
    return index, Seen(np.log(size), noise, called, ruler.shrinkage, ruler.confusion), known


def vote_noise(votes: Votes, ruler: Ruler) -> np.ndarray:
    """(N, 2) one-sigma noise of each vote's size [units]: that of its boxes, or else the ruler's; and the errors that
    its views share."""
    views = np.maximum(votes.views, 1)
    variance = (np.asarray(ruler.noise) * votes.pixel[:, None]) ** 2 * of_median(views)[:, None]
    own = (votes.sigma * votes.size * left_by_views(views)[:, None]) ** 2
    variance = np.where(np.isfinite(own), own, variance)
    if votes.lasting is not None:
        variance = variance + (votes.lasting * votes.size) ** 2
    return np.sqrt(variance)


def _called(votes: Votes, ruler: Ruler) -> np.ndarray:
    """(N, 4) probability of each kind for each vote, zeros where it was not assessed; (N, 0) if kinds are not used."""
    if not ruler.kinds or np.isnan(votes.kinds).all():
        return np.empty((len(votes), 0))
    return np.where(np.isnan(votes.kinds).any(1, keepdims=True), 0.0, votes.kinds)


def left_by_views(views: np.ndarray) -> np.ndarray:
    """(N,) share of a measured box's sigma that is left in the median of so many `views` (N,) of one vehicle."""
    return np.sqrt(OF_THE_VEHICLE + (1 - OF_THE_VEHICLE) * of_median(np.maximum(views, 1)))


def _margin_covariance(ruler: Ruler, share_px: np.ndarray) -> np.ndarray:
    """(2, 2) covariance from the margin's uncertainty, as a share of length and width, and from the box bias, own and
    shared. share_px : (2,) one pixel as a share of length and width."""
    own = (np.asarray(ruler.margin_sd) * share_px) ** 2 + np.asarray(ruler.bias_sd) ** 2
    return np.diag(own) + ruler.common_sd**2
