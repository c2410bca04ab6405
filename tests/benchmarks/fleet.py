"""Simulated workers, many in one process: they claim jobs, announce bundles and serve chunks of one common bundle.

Each public function is the main function of a process: it opens its sessions, reports that it is ready, runs its load
and sends the measurements. Simulates no episodes.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from multiprocessing.connection import Connection

import zenoh

from coordinator.protocol.ask import query
from coordinator.protocol.zenoh_config import client_config
from schemas.base import Model
from schemas.errors import TransientError
from schemas.protocol.keys import RANGE_FIELDS, Verb, alive_key, bundle_key, parse_bundle_ranges, verb_key
from schemas.protocol.messages import Beat, BeatReply, Claim, Done, Hello, Lease
from schemas.support.product import product_version

_LINK_LEASE_S = 60.0
_ASK_S = 30.0
_BEAT_S = 0.5
_PARALLEL = 64
"""Largest number of workers of one process that send requests at the same time."""
_ARRIVING, _TRIES = 8, 10
"""`_ARRIVING`: number of sessions that are opened at the same time. `_TRIES`: number of attempts to open a session,
because a connection may time out after 2 s under load."""


class WorkCost(Model):
    """Wall and CPU time of a load."""

    seconds: float
    """Wall time, seconds."""
    cpu_s: float
    """CPU time of all threads of the process, seconds."""


def bundle_of(size: int) -> bytes:
    """Returns the bundle that every worker delivers: incompressible bytes, equal in every process."""
    block = b"".join(sha256(number.to_bytes(4, "big")).digest() for number in range(1 << 10))
    return (block * (size // len(block) + 1))[:size]


class BenchWorker:
    """Simulated worker with one zenoh session; `close` ends it.

    Args:
        endpoints: Endpoints of the coordinator.
        run: Name of the run.
        bundle: Bytes served for every lease; empty to serve nothing.
    """

    def __init__(self, endpoints: Sequence[str], run: str, bundle: bytes = b"") -> None:
        self._host = f"bench-{secrets.token_hex(4)}"
        self.sid = f"{self._host}.1"
        self._run, self._bundle = run, bundle
        self._session = _connect(endpoints)
        self._session.declare_queryable(bundle_key(run, self.sid), self._serve)
        self._token = self._session.liveliness().declare_token(alive_key(run, self.sid))

    def ask(self, verb: Verb, message: Model) -> bytes:
        """Sends a request and returns the reply, unparsed.

        Raises:
            TransientError: The coordinator did not reply in time.
        """
        for reply in query(self._session, verb_key(self._run, self._host, verb), message.model_dump_json(), _ASK_S):
            return reply
        raise TransientError(f"the coordinator did not answer {verb} within {_ASK_S:.0f} s")

    def introduce(self) -> None:
        """Sends the `hello` request."""
        self.ask(Verb.HELLO, Hello(sid=self.sid, host=self._host, slots=1, version=product_version()))

    def ask_for_work(self) -> bytes:
        """Sends a claim and returns the reply, unparsed, with or without a job."""
        return self.ask(Verb.CLAIM, Claim(sid=self.sid, token=secrets.token_hex(16)))

    def claim(self) -> Lease:
        """Returns the lease of a job.

        Raises:
            TransientError: The coordinator did not reply, or no job is available.
        """
        reply = json.loads(self.ask_for_work())
        if reply.get("lease") is None:
            raise TransientError(f"the coordinator assigned no job: {reply}")
        return Lease.model_validate(reply["lease"])

    def announce(self, lease: Lease, digest: str, size: int) -> None:
        """Announces a finished bundle."""
        self.ask(Verb.DONE, Done(sid=self.sid, lease=lease, sha256=digest, size=size))

    def is_wanted(self, lease: Lease) -> bool:
        """Returns whether the bundle of a lease must still be kept, according to the reply to a heartbeat."""
        reply = BeatReply.model_validate_json(self.ask(Verb.BEAT, Beat(sid=self.sid, spool=(lease,))))
        return lease not in reply.drop

    def close(self) -> None:
        """Closes the session."""
        self._session.close()

    def _serve(self, query: zenoh.Query) -> None:
        with query:
            asked = parse_bundle_ranges({name: query.parameters.get(name) or "" for name in RANGE_FIELDS})
            if self._bundle:
                parts = [self._bundle[part.offset : part.offset + part.length] for *_, part in asked]
                query.reply(bundle_key(self._run, self.sid), b"".join(parts))


def claim_and_announce(
    pipe: Connection, endpoints: Sequence[str], run: str, members: int, cycles: int, size: int
) -> None:
    """Every worker claims and announces `cycles` jobs and serves the bundles; sends a `WorkCost`.

    The coordinator pulls bundles concurrently, as fast as it can; no worker waits until its bundles are pulled.
    """
    bundle = bundle_of(size)
    digest = sha256(bundle).hexdigest()

    def work(member: BenchWorker) -> None:
        for _ in range(cycles):
            member.announce(member.claim(), digest, size)

    fleet = _open(endpoints, run, members, bundle)
    pipe.send(len(fleet))
    pipe.recv()
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    _all(work, fleet)
    pipe.send(WorkCost(seconds=time.perf_counter() - start_s, cpu_s=time.process_time() - start_cpu_s))
    with contextlib.suppress(EOFError):
        pipe.recv()
    _all(BenchWorker.close, fleet)


def claim_until_stopped(pipe: Connection, endpoints: Sequence[str], run: str, pause_s: float) -> None:
    """One worker claims periodically until a message arrives in the pipe; then sends the response times, seconds."""
    (member,) = _open(endpoints, run, 1)
    waits = []
    pipe.send(1)
    while not pipe.poll(pause_s):
        start_s = time.perf_counter()
        member.ask_for_work()
        waits.append(time.perf_counter() - start_s)
    pipe.send(waits)
    member.close()


def deliver_together(pipe: Connection, endpoints: Sequence[str], run: str, members: int, size: int) -> None:
    """All workers finish a bundle of `size` bytes simultaneously; sends the time until all are archived, seconds."""
    bundle = bundle_of(size)
    digest = sha256(bundle).hexdigest()
    fleet = _open(endpoints, run, members, bundle)
    leases = [member.claim() for member in fleet]
    pipe.send(len(fleet))
    pipe.recv()
    start_s = time.perf_counter()
    waiting = dict(zip(fleet, leases, strict=True))
    _all(lambda member: member.announce(waiting[member], digest, size), fleet)
    while waiting:
        time.sleep(_BEAT_S)
        waiting = {member: lease for member, lease in waiting.items() if member.is_wanted(lease)}
    pipe.send(time.perf_counter() - start_s)
    _all(BenchWorker.close, fleet)


def stay_connected(pipe: Connection, endpoints: Sequence[str], run: str, members: int) -> None:
    """Opens sessions and sends `hello` in each; keeps them open until a message arrives in the pipe.

    Sends the number of sessions through the pipe when all are open.
    """
    fleet = _open(endpoints, run, members)
    _all(BenchWorker.introduce, fleet)
    pipe.send(len(fleet))
    with contextlib.suppress(EOFError):
        pipe.recv()
    _all(BenchWorker.close, fleet)


def _connect(endpoints: Sequence[str]) -> zenoh.Session:
    for _ in range(_TRIES - 1):
        with contextlib.suppress(zenoh.ZError):
            return zenoh.open(client_config(endpoints, _LINK_LEASE_S))
    return zenoh.open(client_config(endpoints, _LINK_LEASE_S))


def _open(endpoints: Sequence[str], run: str, members: int, bundle: bytes = b"") -> list[BenchWorker]:
    with ThreadPoolExecutor(_ARRIVING) as pool:
        return list(pool.map(lambda _: BenchWorker(endpoints, run, bundle), range(members)))


def _all(work: Callable[[BenchWorker], None], fleet: Sequence[BenchWorker]) -> None:
    with ThreadPoolExecutor(min(len(fleet), _PARALLEL)) as pool:
        list(pool.map(work, fleet))
