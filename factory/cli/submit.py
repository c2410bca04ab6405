"""`factory submit`: writes and submits the jobs of a run for a batch system."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import count_option, json_option, plan_argument, shrink_options, write_option
from schemas.errors import UsageError
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from factory.runs.plan_changes import PlanChanges
    from factory.submit.slurm import Mode

_TIME = re.compile(r"(\d+-)?\d+(:\d{2}){0,2}", re.ASCII)


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
def slurm(
    plan_name: str,
    run: Path,
    tasks: int,
    cpus: int,
    partition: str | None,
    time: str,
    mode: Mode,
    setup: tuple[str, ...],
    no_submit: bool,
    changes: PlanChanges,
    as_json: bool,
) -> None:
    """Submit a run to Slurm.

    PLAN is a built-in plan or a TOML file. Compiles the scenes, writes the scripts to DIR/slurm and submits them. Tasks
    that reach their time limit drain and queue themselves again; `scancel` drains and cancels. The dataset is
    DIR/dataset.
    """
    from coordinator.expansion.plan_file import load_plan
    from factory.runs.start import shrunk_plan
    from factory.submit.slurm import SlurmJob, prepare_run, submit_new_run, write_scripts
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_json
    from schemas.storage.mounts import mount_of
    from schemas.support.child import python_module

    configure_logs()
    if _TIME.fullmatch(time) is None:
        raise UsageError(f"--time {time!r} is not a valid time limit; examples: 30 (minutes), 04:00:00, 1-12:00:00")
    plan = shrunk_plan(load_plan(plan_name), changes)
    if mode == "shards" and tasks > plan.episodes:
        raise UsageError(f"--tasks {tasks}: plan {plan.name} has {plan.episodes} episodes; use at most as many tasks")
    run = run.absolute()
    mount = mount_of(run)
    job = SlurmJob(
        run=run,
        tasks=tasks,
        cpus=cpus,
        time=time,
        partition=partition,
        setup=setup,
        factory=("factory",) if setup else python_module("factory"),
        has_local_ledgers=mount is not None and mount.is_network,
    )
    prepare_run(job, plan, mode)
    scripts = write_scripts(job, mode)
    ids = {} if no_submit else submit_new_run(job, mode)
    if as_json:
        print_json({"run": str(run), "scripts": [str(script) for script in scripts], "jobs": ids})
        return
    for script in scripts:
        click.echo(f"{script}: {f'job {ids[script.stem]}' if ids else 'not submitted'}")
    click.echo(
        f"progress: factory status {quoted(run)}\ndataset: {quoted(job.dataset)}, when the last job has ended", err=True
    )
