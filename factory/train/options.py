"""The settings of a training and what a checkpoint says of itself. Models only; opens nothing."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from factory.train.preprocess import PREPROCESS_VERSION, SIZES
from schemas.base import Fraction, Model, NonNegative, Positive, Sha256

__all__ = ["CHECKPOINT_FORMAT", "BcOptions", "CheckpointMeta", "Head"]

CHECKPOINT_FORMAT = 1
"""Version of the checkpoint. A reader opens its own version and older ones; a newer one it refuses by name."""
Head = Literal["continuous", "tokens"]


class BcOptions(Model):
    """Everything that decides what is learned; a resumed training must have the same."""

    head: Head = "continuous"
    """`continuous`: v, w and whether to stand; `tokens`: one of the 49 points of the action grid."""
    ablate_language: bool = False
    """Whether every instruction is replaced by one constant token."""
    epochs: Annotated[int, Field(ge=1, le=10_000)] = 30
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    size: int = 128
    """Side of the picture the network sees, pixels."""
    width: Annotated[int, Field(ge=4, le=256, multiple_of=4)] = 24
    """Channels of the first stage; the later ones have two and four times as many. Normalised in four groups."""
    hold: Annotated[int, Field(ge=1, le=60)] = 6
    """Steps for which an action is held; 6 is ten looks a second at 60 Hz."""
    batch: Annotated[int, Field(ge=1, le=4096)] = 32
    peak_rate: Positive = 1e-3
    weight_decay: NonNegative = 0.02
    ema: Fraction = 0.995
    """Limit of the running mean of the weights."""
    mask_weight: NonNegative = 1.0
    """Of the loss that asks where the named object stands in the picture; 0 leaves plain imitation."""
    stop_weight: Positive = 1.0
    """Of the frames at which to stand."""

    @field_validator("size")
    @classmethod
    def _divides_a_frame(cls, size: int) -> int:
        if size not in SIZES:
            raise ValueError(f"{size} is not a valid image size; valid sizes: {', '.join(map(str, SIZES))} px")
        return size


class CheckpointMeta(Model):
    """The words beside the weights: all a policy needs to know to use them."""

    format: int = CHECKPOINT_FORMAT
    kind: Literal["bc"] = "bc"
    look: int = PREPROCESS_VERSION
    options: BcOptions
    words: tuple[str, ...]
    """The vocabulary by number."""
    control_hz: Annotated[int, Field(ge=1)]
    """Steps a second that the hold was learned at."""
    fov_deg: Positive
    max_speed_mps: Positive
    max_yaw_rate_rps: Positive
    epochs_done: Annotated[int, Field(ge=0)] = 0
    train_digest: Sha256
    """Digest of the episodes it learned from."""
    train_episodes: Annotated[int, Field(ge=1)]
    train_frames: Annotated[int, Field(ge=1)]
    software: str
    """Versions of this product and of torch."""
