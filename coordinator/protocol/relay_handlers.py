"""Implements the requests of gateways as fenced operations on the ledger. Does not use zenoh.

This is the counterpart of `protocol` for gateways. A gateway may record what the core's own pullers record, and reports
the files that it stores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import bindparam, select
from sqlalchemy.engine import Connection

from coordinator.archive.difference import ListedFile, describe_difference
from coordinator.expansion.draw import to_job
from coordinator.ledger import archived, claims, outcomes
from coordinator.ledger.opening import planned_of
from coordinator.ledger.repair import current_job, record_whole
from coordinator.ledger.states import OPEN_STATES, JobState
from coordinator.ledger.tables import jobs
from coordinator.ledger.transitions import JobRow
from coordinator.protocol.bundles import IncomingBundle
from coordinator.protocol.protocol import ParsedRequest, ProtocolAnswer, Terms, fail_attempt
from coordinator.protocol.relay import (
    MAX_LOST,
    Archived,
    ExtendLease,
    Inventory,
    InventoryReply,
    Join,
    JoinReply,
    Orders,
    OrdersRequest,
    Refused,
    RelayOrder,
    UnrecordedFile,
)
from schemas.base import Model
from schemas.dataset.rows import EpisodeSummary, file_name_of
from schemas.exchangeable import candidates_of
from schemas.job import Job
from schemas.protocol.keys import Verb
from schemas.protocol.messages import PROTOCOL, Ack, Fail, Refusal, cut_detail
from schemas.support.product import why_refused
from schemas.terms import FailReason

Handler = Callable[[Connection, Any, str, Terms, datetime], Model]
_OF_THE_JOB = (
    *("split", "scene", "instruction", "target_id", "template_id", "colour", "expert"),
    *("scene_sha256", "plan_digest", "run"),
)
"""Fields that an episode's row copies from its job under the same name."""
_MOST_AHEAD = 10_000
"""Maximum number by which the attempt of a file may exceed the attempt of its job in a rebuilt ledger."""
_DRAW = select(jobs).where(jobs.c.idx == bindparam("index"), jobs.c.draw == bindparam("of_draw"))
_CURRENT = select(jobs).where(jobs.c.idx.in_(bindparam("indices", expanding=True)), jobs.c.superseded.is_(False))


def serve_gateway(connection: Connection, request: ParsedRequest, terms: Terms, now: datetime) -> ProtocolAnswer:
    """Executes a request of a gateway within the caller's transaction."""
    return ProtocolAnswer(_HANDLERS[type(request.message)](connection, request.message, request.host, terms, now))


def orders_for(bundles: tuple[IncomingBundle, ...], *, finished: bool) -> Orders:
    """Returns the message with the orders of a gateway and whether the run is finished."""
    return Orders(
        orders=tuple(
            RelayOrder(lease=p.lease, sid=p.sid, sha256=p.sha256, size=p.size, job=p.job, candidates=p.candidates)
            for p in bundles
            if isinstance(p.job, Job)  # no package of a layout is assigned to a gateway
        ),
        finished=finished,
    )


def _join(connection: Connection, join: Join, gateway: str, terms: Terms, now: datetime) -> Model:  # noqa: ARG001
    if join.version != terms.version:
        peer = f"gateway {gateway}"
        why = why_refused(peer, join.version, join.protocol, mine=terms.version, my_protocol=PROTOCOL)
        return Refusal(error=f"join: {why}")
    if terms.evaluation is not None:
        return Refusal(error="gateways do not store the results of evaluations: connect the workers to the coordinator")
    return JoinReply(run=terms.plan.run, plan_digest=terms.plan.digest)


def _hold(connection: Connection, hold: ExtendLease, gateway: str, terms: Terms, now: datetime) -> Model:  # noqa: ARG001
    return Ack(accepted=claims.extend(connection, hold.lease, now, hold.seconds))


def _archived(connection: Connection, report: Archived, gateway: str, terms: Terms, now: datetime) -> Model:
    summary = report.summary
    row = connection.execute(_DRAW, {"index": summary.index, "of_draw": summary.draw}).first()
    if row is None:
        return Ack(accepted=False)
    wrong = _contradictions(row, summary, terms)
    if wrong:
        return Refusal(error=f"gateway {gateway}: {summary.episode_id} is not of this run: {', '.join(wrong)} differ")
    if archived.is_recorded_at_gateway(connection, summary.index, gateway, summary.file_sha256):
        return Ack(accepted=True)  # the gateway repeats a request whose reply was lost
    if report.lease is not None:
        accepted = outcomes.archive(connection, report.lease, summary, now)
    else:
        accepted = _adopt(connection, summary, terms, now)
    if accepted:
        archived.record_at_gateway(connection, summary.index, gateway)
    return Ack(accepted=accepted)


def _contradictions(row: JobRow, summary: EpisodeSummary, terms: Terms) -> list[str]:
    """Returns the fields in which a reported episode differs from its job."""
    job = to_job(terms.plan, terms.catalog, planned_of(row), summary.attempt)
    wanted = {
        "episode_id": job.episode_id,
        "file_name": file_name_of(job.episode_id),
        "target_category": job.category,
        "spawn_tier": job.tier,
    } | {name: getattr(job, name) for name in _OF_THE_JOB}
    if job.language is not None:  # the worker wrote the instruction, so it is not in the job
        wanted = {name: value for name, value in wanted.items() if name not in ("instruction", "template_id")}
    wrong = [name for name, value in wanted.items() if getattr(summary, name) != value]
    return wrong if summary.attempt <= row.attempt + _MOST_AHEAD else [*wrong, "attempt"]


def _adopt(connection: Connection, summary: EpisodeSummary, terms: Terms, now: datetime) -> bool:
    """Records a file that was published before a crash of its gateway or of the core, if the job is open.

    A rebuilt ledger may be at an earlier attempt than the file.
    """
    row = current_job(connection, summary.index)
    if row is None or row.state not in OPEN_STATES or row.draw != summary.draw or row.attempt > summary.attempt:
        return False
    if row.state == JobState.SUBMITTED and row.sha256 == summary.file_sha256:
        return outcomes.adopt(connection, row.id, summary, now)
    at = (summary.draw, summary.attempt)
    return record_whole(connection, terms.plan, catalog=terms.catalog, receipt=summary, now=now, at=at) == ""


def _refused(connection: Connection, refusal: Refused, gateway: str, terms: Terms, now: datetime) -> Model:
    report = Fail(
        sid=refusal.sid,
        lease=refusal.lease,
        reason=FailReason.INVALID,
        detail=cut_detail(f"at gateway {gateway}: {refusal.detail}"),
    )
    return Ack(accepted=fail_attempt(connection, report, terms, now))


def _inventory(connection: Connection, inventory: Inventory, gateway: str, terms: Terms, now: datetime) -> Model:
    if inventory.is_new and (kept := archived.count_by_gateway(connection).get(gateway)):
        return Refusal(
            error=f"the ledger has {kept} episodes at gateway {gateway}, but the gateway's directory is new: "
            "give the --out of its previous start, or another --name; lost episodes are generated again after "
            "`factory gather CORE_DIR --requeue-missing`"
        )
    files = {index: ListedFile(size) for index, size in inventory.files if inventory.first <= index <= inventory.last}
    owned, wrong = set(), {}
    for index, record in archived.records_of_gateway(connection, gateway, inventory.first, inventory.last):
        owned.add(index)
        if why := describe_difference(files.get(index), record):
            wrong[index] = why
        if len(wrong) == MAX_LOST:
            break
    for index, why in wrong.items():
        outcomes.lose(connection, index, now, f"at gateway {gateway}: {why}")
    if len(wrong) == MAX_LOST:
        return InventoryReply(lost=tuple(wrong))
    strays = tuple(_strays(connection, files.keys() - owned, terms))
    strays += tuple(UnrecordedFile(index=index, why=why) for index, why in wrong.items() if index in files)
    return InventoryReply(strays=strays, lost=tuple(wrong))


def _strays(connection: Connection, indices: set[int], terms: Terms) -> Iterator[UnrecordedFile]:
    rows = {row.idx: row for row in connection.execute(_CURRENT, {"indices": sorted(indices)})} if indices else {}
    for index in sorted(indices):
        row = rows.get(index)
        if row is None:
            yield UnrecordedFile(index=index, why="the plan has no such episode")
        elif row.state not in OPEN_STATES:
            yield UnrecordedFile(index=index, why=f"no file is expected for this episode (its job is {row.state})")
        else:
            job = to_job(terms.plan, terms.catalog, planned_of(row), row.attempt)
            candidates = candidates_of(job, terms.catalog[job.scene].info)
            yield UnrecordedFile(index=index, why=f"its job is {row.state}", job=job, candidates=candidates)


RELAY_MESSAGES: Mapping[Verb, type[Model]] = MappingProxyType(
    {
        Verb.JOIN: Join,
        Verb.ORDERS: OrdersRequest,
        Verb.HOLD: ExtendLease,
        Verb.ARCHIVED: Archived,
        Verb.REFUSED: Refused,
        Verb.INVENTORY: Inventory,
    }
)
"""Message type by verb of a gateway; the reply to `orders` does not need the ledger."""

_HANDLERS: Mapping[type[Model], Handler] = MappingProxyType(
    {Join: _join, ExtendLease: _hold, Archived: _archived, Refused: _refused, Inventory: _inventory}
)
