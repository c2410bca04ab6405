"""Slurm jobs of a run: its folder, their scripts, as text, and the commands of Slurm that submit them.

The scripts only call the command line; they contain no Python code. submitit pickles functions, handles signals in
Python instead of the batch shell, and has no dependent arrays.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from coordinator.archive.contract import scene_file
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.plan_file import plan_to_toml
from factory.keys import admit, create_authority
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_building
from schemas.errors import FactoryError, UsageError, WorldError
from schemas.plan import Plan
from schemas.protocol.identity import Role
from schemas.scene.files import copy_package
from schemas.storage.dataset_files import is_submitted_run
from schemas.storage.disk import translated
from schemas.support.child import child_environment

Mode = Literal["shards", "workers"]
_NOTICE_S = 120
_AUTHORITY_DAYS = 365
_HOST = "$(hostname -f)"
_SCRATCH = "${SLURM_TMPDIR:-${TMPDIR:-/tmp}}/minivla-${USER:-factory}-${SLURM_ARRAY_JOB_ID:-${SLURM_JOB_ID}}"
RUN_TASK = r"""
requeue=
stopped=
child=
# shellcheck disable=SC2317  # called by the traps
drain() {
    stopped=yes
    if [ -n "${child}" ]; then kill -TERM "${child}" 2>/dev/null; fi
}
trap 'requeue=yes; drain' USR1  # before the time limit: --signal of this script
trap drain TERM INT             # scancel, or a preemption, after which Slurm queues the task again

# hold_scratch: takes a shared lock in the folder of the run on this node, and removes folders of this user that no task
# has held for a day, such as those of killed tasks
hold_scratch() {
    command -v flock >/dev/null || return 0
    for folder in "${MINIVLA_CACHE%/*}/minivla-${USER:-factory}"*; do
        if [ -O "${folder}/.lock" ] && [ -n "$(find "${folder}/.lock" -mmin +1440)" ]; then
            (flock -n -x 9 && rm -rf -- "${folder}") 9>>"${folder}/.lock"
        fi
    done
    while mkdir -p "${MINIVLA_CACHE}" && exec 9>>"${MINIVLA_CACHE}/.lock"; do
        touch "${MINIVLA_CACHE}/.lock"
        flock -s 9
        # the last task of another job step may have removed the folder before it was locked
        if [ "${MINIVLA_CACHE}/.lock" -ef "/proc/self/fd/9" ]; then return 0; fi
    done
}

# leave_scratch STATUS: removes the spool, whose jobs other tasks simulate again, the local ledger of a finished task,
# and the folder if no other task holds it and no requeued task has left its spool or ledger there
leave_scratch() {
    rm -rf -- "${MINIVLA_CACHE}/spool-${SLURM_ARRAY_TASK_ID:-0}"
    if [ "$1" -eq 0 ]; then rm -f -- "${MINIVLA_CACHE}/ledger-${SLURM_ARRAY_TASK_ID:-0}."*; fi
    if ! { true >&9; } 2>/dev/null || ! flock -n -x 9; then return 0; fi
    for kept in "${MINIVLA_CACHE}"/spool-* "${MINIVLA_CACHE}"/ledger-*; do
        if [ -e "${kept}" ]; then return 0; fi
    done
    rm -rf -- "${MINIVLA_CACHE}"
}

# run_task UNFINISHED COMMAND...: runs a command; queues the task again if it exits with UNFINISHED after SIGUSR1
run_task() {
    unfinished=$1
    shift
    hold_scratch
    "$@" 9>&- &
    child=$!
    # signalled before the command was started
    if [ -n "${stopped}" ]; then kill -TERM "${child}" 2>/dev/null; fi
    # a signal interrupts the wait; repeat until the command has exited, which may be before the first check
    wait "${child}"
    status=$?
    while kill -0 "${child}" 2>/dev/null; do
        wait "${child}"
        status=$?
    done
    if [ -n "${stopped}" ] && [ "${status}" -gt 128 ]; then
        wait "${child}" 2>/dev/null
        status=$?
        # the status was lost, or SIGTERM ended the command before it could drain
        case "${status}" in 127 | 143) status=${unfinished} ;; esac
    fi
    if [ -n "${requeue}" ] && [ "${status}" -eq "${unfinished}" ]; then
        echo "stopped before the run was finished: requeueing"
        scontrol requeue "${SLURM_ARRAY_JOB_ID:-${SLURM_JOB_ID}}${SLURM_ARRAY_TASK_ID:+_${SLURM_ARRAY_TASK_ID}}"
        exit $?
    fi
    leave_scratch "${status}"
    exit "${status}"
}
"""
"""Shell functions that stop and requeue a task, also in `deploy/slurm/workers.sh`."""


@dataclass(frozen=True)
class SlurmJob:
    """Resources and files of the jobs of a run; all paths are on a file system that the nodes share."""

    run: Path
    """Folder of the run, absolute."""
    tasks: int
    """Number of tasks: shards, or workers."""
    cpus: int
    """Number of cores of a task."""
    time: str
    """Time limit of a task, in Slurm's form."""
    partition: str | None = None
    """Partition of the tasks; `None` for the default partition."""
    setup: tuple[str, ...] = ()
    """Shell lines that run before each command, such as `module load python`."""
    factory: tuple[str, ...] = ("factory",)
    """Command that starts `factory`."""
    has_local_ledgers: bool = False
    """Whether ledgers are on the local disks of the nodes, because SQLite cannot use the file system of `run`."""

    @property
    def plan(self) -> Path:
        return self.run / "slurm" / "plan.toml"

    @property
    def scenes(self) -> Path:
        return self.run / "scenes"

    @property
    def dataset(self) -> Path:
        return self.run / "dataset"


def shards_script(job: SlurmJob) -> str:
    """Returns the script of an array whose tasks each generate one shard."""
    options = ("--scenes", job.scenes, "--workers", job.cpus, "--gate", "skip")
    shard = f'--shard "${{SLURM_ARRAY_TASK_ID}}/{job.tasks}" --out {_quoted(job.run)}/shards/"${{SLURM_ARRAY_TASK_ID}}"'
    command = f"run_task 130 {_command(job, 'run', job.plan, *options)} {shard}"
    return _script(job, "shards", command, array=job.tasks, cpus=job.cpus)


def gather_script(job: SlurmJob) -> str:
    """Returns the script that joins the shards after the array has ended."""
    command = _command(job, "gather", job.plan, job.run / "shards", "--out", job.dataset)
    return _script(job, "gather", f"run_task 130 {command}", cpus=1)


def coordinator_script(job: SlurmJob) -> str:
    """Returns the script of the coordinator, which creates its certificate for the node that it gets."""
    keys = ("keys", "host", job.run / "pki", "hub", "--role", "coordinator", "--renew", "--days", 30)
    start = ("coordinator", "start", job.plan, "--out", job.dataset, "--listen", "tls/0.0.0.0:0", "--pullers", job.cpus)
    lines = (
        f'{_command(job, *keys)} --address "{_HOST}" || exit $?',
        f"run_task 130 {_command(job, *start, '--tls', job.run / 'pki' / 'hub')}",
    )
    return _script(job, "coordinator", "\n".join(lines), cpus=job.cpus)


def workers_script(job: SlurmJob) -> str:
    """Returns the script of an array of workers, which find the coordinator through the folder of the run."""
    options = ("--connect", f"@{job.dataset}", "--tls", job.run / "pki" / "worker")
    more = ("--cores", job.cpus, "--connect-timeout", 3600, "--verbose")
    spool = '--spool "${MINIVLA_CACHE}/spool-${SLURM_ARRAY_TASK_ID}"'
    command = f"run_task 130 {_command(job, 'worker', *options, *more)} {spool}"
    return _script(job, "workers", command, array=job.tasks, cpus=job.cpus)


def submit(script: Path, *options: str) -> int:
    """Submits a script and returns the id of its job.

    Raises:
        UsageError: this host has no `sbatch`.
        WorldError: Slurm refuses the job.
    """
    try:
        done = subprocess.run(
            ["sbatch", "--parsable", *options, script],
            capture_output=True,
            text=True,
            check=False,
            env=child_environment(os.environ),
        )
    except FileNotFoundError as error:
        raise UsageError(
            f"sbatch is not installed on this host: submit {script} on a login node, or write the scripts only, with "
            "--no-submit"
        ) from error
    if done.returncode:
        raise WorldError(
            f"sbatch refused {script}: {' '.join(done.stderr.split())}; `sinfo --format='%P %D %c'` lists partitions, "
            "number of nodes and cores of a node"
        )
    return int(done.stdout.strip().partition(";")[0])


def _script(job: SlurmJob, name: str, command: str, *, cpus: int, array: int | None = None) -> str:
    log = job.run / "slurm" / (f"{name}-%a.log" if array else f"{name}.log")
    options = {
        "job-name": f"minivla-{name}",
        "array": None if array is None else f"1-{array}",
        "ntasks": 1,
        "cpus-per-task": cpus,
        "mem-per-cpu": "1500M",
        "time": job.time,
        "partition": job.partition,
        "requeue": "",
        "open-mode": "append",
        "signal": f"B:USR1@{_NOTICE_S}",
        "output": log,
    }
    head = [
        f"#SBATCH --{key}{f'={value}' if value != '' else ''}" for key, value in options.items() if value is not None
    ]
    setup = [
        *job.setup,
        "# scenes, bundles and local ledgers are stored on the disk of the node",
        f'export MINIVLA_CACHE="{_SCRATCH}"',
        'mkdir -p "${MINIVLA_CACHE}" || exit $?',
        *(_LOCAL_LEDGER if job.has_local_ledgers else ()),
    ]
    return "\n".join(["#!/bin/bash", *head, "set -u", *setup, RUN_TASK, command, ""])


_LOCAL_LEDGER = ('export MINIVLA_LEDGER="sqlite:///${MINIVLA_CACHE}/ledger-${SLURM_ARRAY_TASK_ID:-0}.db"',)


def _command(job: SlurmJob, *words: object) -> str:
    return shlex.join([*job.factory, *map(str, words)])


def _quoted(path: Path) -> str:
    return shlex.quote(str(path))


def write_scripts(job: SlurmJob, mode: Mode) -> Sequence[Path]:
    """Writes the scripts of a run to its folder; returns their paths in the order of submission."""
    makers = (
        {"shards": shards_script, "gather": gather_script}
        if mode == "shards"
        else {"coordinator": coordinator_script, "workers": workers_script}
    )
    paths = []
    for name, make in makers.items():
        path = job.run / "slurm" / f"{name}.sh"
        path.write_text(make(job), encoding="utf-8")
        path.chmod(0o755)
        paths.append(path)
    return paths


def order_of(mode: Mode) -> tuple[str, str, str]:
    """Returns the names of the first and the second job, and the kind of dependency of the second on the first."""
    return ("shards", "gather", "afterany") if mode == "shards" else ("coordinator", "workers", "after")


def submit_all(job: SlurmJob, mode: Mode) -> dict[str, int]:
    """Submits the written scripts with their dependencies; returns the job ids by name.

    Raises:
        UsageError: this host has no `sbatch`.
        WorldError: Slurm refuses a job; a job that was already submitted is cancelled.
    """
    first, second, when = order_of(mode)
    leading = submit(job.run / "slurm" / f"{first}.sh")
    try:
        following = submit(job.run / "slurm" / f"{second}.sh", f"--dependency={when}:{leading}")
    except WorldError:
        subprocess.run(["scancel", str(leading)], check=False, env=child_environment(os.environ))
        raise
    return {first: leading, second: following}


def submit_new_run(job: SlurmJob, mode: Mode) -> dict[str, int]:
    """Submits the scripts as `submit_all`; if Slurm refuses, removes the folder, so the run can be prepared again."""
    try:
        return submit_all(job, mode)
    except WorldError:
        shutil.rmtree(job.run)
        raise


def prepare_run(job: SlurmJob, plan: Plan, mode: Mode) -> None:
    """Creates the folder of a run with its plan, its compiled scenes and, for workers, its certificates.

    Raises:
        UsageError: the folder exists.
        InvalidPlan: the scenes cannot fulfil the plan.
        WorldError: the folder cannot be written.
    """
    if job.run.exists():
        other = f", or continue its run with {_again(job.run)}" if is_submitted_run(job.run) else ""
        raise UsageError(f"{job.run} exists: choose another --out{other}")
    catalog = open_catalog(plan, job.dataset, scene_cache(), print_building)
    try:
        with translated("write", job.run):
            job.plan.parent.mkdir(parents=True)
            (job.run / "shards").mkdir()
            job.plan.write_text(plan_to_toml(plan), encoding="utf-8")
            copy_scenes(catalog, job.scenes if mode == "shards" else job.dataset / "scenes")
        if mode == "workers":
            now = datetime.now(UTC)
            create_authority(job.run / "pki", plan.run, _AUTHORITY_DAYS, now)
            admit(job.run / "pki", "worker", Role.WORKER, (), _AUTHORITY_DAYS, now)
    except FactoryError:
        shutil.rmtree(job.run, ignore_errors=True)  # so that the command can be repeated
        raise


def copy_scenes(catalog: Catalog, folder: Path) -> None:
    """Copies the packages of scenes to a new folder, with their names in a dataset."""
    folder.mkdir(parents=True)
    for name, entry in catalog.items():
        copy_package(entry.path, folder / scene_file(name, entry.sha256))


def _again(run: Path) -> str:
    """Returns the shell command that submits the jobs of a run again."""
    scripts = run / "slurm"
    first, second, when = order_of("shards" if (scripts / "shards.sh").is_file() else "workers")
    job = f"$(sbatch --parsable {shlex.quote(str(scripts / first))}.sh)"
    return f"`sbatch --dependency={when}:{job} {shlex.quote(str(scripts / second))}.sh`"
