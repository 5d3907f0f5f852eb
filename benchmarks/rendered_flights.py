"""How accurate is `estimate` on reconstructions whose frames are rendered, and do its 90 % intervals hold?

    python benchmarks/rendered_flights.py --keep FOLDER                # 32 flights: 20 minutes
    python benchmarks/rendered_flights.py --keep FOLDER --flights 8

The whole program on frames with exact truth: detector, measurer, projection in both modes, and pooling, with the
country named and without anchors. (`flights.py` has many more flights, but a perfect detector.) Pitch, altitude,
camera, slope of the ground, style of the scene, vehicles and light are drawn for each flight; the vehicles are those of
one place of the country, which strays from the country's fleet as places do. Beside the error is what remains of it
without that stray: the mean size of the vehicles that stand in the scene, against the fleet's.

Prints Markdown, seeded. ``--keep FOLDER`` has the models, and a line of JSON for each; those in it are not measured
again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import orthoscale
from orthoscale.core.fleet import Fleet
from orthoscale.errors import EvidenceDisagrees, TooLittleEvidence
from orthoscale.fleets import load_fleet
from orthoscale.synthetic import make_scene, write_colmap

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.simulate import place_of, table  # noqa: E402

FLEETS = ("US", "DE", "JP", "BR", "PL", "PH")
STYLES = ("carpark", "suburb", "city", "industrial")
STEEP = 78.0  # [degrees] from here on a flight looks straight down


@dataclass(frozen=True)
class Flight:
    """What is drawn for one flight. pitch, slope : [degrees]; altitude [m]; focal [px]; unit : metres per unit."""

    fleet: str
    style: str
    pitch: float
    altitude: float
    focal: float
    size: tuple[int, int]
    k1: float
    slope: float
    frames: int
    vehicles: int
    points: int
    unit: float

    @classmethod
    def drawn(cls, number: int) -> Flight:
        rng = np.random.default_rng([52, number])
        size = ((1000, 750), (1600, 1200), (1920, 1080))[rng.integers(3)]
        return cls(
            FLEETS[number % len(FLEETS)],
            STYLES[rng.integers(len(STYLES))],
            90.0 if number % 3 == 0 else float(rng.uniform(40, 88)),
            float(rng.uniform(35, 110)),
            float(size[0] * rng.uniform(0.7, 1.2)),
            size,
            float(rng.choice([0.0, -0.03, 0.02])),
            float(rng.choice([0.0, 0.0, 4.0, 8.0])),
            int(rng.integers(9, 21)),
            int(rng.integers(20, 70)),
            int(rng.choice([300, 1500, 4000])),
            float(np.exp(rng.uniform(np.log(0.1), np.log(20)))),
        )


def rendered(number: int, flight: Flight, folder: Path) -> dict[str, Any]:
    """The truth of the flight in `folder`, rendered if it is not there."""
    if not (folder / "truth.json").exists():
        place = place_of(np.random.default_rng([53, number]), load_fleet(flight.fleet))
        scene = make_scene(5200 + number, place, 110.0, flight.vehicles, flight.style)
        write_colmap(
            scene, folder, flight.unit, flight.frames, flight.pitch, flight.altitude, flight.focal, *flight.size,
            5200 + number, k1=flight.k1, slope_deg=flight.slope, n_points=flight.points,
        )  # fmt: skip
    return json.loads((folder / "truth.json").read_text())


def stray(truth: dict[str, Any], fleet: Fleet) -> float:
    """Mean logarithm of the size of the vehicles that stand in the scene, against the fleet's."""
    here = np.log([[v["length_m"], v["width_m"]] for v in truth["vehicles"]]).mean()
    return float(here - np.log(fleet.sample(np.random.default_rng(1), 20_000)[:, :2]).mean())


def measured(folder: Path, flight: Flight, truth: dict[str, Any]) -> dict[str, Any]:
    """Logarithmic error of the scale, its interval's ends, and the errors of both modes; or why there is no scale."""
    fleet, unit = load_fleet(flight.fleet), truth["metres_per_model_unit"]
    outcome: dict[str, Any] = {"stray": stray(truth, fleet)}
    try:
        result = orthoscale.estimate(folder, fleet=flight.fleet, anchors=["none"], gps=False)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        return outcome | {"refused": error.message.splitlines()[0]}
    low, high = np.log(np.array(result.scale.interval90) / unit)
    return outcome | {
        "error": float(np.log(result.scale.value / unit)),
        "low": float(low),
        "high": float(high),
        "vehicles": result.scale.vehicles_used,
        "verdict": result.scale.verdict,
        "modes": {name: float(np.log(m.scale.value / unit)) for name, m in result.measured.modes.items()},
    }


def row(name: str, some: list[dict[str, Any]]) -> list[str]:
    """One row of the table."""
    error = 100 * np.array([o["error"] for o in some])
    without = error + 100 * np.array([o["stray"] for o in some])
    held = np.mean([o["low"] <= 0 <= o["high"] for o in some])
    half = 50 * np.mean([o["high"] - o["low"] for o in some])
    modes = (
        [100 * (o["modes"][mode] + o["stray"]) for o in some if mode in o["modes"]] for mode in ("oblique", "planar")
    )
    ends = [mean_and_rms(each) for each in (error, without, *modes)]
    return [name, str(len(some)), *ends[:2], f"{half:.1f}", f"{100 * held:.0f} %", *ends[2:]]


def mean_and_rms(error: Sequence[float] | np.ndarray) -> str:
    return f"{np.mean(error):+.1f}, {np.sqrt(np.mean(np.square(error))):.1f}" if len(error) else ""


def main(first: int, count: int, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rows_file = folder / "rows.jsonl"
    kept = dict(json.loads(line) for line in rows_file.read_text().splitlines()) if rows_file.exists() else {}
    done = []
    for number in range(first, first + count):
        flight, model = Flight.drawn(number), folder / f"flight_{number:02d}"
        if number not in kept:
            kept[number] = measured(model, flight, rendered(number, flight, model))
            with rows_file.open("a") as file:
                file.write(json.dumps([number, kept[number]]) + "\n")
        outcome = kept[number]
        print(number, flight, outcome, file=sys.stderr, flush=True)
        if "error" in outcome:
            done.append((flight, outcome))
    groups = {
        "straight down": [o for f, o in done if f.pitch >= STEEP],
        "oblique": [o for f, o in done if f.pitch < STEEP],
        "sloping ground": [o for f, o in done if f.slope],
        "all": [o for _, o in done],
    }
    head = ["", "flights", "error: mean, RMS", "without the place's stray", "half interval", "holds"]
    print(table([*head, "oblique", "planar"], [row(name, some) for name, some in groups.items() if some]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=32)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        main(options.first, options.flights, options.keep or Path(scratch))
