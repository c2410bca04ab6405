"""One core's story, over and over: a ready simulation, a claim, a scene, an attempt, and what came of it.

One claim is one attempt; a slot decides nothing about the job, it reports.
"""

from __future__ import annotations

import secrets
import time
from pathlib import Path
from typing import NoReturn

import structlog

from schemas.errors import FactoryError, LeaseLost, WorldError
from schemas.job import Job
from schemas.keys import Chunk, Verb
from schemas.support.log_limit import Repeated
from schemas.terms import FailReason
from schemas.wire import Ack, Claim, ClaimReply, Done, Fail, Lease
from workers.client.backoff import Backoff
from workers.client.host import Host
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind, failure
from workers.process.simulation import Death, Simulation

__all__ = ["Slot"]

_POLL_S = 0.1
_LONGEST_IDLE_S = 30.0
_STARTS = 3
_LAST_TRIES = 2
_FALLBACK = "TinyRenderer"
_FALLBACK_REMEDY = "20 times slower than OpenGL; on Debian: apt-get install libegl1 libgl1-mesa-dri"

log = structlog.get_logger(__name__)


class _Stopped(Exception):
    """The worker was told to stop."""


class Slot:
    """Runs one simulation at a time until the worker closes."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._simulation = Simulation(host.command, host.settings.hang_s)
        self._trouble = Backoff(1.0, 60.0)
        self._failing = Repeated(log, "attempts_fail_here")

    def run(self) -> None:
        """Works until there is no more to do; whatever breaks it ends the whole worker."""
        try:
            while not self._host.phase.closing.is_set():
                self._turn()
        except _Stopped:
            pass
        except Exception as error:  # noqa: BLE001 - the worker loop: told to the supervisor, which raises it
            self._host.phase.fail(error)
        finally:
            self._simulation.kill()

    def _turn(self) -> None:
        if self._host.spool.is_full:
            self._host.pause(0.5)
            return
        self._be_ready()
        reply = self._claim()
        if reply is None:
            return
        if reply.job is not None and reply.lease is not None:
            self._work(reply.job, reply.lease, reply)
        elif reply.finished:
            self._host.phase.finish()
        else:
            self._host.pause(min(max(reply.retry_after_s, 0.05), _LONGEST_IDLE_S))

    def _be_ready(self) -> None:
        """Has a process at hand before a job is taken, so that no job suffers from one that cannot start."""
        starts = Backoff(0.5, 5.0)
        while not (self._simulation.is_running or self._host.phase.closing.is_set()):
            self._simulation.start()
            heard = self._hear_ready()
            if isinstance(heard, SimulationReport):
                self._tell_renderer(heard.renderer)
                return
            pause_s = starts.fail()
            if starts.failures >= _STARTS:
                command = " ".join(self._host.command)
                raise WorldError(
                    f"a simulation does not start after {_STARTS} tries of `{command}`: {heard.detail}; run this "
                    "command by hand to see why, or choose another --renderer"
                )
            self._host.pause(pause_s)

    def _hear_ready(self) -> SimulationReport | Death:
        while True:
            heard = self._simulation.hear(_POLL_S)
            if self._host.phase.closing.is_set():
                raise _Stopped  # nothing is claimed any more, so that nobody needs the process
            if heard is not None:
                return heard

    def _tell_renderer(self, renderer: str) -> None:
        """Says once a worker, not once a core, what draws; the simulation's own warnings stay in its stderr."""
        host = self._host
        log.debug("simulation_ready", renderer=renderer, pid=self._simulation.pid)
        if renderer in host.renderers:
            return
        host.renderers.add(renderer)
        if host.settings.renderer == "auto" and _FALLBACK in renderer:
            log.warning("renderer_fallback", renderer=renderer, remedy=_FALLBACK_REMEDY)
        else:
            log.info("renderer", renderer=renderer)

    def _claim(self) -> ClaimReply | None:
        """Asks under one token until an answer is known; `None` when the worker closes before."""
        host, away = self._host, Backoff(0.1, 5.0)
        claim = Claim(sid=host.sid, token=secrets.token_hex(16))
        while not host.phase.closing.is_set():
            reply = host.link.ask(Verb.CLAIM, claim, ClaimReply, host.phase.ask_timeout_s)
            if reply is not None:
                return reply
            host.pause(away.fail())
        return None

    def _work(self, job: Job, lease: Lease, given: ClaimReply) -> None:
        begun = time.monotonic()
        with self._host.leases.held(lease):
            try:
                report = self._attempt(job, lease, given)
            except LeaseLost:
                self._give_up(lease)
                log.info("lease_lost", job=lease.job_id, fence=lease.fence, episode=job.episode_id)
                return
            except _Stopped:
                self._give_up(lease)
                report = failure(FailReason.RELEASED, "the worker was told to stop")
            if report.kind is SimulationReportKind.SUCCESS:
                report = self._hand_over(job, lease, report)
            if report.kind is SimulationReportKind.FAILURE:
                self._host.spool.clear(lease)
                self._report_failure(job, lease, report, time.monotonic() - begun)
        self._rest_after(report)

    def _give_up(self, lease: Lease) -> None:
        self._simulation.kill()
        self._host.spool.clear(lease)

    def _attempt(self, job: Job, lease: Lease, given: ClaimReply) -> SimulationReport:
        host = self._host
        try:
            scene = self._fetch(job.scene_sha256, job.scene_bytes, lease)
            more = given.attachment
            attached = self._fetch(more.sha256, more.size, lease) if more is not None else None
        except FactoryError as error:
            if isinstance(error, LeaseLost):
                raise
            return failure(FailReason.RELEASED, f"no scene: {error}")
        bundle = host.spool.path_for(lease)
        order = SimulationOrder(
            job=job,
            scene_path=scene,
            bundle_path=bundle,
            sid=host.sid,
            errand=given.errand,
            attachment_path=attached,
        )
        self._simulation.order(order)
        step = 0
        while True:
            heard = self._simulation.hear(_POLL_S)
            if isinstance(heard, Death):
                return failure(heard.reason, heard.detail, step)
            if heard is not None and heard.kind in {SimulationReportKind.SUCCESS, SimulationReportKind.FAILURE}:
                return heard
            self._check(lease)
            if heard is not None:
                step = heard.step
                host.leases.note_step(lease, step)

    def _fetch(self, sha256: str, size: int, lease: Lease) -> Path:
        """Returns the file of that digest, a scene or what is attached to an errand."""
        host = self._host

        def wait() -> None:
            self._check(lease)
            time.sleep(_POLL_S)

        def fetch(chunk: Chunk) -> bytes:
            away = Backoff(0.1, 2.0)
            while True:
                self._check(lease)
                data = host.link.fetch_scene(sha256, chunk)
                if data is not None:
                    return data
                host.phase.stopping.wait(away.fail())

        return host.scenes.ensure(sha256, size, fetch, wait)

    def _check(self, lease: Lease) -> None:
        if self._host.phase.stopping.is_set():
            raise _Stopped
        if self._host.leases.is_lost(lease):
            raise LeaseLost(f"lease on job {lease.job_id} (fence {lease.fence}) belongs to another worker")

    def _hand_over(self, job: Job, lease: Lease, report: SimulationReport) -> SimulationReport:
        """Spools and announces a bundle; returns the report, or the failure that a full disk has made of it."""
        host = self._host
        if report.sha256 is None or report.size is None:
            self._bug(report)
        try:
            entry = host.spool.add(lease, report.sha256, report.size)
        except WorldError as error:
            return failure(FailReason.RELEASED, str(error), report.step, report.seconds)
        log.info("bundle_spooled", episode=job.episode_id, steps=report.step, seconds=round(report.seconds, 1))
        # once is enough: the heartbeat repeats it until the coordinator says drop
        done = Done(sid=host.sid, lease=lease, sha256=entry.sha256, size=entry.size, via=host.link.via)
        host.link.ask(Verb.DONE, done, Ack, host.phase.ask_timeout_s)
        return report

    def _report_failure(self, job: Job, lease: Lease, report: SimulationReport, seconds: float) -> None:
        """Reports a failed attempt until the answer is known, the lease is lost, or time is up."""
        host, away = self._host, Backoff(0.1, 5.0)
        if report.reason is None:
            self._bug(report)
        fail = Fail(
            sid=host.sid,
            lease=lease,
            reason=report.reason,
            detail=report.detail,
            steps=report.step,
            seconds=report.seconds or seconds,
        )
        log.info("attempt_failed", episode=job.episode_id, reason=str(report.reason), detail=report.detail)
        while host.phase.left_s > 0 and not host.leases.is_lost(lease):
            if host.link.ask(Verb.FAIL, fail, Ack, host.phase.ask_timeout_s) is not None:
                return
            pause_s = away.fail()
            if host.phase.stopping.is_set() and away.failures >= _LAST_TRIES:
                return  # nobody there: the lease runs out by itself
            if host.phase.stopping.wait(pause_s):
                time.sleep(min(pause_s, host.phase.left_s))

    def _rest_after(self, report: SimulationReport) -> None:
        """Pauses longer and longer when this machine seems to be at fault, so that it spoils few jobs."""
        if report.reason in {FailReason.CRASH, FailReason.HANG, FailReason.RELEASED}:
            if not self._host.phase.stopping.is_set():
                self._failing.fail(report.detail, reason=str(report.reason))
            self._host.pause(self._trouble.fail())
        else:
            self._trouble.succeed()
            self._failing.succeed()

    def _bug(self, report: SimulationReport) -> NoReturn:
        raise AssertionError(f"a report that its own model forbids: {report}")
