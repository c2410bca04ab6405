"""The leases this host holds while it works on them, shared by slots and heartbeat. Never talks to anybody."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from schemas.wire import Lease, LeaseProgress

__all__ = ["LeaseBook"]


class LeaseBook:
    """A table of leases in work; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._steps: dict[Lease, int] = {}
        self._lost: set[Lease] = set()

    @contextmanager
    def held(self, lease: Lease) -> Iterator[None]:
        """Lists the lease in every beat for as long as the block runs."""
        with self._lock:
            self._steps[lease] = 0
        try:
            yield
        finally:
            with self._lock:
                self._steps.pop(lease, None)
                self._lost.discard(lease)

    def note_step(self, lease: Lease, step: int) -> None:
        """Records progress for the next beat."""
        with self._lock:
            if lease in self._steps:
                self._steps[lease] = step

    def live(self) -> tuple[LeaseProgress, ...]:
        """Returns what the next beat tells."""
        with self._lock:
            return tuple(LeaseProgress(lease=lease, step=step) for lease, step in self._steps.items())

    def lose(self, leases: Iterable[Lease]) -> None:
        """Notes that leases belong to somebody else now; those not in work are passed over."""
        with self._lock:
            self._lost |= set(leases) & self._steps.keys()

    def is_lost(self, lease: Lease) -> bool:
        """Whether work under the lease is in vain."""
        with self._lock:
            return lease in self._lost
