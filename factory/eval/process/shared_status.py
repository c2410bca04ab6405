"""A few numbers in shared memory: what a driving process is busy with, for the one that watches it.

Written without a lock and without a system call, so that a policy that hangs with the interpreter's lock in its hands
is found out all the same; a checksum tells the reader what it caught half written. Knows no policy and no process.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import time
import zlib
from enum import IntEnum
from typing import NamedTuple, Self

__all__ = ["Activity", "DriverStatus", "SharedStatus"]

_LAYOUT = struct.Struct("=qdqddddq")
_CHECK = struct.Struct("=L")
_TRIES = 100


class Activity(IntEnum):
    """What the process is at."""

    STARTING = 0  # opening the renderer
    MAKING = 1  # making or loading the policy, or waiting for its first answer
    ASKING = 2  # waiting for the policy
    SIMULATING = 3  # loading a scene, stepping, measuring
    IDLE = 4  # waiting for an order


class DriverStatus(NamedTuple):
    """What stands on a sheet; the distances are those of the running episode, metres."""

    busy: Activity = Activity.STARTING
    since_s: float = 0.0
    """On the monotonic clock, which all processes of a machine share."""
    steps: int = 0
    start_m: float = 0.0
    now_m: float = 0.0
    least_m: float = 0.0
    driven_m: float = 0.0
    contact_steps: int = 0


class SharedStatus:
    """One writer, one reader; handed on by its file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _LAYOUT.size + _CHECK.size)
        self._last = DriverStatus(since_s=time.monotonic())

    @classmethod
    def fresh(cls) -> Self:
        """Returns a new sheet in an unnamed file."""
        with tempfile.TemporaryFile() as file:
            file.truncate(_LAYOUT.size + _CHECK.size)
            return cls(os.dup(file.fileno()))

    def write(self, state: DriverStatus) -> None:
        """Replaces what stands there."""
        body = _LAYOUT.pack(*state)
        self._memory[:] = body + _CHECK.pack(zlib.crc32(body))

    def read(self) -> DriverStatus:
        """Returns what stands there, or what was read last where the writer got stuck or died in the middle."""
        for _ in range(_TRIES):
            data = self._memory[:]
            body, check = data[: _LAYOUT.size], data[_LAYOUT.size :]
            if check == _CHECK.pack(zlib.crc32(body)):
                busy, *rest = _LAYOUT.unpack(body)
                self._last = DriverStatus(Activity(busy), *rest)
                break
        return self._last

    def close(self) -> None:
        """Frees the memory and the descriptor."""
        self._memory.close()
        os.close(self.descriptor)
