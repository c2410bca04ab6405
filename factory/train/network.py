"""Networks of the baselines: an image encoder, an LSTM over the instruction, and a head. Imports torch.

The instruction modulates the later stages of the encoder (FiLM) and predicts a mask of the target; the head receives
the features under the mask, their position, and the global features. Import this module only to use a network.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from factory.train.efficientnet import COARSE, FINE, MIDDLE, EfficientNetLite0
from factory.train.options import BcOptions
from schemas.tokens import GRID_POINTS

_CELLS = GRID_POINTS * GRID_POINTS
_GROUPS = 4
_STATE, _DEPTH, _NEAR, _WIDE, _TRUNK = 64, 32, 96, 192, 256
"""Widths of `PolicyNetwork`: of the instruction state, of the depth's features, and of its stages."""
GOAL_SCALE_M = 2.0
"""Unit of the distance in `NetworkOutput.goal`."""


class NetworkOutput(NamedTuple):
    """Network output for N frames."""

    action: Tensor
    """(N, 2) v / maximum speed, 0..1, and w / maximum yaw rate, -1..1; continuous head only."""
    stop: Tensor
    """(N,) stop logits; continuous head only."""
    # near the goal, a regressed speed would be the mean of driving and stopping, which is correct for neither
    cells: Tensor
    """(N, 49) logits of the grid points, at index 7 * token of v + token of w; token head only."""
    mask: Tensor
    """(N, S/8, S/8) logits of the target mask."""
    goal: Tensor
    """(N, 3) distance to the target / `GOAL_SCALE_M`, and cosine and sine of its bearing; (N, 0) from `BcNetwork`."""


def make_network(options: BcOptions, words: int) -> Network:
    """Returns the network of a training, with random weights.

    Args:
        options: Training options, with encoder, size and head.
        words: Size of the vocabulary.
    """
    return BcNetwork(options, words) if options.encoder == "residual" else PolicyNetwork(options, words)


class Network(nn.Module):  # type: ignore[misc]
    """Network from pictures (N, 4, S, S) and tokens (N, W) to actions."""

    def __init__(self, options: BcOptions, words: int) -> None:
        super().__init__()
        self._is_tokens = options.head == "tokens"
        self.embedding = nn.Embedding(words, 32, padding_idx=0)
        self.reader = nn.LSTM(32, _STATE, batch_first=True)

    def _read(self, words: Tensor) -> Tensor:
        """Returns the LSTM state after the last word, (N, 64)."""
        states, _ = self.reader(self.embedding(words))
        last = (words != 0).sum(dim=1).clamp(min=1) - 1
        return states[torch.arange(len(words), device=words.device), last]


class PolicyNetwork(Network):
    """Network of `train policy`: EfficientNet-Lite0 for the colours, and a separate decision to stop."""

    def __init__(self, options: BcOptions, words: int) -> None:
        super().__init__(options, words)
        self.encoder = EfficientNetLite0()
        self.depth = nn.Sequential(
            *(nn.Conv2d(1, 16, 5, stride=4, padding=2, bias=False), nn.GroupNorm(_GROUPS, 16), nn.ReLU()),
            *(nn.Conv2d(16, _DEPTH, 3, stride=2, padding=1, bias=False), nn.GroupNorm(_GROUPS, _DEPTH), nn.ReLU()),
        )
        self.lateral = nn.Conv2d(MIDDLE, _STATE, 1)
        self.join = _Block(FINE + _STATE + _DEPTH + 2, _NEAR, 1, _STATE)
        self.look = _Block(_NEAR, _NEAR, 1, _STATE)
        self.pointer = nn.Conv2d(_NEAR, 1, 1)
        self.wide = _Block(COARSE + _NEAR, _WIDE, 1, _STATE)
        self.trunk = nn.Sequential(
            *(nn.Linear(_WIDE + _NEAR + 4 + _STATE, _TRUNK), nn.ReLU()),
            *(nn.Linear(_TRUNK, _TRUNK), nn.ReLU()),
        )
        self.goal = nn.Linear(_TRUNK, 3)
        self.twist = nn.Linear(_TRUNK, _CELLS if self._is_tokens else 2)
        self.stop = nn.Sequential(nn.Linear(_TRUNK + 3, _STATE), nn.ReLU(), nn.Linear(_STATE, 1))

    def forward(self, pictures: Tensor, words: Tensor) -> NetworkOutput:
        """Returns the actions, the target mask and the place of the target.

        Args:
            pictures: (N, 4, S, S) output of `preprocess.to_input`, sRGB and nearness; S is a multiple of 32.
            words: (N, L) token indices, padded with 0.
        """
        state = self._read(words)
        seen = self.encoder(pictures[:, :3])
        middle = functional.interpolate(self.lateral(seen.middle), scale_factor=2, mode="nearest")
        joined = torch.cat([seen.fine, middle, self.depth(pictures[:, 3:])], dim=1)
        near = self.look(self.join(_with_positions(joined), state), state)
        mask = self.pointer(near)
        low = functional.avg_pool2d(near, 4)
        wide = self.wide(torch.cat([seen.coarse, low], dim=1), state).mean(dim=(2, 3))
        trunk = self.trunk(torch.cat([wide, _attend(near, mask, pictures[:, 3:]), state], dim=1))
        goal, out = self.goal(trunk), self.twist(trunk)
        empty = out.new_zeros((len(out), 0))
        if self._is_tokens:
            return NetworkOutput(empty, empty, out, mask[:, 0], goal)
        action = torch.stack([torch.sigmoid(out[:, 0]), torch.tanh(out[:, 1])], dim=1)
        # the stop depends on the distance, which the labels of the goal teach in every frame
        stop = self.stop(torch.cat([trunk, goal.detach()], dim=1))
        return NetworkOutput(action, stop[:, 0], empty, mask[:, 0], goal)


class BcNetwork(Network):
    """Network of `train bc`: a small residual encoder.

    Args:
        options: Training options, with size and head.
        words: Size of the vocabulary.
    """

    def __init__(self, options: BcOptions, words: int) -> None:
        super().__init__(options, words)
        width = options.width
        self.stem = nn.Sequential(
            nn.Conv2d(4, width, 5, stride=2, padding=2, bias=False), nn.GroupNorm(_GROUPS, width), nn.ReLU()
        )
        self.stage1 = _Block(width, width, 2, 64)
        self.stage2 = _Block(width, 2 * width, 2, 64)
        self._has_positions = options.positions
        self.look = _Block(2 * width + (2 if options.positions else 0), 2 * width, 1, 64)
        self.stage3 = _Block(2 * width, 4 * width, 2, 64)
        self.stage4 = _Block(4 * width, 4 * width, 2, 64)
        self.pointer = nn.Conv2d(2 * width, 1, 1)
        self.trunk = nn.Sequential(
            nn.Linear(4 * width + 2 * width + 4 + 64, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU()
        )
        self.twist = nn.Linear(128, _CELLS if self._is_tokens else 3)

    def forward(self, pictures: Tensor, words: Tensor) -> NetworkOutput:
        """Returns the actions and the target mask.

        Args:
            pictures: (N, 4, S, S) output of `preprocess.to_input`, sRGB and nearness.
            words: (N, L) token indices, padded with 0.
        """
        instruction_state = self._read(words)
        low = self.stage2(self.stage1(self.stem(pictures), instruction_state), instruction_state)
        near = self.look(_with_positions(low) if self._has_positions else low, instruction_state)
        mask = self.pointer(near)
        wide = self.stage4(self.stage3(near, instruction_state), instruction_state).mean(dim=(2, 3))
        pointed = _attend(near, mask, pictures[:, 3:])
        out = self.twist(self.trunk(torch.cat([wide, pointed, instruction_state], dim=1)))
        empty = out.new_zeros((len(out), 0))
        if self._is_tokens:
            return NetworkOutput(empty, empty, out, mask[:, 0], empty)
        action = torch.stack([torch.sigmoid(out[:, 0]), torch.tanh(out[:, 1])], dim=1)
        return NetworkOutput(action, out[:, 2], empty, mask[:, 0], empty)


class _Block(nn.Module):  # type: ignore[misc]
    """Residual block with FiLM: two convolutions and a shortcut, scaled and shifted by the instruction state."""

    def __init__(self, into: int, out: int, stride: int, instruction_state: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(into, out, 3, stride=stride, padding=1, bias=False)
        self.norm1 = nn.GroupNorm(_GROUPS, out)
        self.conv2 = nn.Conv2d(out, out, 3, padding=1, bias=False)
        self.norm2 = nn.GroupNorm(_GROUPS, out)
        self.film = nn.Linear(instruction_state, 2 * out)
        nn.init.zeros_(self.film.weight)
        nn.init.zeros_(self.film.bias)
        plain = into == out and stride == 1
        self.around = nn.Identity() if plain else nn.Conv2d(into, out, 1, stride=stride, bias=False)

    def forward(self, x: Tensor, instruction_state: Tensor) -> Tensor:
        """Returns (N, out, H / stride, W / stride) features.

        Args:
            x: (N, into, H, W) features.
            instruction_state: (N, instruction_state) LSTM state after the last word.
        """
        scale, shift = self.film(instruction_state)[:, :, None, None].chunk(2, dim=1)
        y = functional.relu(self.norm1(self.conv1(x)))
        y = self.norm2(self.conv2(y)) * (1 + scale) + shift
        return functional.relu(y + self.around(x))


def _with_positions(features: Tensor) -> Tensor:
    """Returns the features with the column and the row of each cell, from -1 to 1, as channels, (N, C + 2, H, W)."""
    n, _, rows, columns = features.shape
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, rows, device=features.device),
        torch.linspace(-1, 1, columns, device=features.device),
        indexing="ij",
    )
    return torch.cat([features, x.expand(n, 1, -1, -1), y.expand(n, 1, -1, -1)], dim=1)


def _attend(features: Tensor, mask: Tensor, nearness: Tensor) -> Tensor:
    """Returns the features pooled under the mask, with position, nearness and mask size, (N, C + 4)."""
    n, _, rows, columns = features.shape
    share = torch.softmax(mask.reshape(n, 1, rows * columns), dim=2)
    near = functional.adaptive_avg_pool2d(nearness, (rows, columns))
    size = torch.sigmoid(mask).mean(dim=(2, 3))
    maps: Any = torch.cat([_with_positions(features), near], dim=1)
    pooled = (maps.reshape(n, -1, rows * columns) * share).sum(dim=2)
    return torch.cat([pooled, size], dim=1)
