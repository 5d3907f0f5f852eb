"""Run the campaign, or parts of it.

python -m tests.fuzz                        all of it, about 17 minutes on two idle cores
python -m tests.fuzz --short                about a minute
python -m tests.fuzz --class rasters        the classes whose names hold a word
python -m tests.fuzz --only "killed:17"     one attempt again, with what it printed; --keep leaves its folder
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import shlex
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))  # the makers of inputs of the suite are in tests/support

from . import campaign, commands, runner  # noqa: E402
from .runner import Outcome  # noqa: E402
from .table import table  # noqa: E402

SHORT = 300  # attempts of a short run, before the least of each class
LEAST = 10  # of each class in a short run
FAILURES = Path("build/fuzz-failures.jsonl")


def wanted(options: argparse.Namespace) -> Iterator[tuple[str, int]]:
    """Class and seed of each attempt; classes take turns, so that a run that is stopped has seen all."""
    if options.only:
        name, _, seed = options.only.rpartition(":")
        yield name, int(seed)
        return
    counts = {
        name: count for name, (_, count) in commands.CLASSES.items() if any(word in name for word in options.parts)
    }
    if options.short:
        total = sum(counts.values())
        counts = {name: max(LEAST, round(SHORT * count / total)) for name, count in counts.items()}
    if options.count:
        counts = dict.fromkeys(counts, options.count)
    order = sorted((k / count, name, k) for name, count in counts.items() for k in range(count))
    for _, name, k in order:
        yield name, options.first + k


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description="The damage campaign.")
    parser.add_argument("--short", action="store_true", help="about 400 attempts")
    parser.add_argument(
        "--class", dest="parts", action="append", metavar="WORD", help="classes whose names hold this; repeatable"
    )
    parser.add_argument("--count", type=int, help="attempts of each class")
    parser.add_argument("--first", type=int, default=0, help="first seed (%(default)s)")
    parser.add_argument("--only", metavar="CLASS:SEED", help="one attempt")
    parser.add_argument("--keep", action="store_true", help="leave the attempts' folders")
    parser.add_argument(
        "--workers", type=int, default=min(5, 1 + (os.cpu_count() or 1)), help="one more than cores, since some wait"
    )
    parser.add_argument("--failures", type=Path, default=FAILURES, help="file for what failed (%(default)s)")
    parser.add_argument("--log", type=Path, help="file to which all outcomes are added")
    options = parser.parse_args()
    options.parts = options.parts or [""]
    runner.one_thread()
    begin = time.monotonic()
    home = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
    work = Path(tempfile.mkdtemp(prefix="orthoscale-fuzz-", dir=home))
    context = multiprocessing.get_context("spawn")
    try:
        with context.Pool(1) as pool:
            corpus = pool.apply(campaign.make_corpus, (work / "corpus",))
        print(f"corpus made in {time.monotonic() - begin:.0f} s", file=sys.stderr)
        outcomes = []
        todo = [(corpus, work, name, seed, options.keep) for name, seed in wanted(options)]
        with context.Pool(1 if options.only else options.workers, runner.preload) as pool:
            for outcome in pool.imap_unordered(campaign.attempt, todo):
                outcomes.append(outcome)
                if options.log:  # at once: a run that is stopped has told what it saw
                    with options.log.open("a") as log:
                        log.write(json.dumps(asdict(outcome)) + "\n")
                if outcome.problems or options.only:
                    _tell(outcome)
                elif len(outcomes) % 500 == 0:
                    print(f"{len(outcomes)} of {len(todo)}, {time.monotonic() - begin:.0f} s", file=sys.stderr)
    finally:
        if options.keep:
            print(f"kept: {work}", file=sys.stderr)
        else:
            runner.clean(work)
    failed = [o for o in outcomes if o.problems]
    if not options.only:
        print(table(outcomes, [name for name in commands.CLASSES if any(o.name == name for o in outcomes)]))
        options.failures.parent.mkdir(exist_ok=True)
        options.failures.write_text("".join(json.dumps(asdict(o)) + "\n" for o in failed))
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)  # corpus, workers and all that they started
        cpu = usage.ru_utime + usage.ru_stime
        print(f"\n{len(outcomes)} inputs in {time.monotonic() - begin:.0f} s ({cpu:.0f} s of the processor), "
              f"{len(failed)} with problems" + (f", listed in {options.failures}" if failed else ""))  # fmt: skip
    return int(bool(failed))


def _tell(outcome: Outcome) -> None:
    words = shlex.join(outcome.argv)
    said = outcome.said.strip().splitlines()
    print(f"{', '.join(outcome.problems) or 'fine'}: {outcome.name}:{outcome.seed}: exit {outcome.code}, "
          f"{outcome.seconds:.1f} s, {outcome.peak:.2f} GiB: {words}", file=sys.stderr)  # fmt: skip
    for line in said[-6:]:
        print(f"    {line[:300]}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
