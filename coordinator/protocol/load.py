"""How many requests, and how many bytes of them, wait for the ledger: in all, and of one host. Counts only."""

from __future__ import annotations

import threading
from collections import Counter

__all__ = ["Load"]

_HOST_SHARE = 8
"""A host may have this fraction of what may wait in all, so that several busy hosts leave room for others."""


class Load:
    """What waits now; safe to use from any thread.

    Args:
        requests: that may wait in all.
        octets: bytes of messages that may wait in all.
    """

    def __init__(self, requests: int, octets: int) -> None:
        self._most = (requests, octets)
        self._host_most = (max(1, requests // _HOST_SHARE), octets // _HOST_SHARE)
        self._guard = threading.Lock()
        self._requests: Counter[str] = Counter()
        self._octets: Counter[str] = Counter()
        self._all_octets = 0
        self._all_requests = 0

    def enter(self, host: str, octets: int) -> bool:
        """Counts a request in; returns whether there was room for it."""
        with self._guard:
            if self._all_requests >= self._most[0] or self._all_octets + octets > self._most[1]:
                return False
            if self._requests[host] >= self._host_most[0] or self._octets[host] + octets > self._host_most[1]:
                return False
            self._requests[host] += 1
            self._octets[host] += octets
            self._all_requests += 1
            self._all_octets += octets
            return True

    def leave(self, host: str, octets: int) -> None:
        """Counts a request out that was counted in."""
        with self._guard:
            self._requests[host] -= 1
            self._octets[host] -= octets
            self._all_requests -= 1
            self._all_octets -= octets
            if not self._requests[host]:
                del self._requests[host], self._octets[host]
