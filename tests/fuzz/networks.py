"""Tiny ONNX networks that behave badly, and one of orthoscale's own layout with any text for its card."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

NAMES = {"names": "{0: 'large vehicle', 1: 'small vehicle', 2: 'ship'}", "task": "obb", "stride": "32"}


def card_network(path: Path, card: str) -> None:
    """Maps (1, 7, h / 4, w / 4) with no vehicle in them, and the text `card` as its card."""
    weights = [numpy_helper.from_array(np.full((7, 3, 4, 4), -0.01, np.float32), "w")]
    nodes = [helper.make_node("Conv", ["images", "w"], ["maps"], strides=[4, 4], kernel_shape=[4, 4])]
    _save(path, nodes, ("maps", TensorProto.FLOAT, [1, 7, "h4", "w4"]), weights, {"orthoscale": card})


def endless(path: Path) -> None:
    """A loop of 2^62 turns before the output."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Sin", ["x"], ["y"])],
        "turn",
        [
            helper.make_tensor_value_info("k", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 8, 16]),
        ],
        [
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 8, 16]),
        ],
    )
    weights = [
        numpy_helper.from_array(np.array(2**62, np.int64), "turns"),
        numpy_helper.from_array(np.array(True), "true"),
        numpy_helper.from_array(np.ones((1, 8, 16), np.float32), "start"),
    ]
    nodes = [*_nothing(), helper.make_node("Loop", ["turns", "true", "start"], ["looped"], body=body)]
    nodes.append(helper.make_node("Add", ["looped", "nothing"], ["output0"]))
    _save(path, nodes, ("output0", TensorProto.FLOAT, [1, 8, 16]), weights, NAMES)


def many_boxes(path: Path, count: int, metadata: dict[str, str] | None = None) -> None:
    """`count` times the same vehicle, made inside the network, so that the file stays small."""
    column = np.array([100, 100, 36, 15, 0.01, 0.9, 0.01, 0.3], np.float32).reshape(1, 8, 1)
    weights = [
        numpy_helper.from_array(column, "column"),
        numpy_helper.from_array(np.array([1, 8, count], np.int64), "shape"),
    ]
    nodes = [*_nothing(), helper.make_node("Expand", ["column", "shape"], ["many"])]
    nodes.append(helper.make_node("Add", ["many", "nothing"], ["output0"]))
    _save(path, nodes, ("output0", TensorProto.FLOAT, [1, 8, "n"]), weights, metadata or NAMES)


def text_output(path: Path) -> None:
    """An output of strings."""
    weights = [helper.make_tensor("words", TensorProto.STRING, [1, 8, 2], [b"car"] * 16)]
    nodes = [*_nothing(), helper.make_node("Identity", ["words"], ["output0"])]
    _save(path, nodes, ("output0", TensorProto.STRING, [1, 8, 2]), weights, NAMES)


def _nothing() -> list[onnx.NodeProto]:
    """A zero made of the image."""
    return [
        helper.make_node("ReduceMax", ["images"], ["brightest"], keepdims=0),
        helper.make_node("Sub", ["brightest", "brightest"], ["nothing"]),
    ]


def _save(path: Path, nodes: list, output: tuple, weights: list, metadata: dict[str, str]) -> None:
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, "h", "w"])
    graph = helper.make_graph(nodes, "tiny", [image], [helper.make_tensor_value_info(*output)], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata)
    onnx.save(model, path)
