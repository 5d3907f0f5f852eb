"""The likely cause of a contradiction between the planar and the oblique scale, by the vehicles measured in both."""

from __future__ import annotations

from enum import Enum

import numpy as np

from ..pooling.agreement import CONTRADICTION, MIN_COMMON, Agreement
from .drift import CHANCE, NOTABLE
from .measurement import SelfCalibration
from .model_drift import trend_of

ODD_HEIGHT = 2.0  # sigmas from the card at which the boxes' effective height counts as odd; 5 % are, by chance


class Cause(Enum):
    """Possible causes of a contradiction between two modes of measuring one model."""

    OTHERS = "vehicles that only one of them counts"
    GROUND = "the ground under the vehicles"
    LENS = "focal length or distortion"
    BOXES = "the detector's boxes"


def cause(
    agreement: Agreement, apart: np.ndarray, plan: np.ndarray, calibration: SelfCalibration | None
) -> tuple[Cause, str]:
    """The likely cause of a contradiction between two modes, and the sentence that states it.

    apart : (K,) log ratio of the size by the first mode to that by the second, of the vehicles that count in both.
    plan : (K, 2) their positions on the ground's plane [units]. calibration : of the frames.

    If both modes give the vehicles in common the same sizes, the other vehicles are the cause. A difference that
    changes with the position is due to the ground, or to a bent model: neither mode is better. Otherwise all vehicles
    differ alike. If the fitted effective height is odd as well, the cause is the lens: a wrong focal length falsifies
    the height correction in flat views, while footprints from above are right. If not, it is the boxes.
    """
    count, others = len(apart), "other vehicles cause the difference, or wrong boxes"
    if count < MIN_COMMON:
        return Cause.OTHERS, f"few vehicles count in both ({count}): {others}"
    if abs(agreement.difference) < CONTRADICTION * agreement.sd:
        return Cause.OTHERS, f"the {count} vehicles that count in both agree: {others}"
    trend = trend_of(apart, plan, lots_sd=0.0)  # of the same vehicles
    if trend is not None and trend.p_tilt < CHANCE and trend.tilt > NOTABLE:
        return Cause.GROUND, (
            f"the difference changes by {100 * trend.tilt:.0f} % across the model: the ground under the vehicles "
            "is wrong, or the model is bent"
        )
    if calibration is not None and calibration.ruler.views:
        ruler, card = calibration.ruler, calibration.card
        sigmas = (ruler.height - card.height) / card.sd[:, 0]
        axis = int(np.argmax(np.abs(sigmas)))
        if abs(sigmas[axis]) > ODD_HEIGHT:
            return Cause.LENS, (
                f"the frames make vehicles {ruler.height[axis]:.1f} m high where the detector's boxes take in "
                f"{card.height[axis]:.1f} m: the focal length or the distortion is wrong"
            )
    return Cause.BOXES, "all vehicles differ alike: one of the two resampling factors does not suit the detector"
