"""Heartbeat of a worker: reports leases, spool and free memory, and applies the coordinator's reply.

Also detects an unreachable coordinator and opens the link again. Does not claim jobs and does not simulate.
"""

from __future__ import annotations

import time
from pathlib import Path

import structlog

from schemas.protocol.keys import Verb
from schemas.protocol.messages import (
    MAX_LEASES,
    Ack,
    Beat,
    BeatReply,
    Done,
    Hello,
    HelloReply,
    HostMemory,
    LeaseProgress,
    RunKind,
    SpooledBundle,
)
from schemas.support.product import product_version
from workers.client.host import Host

_KIB = 1024


def read_memory(path: Path = Path("/proc/meminfo")) -> HostMemory | None:
    """Returns the memory of the host; `None` if the system does not report it.

    Args:
        path: file in the format of Linux' `/proc/meminfo`.
    """
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        sizes = {name: int(rest.split()[0]) * _KIB for name, _, rest in (line.partition(":") for line in lines)}
        total = sizes["MemTotal"]
        return HostMemory(used_bytes=max(0, total - sizes["MemAvailable"]), total_bytes=total)
    except (OSError, ValueError, KeyError, IndexError):
        return None


_HURRIED_S = 0.25
_REOPEN_S = 10.0
_EVALUATION_CHECK_S = 10.0
"""Time between two checks for an evaluation, which has priority over collection, seconds."""

log = structlog.get_logger(__name__)


def make_hello(sid: str, host: str, slots: int) -> Hello:
    return Hello(sid=sid, host=host, slots=slots, version=product_version())


def make_done(entry: SpooledBundle, host: Host) -> Done:
    """Returns the announcement of a bundle in the spool."""
    return Done(sid=host.sid, via=host.link.via, **dict(entry))


class Heartbeat:
    """Loop that sends heartbeats until the worker ends."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._hello = make_hello(host.sid, host.name, host.settings.cores)
        self.is_answered = True
        """Whether the coordinator answered the last heartbeat."""
        self._checked_at = time.monotonic()

    def run(self) -> None:
        """Sends four heartbeats in each lease time, and more while the spool fills up or the worker leaves.

        An exception ends the worker.
        """
        host = self._host
        try:
            while host.phase.left_s > 0:
                host.phase.heartbeat_due.clear()
                self.beat()
                if host.phase.closing.is_set():
                    time.sleep(min(_HURRIED_S, host.phase.left_s))
                else:
                    host.wait_for_beat()
        except Exception as error:  # noqa: BLE001 - the worker loop: passed to the supervisor, which raises it
            host.phase.fail(error)

    def beat(self) -> None:
        """Reports the leases in simulation and in the spool, and applies the reply."""
        host = self._host
        live = host.leases.live()  # read before the spool, so an attempt that ends now is in one of the two
        spooled = host.spool.entries()
        for start in range(0, max(len(live), len(spooled), 1), MAX_LEASES):
            part = slice(start, start + MAX_LEASES)
            if not self._beat_part(live[part], spooled[part]):
                self._handle_silence()
                return
        self._check_for_evaluation()

    def _beat_part(self, live: tuple[LeaseProgress, ...], spooled: tuple[SpooledBundle, ...]) -> bool:
        """Sends one heartbeat with part of the leases; returns whether the coordinator answered."""
        host = self._host
        spool = tuple(entry.lease for entry in spooled)
        beat = Beat(sid=host.sid, live=live, spool=spool, via=host.link.via, memory=read_memory())
        reply = host.link.ask(Verb.BEAT, beat, BeatReply, host.phase.ask_timeout_s)
        if reply is None:
            return False
        self._handle_reply()
        host.leases.lose(reply.lost)
        for lease in reply.drop:
            if host.spool.drop(lease):
                log.debug("bundle_dropped", job=lease.job_id, fence=lease.fence)
        if reply.drain and not host.phase.closing.is_set():
            log.info("draining", by="coordinator")
            host.phase.close()
        if reply.finished:
            host.phase.finish()
        settled = {*reply.drop, *reply.waiting}
        for entry in spooled:
            if entry.lease not in settled:
                self._announce(entry)
        return True

    def _announce(self, entry: SpooledBundle) -> None:
        """Repeats the announcement of a bundle, because the coordinator or this worker may have been restarted."""
        host = self._host
        host.link.ask(Verb.DONE, make_done(entry, host), Ack, host.phase.ask_timeout_s)

    def _handle_silence(self) -> None:
        host = self._host
        if self.is_answered:
            self.is_answered = False
            log.warning("coordinator_unreachable", endpoints=host.link.endpoints)
        if host.link.silence_s > _REOPEN_S and not host.phase.stopping.is_set():
            # replaces a half-open connection; tries all endpoints, because this router may accept no connections
            host.link.open()
            if host.link.is_run_finished:
                host.phase.finish()
                return
            self._check_for_other_run()

    def _check_for_other_run(self) -> None:
        host = self._host
        runs = {reply.run for reply in host.link.send_hello(self._hello) if isinstance(reply, HelloReply)}
        if runs and host.run not in runs and host.settings.run is None:
            log.warning("run_changed", was=host.run, found=sorted(runs))
            host.phase.moved.set()
            host.phase.stop(0.0)

    def _check_for_evaluation(self) -> None:
        """Ends the work for a collecting run after the current attempts, if an evaluation needs workers."""
        host = self._host
        is_free = host.run_kind is RunKind.COLLECTION and host.settings.run is None and not host.phase.closing.is_set()
        if not is_free or time.monotonic() - self._checked_at < _EVALUATION_CHECK_S:
            return
        self._checked_at = time.monotonic()
        if any(
            isinstance(reply, HelloReply) and reply.run_kind is RunKind.EVALUATION
            for reply in host.link.send_hello(self._hello)
        ):
            log.info("evaluation_found", was=host.run)
            host.phase.moved.set()
            host.phase.close()

    def _handle_reply(self) -> None:
        if not self.is_answered:
            self.is_answered = True
            log.info("coordinator_reconnected")
            self._host.link.ask(Verb.HELLO, self._hello, HelloReply, self._host.phase.ask_timeout_s)
