"""Write the trained measurer as ONNX, its answers averaged over the crop's mirrors.

    python -m training.measurer.export --run runs/m1 --out measurer.onnx

Input ``crops`` float32 (n, 3, 48, 96), RGB 0..255; outputs ``edges`` and ``sigma`` (n, 4) [crop px], ``turn`` (n,)
[rad], ``seen`` (n, 4) and ``kind`` (n, 5) as shares. `orthoscale.detect.measurer` reads it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from orthoscale.detect.measurer import CROP_HEIGHT, CROP_WIDTH

from .network import MeasureNet, Mirrored

OUTPUTS = ("edges", "sigma", "turn", "seen", "kind")


def write(network: MeasureNet, out: Path) -> Path:
    """Write the network with its mirrors to `out`; returns it."""
    torch.onnx.export(
        Mirrored(network).eval(), (torch.zeros(2, 3, CROP_HEIGHT, CROP_WIDTH),), str(out), input_names=["crops"],
        output_names=list(OUTPUTS), dynamic_axes={name: {0: "n"} for name in ("crops", *OUTPUTS)}, opset_version=17,
        dynamo=False,
    )  # fmt: skip
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True, help="folder of training.measurer.train")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()

    network = MeasureNet()
    network.load_state_dict(torch.load(options.run / "checkpoint.pt", map_location="cpu")["average"])
    write(network, options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
