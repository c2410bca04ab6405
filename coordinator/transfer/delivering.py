"""Validates transferred bundles, publishes them and records them in the ledger. Transfers nothing.

A bundle that its worker has validated is validated without its frames, except in a spot check. A worker cannot predict
which of its bundles are checked: the draw depends on a secret of this process and on the announced digest.

Design: docs/design/protocol.md#spot-checks.
"""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import structlog

from coordinator.archive.contract import Archive
from coordinator.meters import Meter, Meters
from coordinator.protocol.bundles import BuildJob, IncomingBundle
from coordinator.transfer.contract import BundleValidator, LedgerClient, ValidatedBundle
from coordinator.transfer.refusals import Refusals
from coordinator.validation.messages import Scope, ValidationTask
from schemas.dataset.rows import BundleReceipt
from schemas.errors import FactoryError, InvalidBundle
from schemas.job import episode_id
from schemas.protocol.keys import host_of

if TYPE_CHECKING:
    from coordinator.transfer.layouts import LayoutStore


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

    def validate(self, bundles: Sequence[IncomingBundle]) -> list[ValidatedBundle | InvalidBundle]:
        """Validates complete bundles; returns the result or the violations of each.

        Raises:
            TransientError: the bundles cannot be validated now.
        """
        tasks, started = [self._task_of(bundle) for bundle in bundles], time.monotonic()
        receipts = self._checker.check_all(
            [(bundle.open_part.path, task) for bundle, task in zip(bundles, tasks, strict=True)]
        )
        self._meters.add(Meter.VALIDATIONS, len(bundles))
        self._meters.add(Meter.VALIDATION_S, time.monotonic() - started)
        return [
            self._result_of(bundle, task.scope, receipt)
            for bundle, task, receipt in zip(bundles, tasks, receipts, strict=True)
        ]

    def _task_of(self, bundle: IncomingBundle) -> ValidationTask:
        if isinstance(bundle.job, BuildJob):
            raise TypeError(f"{bundle.name} is the package of a layout")
        is_linked = bundle.open_part.is_linked
        return ValidationTask(
            job=bundle.job,
            candidates=bundle.candidates,
            scope=Scope.SAMPLE if is_linked else self._scope(bundle),
            sha256=None if is_linked else bundle.open_part.sha256,
        )

    def _result_of(
        self, bundle: IncomingBundle, scope: Scope, receipt: BundleReceipt | InvalidBundle
    ) -> ValidatedBundle | InvalidBundle:
        host = host_of(bundle.sid)
        if isinstance(receipt, InvalidBundle):
            self._is_trusted[host] = False
            return receipt
        if bundle.is_validated and scope is Scope.ALL:
            self._is_trusted.setdefault(host, True)
        return ValidatedBundle(bundle, receipt, scope is not Scope.CLAIM)

    def _scope(self, bundle: IncomingBundle) -> Scope:
        trusts = self._share is not None and bundle.is_validated and self._is_trusted.get(host_of(bundle.sid), False)
        return Scope.CLAIM if trusts and not self._is_drawn(bundle) else Scope.ALL

    def _is_drawn(self, bundle: IncomingBundle) -> bool:
        text = f"{bundle.lease.job_id} {bundle.lease.fence} {bundle.sha256}"
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
        on_failure: Callable[[IncomingBundle, FactoryError], None],
        layouts: LayoutStore | None,
    ) -> None:
        self._archive, self._ledger, self._validation = archive, ledger, validation
        self._refusals, self._meters, self._layouts = refusals, meters, layouts
        self._on_archived, self._on_failure = on_archived, on_failure

    def deliver(self, bundles: Sequence[IncomingBundle]) -> None:
        """Validates, publishes and records complete bundles as a group; refuses invalid bundles.

        Raises:
            TransientError: the bundles cannot be validated or recorded now.
            WorldError: the disk is full or unavailable.
        """
        whole = [bundle for bundle in bundles if self._is_whole(bundle)]
        if not whole:
            return
        self._ledger.keep(whole, _VALIDATION_S)
        episodes = [bundle for bundle in whole if not self._store_layout(bundle)]
        if episodes:
            self._publish(list(self._valid(episodes)))

    def _is_whole(self, bundle: IncomingBundle) -> bool:
        """Returns whether the file has the announced digest; refuses the bundle if not.

        A linked file is accepted, because the digest that the validator computes is compared later.
        """
        return bundle.open_part.is_linked or self._is_announced(bundle, bundle.open_part.sha256)

    def _is_announced(self, bundle: IncomingBundle, sha256: str) -> bool:
        """Returns whether the digest of a bundle is the announced digest; refuses the bundle if not."""
        if sha256 != bundle.sha256:
            self._refusals.refuse(bundle, f"SHA-256 {sha256} arrived, {bundle.sha256} was announced")
        return sha256 == bundle.sha256

    def _store_layout(self, bundle: IncomingBundle) -> bool:
        """Stores or refuses the package of a layout; returns `False` if the bundle is an episode."""
        if not isinstance(bundle.job, BuildJob):
            return False
        if self._layouts is None:
            raise TypeError(f"no store for the package of {bundle.job.layout}")
        try:
            self._layouts.receive(bundle, bundle.job)
        except InvalidBundle as error:
            self._refusals.refuse(bundle, str(error))
        return True

    def _valid(self, bundles: Sequence[IncomingBundle]) -> Iterator[ValidatedBundle]:
        """Validates episodes and yields the valid ones; the others are refused."""
        for bundle, result in zip(bundles, self._validation.validate(bundles), strict=True):
            if isinstance(result, InvalidBundle):
                self._refusals.refuse(bundle, str(result), is_false=bundle.is_validated)
            elif not bundle.open_part.is_linked or self._is_announced(bundle, result.receipt.file_sha256):
                yield result

    def _publish(self, valid: Sequence[ValidatedBundle]) -> None:
        failed = self._archive.publish_all({bundle.job.index: bundle.open_part for bundle, _, _ in valid})
        published = []
        for validated in valid:
            bundle = validated.bundle
            if bundle.job.index in failed:
                self._on_failure(bundle, failed[bundle.job.index])
            else:
                published.append(validated)
        if published:
            for validated, is_recorded in zip(published, self._ledger.record_archived(published), strict=True):
                self._conclude(validated, is_recorded=is_recorded)

    def _conclude(self, validated: ValidatedBundle, *, is_recorded: bool) -> None:
        index = validated.bundle.job.index
        if not is_recorded:  # the lease was lost meanwhile, and no other worker delivered the episode
            self._archive.unpublish(index)
            return
        self._meters.add(Meter.ARCHIVED)
        worker, steps = validated.bundle.sid, validated.receipt.num_steps
        log.info("archived", episode=episode_id(index), worker=worker, steps=steps)
        self._on_archived()
