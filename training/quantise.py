"""Store a network in 8 bits, which runs up to twice as fast on a CPU and takes a third of the space.

    python -m training.quantise training/weights/small_vehicle.onnx --labels ../shared/data/vehicles/labels.json \\
        --labels ../shared/data/vehicles/chips --out orthoscale/detect/weights/small_vehicle.onnx

Every convolution but the last, whose outputs are the boxes, multiplies 8-bit integers. Weights have a scale for each
output channel; activations have one for each layer, from the smallest to the largest value on training crops
(`augment`). No test place is used. Weights have 7 bits: CPUs without VNNI add products in 16 bits, which two products
of 8 bits overflow, so their results would differ from those of others. The mean loss of the outputs at vehicles is
added to them again (bias correction: Nagel et al. 2019, Data-free quantization, section 4.2).
`training.measurer.quantise` does the same to the measurer.

Training continues from the network in 32 bits, never from the one in 8.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from .augment import crops
from .data import read_labels
from .export import with_card
from .train import SCENE_WEIGHTS

COUNT = 600  # crops used for calibration
FOLLOW = ("Add", "Relu", "Clip", "Resize")  # operators that become integer ones where their inputs are
VEHICLE = -1.0  # logit of the heat from which the outputs of a cell count as those of a vehicle


def quantise(network: Path, shown: Sequence[np.ndarray], out: Path) -> None:
    """Write the detector `network` (ONNX) to `out` in 8 bits, with its card.

    shown : calibration inputs (3, h, w) uint8.
    """
    import onnx

    with tempfile.TemporaryDirectory() as scratch:
        stored = Path(scratch) / "stored.onnx"
        head = [node for node in onnx.load(network).graph.node if node.op_type == "Conv"][-1]
        in_8_bits(network, [{"image": _as_input(image)} for image in shown], stored, lambda conv: conv == head.name)
        _add_to_bias(stored, head.input[2], lost(network, stored, shown))
        finish(network, stored, out)


def in_8_bits(network: Path, shown: Iterable[Mapping[str, np.ndarray]], out: Path, left: Callable[[str], bool]) -> None:
    """Write the ONNX file `network` to `out` with its convolutions and what follows them in 8 bits, without its card.

    shown : calibration inputs by name. left : whether the convolution of this name stays in 32 bits.
    """
    import onnx
    from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Shown(CalibrationDataReader):
        def __init__(self) -> None:
            self.left = iter(shown)

        def get_next(self) -> Mapping[str, np.ndarray] | None:
            return next(self.left, None)

    with tempfile.TemporaryDirectory() as scratch:
        plain = Path(scratch) / "plain.onnx"
        quant_pre_process(network, plain, skip_symbolic_shape=True)
        quantize_static(
            plain, out, Shown(), per_channel=True, reduce_range=True, activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8, nodes_to_quantize=_of_integers(onnx.load(plain).graph.node, left),
        )  # fmt: skip


def _of_integers(nodes: Iterable[Any], left: Callable[[str], bool]) -> list[str]:
    """Names of the `nodes` (in the order of their computation) that are to compute in integers."""
    computed: dict[str, bool] = {}  # outputs of nodes but constants, and whether these compute in integers
    names = []
    for node in nodes:
        if node.op_type == "Conv":
            integers = not left(node.name)
        else:
            inputs = [computed[name] for name in node.input if name in computed]
            integers = node.op_type in FOLLOW and bool(inputs) and all(inputs)
        if integers:
            names.append(node.name)
        if node.op_type != "Constant":
            computed.update(dict.fromkeys(node.output, integers))
    return names


def finish(network: Path, stored: Path, out: Path) -> None:
    """Write `stored` to `out` with the card of `network`."""
    import onnx

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
