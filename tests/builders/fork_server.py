"""Starts processes quickly by forking them from a process that has already imported their modules.

Each child is a real process with its own session, output files, arguments, environment and working directory.
"""

from __future__ import annotations

import contextlib
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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NoReturn

from schemas.support.child import python_module
from schemas.support.closing import Closing
from tests.builders.fork_helper import end_after, fork_children, prepare_forks

_STARTS_WITHIN_S = 800.0
"""Time after which the server counts as hung, seconds: on a busy machine its imports alone take minutes."""


class Child:
    """A child process with the part of the interface of `subprocess.Popen` that the tests need."""

    def __init__(self, pid: int, args: Sequence[str]) -> None:
        self.pid, self.args = pid, args
        self._status: int | None = None
        self._ended = threading.Event()

    def poll(self) -> int | None:
        """Returns the exit status, `-N` if signal N ended the process, or `None` while it runs."""
        return self._status

    def wait(self, timeout: float | None = None) -> int:
        """Waits for the end of the process and returns its exit status."""
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
        """Records the exit status; called by the fork server."""
        self._status = status
        self._ended.set()


@dataclass(frozen=True)
class _Order:
    module: str
    words: list[str]
    environment: dict[str, str]
    folder: str
    out: str
    err: str
    forks_children: bool


class ForkServer(Closing):
    """Starts processes quickly. Context manager: exit kills the remaining processes.

    Args:
        modules: modules to import in advance. A module that `start` runs has a `main` that reads `sys.argv`.
        environment: environment variables of the server.
        forks_children: whether the started processes fork their own Python processes, as `tests.builders.fork_helper`
            describes.
    """

    def __init__(self, modules: Sequence[str], environment: Mapping[str, str], *, forks_children: bool = False) -> None:
        self._forks_children = forks_children
        self._process = subprocess.Popen(
            python_module("tests.builders.fork_server", *modules),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**environment, "OPENBLAS_NUM_THREADS": "1"},
            text=True,
        )
        self._children: dict[int, Child] = {}
        self._started: queue.Queue[Child | None] = queue.Queue()
        self._asked: tuple[str, ...] = ()
        self._thread = threading.Thread(target=self._listen, name="fork-server")
        self._thread.start()

    def start(
        self, module: str, words: Sequence[str], environment: Mapping[str, str], out: Path, err: Path | None = None
    ) -> Child:
        """Starts `module` in the current working directory.

        Args:
            module: module to run, as `python -m` does.
            words: arguments.
            environment: all environment variables of the process.
            out: file to which its output is appended.
            err: file to which its errors are appended; by default `out`.
        """
        assert self._process.stdin is not None
        self._asked = (module, *words)
        order = _Order(
            module, [*words], {**environment}, str(Path.cwd()), str(out), str(err or out), self._forks_children
        )
        self._process.stdin.write(json.dumps(asdict(order)) + "\n")
        self._process.stdin.flush()
        child = self._started.get(timeout=_STARTS_WITHIN_S)
        assert child is not None, f"the fork server has ended with {self._process.wait()}"
        return child

    def close(self) -> None:
        """Kills the remaining processes."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write("\n")  # closing stdin is not enough: a fork of this process may keep it open
            self._process.stdin.close()
        self._process.wait()
        self._thread.join()
        self._process.stdout.close()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            what, pid, *status = line.split()
            if what == "started":
                self._children[int(pid)] = child = Child(int(pid), self._asked)
                self._started.put(child)
            else:
                self._children.pop(int(pid)).note_end(int(status[0]))
        self._started.put(None)


def main() -> None:
    """Runs the fork server: reads orders from stdin, reports starts and exits on stdout, kills its children at exit.

    Exits at an empty line or at the end of its input.
    """
    for module in sys.argv[1:]:
        importlib.import_module(module)
    prepare_forks()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C also reaches the owner, which closes stdin
    hear, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    alive = set[int]()
    orders = b""
    while True:
        ready, _, _ = select.select([0, hear], [], [])
        if 0 in ready:
            data = os.read(0, 1 << 16)
            *lines, orders = (orders + data).split(b"\n")
            if not data or b"" in lines:
                break
            for line in lines:
                pid = os.fork()
                if pid == 0:
                    _run_child(_Order(**json.loads(line)), hear, wake)
                alive.add(pid)
                _report(f"started {pid}")
        if hear in ready:
            os.read(hear, 1 << 16)
        _reap(alive)
    for pid in alive:
        os.kill(pid, signal.SIGKILL)
    _reap(alive, 0)


def _reap(alive: set[int], options: int = os.WNOHANG) -> None:
    while alive:
        pid, status = os.waitpid(-1, options)
        if pid == 0:
            return
        alive.remove(pid)
        _report(f"ended {pid} {os.waitstatus_to_exitcode(status)}")


def _report(line: str) -> None:
    os.write(1, f"{line}\n".encode())


def _run_child(order: _Order, *fds: int) -> NoReturn:
    """Runs the ordered module in the forked process as `__main__`, and exits as an interpreter does."""
    os.setsid()
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    nothing = os.open(os.devnull, os.O_RDONLY)
    out, err = (os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600) for path in (order.out, order.err))
    for source, target in ((nothing, 0), (out, 1), (err, 2)):
        os.dup2(source, target)
    for fd in (*fds, nothing, out, err):
        os.close(fd)
    os.chdir(order.folder)
    os.environ.clear()
    os.environ.update(order.environment)
    sys.argv = [order.module, *order.words]
    sys.orig_argv = [sys.executable, "-m", *sys.argv]
    program = sys.modules["__main__"] = importlib.import_module(order.module)
    if order.forks_children:
        fork_children()
    end_after(lambda: sys.exit(program.main()))


if __name__ == "__main__":
    main()
