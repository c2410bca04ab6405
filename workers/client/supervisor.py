"""Supervisor of a worker: finds the run, runs one slot per core and one heartbeat, and shuts down cleanly.

Does not simulate, and does not fork while the link is open: simulations are separate processes.
"""

from __future__ import annotations

import random
import socket
import threading
import time
from enum import Enum

import structlog

from schemas.errors import WorldError
from schemas.protocol.identity import Role
from schemas.protocol.messages import PROTOCOL, HelloReply, Refusal, RunKind
from schemas.support.product import product_version
from workers.client.heartbeat import Heartbeat, make_hello
from workers.client.host import Backoff, Host, Phase, make_sid, valid_host_name
from workers.client.link import Link
from workers.client.scene_cache import SceneCache
from workers.client.settings import WorkerSettings
from workers.client.slot import Slot
from workers.client.spool import Spool, folder_of

STOPPED = 130
"""Exit status of a worker that was stopped before its run was finished; batch systems start it again."""
_POLL_S = 0.2
_DRAIN_S = 3.5
"""Time for replies of the coordinator after a stop, seconds."""
# a stopped worker ends within 5 s; the remaining 1.5 s are for the poll of the signal, the end of the threads and the
# exit of the process
_JOIN_S = 2.0
_FINISH_TIMEOUT_S = 5.0
"""Time after the end of a run for which a worker still asks the coordinator about its spooled bundles, seconds. The
time is limited, because the coordinator may have exited."""

log = structlog.get_logger(__name__)


class Ending(Enum):
    """Reason for the end of a worker's work for a run."""

    FINISHED = "finished"  # all jobs of the run have ended, or the coordinator drains its workers
    STOPPED = "stopped"  # the worker was stopped
    MOVED = "moved"  # another run replaced this one, or an evaluation has priority


def run_worker(settings: WorkerSettings, stop: threading.Event, at_once: threading.Event | None = None) -> int:
    """Runs a worker until the run is finished or `stop` is set; then returns its jobs within five seconds.

    Args:
        settings: settings of the worker.
        stop: event for a clean shutdown: the worker returns its jobs and waits a moment for its bundles to be fetched.
        at_once: event for an immediate shutdown without that wait.

    Returns:
        The exit status: 0 if the run is finished or the coordinator drains its workers, `STOPPED` if the worker was
        stopped before.

    Raises:
        WorldError: no coordinator answered within `wait_s`, it refuses this worker, or simulations do not start.
    """
    at_once = at_once or threading.Event()
    name = valid_host_name(settings.host or socket.gethostname())
    sid = make_sid(name)
    settled: str | None = None
    with Link(settings.connect, name, settings.tls) as link:
        while True:
            terms = _find_run(link, settings, name=name, sid=sid, stop=stop, settled=settled)
            if terms is None:
                is_over = link.is_run_finished or settled is not None
                return 0 if is_over else STOPPED
            link.join(terms.run)
            ending = _work_for(terms, link, settings=settings, name=name, sid=sid, stop=stop, at_once=at_once)
            log.info("worker_left", run=terms.run, why=ending.value)
            is_settled = ending is Ending.FINISHED and terms.run_kind is RunKind.EVALUATION
            if ending is Ending.STOPPED:
                return STOPPED
            if not is_settled and ending is not Ending.MOVED:
                return 0
            settled = terms.run if is_settled else None
            sid = make_sid(name)


def _work_for(
    terms: HelloReply,
    link: Link,
    settings: WorkerSettings,
    name: str,
    sid: str,
    stop: threading.Event,
    at_once: threading.Event,
) -> Ending:
    folder = folder_of(settings.spool_dir, terms.run)
    with Spool(folder, settings.spool_limit, settings.max_spool_bytes, settings.min_free_bytes) as spool:
        host = Host(
            settings=settings,
            name=name,
            sid=sid,
            run=terms.run,
            run_kind=terms.run_kind,
            command=settings.command_for(terms.run_kind),
            lease_ttl_s=terms.lease_ttl_s,
            check_bundle=settings.check_bundle if terms.validates else None,
            link=link,
            spool=spool,
            scenes=SceneCache(settings.scene_dir, settings.max_scene_bytes),
            rng=random.Random(sid),  # noqa: S311 - jitter
        )
        return Supervisor(host, stop, at_once).run()


class Supervisor:
    """Threads of one worker for one run: slots and heartbeat."""

    def __init__(self, host: Host, stop: threading.Event, at_once: threading.Event) -> None:
        self._host = host
        self._phase: Phase = host.phase
        self._stop, self._at_once = stop, at_once
        slots = [Slot(host) for _ in range(host.settings.cores)]
        self._slots = [threading.Thread(target=slot.run, name=f"slot-{n}") for n, slot in enumerate(slots)]
        self._heartbeat = Heartbeat(host)
        self._heartbeat_thread = threading.Thread(target=self._heartbeat.run, name="heartbeat")

    def run(self) -> Ending:
        """Runs the threads until the worker ends, and returns the reason.

        Raises:
            WorldError: the worker failed, e.g. because simulations do not start.
        """
        host = self._host
        host.link.serve(
            host.sid,
            lambda stop_requested: host.spool.read(stop_requested.job_id, stop_requested.fence, *stop_requested.chunk),
        )
        log.info("worker_started", run=host.run, sid=host.sid, cores=host.settings.cores, spooled=len(host.spool))
        threads = [*self._slots, self._heartbeat_thread]
        for thread in threads:
            thread.start()
        try:
            while not self._is_over():
                self._poll_stop()
        finally:
            self._phase.stop(0.0)
            host.link.close()  # ends all open requests
            for thread in threads:
                thread.join(_JOIN_S)
        if self._phase.error is not None:
            raise self._phase.error
        if self._phase.moved.is_set():
            return Ending.MOVED
        if self._phase.finished_s:
            return Ending.FINISHED
        return Ending.STOPPED if self._stop.is_set() else Ending.FINISHED

    def _poll_stop(self) -> None:
        # wait() needs a timeout: another thread may handle the signal, and this thread would not wake up
        if not self._phase.stopping.is_set() and self._stop.wait(_POLL_S):
            log.info("draining", by="stop", spooled=len(self._host.spool))
            self._phase.stop(_DRAIN_S)
        elif self._phase.stopping.is_set():
            self._at_once.wait(_POLL_S / 4)

    def _is_over(self) -> bool:
        if self._at_once.is_set():
            return True
        if self._phase.left_s == 0.0 or self._phase.finished_s > _FINISH_TIMEOUT_S:
            return True
        if any(slot.is_alive() for slot in self._slots):
            return False
        if self._phase.stopping.is_set() and not self._heartbeat.is_answered:
            return True  # no coordinator fetches the bundles; they stay in the spool until the next start
        return len(self._host.spool) == 0


def _find_run(
    link: Link, settings: WorkerSettings, name: str, sid: str, stop: threading.Event, settled: str | None
) -> HelloReply | None:
    """Waits for the reply of a run until `wait_s` is over; returns `None` if the worker is stopped or the run finished.

    `settled` is the name of the evaluation that has just ended, if any. Its run is ignored. If no other run replies,
    the result is `None` at once.
    """
    hello, pause, started = make_hello(sid, name, settings.cores), Backoff(0.2, 2.0), time.monotonic()
    is_open = False
    while not stop.is_set():
        is_open = is_open or link.open()
        if is_open:
            terms = _choose(link.send_hello(hello), settings, settled)
            if terms is not None:
                return terms
        if link.is_run_finished:
            log.warning("run_finished", detail=link.last_error)
        if settled is not None or link.is_run_finished:
            return None
        if time.monotonic() - started > settings.wait_s:
            where = ", ".join(settings.connect)
            if link.is_foreign:
                raise WorldError(
                    f"the coordinator at {where} sent a reply that {_self()} cannot read, so it runs another version: "
                    "install the version that `factory --version` prints on its host"
                )
            role = link.ask_role() if is_open and settings.tls is not None else None
            if role is not None and role is not Role.WORKER:
                raise WorldError(
                    f"the coordinator at {where} does not take {name!r} as a worker: its role is {role}. Use the --tls "
                    "folder of a worker, or create one where the authority is: `factory keys host DIR NAME`"
                )
            refused = ", or it does not admit this host (its hosts.txt)" if settings.tls is not None else ""
            problem = f" ({link.last_error})" if link.last_error else ""
            raise WorldError(
                f"no coordinator answered at {where} within {settings.wait_s:g} s{problem}{refused}: start one with "
                "`factory coordinator start`, give its endpoint with --connect, or wait longer with --connect-timeout"
            )
        stop.wait(pause.fail())
    return None


def _self() -> str:
    return f"minivla-factory {product_version()} (protocol {PROTOCOL})"


def _choose(
    replies: tuple[HelloReply | Refusal, ...], settings: WorkerSettings, settled: str | None
) -> HelloReply | None:
    """Returns the reply of the run to work for: the first evaluation by name or, without evaluations, the run."""
    greetings = (reply for reply in replies if isinstance(reply, HelloReply) and reply.run != settled)
    terms = sorted((reply for reply in greetings if settings.run in {None, reply.run}), key=lambda reply: reply.run)
    short = [reply for reply in terms if reply.run_kind is RunKind.EVALUATION]
    if short:
        return short[0]
    if len(terms) > 1:
        runs = ", ".join(reply.run for reply in terms)
        raise WorldError(f"{len(terms)} runs answer ({runs}): give --connect endpoints of one run only")
    refusals = [reply.error for reply in replies if isinstance(reply, Refusal)]
    if not terms and refusals:
        mine = "" if product_version() in refusals[0] else f"; this worker runs {_self()}"
        raise WorldError(f"the coordinator refuses this worker: {refusals[0]}{mine}")
    return terms[0] if terms else None
