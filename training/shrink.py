r"""The shrinkage of a detector: how strongly it draws small vehicles too large and large ones too small.

    python -m orthoscale.synthetic ortho runs/truth/jp.png --fleet JP --gsd 0.13 --vehicles 90 --style carpark --seed 1
    python -m training.shrink --detector orthoscale/detect/weights/small_vehicle.onnx runs/truth/*.png

It needs rendered orthophotos with exact boxes, each with the ``.truth.json`` that `orthoscale.synthetic` writes beside
it; of several pixel sizes and several fleets, with small and large vehicles. Each is swept as a user's would be, with
two passes, at the zoom that brings its median vehicle to the detector's best length. Per axis, over all pictures,

    log((box - margin) / vehicle) = shrink * (log usual - log vehicle)

with the margin of the detector's card. Printed are shrink and usual for the card's ``ruler``; the scatter of the
shrink between pictures, a lower limit of ``shrink_sd`` (real vehicles may shrink differently); and the remaining noise
of a box.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orthoscale.core.boxes import Boxes, matched
from orthoscale.detect.tiles import AnyDetector

from .evaluate import IOU, picture_files, twice_seen

WHOLE = 0.9  # share of a vehicle that must be visible
MIN_VEHICLES = 10


@dataclass(frozen=True)
class Shrink:
    """For length and width, (2,) each. value, sd : the shrink, and its scatter between pictures. usual [m].

    noise : one sigma of the residuals [detector px]. scenes : (S, 2) each picture's own shrink.
    """

    value: np.ndarray
    sd: np.ndarray
    usual: np.ndarray
    noise: np.ndarray
    scenes: np.ndarray


def fit_shrink(known: Sequence[tuple[np.ndarray, np.ndarray, float]], margin: Sequence[float]) -> Shrink:
    """Fit the shrink to pictures with exact truth. known : per picture the vehicles (N, 2) [m], their boxes (N, 2)
    [detector px], and metres per detector pixel. margin : (2,) [detector px], which is taken off the boxes."""
    ratios = [np.log((box - np.asarray(margin)) * gsd / vehicle) for vehicle, box, gsd in known]
    sizes = [np.log(vehicle) for vehicle, _, _ in known]
    value, usual, noise = np.empty(2), np.empty(2), np.empty(2)
    scenes = np.array(
        [[-np.polyfit(x[:, k], y[:, k], 1)[0] for k in (0, 1)] for x, y in zip(sizes, ratios, strict=True)]
    )
    x, y = np.concatenate(sizes), np.concatenate(ratios)
    px = np.concatenate([box for _, box, _ in known])
    for k in (0, 1):
        slope, at_one = np.polyfit(x[:, k], y[:, k], 1)
        value[k], usual[k] = -slope, np.exp(-at_one / slope)
        noise[k] = ((y[:, k] - slope * x[:, k] - at_one) * px[:, k]).std(ddof=2)
    return Shrink(value, scenes.std(0, ddof=1) if len(scenes) > 1 else np.full(2, np.nan), usual, noise, scenes)


def known_vehicles(
    path: Path, detector: AnyDetector, best_length: float, score: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """One picture for `fit_shrink`, with its ``.truth.json``. Raises ValueError if too few vehicles are found."""
    truth = json.loads(path.with_suffix(".truth.json").read_text())
    rows = [[b[k] for k in ("cx", "cy", "length", "width", "angle")] for b in truth["boxes"] if b["visible"] > WHOLE]
    exact = Boxes(np.array(rows), np.ones(len(rows)))
    zoom = best_length / float(np.median(exact.length))
    found = Boxes.concatenate(list(twice_seen(picture_files(path), zoom, detector).values()))
    found = found[found.score >= score]
    i, j, _ = matched(exact, found, IOU)
    if len(i) < MIN_VEHICLES:
        raise ValueError(f"{path}: {len(i)} of {len(rows)} vehicles found, {MIN_VEHICLES} are needed")
    return exact.xylwa[i, 2:4] * truth["gsd_m"], found.xylwa[j, 2:4] * zoom, truth["gsd_m"] / zoom


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--detector", type=Path, required=True, help="ONNX file with an orthoscale card")
    parser.add_argument("pictures", type=Path, nargs="+", help="orthophotos with NAME.truth.json beside them")
    options = parser.parse_args()

    from orthoscale.detect.detector import Detector

    detector = Detector(options.detector)
    card = detector.card
    known = [known_vehicles(path, detector, card.best_length, card.score) for path in options.pictures]
    fit = fit_shrink(known, card.ruler.margin)
    for path, (vehicles, _, gsd), own in zip(options.pictures, known, fit.scenes, strict=True):
        print(f"{str(path)[-40:]:40s} {len(vehicles):4d} vehicles  {gsd:.3f} m/px   {own[0]:.2f} {own[1]:.2f}")
    for name, values in (("shrink", fit.value), ("shrink_sd", fit.sd), ("usual", fit.usual), ("noise", fit.noise)):
        print(f'"{name}": [{values[0]:.2f}, {values[1]:.2f}]')


if __name__ == "__main__":
    main()
