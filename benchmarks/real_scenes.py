"""Each projection and each estimator on real scenes of known scale: ``python benchmarks/real_scenes.py [BOXES]``.

The scenes are read from ``../shared/data`` or ``ORTHOSCALE_DATA``. With the folder BOXES, the detector runs once and
its boxes are kept there for later runs.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import orthoscale
from orthoscale.requests import ESTIMATORS, PROJECTIONS

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # for simulated boxes of known truth, as in the tests

from support.simulate import table  # noqa: E402

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared" / "data")
SCENES = {  # with the fleet of their country
    "reconstructions/sheffield": "US",
    "reconstructions/brighton": "US",
    "orthophotos/manila.tif": "PH",
    "orthophotos/banepa.jpg": "NP",
}


def truth(scene: str) -> float:
    """True metres per pixel, or per model unit."""
    path = DATA / scene
    known = json.loads((path / "truth.json" if path.is_dir() else path.with_name("truth.json")).read_text())
    return float(known["metres_per_model_unit"] if path.is_dir() else known[path.name]["gsd_m"])


def row(scene: str, boxes: Path, fleet: str, **options: str) -> list[str]:
    """A row for one way of measuring one scene."""
    # GPS positions of frames are the truth of most reconstructions; the paper's estimator does not take them.
    without = {"gps": False} if (DATA / scene).is_dir() and options.get("estimator") != "iqr" else {}
    result = orthoscale.estimate(DATA / scene, fleet=fleet, detections=boxes, **without, **options)
    low, high = (end / truth(scene) - 1 for end in result.scale.interval90)
    return [
        Path(scene).stem,
        fleet,
        result.projection,
        options.get("estimator", "robust"),
        f"{100 * (result.scale.value / truth(scene) - 1):+.1f}",
        f"{100 * low:+.1f} to {100 * high:+.1f}",
        "yes" if low <= 0 <= high else "no",
        f"{result.scale.vehicles_used}",
    ]


def main(folder: Path) -> None:
    rows = []
    for scene, country in SCENES.items():
        boxes = folder / f"{Path(scene).name}.det.json"
        if not boxes.exists():
            orthoscale.save_detections(orthoscale.estimate(DATA / scene, fleet=country).detections, boxes)
        ways = [None] if (DATA / scene).is_file() else list(PROJECTIONS)
        rows += [
            row(scene, boxes, country, estimator=estimator, **({"projection": way} if way else {}))
            for way in ways
            for estimator in ESTIMATORS
        ]
        rows.append(row(scene, boxes, "world"))
        rows.append(row(scene, boxes, "PAPER", estimator="iqr", **({"projection": "program"} if ways[0] else {})))
    head = ["scene", "fleet", "projection", "estimator", "error [%]", "90 % [%]", "holds the truth", "vehicles"]
    print(table(head, rows))
    errors = np.array([float(r[4]) for r in rows if r[2] in ("exact", "planar") and r[3] == "robust"])
    print(f"\nRMS error of exact and planar with the robust estimator, all fleets: {np.sqrt((errors**2).mean()):.1f} %")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as scratch:
            main(Path(scratch))
