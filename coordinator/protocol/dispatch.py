"""Who pulls an announced bundle: the gateway that its worker is connected to, else the coordinator itself.

Keeps orders until their gateway fetches them, and nothing durable: what is forgotten, the next beat announces again.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping

from coordinator.protocol.protocol import Pull
from schemas.keys import host_of

__all__ = ["Dispatch"]

_OF_ONE_HOST = 4
"""Orders of one host that a gateway is given at a time."""
_MOST_GATEWAYS = 1000
"""Gateways that are known at a time; the one that was silent longest is forgotten."""
_SILENT_S = 10.0
"""Silence after which another gateway may name the same router; a gateway asks four times a second."""


class Dispatch:
    """Orders by gateway; safe to use from any thread.

    Args:
        pull_here: takes a bundle whose worker is connected to no gateway that has been heard of.
        clock: monotonic seconds.
    """

    def __init__(self, pull_here: Callable[[Pull], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._pull_here = pull_here
        self._clock = clock
        self._guard = threading.Lock()
        self._gateways: dict[str, str] = {}
        """Zenoh's id of a router -> name of the gateway."""
        self._orders: dict[str, dict[int, Pull]] = {}
        """Gateway -> episode -> what to pull."""
        self._heard: dict[str, float] = {}
        """Gateway -> when it asked last; the one that was silent longest first."""

    def offer(self, pull: Pull) -> None:
        """Gives a bundle to whoever is to pull it; who was to pull it before, is so no longer."""
        index = pull.job.index
        with self._guard:
            gateway = self._gateways.get(pull.via or "")
            for orders in self._orders.values():
                orders.pop(index, None)
            if gateway is not None:
                self._orders[gateway][index] = pull
        if gateway is None:
            self._pull_here(pull)

    def take(self, gateway: str, router: str, most: int, busy: Collection[str] = ()) -> tuple[Pull, ...]:
        """Hands a gateway its orders, the oldest first.

        Args:
            gateway: its name.
            router: zenoh's id of its session; from now on what is announced via that is the gateway's, unless it is
                the router of another gateway that is there.
            most: orders it can take.
            busy: hosts of which it has enough.
        """
        with self._guard:
            self._note(gateway, router)
            orders = self._orders.setdefault(gateway, {})
            return tuple(orders.pop(index) for index in _choose(orders, most, busy))

    def _note(self, gateway: str, router: str) -> None:
        """Records that a gateway is there, and its router if no other gateway that is there has named it."""
        now = self._clock()
        self._heard.pop(gateway, None)
        self._heard[gateway] = now
        owner = self._gateways.get(router)
        if owner is None or (owner != gateway and now - self._heard[owner] > _SILENT_S):
            former = {known: name for known, name in self._gateways.items() if name != gateway}
            self._gateways = former | {router: gateway}
        if len(self._heard) > _MOST_GATEWAYS:
            self._forget(next(iter(self._heard)))

    def _forget(self, gateway: str) -> None:
        del self._heard[gateway]
        self._orders.pop(gateway, None)
        self._gateways = {known: name for known, name in self._gateways.items() if name != gateway}


def _choose(orders: Mapping[int, Pull], most: int, busy: Collection[str]) -> list[int]:
    """Returns which orders a gateway is given: the oldest, a few of each host."""
    chosen: list[int] = []
    by_host = Counter(dict.fromkeys(busy, _OF_ONE_HOST))
    for index, pull in orders.items():
        host = host_of(pull.sid)
        if len(chosen) < most and by_host[host] < _OF_ONE_HOST:
            by_host[host] += 1
            chosen.append(index)
    return chosen
