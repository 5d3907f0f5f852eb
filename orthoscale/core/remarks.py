"""Remarks on a scale beside its figures, each with its severity."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

REFUSAL = "refusal"  # no output is written with this scale unless it is forced (exit code 4)
CAUTION = "caution"  # a person should look at it before relying on the scale
SUPPORT = "support"  # something that could have spoken against the scale, and does not
INFO = "info"  # what was chosen or could not be done; neither for nor against the scale
SEVERITIES = (REFUSAL, CAUTION, SUPPORT, INFO)  # in the order in which they are shown
# Checks that state what a remark says (`Remark.check`).
ON_EVIDENCE, ON_PLACES, ON_PARTS = "evidence", "places", "parts"


ONE = {  # the singular of each plural word
    "vehicles": "vehicle",
    "boxes": "box",
    "photos": "photo",
    "images": "image",
    "parts": "part",
    "coordinates": "coordinate",
    "do": "does",
}


def amount(number: int, what: str) -> str:
    """`number` and `what`, which is given in the plural: "4 usable vehicles", but "1 usable vehicle"."""
    words = what.split(" ") if number != 1 else [ONE.get(word, word) for word in what.split(" ")]
    return " ".join([f"{number:,}", *words])


@dataclass(frozen=True)
class Remark:
    """severity : one of SEVERITIES. text : one sentence without its full stop. hint : for a refusal, what to do.
    check : the check of the scale (`measuring.judgement`) that states the same, '' if none does."""

    severity: str
    text: str
    hint: str = ""
    check: str = ""

    def __post_init__(self) -> None:
        """Raises ValueError for an unknown severity."""
        if self.severity not in SEVERITIES:
            raise ValueError(f"severity: expected one of {', '.join(SEVERITIES)}")

    def document(self) -> dict[str, str]:
        """What files of results show of it, as JSON values."""
        return {"severity": self.severity, "text": self.text}

    def __str__(self) -> str:
        """The sentence."""
        return self.text

    @property
    def label(self) -> str:
        """The word with which a printed line of it begins."""
        return "note" if self.severity == INFO else self.severity


@dataclass(frozen=True)
class Judgement:
    """One check of a scale. severity : one of SEVERITIES. what : in short. detail : the figures."""

    severity: str
    what: str
    detail: str


def informing(texts: Iterable[str]) -> list[Remark]:
    """The `texts` as remarks of severity `info`."""
    return [Remark(INFO, text) for text in texts]


Said = TypeVar("Said", Remark, Judgement)


def by_severity(said: Iterable[Said]) -> tuple[Said, ...]:
    """`said`, sorted with the most serious first; the order is kept within one severity."""
    return tuple(sorted(said, key=lambda one: SEVERITIES.index(one.severity)))


def percent(value: float) -> str:
    """A share with one decimal: 0.0123 is ``1.2 %``. One that would round to zero has up to three: ``0.001 %``."""
    small = 0 < abs(value) < 5e-4
    return f"{100 * value:.3f}".rstrip("0").rstrip(".") + " %" if small else f"{100 * value:.1f} %"


def signed(value: float) -> str:
    """A share with one decimal and its sign, for print: with a true minus."""
    return f"{100 * value:+z.1f} %".replace("-", "−")
