"""The heartbeat: one beat for all slots and the spool, and what the coordinator holds against it.

Also the one place that notices silence and opens the link again; it never claims and never simulates.
"""

from __future__ import annotations

import time
from importlib.metadata import version

import structlog

from schemas.keys import Verb
from schemas.wire import MAX_LEASES, Ack, Beat, BeatReply, Done, Hello, HelloReply, LeaseProgress, Trade
from workers.client.host import Host
from workers.client.spool import Spooled

__all__ = ["Heartbeat", "make_hello"]

_BEATS_PER_LEASE = 4
_HURRIED_S = 0.25
_REOPEN_S = 10.0
_LOOK_S = 10.0
"""Pause between two looks for an evaluation, which goes before collection."""

log = structlog.get_logger(__name__)


def make_hello(sid: str, host: str, slots: int) -> Hello:
    """Returns a worker's introduction."""
    return Hello(sid=sid, host=host, slots=slots, version=version("minivla-factory"))


class Heartbeat:
    """Beats until told to end."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._hello = make_hello(host.sid, host.name, host.settings.cores)
        self.is_answered = True
        """Whether the last beat was."""
        self._looked = time.monotonic()

    def run(self) -> None:
        """Beats four times a lease, oftener while the worker waits to leave; whatever breaks it ends the worker."""
        host = self._host
        try:
            while host.phase.left_s > 0:
                self.beat()
                if host.phase.closing.is_set():
                    time.sleep(min(_HURRIED_S, host.phase.left_s))
                else:
                    host.pause(host.lease_ttl_s / _BEATS_PER_LEASE)
        except Exception as error:  # noqa: BLE001 - the worker loop: told to the supervisor, which raises it
            host.phase.fail(error)

    def beat(self) -> None:
        """Tells what is in work and in the spool, and does what the answer says."""
        host = self._host
        live = host.leases.live()  # before the spool: an attempt that ends meanwhile is in both, never in neither
        spooled = host.spool.entries()
        for start in range(0, max(len(live), len(spooled), 1), MAX_LEASES):
            part = slice(start, start + MAX_LEASES)
            if not self._beat_part(live[part], spooled[part]):
                self._note_silence()
                return
        self._look_for_evaluation()

    def _beat_part(self, live: tuple[LeaseProgress, ...], spooled: tuple[Spooled, ...]) -> bool:
        """Sends as many leases as one beat may have; returns whether it was answered."""
        host = self._host
        beat = Beat(sid=host.sid, live=live, spool=tuple(entry.lease for entry in spooled), via=host.link.via)
        reply = host.link.ask(Verb.BEAT, beat, BeatReply, host.phase.ask_timeout_s)
        if reply is None:
            return False
        self._note_answer()
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

    def _announce(self, entry: Spooled) -> None:
        """Repeats what the slot has announced already: the coordinator, or this worker, may have been restarted."""
        host = self._host
        done = Done(sid=host.sid, lease=entry.lease, sha256=entry.sha256, size=entry.size, via=host.link.via)
        host.link.ask(Verb.DONE, done, Ack, host.phase.ask_timeout_s)

    def _note_silence(self) -> None:
        host = self._host
        if self.is_answered:
            self.is_answered = False
            log.warning("coordinator_away", endpoints=host.link.endpoints)
        if host.link.silence_s > _REOPEN_S and not host.phase.stopping.is_set():
            host.link.open()  # a half-open link, or a router that lets nobody in, heals with a new session
            self._look_for_another_run()

    def _look_for_another_run(self) -> None:
        host = self._host
        runs = {reply.run for reply in host.link.greet(self._hello) if isinstance(reply, HelloReply)}
        if runs and host.run not in runs and host.settings.run is None:
            log.warning("run_changed", was=host.run, found=sorted(runs))
            host.phase.moved.set()
            host.phase.stop(0.0)

    def _look_for_evaluation(self) -> None:
        """Finishes what is under way and moves on when an evaluation asks for workers."""
        host = self._host
        is_free = host.trade is Trade.COLLECTION and host.settings.run is None and not host.phase.closing.is_set()
        if not is_free or time.monotonic() - self._looked < _LOOK_S:
            return
        self._looked = time.monotonic()
        if any(
            isinstance(reply, HelloReply) and reply.trade is Trade.EVALUATION for reply in host.link.greet(self._hello)
        ):
            log.info("evaluation_first", was=host.run)
            host.phase.moved.set()
            host.phase.close()

    def _note_answer(self) -> None:
        if not self.is_answered:
            self.is_answered = True
            log.info("coordinator_back")
            self._host.link.ask(Verb.HELLO, self._hello, HelloReply, self._host.phase.ask_timeout_s)
