r"""Train the measurer.

    python -m training.measurer.rendered runs/bank --count 300
    python -m training.measurer.real runs/bank --labels ../shared/data/vehicles/labels.json
    python -m training.measurer.train --bank runs/bank --run runs/new --steps 20000

A step takes BATCH crops, which are made by a process of their own; two cores do 60 to 240 crops a second. The
checkpoint holds everything: `--resume` continues where it stopped, with newly drawn crops. `export` writes the
exponential moving average of the weights.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset

from training.log import Log
from training.train import copied, follow, in_16_bits, learning_rate
from training.unfold import unfolded

from .crops import RENDERED, Examples, batch
from .network import Habits, MeasureNet, loss
from .real import NONE, SCENES

BATCH = 32
HABITS_RATE = 10.0  # learning rate of `Habits` as a multiple of the network's
EXPORTED = ".onnx"  # how a file ends that `export` wrote


class Batches(IterableDataset):  # type: ignore[type-arg]
    """Endless batches of `Examples`."""

    def __init__(self, bank: Path, seed: int) -> None:
        self.bank, self.seed = bank, seed

    def __iter__(self) -> Iterator[dict[str, np.ndarray]]:
        cv2.setNumThreads(1)
        examples = iter(Examples(self.bank, self.seed))
        while True:
            yield batch(list(islice(examples, BATCH)))


@dataclass
class State:
    """The training between two steps. file : its checkpoint. average : exponential moving average of the weights."""

    file: Path
    network: MeasureNet
    habits: Habits
    optimiser: torch.optim.Optimizer
    average: dict[str, torch.Tensor]
    step: int = 0

    @classmethod
    def begun(cls, options: argparse.Namespace) -> State:
        """A state at step 0 with new or given weights, or the one in the run's checkpoint. Weights in an exported file
        are left to `unfold`."""
        network, habits = MeasureNet(), Habits(len(SCENES) + 1)
        optimiser = torch.optim.AdamW(
            [{"params": network.parameters(), "times": 1.0},
             {"params": habits.parameters(), "times": HABITS_RATE, "weight_decay": 0.0}], weight_decay=1e-4,
        )  # fmt: skip
        state = cls(options.run / "checkpoint.pt", network, habits, optimiser, copied(network.state_dict()))
        begin = state.file if options.resume else options.start
        if begin is not None and begin.suffix != EXPORTED:
            state.take(torch.load(begin), options.resume)
        return state

    def take(self, kept: dict[str, Any], all_of_it: bool) -> None:
        """Take what a checkpoint holds: `all_of_it`, or only the averaged weights and the habits."""
        self.habits.load_state_dict(kept["habits"])
        self.network.load_state_dict(kept["network"] if all_of_it else kept["average"])
        self.average = copied(kept["average"])
        if all_of_it:
            self.optimiser.load_state_dict(kept["optimiser"])
            self.step = kept["step"]

    def unfold(self, exported: Path, seen: torch.Tensor) -> None:
        """Take the weights of an `exported` file; the crops `seen` give their statistics."""
        self.average = copied(unfolded(exported, self.network, seen.float()))

    def save(self) -> None:
        """Write the checkpoint, completely or not at all."""
        kept = {
            "network": self.network.state_dict(), "habits": self.habits.state_dict(), "average": self.average,
            "optimiser": self.optimiser.state_dict(), "step": self.step,
        }  # fmt: skip
        partial = self.file.with_suffix(".partial")
        torch.save(kept, partial)
        partial.replace(self.file)

    def learn(self, arrays: dict[str, torch.Tensor], rate: float) -> dict[str, float]:
        """Make one step at the learning rate `rate`; returns the parts of the loss, and the error on rendered edges
        [px]."""
        for group in self.optimiser.param_groups:
            group["lr"] = group["times"] * rate
        with in_16_bits("cpu"):
            outputs = self.network(arrays["pixels"].float())
        parts = loss(tuple(o.float() for o in outputs), self.habits, arrays)
        self.optimiser.zero_grad()
        sum(parts.values()).backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        self.step += 1
        follow(self.average, self.network, min(0.998, (1 + self.step) / (10 + self.step)))
        with torch.no_grad():
            exact = (arrays["kind"] != NONE) & (arrays["scene"] == RENDERED)
            error = (outputs[0].float() - arrays["edges"]).abs()[exact]
        return {**{k: v.item() for k, v in parts.items()}, "error_px": error.median().item()}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bank", type=Path, required=True, help="folder of training.measurer.rendered and real")
    parser.add_argument("--run", type=Path, required=True, help="folder of the checkpoint and the log")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--rate", type=float, default=1.5e-3, help="peak learning rate (%(default)s)")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--start", type=Path, help="checkpoint to begin with, its average, or exported file, at step 0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    options.run.mkdir(parents=True, exist_ok=True)
    state = State.begun(options)
    made = iter(DataLoader(Batches(options.bank, options.seed + 1000 * state.step), batch_size=None, num_workers=1))
    if not options.resume and options.start is not None and options.start.suffix == EXPORTED:
        state.unfold(options.start, torch.cat([next(made)["pixels"] for _ in range(8)]))
    log = Log(options.run, 25, BATCH, state.step, options.steps)
    state.network.train()
    while state.step < options.steps:
        rate = learning_rate(state.step, state.step / options.steps, options.rate)
        told = state.learn(next(made), rate)
        margins = [[round(v, 2) for v in row] for row in state.habits.margin.tolist()]
        log.add(state.step, told, margin_px=margins)
        if state.step % 100 == 0:
            state.save()
    state.save()


if __name__ == "__main__":
    main()
