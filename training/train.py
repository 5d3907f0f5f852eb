"""Train the detector; stop and start it again as you like.

    python -m training.train --labels ../shared/data/vehicles/labels.json --run runs/v1 --hold-out ohio
    python -m training.train ... --network lite0 --run runs/finder      # on layers that ImageNet taught
    python -m training.train ... --run runs/v1 --resume                 # go on where the checkpoint stands

The learning rate follows the share of `--steps` done (warm-up, then a half cosine), so an interrupted run that is
resumed ends where an uninterrupted one would. The shipped weights are the exponential moving average.
"""

from __future__ import annotations

import argparse
import math
import os
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from .augment import crops
from .data import read_labels, split
from .log import Log
from .network import NETWORKS, Finder, loss
from .unfold import unfolded

# Share of the crops by scene: many small images of one car park count less, vehicle-free ground counts.
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


class Crops(IterableDataset):
    def __init__(self, images, seed: int):
        self.images, self.seed = images, seed

    def __iter__(self):
        worker = get_worker_info()
        yield from crops(self.images, SCENE_WEIGHTS, self.seed + (worker.id if worker else 0))


@torch.no_grad()
def follow(average: dict[str, torch.Tensor], network: torch.nn.Module, keep: float) -> None:
    """Move the exponential moving `average` of weights towards those of `network`; `keep` is the share that stays."""
    for name, value in network.state_dict().items():
        if value.dtype.is_floating_point:
            average[name].mul_(keep).add_(value, alpha=1 - keep)
        else:
            average[name].copy_(value)


def learning_rate(step: int, steps: int, peak: float = PEAK_RATE) -> float:
    return peak * min(1.0, (step + 1) / WARM_UP) * (0.5 * (1 + math.cos(math.pi * step / steps)) + 0.01)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--labels", type=Path, action="append", required=True, help="label file; may be repeated")
    parser.add_argument("--run", type=Path, required=True, help="folder for checkpoint.pt and log.jsonl")
    parser.add_argument("--network", choices=NETWORKS, default="small", help="(%(default)s)")
    parser.add_argument("--hold-out", default="", help="scenes not trained on, comma separated")
    parser.add_argument("--steps", type=int, default=7000)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="one where others use the cores too")
    parser.add_argument("--rate", type=float, default=PEAK_RATE, help="peak of the learning rate (%(default)s)")
    parser.add_argument(
        "--backbone-rate", type=float, default=0.25, help="share of it for what ImageNet taught (%(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0)
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--resume", action="store_true")
    start.add_argument(
        "--start",
        type=Path,
        metavar="CHECKPOINT|ONNX",
        help="begin with the average of another run, or what it exported",
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
    """A training run between two steps. kind : key of NETWORKS. average : exponential moving average of the weights."""

    kind: str
    network: torch.nn.Module
    optimiser: torch.optim.Optimizer
    average: dict[str, torch.Tensor]
    step: int = 0

    @classmethod
    def begun(cls, options: argparse.Namespace, training: list, device: str) -> State:
        """At step 0 with new, pretrained or given weights, or where the run's checkpoint ended.

        training : images of which a batch passes through a network that is read from ONNX (see `unfold`).
        """
        network = NETWORKS[options.network]()
        if isinstance(network, Finder) and not (options.start or options.resume):
            network.backbone.load_imagenet()
        network.to(device, memory_format=torch.channels_last)
        optimiser = optimiser_of(network, options.backbone_rate)
        state = cls(options.network, network, optimiser, copied(network.state_dict()))
        if options.start:
            state.take(options, training, device)
        elif options.resume:
            state.resume(options.run, device)
        return state

    def take(self, options: argparse.Namespace, training: list, device: str) -> None:
        """Take the averaged weights of another run, from its checkpoint or its exported file."""
        if options.start.suffix == ".onnx":
            sample = islice(crops(training, SCENE_WEIGHTS, options.seed), options.batch)
            seen = torch.stack([torch.from_numpy(image) for image, *_ in sample])
            average = unfolded(options.start, self.network, seen)
        else:
            average = torch.load(options.start, map_location=device)["average"]
        self.network.load_state_dict(average)
        self.average = copied(average)

    def resume(self, run: Path, device: str) -> None:
        """Go on from the checkpoint in `run`."""
        kept = torch.load(run / CHECKPOINT, map_location=device)
        self.network.load_state_dict(kept["network"])
        self.optimiser.load_state_dict(kept["optimiser"])
        self.average, self.step = kept["average"], kept["step"]

    def save(self, run: Path) -> None:
        """Write the checkpoint into `run`, whole or not at all."""
        kept = {
            "kind": self.kind, "step": self.step, "network": self.network.state_dict(), "average": self.average,
            "optimiser": self.optimiser.state_dict(),
        }  # fmt: skip
        partial = (run / CHECKPOINT).with_suffix(".partial")
        torch.save(kept, partial)
        partial.replace(run / CHECKPOINT)

    def learn(self, batch: list[torch.Tensor], rate: float, device: str) -> dict[str, torch.Tensor]:
        """One step at the learning rate `rate`; the parts of the loss."""
        for group in self.optimiser.param_groups:
            group["lr"] = group["share"] * rate
        image, *targets = (part.to(device, non_blocking=True) for part in batch)
        with in_16_bits(device):
            maps = self.network(image.contiguous(memory_format=torch.channels_last))
        parts = loss(maps.float(), *targets)
        self.optimiser.zero_grad()
        sum(parts.values()).backward()
        torch.nn.utils.clip_grad_norm_([p for p in self.network.parameters() if p.requires_grad], 5.0)
        self.optimiser.step()
        self.step += 1
        follow(self.average, self.network, min(0.999, (1 + self.step) / (10 + self.step)))
        return parts


def in_16_bits(device: str) -> torch.autocast:
    """Within it numbers have 16 bits where that does no harm: 1.4 to 1.7 times as fast on a core with AVX-512 BF16. A
    core without it would be ten times as slow, and keeps 32."""
    fast = device != "cpu" or torch.cpu.get_capabilities().get("avx512_bf16", False)
    return torch.autocast(device, torch.bfloat16, enabled=fast)


def copied(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in weights.items()}


def main() -> None:
    options = arguments()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    images = [image for file in options.labels for image in read_labels(file)]
    training, _ = split(images, set(filter(None, options.hold_out.split(","))))
    options.run.mkdir(parents=True, exist_ok=True)
    state = State.begun(options, training, device)
    state.network.train()
    loader = DataLoader(
        Crops(training, options.seed + 1000 * state.step), batch_size=options.batch, num_workers=options.workers,
        prefetch_factor=8 if options.workers else None,
    )  # fmt: skip
    log = Log(options.run, 100, options.batch, state.step, options.steps)
    for batch in loader:
        if state.step >= options.steps:
            break
        parts = state.learn(batch, learning_rate(state.step, options.steps, options.rate), device)
        log.add(state.step, {name: value.item() for name, value in parts.items()})
        if state.step % CHECKPOINT_EVERY == 0:
            state.save(options.run)
    state.save(options.run)


if __name__ == "__main__":
    main()
