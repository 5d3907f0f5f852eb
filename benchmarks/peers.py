"""orthoscale's sweep side by side with SAHI's and GeoDeep's slicing loops: speed, memory and boxes.

    python -m venv peers && peers/bin/pip install sahi geodeep -e .      # as on the package index
    peers/bin/python benchmarks/peers.py RASTER.tif [--rounds 3]

All use the same network (the shipped detector), the same raster at zoom 1, tiles of 1024 px that share an eighth with
neighbours, and as many threads as cores; each runs in a process of its own, in turns. `bare` is the bound that no
program can beat: the same tiles, decoded, resampled and normalised beforehand, go through ONNX sessions on as many
threads. orthoscale makes two detection passes (one and a half times the pixels) and gives oriented boxes; SAHI and
GeoDeep make one pass and give upright ones. The anytime sweep stops when the sampling error is small enough. Mpx are
those of the raster; memory is the process's peak, imports included; processor seconds matter if the machine is shared.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from orthoscale.core.detections import Detections
from orthoscale.core.measuring.measure import measure
from orthoscale.core.measuring.plan import PlanGeometry
from orthoscale.detect.decoders import decode_maps
from orthoscale.detect.detector import SHIPPED, Detector
from orthoscale.detect.effort import Effort
from orthoscale.detect.find import find_vehicles
from orthoscale.detect.sweep import sweep_twice
from orthoscale.detect.tiles import CONFIRMING_ZOOM, OVERLAP, TILE, read, tiles
from orthoscale.detect.workers import cores, on_threads
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import load_fleet
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
    """Upright boxes x1, y1, x2, y2, score, class score, the form that the other programs use."""
    boxes = decode_maps(maps, SCORE)
    low, high = boxes.corners.min(1), boxes.corners.max(1)
    return np.column_stack([low, high, boxes.score, np.ones(len(boxes))]).astype(np.float32)


def bare(source: RasterSource, workers: int) -> Callable[[], int]:
    inputs = []
    for tile in tiles(source, 1.0):
        image = read(source, tile)
        half = [round(side * CONFIRMING_ZOOM) for side in image.shape[1::-1]]
        inputs += [tensor(image), tensor(cv2.resize(image, half, interpolation=cv2.INTER_AREA))]
    net = session(max(1, cores() // workers))

    def run() -> int:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(lambda x: net.run(None, {"image": x})[0].shape, inputs))
        return 0

    return run


def ours(source: RasterSource, workers: int) -> Callable[[], int]:
    jobs = [(source, tile) for tile in tiles(source, 1.0)]
    detector = Detector(threads=max(1, cores() // workers))

    def run() -> int:
        source.close()
        again = RasterSource.open(source.path)  # with nothing decoded yet
        own = [(again, tile) for _, tile in jobs]
        found = sweep_twice(own, np.arange(len(own)), lambda some: on_threads(some, detector, workers))
        return sum(map(len, found.boxes.values()))

    return run


def sahi(source: RasterSource, workers: int) -> Callable[[], int]:
    from sahi.models.base import DetectionModel
    from sahi.predict import get_sliced_prediction
    from sahi.prediction import ObjectPrediction

    net = session(cores())

    class Model(DetectionModel):
        def load_model(self) -> None:
            self.model = net
            self.category_mapping = {"0": "vehicle"}

        def perform_inference(self, image: np.ndarray) -> None:
            x = tensor(image)
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
        result = get_sliced_prediction(
            str(source.path), model, TILE, TILE, share, share, perform_standard_pred=False, postprocess_type="NMS",
            postprocess_match_metric="IOU", verbose=0,
        )  # fmt: skip
        return len(result.object_prediction_list)

    return run


def geodeep(source: RasterSource, workers: int) -> Callable[[], int]:
    import geodeep.geodeep as loop
    from geodeep.detection import non_max_suppression_fast, preprocess

    config = {
        "det_type": "YOLO_v5_or_v7_default", "det_conf": SCORE, "det_iou_thresh": 0.3, "classes": [],
        "resolution": 1.0, "class_names": {"0": "vehicle"}, "model_type": "Detector",
        "tiles_overlap": 100 * OVERLAP / TILE, "tiles_size": TILE, "input_name": "image",
    }  # fmt: skip

    def detect(image: np.ndarray, net, config: dict) -> np.ndarray:
        rows = rows_of(net.run(None, {"image": preprocess(image)})[0][0])
        return non_max_suppression_fast(rows, config) if len(rows) else rows

    loop.get_model_file = lambda name, callback: name
    loop.create_session = lambda file, max_threads=None: (session(max_threads), config)
    loop.execute_detection = detect

    def run() -> int:
        return len(loop.run(str(source.path), "shipped", output_type="raw", max_threads=cores()))

    return run


def anytime(source: RasterSource, workers: int) -> Callable[[], int]:
    # As in `orthoscale estimate`. Which fleet it is matters little for the sampling error.
    detector, fleet = (
        Detector(threads=max(1, cores() // workers)),
        replace(load_fleet("world"), candidates=(), prior=()),
    )

    def sampling(found: Detections) -> float:
        try:
            return measure(PlanGeometry.of(source, found), fleet).scale.parts["sampling"]
        except TooLittleEvidence:
            return np.inf

    def run() -> int:
        effort = Effort(workers=workers, cache=False)
        found = find_vehicles([source], detector, 1.0, effort=effort, sampling=sampling)
        print(f"{len(found.swept.tiles)} of {found.swept.total} tiles", file=sys.stderr)
        return len(found)

    return run


SIDES = {"bare": bare, "orthoscale": ours, "orthoscale, anytime": anytime, "SAHI": sahi, "GeoDeep": geodeep}


def one(name: str, raster: Path) -> dict[str, float]:
    """One run of a program in this process: seconds by the clock and of the processor, peak memory [MB], boxes."""
    run = SIDES[name](RasterSource.open(raster), cores())
    start, used = time.perf_counter(), time.process_time()
    boxes = run()
    wall, processor = time.perf_counter() - start, time.process_time() - used
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"wall": wall, "processor": processor, "memory": memory, "boxes": boxes}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raster", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    a = parser.parse_args()
    if a.only:
        print(json.dumps(one(a.only, a.raster)))
        return
    found: dict[str, list[dict[str, float]]] = {name: [] for name in SIDES}
    for _ in range(a.rounds):
        for name, runs in found.items():
            command = [sys.executable, __file__, str(a.raster), "--only", name]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            runs.append(json.loads(done.stdout.splitlines()[-1]))
            print(f"  {name}: {runs[-1]}", file=sys.stderr, flush=True)
    source = RasterSource.open(a.raster)
    mpx = source.width * source.height / 1e6
    print(f"{a.raster.name}, {source.width} x {source.height} px, {cores()} cores, median of {a.rounds}")
    print("| | Mpx/s | Mpx per processor second | peak memory [MB] | boxes |")
    print("|---|---|---|---|---|")
    for name, runs in found.items():
        wall, processor, memory, boxes = (np.median([r[k] for r in runs]) for k in runs[0])
        print(f"| {name} | {mpx / wall:.2f} | {mpx / processor:.2f} | {memory:.0f} | {boxes:.0f} |")


if __name__ == "__main__":
    main()
