"""`factory submit`: writes and submits the jobs of a run for a batch system."""

from __future__ import annotations

import re
import shlex
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from coordinator.archive.contract import scene_file
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.plan_file import load_plan, plan_to_toml
from factory.commands.common.output import print_building, print_json
from factory.commands.common.plan_changes import shrunk_plan
from factory.keys import admit, create_authority
from factory.runs.catalog import open_catalog
from factory.submit.slurm import Mode, SlurmJob, order_of, submit_all, write_scripts
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from schemas.errors import FactoryError, UsageError, WorldError
from schemas.plan import Plan
from schemas.protocol.identity import Role
from schemas.scene.files import copy_package
from schemas.storage.dataset_files import is_submitted_run
from schemas.storage.disk import translated
from schemas.storage.mounts import mount_of
from schemas.support.child import python_module

_TIME = re.compile(r"(\d+-)?\d+(:\d{2}){0,2}", re.ASCII)
_AUTHORITY_DAYS = 365


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
    as_json: bool,
    **changes: Any,
) -> None:
    """Executes `factory submit slurm`."""
    configure_logs()
    if _TIME.fullmatch(time) is None:
        raise UsageError(f"--time {time!r} is not a valid time limit; examples: 30 (minutes), 04:00:00, 1-12:00:00")
    plan = shrunk_plan(load_plan(plan_name), changes)
    if mode == "shards" and tasks > plan.episodes:
        raise UsageError(f"--tasks {tasks}: plan {plan.name} has {plan.episodes} episodes; use at most as many tasks")
    run = run.absolute()
    mount = mount_of(run)
    is_shared = mount is not None and mount.is_network
    factory = ("factory",) if setup else python_module("factory")
    job = SlurmJob(run, tasks, cpus, time, partition, setup, factory, has_local_ledgers=is_shared)
    _prepare(job, plan, mode)
    scripts = write_scripts(job, mode)
    ids = {} if no_submit else _submit(job, mode)
    if as_json:
        print_json({"run": str(run), "scripts": [str(script) for script in scripts], "jobs": ids})
        return
    for script in scripts:
        click.echo(f"{script}: {f'job {ids[script.stem]}' if ids else 'not submitted'}")
    click.echo(f"progress: factory status {run}\ndataset: {job.dataset}, when the last job has ended", err=True)


def _submit(job: SlurmJob, mode: Mode) -> dict[str, int]:
    """Submits the jobs; removes the folder of the run if Slurm refuses them, so the command can be repeated."""
    try:
        return submit_all(job, mode)
    except WorldError:
        shutil.rmtree(job.run)
        raise


def _prepare(job: SlurmJob, plan: Plan, mode: Mode) -> None:
    """Creates the folder of a run with its plan, its scenes and, for workers, its certificates."""
    if job.run.exists():
        other = f", or continue its run with {_again(job.run)}" if is_submitted_run(job.run) else ""
        raise UsageError(f"{job.run} exists: choose another --out{other}")
    catalog = open_catalog(plan, job.dataset, scene_cache(), print_building)
    try:
        with translated("write", job.run):
            job.plan.parent.mkdir(parents=True)
            (job.run / "shards").mkdir()
            job.plan.write_text(plan_to_toml(plan), encoding="utf-8")
            _copy_scenes(catalog, job.scenes if mode == "shards" else job.dataset / "scenes")
        if mode == "workers":
            now = datetime.now(UTC)
            create_authority(job.run / "pki", plan.run, _AUTHORITY_DAYS, now)
            admit(job.run / "pki", "worker", Role.WORKER, (), _AUTHORITY_DAYS, now)
    except FactoryError:
        shutil.rmtree(job.run, ignore_errors=True)  # so that the command can be repeated
        raise


def _again(run: Path) -> str:
    """Returns the shell command that submits the jobs of a run again."""
    scripts = run / "slurm"
    first, second, when = order_of("shards" if (scripts / "shards.sh").is_file() else "workers")
    job = f"$(sbatch --parsable {shlex.quote(str(scripts / first))}.sh)"
    return f"`sbatch --dependency={when}:{job} {shlex.quote(str(scripts / second))}.sh`"


def _copy_scenes(catalog: Catalog, folder: Path) -> None:
    folder.mkdir(parents=True)
    for name, entry in catalog.items():
        copy_package(entry.path, folder / scene_file(name, entry.sha256))
