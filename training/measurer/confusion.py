"""The entries on vehicle kinds in a measurer's card: its confusion table, and how much places differ in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln

from orthoscale.core.boxes import KINDS

VEHICLES = np.geomspace(1.0, 300.0, 200)  # values tried for the concentration, which says how much places differ
ROUNDS = 20
LESS_LIKELY = 1.92  # log likelihood below the maximum at the ends of a 95 % interval (Wilks 1938)


def card_entries(places: Sequence[tuple[np.ndarray, np.ndarray]]) -> dict[str, object]:
    """`kinds` and `kinds_vehicles` of the card's ruler.

    places : for each place, the kinds (N,) of its vehicles, indices of KINDS, and the shares (N, 4) that the measurer
        gave them, without the share of none; only those that it took for vehicles.
    The shares of a place are modelled as a draw from a Dirichlet distribution, and the kinds that its vehicles are
    given as draws with these shares (a Dirichlet-multinomial distribution, fitted by maximum likelihood). So a place
    with many vehicles does not outweigh the others by their number. How much places differ is estimated from the
    likeliest kind of each vehicle: shares scatter less than such draws, and would make places seem more alike than they
    are (50 vehicles instead of 11). Since places are few, the limit of its interval at which they differ most is taken.
    The row of a kind that no place has is uniform.
    """
    kinds = np.eye(len(KINDS))
    calls = np.array([kinds[kind].T @ kinds[shares.argmax(1)] for kind, shares in places])  # (P, 4, 4)
    given = np.array([kinds[kind].T @ shares for kind, shares in places])
    vehicles = 10.0
    for _ in range(ROUNDS):
        table = _table(calls, vehicles)
        vehicles = float(VEHICLES[np.argmax([_log_likelihood(calls, v * table) for v in VEHICLES])])
    likelihood = np.array([_log_likelihood(calls, v * table) for v in VEHICLES])
    least = VEHICLES[np.argmax(likelihood >= likelihood.max() - LESS_LIKELY)]
    return {"kinds": _table(given, vehicles).round(3).tolist(), "kinds_vehicles": round(float(least), 1)}


def _table(counts: np.ndarray, vehicles: float) -> np.ndarray:
    """(4, 4) mean shares of places with `counts` (P, 4, 4), whose own shares have the concentration `vehicles`."""
    number = counts.sum(2)
    # A place's row scatters by its own shares and by the random draw of its vehicles.
    weight = number / (number + vehicles)
    row = (weight[..., None] * counts / np.maximum(number, 1e-9)[..., None]).sum(0)
    return (row + 1e-2 / len(KINDS)) / (row.sum(1, keepdims=True) + 1e-2)


def _log_likelihood(counts: np.ndarray, rows: np.ndarray) -> float:
    """Log likelihood of `counts` (P, 4, 4) if the rows of places are draws from Dirichlet distributions with the
    parameters `rows` (4, 4)."""
    each = gammaln(rows.sum(1)) - gammaln(counts.sum(2) + rows.sum(1)) + (gammaln(counts + rows) - gammaln(rows)).sum(2)
    return float(each.sum())
