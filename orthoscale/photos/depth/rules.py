"""The unit of a depth map in metres: a number, or the rule of the network that made it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...detect.output_forms import IMAGENET, Normalisation
from ...errors import UsageError

LARGEST_UNIT = 100.0  # [m] files keep depths in millimetres to metres; a larger unit is a slip
AS_PIXELS = Normalisation((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


@dataclass(frozen=True)
class Rule:
    """How a network's outputs become metres, and what its input is.

    factor : metres per unit of depth; with `per_focal`, metres per unit and per pixel of focal length, that of the
    picture as the network sees it. normalisation : from pixels to the input.
    padding : value around a picture that does not fill the input. side : longest side of the picture for an input of
    free size [px].
    """

    name: str
    factor: float = 1.0
    per_focal: bool = False
    normalisation: Normalisation = IMAGENET
    padding: tuple[float, float, float] = (0.0, 0.0, 0.0)
    side: int = 504

    def metres(self, focal_px: float) -> float:
        """Metres in a unit of depth, for a picture of this focal length [px]."""
        return self.factor * focal_px if self.per_focal else self.factor


RULES = {
    # "metric_depth = focal * net_output / 300., where focal is the focal length in pixels": README of
    # ByteDance-Seed/Depth-Anything-3 on DA3METRIC-LARGE; its pictures have 504 px on their longest side.
    "da3": Rule("Depth Anything 3, metric", 1 / 300, per_focal=True),
    # The canonical camera has a focal length of 1000 px (arXiv 2404.15506, section 3.1; `hubconf.py` of
    # YvanYin/Metric3D multiplies by intrinsic[0] / 1000); its ONNX export subtracts the mean itself.
    "metric3d": Rule("Metric3D", 1 / 1000, per_focal=True, normalisation=AS_PIXELS, padding=IMAGENET.mean, side=1064),
    # "depth" is metres along the optical axis (README of lpiccinelli-eth/UniDepth).
    "unidepth": Rule("UniDepth", side=616),
}
IN_METRES = Rule("metres")


def rule_of(told: str | None) -> Rule:
    """The rule that `told` gives: a number of metres, or a key of RULES; metres for None. Raises UsageError."""
    if told is None:
        return IN_METRES
    if told in RULES:
        return RULES[told]
    try:
        factor = float(told)
    except ValueError:
        factor = math.nan
    if not 0 < factor <= LARGEST_UNIT:
        raise UsageError(
            f"--depth-factor {told} is neither a number of metres nor a known network",
            f"Give the metres in one unit of the depth (0.001 for millimetres), or one of {', '.join(RULES)}.",
        )
    return Rule(f"{factor:g} m", factor)
