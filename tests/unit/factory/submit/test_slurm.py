"""Slurm scripts of a run: run by bash with a stub of the command line, and submitted to a stub of sbatch."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from factory.submit.slurm import SlurmJob, submit_all, write_scripts
from schemas.errors import UsageError, WorldError


def tool(folder: Path, name: str, body: str) -> Path:
    path = folder / name
    path.write_text(f"#!/bin/bash\n{body}\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def job(tmp_path: Path) -> SlurmJob:
    """A run in a folder whose name has a space, with a command line that records its arguments."""
    run = tmp_path / "the run"
    (run / "slurm").mkdir(parents=True)
    stub = tool(tmp_path, "factory", f'printf "%s|" "$@" >> "{tmp_path}/said"; exit 0')
    return SlurmJob(run, tasks=3, cpus=4, time="01:00:00", factory=(str(stub),))


def environment(tmp_path: Path) -> dict[str, str]:
    return {
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "SLURM_TMPDIR": str(tmp_path / "local"),
        "SLURM_JOB_ID": "17",
        "SLURM_ARRAY_JOB_ID": "15",
        "SLURM_ARRAY_TASK_ID": "2",
        "USER": "me",
    }


def test_each_task_generates_its_shard_with_quoted_paths(job, tmp_path):
    shards, gather = write_scripts(job, "shards")
    subprocess.run([shards], env=environment(tmp_path), check=True)
    said = (tmp_path / "said").read_text()
    assert said.startswith(f"run|{job.plan}|--scenes|{job.scenes}|--workers|4|")
    assert said.endswith(f"--shard|2/3|--out|{job.run}/shards/2|")
    text = shards.read_text()
    assert {"#SBATCH --array=1-3", "#SBATCH --cpus-per-task=4", "#SBATCH --time=01:00:00"} <= set(text.splitlines())
    assert "--array" not in gather.read_text()


def test_the_options_of_the_site_are_part_of_every_script(job):
    special = replace(job, partition="cpu", setup=("module load minivla",), has_local_ledgers=True)
    for script in (*write_scripts(special, "shards"), *write_scripts(special, "workers")):
        lines = script.read_text().splitlines()
        assert "#SBATCH --partition=cpu" in lines
        assert "module load minivla" in lines
        assert any("MINIVLA_LEDGER" in line for line in lines)


@pytest.mark.parametrize(("number", "is_requeued"), [(signal.SIGUSR1, True), (signal.SIGTERM, False)])
def test_a_worker_task_keeps_its_spool_only_for_a_requeue(job, tmp_path, number, is_requeued):
    tool(tmp_path, "scontrol", f'echo "$@" > "{tmp_path}/told"')
    body = 'mkdir -p "${@: -1}"; trap "exit 130" TERM; echo up; while :; do sleep 0.05; done'
    stub = tool(tmp_path, "waiting", body)
    _, workers = write_scripts(replace(job, factory=(str(stub),)), "workers")
    command = ["bash", workers]
    with subprocess.Popen(command, env=environment(tmp_path), stdout=subprocess.PIPE, text=True) as task:
        assert task.stdout is not None
        assert task.stdout.readline() == "up\n"
        task.send_signal(number)
        assert task.wait(60) == (0 if is_requeued else 130)
    (spool,) = [*(tmp_path / "local").glob("*/spool-2")] or [None]
    assert (spool is not None) == is_requeued
    assert (tmp_path / "told").exists() == is_requeued


@pytest.mark.parametrize(("status", "is_requeued"), [(130, True), (0, False), (1, False)])
@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGTERM])
def test_a_coordinator_task_is_requeued_and_keeps_its_ledger_only_if_the_run_is_unfinished(
    job, tmp_path, number, status, is_requeued
):
    tool(tmp_path, "scontrol", f'echo "$@" > "{tmp_path}/told"')
    ledger = "${MINIVLA_CACHE}/ledger-${SLURM_ARRAY_TASK_ID}.db"
    body = (
        f'[ "$1" = keys ] && exit 0; touch "{ledger}"; trap "exit {status}" TERM; echo up; while :; do sleep 0.05; done'
    )
    stub = tool(tmp_path, "waiting", body)
    coordinator, _ = write_scripts(replace(job, factory=(str(stub),), has_local_ledgers=True), "workers")
    with subprocess.Popen(["bash", coordinator], env=environment(tmp_path), stdout=subprocess.PIPE, text=True) as task:
        assert task.stdout is not None
        assert task.stdout.readline() == "up\n"
        task.send_signal(number)
        is_warned = number == signal.SIGUSR1
        assert task.wait(60) == (0 if is_requeued and is_warned else status)
    assert (tmp_path / "told").exists() == (is_requeued and is_warned)
    assert bool([*(tmp_path / "local").glob("*/ledger-2.db")]) == (status != 0)


def test_the_second_job_waits_for_the_first(job, tmp_path, monkeypatch):
    tool(tmp_path, "sbatch", f'echo "$@" >> "{tmp_path}/submitted"; echo "41;cluster"')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    write_scripts(job, "shards")
    write_scripts(job, "workers")
    assert submit_all(job, "shards") == {"shards": 41, "gather": 41}
    assert submit_all(job, "workers") == {"coordinator": 41, "workers": 41}
    lines = (tmp_path / "submitted").read_text().splitlines()
    assert ["--dependency=afterany:41" in line for line in lines] == [False, True, False, False]
    assert ["--dependency=after:41" in line for line in lines] == [False, False, False, True]


def test_the_first_job_is_cancelled_if_the_second_is_refused(job, tmp_path, monkeypatch):
    tool(tmp_path, "sbatch", '[ "$#" -eq 2 ] && echo 41 && exit; echo "no dependency" >&2; exit 1')
    tool(tmp_path, "scancel", f'echo "$@" > "{tmp_path}/cancelled"')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    write_scripts(job, "shards")
    with pytest.raises(WorldError, match=r"sbatch refused .*gather\.sh: no dependency"):
        submit_all(job, "shards")
    assert (tmp_path / "cancelled").read_text() == "41\n"


def test_a_host_without_slurm_and_a_refused_job_raise_errors_with_the_reason(job, tmp_path, monkeypatch):
    write_scripts(job, "shards")
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    with pytest.raises(UsageError, match="sbatch is not installed on this host"):
        submit_all(job, "shards")
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    tool(tmp_path, "sbatch", 'echo "invalid partition" >&2; exit 1')
    with pytest.raises(WorldError, match=r"sbatch refused .*shards\.sh: invalid partition"):
        submit_all(job, "shards")


def test_the_last_task_of_a_node_removes_the_folder_of_the_run(job, tmp_path):
    """Two tasks share the folder; the first one that ends leaves it to the other."""
    wait = 'while [ ! -e "${SLURM_TMPDIR}/end-${SLURM_ARRAY_TASK_ID}" ]; do sleep 0.05; done'
    body = 'mkdir -p "${MINIVLA_CACHE}/fetched" "${@: -1}"; echo up; ' + wait
    stub = tool(tmp_path, "waiting", body)
    _, workers = write_scripts(replace(job, factory=(str(stub),)), "workers")
    folder = tmp_path / "local" / "minivla-me-15"
    tasks = []
    for number in ("2", "3"):
        settings = environment(tmp_path) | {"SLURM_ARRAY_TASK_ID": number}
        tasks.append(subprocess.Popen(["bash", workers], env=settings, stdout=subprocess.PIPE, text=True))
    for task in tasks:
        assert task.stdout is not None
        assert task.stdout.readline() == "up\n"
    for task, number, is_last in zip(tasks, ("2", "3"), (False, True), strict=True):
        (tmp_path / "local" / f"end-{number}").touch()
        task.communicate(timeout=60)
        assert task.returncode == 0
        assert folder.exists() != is_last


def test_a_task_removes_the_folder_that_killed_tasks_left_and_no_folder_in_use(job, tmp_path):
    stub = tool(tmp_path, "quick", "true")
    _, workers = write_scripts(replace(job, factory=(str(stub),)), "workers")
    names = ("minivla-me-7", "minivla-me-8", "minivla-me-9")
    for name in names:
        (tmp_path / "local" / name).mkdir(parents=True)
        (tmp_path / "local" / name / ".lock").touch()
    for name in names[:2]:
        os.utime(tmp_path / "local" / name / ".lock", (1e9, 1e9))
    with (tmp_path / "local" / names[1] / ".lock").open() as held:
        fcntl.flock(held, fcntl.LOCK_SH)
        subprocess.run(["bash", workers], env=environment(tmp_path), check=True)
    assert sorted(path.name for path in (tmp_path / "local").iterdir()) == [*names[1:]]
