"""The campaign's table: what each class found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from .runner import PROBLEMS, Outcome

HEADS = ("crash", "hang > 30 s", "> 1 GiB", "left behind", "input changed", "wrong answer with exit 0")


def table(outcomes: Iterable[Outcome], names: Iterable[str]) -> str:
    """A line per class: how many were tried, and how many had each problem."""
    by_class: Mapping[str, list[Outcome]] = {name: [] for name in names}
    for outcome in outcomes:
        by_class[outcome.name].append(outcome)
    lines = [("class", "tried", *HEADS)]
    total = [0] * (1 + len(PROBLEMS))
    for name, those in by_class.items():
        counts = [len(those), *(sum(problem in o.problems for o in those) for problem in PROBLEMS)]
        total = [a + b for a, b in zip(total, counts, strict=True)]
        lines.append((name, *map(str, counts)))
    lines.append(("all", *map(str, total)))
    rows = ["| " + " | ".join(line) + " |" for line in lines]
    return "\n".join([rows[0], "|---" * len(lines[0]) + "|", *rows[1:]])
