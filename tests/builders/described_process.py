"""Program that describes its process, so tests can compare a forked process with a new interpreter."""

from __future__ import annotations

import json
import os
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

MODULE = "tests.builders.described_process"
"""Name of this module, also while it runs as `__main__`."""


def describe() -> dict[str, Any]:
    """Returns arguments, IDs, pipes and other properties of this process."""
    return {
        "arguments": sys.argv[1:],
        "module": sys.modules["__main__"].__name__,
        "variable": os.environ.get("ONLY"),
        "folder": str(Path.cwd()),
        "session": os.getsid(0) - os.getpid(),
        "group": os.getpgrp(),
        "parent": os.getppid(),
        "is forked": MODULE not in Path("/proc/self/cmdline").read_text().split("\0"),
        "pipes": [int(link.name) for link in Path("/proc/self/fd").iterdir() if is_added_pipe(link)],
        "handlers": handlers(),
    }


def handlers() -> list[str]:
    """Returns the handlers of SIGINT and SIGTERM. If the parent ignores a signal, so does a new process."""
    return [str(signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM)]


def is_added_pipe(link: Path) -> bool:
    """Returns whether an entry of `/proc/self/fd` is an open pipe other than the standard streams."""
    try:
        return int(link.name) > 2 and str(link.readlink()).startswith("pipe:")
    except OSError:
        return False


def main() -> int:
    """Describes the process after a line of input.

    With the argument `wait`, it waits for a signal instead; with `rename NAME`, it first renames itself.
    """
    if sys.argv[1] == "wait":
        signal.pause()
    if sys.argv[1] == "rename":
        Path("/proc/self/comm").write_text(sys.argv[2])
        sys.stdout.write("renamed\n")
        sys.stdout.flush()
        signal.pause()
    seen = describe() | {"input": sys.stdin.readline()}
    os.write(int(sys.argv[2]), json.dumps(seen).encode())
    sys.stdout.write("printed")
    return 7


def report(connection: Connection) -> None:
    """Sends the description of the process; target function of a process of `multiprocessing`."""
    connection.send(describe())


if __name__ == "__main__":
    sys.exit(main())
