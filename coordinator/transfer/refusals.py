"""Refuses announced bundles: counts and logs the refusal, and reports it to the ledger. Decides nothing."""

from __future__ import annotations

import structlog

from coordinator.meters import Meter, Meters
from coordinator.protocol.bundles import IncomingBundle
from coordinator.transfer.contract import LedgerClient
from schemas.protocol.keys import host_of
from schemas.support.log_limit import LogLimit

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 60.0
"""First and longest pause between two log lines about refused bundles of one host, seconds."""

log = structlog.get_logger(__name__)


class Refusals:
    """Thread-safe refusal of bundles.

    Args:
        ledger: ledger of the run.
        meters: counters of the coordinator.
    """

    def __init__(self, ledger: LedgerClient, meters: Meters) -> None:
        self._ledger, self._meters = ledger, meters
        self._limit = LogLimit(_FIRST_PAUSE_S, _LONGEST_PAUSE_S)

    def refuse(self, bundle: IncomingBundle, detail: str, *, is_false: bool = False) -> None:
        """Refuses a bundle.

        Args:
            bundle: bundle.
            detail: reason.
            is_false: whether the worker has announced the bundle as valid, so its host is barred.

        Raises:
            TransientError: the ledger is unavailable.
        """
        self._meters.add(Meter.REFUSED)
        episode, host = bundle.name, host_of(bundle.sid)
        self._limit.write(log.warning, "bundle_refused", host, episode=episode, worker=bundle.sid, detail=detail)
        self._ledger.refuse(bundle, detail, is_false=is_false)
