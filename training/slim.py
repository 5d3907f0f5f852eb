"""Begin a narrower network with the strongest channels of a wider one that is trained already.

    python -m training.slim --start runs/wide/checkpoint.pt --out runs/slim/start.pt
    python -m training.train ... --start runs/slim/start.pt

Filter pruning (Li et al. 2017, Pruning Filters for Efficient ConvNets): where `VehicleNet` has fewer channels inside a
residual block or the head than the checkpoint, those stay whose filters weigh most, in and out. What goes in and out of
a block keeps its width, so the network still does about what it did, and a short training makes good what was lost.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

from .network import VehicleNet

Tensors = dict[str, Tensor]


def slimmed(wide: Tensors, shape: Tensors) -> Tensors:
    """`wide` cut to the sizes of `shape`: tensors by name, as in a network's state. Raises ValueError where they differ
    in more than the channels between a block's two convolutions, or between the head's and the maps'."""
    if wide.keys() != shape.keys():
        raise ValueError(f"other layers: {', '.join(sorted(wide.keys() ^ shape.keys())[:5])}")
    slim = dict(wide)
    for name in wide:
        if not name.endswith(("first.0.weight", "head.0.weight")):
            continue
        conv, after = name.removesuffix(".0.weight"), _reader(name)
        count = len(shape[name])
        if count < len(wide[name]):
            keep = _strongest(wide, conv, after, count)
            for part in ("0.weight", "1.weight", "1.bias", "1.running_mean", "1.running_var"):
                slim[f"{conv}.{part}"] = wide[f"{conv}.{part}"][keep]
            slim[after] = wide[after][:, keep]
    if other := [name for name in shape if slim[name].shape != shape[name].shape]:
        raise ValueError(f"sizes that cannot be cut: {', '.join(other[:5])}")
    return slim


def _reader(name: str) -> str:
    """The weights that read what the convolution `name` writes."""
    return "maps.weight" if name.startswith("head") else name.replace("first", "second")


def _strongest(wide: Tensors, conv: str, after: str, count: int) -> Tensor:
    """The `count` channels, in order, with the largest sum of weights going in (as normalised) times going out."""
    gain = wide[f"{conv}.1.weight"].abs() / (wide[f"{conv}.1.running_var"] + 1e-5).sqrt()
    into = wide[f"{conv}.0.weight"].abs().sum((1, 2, 3)) * gain
    out = wide[after].abs().sum((0, 2, 3))
    return (into * out).topk(count).indices.sort().values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--start", type=Path, required=True, metavar="CHECKPOINT", help="of the wider network")
    parser.add_argument("--out", type=Path, required=True, metavar="CHECKPOINT", help="to begin the narrower one with")
    options = parser.parse_args()
    average = slimmed(torch.load(options.start, map_location="cpu")["average"], VehicleNet().state_dict())
    options.out.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"average": average}, options.out)
    print(f"{options.out}: {sum(t.numel() for t in average.values()):,} numbers")


if __name__ == "__main__":
    main()
