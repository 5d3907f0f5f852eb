"""Drawn padel courts and containers, as there are no real pictures here: ``python benchmarks/anchors_drawn.py KIND``.

Pictures with exact truth and many appearances, one place each: padel courts alone or three side by side, yards of
containers in one to three rows of two heights. The vehicles' scale is off by a random 8 % (one sigma, at most 12 %). Of
an anchor's standards the one nearest to the truth counts; `sure` is the share of anchors with a single standard. A find
off by more than 6 % is false. CPU seconds are those of this process. `anchors_false.py` counts how often other things,
real and drawn, are taken for them.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from orthoscale.anchors.kinds import finder
from orthoscale.core.normal import Z90

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

from anchor_places import VEHICLES_SD, vehicles_off  # noqa: E402
from support.containers import container_yard  # noqa: E402
from support.padel import padel_club  # noqa: E402

FALSE_FROM = 0.06
PICTURES = 24
GSDS = 0.05, 0.1, 0.2, 0.3  # [m/px]


def padel(number: int, gsd: float, rng: np.random.Generator) -> tuple[np.ndarray, int]:
    """RGB picture, and the number of courts in it."""
    courts, image = padel_club(number, gsd, rng)
    return image, len(courts)


def containers(number: int, gsd: float, rng: np.random.Generator) -> tuple[np.ndarray, int]:
    """RGB picture, and the number of containers in it."""
    return container_yard(number, gsd, rng)[:2]


KINDS: dict[str, Callable[[int, float, np.random.Generator], tuple[np.ndarray, int]]] = {
    "padel court": padel,
    "container": containers,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=[kind.replace(" ", "-") for kind in KINDS])
    kind = parser.parse_args().kind.replace("-", " ")
    look = finder(kind, {})
    print(
        "| kind | m/px | found in | of them all | false | error: median [%] | 90 % / worst [%] | in the 90 % interval "
        "[%] | sure [%] | CPU s/Mpx |\n|" + 10 * "---|"
    )
    for gsd in GSDS:
        rng, seconds, pixels, false, there, seen, places = np.random.default_rng(1), 0.0, 0, 0, 0, 0, 0
        found = []
        for number in range(PICTURES):
            image, count = KINDS[kind](number, gsd, rng)
            told = gsd * vehicles_off(rng)
            start = time.process_time()
            anchors = look.find(image, told, VEHICLES_SD, "")
            seconds, pixels, there = seconds + time.process_time() - start, pixels + image[..., 0].size, there + count
            errors = [np.log(anchor.metres_per_pixel() / gsd) for anchor in anchors]
            best = [(error[k], k) for error in errors for k in [int(np.abs(error).argmin())]]
            right = [k for k, (error, _) in enumerate(best) if abs(error) < FALSE_FROM]
            false, places = false + len(best) - len(right), places + bool(right)
            for k in right:
                anchor, (error, number_) = anchors[k], best[k]
                sd = np.hypot(anchor.relative_sd, anchor.standards[number_].relative_sd)
                found.append((error, abs(error) <= Z90 * sd, len(anchor.standards) == 1))
                seen += anchor.count
        error, held, sure = np.array(found).reshape(-1, 3).T
        size = np.abs(error)
        far = f"{100 * np.quantile(size, 0.9):.2f} / {100 * size.max():.2f} | {100 * held.mean():.0f}"
        counts = f"{places} of {PICTURES} | {seen} of {there} | {false}"
        cost = f"{100 * sure.mean():.0f} | {seconds / pixels * 1e6:.2f}"
        print(f"| {kind} | {gsd} | {counts} | {100 * np.median(error):+.2f} | {far} | {cost} |", flush=True)


if __name__ == "__main__":
    main()
