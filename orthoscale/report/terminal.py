"""Prints the summary of a result in the terminal: one table, the answer first, then what it rests on."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from ..core.claims import own_claim
from ..core.normal import Z90
from ..core.remarks import percent
from ..errors import LONGEST_MESSAGE, shown
from ..system.printing import echo, printing
from .result import Result
from .wording import counted, counted_kinds, likely_fleets

VERDICT_STYLES = {"good": "bold green", "fair": "bold yellow", "poor": "bold red", "unusable": "bold reverse red"}
NEGLIGIBLE_PART = 0.001  # relative one sigma that one decimal of a per cent just shows


def show(result: Result, written: Mapping[str, Path] = MappingProxyType({})) -> None:
    """Print the summary of `result`, and the paths that were `written`.

    On a terminal as a table of its width, with colours unless the environment variable NO_COLOR is set; into a pipe one
    line per row.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(color_system=None if os.environ.get("NO_COLOR") else "auto", highlight=False)
    if not console.is_terminal:
        echo(summary(result, written))
        return
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for k, (label, value) in enumerate(rows(result, written)):
        table.add_row(Text(label, "dim"), Text(value, VERDICT_STYLES[result.scale.verdict] if k == 0 else ""))
    with printing():
        console.print(table)


def summary(result: Result, written: Mapping[str, Path] = MappingProxyType({})) -> str:
    """The summary as text, one line per row, without colours."""
    return "\n".join(f"{label:10s} {value}" for label, value in rows(result, written))


def _beside_others(sd: float, total: float) -> str:
    """A part of an uncertainty (relative one-sigma) of `total`, with one decimal as the others have."""
    hidden = sd < NEGLIGIBLE_PART / 2 and total > 5 * NEGLIGIBLE_PART
    return f"below {percent(NEGLIGIBLE_PART)}" if hidden else percent(sd)


def rows(result: Result, written: Mapping[str, Path]) -> list[tuple[str, str]]:
    """Labels and texts, the answer first, in ASCII, which every terminal and pipe can take."""
    scale = result.scale
    checks = (f"{name.replace('_', ' ')} {100 * (v / scale.value - 1):+z.1f} %" for name, v in scale.checks.items())
    parts = (f"{name} {_beside_others(sd, scale.relative_sd)}" for name, sd in scale.parts.items() if sd > 0)
    seen = f", in {int(result.votes.views[scale.used].sum())} views" if result.votes.views.max(initial=0) > 1 else ""
    kinds = counted_kinds(result.vehicles["kind"][scale.used])
    rejected = {**scale.rejected, **result.rejected_boxes}
    table = [
        *result.scale.answer(),
        ("vehicles", f"{scale.vehicles_used} used{seen}{': ' if kinds else ''}{kinds}"),
        ("rejected", counted(rejected) or "none"),
        ("fleet", f"{scale.fleet} ({result.fleet.name})"),
        *([("likely", f"the vehicles' fleet is {likely}")] if (likely := likely_fleets(scale.fleets)) else []),
        *([("checks", "scale from " + ", ".join(checks))] if scale.checks else []),
        ("uncertain", (", ".join(parts) or "nothing") + " (1 sigma each)"),
        (
            "detector",
            f"{result.detections.detector}, resampling factor {result.detections.zoom:.2f}, {result.seconds:.1f} s",
        ),
    ]
    if (claim := own_claim(result.source, scale)) is not None:
        table.append(("claim", claim.sentence()))
    swept = result.detections.swept
    if swept is not None and swept.why:
        table.append(("sweep", f"{swept.looked_at}, {swept.why} (--exhaustive for all)"))
    table += [
        ("also", f"{e.value:.5g} {scale.unit} from {e.says}  +- {percent(Z90 * e.relative_sd)} (90 %)")
        for e in scale.evidence
    ]
    if result.anchors.votes:
        anchors = Counter(vote.anchor.kind for vote in result.anchors.votes)
        found = ", ".join(f"{count} x {kind}" for kind, count in anchors.items())
        before = result.anchors.without
        without = "" if before is None else f"; without them {before.within} (90 %)"
        table.append(("anchors", found + without))
    table += [(remark.label, remark.text) for remark in result.remarks]
    table += [(label, str(path)) for label, path in written.items()]
    return [(label, shown(value, LONGEST_MESSAGE)) for label, value in table]
