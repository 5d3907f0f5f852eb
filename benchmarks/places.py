"""The whole program on every real scene of known scale, with two fleets.

    python benchmarks/places.py [BOXES] [--detector NETWORK.onnx] [--measurer MEASURER] [--scenes NAMES]
                                [--quarters | --sixteenths | --chips]

The scenes are read from ``../shared/data`` or ``ORTHOSCALE_DATA``. With the folder BOXES, detector and measurer run
once on each and the boxes are kept there. MEASURER is as for ``orthoscale --measurer``, `none` for the detector's boxes
alone. ``places/``, `boruszyn` and `weedon` had no part in anything that was fitted or chosen up to detector version 5;
the other four had (README). ``--quarters``, ``--sixteenths``: each orthophoto in four or 16 parts, small places of the
same ground.
``--chips``: American places made of the chips, twelve of one kind each; the finder was trained on them. Coverage comes
with its own 90 % interval (Clopper and Pearson 1934).

The last table is for the detector's card: how far the box bias of a place differs from the ruler's, which no number of
boxes of that place can show. It is the scatter of the errors with the country's own fleet beyond sampling, fleet and
geometry, by maximum likelihood, with each place left out in turn. `common_sd` of the card should equal it (it includes
`bias_sd`); the mean says how far the margin is off.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import minimize
from scipy.stats import beta

import orthoscale
from orthoscale.core.normal import Z90
from orthoscale.errors import EvidenceDisagrees, OrthoscaleError, TooLittleEvidence

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.simulate import table  # noqa: E402

DATA = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared" / "data")
CHOSEN_WITH = ("manila", "banepa", "sheffield", "brighton")  # scenes with which choices of version 5 were made
FLEETS = ("own", "world")
# Chips that show vehicles; 256 px at one foot per pixel, a few are a pixel or two smaller.
CHIPS = ("parkinglot", "denseresidential", "freeway", "intersection", "overpass", "mobilehomepark", "buildings")
CHIP, CHIP_GSD = 256, 0.3048
ACROSS, DOWN = 4, 3  # chips of a montage
FEWEST = 3  # places needed for the card's margin with each left out in turn


@dataclass(frozen=True)
class Scene:
    """path : of a picture or a model. country : ISO code. truth : metres per pixel, or per model unit."""

    path: Path
    country: str
    truth: float

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def options(self) -> dict[str, bool]:
        """Options of `estimate`: without the frames' GPS positions, which are the truth of most reconstructions."""
        return {"gps": False} if self.path.is_dir() else {}


def scenes() -> list[Scene]:
    """All scenes, those with which nothing was chosen first."""
    found = []
    for folder in ("places", "orthophotos"):
        known = json.loads((DATA / folder / "truth.json").read_text())
        found += [Scene(DATA / folder / file, k["country"], k["gsd_m"]) for file, k in known.items() if "gsd_m" in k]
    for path in sorted((DATA / "reconstructions").iterdir()):
        known = json.loads((path / "truth.json").read_text())
        found.append(Scene(path, known["country"], known["metres_per_model_unit"]))
    return sorted(found, key=lambda scene: (scene.name in CHOSEN_WITH, scene.name))


def called(every: list[Scene], names: str) -> list[Scene]:
    """The scenes with the comma-separated `names`, all without names. Ends the program if there is no scene of a
    name."""
    asked = set(filter(None, names.split(",")))
    if unknown := asked - {scene.name for scene in every}:
        sys.exit(f"no such scene: {', '.join(sorted(unknown))}; there are {', '.join(scene.name for scene in every)}")
    return [scene for scene in every if not asked or scene.name in asked]


def parts_of(some: list[Scene], folder: Path, across: int) -> list[Scene]:
    """Each orthophoto in `across` x `across` parts, as files in `folder`, without georeferencing."""
    parts = []
    for scene in some:
        if scene.path.is_dir():
            continue
        pixels = cv2.imread(str(scene.path))
        height, width = pixels.shape[0] // across, pixels.shape[1] // across
        for k in range(across**2):
            path = folder / f"{scene.name}_{k}.png"
            y, x = k // across * height, k % across * width
            cv2.imwrite(str(path), pixels[y : y + height, x : x + width])
            parts.append(replace(scene, path=path))
    return parts


def of_chips(folder: Path) -> list[Scene]:
    """Montages of twelve chips of one kind each, in the order of their numbers, as files in `folder`."""
    places = []
    for kind in CHIPS:
        files = sorted((DATA / "vehicles" / "chips").glob(f"{kind}[0-9]*"))
        for first in range(0, len(files) - ACROSS * DOWN + 1, ACROSS * DOWN):
            chips = [cv2.resize(cv2.imread(str(file)), (CHIP, CHIP)) for file in files[first : first + ACROSS * DOWN]]
            rows = [np.hstack(chips[k : k + ACROSS]) for k in range(0, len(chips), ACROSS)]
            path = folder / f"{kind}_{first:03d}.png"
            cv2.imwrite(str(path), np.vstack(rows))
            places.append(Scene(path, "US", CHIP_GSD))
    return places


def unanswered(error: OrthoscaleError) -> str:
    """Why there is no scale, in the table's words."""
    return "contradiction" if isinstance(error, EvidenceDisagrees) else "too little"


def measured(scene: Scene, fleet: str, boxes: Path) -> tuple[float, float, float, float] | str:
    """Relative error of the scale and of both ends of its 90 % interval, and its one sigma without the margin's part;
    or why there is no scale."""
    try:
        result = orthoscale.estimate(scene.path, fleet=fleet, detections=boxes, **scene.options)
        result.require_useful()
    except (EvidenceDisagrees, TooLittleEvidence) as error:
        return unanswered(error)
    scale = result.scale
    rest = np.sqrt(sum(v**2 for name, v in scale.parts.items() if name != "margin"))
    return (*(float(v / scene.truth - 1) for v in (scale.value, *scale.interval90)), float(rest))


def of_places(error: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation over places of the box bias, from errors (N,) [log] with one sigma (N,) of other
    causes."""

    def cost(unknown: np.ndarray) -> float:
        variance = sd**2 + unknown[1] ** 2
        return float((np.log(variance) + (error - unknown[0]) ** 2 / variance).sum())

    best = minimize(cost, [error.mean(), error.std()], method="Nelder-Mead").x
    return float(best[0]), float(abs(best[1]))


def margins(own: dict[str, tuple[float, float]]) -> str:
    """The figures of the margin for a card, with each of the places `own` (log error, sigma without margin) left
    out."""
    error, sd = map(np.array, zip(*own.values(), strict=True))
    rows, hits = [], 0
    for k, name in enumerate(own):
        mean, between = of_places(np.delete(error, k), np.delete(sd, k))
        inside = abs(error[k]) <= Z90 * np.hypot(sd[k], np.hypot(between, mean))
        hits += inside
        rows.append(
            [name, *(f"{100 * v:+.1f}" for v in (error[k], mean)), f"{100 * between:.1f}", "yes" if inside else "no"]
        )
    mean, between = of_places(error, sd)
    rows.append(["all", "", f"{100 * mean:+.1f}", f"{100 * between:.1f}", f"{hits} of {len(own)}"])
    return table(("left out", "error [%]", "mean of the others [%]", "between places [%]", "would hold (90 %)"), rows)


def main(some: list[Scene], folder: Path, **networks: str | Path | None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rows, errors, own = [], {}, {}
    for scene in some:
        boxes = folder / f"{scene.name}.det.json"
        if not boxes.exists():
            try:
                found = orthoscale.estimate(scene.path, fleet=scene.country, **scene.options, **networks).detections
            except (EvidenceDisagrees, TooLittleEvidence) as error:
                rows.append([scene.name, scene.country, *[unanswered(error)] * len(FLEETS)])
                continue
            orthoscale.save_detections(found, boxes)
        row = [scene.name, scene.country]
        for fleet in FLEETS:
            got = measured(scene, scene.country if fleet == "own" else fleet, boxes)
            if isinstance(got, str):
                row.append(got)
                continue
            error, low, high, rest = got
            if fleet == "own":
                own[scene.name] = float(np.log1p(error)), rest
            errors.setdefault((fleet, scene.name.startswith(CHOSEN_WITH)), []).append((error, low <= 0 <= high))
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
    if len(own) >= FEWEST:
        print("\n" + margins(own))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("boxes", type=Path, nargs="?", help="folder in which boxes are kept")
    parser.add_argument("--detector", type=Path)
    parser.add_argument("--measurer")
    parser.add_argument("--scenes", default="", help="comma separated; all by default")
    which = parser.add_mutually_exclusive_group()
    for name, across in {"quarters": 2, "sixteenths": 4}.items():
        help_text = "of the orthophotos, each by itself"
        which.add_argument(f"--{name}", dest="across", action="store_const", const=across, help=help_text)
    which.add_argument("--chips", action="store_true", help="American places made of the chips")
    options = parser.parse_args()
    networks = {"detector": options.detector, "measurer": options.measurer}
    with tempfile.TemporaryDirectory() as scratch:
        asked = called(of_chips(Path(scratch)) if options.chips else scenes(), options.scenes)
        if options.across:
            asked = parts_of(asked, Path(scratch), options.across)
        main(asked, options.boxes or Path(scratch), **networks)
