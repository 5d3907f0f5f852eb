"""What a person reads in the terminal: the answer first, then why to believe it."""

from __future__ import annotations

from pathlib import Path

from ..check import own_claim
from ..pipeline import Result
from .document import remarks

WORDS = {"good": "known well", "fair": "known fairly", "poor": "known poorly", "refuse": "not known"}


def summary(result: Result, out: Path | None = None) -> str:
    """A few calm lines, without colour."""
    scale = result.scale
    low, high = scale.interval90
    half_width = 100 * (high - low) / 2 / scale.value
    rejected = ", ".join(f"{count} {reason}" for reason, count in {**scale.rejected, **result.rejected_boxes}.items())
    parts = ", ".join(f"{name} {100 * sd:.1f} %" for name, sd in scale.parts.items() if sd > 0)
    checks = ", ".join(f"{value:.5g} from {name.replace('_', ' ')}" for name, value in scale.checks.items())
    lines = [
        f"scale      {scale.value:.6g} {scale.unit}   ({scale.verdict}: {WORDS[scale.verdict]})",
        f"90 %       {low:.6g} to {high:.6g}   (+- {half_width:.1f} %)",
        f"vehicles   {scale.vehicles_used} used"
        + (f", seen {int(result.votes.views[scale.used].sum())} times" if result.votes.views.max() > 1 else ""),
        f"rejected   {rejected or 'none'}",
        f"fleet      {scale.fleet}: {result.fleet.name}",
        f"uncertain  {parts}   (one sigma)",
        f"checks     {checks}",
        f"detector   {result.detections.detector}, zoom {result.detections.zoom:.2f}",
    ]
    if (claim := own_claim(result.source, scale)) is not None:
        lines.append(f"claim      {claim.sentence()}")
    swept = result.detections.swept
    if swept is not None and len(swept.tiles) < swept.total:
        lines.append(f"looked at  {len(swept.tiles)} of {swept.total} tiles, which was enough (--exhaustive for all)")
    lines += [f"note       {remark}" for remark in remarks(result)]
    lines.append(f"time       {result.seconds:.1f} s")
    if out is not None:
        lines.append(f"written    {out}")
    return "\n".join(lines)
