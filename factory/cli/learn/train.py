"""`factory train`: trains the built-in baseline policies on a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from factory.cli.common.bars import Bars
from factory.cli.common.filters import scene_filter, tier_filter
from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import (
    appearance_option,
    count_option,
    former_option,
    number_option,
    place_argument,
    write_option,
)
from factory.cli.common.output import json_option, print_result, print_table
from factory.cli.common.places import PLACE
from factory.dataset.reader import Dataset
from factory.support.logs import configure_logs
from factory.support.text import format_duration
from factory.train import BcOptions, EpochMeasures, TrainReport
from factory.train.preprocess import SIZES
from factory.train.run import TrainCallbacks, TrainOrder, train_bc
from schemas.errors import UsageError
from schemas.storage.place import Place
from schemas.support.closing import Closing
from schemas.terms import Split
from workers.client.stopping import stop_on_signals


@click.group("train", cls=CommandGroup)
def command() -> None:
    """Train baseline policies. Requires the extra `train`."""


@command.command("bc")
@place_argument
@former_option("--data", "root", "DIR|URL", type=PLACE)
@write_option("DIR", "Output directory. An interrupted training with the same options is continued.", required=True)
@click.option(
    "--split",
    type=click.Choice([str(split) for split in Split]),
    metavar="SPLIT",
    default=str(Split.TRAIN_ID),
    show_default=True,
    help=f"Split to train on: {', '.join(Split)}.",
)
@scene_filter()
@tier_filter()
@count_option("--epochs", 30, "Number of epochs, that is passes over all frames.", most=10_000)
@number_option(
    "MINUTES",
    "--minutes",
    None,
    "Time limit, minutes: no epoch is started that would end later. Default: no limit.",
    least=0.01,
)
@count_option("--seed", 0, "Random seed.", least=0, most=2**32 - 1)
@click.option(
    "--head",
    type=click.Choice(["continuous", "tokens"]),
    default="continuous",
    show_default=True,
    help="Output head. continuous: linear and angular velocity; tokens: tokens of the action grid.",
)
@click.option("--ablate-language", is_flag=True, help="Replace each instruction with one constant token.")
@click.option(
    "--positions",
    is_flag=True,
    help="Give the features that locate the target their position in the image, for instructions with left and right.",
)
@click.option(
    "--size",
    type=click.Choice([str(size) for size in SIZES]),
    default="128",
    show_default=True,
    metavar="N",
    help=f"Width and height of the input image, pixels: {', '.join(map(str, SIZES))}.",
)
@count_option(
    "--antialias",
    None,
    "Samples per pixel and axis of rendered frames; 1 is the fastest. For datasets of states. Default: as many as give "
    "the images of stored frames, 640 / SIZE.",
    most=10,
)
@number_option(
    "GB",
    "--memory",
    2.0,
    "Memory for rendered frames of each split, GB; frames that do not fit are rendered in every epoch.",
    least=0,
)
@appearance_option("For datasets of states. Default: the plan's.")
@count_option("--batch", 32, "Batch size, frames.", most=4096)
@number_option("RATE", "--rate", 1e-3, "Peak learning rate.", least=1e-7, most=1.0)
@number_option(
    "WEIGHT",
    "--mask-weight",
    1.0,
    "Weight of the auxiliary loss, which locates the target in the image. 0: imitation loss only.",
    least=0,
    most=100,
)
@click.option(
    "--device",
    default="auto",
    show_default=True,
    metavar="DEVICE",
    help="PyTorch device: cpu, cuda, cuda:1, ...; auto: cuda if available, else cpu.",
)
@click.option("--resume", is_flag=True, hidden=True, expose_value=False, help="Former option without effect.")
@json_option
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
    """Train a policy by behaviour cloning.

    The policy maps an image and an instruction to velocities (v, w), or to tokens of the action grid.
    Frames of a dataset that stores states are rendered in memory; no image is written.
    After Ctrl-C or --minutes, the same command continues the training; the result is the same as without interruption.

    \b
    Then:  factory eval DIR --split test_id --policy bc:OUT
    """
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
