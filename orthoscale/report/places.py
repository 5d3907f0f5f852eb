"""The local scale in a report: of an orthophoto by cells, of a model by regions and frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, expm1, log
from typing import Any

from ..core.normal import Z90
from .stored import pixel_size


@dataclass(frozen=True)
class LocalRegionScale:
    """x, y : its middle on the plan [m]. width, height : its size [m], 0 where it has none.
    deviation : log of its scale over the overall scale; sd : one sigma of that."""

    x: float
    y: float
    width: float
    height: float
    deviation: float
    sd: float


@dataclass(frozen=True)
class LocalFrameScale:
    """deviation : log ratio of the scale from this frame to the scale from all frames, for the same vehicles."""

    name: str
    deviation: float
    sd: float
    odd: bool


def in_percent(deviation: float, sd: float) -> tuple[float, float]:
    """The `deviation` (log) of a scale and its one sigma `sd` in per cent, the latter as half the width of the 90 %
    interval. Every output gives these figures."""
    return 100 * expm1(deviation), 100 * Z90 * sd * exp(deviation)


def regions(report: Mapping[str, Any]) -> list[LocalRegionScale]:
    """Regions with a scale of their own; none if there are too few vehicles to compare them."""
    drift, scale = report.get("drift") or {}, report["scale"]
    if drift.get("cells"):
        ((_, image_height),) = report["pictures"].values()
        wide, high = pixel_size(report)
        width, height = drift["cell_px"]
        return [
            LocalRegionScale(
                c["x_px"] * wide,
                (image_height - c["y_px"]) * high,
                width * wide,
                height * high,
                c["deviation"],
                c["sd"],
            )
            for c in drift["cells"]
        ]
    return [
        LocalRegionScale(x * scale, y * scale, 0.0, 0.0, log(r["scale"] / scale), r["sd"] / r["scale"])
        for r in drift.get("regions", [])
        for x, y in [r["centre_unit"]]
    ]


def frames(report: Mapping[str, Any]) -> list[LocalFrameScale]:
    """A model's frames that share vehicles with others, in the order of their names."""
    drift, scale = report.get("drift") or {}, report["scale"]
    odd = set(drift.get("odd_frames", []))
    return [
        LocalFrameScale(name, log(f["scale"] / scale), f["sd"] / f["scale"], name in odd)
        for name, f in sorted(drift.get("frames", {}).items())
    ]
