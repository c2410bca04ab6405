"""Validates transferred bundles, publishes them and records them in the ledger. Transfers nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import structlog

from coordinator.archive.contract import Archive
from coordinator.meters import Meter, Meters
from coordinator.protocol.pulls import BuildJob, Pull
from coordinator.transfer.contract import Delivery, LedgerClient
from coordinator.transfer.refusals import Refusals
from coordinator.transfer.spot_checks import Arrival, SpotCheckedValidation, ValidatedBundle
from schemas.errors import FactoryError, InvalidBundle
from schemas.job import episode_id

_VALIDATION_S = 120.0
"""Duration of the lease after a complete transfer, seconds; the worker is no longer needed."""

if TYPE_CHECKING:
    from coordinator.transfer.layouts import LayoutStore

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
