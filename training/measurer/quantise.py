"""Store the measurer in 8 bits, in which it runs more than twice as fast.

    python -m training.measurer.quantise training/weights/measurer.onnx --bank runs/bank \\
        --out orthoscale/detect/weights/measurer.onnx

As `training.quantise` does it, with crops of the training. What turns features into edges (`network.Profile`) and the
linear layers stay in 32 bits.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from training.quantise import finish, in_8_bits

from .crops import Examples

COUNT = 800  # crops that are shown
AT_ONCE = 16
PROFILES = ("/along/", "/across/")  # in the names of their convolutions


def quantise(network: Path, shown: Sequence[np.ndarray], out: Path) -> None:
    """Write the measurer `network` (ONNX) to `out` in 8 bits, with its card.

    shown : crops (CROP_HEIGHT, CROP_WIDTH, 3) uint8.
    """
    crops = np.stack(shown).transpose(0, 3, 1, 2).astype(np.float32)
    batches = [{"crops": crops[k : k + AT_ONCE]} for k in range(0, len(crops), AT_ONCE)]
    with tempfile.TemporaryDirectory() as scratch:
        stored = Path(scratch) / "stored.onnx"
        in_8_bits(network, batches, stored, lambda name: any(part in name for part in PROFILES))
        finish(network, stored, out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", type=Path, help="ONNX file with a measurer's card")
    parser.add_argument("--bank", type=Path, required=True, help="folder of training.measurer.rendered and real")
    parser.add_argument("--count", type=int, default=COUNT, help="crops that are shown (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()

    examples = islice(Examples(options.bank, options.seed), options.count)
    quantise(options.network, [example.pixels for example in examples], options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
