"""Monitors a running coordinator: liveness, readiness and metrics. Does not change its components."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass
from typing import Protocol

from coordinator.ledger.database.writer import Writer
from coordinator.meters import Meter, Meters
from schemas.errors import FactoryError
from schemas.protocol.status import Progress

_COMMIT_S = 5.0
_FRESH_S = 1.0


@dataclass(frozen=True)
class Snapshot:
    """Metrics at one point in time."""

    progress: Progress | None
    """Progress of the run; `None` for a gateway."""
    frames: int
    """Number of frames in all archived episodes."""
    sums: Mapping[Meter, float]
    """Counters of the process."""
    requests: Mapping[str, int]
    """Number of requests by verb."""
    free_bytes: int
    """Free space of the archive's disk, bytes."""
    reserve_bytes: int
    """Free space below which no job is leased, bytes."""
    backlog: int
    """Number of requests that wait for the ledger's writer; for a gateway, number of bundles that are queued or in
    transfer."""
    sandbox: tuple[str, ...]
    """Active sandbox layers of the validating processes; empty before the first bundle."""


class StatusSource(Protocol):
    """Interface of a coordinator or gateway for the status pages."""

    def is_alive(self) -> bool:
        """Returns whether the central thread runs; if it has ended, restart the process."""

    def troubles(self) -> tuple[str, ...]:
        """Returns the reasons why the process cannot serve now; empty if it can."""

    def snapshot(self) -> Snapshot:
        """Returns the current metrics."""


class HealthMonitor:
    """Thread-safe health monitor of a coordinator.

    Args:
        writer: writer of the ledger.
        meters: counters of the process.
        read: function that reads the progress and the number of frames from the ledger.
        free_bytes: function that returns the free space of the archive's disk, bytes.
        reserve_bytes: free space below which no job is leased, bytes.
        is_listening: function that returns whether the zenoh session is open.
        sandbox: function that returns the active sandbox layers of the validating processes.
    """

    def __init__(
        self,
        writer: Writer,
        meters: Meters,
        read: Callable[[], tuple[Progress, int]],
        free_bytes: Callable[[], int],
        reserve_bytes: int,
        is_listening: Callable[[], bool],
        sandbox: Callable[[], tuple[str, ...]],
    ) -> None:
        self._writer = writer
        self._meters = meters
        self._read = read
        self._free_bytes = free_bytes
        self._reserve_bytes = reserve_bytes
        self._is_listening = is_listening
        self._sandbox = sandbox
        self._reading = threading.Lock()
        self._last: Snapshot | None = None
        self._taken = 0.0

    def is_alive(self) -> bool:
        """Returns whether the threads of the ledger writer run; if they have ended, restart the process."""
        return self._writer.is_alive

    def troubles(self) -> tuple[str, ...]:
        """Returns the reasons why the coordinator cannot serve now; empty if it can.

        A full disk is not such a reason: workers must stay connected to deliver their bundles.
        """
        findings = []
        if not self._is_listening():
            findings.append("not listening to workers")
        try:
            self._writer.submit(lambda _connection: None).result(_COMMIT_S)
        except FutureTimeout:
            findings.append(f"the ledger has not committed within {_COMMIT_S:g} s")
        except FactoryError as error:
            findings.append(str(error))
        return tuple(findings)

    def snapshot(self) -> Snapshot:
        """Returns the metrics, cached for one second, so frequent requests do not load the ledger."""
        with self._reading:
            if self._last is None or time.monotonic() - self._taken > _FRESH_S:
                progress, frames = self._read()
                self._last = Snapshot(
                    progress=progress,
                    frames=frames,
                    sums=self._meters.sums(),
                    requests=self._meters.requests(),
                    free_bytes=self._free_bytes(),
                    reserve_bytes=self._reserve_bytes,
                    backlog=self._writer.backlog,
                    sandbox=self._sandbox(),
                )
                self._taken = time.monotonic()
            return self._last
