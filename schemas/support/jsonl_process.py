"""Child process that reads lines on stdin and writes one message per line on stdout.

Starts it in a separate process group, sends, reads with a timeout, kills the group, and keeps the end of its stderr.
Does not interpret messages, restart the process or set time limits; the owner does.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Generic, TypeVar

M = TypeVar("M")

_REAP_S = 3.0
_READ_BYTES = 1 << 16
_STDERR_BYTES = 1 << 20
"""Size above which the file with the process's stderr is emptied when the next line is sent, bytes."""
_TAIL_BYTES = 2000
_MAX_LINE_BYTES = 16 << 20

ENDED_FROM_OUTSIDE = frozenset({-signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP, -signal.SIGUSR1})
"""Exit statuses of a process that a batch system, a service manager or a user ended; they do not indicate a fault
of the process."""


def describe_exit(status: int) -> str:
    """Returns an exit status as `subprocess` describes it: `killed by SIGKILL`, `exit status 1`."""
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


# lines of JSON instead of multiprocessing's queues, because unpickling a message can execute code
class JsonlProcess(Generic[M]):
    """Child process, from its start to its end.

    One thread sends and reads; another thread may kill.

    Args:
        command: command line of the process.
        environment: environment variables of the process.
        parse: returns the message of a line; `None` for a line that is not a message, which is skipped.
        stdin: descriptor that the process gets as stdin; by default a pipe, which `send` writes to.
        pass_fds: descriptors that the process inherits.
        keeps_stderr: keeps stderr for `last_stderr_line`; it is discarded otherwise.
        max_line_bytes: length at which a line is truncated.

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        parse: Callable[[bytes], M | None],
        *,
        stdin: int = subprocess.PIPE,
        pass_fds: Sequence[int] = (),
        keeps_stderr: bool = True,
        max_line_bytes: int = _MAX_LINE_BYTES,
    ) -> None:
        self._parse, self._max_line_bytes = parse, max_line_bytes
        self._unread, self._is_at_end = bytearray(), False
        self._reading = threading.Lock()
        self._stderr: IO[bytes] | None = None
        with contextlib.ExitStack() as opened:
            if keeps_stderr:
                self._stderr = opened.enter_context(_file_to_append())
            self._process = subprocess.Popen(
                command,
                stdin=stdin,
                stdout=subprocess.PIPE,
                stderr=self._stderr if self._stderr is not None else subprocess.DEVNULL,
                pass_fds=pass_fds,
                env=environment,
                start_new_session=True,  # Ctrl-C reaches the owner only; `kill` ends the whole group
            )
            opened.pop_all()
        assert self._process.stdout is not None
        self._stdout = self._process.stdout
        self._poll = select.poll()
        self._poll.register(self._stdout, select.POLLIN)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def send(self, line: bytes) -> None:
        """Writes a line to the process's stdin; `read` reports a process that has ended meanwhile."""
        if self._stderr is not None and os.fstat(self._stderr.fileno()).st_size > _STDERR_BYTES:
            os.ftruncate(self._stderr.fileno(), 0)
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(line)
                self._process.stdin.flush()

    def read(self, timeout_s: float) -> M | None:
        """Returns the next message, or `None` when none arrived within `timeout_s`.

        Raises:
            EOFError: the process has closed its stdout, usually because it has ended.
        """
        with self._reading:
            deadline, left_s = time.monotonic() + timeout_s, timeout_s
            while (message := self._next_message()) is None:
                if self._is_at_end:
                    raise EOFError(f"process {self.pid} has closed its stdout")
                if left_s < 0 or not self._poll.poll(left_s * 1000):
                    return None
                self._receive()
                left_s = deadline - time.monotonic()
            return message

    def wait(self) -> int:
        """Returns the exit status of a process whose stdout is closed; one that does not end counts as killed."""
        try:
            return self._process.wait(_REAP_S)
        except subprocess.TimeoutExpired:
            return -signal.SIGKILL

    def kill(self, timeout_s: float = _REAP_S) -> int | None:
        """Kills the process group immediately and closes the pipes; killing twice is harmless.

        Args:
            timeout_s: time to wait for the end of the process; a thread reaps a process that ends later.

        Returns:
            The exit status; `None` when the process does not end, for example in a system call to a failed disk.
        """
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            threading.Thread(target=self._process.wait, name=f"reap-{self.pid}", daemon=True).start()
        is_idle = self._reading.acquire(timeout=_REAP_S)
        self._is_at_end = True
        for pipe in (self._process.stdin, self._stdout, self._stderr):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        if is_idle:
            self._reading.release()
        return self._process.returncode

    def last_stderr_line(self) -> str:
        """Returns the last line that the process wrote to stderr; empty when there is none, or after `kill`."""
        if self._stderr is None or self._stderr.closed:
            return ""
        end = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, end - _TAIL_BYTES))
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else ""

    def _next_message(self) -> M | None:
        while (line := self._next_line()) is not None:
            message = self._parse(line)
            if message is not None:
                return message
        return None

    def _next_line(self) -> bytes | None:
        end = self._unread.find(b"\n") + 1
        if not end and (self._is_at_end or len(self._unread) >= self._max_line_bytes):
            end = len(self._unread)
        if not end:
            return None
        line = bytes(self._unread[:end])
        del self._unread[:end]
        return line

    def _receive(self) -> None:
        received = os.read(self._stdout.fileno(), _READ_BYTES)
        self._unread += received
        self._is_at_end = not received


def _file_to_append() -> IO[bytes]:
    """Returns an unnamed file in append mode: after it was emptied, a process writes at its start, not behind a gap."""
    file = tempfile.TemporaryFile()  # noqa: SIM115 - closed by the caller
    fcntl.fcntl(file, fcntl.F_SETFL, fcntl.fcntl(file, fcntl.F_GETFL) | os.O_APPEND)
    return file
