"""Implements the verbs of the coordinator: parses and validates requests and executes them on the ledger.

Every verb is idempotent. The module does not use zenoh and does not pull bundles: it returns the bundles to pull after
the commit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import ValidationError
from sqlalchemy import Row, select
from sqlalchemy.engine import Connection

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import EvalJobs, redraw, to_job
from coordinator.ledger import administration, claims, hosts, outcomes
from coordinator.ledger.builds import number_of_layout, order_of
from coordinator.ledger.claims import lease_of
from coordinator.ledger.opening import planned_of
from coordinator.ledger.tables import BUILD, jobs
from coordinator.protocol.bundles import BuildJob, IncomingBundle
from schemas.base import Model
from schemas.exchangeable import candidates_of
from schemas.job import Job
from schemas.plan import Plan
from schemas.protocol.administration import AdminRequest
from schemas.protocol.identity import Role, is_host_name
from schemas.protocol.keys import Verb, sid_belongs_to
from schemas.protocol.messages import (
    MAX_MESSAGE_BYTES,
    PROTOCOL,
    Ack,
    Beat,
    BeatReply,
    Claim,
    ClaimReply,
    Done,
    Fail,
    Greeting,
    Hello,
    HelloReply,
    HostMemory,
    Ping,
    Pong,
    Refusal,
    RunKind,
)
from schemas.support.product import product_version, why_refused
from schemas.terms import family_of

M = TypeVar("M", bound=Model)
_SMALL_MESSAGE_BYTES = 16 << 10
_MESSAGE_BYTES: Mapping[Verb, int] = MappingProxyType(
    {
        Verb.BEAT: 64 << 10,
        Verb.INVENTORY: 64 << 10,
        Verb.ADMIN: MAX_MESSAGE_BYTES,
        Verb.ARCHIVED: MAX_MESSAGE_BYTES,
    }
)
"""Maximum message size by verb, bytes; `_SMALL_MESSAGE_BYTES` for other verbs."""
_GREETINGS = MappingProxyType({Verb.HELLO: "worker", Verb.JOIN: "gateway"})
"""Sender by verb of the messages that state the version of the sender."""
_NAME_END, _BYTES_A_NAME = b'":', 24
"""A JSON message may have one key per `_BYTES_A_NAME` bytes of the maximum message size of its verb; keys are counted
by `_NAME_END`. Otherwise, each of thousands of unknown keys would cause a separate validation error. A full heartbeat
has 27 bytes per key."""
_SHOWN_MISTAKES, _SHOWN_CHARS = 5, 80


FindStates = Callable[[Job], str | None]
"""Function that returns the states recording of a job as base64 text, from which the worker renders the frames. It
returns `None` if the worker must simulate the job."""


def simulate_all(_job: Job) -> None:
    """Returns no recording, so every job is simulated."""


@dataclass(frozen=True)
class Terms:
    """Terms of the run for its workers; the flags change while it runs."""

    plan: Plan
    """Plan of the run."""
    catalog: Catalog
    """Compiled scenes of the plan."""
    version: str
    """Version of minivla-factory; workers of a different version are refused."""
    lease_ttl_s: float
    """Duration of a lease, seconds."""
    retry_after_s: float
    """Pause of a worker before its next claim if no job is due, seconds."""
    is_draining: Callable[[], bool] = lambda: False
    """Function that returns whether workers shall stop after their current jobs."""
    is_finished: Callable[[], bool] = lambda: False
    """Function that returns whether the run was finished at the last check, without reading the ledger."""
    has_room: Callable[[], bool] = lambda: True
    """Function that returns whether the archive has space for the bundle of a new job."""
    evaluation: EvalJobs | None = None
    """Tasks of an evaluation; `None` for a collection."""
    is_pulled: Callable[[int], bool] = lambda _index: False
    """Function that returns whether the bundle of an episode is queued or in transfer in this process."""
    find_states: FindStates = simulate_all
    """Function that returns the states recording of a job."""
    memory: dict[str, HostMemory] = field(default_factory=dict)
    """Memory that each host reported in its last heartbeat, by the name of the host."""
    textures: dict[str, frozenset[str]] = field(default_factory=dict)
    """SHA-256 of the stored textures by family."""
    role_of: Callable[[str], Role | None] = lambda _host: None
    """Function that returns the role of a host in the admission list; `None` without TLS."""
    workers_validate: bool = False
    """Whether workers validate their bundles before they announce them."""


@dataclass(frozen=True)
class ProtocolAnswer:
    """Reply to send after COMMIT, with the bundles to pull."""

    reply: Model
    """Reply to the requester."""
    bundles: tuple[IncomingBundle, ...] = ()
    """Bundles to pull."""


@dataclass(frozen=True)
class ParsedRequest:
    """Request that passed all checks that do not need the ledger."""

    host: str
    """Host name in the request key."""
    message: Model
    """Validated message."""


Handler = Callable[[Connection, Any, str, Terms, datetime], ProtocolAnswer]


def parse(
    verb: str, host: str, payload: bytes, known: Mapping[Verb, type[Model]] | None = None
) -> ParsedRequest | Refusal:
    """Parses and validates a message; returns a refusal with the reason if it is invalid.

    Args:
        verb: last segment of the request key.
        host: host name in the request key.
        payload: JSON message.
        known: message type by verb; by default the verbs of workers and operators.
    """
    known = known or _MESSAGES
    if verb not in known:
        return Refusal(error=f"unknown verb {verb[:40]!r}; valid verbs: {', '.join(known)}")
    if not is_host_name(host):
        return Refusal(error=f"{verb}: {host[:_SHOWN_CHARS]!r} is not a valid host name; example: node-07")
    most = _MESSAGE_BYTES.get(Verb(verb), _SMALL_MESSAGE_BYTES)
    if len(payload) > most:
        return Refusal(error=f"{verb}: {len(payload)} bytes, more than {most}")
    if most < MAX_MESSAGE_BYTES and payload.count(_NAME_END) > most // _BYTES_A_NAME:
        return Refusal(error=f"{verb}: more keys than this message allows; check that both sides run the same version")
    foreign = _why_other_protocol(Verb(verb), host, payload)
    if foreign:
        return Refusal(error=f"{verb}: {foreign}")
    try:
        message = known[Verb(verb)].model_validate_json(payload)
    except ValidationError as error:
        return Refusal(
            error=f"{verb}: invalid message ({_mistakes(error)}); check that both sides run the same version"
        )
    sid = getattr(message, "sid", None)
    if known is _MESSAGES and sid is not None and not sid_belongs_to(sid, host):
        return Refusal(
            error=f"{verb}: session {sid!r} does not belong to host {host!r}; session ids begin with the host name"
        )
    return ParsedRequest(host, message)


def _why_other_protocol(verb: Verb, host: str, payload: bytes) -> str:
    """Returns why a registration with another version of the messages is refused; empty for all other messages."""
    if verb not in _GREETINGS:
        return ""
    try:
        greeting = Greeting.model_validate_json(payload)
    except ValidationError:
        return ""  # not a registration of any version
    if greeting.protocol == PROTOCOL:
        return ""
    peer = f"{_GREETINGS[verb]} {host}"
    return why_refused(peer, greeting.version, greeting.protocol, mine=product_version(), my_protocol=PROTOCOL)


def _mistakes(error: ValidationError) -> str:
    """Returns the first validation errors; for a message with many errors only their number, to limit the cost."""
    count = error.error_count()
    if count > 10 * _SHOWN_MISTAKES:
        return f"{count} mistakes"
    mistakes = error.errors(include_url=False, include_context=False, include_input=False)[:_SHOWN_MISTAKES]
    lines = (f"{'.'.join(map(str, item['loc']))[:_SHOWN_CHARS]}: {item['msg']}" for item in mistakes)
    return "; ".join(lines).replace("\n", "; ")


def serve(connection: Connection, request: ParsedRequest, terms: Terms, now: datetime) -> ProtocolAnswer:
    """Executes a request within the caller's transaction."""
    return _HANDLERS[type(request.message)](connection, request.message, request.host, terms, now)


def fail_attempt(connection: Connection, report: Fail, terms: Terms, now: datetime) -> bool:
    """Records a failed attempt under the terms of the run; see `outcomes.fail`."""
    return outcomes.fail(
        connection,
        report,
        now,
        terms.plan.budget,
        lambda planned: redraw(terms.plan, terms.catalog, planned),
        # an evaluation bars no hosts: it reports each failure at once, and users can repeat it
        blames_hosts=terms.evaluation is None,
    )


def _hello(connection: Connection, hello: Hello, host: str, terms: Terms, now: datetime) -> ProtocolAnswer:
    if hello.host != host:
        return ProtocolAnswer(
            Refusal(error=f"hello: the message names host {hello.host!r}, but its key names {host!r}")
        )
    if hello.version != terms.version:
        why = why_refused(
            f"worker {hello.sid}", hello.version, hello.protocol, mine=terms.version, my_protocol=PROTOCOL
        )
        return ProtocolAnswer(Refusal(error=f"hello: {why}; episodes of two versions may differ"))
    if not hosts.register(connection, hello, now):
        return ProtocolAnswer(
            Refusal(
                error=f"hello: host {host!r} has {hosts.SESSIONS_OF_HOST} recently active sessions, or all hosts "
                f"together have {hosts.SESSIONS}: stop some workers, or wait some minutes"
            )
        )
    run_kind = RunKind.COLLECTION if terms.evaluation is None else RunKind.EVALUATION
    run, ttl_s, validates = terms.plan.run, terms.lease_ttl_s, terms.workers_validate
    return ProtocolAnswer(
        HelloReply(run=run, version=terms.version, lease_ttl_s=ttl_s, run_kind=run_kind, validates=validates)
    )


def _claim(connection: Connection, claim: Claim, host: str, terms: Terms, now: datetime) -> ProtocolAnswer:
    may_start = terms.has_room() and not terms.is_draining() and not administration.is_paused(connection)
    pause_s = hosts.pause_of(connection, host, now)
    may_start = may_start and pause_s == 0
    row = claims.claim(
        connection,
        claim.sid,
        token=claim.token,
        now=now,
        ttl_s=terms.lease_ttl_s,
        may_start=may_start,
        can_build=claim.can_build,
    )
    if row is not None and row.tier == BUILD:
        known = terms.textures.get(family_of(row.scene), frozenset())
        return ProtocolAnswer(ClaimReply(build=order_of(terms.plan, row, known), lease=lease_of(row)))
    if row is not None:
        job = to_job(terms.plan, terms.catalog, planned_of(row), row.attempt)
        payload = None if terms.evaluation is None else terms.evaluation.find(row.idx)
        states = terms.find_states(job)
        return ProtocolAnswer(ClaimReply(job=job, lease=lease_of(row), evaluation=payload, states=states))
    hosts.note_alive(connection, claim.sid, host, now)
    finished = not claims.has_open_jobs(connection)
    return ProtocolAnswer(ClaimReply(retry_after_s=max(terms.retry_after_s, pause_s), finished=finished))


def _beat(connection: Connection, beat: Beat, host: str, terms: Terms, now: datetime) -> ProtocolAnswer:
    hosts.note_alive(connection, beat.sid, host, now)
    if beat.memory is not None and (host in terms.memory or len(terms.memory) < hosts.SESSIONS):
        terms.memory[host] = beat.memory
    outcome = claims.beat(connection, beat, now, terms.lease_ttl_s)
    _report_waits(connection, beat, terms)
    waiting = tuple(lease_of(row) for row in outcome.waiting)
    is_idle = len(outcome.lost) == len(beat.live) and len(outcome.drop) == len(beat.spool)
    reply = BeatReply(
        lost=outcome.lost,
        drop=outcome.drop,
        waiting=waiting,
        drain=terms.is_draining(),
        finished=is_idle and not claims.has_open_jobs(connection),
    )
    unpulled = (row for row in outcome.waiting if not terms.is_pulled(row.idx))
    return ProtocolAnswer(reply, tuple(_bundle_of(row, beat.sid, beat.via, terms) for row in unpulled))


def _report_waits(connection: Connection, beat: Beat, terms: Terms) -> None:
    """Passes the long waits for policies to the evaluation."""
    waits = {progress.lease.job_id: progress.waits for progress in beat.live if progress.waits is not None}
    if terms.evaluation is None or not waits:
        return
    for row in connection.execute(select(jobs.c.id, jobs.c.idx).where(jobs.c.id.in_(waits))):
        terms.evaluation.on_wait(row.idx, waits[row.id])


def _done(connection: Connection, done: Done, host: str, terms: Terms, now: datetime) -> ProtocolAnswer:  # noqa: ARG001
    accepted, waiting = outcomes.announce(connection, done, now, terms.lease_ttl_s)
    bundles = (
        (_bundle_of(waiting, done.sid, done.via, terms, is_validated=done.is_validated),) if waiting is not None else ()
    )
    return ProtocolAnswer(Ack(accepted=accepted), bundles)


def _fail(connection: Connection, fail: Fail, host: str, terms: Terms, now: datetime) -> ProtocolAnswer:  # noqa: ARG001
    return ProtocolAnswer(Ack(accepted=fail_attempt(connection, fail, terms, now)))


def _admin(connection: Connection, request: AdminRequest, host: str, terms: Terms, now: datetime) -> ProtocolAnswer:  # noqa: ARG001
    return ProtocolAnswer(administration.execute(connection, request, now))


def _ping(connection: Connection, ping: Ping, host: str, terms: Terms, now: datetime) -> ProtocolAnswer:  # noqa: ARG001
    return ProtocolAnswer(Pong(role=terms.role_of(host)))


def _bundle_of(row: Row[Any], sid: str, via: str | None, terms: Terms, *, is_validated: bool = False) -> IncomingBundle:
    if row.tier == BUILD:
        build = BuildJob(row.idx, row.scene, number_of_layout(terms.plan, row))
        return IncomingBundle(
            lease_of(row), sid, sha256=row.sha256, size=row.size, job=build, candidates=()
        )  # no gateway pulls the package of a layout
    job = to_job(terms.plan, terms.catalog, planned_of(row), row.attempt)
    candidates = candidates_of(job, terms.catalog[job.scene].info)
    return IncomingBundle(
        lease_of(row),
        sid,
        sha256=row.sha256,
        size=row.size,
        job=job,
        candidates=candidates,
        via=via,
        is_validated=is_validated,
    )


_MESSAGES: Mapping[Verb, type[Model]] = MappingProxyType(
    {
        Verb.HELLO: Hello,
        Verb.CLAIM: Claim,
        Verb.BEAT: Beat,
        Verb.DONE: Done,
        Verb.FAIL: Fail,
        Verb.ADMIN: AdminRequest,
        Verb.PING: Ping,
    }
)
"""Message type by verb; `progress` has no message, and a reader of the ledger replies to it."""

_HANDLERS: Mapping[type[Model], Handler] = MappingProxyType(
    {Hello: _hello, Claim: _claim, Beat: _beat, Done: _done, Fail: _fail, AdminRequest: _admin, Ping: _ping}
)
