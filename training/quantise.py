"""Store a network in 8 bits, which runs up to twice as fast on a CPU and takes a third of the space.

    python -m training.quantise training/weights/small_vehicle.onnx --labels ../shared/data/vehicles/labels.json \\
        --labels ../shared/data/vehicles/chips --out orthoscale/detect/weights/small_vehicle.onnx

Every convolution but the last, whose outputs are the boxes, multiplies 8-bit integers. Weights have a scale for each
output channel; activations have one for each layer, from the smallest to the largest value on training crops
(`augment`). No test place is used. Weights have 7 bits: CPUs without VNNI add products in 16 bits, which two products
of 8 bits overflow, so their results would differ from those of others. The mean loss of the outputs at vehicles is
added to them again (bias correction: Nagel et al. 2019, Data-free quantization, section 4.2).

Training continues from the network in 32 bits, never from the one in 8.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from .augment import crops
from .data import read_labels
from .export import with_card
from .train import SCENE_WEIGHTS

COUNT = 600  # crops used for calibration
INTEGER = ["Conv", "Add", "Relu", "Clip", "Resize"]  # operators that become integer ones
VEHICLE = -1.0  # logit of the heat from which the outputs of a cell count as those of a vehicle


def quantise(network: Path, shown: Sequence[np.ndarray], out: Path) -> None:
    """Write the ONNX file `network` to `out` in 8 bits, with its card. shown : calibration inputs (3, h, w) uint8."""
    import onnx
    from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Shown(CalibrationDataReader):
        def __init__(self) -> None:
            self.left = iter(shown)

        def get_next(self) -> dict[str, np.ndarray] | None:
            image = next(self.left, None)
            return None if image is None else {"image": _as_input(image)}

    with tempfile.TemporaryDirectory() as scratch:
        plain, stored = Path(scratch) / "plain.onnx", Path(scratch) / "stored.onnx"
        quant_pre_process(network, plain, skip_symbolic_shape=True)
        head = [node for node in onnx.load(plain).graph.node if node.op_type == "Conv"][-1]
        quantize_static(
            plain, stored, Shown(), per_channel=True, reduce_range=True, activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8, op_types_to_quantize=INTEGER, nodes_to_exclude=[head.name],
        )  # fmt: skip
        _add_to_bias(stored, head.input[2], lost(network, stored, shown))
        (card,) = (entry.value for entry in onnx.load(network).metadata_props if entry.key == "orthoscale")
        with_card(stored, json.loads(card), out)


def lost(network: Path, stored: Path, shown: Sequence[np.ndarray]) -> np.ndarray:
    """(channels,) mean by which the outputs of `network` exceed those of `stored` in each channel, at the vehicles that
    the former sees in `shown`."""
    import onnxruntime

    before, after = (
        onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"]) for file in (network, stored)
    )
    differences = []
    for image in shown:
        maps, others = (session.run(None, {"image": _as_input(image)})[0][0] for session in (before, after))
        differences.append((maps - others)[:, maps[0] > VEHICLE])
    return np.concatenate(differences, axis=1).mean(1)


def _add_to_bias(file: Path, name: str, more: np.ndarray) -> None:
    """Add `more` (channels,) to the bias `name` of the network in `file`."""
    import onnx

    model = onnx.load(file)
    (bias,) = (value for value in model.graph.initializer if value.name == name)
    bias.CopyFrom(onnx.numpy_helper.from_array((onnx.numpy_helper.to_array(bias) + more).astype(np.float32), name))
    onnx.save(model, file)


def _as_input(image: np.ndarray) -> np.ndarray:
    return image[None].astype(np.float32) / 255


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", type=Path, help="ONNX file with an orthoscale card")
    parser.add_argument("--labels", type=Path, action="append", required=True, help="label file; may be repeated")
    parser.add_argument("--count", type=int, default=COUNT, help="crops that are shown (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()

    images = [image for file in options.labels for image in read_labels(file)]
    shown = [image for image, *_ in islice(crops(images, SCENE_WEIGHTS, options.seed), options.count)]
    quantise(options.network, shown, options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
