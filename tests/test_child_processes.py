"""Checks that a hanging process fails the test that started it and affects no other test."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from tests.builders.fresh_process import in_fresh_process
from tests.builders.process_state import is_gone


def fail() -> None:
    raise ValueError("the reason")


def hang_in_a_fork(path: Path) -> None:
    if os.fork() == 0:
        path.write_text(str(os.getpid()))
    signal.pause()


def test_the_traceback_of_a_new_process_fails_the_test() -> None:
    in_fresh_process(str, 1)
    with pytest.raises(AssertionError, match="ValueError: the reason"):
        in_fresh_process(fail)


def test_a_hanging_process_shows_its_stacks_and_is_killed_with_its_forks(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(pytest.fail.Exception, match="no result after 5 s; the stacks are on stderr"):
        in_fresh_process(hang_in_a_fork, tmp_path / "pid", timeout_s=5)
    assert capfd.readouterr().err.count("in hang_in_a_fork") == 2
    fork = int((tmp_path / "pid").read_text())
    assert any(is_gone(fork) or time.sleep(0.05) for _ in range(200))
