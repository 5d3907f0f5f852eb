"""The networks that ship are those that were trained, stored in 8 bits, and see the same."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.drawings import RENDERED_VEHICLES, rendered_vehicles

import training
from orthoscale.core.boxes import matched, suppress
from orthoscale.detect.detector import FINDER, SHIPPED, Detector
from orthoscale.detect.detector import __file__ as detector_file
from orthoscale.detect.measurer import SHIPPED_MEASURER, Measurer

onnx = pytest.importorskip("onnx")
TRAINED, SHIPS = Path(training.__file__).parent / "weights", Path(detector_file).parent / "weights"
MOST = 64  # of a weight's size, so that two products with 255 fit into 16 bits with a sign


def cards(model):
    return [json.loads(entry.value) for entry in model.metadata_props if entry.key == "orthoscale"]


def convolutions(model):
    """(weights in 32 bits, integers or None) of each, by the name of its weights."""
    values = {entry.name: onnx.numpy_helper.to_array(entry) for entry in model.graph.initializer}
    given = {node.output[0]: node for node in model.graph.node if node.op_type == "DequantizeLinear"}
    found = {}
    for name in (node.input[1] for node in model.graph.node if node.op_type == "Conv"):
        if name in values:
            found[name] = values[name], None
        else:
            integers, scale, zero = (values[part] for part in given[name].input)
            assert not zero.any()
            found[given[name].input[0].removesuffix("_quantized")] = integers * scale.reshape(-1, 1, 1, 1), integers
    return found


HEADS = {SHIPPED: 1, FINDER: 1, SHIPPED_MEASURER: 8}  # convolutions that keep 32 bits: those that tell boxes or edges


def shown():
    """An input (3, 96, 128) uint8 with RENDERED_VEHICLES."""
    image = np.full((96, 128, 3), 114, np.uint8)
    vehicles = rendered_vehicles()
    image[: vehicles.shape[0], : vehicles.shape[1]] = vehicles
    return np.ascontiguousarray(image.transpose(2, 0, 1))


@pytest.mark.parametrize("network", HEADS)
def test_what_ships_is_what_was_trained_in_8_bits(network):
    trained, ships = onnx.load(TRAINED / network), onnx.load(SHIPS / network)
    assert cards(ships) == cards(trained) != []
    # Others would ask for a newer onnxruntime than pyproject.toml does.
    assert ships.ir_version == trained.ir_version and list(ships.opset_import) == list(trained.opset_import)
    before, after = convolutions(trained), convolutions(ships)
    assert before.keys() == after.keys()
    for name, (stored, integers) in after.items():
        weights, _ = before[name]
        if integers is None:
            assert np.array_equal(weights, stored)
            continue
        step = np.abs(weights).reshape(len(weights), -1).max(1) / MOST  # of each output channel
        # Where a channel is next to nothing beside its bias, its step is larger.
        assert np.all(np.abs(stored - weights) <= 0.51 * step.reshape(-1, 1, 1, 1) + 1e-5)
        assert integers.dtype == np.int8 and np.abs(integers.astype(int)).max() <= MOST
    assert sum(integers is None for _, integers in after.values()) == HEADS[network]


@pytest.mark.parametrize("name", [SHIPPED, FINDER])
def test_8_bits_see_the_same_vehicles(name):
    trained, ships = (
        suppress(one(shown().transpose(1, 2, 0))) for one in (Detector(TRAINED / name), Detector(shipped=name))
    )
    assert len(trained) == len(ships) == RENDERED_VEHICLES
    mine, theirs, _ = matched(trained, ships, 0.5)
    assert len(mine) == RENDERED_VEHICLES
    before, after = trained[mine], ships[theirs]
    assert np.abs(before.score - after.score).max() < 0.06
    assert np.abs(np.log(before.length / after.length)).max() < 0.03
    assert np.abs(before.xylwa[:, :2] - after.xylwa[:, :2]).max() < 0.5


def test_8_bits_measure_the_same_edges():
    trained, ships = Measurer(TRAINED / SHIPPED_MEASURER), Measurer()
    pixels = shown().transpose(1, 2, 0)
    proposed = suppress(Detector()(pixels))
    assert len(proposed) == RENDERED_VEHICLES
    before, after = (measurer.in_pixels(pixels, proposed).boxes for measurer in (trained, ships))
    change = np.abs(np.log(after.xylwa[:, 2:4] / before.xylwa[:, 2:4]))
    assert 0 < change.max() < 0.01 and np.abs(after.xylwa[:, :2] - before.xylwa[:, :2]).max() < 0.1


def test_what_8_bits_take_from_outputs_is_given_back(tmp_path):
    pytest.importorskip("torch")
    from training.quantise import lost, quantise
    from training.unfold import unfolded

    inputs, out = [shown(), shown()[:, ::-1].copy()], tmp_path / "stored.onnx"
    quantise(TRAINED / SHIPPED, inputs, out)
    assert out.stat().st_size < 0.35 * (TRAINED / SHIPPED).stat().st_size
    assert cards(onnx.load(out)) == cards(onnx.load(TRAINED / SHIPPED))
    assert np.abs(lost(TRAINED / SHIPPED, out, inputs)).max() < 1e-4
    with pytest.raises(ValueError, match="goes on from the networks in training/weights"):
        import torch

        from training.network import NETWORKS

        unfolded(out, NETWORKS["small"](), torch.zeros(1, 3, 64, 64))
