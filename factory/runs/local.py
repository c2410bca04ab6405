"""Runs a plan on one machine: a coordinator in this process and worker processes, over zenoh on loopback.

Checks before that simulations can start with the renderer. Owns the worker processes: restarts those that exit with an
error, and stops all when the run ends. Prints nothing; a callback receives the progress.
"""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Never

import structlog

from coordinator.expansion.catalog import Catalog
from coordinator.options import CoordinatorOptions
from coordinator.protocol.protocol import FindStates, simulate_all
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.runs.catalog import write_target_lists
from factory.runs.ray_engine import RayCluster
from schemas.dataset.meta import GateOutcome
from schemas.dataset.run_shard import RunShard
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.protocol.status import Progress
from schemas.rig.requirements import require_sensor_packages
from schemas.storage.disk import require_room
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place
from schemas.support.child import child_environment, python_module
from schemas.support.child_process import ChildProcess, Ended
from schemas.support.closing import Closing
from schemas.support.shell import quoted
from schemas.terms import RendererKind
from workers.client.spool import find_bundle, folder_of
from workers.experts import require_expert
from workers.process.messages import read_report

_START_S = 60.0
_REMEDY = (
    "on Debian: apt-get install libegl1 libgl1-mesa-dri; or leave --renderer out, which falls back to the slower "
    "TinyRenderer"
)


def require_renderer(renderer: RendererKind) -> None:
    """Starts and ends a simulation if a renderer is required that this machine may not have.

    The renderer `auto` is not checked, because it falls back to TinyRenderer.

    Raises:
        WorldError: the simulation does not start, e.g. because no EGL driver is installed.
    """
    if renderer != "gl":
        return
    # without this, every worker of the run would start its simulations in vain; OpenGL is not opened in this process,
    # because Mesa starts threads, and a later fork would hang
    command = python_module("workers.sim.simulate", "--renderer", renderer)
    with ChildProcess(read_report, start_s=_START_S) as process:
        process.start(command, child_environment(os.environ))
        report = process.wait()
    if isinstance(report, Ended) and report.is_hung:
        raise WorldError(f"--renderer {renderer}: the simulation did not start within {_START_S:g} s")
    if isinstance(report, Ended):
        raise WorldError(f"--renderer {renderer}: {report.last_output or report.description}; {_REMEDY}")


_LISTEN = ("tcp/127.0.0.1:0",)
_SPOOL = ".spool"
_POLL_S = 0.25
_LEAVE_S = 8.0
_MOST_DEATHS = 8
"""Maximum number of worker crashes without a new episode; after more, the run stops with an error."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class LocalRun:
    """Settings of a run on this machine."""

    plan: Plan
    catalog: Catalog
    root: Path
    """Dataset directory, or with `store` the local state directory."""
    workers: int
    """Largest number of worker processes, each with one simulation; at most one process per missing episode starts."""
    renderer: RendererKind = "auto"
    verbose: bool = False
    gate: tuple[GateOutcome, ...] = ()
    """Results of the acceptance gate before the run."""
    store: ObjectPath | None = None
    """Location of the dataset in object storage; `None` for a dataset in `root`."""
    find_states: FindStates = simulate_all
    """Function that returns the states recording of a job."""
    states: Place | None = None
    """States dataset that the run renders; `None` if it simulates."""
    rig: str | None = None
    """Value of `--rig` of a run that renders."""
    appearance: str | None = None
    """Value of `--appearance` of a run that renders."""
    ledger_url: str | None = None
    """URL of the ledger; by default `ledger.db` in `root`."""
    shard: RunShard | None = None
    """Shard of the run to generate; `None` for the whole run."""
    take_over: bool = False
    """Whether to take over `store` from another state directory, whose coordinator must have ended."""
    worker_options: tuple[str, ...] = ()
    """Further options of `factory worker`."""
    continued_by: str = ""
    """Command line that continues the run; empty selects that of `factory run` or `factory render`."""
    cluster: RayCluster | None = None
    """Cluster that runs the workers; `None` runs them on this machine."""
    extends: Path | None = None
    """Dataset that the run extends; `None` for a separate run."""

    @property
    def command(self) -> str:
        """Command line that continues the run."""
        if self.continued_by:
            return self.continued_by
        if self.extends is not None:
            return f"factory run --extend --out {quoted(self.extends)}"
        site = self.store or self.root
        rig = "" if self.rig is None else f" --rig {self.rig}"
        rig += "" if self.appearance is None else f" --appearance {self.appearance}"
        shard = "" if self.shard is None else f" --shard {self.shard}"
        return (
            f"factory run{shard} --out {quoted(site)}"
            if self.states is None
            else f"factory render {quoted(self.states)}{rig} -o {quoted(site)}"
        )


def run_locally(
    run: LocalRun,
    settings: CoordinatorSettings,
    stop: threading.Event,
    tell: Callable[[Progress], None],
    pages: Callable[[Coordinator], AbstractContextManager[object]] = nullcontext,
) -> Progress:
    """Generates or resumes the dataset; returns when the run is finished or `stop` is set.

    Args:
        run: Plan, scenes, location and number of workers.
        settings: Settings of the coordinator.
        stop: Event that stops the run gracefully.
        tell: Progress callback, called a few times per second.
        pages: Serves pages of the coordinator while the context is open.

    Raises:
        WorldError: Another process uses the directory, it cannot be written, or workers crash repeatedly.
        UsageError: The directory contains another plan, this version does not have the expert of the plan, or a
            package that a sensor needs is not installed.
    """
    require_expert(run.plan.expert)
    require_sensor_packages(run.plan.rig)
    require_room(run.root, settings.reserve_bytes)
    spool = folder_of(run.root / _SPOOL, run.plan.run)
    options = CoordinatorOptions(
        listen=_LISTEN if run.cluster is None else run.cluster.listen,
        guard=None if run.cluster is None else run.cluster.guard,
        ledger_url=run.ledger_url,
        settings=settings,
        gate=run.gate,
        store=run.store,
        take_over=run.take_over,
        shard=run.shard,
        find_states=run.find_states,
        find_local_bundle=lambda lease: find_bundle(spool, lease),
    )
    with Coordinator(run.root, run.plan, run.catalog, options) as coordinator, pages(coordinator):
        write_target_lists(run.catalog, run.store or run.root)
        progress = coordinator.progress()
        tell(progress)
        if progress.finished:
            return progress
        with _open_pool(run, coordinator.endpoints[0], progress.missing) as pool:
            while not (progress.finished or stop.wait(_POLL_S)):
                coordinator.is_finished()  # raises an error of the coordinator itself
                progress = coordinator.progress()
                tell(progress)
                pool.restart_dead(progress.jobs.get("archived", 0))
                _require_work(run, progress)
        progress = coordinator.progress()
        tell(progress)
        if progress.finished:
            shutil.rmtree(run.root / _SPOOL, ignore_errors=True)  # a finished run does not read bundles again
        return progress


def _require_work(run: LocalRun, progress: Progress) -> None:
    """Raises an error when no worker can receive a job.

    Raises:
        WorldError: This host, which runs all workers, is barred.
    """
    barred = [host for host in progress.hosts if host.barred_at is not None]
    if not barred or progress.finished or progress.jobs.get("submitted", 0):
        return
    host, site = barred[0], run.store or run.root
    raise WorldError(
        f"host {host.host} is barred after {host.strikes} failures, last: {host.reason}; {progress.missing} of "
        f"{progress.planned} episodes are missing. Repair the host, then run `factory jobs release "
        f"{quoted(site)} {host.host}` "
        f"and `{run.command}`"
    )


def _open_pool(run: LocalRun, endpoint: str, missing: int) -> _WorkerPool | RayCluster:
    if run.cluster is None:
        return _WorkerPool(run, endpoint, min(run.workers, max(1, missing)))
    run.cluster.open(endpoint)
    return run.cluster


class _WorkerPool(Closing):
    """Worker processes; each exits when its stdin closes, even if this process is killed."""

    def __init__(self, run: LocalRun, endpoint: str, workers: int) -> None:
        self._command = [
            *python_module("factory", "worker", "--cores", "1", "--connect", endpoint, "--until-eof"),
            *("--renderer", run.renderer, "--spool", str(run.root / _SPOOL)),
            *run.worker_options,
            *(("--verbose",) if run.verbose else ()),
        ]
        self._deaths = 0
        self._archived = 0
        self._processes: list[ChildProcess[Never]] = [
            ChildProcess(None, leave_s=_LEAVE_S, stderr="inherit") for _ in range(workers)
        ]
        for process in self._processes:
            self._start(process)

    def restart_dead(self, archived: int) -> None:
        """Restarts workers that exited with an error.

        Raises:
            WorldError: Too many crashes without a new episode.
        """
        if archived > self._archived:
            self._archived, self._deaths = archived, 0
        for process in self._processes:
            end = process.receive(0.0)
            if end is None or end.status == 0:
                continue
            self._deaths += 1
            log.warning("worker_died", status=end.status, deaths=self._deaths)
            if self._deaths > _MOST_DEATHS:
                raise WorldError(
                    f"workers died {self._deaths} times in a row without an episode, last with exit status {end.status}"
                )
            self._start(process)

    def _start(self, process: ChildProcess[Never]) -> None:
        process.start(self._command, child_environment(os.environ))

    def close(self) -> None:
        """Closes the stdin of the workers, waits for them to exit, and kills those that do not."""
        for process in self._processes:
            process.end_input()
        for process in self._processes:
            process.kill()
