"""Interfaces of a transfer: the validator of bundles, the ledger, and the search for bundles on this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from coordinator.protocol.bundles import IncomingBundle
from coordinator.validation.messages import Scope, ValidationTask
from schemas.dataset.rows import BundleReceipt, EpisodeSummary
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.protocol.messages import Lease
from schemas.scene import Target

FindLocalBundle = Callable[[Lease], Path | None]
"""Function that returns the path of a lease's bundle on this machine, or `None` if unknown."""


def no_local_bundle(_lease: Lease) -> None:
    """Returns `None`: every bundle is transferred over the network."""


class BundleValidator(Protocol):
    """Interface of thread-safe bundle validators."""

    def check(
        self, path: Path, job: Job, candidates: tuple[Target, ...] = (), scope: Scope = Scope.ALL
    ) -> BundleReceipt:
        """Validates the part `scope` of a bundle, or raises `InvalidBundle` or `TransientError`."""

    def check_all(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> Sequence[BundleReceipt | InvalidBundle]:
        """Validates several bundles; returns a row or the violations of each, or raises `TransientError`."""

    def close(self) -> None:
        """Ends the validator; a running check raises `TransientError`."""


class EpisodeValidator(BundleValidator, Protocol):
    """Interface of validators of collected episodes."""

    def check(
        self, path: Path, job: Job, candidates: tuple[Target, ...] = (), scope: Scope = Scope.ALL
    ) -> EpisodeSummary:
        """Validates a bundle and returns the episode's row, or raises `InvalidBundle` or `TransientError`."""


class ValidatedBundle(NamedTuple):
    """Bundle without violations, to be published and recorded."""

    bundle: IncomingBundle
    """Bundle of an episode."""
    receipt: BundleReceipt
    """Facts of the bundle that the ledger records."""
    is_checked: bool
    """Whether the frames were validated here; `False` if only the worker has validated them."""


class LedgerClient(Protocol):
    """Interface of the ledger for pullers: local in a coordinator, remote in a gateway.

    All methods except `refuse` are idempotent. All methods raise `TransientError` if the ledger is unavailable.
    """

    def keep(self, bundles: Sequence[IncomingBundle], seconds: float) -> Sequence[bool]:
        """Extends each lease to at least `seconds` from now; returns for each lease whether it is in force."""

    def is_recorded(self, index: int) -> bool:
        """Returns whether the ledger records the stored episode, so its file must not be deleted."""

    def record_archived(self, bundles: Sequence[ValidatedBundle]) -> Sequence[bool]:
        """Records published episodes whose leases are in force; returns for each whether its file is recorded."""

    def refuse(self, bundle: IncomingBundle, detail: str, *, is_false: bool = False) -> None:
        """Reports a bundle that failed validation.

        Args:
            bundle: bundle.
            detail: reason.
            is_false: whether the worker has announced the bundle as valid, so its host is barred.
        """
