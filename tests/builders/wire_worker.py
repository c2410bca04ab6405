"""A worker for tests of the protocol: claims jobs, spools given bundles and serves chunks. Simulates nothing."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import zenoh

from coordinator.protocol.zenoh_config import client_config
from schemas.base import Model
from schemas.job import Job
from schemas.protocol.identity import TlsFiles
from schemas.protocol.keys import (
    RANGE_FIELDS,
    Chunk,
    Verb,
    alive_key,
    bundle_key,
    parse_bundle_ranges,
    scene_selector,
    verb_key,
)
from schemas.protocol.messages import (
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
from schemas.support.closing import Closing
from schemas.terms import FailReason
from tests.builders.bundle import parts_for

M = TypeVar("M", bound=Model)


def bundle_for(job: Job) -> bytes:
    """Returns the smallest valid bundle of a job."""
    return parts_for(job).write()


def until(condition: Callable[[], bool], within_s: float = 120.0) -> None:
    """Waits until another thread has made a condition true; the time limit only guards against a hang."""
    end = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end, "timed out waiting"
        time.sleep(0.02)


class WireWorker(Closing):
    """A client session with a spool in memory. Context manager."""

    def __init__(
        self, endpoints: Sequence[str], run: str, host: str = "host", tls: TlsFiles | None = None, sid: str = ""
    ) -> None:
        self.run, self.host = run, host
        self.sid = sid or f"{host}.{secrets.token_hex(3)}"
        self.spool: dict[tuple[int, int], tuple[Done, bytes]] = {}
        self.served: list[int] = []
        """Offsets of the requested chunks."""
        self.served_together: list[int] = []
        """Number of ranges in each request for chunks."""
        self.is_frozen = False
        self.knows_router = True
        self._session = zenoh.open(client_config(endpoints, 2.0, tls))
        self._session.declare_queryable(bundle_key(run, self.sid), self._serve)
        self._token = self._session.liveliness().declare_token(alive_key(run, self.sid))

    @property
    def via(self) -> str | None:
        """ID of the connected router."""
        routers = self._session.info.routers_zid() if self.knows_router else []
        return str(routers[0]) if routers else None

    def ask(self, verb: Verb | str, message: Model | bytes, answer: type[M]) -> M | Refusal | None:
        """Sends a request; returns the reply, or `None` if no valid reply came, so the outcome is unknown."""
        payload = message if isinstance(message, bytes) else message.model_dump_json()
        key = verb_key(self.run, self.host, verb)  # type: ignore[arg-type]
        replies = self._session.get(
            key,
            zenoh.handlers.FifoChannel(4),
            payload=payload,
            timeout=5.0,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        for reply in replies:
            if reply.ok is not None:
                data = reply.ok.payload.to_bytes()
                kind: type[M] | type[Refusal] = Refusal if data.startswith(b'{"error"') else answer
                return kind.model_validate_json(data)
        return None

    def hello(self, version: str) -> HelloReply | Refusal | None:
        return self.ask(Verb.HELLO, Hello(sid=self.sid, host=self.host, slots=2, version=version), HelloReply)

    def claim(self, token: str | None = None, *, can_build: bool = False) -> ClaimReply:
        claim = Claim(sid=self.sid, token=token or secrets.token_hex(16), can_build=can_build)
        reply = self.ask(Verb.CLAIM, claim, ClaimReply)
        assert isinstance(reply, ClaimReply)
        return reply

    def job(self) -> tuple[Job, Lease]:
        """Repeats claims until it gets a job; returns the job and its lease."""
        replies: list[ClaimReply] = []

        def has_one() -> bool:
            replies.append(self.claim())
            return replies[-1].job is not None

        until(has_one)
        job, lease = replies[-1].job, replies[-1].lease
        assert job is not None
        assert lease is not None
        return job, lease

    def deliver(self, lease: Lease, bundle: bytes, sha256: str | None = None, *, is_validated: bool = False) -> bool:
        """Spools a bundle and announces it; returns whether the coordinator accepts the announcement."""
        digest = sha256 or hashlib.sha256(bundle).hexdigest()
        size, via = len(bundle), self.via
        done = Done(sid=self.sid, lease=lease, sha256=digest, size=size, via=via, is_validated=is_validated)
        self.spool[lease.job_id, lease.fence] = done, bundle
        reply = self.ask(Verb.DONE, done, Ack)
        return isinstance(reply, Ack) and reply.accepted

    def fetch_scene(self, sha256: str, chunk: Chunk) -> bytes:
        """Returns a part of a file that the coordinator serves."""
        selector = scene_selector(self.run, sha256, chunk)
        replies = self._session.get(selector, zenoh.handlers.FifoChannel(4), timeout=5.0)
        return next(reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None)

    def fail(self, lease: Lease, reason: FailReason) -> bool:
        reply = self.ask(Verb.FAIL, Fail(sid=self.sid, lease=lease, reason=reason, detail="as asked"), Ack)
        return isinstance(reply, Ack) and reply.accepted

    def beat(self, live: Sequence[Lease] = ()) -> BeatReply:
        """Sends one heartbeat and removes the bundles named in the reply from the spool."""
        beat = Beat(
            sid=self.sid,
            live=tuple(LeaseProgress(lease=lease, step=5) for lease in live),
            spool=tuple(done.lease for done, _ in self.spool.values()),
            via=self.via,
        )
        reply = self.ask(Verb.BEAT, beat, BeatReply)
        assert isinstance(reply, BeatReply)
        for lease in reply.drop:
            self.spool.pop((lease.job_id, lease.fence), None)
        return reply

    def fetch(self, selector: str) -> bytes | None:
        for reply in self._session.get(selector, zenoh.handlers.FifoChannel(4), timeout=5.0):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None

    def close(self) -> None:
        self._session.close()

    def _serve(self, query: zenoh.Query) -> None:
        with query:
            asked = parse_bundle_ranges({name: query.parameters.get(name) or "" for name in RANGE_FIELDS})
            if self.is_frozen or any((job_id, fence) not in self.spool for job_id, fence, _ in asked):
                return
            self.served += [chunk.offset for *_, chunk in asked]
            self.served_together.append(len(asked))
            parts = [self.spool[job_id, fence][1][chunk.offset :][: chunk.length] for job_id, fence, chunk in asked]
            query.reply(bundle_key(self.run, self.sid), b"".join(parts))
