"""Limits the number and size of requests that wait for the ledger, in total and per host. Queues no request."""

from __future__ import annotations

import threading
from collections import Counter

__all__ = ["Load"]

_HOST_SHARE = 8
"""Divisor of the total limits for the limits of one host, so that several busy hosts leave capacity for others."""


class Load:
    """Thread-safe counter of waiting requests.

    Args:
        requests: maximum number of waiting requests in total.
        octets: maximum size of waiting messages in total, bytes.
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
        """Adds a request; returns `False` if a limit is reached."""
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
        """Removes a request that was added."""
        with self._guard:
            self._requests[host] -= 1
            self._octets[host] -= octets
            self._all_requests -= 1
            self._all_octets -= octets
            if not self._requests[host]:
                del self._requests[host], self._octets[host]
