"""Throughput of the exhaustive sweep against the bare network, and against SAHI's and GeoDeep's slicing loops.

    pip install sahi geodeep     # perhaps in an environment of their own
    python benchmarks/throughput.py RASTER.tif [--rounds 3] [--workers 2]

All use the shipped detector on the same raster at zoom 1, tiles of 1024 px, an eighth of them shared by neighbours, and
as many threads. `bare` is what no program could beat: the same tiles, decoded, resampled and normalised beforehand, go
through the ONNX sessions of as many threads. orthoscale looks twice (one and a half times the pixels); SAHI and GeoDeep
look once, so network pixels per second are what can be compared. SAHI reads the whole raster into memory first.
Rounds take turns; the median is told. Processor seconds matter where others use the machine too.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from orthoscale.detect.decoders import decode_maps
from orthoscale.detect.detector import SHIPPED, Detector
from orthoscale.detect.sweep import sweep_twice
from orthoscale.detect.tiles import CONFIRMING_ZOOM, OVERLAP, TILE, read, tiles
from orthoscale.detect.workers import cores, on_threads
from orthoscale.sources.raster import RasterSource

WEIGHTS = Path(__file__).parent.parent / "orthoscale" / "detect" / "weights" / SHIPPED
SCORE = 0.4


def session(threads: int) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(WEIGHTS.read_bytes(), options, providers=["CPUExecutionProvider"])


def tensor(image: np.ndarray) -> np.ndarray:
    height, width = (-(-side // 32) * 32 for side in image.shape[:2])
    out = np.full((1, 3, height, width), 114 / 255, np.float32)
    out[0, :, : image.shape[0], : image.shape[1]] = image.transpose(2, 0, 1) / np.float32(255)
    return out


def rows_of(maps: np.ndarray) -> np.ndarray:
    """Upright boxes x1, y1, x2, y2, score, class score, which is what the others know."""
    boxes = decode_maps(maps, SCORE)
    low, high = boxes.corners.min(1), boxes.corners.max(1)
    return np.column_stack([low, high, boxes.score, np.ones(len(boxes))]).astype(np.float32)


def bare(source: RasterSource, workers: int) -> tuple[Callable[[], int], float]:
    inputs = []
    for tile in tiles(source, 1.0):
        image = read(source, tile)
        half = [round(side * CONFIRMING_ZOOM) for side in image.shape[1::-1]]
        inputs += [tensor(image), tensor(cv2.resize(image, half, interpolation=cv2.INTER_AREA))]
    net = session(max(1, cores() // workers))

    def run() -> int:
        with ThreadPoolExecutor(workers) as pool:
            return len(list(pool.map(lambda x: net.run(None, {"image": x})[0].shape, inputs)))

    return run, sum(x.shape[2] * x.shape[3] for x in inputs) / 1e6


def ours(source: RasterSource, workers: int) -> tuple[Callable[[], int], float]:
    jobs = [(source, tile) for tile in tiles(source, 1.0)]
    detector = Detector(threads=max(1, cores() // workers))

    def run() -> int:
        source.close()
        again = RasterSource.open(source.path)  # nothing decoded before
        own = [(again, tile) for _, tile in jobs]
        found = sweep_twice(own, np.arange(len(own)), lambda some: on_threads(some, detector, workers))
        return sum(map(len, found.boxes.values()))

    pixels = sum(t.out_width * t.out_height * (1 + CONFIRMING_ZOOM**2) for _, t in jobs)
    return run, pixels / 1e6


def sahi(source: RasterSource, workers: int) -> tuple[Callable[[], int], float]:
    from sahi.models.base import DetectionModel
    from sahi.predict import get_sliced_prediction
    from sahi.prediction import ObjectPrediction

    net = session(cores())
    looked = []

    class Model(DetectionModel):
        def load_model(self) -> None:
            self.model = net
            self.category_mapping = {"0": "vehicle"}

        def perform_inference(self, image: np.ndarray) -> None:
            x = tensor(image)
            looked.append(x.shape[2] * x.shape[3])
            self._original_predictions = [rows_of(self.model.run(None, {"image": x})[0][0])]

        def _create_object_prediction_list_from_original_predictions(self, shift_amount_list, full_shape_list=None):
            shift = shift_amount_list[0] if isinstance(shift_amount_list[0], (list, tuple)) else shift_amount_list
            full = full_shape_list[0] if isinstance(full_shape_list[0], (list, tuple)) else full_shape_list
            self._object_prediction_list_per_image = [
                [
                    ObjectPrediction(
                        bbox=row[:4].tolist(), score=float(row[4]), category_id=0, category_name="vehicle",
                        shift_amount=shift, full_shape=full,
                    )
                    for row in rows
                ]
                for rows in self._original_predictions
            ]  # fmt: skip

    model = Model(confidence_threshold=SCORE, device="cpu")

    def run() -> int:
        share = OVERLAP / TILE
        looked.clear()
        result = get_sliced_prediction(
            str(source.path), model, TILE, TILE, share, share, perform_standard_pred=False, postprocess_type="NMS",
            postprocess_match_metric="IOU", verbose=0,
        )  # fmt: skip
        return len(result.object_prediction_list)

    run()
    return run, sum(looked) / 1e6


def geodeep(source: RasterSource, workers: int) -> tuple[Callable[[], int], float]:
    import geodeep.geodeep as loop
    from geodeep.detection import non_max_suppression_fast, preprocess

    config = {
        "det_type": "YOLO_v5_or_v7_default", "det_conf": SCORE, "det_iou_thresh": 0.3, "classes": [],
        "resolution": 1.0, "class_names": {"0": "vehicle"}, "model_type": "Detector",
        "tiles_overlap": 100 * OVERLAP / TILE, "tiles_size": TILE, "input_name": "image",
    }  # fmt: skip
    looked = []

    def detect(image: np.ndarray, net, config: dict) -> np.ndarray:
        looked.append(TILE * TILE)
        rows = rows_of(net.run(None, {"image": preprocess(image)})[0][0])
        return non_max_suppression_fast(rows, config) if len(rows) else rows

    loop.get_model_file = lambda name, callback: name
    loop.create_session = lambda file, max_threads=None: (session(max_threads), config)
    loop.execute_detection = detect

    def run() -> int:
        looked.clear()
        return len(loop.run(str(source.path), "shipped", output_type="raw", max_threads=cores()))

    run()
    return run, sum(looked) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raster", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=cores())
    a = parser.parse_args()
    source = RasterSource.open(a.raster)
    sides: dict[str, tuple[Callable[[], int], float]] = {}
    for make in (bare, ours, sahi, geodeep):
        try:
            sides[make.__name__] = make(source, a.workers)
        except ImportError as error:
            print(f"{make.__name__}: left out ({error})")
    wall: dict[str, list[float]] = {name: [] for name in sides}
    processor: dict[str, list[float]] = {name: [] for name in sides}
    for _ in range(a.rounds):
        for name, (run, _) in sides.items():
            start = time.perf_counter(), time.process_time()
            found = run()
            wall[name].append(time.perf_counter() - start[0])
            processor[name].append(time.process_time() - start[1])
            print(f"  {name}: {wall[name][-1]:.1f} s, {processor[name][-1]:.1f} processor s, {found}", flush=True)
    print(f"{a.raster.name}, {source.width} x {source.height} px, {a.workers} workers")
    print("| | network Mpx | Mpx/s | Mpx per processor second | of bare, wall | of bare, processor |")
    print("|---|---|---|---|---|---|")
    speed = {n: (mpx / np.median(wall[n]), mpx / np.median(processor[n])) for n, (_, mpx) in sides.items()}
    for name, (_, mpx) in sides.items():
        s, bare_s = speed[name], speed["bare"]
        print(f"| {name} | {mpx:.0f} | {s[0]:.2f} | {s[1]:.2f} | {s[0] / bare_s[0]:.2f} | {s[1] / bare_s[1]:.2f} |")


if __name__ == "__main__":
    main()
