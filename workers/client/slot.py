"""Worker loop of one core: starts a simulation, claims a job, fetches its scene, runs an attempt, reports the result.

One claim is one attempt. The loop does not decide about the job; the coordinator does.
"""

from __future__ import annotations

import secrets
import time
from pathlib import Path
from typing import NoReturn

import structlog

from schemas.errors import FactoryError, InvalidBundle, LeaseLost, TransientError, WorldError
from schemas.job import Job
from schemas.protocol.keys import Chunk, Verb
from schemas.protocol.messages import Ack, BuildOrder, Claim, ClaimReply, Fail, Lease
from schemas.support.log_limit import Repeated
from schemas.terms import FailReason
from workers.client.heartbeat import make_done
from workers.client.host import Backoff, Host
from workers.client.scene_cache import Fetch, Wait
from workers.process.messages import BuildTask, SimulationOrder, SimulationReport, SimulationReportKind, failure
from workers.process.simulation import ProcessEnd, Simulation

_POLL_S = 0.1
_LONGEST_IDLE_S = 30.0
_BUILD_S = 900.0
"""Time without a report after which a build is killed as hung, seconds. A build reports only its end and takes 2 to 9 s
of CPU time (docs/performance/layouts.md#building)."""
_STARTS = 3
_LAST_TRIES = 2
_SIGNALLED_S = 1.0
"""Time for which a slot waits for a stop signal to the worker after its simulation was killed, seconds. If the signal
arrives, a batch system is ending both processes: the job is returned, and no crash is reported."""
_FALLBACK = "TinyRenderer"
_FALLBACK_REMEDY = "20 times slower than OpenGL; on Debian: apt-get install libegl1 libgl1-mesa-dri"

log = structlog.get_logger(__name__)


class _Stopped(Exception):
    """Exception that ends the loop of a slot when the worker stops."""


class Slot:
    """Loop that runs one simulation at a time until the worker closes."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._simulation = Simulation(host.command, host.settings.hang_s, host.settings.start_s)
        self._builder = Simulation(host.settings.build_command, _BUILD_S)
        self._backoff = Backoff(host.settings.pause_s, 60.0)
        self._failing = Repeated(log, "attempts_failing")

    def run(self) -> None:
        """Executes jobs until the worker closes; an exception ends the worker."""
        try:
            while not self._host.phase.closing.is_set():
                self._run_once()
        except _Stopped:
            pass
        except Exception as error:  # noqa: BLE001 - the worker loop: passed to the supervisor, which raises it
            self._host.phase.fail(error)
        finally:
            self._simulation.kill()
            self._builder.kill()

    def _run_once(self) -> None:
        if self._host.spool.is_full:
            self._host.phase.heartbeat_due.set()
            self._host.pause(0.5)
            return
        self._ensure_simulation()
        reply = self._claim()
        if reply is None:
            return
        if reply.lease is not None:
            self._work(reply, reply.lease)
        elif reply.finished:
            self._host.phase.finish()
        else:
            self._host.pause(min(max(reply.retry_after_s, 0.05), _LONGEST_IDLE_S))

    def _ensure_simulation(self) -> None:
        """Starts the simulation process before a job is claimed, so no job fails if the process cannot start."""
        starts = Backoff(0.5, 5.0)
        while not (self._simulation.is_running or self._host.phase.closing.is_set()):
            self._simulation.start()
            report = self._receive_ready()
            if isinstance(report, SimulationReport):
                self._log_renderer(report.renderer)
                return
            pause_s = starts.fail()
            if self._simulation.failed_starts >= _STARTS:
                command = " ".join(self._host.command)
                raise WorldError(
                    f"a simulation did not start after {_STARTS} tries of `{command}`: {report.detail}; run this "
                    "command manually to see the cause, or choose another --renderer"
                )
            self._host.pause(pause_s)

    def _receive_ready(self) -> SimulationReport | ProcessEnd:
        while True:
            report = self._simulation.receive(_POLL_S)
            if self._host.phase.closing.is_set():
                raise _Stopped  # no job will be claimed, so the process is not needed
            if report is not None:
                return report

    def _log_renderer(self, renderer: str) -> None:
        """Logs the renderer once per worker, not per core; warnings of the simulation stay in its stderr."""
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
        """Claims a job; repeats the request with the same token until a reply arrives. `None` if the worker closes."""
        host, backoff = self._host, Backoff(0.1, 5.0)
        claim = Claim(sid=host.sid, token=secrets.token_hex(16), can_build=bool(host.settings.build_command))
        while not host.phase.closing.is_set():
            reply = host.link.ask(Verb.CLAIM, claim, ClaimReply, host.phase.ask_timeout_s)
            if reply is not None:
                return reply
            host.pause(backoff.fail())
        return None

    def _work(self, given: ClaimReply, lease: Lease) -> None:
        started = time.monotonic()
        name = given.build.layout if given.build is not None else given.job.episode_id if given.job is not None else ""
        with self._host.leases.held(lease):
            try:
                if given.build is not None:
                    report = self._build(given.build, lease)
                elif given.job is not None:
                    report = self._attempt(given.job, lease, given)
                else:
                    report = failure(FailReason.RELEASED, "the coordinator sent no job with the lease")
            except LeaseLost:
                self._abort(lease)
                log.info("lease_lost", job=lease.job_id, fence=lease.fence, episode=name)
                return
            except _Stopped:
                self._abort(lease)
                report = failure(FailReason.RELEASED, "the worker stopped")
            if report.kind is SimulationReportKind.SUCCESS:
                report = self._spool_bundle(name, given.job, lease, report)
            if report.kind is SimulationReportKind.FAILURE:
                self._host.spool.clear(lease)
                self._report_failure(name, lease, report, time.monotonic() - started)
        self._pause_after(report)

    def _abort(self, lease: Lease) -> None:
        self._simulation.kill()
        self._builder.kill()
        self._host.spool.clear(lease)

    def _attempt(self, job: Job, lease: Lease, given: ClaimReply) -> SimulationReport:
        host, fetching = self._host, self._fetching(lease)
        try:
            scene = host.scenes.ensure_scene(job.scene_sha256, job.scene_bytes, *fetching)
            light = job.view.light
            lamps = host.scenes.ensure(light.sha256, light.size, *fetching) if light is not None else None
            more = None if given.evaluation is None else given.evaluation.attachment
            attached = host.scenes.ensure(more.sha256, more.size, *fetching) if more is not None else None
        except FactoryError as error:
            if isinstance(error, LeaseLost):
                raise
            return failure(FailReason.RELEASED, f"no scene: {error}")
        bundle = host.spool.path_for(lease)
        order = SimulationOrder(
            job=job,
            scene_path=scene,
            light_path=lamps,
            bundle_path=bundle,
            sid=host.sid,
            eval_task=None if given.evaluation is None else given.evaluation.task,
            attachment_path=attached,
            states=given.states,
        )
        self._simulation.order(order)
        report = self._receive_result(self._simulation, lease)
        if report.reason is FailReason.POLICY:
            self._simulation.kill()  # a policy that hung ends its process, and one that raised may be in any state
        return report

    def _build(self, order: BuildOrder, lease: Lease) -> SimulationReport:
        """Builds a layout in a separate process, which keeps textures for the next build."""
        if not self._builder.is_running:
            self._builder.start()
        self._builder.order(BuildTask(order=order, bundle_path=self._host.spool.path_for(lease)))
        return self._receive_result(self._builder, lease)

    def _receive_result(self, process: Simulation, lease: Lease) -> SimulationReport:
        host, step = self._host, 0
        while True:
            report = process.receive(_POLL_S)
            if isinstance(report, ProcessEnd):
                if report.is_killed and host.phase.stopping.wait(_SIGNALLED_S):
                    raise _Stopped
                return failure(report.reason, report.detail, step)
            if report is not None and report.kind in {SimulationReportKind.SUCCESS, SimulationReportKind.FAILURE}:
                return report
            self._check(lease)
            if report is not None:
                step = report.step
                host.leases.note_progress(lease, step, report.waits)

    def _fetching(self, lease: Lease) -> tuple[Fetch, Wait]:
        """Returns the functions `fetch` and `wait` for the scene cache.

        Both raise an exception if the worker stops or the lease is lost.
        """
        host = self._host

        def wait() -> None:
            self._check(lease)
            time.sleep(_POLL_S)

        def fetch(sha256: str, chunk: Chunk) -> bytes:
            backoff = Backoff(0.1, 2.0)
            while True:
                self._check(lease)
                data = host.link.fetch_scene(sha256, chunk)
                if data is not None:
                    return data
                host.phase.stopping.wait(backoff.fail())

        return fetch, wait

    def _check(self, lease: Lease) -> None:
        if self._host.phase.stopping.is_set():
            raise _Stopped
        if self._host.leases.is_lost(lease):
            raise LeaseLost(f"lease on job {lease.job_id} (fence {lease.fence}) belongs to another worker")

    def _spool_bundle(self, name: str, job: Job | None, lease: Lease, report: SimulationReport) -> SimulationReport:
        """Spools and announces a bundle; returns the report, or a failure if the spool cannot store the bundle."""
        host = self._host
        if report.sha256 is None or report.size is None:
            self._raise_invalid(report)
        try:
            is_validated = job is not None and self._is_validated(job, host.spool.path_for(lease))
            entry = host.spool.add(lease, report.sha256, report.size, is_validated=is_validated)
        except InvalidBundle as error:
            return failure(FailReason.INVALID, str(error), report.step, report.seconds)
        except WorldError as error:
            return failure(FailReason.RELEASED, str(error), report.step, report.seconds)
        if 2 * len(host.spool) >= host.settings.spool_limit:
            # the reply names the bundles to drop; several short episodes may end between two regular heartbeats
            host.phase.heartbeat_due.set()
        log.info("bundle_spooled", episode=name, steps=report.step, seconds=round(report.seconds, 1))
        # the request is not repeated, because each heartbeat lists the bundle until the coordinator requests to drop it
        host.link.ask(Verb.DONE, make_done(entry, host), Ack, host.phase.ask_timeout_s)
        return report

    def _is_validated(self, job: Job, bundle: Path) -> bool:
        """Validates a bundle if the coordinator requests it; returns whether that was possible.

        Raises:
            InvalidBundle: the bundle has violations.
        """
        check = self._host.check_bundle
        if check is None:
            return False
        try:
            check(bundle, job)
        except TransientError as error:
            log.warning(
                "bundle_not_validated",
                episode=job.episode_id,
                why=str(error),
                remedy="none needed: the coordinator validates it",
            )
            return False
        return True

    def _report_failure(self, name: str, lease: Lease, report: SimulationReport, seconds: float) -> None:
        """Reports a failed attempt; repeats this until a reply arrives, the lease is lost, or the worker ends."""
        host, backoff = self._host, Backoff(0.1, 5.0)
        if report.reason is None:
            self._raise_invalid(report)
        fail = Fail(
            sid=host.sid,
            lease=lease,
            reason=report.reason,
            detail=report.detail,
            steps=report.step,
            seconds=report.seconds or seconds,
        )
        log.info("attempt_failed", episode=name, reason=str(report.reason), detail=report.detail)
        while host.phase.left_s > 0 and not host.leases.is_lost(lease):
            if host.link.ask(Verb.FAIL, fail, Ack, host.phase.ask_timeout_s) is not None:
                return
            pause_s = backoff.fail()
            if host.phase.stopping.is_set() and backoff.failures >= _LAST_TRIES:
                return  # the coordinator is unreachable; the lease expires
            if host.phase.stopping.wait(pause_s):
                time.sleep(min(pause_s, host.phase.left_s))

    def _pause_after(self, report: SimulationReport) -> None:
        """Pauses with a backoff after failures that this machine may have caused, so few jobs fail."""
        if report.reason in {FailReason.CRASH, FailReason.HANG, FailReason.RELEASED}:
            if not self._host.phase.stopping.is_set():
                self._failing.fail(report.detail, reason=str(report.reason))
            self._host.pause(self._backoff.fail())
        else:
            self._backoff.succeed()
            self._failing.succeed()

    def _raise_invalid(self, report: SimulationReport) -> NoReturn:
        raise AssertionError(f"invalid report: {report}")
