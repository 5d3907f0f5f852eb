"""Fully convolutional networks down to stride 16 or 32, and a feature pyramid back up to stride 4.

`VehicleNet` is small and starts from random weights; `Finder` has a backbone that was pretrained on ImageNet.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from . import lite0


def conv(inputs: int, outputs: int, stride: int = 1, size: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(True)
    )


class Residual(nn.Module):
    def __init__(self, channels: int, inner: int):
        super().__init__()
        self.first = conv(channels, inner)
        self.second = nn.Sequential(nn.Conv2d(inner, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.second(self.first(x)))


def stage(inputs: int, outputs: int, inner: int, blocks: int) -> nn.Sequential:
    return nn.Sequential(conv(inputs, outputs, 2), *(Residual(outputs, inner) for _ in range(blocks)))


class Pyramid(nn.Module):
    """Leads from features at stride 16 back up to stride 4, and to maps (n, 7, h/4, w/4) as `targets` describes them.

    lateral8, lateral4 : layers that bring the features at strides 8 and 4 to 32 channels.
    """

    def __init__(self, lateral8: nn.Module, lateral4: nn.Module) -> None:
        super().__init__()
        self.merge16 = conv(64, 64)
        self.reduce16 = nn.Conv2d(64, 32, 1)
        self.lateral8 = lateral8
        self.merge8 = conv(32, 32)
        self.lateral4 = lateral4
        self.merge4 = conv(32, 32)
        self.head = conv(32, 16)
        self.maps = nn.Conv2d(16, 7, 1)
        nn.init.zeros_(self.maps.bias)
        nn.init.constant_(self.maps.bias[:1], -4.6)  # a heat of 0.01 everywhere at the start

    def climb(self, x16: Tensor, s8: Tensor, s4: Tensor) -> Tensor:
        """The maps from 64 channels at stride 16 and the features at strides 8 and 4."""
        x = self.merge16(x16)
        x = self.merge8(self.lateral8(s8) + enlarge(self.reduce16(x)))
        x = self.merge4(self.lateral4(s4) + enlarge(x))
        return self.maps(self.head(x))


class VehicleNet(Pyramid):
    """RGB (n, 3, h, w) in 0..1, h and w multiples of 32, to maps (n, 7, h/4, w/4) as `targets` describes them."""

    def __init__(self) -> None:
        super().__init__(nn.Conv2d(48, 32, 1), nn.Conv2d(32, 32, 1))
        self.stem = conv(3, 16, 2)
        self.stage4 = stage(16, 32, 16, 1)
        self.stage8 = stage(32, 48, 32, 2)
        self.stage16 = stage(48, 96, 48, 2)
        self.stage32 = stage(96, 128, 64, 2)
        self.lateral32 = nn.Conv2d(128, 64, 1)
        self.lateral16 = nn.Conv2d(96, 64, 1)

    def forward(self, image: Tensor) -> Tensor:
        s4 = self.stage4(self.stem(image))
        s8 = self.stage8(s4)
        s16 = self.stage16(s8)
        s32 = self.stage32(s16)
        return self.climb(self.lateral16(s16) + enlarge(self.lateral32(s32)), s8, s4)


class Finder(Pyramid):
    """Makes the same maps with a backbone pretrained on ImageNet (`lite0`); h and w multiples of 16.

    The features differ in size from stride to stride (standard deviations of 5 to 11), so each is normalised.
    """

    def __init__(self) -> None:
        s4, s8, s16 = lite0.CHANNELS
        super().__init__(lateral(s8, 32), lateral(s4, 32))
        self.backbone = lite0.Lite0()
        self.lateral16 = lateral(s16, 64)

    def forward(self, image: Tensor) -> Tensor:
        s4, s8, s16 = self.backbone(image)
        return self.climb(self.lateral16(s16), s8, s4)


NETWORKS: dict[str, type[Pyramid]] = {"small": VehicleNet, "lite0": Finder}


def lateral(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1, bias=False), nn.BatchNorm2d(outputs))


def enlarge(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")


def loss(maps: Tensor, heat: Tensor, background: Tensor, values: Tensor, value_weight: Tensor) -> dict[str, Tensor]:
    """Parts of the loss by name; their sum is the loss. Penalty-reduced focal loss on the heat (Zhou et al. 2019,
    Objects as Points, eq. 1; alpha 2, beta 4) and weighted L1 on the values; sizes count four times, because a ruler
    needs them most. Vehicles count by their weight in both."""
    logits = maps[:, 0]
    p = torch.sigmoid(logits)
    peak = heat > 0.999
    weight = value_weight * peak
    hit = F.logsigmoid(logits) * (1 - p) ** 2 * weight
    miss = F.logsigmoid(-logits) * p**2 * (1 - heat) ** 4 * ~peak * background
    error = (maps[:, 1:] - values).abs() * value_weight[:, None] / value_weight.sum().clamp(min=1)
    return {
        "heat": -hit.sum() / weight.sum().clamp(min=1) - miss.sum() / peak.sum().clamp(min=1),
        "offset": 0.5 * error[:, :2].sum(),
        "size": 4.0 * error[:, 2:4].sum(),
        "angle": error[:, 4:].sum(),
    }
