"""`factory train`: trains the built-in baseline policies on a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import (
    PLACE,
    Command,
    appearance_option,
    collected,
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


@dataclass(frozen=True)
class Training:
    """Options of both trainings."""

    split: str
    scenes: tuple[str, ...] | None
    tiers: tuple[str, ...] | None
    minutes: float | None
    seed: int
    corrections: tuple[Place, ...]
    stops: StopRule
    ablate_language: bool
    antialias: int | None
    memory: float
    appearance: str | None
    batch: int
    rate: float
    mask_weight: float
    device: str


def _training_options(command: Command) -> Command:
    """Adds the options of both trainings as `training`."""
    command = collected(command, "training", Training)
    for option in reversed(_SHARED):
        command = option(command)
    return command


_SHARED = (
    click.option(
        "--split",
        type=click.Choice([str(split) for split in Split]),
        metavar="SPLIT",
        default=str(Split.TRAIN_ID),
        show_default=True,
        help=f"Split to train on: {', '.join(Split)}.",
    ),
    scene_filter(),
    tier_filter(),
    number_option(
        "MINUTES",
        "--minutes",
        None,
        "Time limit, minutes: an epoch that would end later is not started. Default: no limit.",
        least=0.01,
    ),
    count_option("--seed", 0, "Random seed.", least=0, most=2**32 - 1),
    click.option(
        "--correction",
        "corrections",
        type=PLACE,
        multiple=True,
        metavar="DIR|URL",
        help="Dataset of `factory correct` to train on, too; repeatable, once for each round.",
    ),
    click.option(
        "--stop-labels",
        "stops",
        type=click.Choice(["success", "braking"]),
        default="success",
        show_default=True,
        help="When a stop is the right answer. success: where a stop succeeds; braking: where the demonstration "
        "brakes.",
    ),
    click.option("--ablate-language", is_flag=True, help="Replace each instruction with one constant token."),
    count_option(
        "--antialias",
        None,
        "Samples per pixel of rendered frames, along each axis; 1 is the fastest. For datasets of states. "
        "Default: 640 / SIZE, which gives the same images as stored frames.",
        most=10,
    ),
    number_option(
        "GB",
        "--memory",
        2.0,
        "Memory for rendered frames of each split, GB; frames that do not fit are rendered in every epoch.",
        least=0,
    ),
    appearance_option("For datasets of states. Default: the plan's."),
    count_option("--batch", 32, "Batch size, frames.", most=4096),
    number_option("RATE", "--rate", 1e-3, "Peak learning rate.", least=1e-7, most=1.0),
    number_option(
        "WEIGHT",
        "--mask-weight",
        1.0,
        "Weight of the auxiliary loss, which locates the target in the image. 0: imitation loss only.",
        least=0,
        most=100,
    ),
    click.option(
        "--device",
        default="auto",
        show_default=True,
        metavar="DEVICE",
        help="PyTorch device: cpu, cuda, cuda:1, ...; auto: cuda if available, else cpu.",
    ),
)
_OUT = write_option(
    "DIR", "Output directory. An interrupted training with the same options is continued.", required=True
)


@command.command("bc")
@place_argument
@_OUT
@count_option("--epochs", 30, "Number of epochs, that is passes over all frames.", most=10_000)
@input_size_option
@click.option(
    "--head",
    type=click.Choice(["continuous", "tokens"]),
    default="continuous",
    show_default=True,
    help="Output head. continuous: linear and angular velocity; tokens: tokens of the action grid.",
)
@click.option(
    "--positions",
    is_flag=True,
    help="Add the image position to the features that locate the target, for instructions with left and right.",
)
@_training_options
@json_option
def bc(
    root: Place,
    out: Path,
    epochs: int,
    size: str,
    head: Head,
    positions: bool,
    training: Training,
    as_json: bool,
) -> int:
    """Train a policy by behaviour cloning.

    The policy maps an image and an instruction to velocities (v, w), or to tokens of the action grid.
    Frames of a dataset that stores states are rendered in memory; no image is written.
    After Ctrl-C or --minutes, the same command continues the training; the result is the same as without interruption.

    \b
    Then:  factory eval DIR --split test_id --policy bc:OUT
    """
    options = _options(training, epochs=epochs, size=int(size), head=head, positions=positions)
    return _train(root, out, options, training, None, as_json)


@command.command("policy")
@place_argument
@_OUT
@number_option(
    "HOURS",
    "--budget",
    None,
    "Time of the training, hours: chooses --size and --epochs from measured steps of this machine.",
    least=0.01,
    most=1000,
)
@count_option("--epochs", None, "Number of epochs, that is passes over all frames. Default: 12.", most=10_000)
@click.option(
    "--size",
    type=click.Choice(["64", "128", "160"]),
    metavar="N",
    help="Width and height of the input image, pixels: 64, 128, 160. Default: 160.",
)
@_training_options
@json_option
def policy(
    root: Place,
    out: Path,
    budget: float | None,
    epochs: int | None,
    size: str | None,
    training: Training,
    as_json: bool,
) -> int:
    """Train a larger policy with a pretrained image encoder.

    As `factory train bc`, but with EfficientNet-Lite0 (weights of ImageNet) for the images, and with
    separate outputs for the stop and for the place of the target.

    \b
    Then:  factory eval DIR --split test_id --policy bc:OUT
    """
    if budget is not None and (epochs is not None or size is not None):
        raise UsageError("--budget chooses --size and --epochs: omit these, or omit --budget")
    options = _options(training, epochs=epochs or 12, size=int(size or 160), encoder="efficientnet_lite0")
    return _train(root, out, options, training, budget, as_json)


def _train(root: Place, out: Path, options: BcOptions, training: Training, budget: float | None, as_json: bool) -> int:
    from factory.dataset.reader import Dataset
    from factory.support.logs import configure_logs
    from factory.train.behaviour_cloning import TrainCallbacks, TrainOrder, train_bc
    from factory.train.budget import fit_to_budget
    from factory.train.measures import TrainBar
    from workers.client.stopping import stop_on_signals

    configure_logs()
    columns = {name: values for name, values in (("scene", training.scenes), ("tier", training.tiers)) if values}
    dataset = Dataset(root, appearance=training.appearance).filter(**columns)
    order = TrainOrder(
        dataset,
        out,
        options,
        split=Split(training.split),
        device=training.device,
        minutes=training.minutes,
        corrections=tuple(_corrections_in(place, training.appearance) for place in training.corrections),
        memory_bytes=int(training.memory * 1e9),
    )
    with stop_on_signals() as (stop, _), TrainBar() as bar:
        callbacks = TrainCallbacks(bar.caching, bar.learning, bar.measured, stop.is_set)
        if budget is not None:
            order = fit_to_budget(order, callbacks, budget)
            chosen = order.options
            click.echo(f"--budget {budget:g}: --size {chosen.size} --epochs {chosen.epochs}", err=True)
        bar.epochs = order.options.epochs
        report = train_bc(order, callbacks)
    _show(report, Dataset(root), out, as_json)
    if not report.finished:
        left = f"{len(report.epochs)} of {order.options.epochs} epochs done"
        click.echo(f"{left}; run the same command again to continue", err=True)
        return 130 if stop.is_set() else 0
    return 0


def _options(training: Training, **values: Any) -> BcOptions:
    from pydantic import ValidationError

    from factory.train.options import BcOptions

    shared = {name: getattr(training, name) for name in ("seed", "stops", "ablate_language", "antialias", "batch")}
    try:
        return BcOptions(**shared, peak_rate=training.rate, mask_weight=training.mask_weight, **values)
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
