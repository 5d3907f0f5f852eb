"""The log of a training run: means over some steps, printed and stored in log.jsonl."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class Log:
    """Writes `run`/log.jsonl, a line after each `every` steps of `batch` crops, from step `first` to step `steps`."""

    def __init__(self, run: Path, every: int, batch: int, first: int, steps: int) -> None:
        self.path, self.every, self.batch, self.first, self.steps = run / "log.jsonl", every, batch, first, steps
        self.totals: dict[str, float] = {}
        self.added = 0  # steps in the totals: fewer than `every` if a training was resumed between two lines
        self.started = time.time()

    def add(self, step: int, told: Mapping[str, float], **more: Any) -> None:
        """Add the values of step number `step`; if a line is due, `more` is written as it is."""
        for name, value in told.items():
            self.totals[name] = self.totals.get(name, 0.0) + value
        self.added += 1
        if step % self.every:
            return
        seconds, done = time.time() - self.started, step - self.first
        line = {"step": step, **{name: round(value / self.added, 4) for name, value in self.totals.items()}, **more}
        line["crops_per_s"] = round(done * self.batch / seconds, 1)
        line["minutes_left"] = round(seconds / done * (self.steps - step) / 60, 1)
        print(json.dumps(line), flush=True)
        with self.path.open("a") as log:
            log.write(json.dumps(line) + "\n")
        self.totals.clear()
        self.added = 0
