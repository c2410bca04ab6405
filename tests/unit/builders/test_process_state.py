"""Changes that a test makes to its process are restored and reported."""

from __future__ import annotations

import logging
import os
import resource
import signal
from pathlib import Path

import pytest
import structlog

from factory.support.logs import configure_logs
from tests.builders.process_state import ProcessState, unchanged_process


def change_folder() -> None:
    os.chdir("/")


def change_handler() -> None:
    signal.signal(signal.SIGUSR1, lambda *_: None)


def change_level() -> None:
    logging.root.setLevel(logging.DEBUG)


def disable_logging() -> None:
    logging.disable(logging.CRITICAL)


def lower_limit() -> None:
    _soft, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**40, hard))


def enter_and_remove(folder: Path) -> None:
    folder.mkdir()
    os.chdir(folder)
    folder.rmdir()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (change_folder, "working directory"),
        (change_handler, "SIGUSR1"),
        (change_level, "logging"),
        (disable_logging, "logging"),
        (lower_limit, "resource limit"),
    ],
)
def test_leftover_changes_of_a_test_are_restored_and_reported(change, named):
    before = ProcessState.now()
    with pytest.raises(AssertionError, match=named), unchanged_process():
        change()
    assert ProcessState.now() == before


def test_a_removed_working_directory_is_restored(tmp_path):
    before = Path.cwd()
    with pytest.raises(AssertionError, match="working directory"), unchanged_process():
        enter_and_remove(tmp_path / "gone")
    assert Path.cwd() == before


def test_structlog_settings_of_a_command_are_reset_after_the_test():
    with unchanged_process():
        configure_logs()
        structlog.contextvars.bind_contextvars(job=1)
    assert not structlog.is_configured()
    assert structlog.contextvars.get_contextvars() == {}


def test_variables_are_restored_silently(monkeypatch):
    monkeypatch.setenv("MINIVLA_CHANGED", "before")
    before = dict(os.environ)
    with unchanged_process():
        os.environ |= {"MINIVLA_NEW": "1", "MINIVLA_CHANGED": "after"}
        del os.environ["HOME"]
    assert dict(os.environ) == before


def test_the_limit_of_open_files_that_a_coordinator_raises_is_restored_silently():
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    with unchanged_process():
        resource.setrlimit(resource.RLIMIT_NOFILE, (before[0] - 1, before[1]))
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == before
