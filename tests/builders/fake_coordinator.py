"""Minimal coordinator for tests of workers: a zenoh router over a table in memory, with settings that inject failures.

Implements only the wire protocol; it records the messages of workers.
"""

from __future__ import annotations

import hashlib
import json
import queue
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

import zenoh

from schemas.base import Model
from schemas.job import Job
from schemas.protocol.keys import (
    BundleRange,
    Chunk,
    Verb,
    bundle_selector,
    parse_chunk,
    scene_pattern,
    verb_key,
    verb_pattern,
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
    Refusal,
)
from schemas.terms import FailReason
from tests.builders.bundle import job_for
from tests.builders.ledger import room_catalog
from tests.builders.package import package_without_arrays
from tests.builders.ports import free_endpoint

SCENE = package_without_arrays(room_catalog()["room"].info, bytes(range(256)) * 10_000)
"""Package that replaces a compiled scene; it is transferred in three chunks."""
RUN = "test-00000000"
_CHUNK = 1 << 20
_MESSAGES = {Verb.HELLO: Hello, Verb.CLAIM: Claim, Verb.BEAT: Beat, Verb.DONE: Done, Verb.FAIL: Fail}


def jobs_with_instructions(*instructions: str) -> tuple[Job, ...]:
    """Returns jobs whose instructions select the behaviour of the fake simulation."""
    digest = hashlib.sha256(SCENE).hexdigest()
    return tuple(
        job_for(index, instruction=text, scene_sha256=digest, scene_bytes=len(SCENE))
        for index, text in enumerate(instructions, 1)
    )


class FakeCoordinator:
    """Fake coordinator. Context manager; `close` followed by `open` is a restart that keeps the state."""

    def __init__(self, jobs: Sequence[Job], lease_ttl_s: float = 1.0) -> None:
        self.endpoint = free_endpoint()
        self.lease_ttl_s = lease_ttl_s
        self.jobs = dict(enumerate(jobs, 1))
        self.heard: list[Model] = []
        """Every message, in order of arrival."""
        self.archived: dict[int, bytes] = {}
        self.ended: dict[int, Fail] = {}
        """Jobs that failed and are not assigned again, by number."""
        self.dropped_replies: Counter[Verb] = Counter()
        """Number of the next replies to drop, by verb."""
        self.pulls = True
        self.drains = False
        self.refuses = ""
        self.tells_end_by_beat = False
        self.changed = threading.Condition(threading.RLock())
        self._leases: dict[int, Lease] = {}
        self._fences: Counter[int] = Counter()
        self._due: queue.Queue[Done | None] = queue.Queue()
        self._session: zenoh.Session | None = None
        self._puller: threading.Thread | None = None

    def open(self) -> None:
        values = {
            "mode": '"router"',
            "listen/endpoints": json.dumps([self.endpoint]),
            "scouting/multicast/enabled": "false",
            "scouting/gossip/enabled": "false",
            "transport/shared_memory/enabled": "false",
            "transport/link/rx/max_message_size": str(4 << 20),
        }
        config = zenoh.Config()
        for key, value in values.items():
            config.insert_json5(key, value)
        self._session = zenoh.open(config)
        self._session.declare_queryable(verb_pattern(RUN), self._take)
        self._session.declare_queryable(scene_pattern(RUN), self._serve_scene)
        self._puller = threading.Thread(target=self._pull_all)
        self._puller.start()

    def close(self) -> None:
        if self._session is not None:
            self._session.close()
            self._session = None
        if self._puller is not None:
            self._due.put(None)
            self._puller.join()
            self._puller = None

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def wait_until(self, holds: Callable[[], bool], what: str) -> None:
        """Waits for a condition; after two minutes, fails with the message `what`."""
        with self.changed:
            assert self.changed.wait_for(holds, 120), f"timed out waiting for {what}; last messages: {self.heard[-5:]}"

    def of(self, kind: type[Model]) -> list[Model]:
        """Returns the messages of one kind."""
        with self.changed:
            return [message for message in self.heard if isinstance(message, kind)]

    def lease_of(self, number: int) -> Lease | None:
        with self.changed:
            return self._leases.get(number)

    def take_away(self, number: int) -> None:
        """Ends the lease of a job as if it had expired and does not assign the job again."""
        with self.changed:
            lease = self._leases.pop(number)
            self.ended[number] = Fail(sid="nobody", lease=lease, reason=FailReason.CRASH)

    def _take(self, query: zenoh.Query) -> None:
        *_, host, name = str(query.key_expr).split("/")
        verb = Verb(name)
        with self.changed, query:
            message = _MESSAGES[verb].model_validate_json(query.payload.to_bytes())
            self.heard.append(message)
            reply = self._reply_to(message)
            self.changed.notify_all()
            if self.dropped_replies[verb] > 0:
                self.dropped_replies[verb] -= 1
            else:
                query.reply(verb_key(RUN, host, verb), reply.model_dump_json())

    def _reply_to(self, message: Model) -> Model:
        match message:
            case Hello():
                return (
                    Refusal(error=self.refuses)
                    if self.refuses
                    else HelloReply(run=RUN, version="0", lease_ttl_s=self.lease_ttl_s)
                )
            case Claim():
                return self._claim(message)
            case Beat():
                lost = tuple(item.lease for item in message.live if not self._holds(item.lease))
                drop = tuple(lease for lease in message.spool if not self._holds(lease))
                finished = self.tells_end_by_beat and not self._open_jobs()
                return BeatReply(lost=lost, drop=drop, drain=self.drains, finished=finished)
            case Done():
                if self._holds(message.lease):
                    self._due.put(message)
                return Ack(accepted=self._holds(message.lease))
            case Fail():
                return Ack(accepted=self._fail(message))
        raise AssertionError(message)

    def _holds(self, lease: Lease) -> bool:
        return self._leases.get(lease.job_id) == lease

    def _claim(self, claim: Claim) -> ClaimReply:
        held = next((lease for lease in self._leases.values() if lease.token == claim.token), None)
        if held is not None:
            return ClaimReply(job=self.jobs[held.job_id], lease=held)
        open_jobs = self._open_jobs()
        for number in sorted(open_jobs - self._leases.keys()):
            self._fences[number] += 1
            lease = self._leases[number] = Lease(job_id=number, fence=self._fences[number], token=claim.token)
            return ClaimReply(job=self.jobs[number], lease=lease)
        return ClaimReply(retry_after_s=0.1, finished=not open_jobs)

    def _open_jobs(self) -> set[int]:
        return self.jobs.keys() - self.archived.keys() - self.ended.keys()

    def _fail(self, fail: Fail) -> bool:
        if not self._holds(fail.lease):
            return False
        del self._leases[fail.lease.job_id]
        if fail.reason is not FailReason.RELEASED:
            self.ended[fail.lease.job_id] = fail
        return True

    def _serve_scene(self, query: zenoh.Query) -> None:
        with query:
            chunk = parse_chunk({name: query.parameters.get(name, "") for name in ("off", "n")})
            query.reply(str(query.key_expr), SCENE[chunk.offset : chunk.offset + chunk.length])

    def _pull_all(self) -> None:
        while (done := self._due.get()) is not None:
            data = self._pull(done) if self.pulls else None
            if data is not None:
                with self.changed:
                    if self._holds(done.lease):
                        self.archived[done.lease.job_id] = data
                        del self._leases[done.lease.job_id]
                    self.changed.notify_all()

    def _pull(self, done: Done) -> bytes | None:
        parts: list[bytes] = []
        session = self._session
        for offset in range(0, done.size, _CHUNK):
            chunk = Chunk(offset, min(_CHUNK, done.size - offset))
            try:
                asked = BundleRange(done.lease.job_id, done.lease.fence, chunk)
                selector = bundle_selector(RUN, done.sid, [asked])
                replies = list(session.get(selector, zenoh.handlers.FifoChannel(4), timeout=2)) if session else []
            except zenoh.ZError:
                return None
            if not replies or replies[0].ok is None:
                return None
            parts.append(replies[0].ok.payload.to_bytes())
        data = b"".join(parts)
        return data if hashlib.sha256(data).hexdigest() == done.sha256 else None
