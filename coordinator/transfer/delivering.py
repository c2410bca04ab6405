"""Validates transferred bundles, publishes them and records them in the ledger. Transfers nothing.

A bundle that its worker has validated is validated without its frames, except in a spot check. A worker cannot predict
which of its bundles are checked: the draw depends on a secret of this process and on the announced digest.
"""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import structlog

from coordinator.archive.contract import Archive, Staged
from coordinator.meters import Meter, Meters
from coordinator.protocol.bundles import BuildJob, BundleFile, Pull, Scope
from coordinator.transfer.contract import BundleValidator, Delivery, LedgerClient
from coordinator.transfer.refusals import Refusals
from schemas.dataset.rows import BundleReceipt
from schemas.errors import FactoryError, InvalidBundle
from schemas.job import episode_id
from schemas.protocol.keys import host_of

if TYPE_CHECKING:
    from coordinator.transfer.layouts import LayoutStore


class Arrival(NamedTuple):
    """Announced bundle whose file has been transferred or linked."""

    pull: Pull
    """Announced bundle."""
    staged: Staged
    """Complete part file."""


class ValidatedBundle(NamedTuple):
    """Result of the validation of a bundle without violations."""

    receipt: BundleReceipt
    """Row of the episode."""
    is_checked: bool
    """Whether the frames were validated here; `False` if only the worker has validated them."""


class SpotCheckedValidation:
    """Thread-safe validation of bundles, complete or with spot checks.

    A host's first bundle is always validated completely. After an invalid bundle, all bundles of the host are
    validated completely.

    Args:
        checker: validator of bundles.
        meters: counters of the coordinator.
        share: share of the bundles that are validated completely although their worker has validated them, 0 to 1.
            `None` validates all bundles completely.
        secret: key of the draw; by default new random bytes.
    """

    def __init__(self, checker: BundleValidator, meters: Meters, share: float | None, secret: bytes = b"") -> None:
        self._checker, self._meters, self._share = checker, meters, share
        self._secret = secret or secrets.token_bytes(32)
        self._is_trusted: dict[str, bool] = {}
        """Whether bundles of a host may be validated without their frames, by host: `True` after a bundle that was
        validated completely and is valid, always `False` after an invalid bundle. Other hosts have no entry."""

    def validate(self, arrivals: Sequence[Arrival]) -> list[ValidatedBundle | InvalidBundle]:
        """Validates bundles; returns the result or the violations of each.

        Raises:
            TransientError: the bundles cannot be validated now.
        """
        files, started = [self._file_of(arrival) for arrival in arrivals], time.monotonic()
        receipts = self._checker.check_all(files)
        self._meters.add(Meter.VALIDATIONS, len(files))
        self._meters.add(Meter.VALIDATION_S, time.monotonic() - started)
        return [
            self._result_of(pull, file.scope, receipt)
            for (pull, _), file, receipt in zip(arrivals, files, receipts, strict=True)
        ]

    def _file_of(self, arrival: Arrival) -> BundleFile:
        pull, staged = arrival
        if isinstance(pull.job, BuildJob):
            raise TypeError(f"{pull.name} is the package of a layout")
        scope = Scope.SAMPLE if staged.is_linked else self._scope(pull)
        return BundleFile(staged.path, pull.job, pull.candidates, scope, None if staged.is_linked else staged.sha256)

    def _result_of(
        self, pull: Pull, scope: Scope, receipt: BundleReceipt | InvalidBundle
    ) -> ValidatedBundle | InvalidBundle:
        host = host_of(pull.sid)
        if isinstance(receipt, InvalidBundle):
            self._is_trusted[host] = False
            return receipt
        if pull.is_validated and scope is Scope.ALL:
            self._is_trusted.setdefault(host, True)
        return ValidatedBundle(receipt, scope is not Scope.CLAIM)

    def _scope(self, pull: Pull) -> Scope:
        trusts = self._share is not None and pull.is_validated and self._is_trusted.get(host_of(pull.sid), False)
        return Scope.CLAIM if trusts and not self._is_drawn(pull) else Scope.ALL

    def _is_drawn(self, pull: Pull) -> bool:
        text = f"{pull.lease.job_id} {pull.lease.fence} {pull.sha256}"
        drawn = int.from_bytes(hmac.digest(self._secret, text.encode(), "sha256")[:8], "big")
        return drawn < (self._share or 0.0) * 2**64


_VALIDATION_S = 120.0
"""Duration of the lease after a complete transfer, seconds; the worker is no longer needed."""


log = structlog.get_logger(__name__)


class Deliverer:
    """Thread-safe delivery of transferred bundles to archive and ledger.

    Args:
        archive: archive with the part files.
        ledger: ledger of the run.
        validation: validation of bundles.
        refusals: reports invalid bundles.
        meters: counters of the coordinator.
        on_archived: callback after an episode was archived.
        on_failure: callback with a bundle that was not published, and the error.
        layouts: store of built layouts; `None` if the run builds none.
    """

    def __init__(
        self,
        archive: Archive,
        ledger: LedgerClient,
        validation: SpotCheckedValidation,
        refusals: Refusals,
        meters: Meters,
        on_archived: Callable[[], None],
        on_failure: Callable[[Pull, FactoryError], None],
        layouts: LayoutStore | None,
    ) -> None:
        self._archive, self._ledger, self._validation = archive, ledger, validation
        self._refusals, self._meters, self._layouts = refusals, meters, layouts
        self._on_archived, self._on_failure = on_archived, on_failure

    def deliver(self, arrivals: Sequence[Arrival]) -> None:
        """Validates, publishes and records bundles as a group; refuses invalid bundles.

        Raises:
            TransientError: the bundles cannot be validated or recorded now.
            WorldError: the disk is full or unavailable.
        """
        whole = [arrival for arrival in arrivals if self._is_whole(arrival)]
        if not whole:
            return
        self._ledger.keep([arrival.pull for arrival in whole], _VALIDATION_S)
        episodes = [arrival for arrival in whole if not self._store_layout(arrival)]
        if episodes:
            self._publish(list(self._valid(episodes)))

    def _is_whole(self, arrival: Arrival) -> bool:
        """Returns whether the file has the announced digest; refuses the bundle if not.

        A linked file is accepted, because the digest that the validator computes is compared later.
        """
        pull, staged = arrival
        return staged.is_linked or self._is_announced(pull, staged.sha256)

    def _is_announced(self, pull: Pull, sha256: str) -> bool:
        """Returns whether the digest of a bundle is the announced digest; refuses the bundle if not."""
        if sha256 != pull.sha256:
            self._refusals.refuse(pull, f"SHA-256 {sha256} arrived, {pull.sha256} was announced")
        return sha256 == pull.sha256

    def _store_layout(self, arrival: Arrival) -> bool:
        """Stores or refuses the package of a layout; returns `False` if the bundle is an episode."""
        pull, staged = arrival
        if not isinstance(pull.job, BuildJob):
            return False
        if self._layouts is None:
            raise TypeError(f"no store for the package of {pull.job.layout}")
        try:
            self._layouts.receive(pull, pull.job, staged)
        except InvalidBundle as error:
            self._refusals.refuse(pull, str(error))
        return True

    def _valid(self, arrivals: Sequence[Arrival]) -> Iterator[tuple[Arrival, ValidatedBundle]]:
        """Validates episodes and yields the valid ones; the others are refused."""
        for arrival, result in zip(arrivals, self._validation.validate(arrivals), strict=True):
            pull, staged = arrival
            if isinstance(result, InvalidBundle):
                self._refusals.refuse(pull, str(result), is_false=pull.is_validated)
            elif not staged.is_linked or self._is_announced(pull, result.receipt.file_sha256):
                yield arrival, result

    def _publish(self, valid: Sequence[tuple[Arrival, ValidatedBundle]]) -> None:
        failed = self._archive.publish_all({pull.job.index: staged for (pull, staged), _ in valid})
        deliveries = []
        for (pull, _), (receipt, is_checked) in valid:
            if pull.job.index in failed:
                self._on_failure(pull, failed[pull.job.index])
            else:
                deliveries.append(Delivery(pull, receipt, is_checked))
        if deliveries:
            for delivery, is_owned in zip(deliveries, self._ledger.own(deliveries), strict=True):
                self._conclude(delivery, is_owned=is_owned)

    def _conclude(self, delivery: Delivery, *, is_owned: bool) -> None:
        index = delivery.pull.job.index
        if not is_owned:  # the lease was lost meanwhile, and no other worker delivered the episode
            self._archive.unpublish(index)
            return
        self._meters.add(Meter.ARCHIVED)
        log.info("archived", episode=episode_id(index), worker=delivery.pull.sid, steps=delivery.receipt.num_steps)
        self._on_archived()
