"""Runs `orthoscale.fix` on the two examples of this folder, and prints the recovered scale, its interval, the truth
and the error.

Needs only the installed package; writes to build/demo/.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import orthoscale

HERE = Path(__file__).parent
OUT = HERE.parent / "build" / "demo"


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    jobs = [
        ("synthetic orthophoto", HERE / "town" / "ortho.jpg", OUT / "town.tif", {}),
        (
            "real reconstruction",
            HERE / "sheffield" / "sparse",
            OUT / "sheffield",
            {"detections": HERE / "sheffield" / "detections.json"},
        ),
    ]
    print(f"{'':22s}{'recovered':>12s}{'90 % interval':>22s}{'truth':>10s}{'error':>9s}  vehicles")
    missed = False
    for name, source, out, options in jobs:
        truth = json.loads((HERE / source.relative_to(HERE).parts[0] / "truth.json").read_text())
        true_scale = truth.get("gsd_m") or truth["metres_per_model_unit"]
        result = orthoscale.fix(source, out, fleet=truth["fleet"], overwrite=True, **options)
        scale = result.scale
        low, high = scale.interval90
        missed |= not low <= true_scale <= high
        error = 100 * (scale.value / true_scale - 1)
        print(
            f"{name:22s}{scale.value:12.5g}{f'{low:.5g} to {high:.5g}':>22s}{true_scale:10.5g}{error:+8.1f} %"
            f"  {scale.vehicles_used:5d}   [{scale.unit}]"
        )
    print(f"\nTo open in a browser: {OUT / 'town.tif.html'}, {OUT / 'sheffield' / 'report.html'}")
    if missed:
        sys.exit("an interval does not hold the truth")


if __name__ == "__main__":
    main()
