"""Counts events of a coordinator process that the ledger does not record. The counters start at zero per process."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from enum import StrEnum


class Meter(StrEnum):
    """Counter of a coordinator process."""

    CLAIMS = "claims"  # leased jobs
    ARCHIVED = "archived"  # episodes archived by this process
    PULLED_BYTES = "pulled_bytes"  # received bytes of bundles
    PULLS_FAILED = "pulls_failed"  # incomplete transfers; the next heartbeat announces the bundle again
    REFUSED = "refused"  # bundles that failed validation
    VALIDATIONS = "validations"
    VALIDATION_S = "validation_s"  # wall time of all validations, seconds
    EXPIRED = "expired"  # expired leases


class Meters:
    """Thread-safe set of counters."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._sums: Counter[Meter] = Counter()
        self._requests: Counter[str] = Counter()

    def add(self, meter: Meter, amount: float = 1) -> None:
        with self._guard:
            self._sums[meter] += amount  # type: ignore[assignment]

    def note_request(self, verb: str) -> None:
        """Counts a request with a known verb."""
        with self._guard:
            self._requests[verb] += 1

    def sums(self) -> Mapping[Meter, float]:
        with self._guard:
            return {meter: self._sums[meter] for meter in Meter}

    def requests(self) -> Mapping[str, int]:
        """Returns the number of requests by verb."""
        with self._guard:
            return dict(self._requests)
