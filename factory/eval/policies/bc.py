"""Policy with a trained behaviour cloning network: runs the network every few steps, holds the twist, and stops at the
target.

Loads the checkpoint on construction. Uses camera and instruction only.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from factory.eval.driving.policy import EpisodeInfo, PolicyInput
from factory.eval.models.result import Attention, TrainingNote
from factory.train import preprocess
from factory.train.checkpoint import POLICY, checkpoint_path, read_checkpoint
from factory.train.torch_import import load_torch
from factory.train.vocabulary import encode
from schemas.errors import UsageError
from schemas.tokens import V_GRID_MPS, W_GRID_RPS

STOPS_REQUIRED = 2
"""Consecutive stop predictions after which the robot stops. A robot that stopped after a single wrong prediction would
see the same view again and never move."""
_STOP_CELL = 3


def bc_file(name: str) -> Path:
    """Returns the checkpoint file for the text after `bc:`.

    Raises:
        UsageError: The file does not exist.
    """
    if not name:
        raise UsageError("policy bc needs a folder: write bc:OUT with the OUT of `factory train bc -o OUT`")
    path = checkpoint_path(Path(name))
    if not path.is_file():
        raise UsageError(f"checkpoint {path} does not exist; `factory train bc DIR -o OUT` creates OUT/{POLICY}")
    return path


def _peak(logits: NDArray[np.float32]) -> Attention:
    """Returns the most likely cell of a pointer map: its centre as fractions of the image, and the share of the target
    that the network expects in it."""
    row, column = divmod(int(logits.argmax()), logits.shape[1])
    confidence = 1 / (1 + math.exp(-float(np.clip(logits[row, column], -50, 50))))
    return (column + 0.5) / logits.shape[1], (row + 0.5) / logits.shape[0], confidence


class BcPolicy:
    """Behaviour cloning policy, trained by `factory train bc`.

    Each call of `act` returns one action, repeated for the number of steps for which actions were held in training. The
    control rate must be that of the training.

    Args:
        name: Training folder, or its `policy.pt`.
    """

    knows: ClassVar[str] = "camera and instruction"
    needs: ClassVar[tuple[str, ...]] = ("rgb", "depth")
    """Inputs without which the policy is refused."""

    def __init__(self, name: str) -> None:
        torch = self._torch = load_torch()
        path = bc_file(name)
        from factory.train.network import make_network

        torch.set_num_threads(1)  # a driver process uses one core
        checkpoint = read_checkpoint(path)
        self.meta = checkpoint.meta
        self.training = TrainingNote(digest=self.meta.train_digest, episodes=self.meta.train_episodes)
        self.training_starts = self.meta.starts
        self._network = make_network(self.meta.options, len(self.meta.words))
        try:
            self._network.load_state_dict(checkpoint.tensors["model"])
        except (KeyError, RuntimeError, AttributeError) as error:
            first = (str(error).splitlines() or ["no reason given"])[0]
            raise UsageError(
                f"the weights in {name} do not fit the network that its metadata describes ({first}): train it again"
            ) from error
        self._network.eval()
        self._scale = np.array((self.meta.max_speed_mps, self.meta.max_yaw_rate_rps), np.float32)

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Encodes the instruction and starts an episode.

        Raises:
            UsageError: The camera or the control rate differs from the training.
        """
        mine, theirs = (self.meta.control_hz, self.meta.fov_deg), (info.control_hz, info.fov_deg)
        if mine != theirs:
            raise UsageError(
                f"the policy was trained at {mine[0]} Hz with a field of view of {mine[1]:g} degrees, but the episodes "
                f"have {theirs[0]} Hz and {theirs[1]:g} degrees: train on episodes with the same rate and camera"
            )
        words = encode(instruction, self.meta.words, self.meta.options.ablate_language)
        self._words = self._torch.from_numpy(words[None])
        self._stops = 0
        self.attention: Attention | None = None

    def act(self, observation: PolicyInput) -> NDArray[np.float32]:
        """Returns an action chunk, (hold, 2) twists."""
        size = self.meta.options.size
        picture = preprocess.to_input(
            preprocess.shrink_rgb(observation["rgb"], size)[None],
            preprocess.shrink_depth(observation["depth"], size)[None],
        )
        with self._torch.inference_mode():
            answer = self._network(self._torch.from_numpy(picture), self._words)
        if self.meta.options.mask_weight:  # otherwise the map was not trained
            self.attention = _peak(answer.mask[0].numpy())
        twist, is_stop = self._decide(answer)
        self._stops = self._stops + 1 if is_stop else 0
        if self._stops >= STOPS_REQUIRED:
            twist = np.zeros(2, np.float32)
        return np.tile(twist, (self.meta.options.hold, 1))

    def _decide(self, answer: Any) -> tuple[NDArray[np.float32], bool]:
        """Returns the twist, and whether the network predicts a stop."""
        if self.meta.options.head == "tokens":
            cells = answer.cells[0].numpy().copy()
            is_stop = int(cells.argmax()) == _STOP_CELL
            cells[_STOP_CELL] = -np.inf
            v, w = divmod(int(cells.argmax()), len(W_GRID_RPS))
            return np.array((V_GRID_MPS[v], W_GRID_RPS[w]), np.float32), is_stop
        twist: NDArray[np.float32] = answer.action[0].numpy() * self._scale
        return twist, float(answer.stop[0]) > 0
