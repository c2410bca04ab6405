"""Training loop: epochs over frames, validation, and the state from which a training resumes. Accesses no files.

The random numbers of an epoch depend on (seed, epoch) only, so a training that was interrupted after an epoch and
resumed produces the same weights, bit for bit, on the same device with the same number of threads.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from factory.dataset.sampler import shuffle_by_scene
from factory.train import preprocess
from factory.train.efficientnet import EfficientNetLite0, load_weights
from factory.train.frames import TrainingFrames
from factory.train.measures import EpochMeasures
from factory.train.network import GOAL_SCALE_M, Network, NetworkOutput, make_network
from factory.train.options import BcOptions, ema_decay, learning_rate
from factory.train.preprocess import Batch, augment
from factory.train.vocabulary import encode, mirrored_words
from schemas.tokens import V_GRID_MPS, W_GRID_RPS, tokens_of

_STOP_CELL = 3
"""Index of the grid cell with v = 0 and w = 0: tokens 0 and 3."""
_WARMUP_SHARE = 0.05
_SHOWN = 0.05
"""Share of a mask cell that shows the target from which the target counts as visible in it."""
_MOST_NORM = 1.0
_GOAL_WEIGHT = 0.5
_PRETRAINED_RATE = 0.3
"""Learning rate of pretrained weights, as a share of that of the others."""
LossCallback = Callable[[int, int, float], None]
_MEASURES = ("val_loss", "val_v_mps", "val_w_rps", "stop_precision", "stop_recall", "pointing")


@dataclass(frozen=True)
class TrainingLimits:
    """Full-scale values of the actions."""

    max_speed_mps: float
    max_yaw_rate_rps: float


class BcTraining:
    """Training state: the weights, their moving average, the optimiser, and the number of finished epochs.

    Args:
        options: Training options.
        words: Vocabulary.
        limits: Action limits of the robot.
        device: Torch device.
    """

    def __init__(self, options: BcOptions, words: tuple[str, ...], limits: TrainingLimits, device: Any) -> None:
        self._options, self._words, self._limits, self._device = options, words, limits, device
        torch.manual_seed(options.seed)
        self._mirrored_words = mirrored_words(words)
        self.model = make_network(options, len(words))
        self._is_pretrained = isinstance(getattr(self.model, "encoder", None), EfficientNetLite0)
        if self._is_pretrained:
            load_weights(self.model.encoder)
            self.model.to(memory_format=torch.channels_last)  # 1.2 to 1.4 times as fast on CPUs
        self.model.to(device)
        self.mean = copy.deepcopy(self.model).requires_grad_(False)
        self._optimizer = torch.optim.AdamW(
            _groups(self.model, self._is_pretrained), lr=options.peak_rate, weight_decay=options.weight_decay
        )
        self.epochs_done = 0
        self._steps_done = 0

    @property
    def parameters(self) -> int:
        """Number of trainable parameters."""
        return sum(parameter.numel() for parameter in self.model.parameters())

    def state(self) -> dict[str, Any]:
        """Returns the state needed to resume, as tensors and plain values."""
        return {
            "moving": self.model.state_dict(),
            "model": self.mean.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "epochs_done": self.epochs_done,
            "steps_done": self._steps_done,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a state returned by `state`."""
        self.model.load_state_dict(state["moving"])
        self.mean.load_state_dict(state["model"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.epochs_done, self._steps_done = int(state["epochs_done"]), int(state["steps_done"])

    def run_epoch(self, train: TrainingFrames, val: TrainingFrames | None, tell: LossCallback) -> EpochMeasures:
        """Trains for one epoch and validates the averaged weights.

        Args:
            train: Training frames.
            val: Validation frames; `None` skips the validation.
            tell: Progress callback, called with finished and total batches, and the mean loss.
        """
        start_s = time.monotonic()
        rng = np.random.default_rng((self._options.seed, self.epochs_done))
        order = np.concatenate(shuffle_by_scene(train.scene, rng))
        sentences = self._sentences(train)
        batches = max(1, len(order) // self._options.batch)
        steps = batches * self._options.epochs
        losses = 0.0
        rate = 0.0
        self.model.train()
        for number, rows in enumerate(np.array_split(order, batches)):
            rate = learning_rate(self._steps_done, steps, self._options.peak_rate, max(1, int(_WARMUP_SHARE * steps)))
            batch = augment(_read(train, np.sort(rows), sentences), rng, self._mirrored_words)
            losses += self._step(batch, rate)
            tell(number + 1, batches, losses / (number + 1))
        self.epochs_done += 1
        measured = {} if val is None else self._measure(val)
        return EpochMeasures(
            epoch=self.epochs_done,
            train_loss=losses / batches,
            **{name: measured.get(name) for name in _MEASURES},
            rate=rate,
            seconds=time.monotonic() - start_s,
        )

    def try_step(self, train: TrainingFrames, rows: NDArray[np.int64]) -> None:
        """Makes one training step at the peak learning rate, to measure its time.

        Args:
            train: Training frames.
            rows: Frames of the step.
        """
        self.model.train()
        self._step(_read(train, rows, self._sentences(train)), self._options.peak_rate)

    def _step(self, batch: Batch, rate: float) -> float:
        for group in self._optimizer.param_groups:
            group["lr"] = rate * group.get("share", 1.0)
        answer = self._answer(self.model, batch)
        loss = self._imitation(answer, batch).mean()
        if self._options.mask_weight:
            loss = loss + self._options.mask_weight * _mask_loss(answer.mask, self._tensor(batch.mask))
        if answer.goal.shape[1]:
            loss = loss + _GOAL_WEIGHT * _goal_loss(answer.goal, self._tensor(batch.goal), self._tensor(batch.mask))
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), _MOST_NORM)
        self._optimizer.step()
        keep = ema_decay(self._steps_done, self._options.ema)
        with torch.no_grad():
            for mean, moving in zip(self.mean.parameters(), self.model.parameters(), strict=True):
                mean.lerp_(moving, 1 - keep)
        self._steps_done += 1
        return float(loss.detach())

    def _answer(self, network: Network, batch: Batch) -> NetworkOutput:
        """Returns the output of a network in float32; pretrained encoders compute in bfloat16 on a GPU."""
        pictures, words = self._tensor(batch.pictures), self._tensor(batch.words)
        if not self._is_pretrained:
            return NetworkOutput(*network(pictures, words))
        device = pictures.device.type
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            answer = network(pictures.to(memory_format=torch.channels_last), words)
        return NetworkOutput(*(part.float() for part in answer))

    def _imitation(self, answer: NetworkOutput, batch: Batch) -> Tensor:
        """Returns the imitation loss of each frame, (N,)."""
        is_stop, has_stop, has_twist = (
            self._tensor(column.astype(np.float32)) for column in (batch.is_stop, batch.has_stop, batch.has_twist)
        )
        weight = (1 + (self._options.stop_weight - 1) * is_stop) * has_stop
        if self._options.head == "tokens":
            tokens = tokens_of(batch.actions).astype(np.int64)
            cells = self._tensor(tokens[:, 0] * len(W_GRID_RPS) + tokens[:, 1])
            return functional.cross_entropy(answer.cells, cells, reduction="none", label_smoothing=0.02) * weight
        scale = np.array((self._limits.max_speed_mps, self._limits.max_yaw_rate_rps), np.float32)
        wanted = self._tensor(batch.actions / scale)
        twist = functional.smooth_l1_loss(answer.action, wanted, reduction="none", beta=0.1).sum(dim=1)
        stop = functional.binary_cross_entropy_with_logits(answer.stop, is_stop, reduction="none")
        return 5 * twist * has_twist + stop * weight

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _measure(self, val: TrainingFrames) -> dict[str, float | None]:
        self.mean.eval()
        sentences = self._sentences(val)
        losses, drives, stops, pointed = [], [], [], []
        for rows in _blocks(len(val), self._options.batch):
            batch = _read(val, rows, sentences)
            answer = self._answer(self.mean, batch)
            losses.append(self._imitation(answer, batch).cpu().numpy())
            action, stop = self._decide(answer)
            drives.append(np.abs(action - batch.actions)[batch.has_twist])
            stops.append(np.stack([stop, batch.is_stop])[:, batch.has_stop])
            pointed.append(_pointing(answer.mask.cpu().numpy(), batch.mask))
        said_stop, is_stop = np.concatenate(stops, axis=1)
        hits = int((said_stop & is_stop).sum())
        is_hit = np.concatenate(pointed)
        v, w = np.concatenate(drives).mean(axis=0) if any(map(len, drives)) else (None, None)
        return {
            "val_loss": float(np.concatenate(losses).mean()),
            "val_v_mps": None if v is None else float(v),
            "val_w_rps": None if w is None else float(w),
            "stop_precision": hits / int(said_stop.sum()) if said_stop.any() else None,
            "stop_recall": hits / int(is_stop.sum()) if is_stop.any() else None,
            "pointing": float(is_hit.mean()) if len(is_hit) else None,
        }

    def _decide(self, answer: NetworkOutput) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Returns the twists, (N, 2), and whether each is a stop, (N,)."""
        if self._options.head == "tokens":
            cells = answer.cells.argmax(dim=1).cpu().numpy()
            v, w = np.divmod(cells, len(W_GRID_RPS))
            return np.stack([V_GRID_MPS[v], W_GRID_RPS[w]], axis=1).astype(np.float32), cells == _STOP_CELL
        scale = np.array((self._limits.max_speed_mps, self._limits.max_yaw_rate_rps), np.float32)
        action: NDArray[np.float32] = answer.action.cpu().numpy() * scale
        return action, (answer.stop > 0).cpu().numpy()

    def _sentences(self, frames: TrainingFrames) -> NDArray[np.int64]:
        """Returns the token indices of the instruction of every episode, (E, W)."""
        ablate = self._options.ablate_language
        return np.stack([encode(episode.instruction, self._words, ablate) for episode in frames.index.episodes])

    def _tensor(self, array: NDArray[Any]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device)


def _groups(model: Network, is_pretrained: bool) -> list[dict[str, Any]]:
    """Returns the parameters as groups of the optimiser; those of a pretrained encoder have a lower learning rate."""
    if not is_pretrained:
        return [{"params": list(model.parameters())}]
    encoder = list(model.encoder.parameters())
    known = set(map(id, encoder))
    others = [parameter for parameter in model.parameters() if id(parameter) not in known]
    return [{"params": others}, {"params": encoder, "share": _PRETRAINED_RATE}]


def _goal_loss(goal: Tensor, wanted: Tensor, mask: Tensor) -> Tensor:
    """Returns the mean error of the place of the target, over the frames that show it.

    Args:
        goal: (N, 3) output of the network.
        wanted: (N, 2) distance, metres, and bearing, radians; NaN without a goal.
        mask: (N, H, W) share of each cell that shows the target.
    """
    distance, bearing = wanted[:, 0], wanted[:, 1]
    polar = torch.stack([distance / GOAL_SCALE_M, bearing.cos(), bearing.sin()], dim=1)
    shown = mask.amax(dim=(1, 2)) > _SHOWN
    is_known = (shown & polar.isfinite().all(dim=1)).float()
    error = functional.smooth_l1_loss(goal, polar.nan_to_num(0.0), reduction="none", beta=0.1).sum(dim=1)
    return (error * is_known).sum() / is_known.sum().clamp(min=1)


def _read(frames: TrainingFrames, rows: NDArray[np.int64], sentences: NDArray[np.int64]) -> Batch:
    taken = frames.pictures.take(rows)
    mask = taken.mask.astype(np.float32) / np.float32(255)
    pictures = preprocess.to_input(taken.rgb, taken.depth)
    return Batch(
        pictures,
        mask,
        words=sentences[frames.episode[rows]],
        **frames.labels.take(rows)._asdict(),
    )


def _blocks(rows: int, size: int) -> Iterator[NDArray[np.int64]]:
    return (np.arange(first, min(first + size, rows)) for first in range(0, rows, size))


def _mask_loss(logits: Tensor, wanted: Tensor) -> Tensor:
    """Returns the binary cross-entropy of the mask; target cells have a higher weight, because they are rare."""
    weight = 1 + 4 * wanted
    return (functional.binary_cross_entropy_with_logits(logits, wanted, reduction="none") * weight).mean()


def _pointing(logits: NDArray[np.float32], wanted: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Returns whether the most likely cell shows the target, for each frame with a visible target."""
    n = len(logits)
    best = logits.reshape(n, -1).argmax(axis=1)
    cells = wanted.reshape(n, -1)
    seen = cells.max(axis=1) > _SHOWN
    hit: NDArray[np.bool_] = cells[np.arange(n), best][seen] > _SHOWN
    return hit
