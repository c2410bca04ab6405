"""Declares `factory submit`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import count_option, json_option, plan_argument, shrink_options, write_option


@click.group("submit", cls=CommandGroup)
def command() -> None:
    """Submit a run to a batch system."""


@command.command("slurm")
@plan_argument(default="demo")
@write_option(
    "DIR", "Folder of the run, on a file system that all nodes share. It must not exist.", "run", required=True
)
@count_option("--tasks", 8, "Number of array tasks: shards, or workers.", most=100_000)
@count_option("--cpus", 4, "Number of cores of a task.", most=1024)
@click.option("--partition", metavar="NAME", help="Slurm partition. Default: the default partition of the cluster.")
@click.option(
    "--time", default="04:00:00", show_default=True, metavar="TIME", help="Time limit of a task, e.g. 30 or 1-12:00:00."
)
@click.option(
    "--mode",
    type=click.Choice(["shards", "workers"]),
    default="shards",
    show_default=True,
    help="shards: each task generates a part of the plan, and a last job joins them; workers: a coordinator and an "
    "array of workers, which balances the load.",
)
@click.option(
    "--setup",
    multiple=True,
    metavar="LINE",
    help="Shell line that makes `factory` available, e.g. '. /shared/venv/bin/activate' or 'module load minivla'; "
    "repeatable. Default: the tasks use the Python of this command.",
)
@click.option("--no-submit", is_flag=True, help="Write the scripts only.")
@shrink_options
@json_option
def slurm(**options: Any) -> None:
    """Submit a run to Slurm.

    PLAN is a built-in plan or a TOML file. Compiles the scenes, writes the scripts to DIR/slurm and submits them. Tasks
    that reach their time limit drain and queue themselves again; `scancel` drains and cancels. The dataset is
    DIR/dataset.
    """
    from factory.commands.farm.submit import slurm

    slurm(**options)
