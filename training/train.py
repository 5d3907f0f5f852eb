"""Train the detector. A training can be stopped and resumed at any time.

    python -m training.train --labels ../shared/data/vehicles/labels.json --run runs/v1 --hold-out ohio
    python -m training.train ... --network lite0 --run runs/finder      # on a backbone pretrained on ImageNet
    python -m training.train ... --network small lite0 --run runs/both  # both from the same crops, on a GPU
    python -m training.train ... --run runs/v1 --resume                 # continue from the checkpoint

The learning rate depends on the share of `--steps` or `--minutes` that is done (warm-up, then a half cosine), so a run
with `--steps` that is interrupted and resumed ends where an uninterrupted one would. The shipped weights are the
exponential moving average.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import torch
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from .augment import crops
from .data import LabelledImage, read_labels, split
from .log import Log
from .measured import with_measured
from .network import NETWORKS, Finder, loss
from .unfold import unfolded

# Relative share of the crops by scene: many small images of one car park count less; vehicle-free ground counts, too.
SCENE_WEIGHTS = {
    "munich": 0.18, "minsk": 0.16, "bogota": 0.18, "warsaw": 0.3, "ohio": 0.08,
    "park": 0.14, "dunes": 0.06, "synthetic": 0.5, "lookalikes": 0.4,
    "parkinglot": 0.12, "intersection": 0.08, "freeway": 0.06, "overpass": 0.06, "mobilehomepark": 0.05,
    "denseresidential": 0.06, "buildings": 0.1, "harbor": 0.1, "storagetanks": 0.07, "tenniscourt": 0.06,
}  # fmt: skip
PEAK_RATE = 1.5e-3
WARM_UP = 300  # steps
CHECKPOINT = "checkpoint.pt"
CHECKPOINT_EVERY = 250  # steps
LOOKED_AT = 10  # steps between two whose loss is read: a GPU has to wait for each
COARSEST = 3  # coarsest half-size level of a picture that crops are taken from


class Crops(IterableDataset):
    def __init__(self, images, seed: int):
        self.images, self.seed = images, seed

    def __iter__(self):
        worker = get_worker_info()
        yield from crops(self.images, SCENE_WEIGHTS, self.seed + (worker.id if worker else 0))


@torch.no_grad()
def follow(average: dict[str, torch.Tensor], network: torch.nn.Module, keep: float) -> None:
    """Move the exponential moving `average` of weights towards those of `network`; `keep` is its decay factor."""
    state = network.state_dict()
    learnt = [name for name, value in state.items() if value.dtype.is_floating_point]
    get_ema_multi_avg_fn(keep)([average[name] for name in learnt], [state[name] for name in learnt], None)
    for name in state.keys() - learnt:
        average[name].copy_(state[name])


def learning_rate(step: int, done: float, peak: float = PEAK_RATE) -> float:
    """The learning rate at `step`, when the share `done` of the training is done."""
    return peak * min(1.0, (step + 1) / WARM_UP) * (0.5 * (1 + math.cos(math.pi * done)) + 0.01)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--labels", type=Path, action="append", required=True, help="label file; may be repeated")
    parser.add_argument("--run", type=Path, required=True, help="folder for checkpoint.pt and log.jsonl")
    parser.add_argument(
        "--network",
        choices=NETWORKS,
        nargs="+",
        default=["small"],
        help="(small) several learn from the same crops, each in a folder of the run that has its name",
    )
    parser.add_argument("--measured", type=Path, help="boxes of training.measured that take the place of drawn ones")
    parser.add_argument("--hold-out", default="", help="scenes not trained on, comma separated")
    parser.add_argument("--steps", type=int, default=7000)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="one where others use the cores too")
    parser.add_argument("--rate", type=float, default=PEAK_RATE, help="peak of the learning rate (%(default)s)")
    parser.add_argument(
        "--backbone-rate", type=float, default=0.25, help="share of it for what ImageNet taught (%(default)s)"
    )
    parser.add_argument("--learn-all", action="store_true", help="on a GPU: also the layers that lite0 leaves alone")
    parser.add_argument("--minutes", type=float, help="end after these, if the steps are not done before")
    parser.add_argument("--seed", type=int, default=0)
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--resume", action="store_true")
    start.add_argument(
        "--start",
        type=Path,
        nargs="+",
        metavar="CHECKPOINT|ONNX",
        help="begin with the average of another run, or what it exported; one for each network",
    )
    return parser.parse_args()


def optimiser_of(network: torch.nn.Module, backbone_rate: float) -> torch.optim.Optimizer:
    """AdamW; the pretrained backbone learns at the share `backbone_rate` of the rate."""
    learnt = {name: value for name, value in network.named_parameters() if value.requires_grad}
    taught = [value for name, value in learnt.items() if name.startswith("backbone.")]
    new = [value for name, value in learnt.items() if not name.startswith("backbone.")]
    groups = [{"params": new, "share": 1.0}, {"params": taught, "share": backbone_rate}]
    return torch.optim.AdamW([group for group in groups if group["params"]], weight_decay=1e-4)


@dataclass
class State:
    """The training of one network between two steps. kind : key of NETWORKS. run : folder of its checkpoint and log.
    average : exponential moving average of the weights."""

    kind: str
    run: Path
    network: torch.nn.Module
    optimiser: torch.optim.Optimizer
    average: dict[str, torch.Tensor]
    step: int = 0

    @classmethod
    def begun(cls, kind: str, start: Path | None, options: argparse.Namespace, training: list, device: str) -> State:
        """A state at step 0 with new, pretrained or given weights, or the one in the run's checkpoint.

        start : checkpoint or ONNX file with the weights to start from, if any.
        training : images; a batch of their crops gives the statistics of a network that is read from ONNX (`unfold`).
        """
        network = NETWORKS[kind]()
        if isinstance(network, Finder) and not (start or options.resume):
            network.backbone.load_imagenet()
        if options.learn_all:
            network.requires_grad_(True)
        network.to(device, memory_format=torch.channels_last)
        optimiser = optimiser_of(network, options.backbone_rate)
        run = options.run / kind if len(options.network) > 1 else options.run
        run.mkdir(parents=True, exist_ok=True)
        state = cls(kind, run, network, optimiser, copied(network.state_dict()))
        if start:
            state.take(start, options, training, device)
        elif options.resume:
            state.resume(device)
        return state

    def take(self, start: Path, options: argparse.Namespace, training: list, device: str) -> None:
        """Take the averaged weights of another run, from its checkpoint or its exported file."""
        if start.suffix == ".onnx":
            sample = islice(crops(training, SCENE_WEIGHTS, options.seed), options.batch)
            seen = as_input(torch.stack([torch.from_numpy(image) for image, *_ in sample]), device)
            average = unfolded(start, self.network, seen)
        else:
            average = torch.load(start, map_location=device)["average"]
        self.network.load_state_dict(average)
        self.average = copied(average)

    def resume(self, device: str) -> None:
        """Continue from the run's checkpoint."""
        kept = torch.load(self.run / CHECKPOINT, map_location=device)
        self.network.load_state_dict(kept["network"])
        self.optimiser.load_state_dict(kept["optimiser"])
        self.average, self.step = kept["average"], kept["step"]

    def save(self) -> None:
        """Write the checkpoint, completely or not at all."""
        kept = {
            "kind": self.kind, "step": self.step, "network": self.network.state_dict(), "average": self.average,
            "optimiser": self.optimiser.state_dict(),
        }  # fmt: skip
        partial = (self.run / CHECKPOINT).with_suffix(".partial")
        torch.save(kept, partial)
        partial.replace(self.run / CHECKPOINT)

    def learn(
        self, image: torch.Tensor, targets: list[torch.Tensor], rate: float, device: str
    ) -> dict[str, torch.Tensor]:
        """Make one step at the learning rate `rate`; returns the parts of the loss."""
        for group in self.optimiser.param_groups:
            group["lr"] = group["share"] * rate
        with in_16_bits(device):
            maps = self.network(image)
        parts = loss(maps.float(), *targets)
        self.optimiser.zero_grad()
        sum(parts.values()).backward()
        torch.nn.utils.clip_grad_norm_([p for p in self.network.parameters() if p.requires_grad], 5.0)
        self.optimiser.step()
        self.step += 1
        follow(self.average, self.network, min(0.999, (1 + self.step) / (10 + self.step)))
        return parts


def in_16_bits(device: str) -> torch.autocast:
    """A context with 16-bit numbers where that does no harm: 1.4 to 1.7 times as fast on a core with AVX-512 BF16. A
    core without that would be ten times as slow, and uses 32 bits."""
    fast = device != "cpu" or torch.cpu.get_capabilities().get("avx512_bf16", False)
    return torch.autocast(device, torch.bfloat16, enabled=fast)


def copied(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in weights.items()}


def as_input(image: torch.Tensor, device: str) -> torch.Tensor:
    """RGB (n, 3, h, w) uint8 as input of the networks, 0..1, on `device`."""
    image = image.to(device, non_blocking=True, memory_format=torch.channels_last)
    return image.float() / 255


def decoded(images: list[LabelledImage], threads: int) -> None:
    """Decode all pictures now, so that the processes that crop them share their pixels."""
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda image: image.level(COARSEST), images))


def main() -> None:
    options = arguments()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    images = [image for file in options.labels for image in read_labels(file)]
    if options.measured:
        images = with_measured(images, options.measured)
    training, _ = split(images, set(filter(None, options.hold_out.split(","))))
    if options.workers > 1:
        decoded(training, options.workers)
    starts = options.start or [None] * len(options.network)
    states = [
        State.begun(kind, start, options, training, device) for kind, start in zip(options.network, starts, strict=True)
    ]
    for state in states:
        state.network.train()
    step = states[0].step
    loader = DataLoader(
        Crops(training, options.seed + 1000 * step), batch_size=options.batch, num_workers=options.workers,
        prefetch_factor=max(2, 8 // options.workers) if options.workers else None, pin_memory=device != "cpu",
    )  # fmt: skip
    logs = [Log(state.run, 100, options.batch, step, options.steps) for state in states]
    begun, minutes = time.monotonic(), options.minutes or math.inf
    for images_of_batch, *targets in loader:
        done = max(step / options.steps, (time.monotonic() - begun) / 60 / minutes)
        if done >= 1:
            break
        image = as_input(images_of_batch, device)
        targets = [part.to(device, non_blocking=True) for part in targets]
        rate = learning_rate(step, done, options.rate)
        step += 1
        for state, log in zip(states, logs, strict=True):
            parts = state.learn(image, targets, rate, device)
            if step % LOOKED_AT == 0:
                log.add(step, {name: value.item() for name, value in parts.items()})
            if step % CHECKPOINT_EVERY == 0:
                state.save()
    for state in states:
        state.save()


if __name__ == "__main__":
    main()
