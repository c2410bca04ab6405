"""Transfers announced bundles in chunks, validates and publishes them, and records them in the ledger.

The module does not retry a failed transfer: the worker's next heartbeat announces the bundle again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import structlog

from coordinator.archive.contract import Archive, Staged
from coordinator.meters import Meter, Meters
from coordinator.protocol.pulls import BuildJob, Pull
from coordinator.settings import CoordinatorSettings
from coordinator.transfer.contract import BundleValidator, FindLocalBundle, LedgerClient, no_local_bundle
from coordinator.transfer.fair_queue import FairQueue
from coordinator.transfer.spot_checks import SpotCheckedValidation, ValidatedBundle
from schemas.bundle import MAX_BUNDLE_BYTES
from schemas.errors import FactoryError, InvalidBundle, TransientError
from schemas.job import episode_id
from schemas.protocol.keys import Chunk, host_of
from schemas.protocol.messages import Lease
from schemas.support.closing import Closing
from schemas.support.log_limit import LogLimit, Repeated

_VALIDATION_S = 120.0
"""Duration of the lease after a complete transfer, seconds; the worker is no longer needed."""
_TURN_S = 0.25
"""Duration of a turn of one bundle while others wait, seconds."""
_FAILURES = 5
"""Number of failed transfers after which a bundle may be refused."""
_QUEUED = 2
"""Maximum number of bundles of one host per puller of a gateway, including the current one."""

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 60.0
"""First and longest pause between two log lines about refused bundles of one host, seconds."""

if TYPE_CHECKING:
    from coordinator.transfer.layouts import LayoutStore

log = structlog.get_logger(__name__)

Fetch = Callable[[str, Lease, Chunk], bytes]


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


@dataclass
class _Transfer:
    """Transfer of a bundle, which may take several turns."""

    pull: Pull
    """Announced bundle."""
    staged: Staged | None = None
    """Part file; `None` before the first turn."""
    seconds: float = 0.0
    """Transfer time so far, seconds."""

    @property
    def open_file(self) -> Staged:
        assert self.staged is not None
        return self.staged

    def abandon(self) -> None:
        """Deletes the part file unless it is published."""
        if self.staged is not None:
            self.staged.abandon()


class Pullers(Closing):
    """Pool of threads that transfer bundles, one per episode at a time; a context manager.

    Hosts take turns, so that slow hosts do not delay the others.
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
        self._archive = archive
        self._ledger = ledger
        self._fetch = fetch
        self._find_local_bundle = find_local_bundle
        self._layouts = layouts
        self._settings = settings
        self._on_archived = on_archived
        self._meters = meters or Meters()
        self._validation = SpotCheckedValidation(checker, self._meters, settings.spot_checks)
        self._queue: FairQueue[_Transfer] = FairQueue()
        self._failing = Repeated(log, "pull_failed")
        self._limit = LogLimit(_FIRST_PAUSE_S, _LONGEST_PAUSE_S)
        self._busy: dict[int, int] = {}
        """Mapping of episode number to remaining bytes of its bundle."""
        self._failed: dict[int, _Failures] = {}
        """Mapping of episode number to the failed transfers of its bundle."""
        self._guard = threading.Lock()
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self._run, name=f"puller-{number}") for number in range(settings.pullers)
        ]
        for thread in self._threads:
            thread.start()

    def offer(self, pull: Pull) -> None:
        """Queues a bundle unless its episode is queued or in transfer; the next heartbeat repeats the announcement."""
        with self._guard:
            if pull.job.index in self._busy or self._stop.is_set():
                return
            self._busy[pull.job.index] = 0
        self._queue.put(host_of(pull.sid), _Transfer(pull))

    @property
    def waiting(self) -> int:
        """Number of bundles that are queued or in transfer."""
        with self._guard:
            return len(self._busy)

    @property
    def busy_hosts(self) -> tuple[str, ...]:
        """Hosts with the maximum number of queued bundles."""
        return tuple(host for host, count in self._queue.sizes().items() if count >= _QUEUED * self._settings.pullers)

    def close(self) -> None:
        """Stops transfers at the next chunk and removes their part files."""
        self._stop.set()
        for transfer in self._queue.close():
            transfer.abandon()
        for thread in self._threads:
            thread.join()

    def _run(self) -> None:
        while (taken := self._queue.take()) is not None:
            host, transfer = taken
            begun = time.monotonic()
            is_over = self._serve(host, transfer) or self._stop.is_set()
            if is_over:
                transfer.abandon()
                with self._guard:
                    self._busy.pop(transfer.pull.job.index, None)
            self._queue.give(host, time.monotonic() - begun, None if is_over else transfer)

    def _serve(self, host: str, transfer: _Transfer) -> bool:
        """Continues a transfer for one turn; returns whether it has ended, successfully or not."""
        pull = transfer.pull
        try:
            return self._stop.is_set() or self._advance(host, transfer)
        except Exception as error:  # noqa: BLE001 - the loop of a puller: logged, and announced again by the next heartbeat
            if isinstance(error, FactoryError):
                self._meters.add(Meter.PULLS_FAILED)
            self._failing.fail(error, episode=pull.name, worker=pull.sid)
        return True

    def _advance(self, host: str, transfer: _Transfer) -> bool:
        pull = transfer.pull
        if transfer.staged is None and not self._begin(transfer):
            return True
        if not self._transfer(host, transfer):
            return False
        staged = transfer.open_file
        if staged.size < pull.size:
            self._refuse(
                pull,
                f"too slow: {staged.size} of {pull.size} bytes in {transfer.seconds:.0f} s; a worker has to serve "
                f"{self._settings.min_bytes_per_s:.0f} bytes per second",
            )
        elif not staged.is_linked and self._is_another(pull, staged.sha256):
            return True
        else:
            self._ledger.keep(pull, _VALIDATION_S)
            if isinstance(pull.job, BuildJob):
                self._receive_layout(pull, pull.job, staged)
                return True
            bundle = self._validate(pull, staged)
            if bundle is not None and not (staged.is_linked and self._is_another(pull, bundle.receipt.file_sha256)):
                self._publish(pull, staged, bundle)
        return True

    def _is_another(self, pull: Pull, sha256: str) -> bool:
        """Returns whether a bundle differs from the announced one, and refuses it if so."""
        if sha256 != pull.sha256:
            self._refuse(pull, f"SHA-256 {sha256} arrived, {pull.sha256} was announced")
        return sha256 != pull.sha256

    def _begin(self, transfer: _Transfer) -> bool:
        """Opens the part file of a bundle; returns `False` if the bundle is not needed."""
        pull = transfer.pull
        if not self._ledger.keep(pull, self._settings.lease_ttl_s) or not self._prepare_destination(pull.job.index):
            return False
        if pull.size > MAX_BUNDLE_BYTES:
            self._refuse(pull, f"{pull.size} bytes announced, more than {MAX_BUNDLE_BYTES}")
            return False
        self._require_free_space(pull)
        transfer.staged = self._archive.stage(pull.job.index)
        self._link_local_bundle(pull, transfer.staged)
        return True

    def _prepare_destination(self, index: int) -> bool:
        """Removes a file that an unfinished commit left at the episode's path; returns whether the path is free."""
        if not self._archive.path_of(index).exists():
            return True
        if self._ledger.is_owned(index):
            return False
        self._archive.unpublish(index)
        return True

    def _require_free_space(self, pull: Pull) -> None:
        with self._guard:
            to_come = sum(self._busy.values())
            free, wanted = self._archive.free_bytes(), pull.size + to_come + self._settings.reserve_bytes
            if free < wanted:
                raise TransientError(
                    f"{free} bytes free, {wanted} required for the bundle, {to_come} bytes of other transfers and the "
                    "reserve: free some space"
                )
            self._busy[pull.job.index] = pull.size

    def _transfer(self, host: str, transfer: _Transfer) -> bool:
        """Transfers chunks for one turn; returns whether the transfer has ended: it is complete or too slow."""
        pull, staged, begun = transfer.pull, transfer.open_file, time.monotonic()
        earlier_s = transfer.seconds
        while staged.size < pull.size:
            if self._stop.is_set():
                raise TransientError("the coordinator is closing; the bundle waits in its spool")
            length = min(self._settings.chunk_bytes, pull.size - staged.size)
            try:
                data = self._fetch(pull.sid, pull.lease, Chunk(staged.size, length))
            except TransientError:
                self._record_failure(pull, staged.size)
                raise
            self._meters.add(Meter.PULLED_BYTES, len(data))
            staged.write(data)
            with self._guard:
                self._busy[pull.job.index] = pull.size - staged.size
            turn_s = time.monotonic() - begun
            transfer.seconds = earlier_s + turn_s
            if transfer.seconds > self._settings.slow_start_s + staged.size / self._settings.min_bytes_per_s:
                return True
            if turn_s > _TURN_S and staged.size < pull.size and self._queue.has_others(host):
                return False
        return True

    def _record_failure(self, pull: Pull, size: int) -> None:
        """Records a failed transfer; refuses the bundle if repeated transfers fall below the least rate."""
        now = time.monotonic()
        with self._guard:
            failures = self._failed.get(pull.job.index)
            if failures is None or failures.lease != pull.lease:
                failures = self._failed[pull.job.index] = _Failures(pull.lease, now)
            failures.count += 1
            failures.most_bytes = max(failures.most_bytes, size)
        limit_s = self._settings.slow_start_s + failures.most_bytes / self._settings.min_bytes_per_s
        if failures.count >= _FAILURES and now - failures.since > limit_s:
            self._refuse(
                pull,
                f"not served: {failures.most_bytes} of {pull.size} bytes in {failures.count} transfers over "
                f"{now - failures.since:.0f} s, while its worker was alive",
            )

    def _link_local_bundle(self, pull: Pull, staged: Staged) -> None:
        """Links a bundle on the archive's disk instead of transferring and copying it."""
        try:
            source = self._find_local_bundle(pull.lease)
            if source is not None and source.stat().st_size == pull.size:
                staged.link(source)
        except OSError as error:
            log.debug("fetched_instead", episode=pull.name, error=str(error))

    def _receive_layout(self, pull: Pull, build: BuildJob, staged: Staged) -> None:
        if self._layouts is None:
            raise TypeError(f"no store for the package of {build.layout}")
        try:
            self._layouts.receive(pull, build, staged)
        except InvalidBundle as error:
            self._refuse(pull, str(error))

    def _validate(self, pull: Pull, staged: Staged) -> ValidatedBundle | None:
        try:
            return self._validation.validate(pull, staged.path, is_local=staged.is_linked)
        except InvalidBundle as error:
            self._refuse(pull, str(error), is_false=pull.is_validated)
            return None

    def _refuse(self, pull: Pull, detail: str, *, is_false: bool = False) -> None:
        self._forget_failures(pull)
        self._meters.add(Meter.REFUSED)
        episode, host = pull.name, host_of(pull.sid)
        self._limit.write(log.warning, "bundle_refused", host, episode=episode, worker=pull.sid, detail=detail)
        self._ledger.refuse(pull, detail, is_false=is_false)

    def _forget_failures(self, pull: Pull) -> None:
        with self._guard:
            self._failed.pop(pull.job.index, None)

    def _publish(self, pull: Pull, staged: Staged, bundle: ValidatedBundle) -> None:
        index = pull.job.index
        self._forget_failures(pull)
        self._archive.publish(staged, index)
        if self._ledger.own(pull, bundle.receipt, is_checked=bundle.is_checked):
            self._meters.add(Meter.ARCHIVED)
            self._failing.succeed()
            log.info("archived", episode=episode_id(index), worker=pull.sid, steps=bundle.receipt.num_steps)
            self._on_archived()
        else:
            self._archive.unpublish(index)  # the lease was lost meanwhile, and no other worker delivered the episode
