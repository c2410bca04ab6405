"""Status of a driver process in shared memory, read by the monitoring process.

Writing needs no lock and no system call, so the monitor also detects a policy that hangs while it holds the GIL. A
checksum lets the reader detect a partial write. Starts no process and calls no policy.
"""

from __future__ import annotations

import math
import mmap
import os
import struct
import tempfile
import time
import zlib
from enum import IntEnum
from typing import NamedTuple, Self

from factory.eval.driving.simulator import Simulator
from workers.experts.observation import Observation

_LAYOUT = struct.Struct("=qdqddddq")
_CHECK = struct.Struct("=L")
_TRIES = 100


class Activity(IntEnum):
    """Activity of the driver process."""

    STARTING = 0  # opening the renderer
    MAKING = 1  # creating or loading the policy, or waiting for its first output
    ASKING = 2  # waiting for an output of the policy
    SIMULATING = 3  # loading a scene, stepping, computing metrics
    IDLE = 4  # waiting for an order


class DriverStatus(NamedTuple):
    """Content of the shared status; distances are those of the current episode, metres."""

    busy: Activity = Activity.STARTING
    since_s: float = 0.0
    """Start of the activity on the system's monotonic clock, seconds."""
    steps: int = 0
    start_m: float = 0.0
    now_m: float = 0.0
    least_m: float = 0.0
    driven_m: float = 0.0
    contact_steps: int = 0


class SharedStatus:
    """Shared memory for one writer and one reader, inherited by its file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _LAYOUT.size + _CHECK.size)
        self._last = DriverStatus(since_s=time.monotonic())

    @classmethod
    def fresh(cls) -> Self:
        """Creates a shared status in an unnamed file."""
        with tempfile.TemporaryFile() as file:
            file.truncate(_LAYOUT.size + _CHECK.size)
            return cls(os.dup(file.fileno()))

    def write(self, state: DriverStatus) -> None:
        body = _LAYOUT.pack(*state)
        self._memory[:] = body + _CHECK.pack(zlib.crc32(body))

    def read(self) -> DriverStatus:
        """Returns the status, or the previously read status if the writer stopped during a write."""
        for _ in range(_TRIES):
            data = self._memory[:]
            body, check = data[: _LAYOUT.size], data[_LAYOUT.size :]
            if check == _CHECK.pack(zlib.crc32(body)):
                busy, *rest = _LAYOUT.unpack(body)
                self._last = DriverStatus(Activity(busy), *rest)
                break
        return self._last

    def close(self) -> None:
        """Closes the memory map and the file descriptor."""
        self._memory.close()
        os.close(self.descriptor)


class StatusWriter:
    """Observer of policy calls that writes every change to the shared status."""

    def __init__(self, shared: SharedStatus) -> None:
        self._shared = shared
        self._state = DriverStatus()
        self._last: tuple[float, float] | None = None
        self._calls = 0
        self._asked = self._state
        """Status before the images were rendered within a call of the policy."""
        self.is_warm = False
        """Whether the policy has returned an action; until then, the longer `load_timeout_s` applies."""
        self.is_privileged = False
        """Whether the policy is privileged. The calls of such a policy plan paths, so they have the time limit of the
        simulation."""

    def note(self, busy: Activity) -> None:
        self._state = self._state._replace(busy=busy, since_s=time.monotonic())
        self._shared.write(self._state)

    def begin(self, busy: Activity) -> None:
        """Writes the current activity and resets the distances for a new episode."""
        self._state, self._last, self._calls = DriverStatus(), None, 0
        self.note(busy)

    def before_call(self, simulator: Simulator, view: Observation) -> None:
        """Writes the progress before a policy call."""
        self._calls += 1
        here, state = (view.pose.x, view.pose.y), self._state
        moved = 0.0 if self._last is None else math.dist(self._last, here)
        is_first, self._last = self._last is None, here
        self._state = state._replace(
            steps=simulator.steps,
            start_m=view.distance_m if is_first else state.start_m,
            now_m=view.distance_m,
            least_m=view.distance_m if is_first else min(state.least_m, view.distance_m),
            driven_m=state.driven_m + moved,
            contact_steps=simulator.contact_steps,
        )
        if not self.is_privileged:
            is_reset = self._calls == 1
            self.note(Activity.ASKING if self.is_warm and not is_reset else Activity.MAKING)

    def after_call(self) -> None:
        """Writes the activity after a policy call."""
        self.is_warm = self.is_warm or self._calls > 1  # the first call is the reset
        self.note(Activity.SIMULATING)

    def before_render(self) -> None:
        """Writes that the simulation renders, which does not count for the time limit of the policy."""
        self._asked = self._state
        self.note(Activity.SIMULATING)

    def after_render(self) -> None:
        """Writes that the policy continues."""
        paused_s = time.monotonic() - self._state.since_s
        self._state = self._asked._replace(since_s=self._asked.since_s + paused_s)
        self._shared.write(self._state)
