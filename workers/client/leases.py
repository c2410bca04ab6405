"""Table of the leases in simulation on this host, shared by slots and heartbeat. Sends no message."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from schemas.wire import Lease, LeaseProgress

__all__ = ["LeaseBook"]


class LeaseBook:
    """Table of leases in simulation; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._steps: dict[Lease, int] = {}
        self._lost: set[Lease] = set()

    @contextmanager
    def held(self, lease: Lease) -> Iterator[None]:
        """Includes the lease in every heartbeat during the block."""
        with self._lock:
            self._steps[lease] = 0
        try:
            yield
        finally:
            with self._lock:
                self._steps.pop(lease, None)
                self._lost.discard(lease)

    def note_step(self, lease: Lease, step: int) -> None:
        """Records the number of simulated steps for the next heartbeat."""
        with self._lock:
            if lease in self._steps:
                self._steps[lease] = step

    def live(self) -> tuple[LeaseProgress, ...]:
        """Returns all leases with their progress, for the next heartbeat."""
        with self._lock:
            return tuple(LeaseProgress(lease=lease, step=step) for lease, step in self._steps.items())

    def lose(self, leases: Iterable[Lease]) -> None:
        """Marks leases as lost; ignores leases that are not in simulation."""
        with self._lock:
            self._lost |= set(leases) & self._steps.keys()

    def is_lost(self, lease: Lease) -> bool:
        """Returns whether a lease in simulation is lost, so that its result would be refused."""
        with self._lock:
            return lease in self._lost
