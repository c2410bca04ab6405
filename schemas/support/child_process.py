"""Supervised child process: starts it, exchanges messages with it, detects its end or silence, and kills its group.

The process reads from its stdin, a socket, and writes one message per line to its stdout. This module does not
interpret messages and does not restart the process; the owner does.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Generic, Literal, TypeVar

from schemas.support.closing import Closing

M = TypeVar("M")

Stderr = Literal["keep", "discard", "inherit"]
"""Destination of the process's stderr: a file for `Ended.last_output`, nothing, or the stderr of this process."""

_LONG_S = 86_400.0
_READ_BYTES = 1 << 16
_STDERR_BYTES = 1 << 20
"""Size above which the file with the process's stderr is emptied when the next message is sent, bytes."""
_TAIL_BYTES = 2000
_MAX_LINE_BYTES = 16 << 20

_FROM_OUTSIDE = frozenset({-signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP, -signal.SIGUSR1})
"""Exit statuses of a process that a batch system, a service manager or a user ended; they do not indicate a fault
of the process."""


@dataclass(frozen=True)
class Ended:
    """End of a child process; the rest of its process group was killed."""

    pid: int
    status: int
    """Exit status, negative for a signal."""
    is_reaped: bool = True
    """Whether the process has ended; false after SIGKILL during a system call that does not return, for example to a
    failed disk."""
    last_output: str = ""
    """Last line on stderr; empty if there is none, or if stderr is not kept."""
    silence_s: float = 0.0
    """Time without a message after which the process was killed as hung, seconds; 0 if it was not hung."""
    limit_s: float = 0.0
    """Time limit that was exceeded, seconds; 0 if the process was not hung."""

    @property
    def is_hung(self) -> bool:
        """Whether the process was killed because it sent no message within its time limit."""
        return self.limit_s > 0.0

    @property
    def is_killed(self) -> bool:
        """Whether SIGKILL ended the process."""
        return self.status == -signal.SIGKILL

    @property
    def is_from_outside(self) -> bool:
        """Whether a signal from outside, e.g. of a batch system, ended the process."""
        return self.status in _FROM_OUTSIDE

    @property
    def description(self) -> str:
        """Exit status as text: `killed by SIGKILL`, `exit status 1`."""
        if self.status < 0:
            return f"killed by {signal.Signals(-self.status).name}"
        return f"exit status {self.status}"


# lines of JSON instead of multiprocessing's queues, because unpickling a message can execute code
class ChildProcess(Closing, Generic[M]):
    """Child process that can be started again after its end.

    One thread starts, sends and receives; any thread may kill.

    Args:
        parse: returns the message of a line; `None` for a line that is not a message, which is skipped. A process
            without `parse` sends no messages, and its output goes to the stderr of this process.
        start_s: time after the start without a message, after which the process is killed as hung, seconds; `None` is
            no limit.
        silence_s: the same time after `send`, seconds.
        leave_s: time that `kill` waits for a normal exit after closing stdin, seconds.
        reap_s: time in which a process that was killed, or has closed its stdout, is expected to end, seconds.
        stderr: destination of its stderr.
        max_line_bytes: length at which a line is truncated.
    """

    def __init__(
        self,
        parse: Callable[[bytes], M | None] | None,
        *,
        start_s: float | None = None,
        silence_s: float | None = None,
        leave_s: float = 0.0,
        reap_s: float = 3.0,
        stderr: Stderr = "keep",
        max_line_bytes: int = _MAX_LINE_BYTES,
    ) -> None:
        self._parse, self._stderr, self._max_line_bytes = parse, stderr, max_line_bytes
        self._start_s, self._silence_s = start_s, silence_s
        self._leave_s, self._reap_s = leave_s, reap_s
        self._running: _Running[M] | None = None
        self._end: Ended | None = None
        self._ending = threading.Lock()
        self.failed_starts = 0
        """Number of processes in a row that ended, or hung, before their first message."""

    @property
    def is_started(self) -> bool:
        """Whether a process was started and its end was not yet returned by `receive` or `kill`."""
        return self._running is not None

    @property
    def is_alive(self) -> bool:
        """Whether a process runs now."""
        running = self._running
        return running is not None and running.popen.poll() is None

    @property
    def pid(self) -> int | None:
        """Process id; `None` unless `is_started`."""
        running = self._running
        return running.popen.pid if running is not None else None

    def start(self, command: Sequence[str], environment: Mapping[str, str], descriptors: Sequence[int] = ()) -> None:
        """Starts a process, after killing the previous one.

        Args:
            command: command line.
            environment: environment variables.
            descriptors: file descriptors that the process inherits.

        Raises:
            OSError: the process cannot be started.
        """
        self.kill()
        with contextlib.ExitStack() as opened:
            stdin, theirs = map(opened.enter_context, socket.socketpair())  # a pipe could not carry open files
            kept = opened.enter_context(_file_to_append()) if self._stderr == "keep" else None
            popen = subprocess.Popen(
                command,
                bufsize=0,
                stdin=theirs.fileno(),
                stdout=_error_output() if self._parse is None else subprocess.PIPE,
                stderr=subprocess.DEVNULL if self._stderr == "discard" else kept,
                pass_fds=descriptors,
                env=environment,
                start_new_session=True,  # Ctrl-C reaches the owner only; `kill` ends the whole group
            )
            opened.pop_all()
        theirs.close()
        parse, stdout = self._parse, popen.stdout
        lines = None if parse is None or stdout is None else _Lines(stdout, parse, self._max_line_bytes)
        self._running = _Running(popen, stdin, lines, kept, limit_s=self._start_s)

    def send(self, data: bytes, descriptors: Sequence[int] = ()) -> None:
        """Writes to the process's stdin; `receive` reports a process that has ended or does not read.

        Args:
            data: message, usually one line.
            descriptors: open files for the process, which it receives with the first byte.
        """
        running = self._running
        if running is not None:
            running.limit_s = self._silence_s
            running.send(data, descriptors)

    def receive(self, timeout_s: float) -> M | Ended | None:
        """Returns the next message, the end of the process, or `None` if neither came in time.

        A process that closes its stdout has ended, or is killed. So is a process that was silent for its time limit.
        After the end, the same end is returned again.

        Args:
            timeout_s: time to wait, seconds.

        Raises:
            RuntimeError: no process was started.
        """
        running = self._running
        if running is None:
            if self._end is None:
                raise RuntimeError("receive() before start()")
            return self._end
        try:
            message = running.read(timeout_s)
        except EOFError:
            return self._finish(running, wait_s=self._reap_s)
        if message is not None:
            running.is_ready, running.silence_s, self.failed_starts = True, 0.0, 0
            return message
        # waiting times are added instead of wall time, so a suspended owner does not report a hang
        running.silence_s += timeout_s
        return self._finish(running, is_hung=True) if running.left_s == 0.0 else None

    def wait(self) -> M | Ended:
        """Returns the next message, or the end of the process; see `receive`."""
        while True:
            running = self._running
            left_s = None if running is None else running.left_s
            result = self.receive(_LONG_S if left_s is None else left_s)
            if result is not None:
                return result

    def end_input(self) -> None:
        """Closes the process's stdin, which asks it to exit."""
        running = self._running
        if running is not None:
            running.stdin.close()

    def kill(self) -> Ended | None:
        """Kills the process group, after `leave_s` for a normal exit; killing twice is harmless.

        Returns:
            The end, or `None` if no process was started. A process that does not end now is reaped later.
        """
        running = self._running
        return None if running is None else self._finish(running, wait_s=self._leave_s, is_wanted=True)

    def close(self) -> None:
        """Kills the process, if one is running."""
        self.kill()

    def release_in_fork(self) -> None:
        """Closes the descriptors in a fork of this process, where the child process cannot be used; it continues."""
        running, self._running = self._running, None
        if running is not None:
            running.popen.returncode = 0  # the process is not a child of the fork, so the fork cannot wait for it
            running.close()

    def _finish(
        self, running: _Running[M], *, wait_s: float = 0.0, is_hung: bool = False, is_wanted: bool = False
    ) -> Ended:
        """Ends a process and returns its end, to each thread that asks.

        Args:
            running: process to end.
            wait_s: time for an exit without SIGKILL, seconds.
            is_hung: whether the process has exceeded its time limit.
            is_wanted: whether the owner ends the process.
        """
        with self._ending:
            if running.end is None:
                if wait_s and is_wanted:
                    running.stdin.close()
                running.end = running.finish(wait_s, self._reap_s, is_hung)
                self.failed_starts += not (running.is_ready or is_wanted)
            if self._running is running:
                self._end, self._running = running.end, None
            return running.end


@dataclass(eq=False)
class _Running(Generic[M]):
    """One process from its start to its end."""

    popen: subprocess.Popen[bytes]
    stdin: socket.socket
    lines: _Lines[M] | None
    stderr: IO[bytes] | None
    limit_s: float | None
    """Time limit of the silence, seconds."""
    silence_s: float = 0.0
    """Time that the owner has waited since the last message, seconds."""
    is_ready: bool = False
    """Whether the process has sent a message."""
    end: Ended | None = None

    @property
    def left_s(self) -> float | None:
        """Time until the process is hung, seconds; `None` without a limit."""
        return None if self.limit_s is None else max(0.0, self.limit_s - self.silence_s)

    def send(self, data: bytes, descriptors: Sequence[int]) -> None:
        begin_s = time.monotonic()
        with contextlib.suppress(OSError, ValueError):  # a ValueError if another thread closes the files
            if self.stderr is not None and os.fstat(self.stderr.fileno()).st_size > _STDERR_BYTES:
                os.ftruncate(self.stderr.fileno(), 0)
            self.stdin.settimeout(self.limit_s)
            sent = socket.send_fds(self.stdin, [data], descriptors) if descriptors else 0
            self.stdin.sendall(data[sent:])
        self.silence_s = time.monotonic() - begin_s

    def read(self, timeout_s: float) -> M | None:
        """Returns the next message, or `None` when none arrived in time.

        Raises:
            EOFError: the process has closed its stdout; without messages: it has ended.
        """
        if self.lines is not None:
            return self.lines.read(timeout_s)
        if self.wait(timeout_s):
            raise EOFError
        return None

    def wait(self, timeout_s: float) -> bool:
        """Returns whether the process ended in time."""
        try:
            self.popen.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def finish(self, wait_s: float, reap_s: float, is_hung: bool) -> Ended:
        pid = self.popen.pid
        if wait_s:
            self.wait(wait_s)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
        is_reaped = self.wait(reap_s)
        if not is_reaped:
            with contextlib.suppress(RuntimeError):  # no thread can start while the interpreter exits
                threading.Thread(target=self.popen.wait, name=f"reap-{pid}", daemon=True).start()
        end = Ended(
            pid,
            status=self.popen.returncode if is_reaped else -signal.SIGKILL,
            is_reaped=is_reaped,
            last_output=self._last_line(),
            silence_s=self.silence_s if is_hung else 0.0,
            limit_s=self.limit_s or 0.0 if is_hung else 0.0,
        )
        self.close(reap_s)
        return end

    def close(self, reading_s: float = 0.0) -> None:
        """Closes the descriptors, after `reading_s` for a thread that reads them."""
        if self.lines is not None:
            self.lines.close(reading_s)
        for file in (self.stdin, self.stderr):
            if file is not None:
                file.close()

    def _last_line(self) -> str:
        if self.stderr is None:
            return ""
        end = self.stderr.seek(0, os.SEEK_END)
        self.stderr.seek(max(0, end - _TAIL_BYTES))
        lines = self.stderr.read().decode(errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else ""


class _Lines(Generic[M]):
    """Messages that a process writes to its stdout, one per line."""

    def __init__(self, stdout: IO[bytes], parse: Callable[[bytes], M | None], max_line_bytes: int) -> None:
        self._stdout, self._parse, self._max_line_bytes = stdout, parse, max_line_bytes
        self._unread, self._is_at_end = bytearray(), False
        self._reading = threading.Lock()
        self._poll = select.poll()
        self._poll.register(stdout, select.POLLIN)

    def read(self, timeout_s: float) -> M | None:
        """Returns the next message, or `None` when none arrived in time.

        Raises:
            EOFError: the process has closed its stdout.
        """
        with self._reading:
            deadline, left_s = time.monotonic() + timeout_s, timeout_s
            while (message := self._next_message()) is None:
                if self._is_at_end:
                    raise EOFError
                if left_s < 0 or not self._poll.poll(left_s * 1000):
                    return None
                received = os.read(self._stdout.fileno(), _READ_BYTES)
                self._unread += received
                self._is_at_end = not received
                left_s = deadline - time.monotonic()
            return message

    def close(self, reading_s: float) -> None:
        """Closes the pipe, after `reading_s` for a thread that reads it; `read` raises `EOFError` from now on."""
        is_idle = self._reading.acquire(timeout=reading_s)
        self._is_at_end = True
        self._stdout.close()
        if is_idle:
            self._reading.release()

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


def _error_output() -> int:
    """Returns the descriptor of `sys.stderr`, or that of the process in a notebook, which replaces `sys.stderr`."""
    try:
        return sys.stderr.fileno()
    except (AttributeError, OSError, ValueError):
        return 2


def _file_to_append() -> IO[bytes]:
    """Returns an unnamed file in append mode: after it was emptied, a process writes at its start, not behind a gap."""
    file = tempfile.TemporaryFile()  # noqa: SIM115 - closed by the caller
    fcntl.fcntl(file, fcntl.F_SETFL, fcntl.fcntl(file, fcntl.F_GETFL) | os.O_APPEND)
    return file
