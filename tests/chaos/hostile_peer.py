"""Hostile peer among honest workers: sends invalid requests at a bounded rate and counts the refusals.

It omits operator requests and gateway requests, which plain TCP permits by design and TLS denies to workers. It also
omits false reports of collisions, which the coordinator cannot detect.
"""

from __future__ import annotations

import hashlib
import random
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Self

import zenoh

from schemas.base import Model
from schemas.bundle import MAX_BUNDLE_BYTES
from schemas.job import Job
from schemas.protocol.keys import Verb
from schemas.protocol.messages import (
    MAX_MESSAGE_BYTES,
    Ack,
    Beat,
    BeatReply,
    Claim,
    ClaimReply,
    Done,
    Fail,
    Hello,
    HelloReply,
    Lease,
    LeaseProgress,
    Refusal,
)
from schemas.terms import FailReason
from tests.builders.bundle import parts_for
from tests.builders.wire_worker import WireWorker
from tests.chaos.cluster import ChaosCluster
from tests.chaos.fault_span import FaultSpan
from tests.chaos.light_simulation import misses

HOSTILE_HOST = "hostile"
_BEAT_S = 0.5
_HELD_S = 4.0
"""Time for which a job is held without progress, seconds."""
_SLOW_S, _SLOW_BYTES = 0.3, 512
"""Delay before a session answers a request for a chunk of a slow bundle, seconds, and the size of the answer, bytes."""
_PAUSES = "no job for a hostile peer that is paused or barred"
_RETRY_S = 0.5
"""Threshold of the retry delay in a claim reply, seconds. A longer delay means that the host is paused or barred."""

Key = tuple[int, int]
"""ID of a job and fence of its lease."""


class _Session(WireWorker):
    """A session that serves the bundles of `slow` slowly."""

    slow: frozenset[Key] = frozenset()

    def _serve(self, query: zenoh.Query) -> None:
        key = int(query.parameters.get("job") or 0), int(query.parameters.get("fence") or 0)
        if key not in self.slow:
            super()._serve(query)
            return
        time.sleep(_SLOW_S)
        with query:
            query.reply(query.key_expr, bytes(_SLOW_BYTES))


class HostilePeer:
    """Thread that attacks a run until `stop` is called. Context manager.

    Args:
        cluster: cluster of the attacked run.
        rng: generator that chooses the attacks.
        pause_s: shortest and longest pause between two attacks, seconds.
    """

    def __init__(self, cluster: ChaosCluster, rng: random.Random, pause_s: tuple[float, float]) -> None:
        self._cluster, self._rng, self._pause_s = cluster, rng, pause_s
        self._run = cluster.commands.plan.run
        self.acts: list[tuple[str, FaultSpan]] = []
        """Kind and effect of each attack."""
        self.violations: list[str] = []
        self._open: list[tuple[str, Key, FaultSpan]] = []
        """Attacks whose effect is read from the ledger later."""
        self._held: dict[Lease, float] = {}
        """Lease -> time until which heartbeats renew it."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="hostile-peer")

    def stop(self) -> None:
        """Ends the attacks."""
        self._stop.set()
        self._thread.join()

    def settle(self) -> None:
        """Reads the effects of the attacks from the ledger of an ended run."""
        rows = self._cluster.query(f"select job_id, fence, outcome from attempts where sid like '{HOSTILE_HOST}.%'")
        outcomes = {(job, fence): outcome for job, fence, outcome in rows}
        for kind, key, span in self._open:
            outcome = outcomes.get(key)
            span.effects += outcome == ("invalid" if kind in _BUNDLES else "expired")
            if outcome == "success":
                self.violations.append(f"{kind}: it was archived as an episode, job {key[0]}")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _work(self) -> None:
        while not self._stop.wait(0.1):
            try:
                session = _Session(self._cluster.endpoints, self._run, HOSTILE_HOST)
            except zenoh.ZError:  # no router listens
                continue
            with session:
                self._act_in(session)

    def _act_in(self, session: _Session) -> None:
        next_beat = next_act = 0.0
        while not self._stop.wait(0.02):
            now = time.monotonic()
            if now > next_beat:
                self._beat(session, now)
                next_beat = now + _BEAT_S
            if now > next_act:
                self._act(session)
                next_act = time.monotonic() + self._rng.uniform(*self._pause_s)

    def _act(self, session: _Session) -> None:
        kind = self._rng.choice(HOSTILE_KINDS[:-1])
        if kind in _MESSAGES:
            self.acts.append((kind, FaultSpan(_MESSAGES[kind](self, session))))
            return
        reply = session.ask(Verb.CLAIM, Claim(sid=session.sid, token=secrets.token_hex(16)), ClaimReply)
        if not isinstance(reply, ClaimReply):
            return
        if reply.job is None or reply.lease is None:
            if reply.retry_after_s > _RETRY_S:
                self.acts.append((_PAUSES, FaultSpan(1)))
        elif self._rng.random() < 0.5:
            _work_honestly(session, reply.job, reply.lease)  # a success halves the strikes of the host
        else:
            self._spoil(session, kind, reply.job, reply.lease)

    def _spoil(self, session: _Session, kind: str, job: Job, lease: Lease) -> None:
        key, span = (lease.job_id, lease.fence), FaultSpan()
        self.acts.append((kind, span))
        self._open.append((kind, key, span))
        if kind == _SLOW:
            session.slow |= {key}
        if kind in _HELD:
            self._held[lease] = time.monotonic() + _HELD_S
        if kind in _BUNDLES:
            data, sha256, size = _BUNDLES[kind](job, self._rng)
            done = Done(sid=session.sid, lease=lease, sha256=sha256, size=size, via=session.via)
            session.spool[key] = done, data
            session.ask(Verb.DONE, done, Ack)
        elif kind == _UNSERVED:
            session.ask(Verb.DONE, Done(sid=session.sid, lease=lease, sha256="0" * 64, size=1 << 16), Ack)
        elif kind == _TOO_LARGE:
            session.ask(Verb.DONE, Done(sid=session.sid, lease=lease, sha256="0" * 64, size=MAX_BUNDLE_BYTES), Ack)

    def _beat(self, session: _Session, now: float) -> None:
        self._held = {lease: until for lease, until in self._held.items() if until > now}
        live = tuple(LeaseProgress(lease=lease, step=1) for lease in self._held)
        spool = tuple(done.lease for done, _ in session.spool.values())
        beat = Beat(sid=session.sid, live=live, spool=spool[:100], via=session.via)
        reply = session.ask(Verb.BEAT, beat, BeatReply)
        if isinstance(reply, BeatReply):
            for lease in reply.drop:
                session.spool.pop((lease.job_id, lease.fence), None)

    def _garble(self, session: _Session) -> bool:
        texts = (b"", b"{", b"\xff" * 100, b'{"sid": 1}', b"[" * 10_000, b'{"sid": "\\u0000", "token": 1e999}')
        verb = self._rng.choice((Verb.HELLO, Verb.CLAIM, Verb.BEAT, Verb.DONE, Verb.FAIL))
        return isinstance(session.ask(verb, self._rng.choice(texts), Ack), Refusal)

    def _inflate(self, session: _Session) -> bool:
        size = self._rng.choice((200_000, MAX_MESSAGE_BYTES + 1, 3 * MAX_MESSAGE_BYTES))
        return isinstance(session.ask(Verb.CLAIM, b'{"sid": "' + b"x" * size + b'"}', Ack), Refusal)

    def _pretend(self, session: _Session) -> bool:
        """Sends a request in the name of an honest host."""
        number = self._rng.randrange(3)
        messages: tuple[tuple[Verb, Model], ...] = (
            (Verb.CLAIM, Claim(sid=f"host-{number}.1", token="0" * 32)),
            (Verb.BEAT, Beat(sid=f"host-{number}.1")),
            (Verb.HELLO, Hello(sid=session.sid, host=f"host-{number}", slots=1, version="1")),
        )
        verb, message = self._rng.choice(messages)
        return isinstance(session.ask(verb, message, Ack), Refusal)

    def _differ(self, session: _Session) -> bool:
        """Sends a hello with a version other than the coordinator's."""
        hello = Hello(sid=session.sid, host=HOSTILE_HOST, slots=4096, version="0.0.1")
        return isinstance(session.ask(Verb.HELLO, hello, HelloReply), Refusal)

    def _steal(self, session: _Session) -> bool:
        """Sends a request with a lease token of an honest host, read from the ledger."""
        held = self._cluster.query("select id, fence, token from jobs where sid like 'host-%' and token is not null")
        if not held:
            return False
        lease = Lease(**dict(zip(("job_id", "fence", "token"), self._rng.choice(held), strict=True)))
        reason = self._rng.choice((FailReason.RELEASED, FailReason.CRASH, FailReason.COLLISION))
        if self._rng.random() < 0.3:
            beat = Beat(sid=session.sid, live=(LeaseProgress(lease=lease, step=1),))
            reply: Model | None = session.ask(Verb.BEAT, beat, BeatReply)
            return isinstance(reply, BeatReply) and self._must(
                lease in reply.lost, "a heartbeat with a token of another host is accepted"
            )
        if self._rng.random() < 0.5:
            reply = session.ask(Verb.FAIL, Fail(sid=session.sid, lease=lease, reason=reason), Ack)
        else:
            reply = session.ask(Verb.DONE, Done(sid=session.sid, lease=lease, sha256="0" * 64, size=7), Ack)
        return isinstance(reply, Ack) and self._must(not reply.accepted, "a token of another host is accepted")

    def _must(self, is_so: bool, violation: str) -> bool:
        if not is_so:
            self.violations.append(violation)
        return is_so


def _work_honestly(session: _Session, job: Job, lease: Lease) -> None:
    if misses(job.index, job.attempt):
        session.fail(lease, FailReason.COLLISION)
    else:
        session.deliver(lease, parts_for(job).write())


def _announced(data: bytes) -> tuple[bytes, str, int]:
    return data, hashlib.sha256(data).hexdigest(), len(data)


def _mistitled(job: Job) -> tuple[bytes, str, int]:
    data = parts_for(job).write()
    return data, hashlib.sha256(data + b" ").hexdigest(), len(data)


def _forge(job: Job, rng: random.Random) -> tuple[bytes, str, int]:
    """Returns a well-formed bundle that validation refuses."""
    parts = parts_for(job)
    poses = parts.arrays.poses.copy()
    poses[-1, 0] += 1.0
    forged = (
        parts.with_job(index=job.index + 1),
        parts.with_job(root_seed=job.root_seed + 1),
        parts.with_rollout(num_steps=len(poses) - 1),
        parts.with_arrays(poses=poses),
    )
    return _announced(rng.choice(forged).write())


_SLOW = "bundle served slowly by a hostile peer"
_UNSERVED = "bundle that a hostile peer does not serve"
_TOO_LARGE = "announcement beyond the free space by a hostile peer"
_IDLE = "job held without work by a hostile peer"
_HELD = (_UNSERVED, _TOO_LARGE, _IDLE)
_FORGOTTEN = "job claimed and forgotten by a hostile peer"
_MESSAGES: Mapping[str, Callable[[HostilePeer, _Session], bool]] = {
    "malformed message of a hostile peer": HostilePeer._garble,
    "oversized message of a hostile peer": HostilePeer._inflate,
    "message in the name of another host": HostilePeer._pretend,
    "hello of a different version": HostilePeer._differ,
    "token of another host": HostilePeer._steal,
}
"""Kind -> function that attacks and returns whether the coordinator refused the request."""
_BUNDLES: Mapping[str, Callable[[Job, random.Random], tuple[bytes, str, int]]] = {
    "bundle of 7 bytes from a hostile peer": lambda _job, _rng: _announced(b"7 bytes"),
    "huge size announced by a hostile peer": lambda _job, _rng: (b"7 bytes", "0" * 64, MAX_BUNDLE_BYTES + 1),
    "wrong SHA-256 announced by a hostile peer": lambda job, _rng: _mistitled(job),
    "forged bundle of a hostile peer": _forge,
    _SLOW: lambda _job, _rng: _announced(bytes(1 << 20)),
}
"""Kind -> function that returns bundle, announced SHA-256 and announced size. The attack has an effect if the
coordinator refuses the bundle."""
HOSTILE_KINDS = (*_MESSAGES, *_BUNDLES, *_HELD, _FORGOTTEN, _PAUSES)
"""All kinds that are counted. The last kind is not an attack: it counts claims refused because the host pauses or is
barred."""
