"""Tiny ONNX networks of known output, in the format of each detector that is recognised."""

from __future__ import annotations

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
helper, numpy_helper = onnx.helper, onnx.numpy_helper

# Centre x, y, width, height [px], angle [rad], confidence, class: a car written long side first, one written short side
# first, a large vehicle, a doubtful car.
TRUTH = np.array(
    [
        [40.0, 30.0, 36.0, 15.0, 0.4, 0.9, 1],
        [90.0, 50.0, 14.0, 33.0, 0.2, 0.8, 1],
        [20.0, 80.0, 90.0, 24.0, 0.0, 0.9, 0],
        [60.0, 90.0, 35.0, 15.0, 0.1, 0.2, 1],
    ]
)
CARS = [[40, 30, 36, 15, 0.4], [90, 50, 33, 14, 0.2 - np.pi / 2]]
NAMES = {"names": "{0: 'large vehicle', 1: 'small vehicle', 2: 'ship'}", "task": "obb", "stride": "32"}


def network(path, outputs, metadata=None, size=("h", "w"), open_shapes=False, dtype=onnx.TensorProto.FLOAT):
    """An ONNX file with constant outputs, arrays by name; only an added zero is computed from its image."""
    nodes, values, weights = [], [], []
    nodes.append(helper.make_node("ReduceMax", ["images"], ["brightest"], keepdims=0))
    for name, array in outputs.items():
        array = np.asarray(array)
        kind = onnx.TensorProto.INT64 if array.dtype.kind == "i" else dtype
        weights.append(numpy_helper.from_array(array.astype(helper.tensor_dtype_to_np_dtype(kind)), f"{name}_known"))
        nodes += [
            helper.make_node("Cast", ["brightest"], [f"{name}_cast"], to=kind),
            helper.make_node("Sub", [f"{name}_cast", f"{name}_cast"], [f"{name}_zero"]),
            helper.make_node("Add", [f"{name}_known", f"{name}_zero"], [name]),
        ]
        shape = [f"{name}{k}" for k in range(array.ndim)] if open_shapes else array.shape
        values.append(helper.make_tensor_value_info(name, kind, shape))
    image = helper.make_tensor_value_info("images", dtype, [1, 3, *size])
    model = helper.make_model(
        helper.make_graph(nodes, "tiny", [image], values, weights),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=8,
    )
    helper.set_model_props(model, metadata or {})
    onnx.save(model, path)
    return path


def raw(classes=3):
    """Outputs as [1, 4 + classes + 1, n]; other classes have a small score, too."""
    scores = np.full((len(TRUTH), classes), 0.01)
    scores[np.arange(len(TRUTH)), TRUTH[:, 6].astype(int)] = TRUTH[:, 5]
    return np.hstack([TRUTH[:, :4], scores, TRUTH[:, 4:5]]).T[None]


def nms_free():
    """Outputs as [1, n, 7], padded with rows of zeros."""
    return np.vstack([TRUTH[:, [0, 1, 2, 3, 5, 6, 4]], np.zeros((3, 7))])[None]


def mmrotate(large=5, small=4):
    """Outputs dets [1, n, 6] and labels [1, n], with DOTA's class numbers."""
    return {"dets": TRUTH[None, :, :6], "labels": np.where(TRUTH[:, 6] == 1, small, large)[None]}


def depth_network(
    path, gain=1.0, offset=0.0, size=(None, None), rank=4, inputs=1, outputs=("depth",), channels=3, flat=False
):
    """An ONNX file whose outputs are `gain` times the first channel of its picture plus `offset`, at half its size."""
    lead = [1] * (rank - 3)
    shape = [*lead, channels, *(n or name for n, name in zip(size, ("h", "w"), strict=True))]
    pictures = [helper.make_tensor_value_info(f"image{k}", onnx.TensorProto.FLOAT, shape) for k in range(inputs)]
    weights = [
        numpy_helper.from_array(np.array(values, kind), name)
        for name, values, kind in (
            ("gain", gain, np.float32), ("offset", offset, np.float32), ("first", [0], np.int64),
            ("four", [1, channels, 0, 0], np.int64), ("start", [0, 1, 1], np.int64), ("end", [1, 9999, 9999], np.int64),
            ("axes", [1, 2, 3], np.int64), ("step", [1, 2, 2], np.int64), ("one", [1], np.int64),
        )
    ]  # fmt: skip
    nodes = [
        helper.make_node("Squeeze", ["image0", "one"], ["flat"]) if rank == 5
        else helper.make_node("Identity", ["image0"], ["flat"]),
        helper.make_node("Slice", ["flat", "start", "end", "axes", "step"], ["red"]),
        helper.make_node("Mul", ["red", "gain"], ["scaled"]),
        helper.make_node("Add", ["scaled", "offset"], ["made"]),
    ]  # fmt: skip
    nodes += [
        helper.make_node("ReduceMean", ["made"], [name], keepdims=0)
        if flat
        else helper.make_node("Identity" if name == outputs[-1] else "Neg", ["made"], [name])
        for name in outputs
    ]
    values = [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None) for name in outputs]
    graph = helper.make_graph(nodes, "depth", pictures, values, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, path)
    return path
