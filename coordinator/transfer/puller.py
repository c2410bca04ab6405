"""Threads that fetch announced bundles, validate and publish them, and record them in the ledger.

The module does not retry a failed transfer: the worker's next heartbeat announces the bundle again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import structlog
from sqlalchemy.exc import SQLAlchemyError

from coordinator.archive.contract import Archive
from coordinator.meters import Meter, Meters
from coordinator.protocol.bundles import IncomingBundle
from coordinator.settings import CoordinatorSettings
from coordinator.transfer.contract import BundleValidator, FindLocalBundle, LedgerClient, no_local_bundle
from coordinator.transfer.delivering import Deliverer, SpotCheckedValidation
from coordinator.transfer.fair_queue import FairQueue
from coordinator.transfer.fetching import Fetch, Fetcher
from coordinator.transfer.refusals import Refusals
from schemas.errors import FactoryError
from schemas.protocol.keys import host_of
from schemas.support.closing import Closing
from schemas.support.log_limit import Repeated

_QUEUED = 2
"""A host with this many bundles for each puller, waiting or in transfer, is busy: a gateway then requests no more of
its bundles."""

if TYPE_CHECKING:
    from coordinator.transfer.layouts import LayoutStore

log = structlog.get_logger(__name__)


class Pullers(Closing):
    """Pool of threads that transfer bundles, at most one bundle of each episode at a time; a context manager.

    Hosts take turns, so slow hosts do not delay the others. The waiting small bundles of one worker share a turn.
    """

    def __init__(
        self,
        archive: Archive,
        ledger: LedgerClient,
        fetch: Fetch,
        checker: BundleValidator,
        settings: CoordinatorSettings,
        on_archived: Callable[[], None],
        meters: Meters | None = None,
        find_local_bundle: FindLocalBundle = no_local_bundle,
        layouts: LayoutStore | None = None,
    ) -> None:
        self._settings = settings
        self._meters = meters = meters or Meters()
        self._failing = Repeated(log, "pull_failed", (SQLAlchemyError,))
        self._on_archived = on_archived
        self._busy: set[int] = set()
        """Numbers of the episodes whose bundles are queued or in transfer."""
        self._guard = threading.Lock()
        self._stop = threading.Event()
        self._queue: FairQueue[IncomingBundle] = FairQueue(lambda turn, item: self._fetcher.joins(turn, item))
        refusals = Refusals(ledger, meters)
        self._fetcher = Fetcher(
            archive,
            ledger,
            fetch=fetch,
            settings=settings,
            meters=meters,
            find_local_bundle=find_local_bundle,
            refusals=refusals,
            has_others=self._queue.has_others,
            stop=self._stop,
        )
        validation = SpotCheckedValidation(checker, meters, settings.spot_checks)
        self._deliverer = Deliverer(
            archive,
            ledger,
            validation=validation,
            refusals=refusals,
            meters=meters,
            on_archived=self._note_archived,
            on_failure=self._note_failure,
            layouts=layouts,
        )
        self._threads = [
            threading.Thread(target=self._run, name=f"puller-{number}") for number in range(settings.pullers)
        ]
        for thread in self._threads:
            thread.start()

    def offer(self, bundle: IncomingBundle) -> None:
        """Queues a bundle unless its episode is queued or in transfer; the next heartbeat repeats the announcement."""
        with self._guard:
            if bundle.job.index in self._busy or self._stop.is_set():
                return
            self._busy.add(bundle.job.index)
        self._queue.put(host_of(bundle.sid), bundle)

    def has(self, index: int) -> bool:
        """Returns whether the bundle of an episode is queued or in transfer."""
        return index in self._busy

    @property
    def waiting(self) -> int:
        """Number of bundles that are queued or in transfer."""
        with self._guard:
            return len(self._busy)

    @property
    def busy_hosts(self) -> tuple[str, ...]:
        """Hosts with the maximum number of queued bundles."""
        return tuple(host for host, count in self._queue.sizes().items() if count >= _QUEUED * self._settings.pullers)

    def require_no_fault(self) -> None:
        """Raises `RuntimeError` if bundles fail by an error of this software; see `Repeated.require_no_fault`."""
        self._failing.require_no_fault()

    def close(self) -> None:
        """Stops transfers at the next chunk and removes their part files."""
        self._stop.set()
        for bundle in self._queue.close():
            bundle.abandon()
        for thread in self._threads:
            thread.join()

    def _run(self) -> None:
        while (taken := self._queue.take()) is not None:
            host, turn = taken
            started = time.monotonic()
            unfinished = self._serve(host, turn)
            if self._stop.is_set():
                unfinished = []
            self._end([bundle for bundle in turn if bundle not in unfinished])
            self._queue.give(host, time.monotonic() - started, unfinished)

    def _end(self, bundles: list[IncomingBundle]) -> None:
        for bundle in bundles:
            bundle.abandon()
        self._fetcher.forget(bundles)
        with self._guard:
            self._busy.difference_update(bundle.job.index for bundle in bundles)

    def _serve(self, host: str, turn: list[IncomingBundle]) -> list[IncomingBundle]:
        """Serves one turn; returns the bundles whose transfer continues in a later turn."""
        try:
            return [] if self._stop.is_set() else self._advance(host, turn)
        except Exception as error:  # noqa: BLE001 - the loop of a puller: logged; the worker announces the bundle again
            if len(turn) > 1:  # with a separate turn for each bundle, only the faulty bundle fails again
                log.debug("served_apart", host=host, bundles=len(turn), error=str(error))
                for bundle in turn:
                    bundle.restart()
                return turn
            self._note_failure(turn[0], error)
            return []

    def _advance(self, host: str, turn: list[IncomingBundle]) -> list[IncomingBundle]:
        wanted = self._fetcher.begin(turn)
        complete = self._fetcher.fetch(host, wanted)
        if complete:
            self._deliverer.deliver(complete)
        return [bundle for bundle in wanted if bundle.rest and not bundle.is_refused]

    def _note_archived(self) -> None:
        self._failing.succeed()
        self._on_archived()

    def _note_failure(self, bundle: IncomingBundle, error: Exception) -> None:
        if isinstance(error, FactoryError):
            self._meters.add(Meter.PULLS_FAILED)
        self._failing.fail(error, episode=bundle.name, worker=bundle.sid)
