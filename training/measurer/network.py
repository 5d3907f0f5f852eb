"""The measurer's network, and the likelihood by which it learns.

Residual stages reduce the crop to 1/16 and a feature pyramid brings it back to 1/2. Each edge is a distribution over
positions along its axis: features, gathered across the axis with a learnt weight, give one logit for each position, and
the distribution's mean is the edge (soft argmax), finer than a pixel. Its uncertainty follows from the crop as a whole
and from the distribution's own width. The kind follows from the crop as a whole and from the features at 1/4, where a
bed or a boot is some cells long. Learnt merely as a by-product of the edges, real pickups of the training data got a
share of 0.65 for pickup; with these features and as much weight as the edges, 0.8.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from orthoscale.detect.measurer import ANSWERS, CROP_HEIGHT, CROP_WIDTH
from training.network import Residual, conv, enlarge, stage

from .crops import NO_EDGES

FEATURES = 24  # of the map at half the crop's size
GATHERED = 3  # learnt weightings with which features are gathered across an axis, beside the plain mean
SMALLEST_SIGMA = 0.05  # [crop px]
DEGREES_OF_FREEDOM = 4.0  # of Student's t, so that a few gross errors do not dominate
# The median absolute error is 0.74 of the scale for Student's t with 4 degrees of freedom, and 0.674 of the standard
# deviation for a normal distribution: so the standard deviation as users understand it is 1.1 of the scale.
SIGMA_PER_SCALE = 1.1
TURN_SCALE = 0.1  # [rad] of the turn's output
KIND = 0.3  # weight of the kinds' part of the loss; an edge's part is 0.5 to 0.6 by itself


class Profile(nn.Module):
    """Features (n, c, positions, across) to logits of both edges (n, 2, positions)."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.weight = nn.Conv2d(inputs, GATHERED, 1)
        gathered = inputs * (GATHERED + 1)
        self.mix = nn.Sequential(
            nn.Conv1d(gathered, 48, 5, padding=2), nn.ReLU(True), nn.Conv1d(48, 32, 5, padding=2), nn.ReLU(True),
            nn.Conv1d(32, 2, 3, padding=1),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        weight = torch.softmax(self.weight(x), 3)
        parts = [x.mean(3)] + [(x * weight[:, k : k + 1]).sum(3) for k in range(GATHERED)]
        return self.mix(torch.cat(parts, 1))


class MeasureNet(nn.Module):
    """Crops (n, 3, CROP_HEIGHT, CROP_WIDTH), 0..255, to edges (n, 4), the logarithms of their scales (n, 4) [crop px],
    the turn (n, 1), its scale's logarithm (n, 1), logits of seen (n, 4) and kind (n, ANSWERS)."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(conv(3, 16, 2), Residual(16, 16))
        self.stage4 = stage(16, 40, 24, 2)
        self.stage8 = stage(40, 80, 48, 2)
        self.stage16 = stage(80, 128, 64, 2)
        self.lateral16, self.lateral8 = nn.Conv2d(128, 64, 1), nn.Conv2d(80, 64, 1)
        self.merge8, self.reduce8 = conv(64, 64), nn.Conv2d(64, 40, 1)
        self.lateral4, self.merge4 = nn.Conv2d(40, 40, 1), conv(40, 40)
        self.reduce4, self.lateral2 = nn.Conv2d(40, FEATURES, 1), nn.Conv2d(16, FEATURES, 1)
        self.merge2 = conv(FEATURES, FEATURES)
        self.along, self.across = Profile(FEATURES), Profile(FEATURES)
        cells = (CROP_HEIGHT // 16) * (CROP_WIDTH // 16)
        self.whole = nn.Sequential(nn.Linear(128 * cells, 64), nn.ReLU(True))
        self.rest = nn.Linear(64 + 4, 4 + 1 + 1 + 4 + len(ANSWERS))
        self.details = nn.Sequential(
            conv(40, 64, 2), Residual(64, 64), conv(64, 96, 2), nn.Flatten(), nn.Linear(96 * cells, 64),
            nn.ReLU(True), nn.Dropout(0.2), nn.Linear(64, 4 + len(ANSWERS)),
        )  # fmt: skip
        for name, size in (("x", CROP_WIDTH), ("y", CROP_HEIGHT)):
            places = torch.arange(size // 2) * 2.0 + 1.0 - size / 2
            self.register_buffer(name, places, persistent=False)

    def forward(self, crops: Tensor) -> tuple[Tensor, ...]:
        # The place of an edge does not depend on light, haze and contrast.
        mean = crops.mean((1, 2, 3), keepdim=True)
        sd = ((crops - mean) ** 2).mean((1, 2, 3), keepdim=True).sqrt()
        s2 = self.stem((crops - mean) / (sd + 4.0))
        s4 = self.stage4(s2)
        s8 = self.stage8(s4)
        s16 = self.stage16(s8)
        f = self.merge8(self.lateral8(s8) + enlarge(self.lateral16(s16)))
        f = self.merge4(self.lateral4(s4) + enlarge(self.reduce8(f)))
        seen_there, kind_there = self.details(f).float().split([4, len(ANSWERS)], 1)
        f = self.merge2(self.lateral2(s2) + enlarge(self.reduce4(f)))
        ends, end_widths = _mean_and_width(self.along(f.transpose(2, 3)).float(), self.x)
        sides, side_widths = _mean_and_width(self.across(f).float(), self.y)
        whole = self.whole(s16.flatten(1)).float()
        widths = torch.cat([end_widths, side_widths], 1).log()
        rest = self.rest(torch.cat([whole, widths], 1))
        scale, turn, turn_scale, seen, kind = rest.split([4, 1, 1, 4, len(ANSWERS)], 1)
        edges = torch.cat([ends, sides], 1)
        return edges, scale + widths, TURN_SCALE * turn, turn_scale - 2.5, seen + seen_there, kind + kind_there


def _mean_and_width(logits: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (n, 2) of distributions over `places` (p,) with the given logits (n, 2, p)."""
    share = torch.softmax(logits, 2)
    mean = (share * places).sum(2)
    variance = (share * (places - mean[..., None]) ** 2).sum(2)
    return mean, (variance + 0.25).sqrt()


class Mirrored(nn.Module):
    """The network's results averaged over the crop's four mirrors, ready for use: edges and sigmas [crop px], turn
    [rad], seen and kind as probabilities. If the mirrors disagree, their spread is added to sigma."""

    def __init__(self, network: MeasureNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, crops: Tensor) -> tuple[Tensor, ...]:
        n = crops.shape[0]
        both = torch.cat([crops, crops.flip(3)], 0)
        edges, scale, turn, _, seen, kind = self.network(torch.cat([both, both.flip(2)], 0))
        sigma = SIGMA_PER_SCALE * scale.exp().clamp(min=SMALLEST_SIGMA)
        views = []
        for k, (x, y) in enumerate([(False, False), (True, False), (False, True), (True, True)]):
            order = [1, 0] * x + [0, 1] * (not x) + [3, 2] * y + [2, 3] * (not y)
            sign = torch.tensor([-1.0 if x else 1.0] * 2 + [-1.0 if y else 1.0] * 2)
            part = slice(k * n, (k + 1) * n)
            views.append(
                (edges[part][:, order] * sign, sigma[part][:, order], turn[part][:, 0] * (1.0 if x == y else -1.0),
                 torch.sigmoid(seen[part][:, order]), torch.softmax(kind[part], 1))
            )  # fmt: skip
        edges, sigma, turn, seen, kind = (torch.stack(each) for each in zip(*views, strict=True))
        spread = ((edges - edges.mean(0)) ** 2).mean(0)
        return edges.mean(0), (sigma.mean(0) ** 2 + spread).sqrt(), turn.mean(0), seen.mean(0), kind.mean(0)


class Habits(nn.Module):
    """Properties of the labels of each real scene, learnt together with the network and discarded afterwards: by how
    much vehicles are longer and wider than their boxes [px of the picture], and the scatter of edges [px]."""

    def __init__(self, scenes: int) -> None:
        super().__init__()
        self.margin = nn.Parameter(torch.zeros(scenes, 2))
        self.stray = nn.Parameter(torch.full((scenes, 2), 0.3))  # logarithm

    def forward(self, scene: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
        """Outward shift and scatter of edges (n, 4) [crop px] for examples of `scene` (n,); zero for negative ones."""
        real = (scene >= 0).float()[:, None] * step[:, None]
        margin, stray = (p[scene.clamp(min=0)].repeat_interleave(2, 1) for p in (self.margin / 2, self.stray.exp()))
        return margin * real * torch.tensor([-1.0, 1.0, -1.0, 1.0]), stray * real


def loss(outputs: tuple[Tensor, ...], habits: Habits, batch: dict[str, Tensor]) -> dict[str, Tensor]:
    """Parts of the loss by name; their sum is the loss. Edges and turn: negative log likelihood of Student's t with the
    predicted scale; an edge that is not seen counts a fifth. Seen and kind: cross entropy. For NO_EDGES, only kind."""
    edges, scale, turn, turn_scale, seen, kind = outputs
    vehicle = ((batch["kind"] != ANSWERS.index("none")) & (batch["scene"] != NO_EDGES)).float()
    outward, stray = habits(batch["scene"], batch["step"])
    error = edges - (batch["edges"] + outward)
    scale = torch.sqrt(scale.exp().clamp(min=SMALLEST_SIGMA) ** 2 + stray**2)
    inside = (
        batch["edges"].abs() < torch.tensor([CROP_WIDTH / 2, CROP_WIDTH / 2, CROP_HEIGHT / 2, CROP_HEIGHT / 2])
    ).float()
    weight = vehicle[:, None] * inside * (0.2 + 0.8 * batch["seen"])
    # Angles of real labels scatter by a degree or two.
    turn_scale = torch.sqrt(turn_scale[:, 0].exp() ** 2 + (0.03 * (batch["scene"] >= 0)) ** 2 + 0.003**2)
    known = batch["kind"] >= 0
    # The kind of most real vehicles is unknown; only that they are vehicles is known.
    is_none = F.log_softmax(kind, 1)[:, -1]
    told = F.cross_entropy(kind[known], batch["kind"][known], reduction="sum")
    some = -torch.log1p(-is_none[~known].exp().clamp(max=1 - 1e-6)).sum()
    in_sight = F.binary_cross_entropy_with_logits(seen, batch["seen"], reduction="none")
    vehicles = vehicle.sum().clamp(min=1)
    return {
        "edges": (weight * _student(error, scale)).sum() / weight.sum().clamp(min=1),
        "turn": 0.3 * (vehicle * _student(turn[:, 0] - batch["turn"], turn_scale)).sum() / vehicles,
        "seen": 0.6 * (vehicle[:, None] * in_sight).mean(),
        "kind": KIND * (told + some) / len(kind),
    }


def _student(error: Tensor, scale: Tensor) -> Tensor:
    nu = DEGREES_OF_FREEDOM
    return scale.log() + (nu + 1) / 2 * torch.log1p((error / scale) ** 2 / nu)
