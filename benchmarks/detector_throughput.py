"""How many pixels per second the detector looks at, in single precision and quantised to 8 bits, and what the latter
does to its boxes.

    python benchmarks/detector_throughput.py examples/town/ortho.jpg:0.74 ../shared/data/orthophotos/manila.tif:0.8

Each picture is given with its zoom; the quantised network gets its ranges from the first, and boxes are compared on the
others. Tiles of 1024 x 1024 px; both networks look at the same tile in turn, so that
whatever else the machine does hits both; the best of the repetitions counts, which other work disturbs least. Processor
seconds are those of all threads: on a busy machine they tell more than the clock does. Needs onnx (the extra
`training`). The quantised network is thrown away: the shipped weights stay as they are.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.boxes import matched, suppress
from orthoscale.detect.detector import Detector
from orthoscale.detect.tiles import TILE, read, tiles
from orthoscale.sources.raster import RasterSource

SAME_BOX = 0.5
CALIBRATION_CROPS = 24  # of 512 px


def tiles_of(path: Path, zoom: float) -> list[np.ndarray]:
    """All tiles of a picture that are as large as tiles get, RGB."""
    with RasterSource.open(path) as source:
        images = [read(source, tile) for tile in tiles(source, zoom)]
    return [image for image in images if min(image.shape[:2]) >= TILE // 2]


def quantised(weights: Path, images: list[np.ndarray], out: Path) -> Path:
    """`weights` with 8 bit activations and weights (QDQ, u8s8, per channel), its ranges taken from `images`."""
    import onnx
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Crops(CalibrationDataReader):
        def __init__(self) -> None:
            rng = np.random.default_rng(0)
            self.crops = []
            for k in range(CALIBRATION_CROPS):
                image = images[k % len(images)]
                y, x = (int(rng.integers(0, image.shape[axis] - 511)) for axis in (0, 1))
                crop = image[y : y + 512, x : x + 512].transpose(2, 0, 1)[None]
                self.crops.append({"image": crop.astype(np.float32) / 255})

        def get_next(self) -> dict[str, np.ndarray] | None:
            return self.crops.pop() if self.crops else None

    plain = out.with_name("plain.onnx")
    quant_pre_process(str(weights), str(plain), skip_symbolic_shape=True)
    quantize_static(
        str(plain),
        str(out),
        Crops(),
        quant_format=QuantFormat.QDQ,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        per_channel=True,
    )
    model, card = onnx.load(out), onnx.load(weights).metadata_props
    del model.metadata_props[:]
    model.metadata_props.extend(card)
    onnx.save(model, out)
    return out


def best_seconds(looks: Sequence[Detector], image: np.ndarray, repetitions: int) -> np.ndarray:
    """(looks, 2) shortest time that each takes on `image`: by the clock, and of the processor in all threads [s]."""
    seconds = np.full((repetitions, len(looks), 2), np.inf)
    for row in seconds:
        for k, look in enumerate(looks):
            clock, processor = time.perf_counter(), time.process_time()
            look(image)
            row[k] = time.perf_counter() - clock, time.process_time() - processor
    return seconds.min(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="+", metavar="PICTURE:ZOOM", help="two or more")
    parser.add_argument("--detector", type=Path, help="instead of the shipped one")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repetitions", type=int, default=15)
    options = parser.parse_args()
    if len(options.pictures) < 2:
        parser.error("two pictures are needed: ranges from the first, boxes compared on the others")

    exact = Detector(options.detector, threads=options.threads)
    first, *others = (
        tiles_of(Path(path), float(zoom)) for path, _, zoom in (t.rpartition(":") for t in options.pictures)
    )
    images = [image for tiles in others for image in tiles]
    with tempfile.TemporaryDirectory() as scratch:
        small_file = quantised(exact.path, first, Path(scratch) / "int8.onnx")
        small = Detector(small_file, threads=options.threads)
        sizes = exact.path.stat().st_size / 1e6, small_file.stat().st_size / 1e6

    largest = max(first, key=lambda image: image.size)
    missing = [TILE - side for side in largest.shape[:2]]
    tile = cv2.copyMakeBorder(largest, 0, missing[0], 0, missing[1], cv2.BORDER_REFLECT)
    speed = tile.shape[0] * tile.shape[1] / 1e6 / best_seconds((exact, small), tile, options.repetitions)
    for name, size, (clock, processor) in zip(("fp32", "int8"), sizes, speed, strict=True):
        print(
            f"{name}  {size:.1f} MB  {clock:5.1f} Mpx/s on {options.threads} threads, "
            f"{processor:.1f} Mpx per processor second, decoding included"
        )
    print(
        f"int8 is {speed[1, 0] / speed[0, 0]:.2f} times as fast by the clock, {speed[1, 1] / speed[0, 1]:.2f} by load"
    )

    lost = extra = 0
    ratio = []
    for image in images:
        a, b = (suppress(detector(image)) for detector in (exact, small))
        i, j, _ = matched(a, b, SAME_BOX)
        lost, extra = lost + len(a) - len(i), extra + len(b) - len(j)
        ratio.append(np.log(b.xylwa[j, 2:4] / a.xylwa[i, 2:4]))
    ratios = np.concatenate(ratio)
    found = len(ratios) + lost
    middle, spread = np.median(ratios, axis=0), 1.48 * np.median(np.abs(ratios - np.median(ratios, axis=0)), axis=0)
    print(f"boxes of fp32: {found}; int8 loses {lost} and adds {extra}")
    print(f"length of the others: {100 * middle[0]:+.1f} % with a spread of {100 * spread[0]:.1f} %")
    print(f"width of the others:  {100 * middle[1]:+.1f} % with a spread of {100 * spread[1]:.1f} %")


if __name__ == "__main__":
    main()
