"""Fetches announced bundles from workers into part files: one in chunks, or several small bundles in one request.

The module does not validate, publish or retry: the worker's next heartbeat announces a bundle again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import structlog

from coordinator.archive.contract import Archive
from coordinator.meters import Meter, Meters
from coordinator.protocol.bundles import BuildJob, IncomingBundle
from coordinator.settings import CoordinatorSettings
from coordinator.transfer.contract import FindLocalBundle, LedgerClient
from coordinator.transfer.refusals import Refusals
from schemas.bundle import MAX_BUNDLE_BYTES
from schemas.errors import TransientError
from schemas.protocol.keys import MAX_RANGES, BundleRange, Chunk
from schemas.protocol.messages import Lease

_TURN_S = 0.25
"""Time after which the turn of a bundle ends if bundles of other hosts wait, seconds."""
_FAILURES = 5
"""Number of failed transfers after which a bundle may be refused."""
_SMALL_BYTES = 64 << 10
"""Largest size of a bundle that is fetched together with others, bytes."""
# for small bundles, requests, commits and syncs take most of the time, not the bytes
_TOGETHER = 32
"""Largest number of bundles that are fetched, validated and recorded together."""
assert _TOGETHER <= MAX_RANGES

log = structlog.get_logger(__name__)

Fetch = Callable[[str, Sequence[BundleRange]], bytes]
"""Function that requests ranges of the bundles of a session, or raises `TransientError`."""


@dataclass
class _Failures:
    """Failed transfers of a bundle whose worker repeats the announcement."""

    lease: Lease
    """Lease of the bundle."""
    since: float
    """Monotonic time of the first failure, seconds."""
    count: int = 0
    """Number of failures."""
    most_bytes: int = 0
    """Size of the longest partial transfer, bytes."""


class Fetcher:
    """Thread-safe fetching of bundles.

    Args:
        archive: archive with the part files.
        ledger: ledger of the run.
        fetch: function that requests bytes from a worker.
        settings: settings of the coordinator.
        meters: counters of the coordinator.
        find_local_bundle: function that finds a bundle on this machine.
        refusals: reports bundles that their worker does not serve, or serves too slowly.
        has_others: function that takes a host and returns whether bundles of other hosts wait.
        stop: event that ends transfers at the next chunk.
    """

    def __init__(
        self,
        archive: Archive,
        ledger: LedgerClient,
        fetch: Fetch,
        settings: CoordinatorSettings,
        meters: Meters,
        find_local_bundle: FindLocalBundle,
        refusals: Refusals,
        has_others: Callable[[str], bool],
        stop: threading.Event,
    ) -> None:
        self._archive, self._ledger, self._fetch = archive, ledger, fetch
        self._settings, self._meters, self._find_local_bundle = settings, meters, find_local_bundle
        self._refusals, self._has_others, self._stop = refusals, has_others, stop
        self._guard = threading.Lock()
        self._rest: dict[int, int] = {}
        """Mapping of episode number to remaining bytes of its bundle."""
        self._failed: dict[int, _Failures] = {}
        """Mapping of episode number to the failed transfers of its bundle."""

    def joins(self, turn: Sequence[IncomingBundle], bundle: IncomingBundle) -> bool:
        """Returns whether a bundle can be fetched in one request with the bundles of a turn.

        All bundles must be small and belong to the same session of a worker.
        """
        size = sum(each.size for each in turn) + bundle.size
        return (
            len(turn) < _TOGETHER
            and size <= self._settings.chunk_bytes
            and turn[0].sid == bundle.sid
            and _is_small(turn[0])
            and _is_small(bundle)
        )

    def begin(self, turn: Sequence[IncomingBundle]) -> list[IncomingBundle]:
        """Opens part files for the bundles of a turn that are still needed, and returns these bundles.

        Raises:
            TransientError: there is too little free space, or the ledger is unavailable.
            WorldError: the disk is full or unavailable.
        """
        fresh = [bundle for bundle in turn if bundle.part is None]
        if not fresh:
            return list(turn)
        held = self._ledger.keep(fresh, self._settings.lease_ttl_s)
        wanted = [bundle for bundle, is_held in zip(fresh, held, strict=True) if is_held and self._wants(bundle)]
        if wanted:
            self._require_free_space(wanted)
        for bundle in wanted:
            bundle.part = self._archive.stage(bundle.job.index)
            self._link_local_bundle(bundle)
        return wanted

    def fetch(self, host: str, turn: Sequence[IncomingBundle]) -> list[IncomingBundle]:
        """Fetches the bundles of a turn; returns those that are complete.

        A bundle that is fetched alone may need several turns; until the last turn it is neither returned nor refused.

        Raises:
            TransientError: the worker does not serve the bundles, or the coordinator is closing.
            WorldError: the disk is full or unavailable.
        """
        missing = [bundle for bundle in turn if bundle.rest]
        if len(missing) > 1:
            self._fetch_together(missing)
        elif missing and self._fetch_in_chunks(host, missing[0]) and missing[0].rest:
            self._refuse_slow(missing[0])
        complete = [bundle for bundle in turn if not bundle.rest]
        self._forget_failures(complete)
        return complete

    def forget(self, bundles: Sequence[IncomingBundle]) -> None:
        """Frees the space that is reserved for bundles whose transfer has ended."""
        with self._guard:
            for bundle in bundles:
                self._rest.pop(bundle.job.index, None)

    def _wants(self, bundle: IncomingBundle) -> bool:
        if not self._prepare_destination(bundle.job.index):
            return False
        if bundle.size > MAX_BUNDLE_BYTES:
            self._refuse(bundle, f"{bundle.size} bytes announced, more than {MAX_BUNDLE_BYTES}")
            return False
        return True

    def _prepare_destination(self, index: int) -> bool:
        """Removes a file that an unfinished commit left at the episode's path; returns whether the path is free."""
        if not self._archive.path_of(index).exists():
            return True
        if self._ledger.is_recorded(index):
            return False
        self._archive.unpublish(index)
        return True

    def _require_free_space(self, bundles: Sequence[IncomingBundle]) -> None:
        with self._guard:
            size, to_come = sum(bundle.size for bundle in bundles), sum(self._rest.values())
            free, wanted = self._archive.free_bytes(), size + to_come + self._settings.reserve_bytes
            if free < wanted:
                raise TransientError(
                    f"{free} bytes are free, but {wanted} are required for the bundles, for {to_come} bytes of other "
                    "transfers and for the reserve: free some space"
                )
            self._rest.update((bundle.job.index, bundle.size) for bundle in bundles)

    def _link_local_bundle(self, bundle: IncomingBundle) -> None:
        """Makes the part file a hard link to the bundle, if possible, so the bundle need not be transferred."""
        # finds bundles in the spool of this run only: a path that comes over the network is not trusted
        try:
            source = self._find_local_bundle(bundle.lease)
            if source is not None and source.stat().st_size == bundle.size:
                bundle.open_part.link(source)
        except OSError as error:
            log.debug("fetched_instead", episode=bundle.name, error=str(error))

    def _fetch_together(self, bundles: Sequence[IncomingBundle]) -> None:
        """Fetches several bundles of one session in one request."""
        self._require_open()
        ranges = [_range_of(bundle, 0, bundle.size) for bundle in bundles]
        data = memoryview(self._fetch(bundles[0].sid, ranges))
        self._meters.add(Meter.PULLED_BYTES, len(data))
        for bundle in bundles:
            bundle.open_part.write(data[: bundle.size])
            data = data[bundle.size :]
        self.forget(bundles)

    def _fetch_in_chunks(self, host: str, bundle: IncomingBundle) -> bool:
        """Fetches chunks for one turn. Returns whether the transfer has ended, because it is complete or too slow."""
        part, started = bundle.open_part, time.monotonic()
        earlier_s = bundle.seconds
        while part.size < bundle.size:
            self._require_open()
            length = min(self._settings.chunk_bytes, bundle.rest)
            try:
                data = self._fetch(bundle.sid, [_range_of(bundle, part.size, length)])
            except TransientError:
                self._record_failure(bundle, part.size)
                raise
            self._meters.add(Meter.PULLED_BYTES, len(data))
            part.write(data)
            with self._guard:
                self._rest[bundle.job.index] = bundle.rest
            turn_s = time.monotonic() - started
            bundle.seconds = earlier_s + turn_s
            if bundle.seconds > self._settings.slow_start_s + part.size / self._settings.min_bytes_per_s:
                return True
            if turn_s > _TURN_S and bundle.rest and self._has_others(host):
                return False
        return True

    def _require_open(self) -> None:
        if self._stop.is_set():
            raise TransientError("the coordinator is closing; the bundle waits in its spool")

    def _record_failure(self, bundle: IncomingBundle, size: int) -> None:
        """Records a failed transfer. After several failures below the least transfer rate, refuses the bundle."""
        now = time.monotonic()
        with self._guard:
            failures = self._failed.get(bundle.job.index)
            if failures is None or failures.lease != bundle.lease:
                failures = self._failed[bundle.job.index] = _Failures(bundle.lease, now)
            failures.count += 1
            failures.most_bytes = max(failures.most_bytes, size)
        limit_s = self._settings.slow_start_s + failures.most_bytes / self._settings.min_bytes_per_s
        if failures.count >= _FAILURES and now - failures.since > limit_s:
            self._refuse(
                bundle,
                f"not served: {failures.most_bytes} of {bundle.size} bytes in {failures.count} transfers over "
                f"{now - failures.since:.0f} s, while its worker was alive",
            )

    def _refuse_slow(self, bundle: IncomingBundle) -> None:
        bundle.is_refused = True
        self._refuse(
            bundle,
            f"too slow: {bundle.open_part.size} of {bundle.size} bytes in {bundle.seconds:.0f} s; a worker "
            f"has to serve {self._settings.min_bytes_per_s:.0f} bytes per second",
        )

    def _refuse(self, bundle: IncomingBundle, detail: str) -> None:
        self._forget_failures([bundle])
        self._refusals.refuse(bundle, detail)

    def _forget_failures(self, bundles: Sequence[IncomingBundle]) -> None:
        with self._guard:
            for bundle in bundles:
                self._failed.pop(bundle.job.index, None)


def _is_small(bundle: IncomingBundle) -> bool:
    is_first_turn = bundle.part is None and not bundle.is_alone
    return is_first_turn and bundle.size <= _SMALL_BYTES and not isinstance(bundle.job, BuildJob)


def _range_of(bundle: IncomingBundle, offset: int, length: int) -> BundleRange:
    return BundleRange(bundle.lease.job_id, bundle.lease.fence, Chunk(offset, length))
