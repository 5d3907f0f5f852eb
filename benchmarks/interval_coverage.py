"""Do the 90 % intervals hold, and how accurate is the value?

    python benchmarks/interval_coverage.py                        # every table: hours; one with --scenes 100
    python benchmarks/interval_coverage.py country --scenes 3     # one of them: minutes

Simulated car parks in orthophotos; in each, the fleet's mean, its classes, the margin and the labels' bias are off by
as much as their stated uncertainties. Pooled by orthoscale and, on the same boxes, by the paper's IQR mean.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from orthoscale.core.fleet import WORLD, Fleet
from orthoscale.core.pooling.paper import pool_iqr
from orthoscale.core.pooling.proposed import proposed_class
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.detect.measurer import MeasurerCard
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import fleet_codes, load_fleet
from orthoscale.registrations import VERSIONS

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # for simulated boxes of known truth, as in the tests

from support.simulate import Vans, car_park, table  # noqa: E402

FLEETS = ("US", "DE", "JP", "IN", "BR", "CN", "PH")
SCENES = 500  # a cell
VEHICLES = 60
GSDS = (0.05, 0.12, 0.30)  # metres per pixel, taken in turn
RULER = Ruler(margin=(1.0, 1.5), margin_sd=(0.5, 0.5), bias_sd=(0.015, 0.02), noise=(1.5, 1.0))
NO_MARGIN = Ruler(margin=(0.0, 0.0), margin_sd=(0.0, 0.0), bias_sd=(0.015, 0.02), noise=(1.5, 1.0))
# A detector with the shrinkage that the shipped one has on rendered scenes (`training.shrink`).
DRAWING = replace(RULER, shrink=(0.4, 0.2), shrink_sd=(0.1, 0.1))
NO_VANS = Vans()
CARD = Path(__file__).parents[1] / "training" / "measurer" / "card_m21.json"
SHIPPED = MeasurerCard.from_json(CARD.read_text(), str(CARD)).ruler
# Boxes of the measurer as on its card: their noise is a share of the vehicle at every pixel size (3 % of length, 4.4 %
# of width: 1.1 and 0.66 px at 12 cm/px), and the margin is hardly uncertain. With its vehicle kinds.
MEASURED = replace(
    RULER, margin=SHIPPED.margin, margin_sd=SHIPPED.margin_sd, bias_sd=SHIPPED.bias_sd, noise=(1.1, 0.66),
    shrink_sd=(0.0, 0.0), kinds=SHIPPED.kinds, kinds_vehicles=SHIPPED.kinds_vehicles,
)  # fmt: skip
CONDITIONS = {  # vans among the vehicles (None: as many as places usually have), share of false boxes
    "vehicles only": (NO_VANS, 0.0),
    "vans": (None, 0.0),
    "10 % false boxes": (NO_VANS, 0.1),
    "both": (None, 0.1),
}
ONE_KIND = {
    "10 % of middle size": Vans(0.1, 0.0),
    "10 % large": Vans(0.1, 1.0),
    "25 % of middle size": Vans(0.25, 0.0),
    "25 % large": Vans(0.25, 1.0),
}
ODD = {  # places by what most of their vehicles are in any country: a class of the fleet, or vans beside it
    "as places are": (None, None),
    "80 % pickups": (("pickup", 0.8), NO_VANS),
    "no pickups": (("pickup", 0.0), NO_VANS),
    "80 % SUVs": (("SUV", 0.8), NO_VANS),
    "60 % minis": (("mini", 0.6), NO_VANS),
    "60 % vans": (None, Vans(0.6, 0.5)),
}
HIDDEN = (0.0, 0.1, 0.25)  # shares of the vehicles that stand partly under trees
LONGER = (-0.08, -0.04, 0.0, 0.04, 0.08)  # by how much a place's vehicles are longer than its country's, in the mean
STEEPEST = 8.0  # [1 / m] greatest steepness in `tilted`
ODD_FLEETS = ("US", "DE", "GB", "IT", "CN", "BR", "PH")
ODDEST = ("as places are", "60 % minis", "80 % pickups", "60 % vans")
COUNTS = (5, 10, 20, 50, 100, 300, 1000, 3000, 10_000)


@dataclass
class Tally:
    """The results of one set of scenes: errors as log(value / truth), claimed one sigmas, whether intervals hold."""

    error: np.ndarray
    sd: np.ndarray
    hit: np.ndarray
    paper_error: np.ndarray
    paper_hit: np.ndarray
    fair_error: np.ndarray  # the paper's, with the margin subtracted from the boxes
    refused: int

    def cell(self) -> str:
        return f"{100 * self.hit.mean():.0f} % ({100 * self.error.mean():+.1f}, {rms(self.error)}, {rms(self.sd)})"


def rms(values: np.ndarray) -> str:
    """Root mean square [%]."""
    return f"{100 * np.sqrt((values**2).mean()):.1f}"


def run(
    fleet: Fleet,
    scenes: int,
    n: int = VEHICLES,
    ruler: Ruler = RULER,
    gsds: tuple[float, ...] = GSDS,
    vans: Vans | None = NO_VANS,
    false: float = 0.0,
    most: tuple[str, float] | None = None,
    kinds: bool = True,
    hidden: float = 0.0,
    one: bool = False,
    longer: float = 0.0,
    told: Fleet | None = None,
) -> Tally:
    """`scenes` car parks of `n` boxes, at each of `gsds` [m/px] in turn; the same draws at every call.

    vans : None for as many as places usually have. most, hidden : as in `car_park`. kinds : whether kinds are seen, if
    the ruler has a table of them. one : the vehicles of each car park are of one model. longer : by how much they are
    longer than the fleet's, in the mean (`tilted`). told : the fleet that the pooling is given, if another.
    """
    rows, refused = [], 0
    for k in range(scenes):
        gsd = gsds[k % len(gsds)]
        rng = np.random.default_rng([0, k])
        here = of_one_model(np.random.default_rng([1, k]), fleet) if one else tilted(fleet, longer)
        votes = car_park(rng, here, n, gsd, ruler, vans or Vans.of_place(rng, fleet), false, most, hidden, exact=False)
        if not kinds:
            votes = replace(votes, kinds=np.nan)
        try:
            scale = pool(votes, told or fleet, ruler, "m/px")
        except TooLittleEvidence:
            refused += 1
            continue
        # The paper's estimator, with the fleet's mean size; its score threshold has a table of its own.
        paper, fair = (
            pool_iqr((fleet.mean[:2] / size).mean(1), np.ones(n))
            for size in (votes.size, np.maximum(votes.size - ruler.margin, 1.0))
        )
        low, high = scale.interval90
        paper_low, paper_high = paper.interval90
        rows.append(
            (
                np.log(scale.value / gsd),
                scale.relative_sd,
                low <= gsd <= high,
                np.log(paper.value / gsd),
                paper_low <= gsd <= paper_high,
                np.log(fair.value / gsd),
            )
        )
    error, sd, hit, paper_error, paper_hit, fair_error = np.array(rows, float).reshape(-1, 6).T
    return Tally(error, sd, hit, paper_error, paper_hit, fair_error, refused)


def of_one_model(rng: np.random.Generator, fleet: Fleet) -> Fleet:
    """The vehicles of a place where all are of one model, drawn from `fleet` [m]. Its versions differ as in
    `orthoscale.registrations`."""
    (size,), (k,) = fleet.sample_of_classes(rng, 1)
    model = replace(fleet.classes[k], weight=1.0, mean=size, sd=VERSIONS)
    return replace(fleet, classes=(model,), three_wheelers=None)


def tilted(fleet: Fleet, longer: float) -> Fleet:
    """The vehicles of a place where those of `fleet` are on average `longer` (a share of the mean): the shares of its
    classes change by a factor that is exponential in their lengths, which changes the mix as little as possible (by
    Kullback and Leibler's divergence). Raises ValueError if no mix of the classes has that mean."""
    if not longer:
        return fleet
    weight, length = np.array([(c.weight, c.mean[0]) for c in fleet.classes]).T
    mean = (1 + longer) * np.average(length, weights=weight)

    def shares(steepness: float) -> np.ndarray:
        return np.asarray(weight * np.exp(steepness * (length - mean)))

    steepness = brentq(lambda k: np.average(length, weights=shares(k)) - mean, -STEEPEST, STEEPEST)
    new = shares(float(steepness)) * weight.sum() / shares(float(steepness)).sum()
    classes = tuple(replace(c, weight=float(w)) for c, w in zip(fleet.classes, new, strict=True))
    return replace(fleet, classes=classes)


def by_fleet(ruler: Ruler, scenes: int) -> str:
    """Each fleet in each condition, all pixel sizes together."""
    rows = []
    for code in FLEETS:
        fleet = load_fleet(code)
        rows.append([code, *(run(fleet, scenes, ruler=ruler, vans=v, false=f).cell() for v, f in CONDITIONS.values())])
    return table(["fleet", *CONDITIONS], rows)


def by_gsd(name: str, scenes: int) -> str:
    """Each fleet at each pixel size, in one condition."""
    vans, false = CONDITIONS[name]
    rows = []
    for code in FLEETS:
        fleet = load_fleet(code)
        rows.append([code, *(run(fleet, scenes, gsds=(g,), vans=vans, false=false).cell() for g in GSDS)])
    return table(["fleet", *(f"{100 * g:.0f} cm/px" for g in GSDS)], rows)


def by_vans(scenes: int) -> str:
    """Each fleet with vans of one kind, the same share at every place."""
    rows = []
    for code in FLEETS:
        fleet = load_fleet(code)
        rows.append([code, *(run(fleet, scenes, vans=vans).cell() for vans in ONE_KIND.values())])
    return table(["fleet", *ONE_KIND], rows)


def by_kinds(scenes: int) -> str:
    """Usual places and odd ones, with vans and 10 % false boxes, without and with vehicle kinds."""
    rows = []
    for code in ("US", "TH", "ZA", "DE", "PH"):
        fleet = load_fleet(code)
        for name, (most, vans) in ODD.items():
            if _has(fleet, most):
                tallies = [run(fleet, scenes, VEHICLES, MEASURED, (0.12,), vans, 0.1, most, seen) for seen in (0, 1)]
                rows.append([code, name, *(t.cell() for t in tallies)])
    return table(["fleet", "place", "without kinds", "with kinds"], rows)


def by_oddness(scenes: int) -> str:
    """Usual places and odd ones, with measured boxes and vehicle kinds."""
    rows = []
    for code in ODD_FLEETS:
        fleet = load_fleet(code)
        cells = [
            run(fleet, scenes, ruler=MEASURED, gsds=(0.12,), vans=vans, most=most).cell()
            if _has(fleet, most) else ""
            for most, vans in (ODD[name] for name in ODDEST)
        ]  # fmt: skip
        rows.append([code, *cells])
    return table(["fleet", *ODDEST], rows)


def by_told(scenes: int) -> str:
    """Odd places with measured boxes and vehicle kinds, as they are found and where the user says what most are."""
    rows = []
    for code, (name, (most, vans)) in product(ODD_FLEETS, ODD.items()):
        fleet = load_fleet(code)
        if most is None or not most[1] or not _has(fleet, most):
            continue
        told = (None, load_fleet(f"{code}:{most[0]}"))
        cells = [run(fleet, scenes, ruler=MEASURED, gsds=(0.12,), vans=vans, most=most, told=t).cell() for t in told]
        rows.append([code, name, *cells])
    return table(["fleet", "place", "not told", "told what most are"], rows)


def by_proposal(scenes: int) -> str:
    """How often a class is proposed to the user: at usual places any, at lots of minis that."""
    rows = []
    for code in ODD_FLEETS:
        fleet = load_fleet(code)
        cells = [_proposed(fleet, scenes, most) for most in (None, ("mini", 0.6))]
        rows.append([code, *(f"{100 * np.mean(named):.0f} %" if named else "" for named in cells)])
    return table(["fleet", "usual places: any class", "60 % minis: that class"], rows)


def _has(fleet: Fleet, most: tuple[str, float] | None) -> bool:
    """Whether `fleet` has the class of `most`; True without one."""
    return most is None or most[0] in {c.name for c in fleet.classes}


def _proposed(fleet: Fleet, scenes: int, most: tuple[str, float] | None) -> list[bool]:
    """Whether each place is proposed to be mostly of the class of `most`, or of any class without it; empty where the
    fleet has no such class."""
    if not _has(fleet, most):
        return []
    named = []
    for k in range(scenes):
        rng = np.random.default_rng([0, k])
        vans = Vans.of_place(rng, fleet) if most is None else NO_VANS
        votes = car_park(rng, fleet, VEHICLES, 0.12, MEASURED, vans, most=most, exact=False)
        said = "".join(str(remark) for remark in proposed_class(votes, fleet, MEASURED))
        named.append(bool(said) if most is None else f"of the class {most[0]} " in said)
    return named


def by_length(scenes: int) -> str:
    """Places whose vehicles are shorter or longer than their country's, with measured boxes and vehicle kinds."""
    rows = []
    for code in ODD_FLEETS:
        cells = []
        for longer in LONGER:
            try:
                cells.append(run(load_fleet(code), scenes, ruler=MEASURED, gsds=(0.12,), longer=longer).cell())
            except ValueError:
                cells.append("no such mix")
        rows.append([code, *cells])
    return table(["fleet", *(f"{100 * longer:+.0f} %" for longer in LONGER)], rows)


def by_model(scenes: int) -> str:
    """Each fleet with measured boxes at places of one model, without and with vehicle kinds."""
    rows = []
    for code in FLEETS:
        fleet = load_fleet(code)
        tallies = [run(fleet, scenes, ruler=MEASURED, gsds=(0.12,), kinds=seen, one=True) for seen in (False, True)]
        rows.append([code, *(t.cell() for t in tallies)])
    return table(["fleet", "without kinds", "with kinds"], rows)


def by_hidden(scenes: int) -> str:
    """Each fleet with measured boxes and vans, by the share of vehicles that are partly hidden."""
    rows = []
    for code in FLEETS:
        fleet = load_fleet(code)
        rows.append([code, *(run(fleet, scenes, ruler=MEASURED, vans=None, hidden=h).cell() for h in HIDDEN)])
    return table(["fleet", *(f"{100 * h:.0f} % partly hidden" for h in HIDDEN)], rows)


def without_country(scenes: int) -> str:
    """Places pooled with the fleet `world`: `scenes` of them with the vehicles of each fleet of the table, and as many
    in countries drawn by the prior of `world`."""
    codes = [code for code in fleet_codes() if code not in (WORLD, "PAPER")]
    rows = []
    fleet = load_fleet("world")
    rng = np.random.default_rng(4)
    likely = rng.choice([c.code for c in fleet.candidates], len(codes) * scenes, p=fleet.prior)
    # The world's average stands for countries that are none of the candidates.
    unlike = [code for code in codes if code not in {c.code for c in fleet.candidates}]
    likely = [rng.choice(unlike) if code == WORLD else str(code) for code in likely]
    boxes = {"bare boxes": RULER, "measured, with kinds": MEASURED}
    for (kind, ruler), (drawn, here) in product(boxes.items(), (("evenly", codes * scenes), ("as likely", likely))):
        error, sd, hit = np.array([_without_country(k, code, fleet, ruler) for k, code in enumerate(here)]).T
        mean = {code: error[[k for k, other in enumerate(here) if other == code]].mean() for code in set(here)}
        worst = sorted(mean, key=lambda code: -abs(mean[code]))[:5]
        figures = [f"{100 * hit.mean():.0f} %", f"{100 * error.mean():+.1f}", rms(error), rms(sd)]
        rows.append([kind, drawn, *figures, ", ".join(f"{code} {100 * mean[code]:+.0f}" for code in worst)])
    head = ["boxes", "countries drawn", "coverage", "bias", "RMS error", "claimed one-sigma"]
    return table([*head, "worst fleets, mean error [%]"], rows)


def _without_country(k: int, code: str, fleet: Fleet, ruler: Ruler) -> tuple[float, float, bool]:
    """Log error, claimed one sigma and whether the interval holds, for the `k`-th place, in the country `code`."""
    rng = np.random.default_rng([3, k])
    gsd, (vans, false) = GSDS[rng.integers(len(GSDS))], list(CONDITIONS.values())[rng.integers(len(CONDITIONS))]
    here = load_fleet(code)
    votes = car_park(rng, here, VEHICLES, gsd, ruler, vans or Vans.of_place(rng, here), false, exact=False)
    scale = pool(votes, fleet, ruler, "m/px")
    low, high = scale.interval90
    return float(np.log(scale.value / gsd)), scale.relative_sd, low <= gsd <= high


def by_count(code: str, vans: Vans | None, false: float, scenes: int) -> str:
    """Error against the number of boxes, also of the paper's mean from the same boxes."""
    rows = []
    for n in COUNTS:
        t = run(load_fleet(code), scenes if n < 3000 else scenes // 2, n, vans=vans, false=false)
        own = [rms(t.error), rms(t.sd), f"{100 * t.hit.mean():.0f} %", f"{t.refused}"]
        paper = [rms(t.paper_error), f"{100 * t.paper_hit.mean():.0f} %", rms(t.fair_error)]
        rows.append([f"{n:,}", *own, *paper])
    head = ["error", "claimed", "coverage", "refused", "paper's error", "paper's coverage", "with margin taken off"]
    return table(["boxes", *head], rows)


def paper_thresholds(scenes: int) -> str:
    """The paper's two thresholds: the share of scenes with an answer and their RMS error; fleet and margin are
    exact."""
    fleet = load_fleet("PAPER")
    known = replace(fleet, mean_sd=np.full(3, 1e-6))
    exact = replace(NO_MARGIN, bias_sd=(0.0, 0.0))
    rows = []
    for minimum in (1, 3, 5, 10, 20):
        cells = []
        for threshold in (0.1, 0.3, 0.5, 0.7, 0.9):
            errors = []
            for k in range(scenes):
                rng = np.random.default_rng([7, k])
                votes = car_park(rng, known, int(rng.integers(1, 60)), 0.12, exact, Vans(0.05), 0.3)
                try:
                    paper = pool_iqr((fleet.mean[:2] / votes.size).mean(1), votes.score, threshold, minimum)
                except TooLittleEvidence:
                    continue
                errors.append(np.log(paper.value / 0.12))
            cells.append(f"{100 * len(errors) / scenes:.0f} %, {rms(np.array(errors))}" if errors else "none")
        rows.append([f"{minimum}", *cells])
    return table(["at least", *(f"score > {t}" for t in (0.1, 0.3, 0.5, 0.7, 0.9))], rows)


TABLES: dict[str, tuple[str, Callable[[int], str]]] = {
    "fleets": ("Coverage (bias, RMS error, claimed one-sigma [%])", lambda scenes: by_fleet(RULER, scenes)),
    "bare": ("The same without box margins", lambda scenes: by_fleet(NO_MARGIN, scenes)),
    "drawing": (
        "With margins, sizes drawn to the usual by 0.4 of length and 0.2 of width",
        lambda scenes: by_fleet(DRAWING, scenes),
    ),
    "pixels": ("With margins, vans and 10 % false boxes, by pixel size", lambda scenes: by_gsd("both", scenes)),
    "vans": ("With margins, vans of one kind", by_vans),
    "kinds": ("With margins, vans and 10 % false boxes, kinds seen or not", by_kinds),
    "odd": ("Measured boxes, 12 cm/px: odd places", by_oddness),
    "told": ("Measured boxes, 12 cm/px: odd places, and the user says so", by_told),
    "proposed": ("Measured boxes, 12 cm/px: how often a caution proposes a class", by_proposal),
    "longer": ("Measured boxes, 12 cm/px: places of shorter or longer vehicles than their country's", by_length),
    "one": ("Measured boxes, 12 cm/px: places of one model", by_model),
    "hidden": ("Measured boxes and vans, of which some vehicles are partly hidden", by_hidden),
    "country": ("The country not known [%]: each of the table's fleets in turn", without_country),
    "count": ("Error against the number of boxes [%], DE", lambda scenes: by_count("DE", NO_VANS, 0.0, scenes)),
    "count-vans": (
        "The same with vans and 10 % false boxes",
        lambda scenes: by_count("DE", None, 0.1, scenes),
    ),
    "thresholds": (
        "The paper's thresholds: scenes answered, RMS error [%]; 1 to 59 boxes, of which 30 % are false, 5 % vans",
        paper_thresholds,
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)}; all by default")
    parser.add_argument("--scenes", type=int, default=SCENES, help="a cell (%(default)s)")
    options = parser.parse_args()
    if unknown := set(options.tables) - set(TABLES):
        parser.error(f"no such table: {', '.join(sorted(unknown))}; there are {', '.join(TABLES)}")
    for name in options.tables or TABLES:
        title, make = TABLES[name]
        print(f"## {title}\n\n{options.scenes} scenes a cell\n\n{make(options.scenes)}\n", flush=True)


if __name__ == "__main__":
    main()
