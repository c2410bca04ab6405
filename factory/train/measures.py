"""Measures of a training: the content of `metrics.json` and of `--json`, and their output on the terminal.

Computes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from factory.support.terminal import Bars, print_table
from factory.support.text import format_duration
from factory.train.options import BcOptions
from schemas.base import Fraction, Model, NonNegative
from schemas.support.closing import Closing


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
    policy_epoch: int | None = None
    """Epoch of the weights in `policy.pt`: the one with the smallest validation loss, or the last one without
    validation episodes; `None` before the first epoch, and in reports of older versions."""


class TrainBar(Closing):
    """Progress bars of a training on stderr, and one line per epoch."""

    def __init__(self) -> None:
        self.epochs = 0
        """Number of epochs of the training."""
        self._bar = Bars()
        self._decoding: Any = None
        self._task: Any = None
        self._bar.start()

    def close(self) -> None:
        """Removes the bars."""
        self._bar.stop()

    def caching(self, done: int, of: int) -> None:
        """Updates the number of decoded episodes."""
        if self._decoding is None or done == 1:
            self._decoding = self._bar.add_task("decoding", total=of)
        self._bar.update(self._decoding, completed=done)

    def learning(self, epochs: int, done: int, of: int, loss: float) -> None:
        """Updates the number of batches and the loss of this epoch."""
        if self._task is None:
            self._task = self._bar.add_task("training", total=of)
        note = f"epoch {epochs + 1} of {self.epochs}, loss {loss:.3f}"
        self._bar.update(self._task, total=of, completed=done, note=note)

    def measured(self, epoch: EpochMeasures) -> None:
        """Prints the measures of an epoch."""
        self._bar.console.print(f"epoch {epoch.epoch}: {_describe(epoch)}")


def _describe(epoch: EpochMeasures) -> str:
    names = {"val_v_mps": "v error m/s", "val_w_rps": "w error rad/s", "pointing": "pointing accuracy"}
    pairs = [
        (names.get(name, name.replace("_", " ")), value) for name, value in epoch.model_dump(exclude={"epoch"}).items()
    ]
    return ", ".join(f"{name} {value:.4g}" for name, value in pairs if value is not None)


def describe_kept(report: TrainReport) -> str:
    """Returns which epoch the weights of the policy are from."""
    if report.policy_epoch is None:
        return "no epoch is done"
    by_epoch = {epoch.epoch: epoch for epoch in report.epochs}
    loss = by_epoch[report.policy_epoch].val_loss if report.policy_epoch in by_epoch else None
    why = "the last one, because there are no validation episodes"
    if loss is not None:
        why = f"with the smallest validation loss ({loss:.4g})"
    return f"the policy has the weights of epoch {report.policy_epoch} of {len(report.epochs)}, {why}"


def print_report(report: TrainReport, files: Sequence[str], commands: Sequence[str]) -> None:
    """Prints the measures of the epoch that is kept, the policy, the files of the curve, and the next commands."""
    for epoch in report.epochs:
        if epoch.epoch == report.policy_epoch:
            print_table(
                "", ("measure", "value"), [(name, "-" if value is None else f"{value:.4g}") for name, value in epoch]
            )
    seconds = sum(epoch.seconds for epoch in report.epochs)
    click.echo(
        f"{report.parameters} parameters on {report.device}: {report.train_episodes} episodes, {report.train_frames} "
        f"frames; validated on {report.val_episodes} episodes, {report.val_frames} frames; {format_duration(seconds)}"
    )
    click.echo(f"policy: bc:{report.out}; {describe_kept(report)}")
    if files:
        click.echo(f"curve: {', '.join(files)}")
    for command in commands:
        click.echo(f"next: {command}")
