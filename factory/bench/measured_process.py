"""Starts a process that a benchmark measures, and terminates it when the benchmark ends."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

from schemas.support.child import child_environment
from workers.client.stopping import signals_deferred


@contextmanager
def measured_process(command: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Yields a process that gets SIGTERM at the end of the block, even if a signal interrupts its start.

    Args:
        command: command line.
        options: options of `subprocess.Popen`.
    """
    with ExitStack() as stack:
        with signals_deferred():
            process = stack.enter_context(subprocess.Popen(command, env=child_environment(os.environ), **options))
            stack.callback(process.terminate)
        yield process
