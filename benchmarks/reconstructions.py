"""Real reconstructions, each method on the same boxes: ``python benchmarks/reconstructions.py [DATA] [BOXES]``.

DATA is the folder of the real data (see CONTRIBUTING.md). BOXES is a folder with files ``SCENE.json`` from ``orthoscale
estimate --save-detections``; without it the detector runs. Prints Markdown.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from orthoscale.actions.estimate import estimate
from orthoscale.core.pooling.paper import pool_iqr
from orthoscale.core.projection.decoupled import NAIVE, PRIORS, PROGRAM, TEXT, paper_scale
from orthoscale.core.projection.view import Views
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import load_fleet
from orthoscale.report.result import Result

SCENES = {"sheffield": "US", "brighton": "US"}
# Outer corners of the northern tennis court in one frame, picked by hand [px], and its size [m].
COURT = ("DJI_0074.jpg", [(418.0, 377.6), (598.0, 387.8), (601.3, 475.3), (413.8, 463.6)], (23.77, 10.97))


def by_the_paper(result: Result, source) -> dict[str, float]:
    """Metres per unit by each variant of the decoupled model with the paper's pooling, and the priors of paper or
    fleet."""
    names, boxes = result.picture, result.boxes
    order = np.argsort(names, kind="stable")
    views = Views.concatenate([source.views(n, boxes[names == n].centre)[0] for n in np.unique(names)])
    boxes = boxes[order]
    priors = {"paper's priors": PRIORS, "fleet's priors": tuple(map(float, result.fleet.mean))}
    out = {}
    for which, prior in priors.items():
        for name, variant in {"text": TEXT, "program": PROGRAM, "naive": NAIVE}.items():
            try:
                out[f"{name}, {which}"] = pool_iqr(paper_scale(boxes, views, prior, variant), boxes.score).value
            except TooLittleEvidence:
                out[f"{name}, {which}"] = np.nan
    return out


def court(source, scale: float) -> str:
    """The size of the tennis court, measured on the model's ground."""
    name, corners, size = COURT
    place = source.views(name, np.array(corners))[1] * scale
    sides = np.linalg.norm(place - np.roll(place, -1, 0), axis=1)
    length, width = sides[::2].mean(), sides[1::2].mean()
    return f"{length:.2f} x {width:.2f} m ({100 * (length / size[0] - 1):+.1f} %, {100 * (width / size[1] - 1):+.1f} %)"


def main() -> None:
    data = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[2] / "shared" / "data")
    boxes = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    for scene, fleet in SCENES.items():
        folder = data / "reconstructions" / scene
        truth = json.loads((folder / "truth.json").read_text())["metres_per_model_unit"]
        result = estimate(folder, fleet=load_fleet(fleet).code, detections=boxes and boxes / f"{scene}.json", gps=False)
        source, measured = result.source, result.measured
        print(f"\n`{scene}`, truth {truth} m per unit, {len(result.boxes)} boxes in frames\n")
        print("| method | m per unit | error | 90 % interval |\n|---|---|---|---|")
        rows = {"pooled": (result.scale.value, result.scale.interval90)}
        rows |= {name: (m.scale.value, m.scale.interval90) for name, m in measured.modes.items()}
        for name, (value, (low, high)) in rows.items():
            print(f"| {name} | {value:.4g} | {100 * (value / truth - 1):+.1f} % | {low:.4g} to {high:.4g} |")
        for name, value in by_the_paper(result, source).items():
            print(f"| decoupled, {name} | {value:.4g} | {100 * (value / truth - 1):+.1f} % | |")
        if measured.agreement is not None:
            print(f"\n{measured.agreement.sentence()}")
        changes = measured.findings.calibration.trends
        for when, slopes in (changes or {}).items():
            said = ", ".join(f"{v:+.1f} +- {sd:.1f} {name.replace('_', ' ')}" for name, (v, sd) in slopes.items())
            print(f"\nTrend {when} calibration: {said}")
        if scene == "sheffield":
            print(f"\nTennis court (23.77 x 10.97 m) in the scaled model: {court(source, result.scale.value)}")
            print(f"\nThe same at the true scale: {court(source, truth)}")


if __name__ == "__main__":
    main()
