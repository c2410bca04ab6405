"""Runs a test in a new process that can fork safely.

Earlier tests leave threads (Zenoh, Arrow, Mesa) in the process of pytest. A fork of that process does not contain these
threads, but contains the locks that they held.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import time
import traceback
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection

import pytest

from tests.builders.process_state import children_of

_STACK_S = 1.0
"""Time for one process to write its stacks, seconds. If two processes wrote at the same time, their lines would mix."""


def in_fresh_process(act: Callable[..., object], *args: object, timeout_s: float = 200.0) -> None:
    """Calls a function of a module in a new process; fails with its traceback if it raises.

    Args:
        act: function of a module, because `pickle` sends it by name.
        args: its arguments.
        timeout_s: time after which the process and its forks write their stacks to stderr and are killed.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(theirs, act, args))
    process.start()
    assert process.pid is not None
    theirs.close()
    try:
        if not ours.poll(timeout_s):
            _show_stacks(process.pid)
            pytest.fail(f"no result after {timeout_s:g} s; the stacks are on stderr")
        failure = ours.recv()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()  # the process may not have created its group yet
        process.join()
        ours.close()
    assert not failure, failure


def _show_stacks(pid: int) -> None:
    for each in (pid, *children_of(pid)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(each, signal.SIGUSR1)
        time.sleep(_STACK_S)


def _run(result: Connection, act: Callable[..., object], args: tuple[object, ...]) -> None:
    os.setsid()
    faulthandler.register(signal.SIGUSR1)  # the forks inherit the handler
    try:
        act(*args)
    except BaseException:  # noqa: BLE001 - returned to the test
        result.send(traceback.format_exc())
    else:
        result.send("")
