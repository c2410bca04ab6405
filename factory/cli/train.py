"""`factory train`: trains the built-in baseline policies on a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import (
    PLACE,
    appearance_option,
    count_option,
    input_size_option,
    json_option,
    number_option,
    place_argument,
    scene_filter,
    tier_filter,
    write_option,
)
from factory.cli.rounds import rounds
from schemas.errors import UsageError
from schemas.support.shell import quoted
from schemas.terms import Split

if TYPE_CHECKING:
    from factory.dataset.reader import Dataset
    from factory.train.measures import TrainReport
    from factory.train.options import BcOptions, Head, StopRule
    from schemas.storage.place import Place


@click.group("train", cls=CommandGroup)
def command() -> None:
    """Train baseline policies. Requires the extra `train`."""


command.add_command(rounds)


@command.command("bc")
@place_argument
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
    "Time limit, minutes: an epoch that would end later is not started. Default: no limit.",
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
@click.option(
    "--correction",
    "corrections",
    type=PLACE,
    multiple=True,
    metavar="DIR|URL",
    help="Dataset of `factory correct` to train on, too; repeatable, once for each round.",
)
@click.option(
    "--stop-labels",
    "stops",
    type=click.Choice(["success", "braking"]),
    default="success",
    show_default=True,
    help="When a stop is the right answer. success: where a stop succeeds; braking: where the demonstration brakes.",
)
@click.option("--ablate-language", is_flag=True, help="Replace each instruction with one constant token.")
@click.option(
    "--positions",
    is_flag=True,
    help="Add the image position to the features that locate the target, for instructions with left and right.",
)
@input_size_option
@count_option(
    "--antialias",
    None,
    "Samples per pixel of rendered frames, along each axis; 1 is the fastest. For datasets of states. "
    "Default: 640 / SIZE, which gives the same images as stored frames.",
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
    head: Head,
    corrections: tuple[Place, ...],
    stops: StopRule,
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
    from factory.dataset.reader import Dataset
    from factory.support.logs import configure_logs
    from factory.train.behaviour_cloning import TrainCallbacks, TrainOrder, train_bc
    from factory.train.measures import TrainBar
    from workers.client.stopping import stop_on_signals

    configure_logs()
    options = _options(
        head=head,
        ablate_language=ablate_language,
        positions=positions,
        stops=stops,
        epochs=epochs,
        seed=seed,
        size=int(size),
        antialias=antialias,
        batch=batch,
        peak_rate=rate,
        mask_weight=mask_weight,
    )
    columns = {name: values for name, values in (("scene", scenes), ("tier", tiers)) if values}
    dataset = Dataset(root, appearance=appearance).filter(**columns)
    added = tuple(_corrections_in(place, appearance) for place in corrections)
    order = TrainOrder(dataset, out, options, Split(split), device, minutes, added, int(memory * 1e9))
    with stop_on_signals() as (stop, _), TrainBar(epochs) as bar:
        report = train_bc(order, TrainCallbacks(bar.caching, bar.learning, bar.measured, stop.is_set))
    _show(report, Dataset(root), out, as_json)
    if not report.finished:
        click.echo(f"{len(report.epochs)} of {epochs} epochs done; run the same command again to continue", err=True)
        return 130 if stop.is_set() else 0
    return 0


def _options(**values: Any) -> BcOptions:
    from pydantic import ValidationError

    from factory.train.options import BcOptions

    try:
        return BcOptions(**values)
    except ValidationError as error:
        raise UsageError(f"{error.errors()[0]['loc'][0]}: {error.errors()[0]['msg']}") from error


def _corrections_in(place: Place, appearance: str | None) -> Dataset:
    from factory.dataset.reader import Dataset

    dataset = Dataset(place, appearance=appearance)
    if dataset.meta.plan.correction is None:
        raise UsageError(f"--correction {place}: plan {dataset.meta.plan.name} is not one of `factory correct`")
    if not len(dataset):
        raise UsageError(f"--correction {place} has no episodes; `factory correct` with the same options continues it")
    return dataset


def _show(report: TrainReport, dataset: Dataset, out: Path, as_json: bool) -> None:
    """Writes the curve of a training, and prints its report with the next commands."""
    from factory.support.terminal import print_result
    from factory.train.curve import CURVE, PAGE, write_curve  # needs matplotlib, which the training has checked
    from factory.train.measures import print_report

    commands = _next_commands(dataset, out)
    if report.epochs:
        write_curve(out, report, commands)
    files = [str(out / name) for name in (CURVE, PAGE)] if report.epochs else []
    print_result(report, as_json, lambda result: print_report(result, files, commands))


def _next_commands(dataset: Dataset, out: Path) -> list[str]:
    """Returns the commands that show the losses and evaluate the policy of a training."""
    has_tests = any(split.startswith("test_") for split in dataset.column("split").to_pylist())
    splits = "" if has_tests else " --split all"
    return [
        f"tensorboard --logdir {quoted(out / 'tensorboard')}",
        f"factory eval {quoted(dataset.root)}{splits} --policy {quoted(f'bc:{out}')} -o {quoted(f'{out}_eval')}",
    ]
