"""Write the trained measurer as ONNX, with its results averaged over the crop's mirrors.

    python -m training.measurer.export --run runs/m21 --card training/measurer/card_m21.json --out measurer.onnx
    python -m training.measurer.export --network measurer.onnx --card CARD.json --out measurer.onnx  # another card

Input ``crops`` float32 (n, 3, 48, 96), RGB 0..255; outputs ``edges`` and ``sigma`` (n, 4) [crop px], ``turn`` (n,)
[rad], ``seen`` (n, 4) and ``kind`` (n, 5) as shares. `orthoscale.detect.measurer` reads it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import torch

from orthoscale.detect.measurer import CROP_HEIGHT, CROP_WIDTH, OUTPUTS, MeasurerCard
from training.export import with_card

from .network import MeasureNet, Mirrored


def write(network: MeasureNet, out: Path) -> Path:
    """Write the network with its mirrors to `out`, without a card; returns it."""
    torch.onnx.export(
        Mirrored(network).eval(), (torch.zeros(2, 3, CROP_HEIGHT, CROP_WIDTH),), str(out), input_names=["crops"],
        output_names=list(OUTPUTS), dynamic_axes={name: {0: "n"} for name in ("crops", *OUTPUTS)}, opset_version=17,
        dynamo=False,
    )  # fmt: skip
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    of = parser.add_mutually_exclusive_group(required=True)
    of.add_argument("--run", type=Path, help="folder of training.measurer.train")
    of.add_argument("--network", type=Path, help="an exported one, whose card alone is replaced")
    parser.add_argument("--card", type=Path, required=True, help="JSON file: the fields of `MeasurerCard`")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()

    card = options.card.read_text()
    MeasurerCard.from_json(card, str(options.card))
    exported = options.network
    if exported is None:
        network = MeasureNet()
        network.load_state_dict(torch.load(options.run / "checkpoint.pt", map_location="cpu")["average"])
        exported = write(network, options.out)
    with_card(exported, json.loads(card), options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
