"""Where the processes of a party come from: forked from one that has imported everything, so that a kill costs little.

Each is a real process with its own log, arguments and environment; only the reading of its code is done before.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import queue
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from schemas.support.closing import Closing

__all__ = ["Child", "ForkServer", "main"]

_STARTS_WITHIN_S = 120.0


class Child:
    """A process as `subprocess.Popen` shows it, as far as it is needed here."""

    def __init__(self, pid: int, args: Sequence[str]) -> None:
        self.pid, self.args = pid, args
        self._status: int | None = None
        self._ended = threading.Event()

    def poll(self) -> int | None:
        """Returns the exit status, minus the signal that ended it, or `None` while it lives."""
        return self._status

    def wait(self, timeout: float | None = None) -> int:
        """Returns the exit status once it has ended."""
        if not self._ended.wait(timeout):
            raise subprocess.TimeoutExpired(list(self.args), timeout or 0.0)
        assert self._status is not None
        return self._status

    def send_signal(self, what: signal.Signals) -> None:
        if self._status is None:
            os.kill(self.pid, what)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def note_end(self, status: int) -> None:
        """Is told by the nursery."""
        self._status = status
        self._ended.set()


class ForkServer(Closing):
    """Starts processes quickly; a context manager whose exit kills all that are left.

    Args:
        modules: what they run: each has a `main` that reads `sys.argv`.
        environment: of all of them, beside our own.
    """

    def __init__(self, modules: Sequence[str], environment: Mapping[str, str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.chaos.fork_server", *modules],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | environment | {"OPENBLAS_NUM_THREADS": "1"},
            text=True,
        )
        self._children: dict[int, Child] = {}
        self._born: queue.Queue[Child | None] = queue.Queue()
        self._asked: tuple[str, ...] = ()
        self._thread = threading.Thread(target=self._listen, name="nursery")
        self._thread.start()

    def start(self, module: str, words: Sequence[str], log: Path, extra: Mapping[str, str]) -> Child:
        """Starts `module`, whose output goes to the end of a file, with something extra in its environment."""
        assert self._process.stdin is not None
        self._asked = (module, *words)
        order = {"module": module, "words": list(words), "log": str(log), "extra": dict(extra)}
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        child = self._born.get(timeout=_STARTS_WITHIN_S)
        assert child is not None, f"the nursery has ended with {self._process.wait()}"
        return child

    def close(self) -> None:
        """Kills who is left."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._thread.join()
        self._process.stdout.close()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            what, pid, *status = line.split()
            if what == "born":
                self._children[int(pid)] = child = Child(int(pid), self._asked)
                self._born.put(child)
            else:
                self._children.pop(int(pid)).note_end(int(status[0]))
        self._born.put(None)


def main() -> None:
    """Is the nursery: reads orders from stdin, tells births and deaths on stdout, kills all when stdin ends."""
    for module in sys.argv[1:]:
        importlib.import_module(module)
    gc.freeze()
    hear, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    living = set[int]()
    orders = b""
    while True:
        ready, _, _ = select.select([0, hear], [], [])
        if 0 in ready:
            data = os.read(0, 1 << 16)
            if not data:
                break
            *lines, orders = (orders + data).split(b"\n")
            for line in lines:
                pid = os.fork()
                if pid == 0:
                    _grow_up(json.loads(line), hear, wake)
                living.add(pid)
                _tell(f"born {pid}")
        if hear in ready:
            os.read(hear, 1 << 16)
        _reap(living)
    for pid in living:
        os.kill(pid, signal.SIGKILL)


def _reap(living: set[int]) -> None:
    while living:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid == 0:
            return
        living.remove(pid)
        _tell(f"dead {pid} {os.waitstatus_to_exitcode(status)}")


def _tell(line: str) -> None:
    os.write(1, f"{line}\n".encode())


def _grow_up(order: dict[str, Any], *fds: int) -> NoReturn:
    """Becomes the process that was ordered and leaves as any interpreter does."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    nothing = os.open(os.devnull, os.O_RDONLY)
    log = os.open(order["log"], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    for source, target in ((nothing, 0), (log, 1), (log, 2)):
        os.dup2(source, target)
    for fd in (*fds, nothing, log):
        os.close(fd)
    os.environ.update(order["extra"])
    sys.argv = [order["module"], *order["words"]]
    sys.exit(importlib.import_module(order["module"]).main())


if __name__ == "__main__":
    main()
