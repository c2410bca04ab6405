"""Models of the training measures: the content of `metrics.json` and of `--json`. Computes nothing."""

from __future__ import annotations

from factory.train.options import BcOptions
from schemas.base import Fraction, Model, NonNegative


class EpochMeasures(Model):
    """Measures of one epoch; validation uses the averaged weights, which are those of the policy."""

    epoch: int
    """Number of the epoch, from 1."""
    train_loss: NonNegative
    """Mean training loss over the epoch, with the current weights and augmented pictures."""
    val_loss: NonNegative | None
    """Imitation loss without the mask loss; `None` without validation episodes."""
    val_v_mps: NonNegative | None
    """Mean absolute error of v on frames without a stop, m/s."""
    val_w_rps: NonNegative | None
    """Mean absolute error of w on frames without a stop, rad/s."""
    stop_precision: Fraction | None
    """Precision of predicted stops; `None` without predicted stops."""
    stop_recall: Fraction | None
    """Recall of stops; `None` without stops."""
    pointing: Fraction | None
    """Share of frames with a visible target in which the most likely mask cell shows it."""
    rate: NonNegative
    """Learning rate at the end of the epoch."""
    seconds: NonNegative


class TrainReport(Model):
    """Report of a training."""

    out: str
    finished: bool
    """Whether all epochs are done; otherwise, the same command resumes the training."""
    options: BcOptions
    device: str
    parameters: int
    train_episodes: int
    train_frames: int
    val_episodes: int
    val_frames: int
    epochs: tuple[EpochMeasures, ...]
