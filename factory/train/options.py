"""Options of a training, their schedules, and the metadata of checkpoints. Opens no files; pure functions."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from factory.train.input_size import PREPROCESS_VERSION, SIZES
from schemas.base import Finite, Fraction, Model, Name, NonNegative, Positive, Sha256
from schemas.view import AppearanceData

_FINAL_SHARE = 0.02


def learning_rate(step: int, steps: int, peak: float, warmup: int) -> float:
    """Returns the learning rate of a step.

    Args:
        step: Step, from 0 to `steps` - 1.
        steps: Number of steps of the training.
        peak: Maximum learning rate.
        warmup: Number of warm-up steps.
    """
    if step < warmup:
        return peak * (step + 1) / warmup
    share = min(1.0, (step - warmup) / max(1, steps - warmup))
    return peak * (_FINAL_SHARE + (1 - _FINAL_SHARE) * 0.5 * (1 + math.cos(math.pi * share)))


def ema_decay(step: int, limit: float) -> float:
    """Returns the decay of the moving average of the weights at a step; small at first, when the average is noise."""
    return min(limit, (1 + step) / (10 + step))


CHECKPOINT_FORMAT = 3
"""Format version of a checkpoint. Readers accept this version and older ones, and raise an error for a newer one."""
Head = Literal["continuous", "tokens"]
Encoder = Literal["residual", "efficientnet_lite0"]
StopRule = Literal["braking", "success"]


class BcOptions(Model):
    """Training options; a resumed training must have the same options."""

    head: Head = "continuous"
    """Output head. `continuous`: v, w and a stop logit; `tokens`: one of the 49 points of the action grid."""
    ablate_language: bool = False
    """Whether every instruction is replaced by one constant token."""
    positions: Annotated[bool, Field(exclude_if=lambda it: not it)] = False
    """Whether the features that locate the target include their position in the image; the key is omitted if false."""
    encoder: Annotated[Encoder, Field(exclude_if=lambda it: it == "residual")] = "residual"
    """Image encoder. `residual`: that of `train bc`, from random weights; `efficientnet_lite0`: that of `train policy`.
    The key is omitted for `residual`."""
    stops: Annotated[StopRule, Field(exclude_if=lambda it: it == "braking")] = "braking"
    """Stop labels of demonstrations. `success`: where a stop succeeds (`schemas.measure.stop_labels`); `braking`, the
    only rule of the first versions: from the frame on in which the expert brakes. The key is omitted for `braking`."""
    epochs: Annotated[int, Field(ge=1, le=10_000)] = 30
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    size: int = 128
    """Side of the network's input picture, pixels."""
    antialias: Annotated[int, Field(ge=1)] | None = None
    """Samples per pixel along each axis when states are rendered; `None` gives the same pictures as stored frames."""
    width: Annotated[int, Field(ge=4, le=256, multiple_of=4)] = 24
    """Channels of the first stage, a multiple of four (GroupNorm); later stages have two and four times as many."""
    hold: Annotated[int, Field(ge=1, le=60)] = 6
    """Steps for which an action is held; 6 means ten inferences per second at 60 Hz."""
    batch: Annotated[int, Field(ge=1, le=4096)] = 32
    peak_rate: Positive = 1e-3
    weight_decay: NonNegative = 0.02
    ema: Fraction = 0.995
    """Maximum decay of the moving average of the weights."""
    mask_weight: NonNegative = 1.0
    """Weight of the target mask loss; 0 disables it."""
    stop_weight: Positive = 1.0
    """Weight of the stop frames."""

    @model_validator(mode="after")
    def _fits_the_encoder(self) -> BcOptions:
        if self.encoder == "efficientnet_lite0" and self.size % 32:
            raise ValueError(f"{self.size} is not a multiple of 32 px, which EfficientNet-Lite0 needs")
        return self

    @field_validator("size")
    @classmethod
    def _divides_a_frame(cls, size: int) -> int:
        if size not in SIZES:
            raise ValueError(f"{size} is not a valid image size; valid sizes: {', '.join(map(str, SIZES))} px")
        return size


SAME_START_M, SAME_START_RAD = 0.01, 0.02
"""Largest differences between two starts of the same episode, metres and radians: the robot settles before frame 0."""
Start = tuple[Finite, Finite, Finite]
"""x, y in metres and yaw in radians of base_link at the start, world frame."""


class TrainingStarts(Model):
    """Scene, target and start of every training episode, by which an evaluation recognises these episodes.

    They do not depend on the recording, the appearance, the instruction or the number of an episode.
    """

    scenes: dict[Sha256, dict[Name, tuple[Start, ...]]]
    """SHA-256 of a scene package -> target -> starts."""

    def holds(self, scene_sha256: str, target_id: str, start: tuple[float, float, float]) -> bool:
        """Returns whether an episode with this scene, target and start was trained on."""
        x, y, yaw = start
        return any(
            math.dist((x, y), one[:2]) <= SAME_START_M
            and abs(math.remainder(yaw - one[2], 2 * math.pi)) <= SAME_START_RAD
            for one in self.scenes.get(scene_sha256, {}).get(target_id, ())
        )


class CheckpointMeta(Model):
    """Checkpoint metadata that a policy needs to use the weights."""

    format: int = CHECKPOINT_FORMAT
    kind: Literal["bc"] = "bc"
    look: int = PREPROCESS_VERSION
    options: BcOptions
    words: tuple[str, ...]
    """Vocabulary: words by token index."""
    control_hz: Annotated[int, Field(ge=1)]
    """Control rate of the training data, Hz."""
    fov_deg: Positive
    max_speed_mps: Positive
    max_yaw_rate_rps: Positive
    epochs_done: Annotated[int, Field(ge=0)] = 0
    train_digest: Sha256
    """Digest of the training episodes."""
    appearance: AppearanceData | None = Field(default=None, exclude_if=lambda it: it is None)
    """Appearance of the training frames, if they were rendered with one."""
    train_episodes: Annotated[int, Field(ge=1)]
    train_frames: Annotated[int, Field(ge=1)]
    starts: TrainingStarts | None = Field(default=None, exclude_if=lambda it: it is None)
    """Episodes of the training; `None` in checkpoints of format 2."""
    software: str
    """Versions of this product and of torch."""
