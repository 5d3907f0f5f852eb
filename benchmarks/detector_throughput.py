"""How many pixels per second the shipped detector and finder process, and how many vehicles the measurer measures.

    python benchmarks/detector_throughput.py ../shared/data/orthophotos/manila.tif:0.8

The picture is given with the zoom at which its vehicles are found. Tiles have 1024 x 1024 px. The networks work in
turn, so that other work of the machine affects all of them; the best of the repetitions counts, which is disturbed
least. Processor seconds are those of all threads: on a busy machine they are more reliable than the clock.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.boxes import Boxes, suppress
from orthoscale.detect.detector import FINDER, SHIPPED, Detector
from orthoscale.detect.measurer import Measurer
from orthoscale.detect.tiles import TILE, read, tiles
from orthoscale.sources.raster import RasterSource

VEHICLES = 64  # that the measurer measures in one call


def best_seconds(works: list[Callable[[], object]], repetitions: int) -> np.ndarray:
    """(works, 2) shortest time of each: by the clock, and of the processor in all threads [s]."""
    seconds = np.full((repetitions, len(works), 2), np.inf)
    for row in seconds:
        for k, work in enumerate(works):
            clock, processor = time.perf_counter(), time.process_time()
            work()
            row[k] = time.perf_counter() - clock, time.process_time() - processor
    return seconds.min(0)


def filled(image: np.ndarray) -> np.ndarray:
    """`image`, extended to a whole tile by mirroring at its right and lower edges."""
    missing = [max(TILE - side, 0) for side in image.shape[:2]]
    return cv2.copyMakeBorder(image, 0, missing[0], 0, missing[1], cv2.BORDER_REFLECT)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", metavar="PICTURE:ZOOM")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repetitions", type=int, default=15)
    options = parser.parse_args()
    path, _, zoom = options.picture.rpartition(":")

    detector, finder = (Detector(threads=options.threads, shipped=name) for name in (SHIPPED, FINDER))
    measurer = Measurer(threads=options.threads)
    with RasterSource.open(Path(path)) as source:
        images = [filled(read(source, tile)) for tile in tiles(source, float(zoom))]
    tile, found = max(((image, suppress(detector(image))) for image in images), key=lambda look: len(look[1]))
    if not len(found):
        parser.error("the detector finds no vehicle there")
    vehicles = Boxes.concatenate([found] * -(-VEHICLES // len(found)))[np.arange(VEHICLES)]

    works: list[Callable[[], object]] = [
        lambda: detector(tile),
        lambda: finder(tile),
        lambda: measurer.in_pixels(tile, vehicles),
    ]
    amounts = [(tile.shape[0] * tile.shape[1] / 1e6, "Mpx")] * 2 + [(VEHICLES, "vehicles")]
    for name, (amount, unit), (clock, processor) in zip(
        ("detector", "finder", "measurer"), amounts, best_seconds(works, options.repetitions), strict=True
    ):
        print(
            f"{name}: {amount / clock:.1f} {unit} per second on {options.threads} threads, "
            f"{amount / processor:.1f} per processor second"
        )


if __name__ == "__main__":
    main()
