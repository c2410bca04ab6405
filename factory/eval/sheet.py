"""A few numbers in shared memory: what a driving process is busy with, for the one that watches it.

Written without a lock and without a system call, so that a policy that hangs with the interpreter's lock in its hands
is found out all the same. Knows no policy and no process.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import time
from enum import IntEnum
from typing import NamedTuple, Self

__all__ = ["Busy", "Sheet", "State"]

_LAYOUT = struct.Struct("=qdqddddq")


class Busy(IntEnum):
    """What the process is at."""

    STARTING = 0  # opening the renderer
    MAKING = 1  # making or loading the policy, or waiting for its first answer
    ASKING = 2  # waiting for the policy
    SIMULATING = 3  # loading a scene, stepping, measuring
    IDLE = 4  # waiting for an order


class State(NamedTuple):
    """What stands on a sheet; the distances are those of the running episode, metres."""

    busy: Busy = Busy.STARTING
    since_s: float = 0.0
    """On the monotonic clock, which all processes of a machine share."""
    steps: int = 0
    start_m: float = 0.0
    now_m: float = 0.0
    least_m: float = 0.0
    driven_m: float = 0.0
    contact_steps: int = 0


class Sheet:
    """One writer, one reader; handed on by its file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _LAYOUT.size)

    @classmethod
    def fresh(cls) -> Self:
        """Returns a new sheet in an unnamed file."""
        with tempfile.TemporaryFile() as file:
            file.truncate(_LAYOUT.size)
            sheet = cls(os.dup(file.fileno()))
        sheet.write(State(since_s=time.monotonic()))
        return sheet

    def write(self, state: State) -> None:
        """Replaces what stands there."""
        _LAYOUT.pack_into(self._memory, 0, *state)

    def read(self) -> State:
        """Returns what stands there."""
        busy, *rest = _LAYOUT.unpack_from(self._memory)
        return State(Busy(busy), *rest)

    def close(self) -> None:
        """Frees the memory and the descriptor."""
        self._memory.close()
        os.close(self.descriptor)
