"""State that the slots and the heartbeat of one worker share: name, link, stores, leases and shutdown phase.

Contains no worker loop and sends no message; `slot` and `heartbeat` do.
"""

from __future__ import annotations

import random
import re
import secrets
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from schemas.protocol.messages import Lease, LeaseProgress, PolicyWait, RunKind
from workers.client.link import Link
from workers.client.scene_cache import SceneCache
from workers.client.settings import CheckBundle, WorkerSettings
from workers.client.spool import Spool

_MAX_HOST = 48
_ASK_S, _HURRIED_ASK_S = 2.0, 0.8
_BEATS_PER_LEASE = 4
"""Heartbeats per lease time."""
# with a lease of 15 s, heartbeats are 3 to 4.5 s apart, and one without an answer takes 2 s more: a lease always
# outlasts one lost heartbeat (at most 11 s), and sometimes two (13 to 17.5 s)


class Phase:
    """Shutdown phase of a worker; it only advances."""

    def __init__(self) -> None:
        self.closing = threading.Event()
        """Set when the worker claims no more jobs and finishes its current attempts."""
        self.stopping = threading.Event()
        """Set when the worker also kills its current attempts and returns their jobs."""
        self.moved = threading.Event()
        """Set when another run replaces this one, or an evaluation has priority."""
        self.heartbeat_due = threading.Event()
        """Set when a heartbeat is due at once: the worker closes, or the spool is half full."""
        self.error: BaseException | None = None
        """First exception that ended the worker, or `None`."""
        self._deadline = float("inf")
        self._finished: float | None = None

    def close(self) -> None:
        self.closing.set()
        self.heartbeat_due.set()

    def finish(self) -> None:
        """Ends the worker because all jobs of the run have ended, so its results are no longer needed."""
        if self._finished is None:
            self._finished = time.monotonic()
        self.close()

    @property
    def finished_s(self) -> float:
        """Time since the run was reported as finished, seconds; 0 if it was not."""
        return 0.0 if self._finished is None else time.monotonic() - self._finished

    def stop(self, within_s: float) -> None:
        """Ends all work; open requests get `within_s` seconds for their reply."""
        self._deadline = min(self._deadline, time.monotonic() + within_s)
        self.close()
        self.stopping.set()

    def fail(self, error: BaseException) -> None:
        """Ends all work because of an exception; the first one is kept."""
        self.error = self.error or error
        self.stop(_ASK_S)

    @property
    def left_s(self) -> float:
        """Time until the worker stops waiting for replies, seconds; infinite while it works."""
        return max(0.0, self._deadline - time.monotonic())

    @property
    def ask_timeout_s(self) -> float:
        """Timeout of a request, seconds; shorter while the worker stops."""
        return _ASK_S if not self.stopping.is_set() else max(0.05, min(_HURRIED_ASK_S, self.left_s))


class LeaseBook:
    """Table of leases in simulation; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._live: dict[Lease, LeaseProgress] = {}
        self._lost: set[Lease] = set()

    @contextmanager
    def held(self, lease: Lease) -> Iterator[None]:
        """Includes the lease in every heartbeat during the block."""
        with self._lock:
            self._live[lease] = LeaseProgress(lease=lease, step=0)
        try:
            yield
        finally:
            with self._lock:
                self._live.pop(lease, None)
                self._lost.discard(lease)

    def note_progress(self, lease: Lease, step: int, waits: PolicyWait | None) -> None:
        """Records the number of simulated steps and a long wait for a policy for the next heartbeat."""
        with self._lock:
            if lease in self._live:
                self._live[lease] = LeaseProgress(lease=lease, step=step, waits=waits)

    def live(self) -> tuple[LeaseProgress, ...]:
        """Returns all leases with their progress, for the next heartbeat."""
        with self._lock:
            return tuple(self._live.values())

    def lose(self, leases: Iterable[Lease]) -> None:
        """Marks leases as lost; ignores leases that are not in simulation."""
        with self._lock:
            self._lost |= set(leases) & self._live.keys()

    def is_lost(self, lease: Lease) -> bool:
        """Returns whether a lease in simulation is lost, so its result would be refused."""
        with self._lock:
            return lease in self._lost


@dataclass(frozen=True)
class Host:
    """Shared state of one worker for one run."""

    settings: WorkerSettings
    """Settings of the worker."""
    name: str
    """Name of the host."""
    sid: str
    """Session id of this start of the worker; it begins with the host's name."""
    run: str
    """Name of the run."""
    run_kind: RunKind
    """Type of the jobs of the run."""
    command: tuple[str, ...]
    """Command line of a simulation process."""
    lease_ttl_s: float
    """Time after which a lease without heartbeat expires, seconds."""
    check_bundle: CheckBundle | None
    """Function that validates bundles before they are announced; `None` if the coordinator does not request it."""
    link: Link
    """Connection to the coordinator."""
    spool: Spool
    """Store of finished bundles."""
    scenes: SceneCache
    """Cache of compiled scenes."""
    rng: random.Random
    """Random generator for jitter."""
    leases: LeaseBook = field(default_factory=LeaseBook)
    """Leases in simulation."""
    phase: Phase = field(default_factory=Phase)
    """Shutdown phase."""
    renderers: set[str] = field(default_factory=set)
    """Descriptions of the renderers that were logged."""

    def pause(self, seconds: float) -> None:
        """Waits for a time with 20 % jitter, or until the worker closes."""
        self.phase.closing.wait(self._jittered(seconds))

    def wait_for_beat(self) -> None:
        """Waits until the next heartbeat is due: after a quarter of the lease time with 20 % jitter, or earlier."""
        self.phase.heartbeat_due.wait(self._jittered(self.lease_ttl_s / _BEATS_PER_LEASE))

    def _jittered(self, seconds: float) -> float:
        return seconds * self.rng.uniform(0.8, 1.2)


def valid_host_name(name: str) -> str:
    """Returns a machine's name as a valid host name: lower-case letters, digits and dashes.

    >>> valid_host_name("Node_07.cluster.local")
    'node-07-cluster-local'
    """
    valid = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:_MAX_HOST].rstrip("-")
    return valid or "host"


def make_sid(host: str) -> str:
    """Returns a new unique session id: the host's name, a dot and random hexadecimal digits; the name has no dot."""
    return f"{host}.{secrets.token_hex(4)}"


class Backoff:
    """Exponential backoff from `first_s` to `longest_s` seconds that doubles with each failure."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self.failures = 0
        """Number of failures since the last success."""

    def fail(self) -> float:
        """Counts a failure and returns the time to pause, seconds."""
        self.failures += 1
        return min(self._longest_s, self._first_s * 2.0 ** min(self.failures - 1, 32))

    def succeed(self) -> None:
        """Resets the backoff to the shortest pause."""
        self.failures = 0
