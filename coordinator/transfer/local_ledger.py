"""Implements the ledger operations of the coordinator's pullers, with one commit of the writer per call.

The state machine in `coordinator.ledger` decides which operations succeed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime

from sqlalchemy.engine import Connection

from coordinator.ledger import archived, claims, outcomes
from coordinator.ledger.database.writer import Writer
from coordinator.protocol.bundles import IncomingBundle
from coordinator.protocol.protocol import Terms, fail_attempt
from coordinator.transfer.contract import ValidatedBundle
from schemas.protocol.keys import host_of
from schemas.protocol.messages import Fail, cut_detail
from schemas.terms import FailReason


class LocalLedgerClient:
    """`LedgerClient` that accesses the ledger in the same process."""

    def __init__(self, writer: Writer, terms: Terms, clock: Callable[[], datetime]) -> None:
        self._writer = writer
        self._terms = terms
        self._clock = clock

    def keep(self, bundles: Sequence[IncomingBundle], seconds: float) -> Sequence[bool]:
        return self._writer.call(
            lambda connection: [claims.extend(connection, bundle.lease, self._clock(), seconds) for bundle in bundles]
        )

    def is_recorded(self, index: int) -> bool:
        return self._writer.call(lambda connection: outcomes.is_recorded(connection, index))

    def record_archived(self, bundles: Sequence[ValidatedBundle]) -> Sequence[bool]:
        return self._writer.call(lambda connection: [_record(connection, each, self._clock()) for each in bundles])

    def refuse(self, bundle: IncomingBundle, detail: str, *, is_false: bool = False) -> None:
        report = Fail(
            sid=bundle.sid,
            lease=bundle.lease,
            reason=FailReason.INVALID,
            detail=cut_detail(detail),
        )

        def refuse(connection: Connection) -> None:
            now = self._clock()
            fail_attempt(connection, report, self._terms, now)
            if is_false:
                archived.bar_at_once(
                    connection, host_of(bundle.sid), f"invalid bundle, announced as valid: {report.detail}", now
                )

        self._writer.call(refuse)


def _record(connection: Connection, validated: ValidatedBundle, now: datetime) -> bool:
    bundle, receipt, is_checked = validated
    if not outcomes.archive(connection, bundle.lease, receipt, now):
        return outcomes.is_recorded(connection, bundle.job.index)
    if not is_checked:
        archived.note_unchecked(connection, bundle.job.index, host_of(bundle.sid))
    return True
