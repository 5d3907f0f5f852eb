"""Initialise a network of other widths from one that is already trained.

    python -m training.reshape --start runs/before/checkpoint.pt --out runs/reshaped/start.pt
    python -m training.train ... --start runs/reshaped/start.pt

If `VehicleNet` has fewer channels inside a residual block or the head than the checkpoint, the channels with the
largest weights, in and out, stay (filter pruning, Li et al. 2017, Pruning Filters for Efficient ConvNets): the network
still does about the same, and a short training recovers the loss. If it has more channels anywhere, the new ones start
with random weights and the weights that read them with zero: the network does exactly the same, and training makes use
of them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

from .network import VehicleNet

Tensors = dict[str, Tensor]


def reshaped(given: Tensors, fresh: Tensors) -> Tensors:
    """`given` with the sizes of `fresh`, the state of an untrained network; tensors by name. Raises ValueError if a
    size is reduced anywhere but between a block's two convolutions, or between the head's and the maps'."""
    if given.keys() != fresh.keys():
        raise ValueError(f"other layers: {', '.join(sorted(given.keys() ^ fresh.keys())[:5])}")
    cut = dict(given)
    for name in given:
        if not name.endswith(("first.0.weight", "head.0.weight")):
            continue
        conv, after = name.removesuffix(".0.weight"), _reader(name)
        count = len(fresh[name])
        if count < len(given[name]):
            keep = _strongest(given, conv, after, count)
            for part in ("0.weight", "1.weight", "1.bias", "1.running_mean", "1.running_var"):
                cut[f"{conv}.{part}"] = given[f"{conv}.{part}"][keep]
            cut[after] = given[after][:, keep]
    if other := [name for name in fresh if any(a > b for a, b in zip(cut[name].shape, fresh[name].shape, strict=True))]:
        raise ValueError(f"sizes that cannot be cut: {', '.join(other[:5])}")
    return {name: _grown(tensor, fresh[name]) for name, tensor in cut.items()}


def _reader(name: str) -> str:
    """Name of the weights that read the output of the convolution `name`."""
    return "maps.weight" if name.startswith("head") else name.replace("first", "second")


def _strongest(given: Tensors, conv: str, after: str, count: int) -> Tensor:
    """Indices, in order, of the `count` channels with the largest product of summed input weights (normalised) and
    summed output weights."""
    gain = given[f"{conv}.1.weight"].abs() / (given[f"{conv}.1.running_var"] + 1e-5).sqrt()
    into = given[f"{conv}.0.weight"].abs().sum((1, 2, 3)) * gain
    out = given[after].abs().sum((0, 2, 3))
    return (into * out).topk(count).indices.sort().values


def _grown(tensor: Tensor, fresh: Tensor) -> Tensor:
    """`fresh` with `tensor` in its corner, zero where old outputs would read new inputs."""
    if tensor.shape == fresh.shape:
        return tensor
    grown = fresh.clone()
    corner = tuple(slice(n) for n in tensor.shape)
    grown[corner[:1]] = 0
    grown[corner] = tensor
    return grown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--start", type=Path, required=True, metavar="CHECKPOINT", help="of the trained network")
    parser.add_argument("--out", type=Path, required=True, metavar="CHECKPOINT", help="to begin the other one with")
    parser.add_argument("--seed", type=int, default=0, help="of the new channels (%(default)s)")
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    average = reshaped(torch.load(options.start, map_location="cpu")["average"], VehicleNet().state_dict())
    options.out.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"average": average}, options.out)
    print(f"{options.out}: {sum(t.numel() for t in average.values()):,} numbers")


if __name__ == "__main__":
    main()
