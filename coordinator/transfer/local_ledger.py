"""Implements the ledger operations of the coordinator's pullers, with one commit of the writer per call.

The state machine in `coordinator.ledger` decides which operations succeed.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from coordinator.ledger import claims, outcomes
from coordinator.ledger.writer import Writer
from coordinator.protocol.protocol import Terms, fail_attempt
from coordinator.protocol.pulls import Pull
from schemas.dataset.rows import BundleReceipt
from schemas.protocol.messages import Fail, cut_detail
from schemas.terms import FailReason


class LocalLedgerClient:
    """`LedgerClient` that accesses the ledger in the same process."""

    def __init__(self, writer: Writer, terms: Terms, clock: Callable[[], datetime]) -> None:
        self._writer = writer
        self._terms = terms
        self._clock = clock

    def keep(self, pull: Pull, seconds: float) -> bool:
        """See `LedgerClient`."""
        return self._writer.call(lambda connection: claims.extend(connection, pull.lease, self._clock(), seconds))

    def is_owned(self, index: int) -> bool:
        """See `LedgerClient`."""
        return self._writer.call(lambda connection: outcomes.is_owned(connection, index))

    def own(self, pull: Pull, receipt: BundleReceipt) -> bool:
        """See `LedgerClient`."""
        return self._writer.call(
            lambda connection: (
                outcomes.archive(connection, pull.lease, receipt, self._clock())
                or outcomes.is_owned(connection, pull.job.index)
            )
        )

    def refuse(self, pull: Pull, detail: str) -> None:
        """See `LedgerClient`."""
        report = Fail(
            sid=pull.sid,
            lease=pull.lease,
            reason=FailReason.INVALID,
            detail=cut_detail(detail),
        )
        self._writer.call(lambda connection: fail_attempt(connection, report, self._terms, self._clock()))
