"""Write the trained network as ONNX, with the card that describes its boxes.

    python -m training.export --run runs/v1 --card training/card_v1.json --out small_vehicle.onnx

The card's fields are those of `orthoscale.detect.detector.Card`; `training.evaluate` measures them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import torch

from .network import NETWORKS


def add_card(onnx_file: Path, card: dict, out: Path) -> None:
    """`with_card` for a detector; checks that the card can be read."""
    from orthoscale.detect.detector import Card

    Card.from_json(json.dumps(card))
    with_card(onnx_file, card, out)


def with_card(onnx_file: Path, card: dict, out: Path) -> None:
    """Copy `onnx_file` to `out` with `card` as its metadata entry ``orthoscale``.

    The copy lists only the operator sets that it uses: onnxruntime's tools list all that they know, and its older
    versions refuse unknown ones.
    """
    import onnx

    model = onnx.load(onnx_file)
    used = {node.domain for node in model.graph.node}
    for unused in [opset for opset in model.opset_import if opset.domain not in used]:
        model.opset_import.remove(unused)
    del model.metadata_props[:]
    entry = model.metadata_props.add()
    entry.key, entry.value = "orthoscale", json.dumps(card)
    onnx.checker.check_model(model)
    onnx.save(model, out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True, help="folder of training.train")
    parser.add_argument("--card", type=Path, required=True, help="JSON file")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()

    state = torch.load(options.run / "checkpoint.pt", map_location="cpu")
    network = NETWORKS[state["kind"]]()
    network.load_state_dict(state["average"])
    network.eval()
    with tempfile.TemporaryDirectory() as scratch, torch.no_grad():
        plain = Path(scratch) / "network.onnx"
        # The older exporter (dynamo=False) needs no onnxscript and folds batch normalisation into the convolutions.
        torch.onnx.export(
            network, (torch.zeros(1, 3, 256, 256),), str(plain), input_names=["image"], output_names=["maps"],
            dynamic_axes={"image": {0: "n", 2: "h", 3: "w"}, "maps": {0: "n", 2: "h4", 3: "w4"}},
            opset_version=17, dynamo=False,
        )  # fmt: skip
        add_card(plain, json.loads(options.card.read_text()), options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
