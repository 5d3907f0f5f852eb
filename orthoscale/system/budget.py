"""The memory budget for pictures, boxes and other networks: one figure for the whole process."""

from __future__ import annotations

import re

from ..errors import InputError, UsageError

DEFAULT = 2**30
"""[byte] The budget where nobody says otherwise."""

LEAST_BYTES = 2**29
"""[byte] Less does not hold the shipped network and one tile on each thread."""

_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
_budget = DEFAULT


def memory() -> int:
    """The budget [byte]."""
    return _budget


def allow(amount: int | str) -> None:
    """Set the budget, in bytes or as text: ``"1500M"``, ``"2G"``. Raises UsageError for less than half a gigabyte."""
    global _budget
    size = _bytes(amount) if isinstance(amount, str) else amount
    if size < LEAST_BYTES:
        raise UsageError(f"--memory {amount} is too little", f"Give {in_words(LEAST_BYTES)} or more.")
    _budget = size


def require(needed: float, what: str) -> None:
    """Raise InputError if `needed` [byte] exceeds the budget. what : what needs it, as the subject of a sentence."""
    if needed > _budget:
        raise InputError(
            f"{what} needs {in_words(needed)} of memory, but only {in_words(_budget)} is allowed",
            f"Allow more: --memory {int(-(-needed // 2**30))}G",
        )


def in_words(size: float) -> str:
    """A number of bytes for people: ``1.5 GB``, in powers of 1024 as `allow` takes them."""
    return f"{size / 2**30:.3g} GB" if size >= 2**30 else f"{size / 2**20:.3g} MB"


def _bytes(text: str) -> int:
    found = re.fullmatch(r"(\d{1,6}(?:\.\d+)?|\d{1,18})\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if found is None:
        raise UsageError(f"--memory {text!r} is not an amount of memory", "Give a number with its unit: 1500M, 2G.")
    return int(float(found[1]) * _UNITS[found[2].upper()])
