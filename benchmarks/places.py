"""The whole program on every real scene of known scale, with three fleets.

    python benchmarks/places.py [BOXES [MEASURER]]

The scenes are read from ``../shared/data`` or ``ORTHOSCALE_DATA``. With the folder BOXES, detector and measurer run
once on each and the boxes are kept there. MEASURER is that of ``--measurer``, none for boxes of the detector alone.
``places/``, `boruszyn` and `weedon` had no part in anything that was fitted or chosen up to detector version 5; the
other four had (README). Coverage comes with its own 90 % interval (Clopper and Pearson 1934).
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import beta

import orthoscale
from orthoscale.errors import EvidenceDisagrees, OrthoscaleError

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.simulate import table  # noqa: E402

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared" / "data")
CHOSEN_WITH = ("manila", "banepa", "sheffield", "brighton")  # scenes that choices of version 5 were made with in view
FLEETS = ("own", "world", "auto")


@dataclass(frozen=True)
class Scene:
    """path : of a picture or a model. country : ISO code. truth : metres per pixel or model unit."""

    path: Path
    country: str
    truth: float

    @property
    def name(self) -> str:
        return self.path.stem


def scenes() -> list[Scene]:
    """All that there are, those that nothing was chosen with first."""
    found = []
    for folder in ("places", "orthophotos"):
        known = json.loads((DATA / folder / "truth.json").read_text())
        found += [Scene(DATA / folder / file, k["country"], k["gsd_m"]) for file, k in known.items() if "gsd_m" in k]
    for path in sorted((DATA / "reconstructions").iterdir()):
        known = json.loads((path / "truth.json").read_text())
        found.append(Scene(path, known["country"], known["metres_per_model_unit"]))
    return sorted(found, key=lambda scene: (scene.name in CHOSEN_WITH, scene.name))


def measured(scene: Scene, fleet: str, boxes: Path) -> tuple[float, float, float] | str:
    """Relative error of the scale and of both ends of its 90 % interval; or why there is none."""
    try:
        result = orthoscale.estimate(scene.path, fleet=fleet, detections=boxes)
        result.require_useful()
    except OrthoscaleError as error:
        return "contradiction" if isinstance(error, EvidenceDisagrees) else "too little"
    return tuple(float(v / scene.truth - 1) for v in (result.scale.value, *result.scale.interval90))


def main(folder: Path, measurer: str | None = None) -> None:
    rows, errors = [], {}
    for scene in scenes():
        boxes = folder / f"{scene.name}.det.json"
        if not boxes.exists():
            found = orthoscale.estimate(scene.path, fleet=scene.country, measurer=measurer).detections
            orthoscale.save_detections(found, boxes)
        row = [scene.name, scene.country]
        for fleet in FLEETS:
            got = measured(scene, scene.country if fleet == "own" else fleet, boxes)
            if isinstance(got, str):
                row.append(got)
                continue
            error, low, high = got
            errors.setdefault((fleet, scene.name in CHOSEN_WITH), []).append((error, low <= 0 <= high))
            row.append(
                f"{100 * error:+.1f} ({100 * low:+.0f} to {100 * high:+.0f}){'' if low <= 0 <= high else ' **out**'}"
            )
        rows.append(row)
    print(table(("scene", "country", *(f"fleet {f}: error (90 % interval) [%]" for f in FLEETS)), rows))
    summary = []
    for (fleet, chosen), all_errors in sorted(errors.items(), key=lambda item: (item[0][1], FLEETS.index(item[0][0]))):
        error, inside = (np.array(column) for column in zip(*all_errors, strict=True))
        n, k = len(error), int(inside.sum())
        low = beta.ppf(0.05, k, n - k + 1) if k else 0.0
        high = beta.ppf(0.95, k + 1, n - k) if k < n else 1.0
        summary.append(
            [
                "with them in view" if chosen else "nothing chosen with them",
                fleet,
                f"{n}",
                f"{100 * error.mean():+.1f}",
                f"{100 * np.median(np.abs(error)):.1f}",
                f"{100 * np.abs(error).max():.1f}",
                f"{k} of {n} ({100 * low:.0f} to {100 * high:.0f} %)",
            ]
        )
    columns = ("scenes", "fleet", "n", "mean error [%]", "median of sizes [%]", "worst [%]", "interval holds (90 %)")
    print("\n" + table(columns, summary))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]), *sys.argv[2:])
    else:
        with tempfile.TemporaryDirectory() as scratch:
            main(Path(scratch))
