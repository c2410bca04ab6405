"""Assigns announced bundles to pullers: to the gateway of the worker, else to the coordinator.

The module keeps orders in memory until the gateway fetches them. After the loss of an order, the next heartbeat of the
worker announces the bundle again.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping

from coordinator.protocol.bundles import IncomingBundle
from schemas.protocol.keys import host_of

_OF_ONE_HOST = 4
"""Maximum number of orders of one host per reply to a gateway."""
_MOST_GATEWAYS = 1000
"""Maximum number of known gateways; beyond it the gateway with the oldest request is removed."""
_SILENT_S = 10.0
"""Time without a request after which another gateway may claim the same router, seconds. A gateway sends four requests
per second."""


class Dispatch:
    """Thread-safe queue of orders by gateway.

    Args:
        pull_here: callback for a bundle whose worker is not connected to a known gateway.
        clock: monotonic clock, seconds.
    """

    def __init__(
        self, pull_here: Callable[[IncomingBundle], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._pull_here = pull_here
        self._clock = clock
        self._guard = threading.Lock()
        self._gateways: dict[str, str] = {}
        """Mapping of zenoh router id to gateway name."""
        self._orders: dict[str, dict[int, IncomingBundle]] = {}
        """Mapping of gateway to its orders by episode number."""
        self._heard: dict[str, float] = {}
        """Mapping of gateway to the time of its last request, oldest first."""

    def offer(self, bundle: IncomingBundle) -> None:
        """Assigns a bundle to a gateway or to the coordinator, and withdraws an earlier assignment."""
        index = bundle.job.index
        # the gateway whose router the worker names: zenoh's target BEST_MATCHING distributes queries unevenly, and
        # gateways that claim bundles in the ledger would need timers that detect lost gateways
        with self._guard:
            gateway = self._gateways.get(bundle.via or "")
            for orders in self._orders.values():
                orders.pop(index, None)
            if gateway is not None:
                self._orders[gateway][index] = bundle
        if gateway is None:
            self._pull_here(bundle)

    def take(self, gateway: str, router: str, most: int, busy: Collection[str] = ()) -> tuple[IncomingBundle, ...]:
        """Removes and returns orders of a gateway, oldest first.

        Args:
            gateway: name of the gateway.
            router: zenoh id of its router. Bundles announced via this router are assigned to the gateway from now on,
                unless the router belongs to another active gateway.
            most: maximum number of orders.
            busy: hosts of which the gateway has enough bundles.
        """
        with self._guard:
            self._record_request(gateway, router)
            orders = self._orders.setdefault(gateway, {})
            return tuple(orders.pop(index) for index in _choose(orders, most, busy))

    def _record_request(self, gateway: str, router: str) -> None:
        """Records a request of a gateway, and its router unless the router belongs to another active gateway."""
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


def _choose(orders: Mapping[int, IncomingBundle], most: int, busy: Collection[str]) -> list[int]:
    """Returns the oldest orders, limited in total and per host."""
    chosen: list[int] = []
    by_host = Counter(dict.fromkeys(busy, _OF_ONE_HOST))
    for index, bundle in orders.items():
        host = host_of(bundle.sid)
        if len(chosen) < most and by_host[host] < _OF_ONE_HOST:
            by_host[host] += 1
            chosen.append(index)
    return chosen
