"""What a coordinator counts while it runs and the ledger does not hold; from zero with each process. Counts only."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from enum import StrEnum

__all__ = ["Meter", "Meters"]


class Meter(StrEnum):
    """What is counted."""

    CLAIMS = "claims"  # jobs given out
    ARCHIVED = "archived"  # episodes archived here
    PULLED_BYTES = "pulled_bytes"  # of bundles, as they came
    PULLS_FAILED = "pulls_failed"  # bundles that did not come whole; the next beat announces them again
    REFUSED = "refused"  # bundles that validation refused
    VALIDATIONS = "validations"
    VALIDATION_S = "validation_s"  # wall time of all validations, seconds
    EXPIRED = "expired"  # leases that ran out


class Meters:
    """A handful of sums, safe to add to from any thread."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._sums: Counter[Meter] = Counter()
        self._requests: Counter[str] = Counter()

    def add(self, meter: Meter, amount: float = 1) -> None:
        """Adds to a sum."""
        with self._guard:
            self._sums[meter] += amount  # type: ignore[assignment]

    def note_request(self, verb: str) -> None:
        """Counts a question that came in under a known verb."""
        with self._guard:
            self._requests[verb] += 1

    def sums(self) -> Mapping[Meter, float]:
        """Returns every sum."""
        with self._guard:
            return {meter: self._sums[meter] for meter in Meter}

    def requests(self) -> Mapping[str, int]:
        """Returns the questions by verb."""
        with self._guard:
            return dict(self._requests)
