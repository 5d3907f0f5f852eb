"""What a measurer's card says of kinds: its confusion table, and how much places differ in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln

from orthoscale.core.boxes import KINDS

VEHICLES = np.geomspace(1.0, 300.0, 200)  # tried for how much places differ
ROUNDS = 20
LESS_LIKELY = 1.92  # log likelihood below the greatest, at the ends of a 95 % interval (Wilks 1938)


def card_entries(places: Sequence[tuple[np.ndarray, np.ndarray]]) -> dict[str, object]:
    """`kinds` and `kinds_vehicles` of the card's ruler.

    places : of each place, the kind (N,) of its vehicles, numbers of KINDS, and the shares (N, 4) that they were given;
        of those that were taken for vehicles, without the share of none.
    The shares of a place are taken to come from a Dirichlet distribution, and what its vehicles are called from these
    shares (a Dirichlet-multinomial distribution, of the greatest likelihood); so a place of many vehicles does not
    outweigh the others by their number. How much places differ is told by the likeliest kind of each vehicle: shares
    scatter less than such draws do, and places would seem more alike than they are (50 vehicles instead of 11). It is
    given at its upper limit, for few places tell it. A kind that no place has is as likely called anything.
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
    """(4, 4) mean shares of places with `counts` (P, 4, 4), that have their own as if from so many `vehicles`."""
    number = counts.sum(2)
    # A place's row strays by its own share and by the luck of its vehicles.
    weight = number / (number + vehicles)
    row = (weight[..., None] * counts / np.maximum(number, 1e-9)[..., None]).sum(0)
    return (row + 1e-2 / len(KINDS)) / (row.sum(1, keepdims=True) + 1e-2)


def _log_likelihood(counts: np.ndarray, rows: np.ndarray) -> float:
    """Of `counts` (P, 4, 4), where the rows of places come from Dirichlet distributions of these parameters (4, 4)."""
    each = gammaln(rows.sum(1)) - gammaln(counts.sum(2) + rows.sum(1)) + (gammaln(counts + rows) - gammaln(rows)).sum(2)
    return float(each.sum())
