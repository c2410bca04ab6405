"""`factory train`: fit the baselines that ship with the product to a dataset."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self

import click
from pydantic import ValidationError

from coordinator.archive.place import Place
from factory.cli.bars import Bars
from factory.cli.output import json_option, print_json, print_table, say_duration
from factory.cli.places import PLACE
from factory.dataset import Dataset
from factory.logs import configure_logs
from factory.train import BcOptions, EpochMeasures, TrainReport
from factory.train.look import SIZES
from factory.train.run import TrainOrder, Watcher, train_bc
from schemas.errors import UsageError
from schemas.terms import Split, Tier
from workers.stopping import stop_on_signals

__all__ = ["command"]


@click.group("train")
def command() -> None:
    """Train the baselines; needs the extra `train` (PyTorch, CPU builds too)."""


@command.command("bc")
@click.option("--data", "root", type=PLACE, required=True, metavar="DIR|URL", help="The dataset.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), required=True, metavar="OUT", help="Folder of the result."
)
@click.option(
    "--split",
    type=click.Choice([str(split) for split in Split]),
    default=str(Split.TRAIN_ID),
    show_default=True,
    help="To learn from.",
)
@click.option("--scene", "scenes", multiple=True, metavar="SCENE", help="Only this scene; may be repeated.")
@click.option(
    "--tier",
    "tiers",
    multiple=True,
    type=click.Choice([str(tier) for tier in Tier]),
    help="Only this tier; may be repeated.",
)
@click.option("--epochs", type=click.IntRange(1, 10_000), default=30, show_default=True, help="Rounds over all frames.")
@click.option("--minutes", type=click.FloatRange(0.01), metavar="M", help="Begin no epoch that would end later.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True, help="Of all chance.")
@click.option(
    "--head", type=click.Choice(["continuous", "tokens"]), default="continuous", show_default=True, help="What it says."
)
@click.option(
    "--ablate-language", is_flag=True, help="The twin that cannot read: one constant token for every instruction."
)
@click.option(
    "--size", type=click.Choice([str(size) for size in SIZES]), default="128", show_default=True, help="Pixels."
)
@click.option("--batch", type=click.IntRange(1, 4096), default=32, show_default=True, help="Frames a step.")
@click.option(
    "--rate", type=click.FloatRange(1e-7, 1.0), default=1e-3, show_default=True, help="Highest learning rate."
)
@click.option("--mask-weight", type=click.FloatRange(0, 100), default=1.0, show_default=True, help="0: imitation only.")
@click.option("--device", default="auto", show_default=True, help="auto, cpu, cuda, cuda:1, ...")
@click.option("--resume", is_flag=True, help="Go on with the training in OUT.")
@json_option
def bc(
    root: Place,
    out: Path,
    split: str,
    scenes: tuple[str, ...],
    tiers: tuple[str, ...],
    epochs: int,
    minutes: float | None,
    seed: int,
    head: str,
    ablate_language: bool,
    size: str,
    batch: int,
    rate: float,
    mask_weight: float,
    device: str,
    resume: bool,
    as_json: bool,
) -> int:
    """Fit behaviour cloning to a split: pictures and words to (v, w), or to tokens of the action grid.

    \b
    Then:  factory eval --data DIR --split test_id --policy bc:OUT
    Interrupted by Ctrl-C or after --minutes, the same command with --resume goes on to the same weights.
    """
    configure_logs()
    options = _options(
        head=head,
        ablate_language=ablate_language,
        epochs=epochs,
        seed=seed,
        size=int(size),
        batch=batch,
        peak_rate=rate,
        mask_weight=mask_weight,
    )
    wanted = {name: values for name, values in (("scene", scenes), ("tier", tiers)) if values}
    order = TrainOrder(Dataset(root).filter(**wanted), out, options, Split(split), device, minutes, resume)
    with stop_on_signals() as (stop, _), _TrainBar(epochs) as bar:
        report = train_bc(order, Watcher(bar.caching, bar.learning, bar.measured, stop.is_set))
    if as_json:
        print_json(report.model_dump(mode="json"))
    else:
        _print(report)
    if not report.finished:
        click.echo(f"{len(report.epochs)} of {epochs} epochs done; --resume goes on", err=True)
        return 130 if stop.is_set() else 0
    return 0


def _options(**chosen: Any) -> BcOptions:
    try:
        return BcOptions(**chosen)
    except ValidationError as error:
        raise UsageError(f"{error.errors()[0]['loc'][0]}: {error.errors()[0]['msg']}") from error


class _TrainBar:
    """The bars of a training on stderr, and a line an epoch."""

    def __init__(self, epochs: int) -> None:
        self._epochs = epochs
        self._bar = Bars()
        self._decoding: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def caching(self, done: int, of: int) -> None:
        """Shows episodes being decoded."""
        if self._decoding is None or done == 1:
            self._decoding = self._bar.add_task("decoding", total=of)
        self._bar.update(self._decoding, completed=done)

    def learning(self, epochs: int, done: int, of: int, loss: float) -> None:
        """Shows batches done in this epoch."""
        if self._task is None:
            self._task = self._bar.add_task("learning", total=of)
        note = f"epoch {epochs + 1} of {self._epochs}, loss {loss:.3f}"
        self._bar.update(self._task, total=of, completed=done, note=note)

    def measured(self, epoch: EpochMeasures) -> None:
        """Prints the epoch's measures."""
        self._bar.console.print(f"epoch {epoch.epoch}: {_describe(epoch)}")


def _describe(epoch: EpochMeasures) -> str:
    names = {"val_v_mps": "v err", "val_w_rps": "w err", "pointing": "points right"}
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
        f"frames; validated on {report.val_episodes} episodes, {report.val_frames} frames; {say_duration(seconds)}"
    )
    click.echo(f"policy: bc:{report.out}")
