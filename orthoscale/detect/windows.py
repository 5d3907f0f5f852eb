"""Windows around some of the found vehicles: samples of how vehicles and their surroundings look in these pictures."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from ..core.boxes import Boxes
from ..core.evenly import evenly
from ..core.source import Picture

AT_MOST = 30  # windows; enough for medians and quantiles over them


def windows_about(pictures: Mapping[str, Picture], boxes: Mapping[str, Boxes]) -> list[np.ndarray]:
    """Grey windows (H, W), uint8, around some `boxes`, evenly chosen from all; each is two box lengths wide."""
    every = [(name, box) for name, some in boxes.items() for box in some.xylwa]
    return [_window(pictures[name], box) for name, box in (every[k] for k in evenly(len(every), AT_MOST))]


def _window(picture: Picture, box: np.ndarray) -> np.ndarray:
    limit = np.array([picture.width, picture.height])
    x, y = low = np.clip(np.floor(box[:2] - box[2]), 0, limit - 1).astype(int)
    width, height = (np.clip(np.ceil(box[:2] + box[2]), low + 1, limit).astype(int) - low).tolist()
    return np.asarray(cv2.cvtColor(picture.read(int(x), int(y), width, height, width, height), cv2.COLOR_RGB2GRAY))
