"""What worker processes do: make the corpus, make and run one attempt."""

from __future__ import annotations

import traceback
from pathlib import Path

from . import commands, runner
from .bench import Bench


def make_corpus(folder: Path) -> Path:
    """Build the corpus in the new `folder`; in a process of its own, since its makers load and start much."""
    from .corpus import build

    return build(folder)


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
