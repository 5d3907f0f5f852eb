r"""How much longer and wider than the vehicle the boxes of each scene are drawn.

    python -m training.label_margin --labels ../shared/data/vehicles/labels.json --exact synthetic/labels.json

A bright vehicle on darker ground shows where it ends without anybody's opinion: where the brightness falls half-way
from the vehicle's level to the ground's. Blur moves a half-level edge hardly at all, so it is comparable between sharp
and soft scenes. It lies a little inside the true end (bumpers curve down, sides lean in, one flank is in shade); how
much is measured in the same way on rendered vehicles, whose boxes are exact (``--exact``). What a scene's boxes exceed
that by is their margin:

    margin = box - (half-level extent) / (the same share of exact boxes)        [px of the scene's images]

Lengths and widths give one margin each, and their plain mean is what is recorded. No metres enter. The ratio of length
to width, which a wrong margin spoils quickly, is compared with that of the country's fleet, as a check only: mirrors,
and in frames seen obliquely a vehicle's height, make it look wider than the fleet says.

**These margins are upper bounds.** Rendered vehicles have crisper ends than real ones. On two orthophotos of known
scale (Manila, Banepa) half-level edges span 0.89 and 0.84 of the fleet's length and 0.83 and 0.77 of its width,
rendered ones 0.97 and 0.96. Of a vehicle 45 px long and 18 px wide that is 3 to 5 px of length and 2 to 3 px of width
which look like a margin here and are none. `training.evaluate --margin` asks the same of the trained network.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from orthoscale.fleet import Fleet

from .data import MARGINS, LabelledImage, read_labels

FLEET = {"munich": "DE", "minsk": "WORLD", "bogota": "CO", "warsaw": "PL", "ohio": "US"}  # whose vehicles a scene has
REACH = 1.5  # profiles run from the box's centre to so many half lengths (half widths) [half box]
GROUND = 1.2  # from here on outwards the profile is ground [half box]
EDGE_FROM = 0.45  # the vehicle's end is looked for from here to GROUND [half box]
MIN_CONTRAST = 45.0  # between vehicle and ground on either side [grey levels of 255]
# Where a profile is taken, as shares of the other half side. Lengths near the middle line, away from rounded corners;
# widths over bonnet and boot, away from the cabin's dark windows.
LENGTHWISE = np.linspace(-0.35, 0.35, 13)
CROSSWISE = np.concatenate([np.linspace(-0.75, -0.4, 12), np.linspace(0.4, 0.75, 12)])
POSITION = np.linspace(-REACH, REACH, 121)  # along a profile [half box]
MIN_VEHICLES = 5  # measured ones, fewer say nothing


@dataclass(frozen=True)
class Measured:
    """What the half-level edges say of one scene's boxes.

    box : (N, 2) length and width of every box [px of the image].
    ratio : (N, 2) half-level extent as a share of the box, nan where a vehicle is not bright enough.
    """

    scene: str
    box: np.ndarray
    ratio: np.ndarray

    @property
    def count(self) -> np.ndarray:
        """(2,) vehicles whose length, whose width could be measured."""
        return np.isfinite(self.ratio).sum(0)

    @property
    def median_ratio(self) -> np.ndarray:
        """(2,) median share for length and width, nan for fewer than MIN_VEHICLES."""
        return _median(self.ratio)

    def margins(self, exact_ratio: np.ndarray) -> np.ndarray:
        """(2,) margin of the lengths and of the widths [px], nan where too few could be measured."""
        return _median(self.box * (1 - self.ratio / exact_ratio))

    def margin_sd(self, exact_ratio: np.ndarray) -> np.ndarray:
        """(2,) their statistical uncertainty [px]; too small where frames repeat the same vehicles."""
        m = self.box * (1 - self.ratio / exact_ratio)
        return 1.48 * _median(np.abs(m - _median(m))) / np.sqrt(np.maximum(self.count, 1))

    def shape(self, margin: Sequence[float] = (0.0, 0.0)) -> float:
        """Median length over median width after `margin` (length, width) [px] is taken off."""
        length, width = np.median(self.box, axis=0) - margin
        return float(length / width)


def _median(values: np.ndarray) -> np.ndarray:
    """Columnwise median without nans; nan for columns with fewer than MIN_VEHICLES values."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a column of nans has none
        median = np.nanmedian(values, axis=0)
    return np.where(np.isfinite(values).sum(0) >= MIN_VEHICLES, median, np.nan)


def measure(scene: str, pictures: Iterable[tuple[np.ndarray, np.ndarray]]) -> Measured:
    """`pictures`: (RGB uint8 (h, w, 3), vehicle boxes (N, 5)) of one scene."""
    boxes, ratios = [np.empty((0, 2))], [np.empty((0, 2))]
    for pixels, xylwa in pictures:
        grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(np.float32)
        boxes.append(xylwa[:, 2:4])
        ratios.append(np.array([half_level_share(grey, box) for box in xylwa]).reshape(-1, 2))
    return Measured(scene, np.concatenate(boxes), np.concatenate(ratios))


def half_level_share(grey: np.ndarray, box: np.ndarray) -> tuple[float, float]:
    """Half-level length and width of the vehicle in `box` (5,), as shares of the box's; nan where it is not bright or
    too near the image's edge. `grey`: float32 (h, w)."""
    along = _sample(grey, box, POSITION, LENGTHWISE)
    across = _sample(grey, box, CROSSWISE, POSITION)
    if min(along.min(), across.min()) < 0:  # outside the image
        return np.nan, np.nan
    # Of parallel strips the brighter than median, so that a bonnet's seams and badges do not count.
    return (
        _half_level_reach(np.percentile(along, 60, axis=0), core=0.6),
        _half_level_reach(np.percentile(across, 60, axis=1), core=0.5),
    )


def _sample(grey: np.ndarray, box: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Grey values on a grid in the box's own frame, (len(across), len(along)) [half box]; -1 outside the image."""
    cx, cy, length, width, angle = box
    u, v = np.meshgrid(along * length / 2, across * width / 2)
    x = cx + u * np.cos(angle) - v * np.sin(angle) - 0.5  # OpenCV counts from the first pixel's centre
    y = cy + u * np.sin(angle) + v * np.cos(angle) - 0.5
    return cv2.remap(
        grey, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
        borderValue=-1,
    )  # fmt: skip


def _half_level_reach(profile: np.ndarray, core: float) -> float:
    """Where a profile over POSITION falls half-way to the ground, mean of both ends [half box]; nan if one is unclear.

    The vehicle's level is that of its bright parts within `core` half boxes of the centre.
    """
    inside = np.percentile(profile[np.abs(POSITION) < core], 60)
    reach = []
    for outwards in (profile, profile[::-1]):
        ground = np.median(outwards[POSITION > GROUND])
        half = (inside + ground) / 2
        falls = (outwards[:-1] >= half) & (outwards[1:] < half)
        falls &= (POSITION[:-1] > EDGE_FROM) & (POSITION[1:] < GROUND)
        if inside - ground < MIN_CONTRAST or not falls.any():
            return np.nan
        k = np.flatnonzero(falls)[-1]  # the outermost, because seams and windows fall and rise again
        share = (outwards[k] - half) / (outwards[k] - outwards[k + 1])
        reach.append(POSITION[k] + share * (POSITION[k + 1] - POSITION[k]))
    return float(np.mean(reach))


def measure_scenes(images: list[LabelledImage]) -> list[Measured]:
    """One measurement per scene that has vehicles, in the order of the labels."""
    scenes = dict.fromkeys(image.scene for image in images if image.is_vehicle.any())
    return [
        measure(scene, ((i.level(0), i.vehicles) for i in images if i.scene == scene and i.is_vehicle.any()))
        for scene in scenes
    ]


def table(scenes: list[Measured], exact: Measured, in_use: Mapping[str, Sequence[float]]) -> str:
    """One line per scene; the last columns compare the shape with that of the country's fleet."""
    lines = [
        f"exact boxes: {exact.count[0]} lengths, {exact.count[1]} widths; "
        f"half-level share {exact.median_ratio[0]:.3f} of the length, {exact.median_ratio[1]:.3f} of the width",
        "",
        "           measured   half-level share    margin [px]               in use [px]   length / width",
        "scene        L    W      L      W       L            W                L     W       raw  in use  fleet",
    ]
    for scene in scenes:
        m, sd = scene.margins(exact.median_ratio), scene.margin_sd(exact.median_ratio)
        used = in_use.get(scene.scene, (0.0, 0.0))
        fleet = Fleet.load(FLEET[scene.scene]) if scene.scene in FLEET else None
        fleet_shape = f"{np.exp(fleet.log_mean[0] - fleet.log_mean[1]):.2f} {fleet.code}" if fleet else "-"
        lines.append(
            f"{scene.scene:10s}{scene.count[0]:5d}{scene.count[1]:5d}  {scene.median_ratio[0]:5.3f}  "
            f"{scene.median_ratio[1]:5.3f}  {m[0]:5.1f} +-{sd[0]:4.1f} {m[1]:5.1f} +-{sd[1]:4.1f}   "
            f"{used[0]:5.1f} {used[1]:5.1f}     {scene.shape():5.2f}  {scene.shape(used):5.2f}   {fleet_shape}"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--labels", type=Path, required=True, help="label file of the scenes to measure")
    parser.add_argument("--exact", type=Path, required=True, help="label file of orthoscale.synthetic")
    parser.add_argument("--write", type=Path, help="write the margins here, in the form of labels/margins.json")
    options = parser.parse_args()

    exact = measure("exact", ((i.level(0), i.vehicles) for i in read_labels(options.exact, tighten=False)))
    scenes = measure_scenes(read_labels(options.labels, tighten=False))
    recorded = json.loads(MARGINS.read_text())
    print(table(scenes, exact, recorded["margin_px"]))
    if options.write:
        margins = {scene.scene: scene.margins(exact.median_ratio).round(1).tolist() for scene in scenes}
        known = {name: margin for name, margin in margins.items() if np.isfinite(margin).all()}
        options.write.write_text(json.dumps({**recorded, "margin_px": known}, indent=1) + "\n")


if __name__ == "__main__":
    main()
