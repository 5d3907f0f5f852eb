"""Groups of things that are linked to one another, directly or through others."""

from __future__ import annotations

import numpy as np


def linked(i: np.ndarray, j: np.ndarray, count: int) -> np.ndarray:
    """(count,) number of the group of each of `count` things, where things `i` (P,) and `j` (P,) are linked."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(i)), (i, j)), shape=(count, count))
    labels: np.ndarray = connected_components(links, directed=False)[1]
    return labels
