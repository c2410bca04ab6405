"""Declares `factory train`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.filters import scene_filter, tier_filter
from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import (
    appearance_option,
    count_option,
    former_option,
    json_option,
    number_option,
    place_argument,
    write_option,
)
from factory.cli.common.places import PLACE
from factory.train.input_size import SIZES
from schemas.terms import Split


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
@click.option("--ablate-language", is_flag=True, help="Replace each instruction with one constant token.")
@click.option(
    "--positions",
    is_flag=True,
    help="Add the image position to the features that locate the target, for instructions with left and right.",
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
@click.option("--resume", is_flag=True, hidden=True, expose_value=False, help="Deprecated; has no effect.")
@json_option
def bc(**options: Any) -> int:
    """Train a policy by behaviour cloning.

    The policy maps an image and an instruction to velocities (v, w), or to tokens of the action grid.
    Frames of a dataset that stores states are rendered in memory; no image is written.
    After Ctrl-C or --minutes, the same command continues the training; the result is the same as without interruption.

    \b
    Then:  factory eval DIR --split test_id --policy bc:OUT
    """
    from factory.commands.learn.train import bc

    return bc(**options)
