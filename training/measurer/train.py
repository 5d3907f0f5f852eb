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
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset

from training.log import Log
from training.train import follow, in_16_bits, learning_rate
from training.unfold import unfolded

from .crops import RENDERED, Examples, batch
from .network import Habits, MeasureNet, loss
from .real import NONE, SCENES

BATCH = 32
HABITS_RATE = 10.0  # learning rate of `Habits` as a multiple of the network's


class Batches(IterableDataset):  # type: ignore[type-arg]
    """Endless batches of `Examples`."""

    def __init__(self, bank: Path, seed: int) -> None:
        self.bank, self.seed = bank, seed

    def __iter__(self) -> Iterator[dict[str, np.ndarray]]:
        cv2.setNumThreads(1)
        examples = iter(Examples(self.bank, self.seed))
        while True:
            yield batch(list(islice(examples, BATCH)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bank", type=Path, required=True, help="folder of training.measurer.rendered and real")
    parser.add_argument("--run", type=Path, required=True, help="folder of the checkpoint and the log")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--rate", type=float, default=1.5e-3, help="peak learning rate (%(default)s)")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--start", type=Path, help="checkpoint to begin with, its average, or exported file, at step 0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()

    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    options.run.mkdir(parents=True, exist_ok=True)
    file = options.run / "checkpoint.pt"
    network, habits, step = MeasureNet(), Habits(len(SCENES) + 1), 0
    optimiser = torch.optim.AdamW(
        [{"params": network.parameters(), "times": 1.0},
         {"params": habits.parameters(), "times": HABITS_RATE, "weight_decay": 0.0}], weight_decay=1e-4,
    )  # fmt: skip
    average, begin = network.state_dict(), file if options.resume else options.start
    exported = begin is not None and begin.suffix == ".onnx"
    if begin is not None and not exported:
        state = torch.load(begin)
        habits.load_state_dict(state["habits"])
        average = state["average"]
        network.load_state_dict(state["network"] if options.resume else average)
        if options.resume:
            optimiser.load_state_dict(state["optimiser"])
            step = state["step"]
    made = iter(DataLoader(Batches(options.bank, options.seed + 1000 * step), batch_size=None, num_workers=1))
    if exported:
        seen = torch.cat([next(made)["pixels"] for _ in range(8)])
        average = unfolded(begin, network, seen.float())
    average = {name: value.clone() for name, value in average.items()}

    def save() -> None:
        state = {
            "network": network.state_dict(), "habits": habits.state_dict(), "average": average,
            "optimiser": optimiser.state_dict(), "step": step,
        }  # fmt: skip
        partial = file.with_suffix(".partial")
        torch.save(state, partial)
        partial.replace(file)

    log = Log(options.run, 25, BATCH, step, options.steps)
    network.train()
    while step < options.steps:
        for group in optimiser.param_groups:
            group["lr"] = group["times"] * learning_rate(step, step / options.steps, options.rate)
        arrays = next(made)
        with in_16_bits("cpu"):
            outputs = network(arrays["pixels"].float())
        parts = loss(tuple(o.float() for o in outputs), habits, arrays)
        optimiser.zero_grad()
        sum(parts.values()).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        step += 1
        keep = min(0.998, (1 + step) / (10 + step))
        follow(average, network, keep)
        with torch.no_grad():
            vehicle = arrays["kind"] != NONE
            exact = vehicle & (arrays["scene"] == RENDERED)
            error = (outputs[0].float() - arrays["edges"]).abs()[exact]
        told = {**{k: v.item() for k, v in parts.items()}, "error_px": error.median().item()}
        log.add(step, told, margin_px=[[round(v, 2) for v in row] for row in habits.margin.tolist()])
        if step % 100 == 0:
            save()
    save()


if __name__ == "__main__":
    main()
