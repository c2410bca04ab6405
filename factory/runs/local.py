"""A whole run on one machine: a coordinator in this process, workers beside it, over zenoh on loopback.

Owns the workers' processes: restarts those that die, stops all when it ends. Prints nothing; a listener is told.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import structlog

from coordinator.expansion.catalog import Catalog
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.runs.catalog import write_target_lists
from schemas.dataset_meta import GateOutcome
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.storage.disk import require_room
from schemas.storage.object_path import ObjectPath
from schemas.support.child import child_environment, python_module
from schemas.support.closing import Closing
from schemas.terms import RendererKind
from schemas.wire import Progress
from workers.client.spool import find_bundle, folder_of
from workers.experts import require_expert

__all__ = ["LocalRun", "run_locally"]

_LISTEN = ("tcp/127.0.0.1:0",)
_SPOOL = ".spool"
_POLL_S = 0.25
_LEAVE_S = 8.0
_MOST_DEATHS = 8
"""Deaths of one worker without an episode in between after which the run gives up."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class LocalRun:
    """What to run here."""

    plan: Plan
    catalog: Catalog
    root: Path
    """Dataset directory, or with `store` the home of what cannot lie there."""
    workers: int
    """Worker processes, one simulation each."""
    renderer: RendererKind = "auto"
    verbose: bool = False
    gate: tuple[GateOutcome, ...] = ()
    """What the pilot found before the run."""
    store: ObjectPath | None = None
    """Where the dataset lies, when in object storage."""


def run_locally(
    run: LocalRun, settings: CoordinatorSettings, stop: threading.Event, tell: Callable[[Progress], None]
) -> Progress:
    """Makes the dataset, or goes on with it; returns when the run is finished or `stop` is set.

    Args:
        run: plan, scenes, place and workers.
        settings: of the coordinator.
        stop: leave in good order.
        tell: told the progress a few times a second.

    Raises:
        WorldError: the directory is taken or cannot be written, or workers die again and again.
        UsageError: the directory holds another plan, or this version lacks the expert.
    """
    require_expert(run.plan.expert)
    require_room(run.root, settings.reserve_bytes)
    spool = folder_of(run.root / _SPOOL, run.plan.run)
    with Coordinator(
        run.root,
        run.plan,
        run.catalog,
        CoordinatorOptions(
            listen=_LISTEN,
            settings=settings,
            gate=run.gate,
            store=run.store,
            nearby=lambda lease: find_bundle(spool, lease),
        ),
    ) as coordinator:
        write_target_lists(run.catalog, run.store or run.root)
        progress = coordinator.progress()
        tell(progress)
        if progress.finished:
            return progress
        with _Crew(run, coordinator.endpoints[0]) as crew:
            while not (progress.finished or stop.wait(_POLL_S)):
                progress = coordinator.progress()
                tell(progress)
                crew.look_after(progress.jobs.get("archived", 0))
                _require_work(run, progress)
        progress = coordinator.progress()
        tell(progress)
        if progress.finished:
            shutil.rmtree(run.root / _SPOOL, ignore_errors=True)  # nothing in it is wanted any more
        return progress


def _require_work(run: LocalRun, progress: Progress) -> None:
    """Ends a run in which nobody gets a job any more.

    Raises:
        WorldError: the host of all workers, this one, is barred.
    """
    barred = [host for host in progress.hosts if host.barred_at is not None]
    if not barred or progress.finished or progress.jobs.get("submitted", 0):
        return
    host, site = barred[0], run.store or run.root
    raise WorldError(
        f"host {host.host} is barred after {host.strikes} failures, last: {host.reason}; {progress.missing} of "
        f"{progress.planned} episodes are missing. Repair the host, then run `factory jobs release {site} {host.host}` "
        f"and `factory run --out {site}`"
    )


class _Crew(Closing):
    """The worker processes; each watches our end of its stdin and leaves when it closes, however we end."""

    def __init__(self, run: LocalRun, endpoint: str) -> None:
        self._command = [
            *python_module("factory", "worker", "--cores", "1", "--connect", endpoint, "--until-eof"),
            *("--renderer", run.renderer, "--spool", str(run.root / _SPOOL)),
            *(("--verbose",) if run.verbose else ()),
        ]
        self._deaths = 0
        self._archived = 0
        self._members = [self._start() for _ in range(run.workers)]

    def look_after(self, archived: int) -> None:
        """Starts a dead worker again; gives up when they only die.

        Raises:
            WorldError: too many deaths without a new episode.
        """
        if archived > self._archived:
            self._archived, self._deaths = archived, 0
        for place, member in enumerate(self._members):
            code = member.poll()
            if code is None or code == 0:
                continue
            self._deaths += 1
            log.warning("worker_died", status=code, deaths=self._deaths)
            if self._deaths > _MOST_DEATHS:
                raise WorldError(
                    f"workers died {self._deaths} times in a row without an episode, last with exit status {code}"
                )
            self._members[place] = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        # a session of its own: Ctrl-C reaches us, and we stop them in order
        return subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=sys.stderr,
            env=child_environment(os.environ),
            start_new_session=True,
        )

    def close(self) -> None:
        """Lets the workers end; kills those that take too long."""
        for member in self._members:
            if member.stdin is not None:
                member.stdin.close()
        for member in self._members:
            try:
                member.wait(_LEAVE_S)
            except subprocess.TimeoutExpired:
                member.kill()
                member.wait()
