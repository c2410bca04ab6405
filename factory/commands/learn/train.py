"""`factory train`: trains the built-in baseline policies on a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from factory.commands.common.bars import Bars
from factory.commands.common.output import print_result, print_table
from factory.dataset.reader import Dataset
from factory.support.logs import configure_logs
from factory.support.text import format_duration
from factory.train.behaviour_cloning import TrainCallbacks, TrainOrder, train_bc
from factory.train.measures import EpochMeasures, TrainReport
from factory.train.options import BcOptions
from schemas.errors import UsageError
from schemas.storage.place import Place
from schemas.support.closing import Closing
from schemas.terms import Split
from workers.client.stopping import stop_on_signals


def bc(
    root: Place,
    out: Path,
    split: str,
    scenes: tuple[str, ...] | None,
    tiers: tuple[str, ...] | None,
    epochs: int,
    minutes: float | None,
    seed: int,
    head: str,
    ablate_language: bool,
    positions: bool,
    size: str,
    antialias: int | None,
    memory: float,
    appearance: str | None,
    batch: int,
    rate: float,
    mask_weight: float,
    device: str,
    as_json: bool,
) -> int:
    """Executes `factory train bc`."""
    configure_logs()
    options = _options(
        head=head,
        ablate_language=ablate_language,
        positions=positions,
        epochs=epochs,
        seed=seed,
        size=int(size),
        antialias=antialias,
        batch=batch,
        peak_rate=rate,
        mask_weight=mask_weight,
    )
    wanted = {name: values for name, values in (("scene", scenes), ("tier", tiers)) if values}
    order = TrainOrder(
        Dataset(root, appearance=appearance).filter(**wanted),
        out,
        options,
        Split(split),
        device,
        minutes,
        int(memory * 1e9),
    )
    with stop_on_signals() as (stop, _), _TrainBar(epochs) as bar:
        report = train_bc(order, TrainCallbacks(bar.caching, bar.learning, bar.measured, stop.is_set))
    print_result(report, as_json, _print)
    if not report.finished:
        click.echo(f"{len(report.epochs)} of {epochs} epochs done; run the same command again to continue", err=True)
        return 130 if stop.is_set() else 0
    return 0


def _options(**chosen: Any) -> BcOptions:
    try:
        return BcOptions(**chosen)
    except ValidationError as error:
        raise UsageError(f"{error.errors()[0]['loc'][0]}: {error.errors()[0]['msg']}") from error


class _TrainBar(Closing):
    """Progress bars of a training on stderr, and one line per epoch."""

    def __init__(self, epochs: int) -> None:
        self._epochs = epochs
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
        note = f"epoch {epochs + 1} of {self._epochs}, loss {loss:.3f}"
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


def _print(report: TrainReport) -> None:
    if report.epochs:
        last = report.epochs[-1]
        print_table(
            "", ("measure", "value"), [(name, "-" if value is None else f"{value:.4g}") for name, value in last]
        )
    seconds = sum(epoch.seconds for epoch in report.epochs)
    click.echo(
        f"{report.parameters} parameters on {report.device}: {report.train_episodes} episodes, {report.train_frames} "
        f"frames; validated on {report.val_episodes} episodes, {report.val_frames} frames; {format_duration(seconds)}"
    )
    click.echo(f"policy: bc:{report.out}")
