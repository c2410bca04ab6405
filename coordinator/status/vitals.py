"""How a running coordinator does: whether it lives and can serve, and its figures. Asks its parts, changes nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass
from typing import Protocol

from coordinator.ledger.writer import Writer
from coordinator.meters import Meter, Meters
from schemas.errors import FactoryError
from schemas.wire import Progress

__all__ = ["Snapshot", "Vitals", "Watched"]

_COMMIT_S = 5.0
_FRESH_S = 1.0


@dataclass(frozen=True)
class Snapshot:
    """Figures of one moment."""

    progress: Progress | None
    """Of the run; a gateway does not know it."""
    frames: int
    """Archived, over all episodes of the ledger."""
    sums: Mapping[Meter, float]
    requests: Mapping[str, int]
    free_bytes: int
    reserve_bytes: int
    backlog: int
    """Requests that wait for the ledger's writer."""
    sandbox: tuple[str, ...]
    """What confines the processes that validate bundles; empty before the first bundle."""


class Watched(Protocol):
    """A process that serves for long, as status pages ask it."""

    def is_alive(self) -> bool:
        """Whether what everything goes through still runs; if not, only a restart helps."""

    def troubles(self) -> tuple[str, ...]:
        """Returns why it cannot serve now, in words; nothing when it can."""

    def snapshot(self) -> Snapshot:
        """Returns the figures."""


class Vitals:
    """Answers for a coordinator; safe to ask from any thread.

    Args:
        writer: of its ledger.
        meters: of its process.
        read: reads progress and frames from the ledger.
        free_bytes: asks the archive's disk.
        reserve_bytes: that the archive keeps free.
        is_listening: whether its zenoh session is open.
        sandbox: tells what confines the processes that validate bundles.
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
        """Whether the thread that everything goes through still runs; if not, only a restart helps."""
        return self._writer.is_alive

    def troubles(self) -> tuple[str, ...]:
        """Returns why it cannot serve now, in words; nothing when it can.

        A full disk is no trouble here: workers must stay connected to bring what they have.
        """
        found = []
        if not self._is_listening():
            found.append("not listening to workers")
        try:
            self._writer.submit(lambda _connection: None).result(_COMMIT_S)
        except FutureTimeout:
            found.append(f"the ledger has not committed within {_COMMIT_S:g} s")
        except FactoryError as error:
            found.append(str(error))
        return tuple(found)

    def snapshot(self) -> Snapshot:
        """Returns the figures, at most a second old, so that many who ask cost no more than one."""
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
