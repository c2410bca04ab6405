"""What a training measured, epoch by epoch: the content of `metrics.json` and of `--json`. Models only."""

from __future__ import annotations

from factory.train.options import BcOptions
from schemas.base import Fraction, Model, NonNegative

__all__ = ["EpochMeasures", "TrainReport"]


class EpochMeasures(Model):
    """One epoch; the measures are of the running mean of the weights, which is what drives."""

    epoch: int
    """From 1."""
    train_loss: NonNegative
    """Mean over the epoch, of the weights in motion, on pictures varied at random."""
    val_loss: NonNegative | None
    """Imitation alone, without the loss of the mask; `None` without validation episodes."""
    val_v_mps: NonNegative | None
    """Mean error of v where the expert drives, m/s."""
    val_w_rps: NonNegative | None
    """Mean error of w where the expert drives, rad/s."""
    stop_precision: Fraction | None
    """Of the frames said to be stops, how many are; `None` when none is said to be."""
    stop_recall: Fraction | None
    """Of the stops, how many are found."""
    pointing: Fraction | None
    """How often the likeliest cell of the mask shows the target, where the target is in view."""
    rate: NonNegative
    """Learning rate at its end."""
    seconds: NonNegative


class TrainReport(Model):
    """The whole training."""

    out: str
    finished: bool
    """Whether all epochs are done; else the same command continues."""
    options: BcOptions
    device: str
    parameters: int
    train_episodes: int
    train_frames: int
    val_episodes: int
    val_frames: int
    epochs: tuple[EpochMeasures, ...]
