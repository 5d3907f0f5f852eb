"""Restores a trainable network from an exported ONNX file, so that training can continue without a checkpoint.

Export folds each batch normalisation into its convolution. Here they are separated again, with the means and variances
of the convolutions' outputs on crops: the network does exactly what the file does, and can be trained.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

Layer = nn.Conv2d | nn.Conv1d | nn.Linear


def unfolded(onnx_file: Path, network: nn.Module, crops: Tensor) -> dict[str, Tensor]:
    """The state in which `network` does what `onnx_file` does, which was exported from such a network.

    network : of `training.network` or `training.measurer.network`; it is changed here.

    crops : (n, 3, h, w) RGB as in training; one batch is enough, since training soon has its own statistics.
    Raises ValueError if the file is of a network with other layers, or one stored in 8 bits (`quantise`).
    """
    network.eval()
    layers = list(_by_use(network, crops[:1]).items())
    folded = _weights(onnx_file)
    sizes = [tuple(layer.weight.shape) for layer, _ in layers]
    if [tuple(weight.shape) for weight, _ in folded] != sizes:
        raise ValueError(f"{onnx_file}: not an export of today's {type(network).__name__}; its layers have other sizes")
    with torch.no_grad():
        for (layer, norm), (weight, bias) in zip(layers, folded, strict=True):
            layer.weight.copy_(weight)
            if norm is None:
                layer.bias.copy_(bias)
            else:  # for the initial statistics, 0 and 1
                norm.weight.fill_((1 + norm.eps) ** 0.5)
                norm.bias.copy_(bias)
        for norm, outputs in _inputs(network, [norm for _, norm in layers if norm], crops).items():
            variance, mean = torch.var_mean(outputs, (0, 2, 3))
            norm.running_mean.copy_(mean)
            norm.running_var.copy_(variance)
            norm.weight.copy_((variance + norm.eps).sqrt())
            norm.bias.add_(mean)
    return network.state_dict()


def _weights(onnx_file: Path) -> list[tuple[Tensor, Tensor]]:
    """(weight, bias) of every convolution and every dense layer, in the order in which they are used."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load(onnx_file).graph
    values = {entry.name: torch.from_numpy(numpy_helper.to_array(entry).copy()) for entry in graph.initializer}
    nodes = [node for node in graph.node if node.op_type in ("Conv", "Gemm")]
    if not all(node.input[1] in values for node in nodes):
        raise ValueError(f"{onnx_file}: stored in 8 bits; training goes on from the networks in training/weights")
    return [(values[node.input[1]], values[node.input[2]]) for node in nodes]


def _by_use(network: nn.Module, image: Tensor) -> dict[Layer, nn.BatchNorm2d | None]:
    """Every convolution and dense layer, in the order in which they are used, and the normalisation that follows it."""
    used: list[nn.Module] = []
    modules = [m for m in network.modules() if isinstance(m, Layer | nn.BatchNorm2d)]
    hooks = [m.register_forward_hook(lambda module, *_: used.append(module)) for m in modules]
    with torch.no_grad():
        network(image)
    for hook in hooks:
        hook.remove()
    following = [*used[1:], None]
    return {
        module: after if isinstance(after, nn.BatchNorm2d) else None
        for module, after in zip(used, following, strict=True)
        if isinstance(module, Layer)
    }


def _inputs(network: nn.Module, modules: list[nn.Module], crops: Tensor) -> dict[nn.Module, Tensor]:
    """The input of each of `modules` when the network processes `crops`."""
    given: dict[nn.Module, Tensor] = {}
    hooks = [m.register_forward_pre_hook(lambda module, inputs: given.update({module: inputs[0]})) for m in modules]
    network(crops)
    for hook in hooks:
        hook.remove()
    return given
