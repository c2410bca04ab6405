"""Validates transferred bundles completely, or without their frames if their worker has validated them.

A spot check validates such a bundle completely. A worker cannot predict which of its bundles are checked: the draw
depends on a secret of this process and on the announced digest. Does not transfer, publish or refuse bundles.
"""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Sequence
from typing import NamedTuple

from coordinator.archive.contract import Staged
from coordinator.meters import Meter, Meters
from coordinator.protocol.pulls import BuildJob, Pull
from coordinator.transfer.contract import BundleValidator
from coordinator.validation.bundle_file import BundleFile
from coordinator.validation.scope import Scope
from schemas.dataset.rows import BundleReceipt
from schemas.errors import InvalidBundle
from schemas.protocol.keys import host_of


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
