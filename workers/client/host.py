"""What the slots and the heartbeat of one worker share: its name, its doors, its stores, and when to stop.

Holds these things; what is done with them stands in `slot` and `heartbeat`.
"""

from __future__ import annotations

import random
import re
import secrets
import threading
import time
from dataclasses import dataclass, field

from schemas.wire import Trade
from workers.client.leases import LeaseBook
from workers.client.link import Link
from workers.client.scene_cache import SceneCache
from workers.client.settings import WorkerSettings
from workers.client.spool import Spool

__all__ = ["Host", "Phase", "make_sid", "tidy_host"]

_MAX_HOST = 48
_ASK_S, _HURRIED_ASK_S = 2.0, 0.8


class Phase:
    """How far a worker is on its way out; only ever moves forward."""

    def __init__(self) -> None:
        self.closing = threading.Event()
        """Set: claim no more, finish what is under way."""
        self.stopping = threading.Event()
        """Set: also kill what is under way and give it back."""
        self.moved = threading.Event()
        """Set: the run is gone and another is there."""
        self.error: BaseException | None = None
        """What made the worker fail, if anything."""
        self._deadline = float("inf")
        self._finished: float | None = None

    def close(self) -> None:
        """Lets work under way finish."""
        self.closing.set()

    def finish(self) -> None:
        """Lets the worker leave because every job of the run has ended: nothing that it has is wanted any more."""
        if self._finished is None:
            self._finished = time.monotonic()
        self.close()

    @property
    def finished_s(self) -> float:
        """Seconds since it was told that the run is finished; 0 when it was not."""
        return 0.0 if self._finished is None else time.monotonic() - self._finished

    def stop(self, within_s: float) -> None:
        """Ends all work; whatever still wants an answer has `within_s` seconds for it."""
        self._deadline = min(self._deadline, time.monotonic() + within_s)
        self.closing.set()
        self.stopping.set()

    def fail(self, error: BaseException) -> None:
        """Ends all work because of an error; the first one counts."""
        self.error = self.error or error
        self.stop(_ASK_S)

    @property
    def left_s(self) -> float:
        """Seconds until nothing is waited for any more; infinite while working."""
        return max(0.0, self._deadline - time.monotonic())

    @property
    def ask_timeout_s(self) -> float:
        """How long to wait for an answer now."""
        return _ASK_S if not self.stopping.is_set() else max(0.05, min(_HURRIED_ASK_S, self.left_s))


@dataclass(frozen=True)
class Host:
    """One worker."""

    settings: WorkerSettings
    name: str
    sid: str
    """Name of this start of the worker; begins with the host's name."""
    run: str
    trade: Trade
    """What its jobs are."""
    command: tuple[str, ...]
    """How to start a simulation of the run."""
    lease_ttl_s: float
    link: Link
    spool: Spool
    scenes: SceneCache
    rng: random.Random
    """For jitter."""
    leases: LeaseBook = field(default_factory=LeaseBook)
    phase: Phase = field(default_factory=Phase)
    renderers: set[str] = field(default_factory=set)
    """What draws here, as far as it has been told."""

    def pause(self, seconds: float) -> None:
        """Waits a jittered time, or until the worker closes."""
        self.phase.closing.wait(seconds * self.rng.uniform(0.8, 1.2))


def tidy_host(name: str) -> str:
    """Returns a machine's name as it may stand in a key: lower case letters, digits and dashes.

    >>> tidy_host("Node_07.cluster.local")
    'node-07-cluster-local'
    """
    tidy = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:_MAX_HOST].rstrip("-")
    return tidy or "host"


def make_sid(host: str) -> str:
    """Returns a session id no earlier start of a worker has had; the dot cannot be part of a host's name."""
    return f"{host}.{secrets.token_hex(4)}"
