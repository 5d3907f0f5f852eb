"""What worker processes do: make the corpus, make and run one attempt."""

from __future__ import annotations

import signal
import traceback
from dataclasses import replace
from pathlib import Path

from orthoscale.detect import foreign

from . import commands, runner
from .bench import Bench
from .seeds import SEEDS

PATIENCE = 300.0  # [s] for what once had no end
ENDLESS_SECONDS = 4.0  # [s] that a network without end is given for one look, all of which it takes


def make_corpus(folder: Path, answered: tuple[str, ...] = ()) -> Path:
    """Build the corpus in the new `folder`, see `corpus.build`; in a process of its own, since its makers load and
    start much."""
    from .corpus import build

    build(folder, answered)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the commands that it called took it
    return folder


def attempt(place: tuple[Path, Path, str, int, bool]) -> runner.Outcome:
    """Prepare and run one attempt: (corpus, folder of work, class, seed, whether its folder stays)."""
    corpus, work, name, seed, keep = place
    folder = work / f"{name.replace(' ', '_').replace('/', '_')}-{seed}"
    runner.clean(folder)
    folder.mkdir(parents=True)
    try:
        outcome = runner.run(name, seed, folder, commands.prepare(Bench(corpus, folder), name, seed))
    except Exception:  # of the campaign, not of the program: shown like a failure, and the rest goes on
        outcome = runner.Outcome(name, seed, ("(not run)",), 1, 0.0, 0.0, 0.0, ("crash",), traceback.format_exc())
    if not keep:
        runner.clean(folder)
        for rest in work.glob(f".{folder.name}*"):
            runner.clean(rest)
    return outcome


def run_seed(corpus: Path, work: Path, name: str, patience: float = PATIENCE) -> runner.Outcome:
    """Make and run the seed called `name`, with patience for a machine that has much else to do."""
    if "endless" in name:
        foreign.LONGEST_SECONDS = ENDLESS_SECONDS
    work.mkdir(parents=True)
    return runner.run(name, 0, work, replace(SEEDS[name](Bench(corpus, work)), patience=patience))
