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


def linked_groups(i: np.ndarray, j: np.ndarray, count: int, fewest: int) -> list[np.ndarray]:
    """The groups of `linked` that have `fewest` things or more: the numbers of the things of each, ascending."""
    label = linked(i, j, count)
    member = np.flatnonzero(np.bincount(label)[label] >= fewest)
    order = member[np.argsort(label[member], kind="stable")]
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(order) else []
