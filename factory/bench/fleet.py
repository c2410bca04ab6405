"""Workers that only speak the wire, many in one process: they claim, announce, and serve chunks of one bundle for all.

Each function is the whole life of a process: it opens its sessions, says so, does its work and sends what it saw.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from importlib.metadata import version
from multiprocessing.connection import Connection

import zenoh

from coordinator.protocol.zenoh_config import client_config
from schemas.base import Model
from schemas.errors import TransientError
from schemas.keys import Verb, alive_key, bundle_key, parse_bundle_chunk, verb_key
from schemas.wire import Beat, BeatReply, Claim, Done, Hello, Lease

__all__ = [
    "Effort",
    "Member",
    "bundle_of",
    "claim_and_announce",
    "claim_until_told",
    "deliver_together",
    "stay_connected",
]

_LINK_LEASE_S = 60.0
_ASK_S = 30.0
_BEAT_S = 0.5
_PARALLEL = 64
"""Members that act at a time."""
_ARRIVING, _TRIES = 8, 10
"""Sessions that are opened at a time, and how often: a connection gives up after two seconds on a busy machine."""


class Effort(Model):
    """What some work took."""

    seconds: float
    """Wall clock."""
    cpu_s: float
    """Of all threads of the process that did it."""


def bundle_of(size: int) -> bytes:
    """Returns the bundle that every worker delivers: bytes that do not compress, the same in every process."""
    block = b"".join(sha256(number.to_bytes(4, "big")).digest() for number in range(1 << 10))
    return (block * (size // len(block) + 1))[:size]


class Member:
    """One session with a name; closed with `close`.

    Args:
        endpoints: of the coordinator.
        run: its name.
        bundle: what is served under any lease; nothing is declared without.
    """

    def __init__(self, endpoints: Sequence[str], run: str, bundle: bytes = b"") -> None:
        self._host = f"bench-{secrets.token_hex(4)}"
        self.sid = f"{self._host}.1"
        self._run, self._bundle = run, bundle
        self._session = _connect(endpoints)
        self._session.declare_queryable(bundle_key(run, self.sid), self._serve)
        self._token = self._session.liveliness().declare_token(alive_key(run, self.sid))

    def ask(self, verb: Verb, message: Model) -> bytes:
        """Returns the reply as it came.

        Raises:
            TransientError: there is none.
        """
        for reply in self._session.get(
            verb_key(self._run, self._host, verb),
            zenoh.handlers.FifoChannel(4),
            payload=message.model_dump_json(),
            timeout=_ASK_S,
            consolidation=zenoh.ConsolidationMode.NONE,
        ):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        raise TransientError(f"the coordinator did not answer {verb} within {_ASK_S:.0f} s")

    def introduce(self) -> None:
        """Says hello."""
        self.ask(Verb.HELLO, Hello(sid=self.sid, host=self._host, slots=1, version=version("minivla-factory")))

    def ask_for_work(self) -> bytes:
        """Claims, and returns the reply as it came, with a job or without."""
        return self.ask(Verb.CLAIM, Claim(sid=self.sid, token=secrets.token_hex(16)))

    def claim(self) -> Lease:
        """Returns the lease of a job.

        Raises:
            TransientError: no answer, or no job is due.
        """
        reply = json.loads(self.ask_for_work())
        if reply.get("lease") is None:
            raise TransientError(f"the coordinator assigned no job: {reply}")
        return Lease.model_validate(reply["lease"])

    def announce(self, lease: Lease, digest: str, size: int) -> None:
        """Says that a bundle waits."""
        self.ask(Verb.DONE, Done(sid=self.sid, lease=lease, sha256=digest, size=size))

    def is_wanted(self, lease: Lease) -> bool:
        """Whether a bundle must be kept still, as the coordinator's answer to a heartbeat says."""
        reply = BeatReply.model_validate_json(self.ask(Verb.BEAT, Beat(sid=self.sid, spool=(lease,))))
        return lease not in reply.drop

    def close(self) -> None:
        """Ends the session."""
        self._session.close()

    def _serve(self, query: zenoh.Query) -> None:
        with query:
            names = ("job", "fence", "off", "n")
            *_, chunk = parse_bundle_chunk({name: query.parameters.get(name) or "" for name in names})
            if self._bundle:
                query.reply(bundle_key(self._run, self.sid), self._bundle[chunk.offset : chunk.offset + chunk.length])


def claim_and_announce(
    pipe: Connection, endpoints: Sequence[str], run: str, members: int, cycles: int, size: int
) -> None:
    """Every member claims a job and announces its bundle so many times, and serves what is pulled; sends an `Effort`.

    Pulling goes on beside the cycles, as fast as the coordinator's pullers can; no member waits for it.
    """
    bundle = bundle_of(size)
    digest = sha256(bundle).hexdigest()

    def work(member: Member) -> None:
        for _ in range(cycles):
            member.announce(member.claim(), digest, size)

    fleet = _open(endpoints, run, members, bundle)
    pipe.send(len(fleet))
    pipe.recv()
    begun, begun_cpu = time.perf_counter(), time.process_time()
    _all(work, fleet)
    pipe.send(Effort(seconds=time.perf_counter() - begun, cpu_s=time.process_time() - begun_cpu))
    with contextlib.suppress(EOFError):
        pipe.recv()
    _all(Member.close, fleet)


def claim_until_told(pipe: Connection, endpoints: Sequence[str], run: str, pause_s: float) -> None:
    """One member claims now and then until the pipe says stop; sends how long each answer took, seconds."""
    (member,) = _open(endpoints, run, 1)
    waits = []
    pipe.send(1)
    while not pipe.poll(pause_s):
        begun = time.perf_counter()
        member.ask_for_work()
        waits.append(time.perf_counter() - begun)
    pipe.send(waits)
    member.close()


def deliver_together(pipe: Connection, endpoints: Sequence[str], run: str, members: int, size: int) -> None:
    """All members finish a bundle of that size at the same moment; sends the seconds until the last was archived."""
    bundle = bundle_of(size)
    digest = sha256(bundle).hexdigest()
    fleet = _open(endpoints, run, members, bundle)
    leases = [member.claim() for member in fleet]
    pipe.send(len(fleet))
    pipe.recv()
    begun = time.perf_counter()
    waiting = dict(zip(fleet, leases, strict=True))
    _all(lambda member: member.announce(waiting[member], digest, size), fleet)
    while waiting:
        time.sleep(_BEAT_S)
        waiting = {member: lease for member, lease in waiting.items() if member.is_wanted(lease)}
    pipe.send(time.perf_counter() - begun)
    _all(Member.close, fleet)


def stay_connected(pipe: Connection, endpoints: Sequence[str], run: str, members: int) -> None:
    """Opens sessions that introduce themselves, tells how many there are, and keeps them until the pipe says stop."""
    fleet = _open(endpoints, run, members)
    _all(Member.introduce, fleet)
    pipe.send(len(fleet))
    with contextlib.suppress(EOFError):
        pipe.recv()
    _all(Member.close, fleet)


def _connect(endpoints: Sequence[str]) -> zenoh.Session:
    for _ in range(_TRIES - 1):
        with contextlib.suppress(zenoh.ZError):
            return zenoh.open(client_config(endpoints, _LINK_LEASE_S))
    return zenoh.open(client_config(endpoints, _LINK_LEASE_S))


def _open(endpoints: Sequence[str], run: str, members: int, bundle: bytes = b"") -> list[Member]:
    with ThreadPoolExecutor(_ARRIVING) as pool:
        return list(pool.map(lambda _: Member(endpoints, run, bundle), range(members)))


def _all(work: Callable[[Member], None], fleet: Sequence[Member]) -> None:
    with ThreadPoolExecutor(min(len(fleet), _PARALLEL)) as pool:
        list(pool.map(work, fleet))
