"""Runs a worker for a test: in a thread for tests that read its events, as a process for tests that send signals."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from schemas.support.child import python_module
from tests.builders import fake_simulation
from workers.client.settings import WorkerSettings
from workers.client.stopping import stop_on_signals
from workers.client.supervisor import run_worker


def fake_command(folder: Path, *more: str) -> tuple[str, ...]:
    """Returns the command line of the fake simulation; it writes its markers to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    return (sys.executable, "-S", str(fake_simulation.__file__), str(folder), *more)


def settings_for(endpoint: str, folder: Path, **changes: Any) -> WorkerSettings:
    """Returns the settings of a fast worker with all files below `folder`."""
    values: dict[str, Any] = {
        "connect": tuple(endpoint.split(",")),
        "spool_dir": folder / "spool",
        "scene_dir": folder / "scenes",
        "host": "test-host",
        "hang_s": 30.0,
        "wait_s": 20.0,
        "min_free_bytes": 0,
        "command": fake_command(folder / "started"),
    }
    return WorkerSettings(**values | changes)


class WorkerThread:
    """A worker in a thread of this process. The end of the `with` block stops it; `join` raises its exception."""

    def __init__(self, settings: WorkerSettings) -> None:
        self.stop, self.at_once = threading.Event(), threading.Event()
        self.status: int | None = None
        self.error: BaseException | None = None
        self._settings = settings
        self._thread = threading.Thread(target=self._run)

    def join(self) -> int:
        """Waits for the end of the worker and returns its exit status, or raises its exception."""
        self._thread.join(60)
        assert not self._thread.is_alive(), "the worker does not end"
        if self.error is not None:
            raise self.error
        assert self.status is not None
        return self.status

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.at_once.set()
        self.stop.set()
        self._thread.join(60)

    def _run(self) -> None:
        try:
            self.status = run_worker(self._settings, self.stop, self.at_once)
        except BaseException as error:  # noqa: BLE001 - raised again by join
            self.error = error


@contextmanager
def started_worker(settings: WorkerSettings) -> Iterator[subprocess.Popen[bytes]]:
    """Starts a worker in a separate process, which is killed at the end of the `with` block."""
    arguments = (settings.connect[0], str(settings.spool_dir.parent), str(settings.cores), *settings.command)
    process = subprocess.Popen(python_module("tests.builders.worker", *arguments))
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def main() -> int:
    """Runs a worker. Arguments: `[--host HOST] ENDPOINT FOLDER CORES SIMULATION...`."""
    words = sys.argv[1:]
    named = {"host": words[1]} if words[0] == "--host" else {}
    endpoint, folder, cores, *command = words[2 * len(named) :]
    settings = settings_for(endpoint, Path(folder), cores=int(cores), command=tuple(command), **named)
    with stop_on_signals() as (stop, at_once):
        return run_worker(settings, stop, at_once)


if __name__ == "__main__":
    sys.exit(main())
