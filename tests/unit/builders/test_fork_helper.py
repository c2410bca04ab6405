"""A process forked by the helper behaves like a process of a new interpreter, as a child of its requester."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from schemas.support.child import python_module
from tests.acceptance.factory_cli import wait_for
from tests.builders import fork_helper
from tests.builders.described_process import MODULE, handlers, report
from tests.builders.fresh_process import in_fresh_process
from tests.builders.process_state import children_of, is_gone

ROOT = Path(__file__).parents[3]
FORKED_OF_THE_PRODUCT = {module for module in fork_helper.FORKED if not module.startswith("tests.")}


@pytest.fixture(autouse=True)
def new_interpreters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the processes of these tests start without a helper; a test starts a helper itself."""
    monkeypatch.setenv(fork_helper.NEW_INTERPRETER, "1")


def begin() -> None:
    """Lets this process fork its children; first opens its standard input, which multiprocessing has replaced."""
    sys.stdin = os.fdopen(0, closefd=False)
    name = Path("/proc/self/comm").read_bytes()
    fork_helper.fork_children({MODULE})
    assert Path("/proc/self/comm").read_bytes() == name


def begin_with_threads() -> None:
    """Lets a process that has a thread fork its children."""
    sys.stdin = os.fdopen(0, closefd=False)
    threading.Thread(target=threading.Event().wait, daemon=True).start()
    fork_helper.fork_children_from_interpreter(("decimal",), {MODULE})


def start(*words: str, fds: tuple[int, ...] = (), **options: Any) -> subprocess.Popen[str]:
    command = python_module(MODULE, *words)
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=fds,
        text=True,
        start_new_session=True,
        **options,
    )


def expect_a_module(begins: Callable[[], None], folder: Path, variables: dict[str, str], is_forked: bool) -> None:
    begins()
    read, write = os.pipe()
    process = start("describe", str(write), fds=(write,), env={**os.environ, **variables, "ONLY": "this\n"}, cwd=folder)
    os.close(write)
    assert process.communicate("a line\n") == ("printed", None)
    assert process.returncode == 7
    assert json.loads(os.read(read, 1 << 16)) == {
        "arguments": ["describe", str(write)],
        "module": "__main__",
        "variable": "this\n",
        "folder": str(folder),
        "session": 0,
        "group": process.pid,
        "parent": os.getpid(),
        "is forked": is_forked,
        "pipes": [write],
        "handlers": handlers(),
        "input": "a line\n",
    }
    assert os.read(read, 1) == b""  # no other process holds the pipe


@pytest.mark.parametrize("begins", [begin, begin_with_threads])
@pytest.mark.parametrize(
    "variables",
    [
        {},
        {"PYTHONPATH": str(ROOT)},
        {"PYTHONSAFEPATH": "1"},
        {"PYTHONDONTWRITEBYTECODE": "yes"},
        {"PYTHONUNBUFFERED": "yes"},
        {"PYTHON": sys.executable},
        {"PYTHON_VERSION": "3.11.2"},
    ],
)
def test_a_forked_module_has_its_own_arguments_variables_folder_session_descriptors_and_status(
    tmp_path, begins, variables
):
    in_fresh_process(expect_a_module, begins, tmp_path, variables, True)


@pytest.mark.parametrize("begins", [begin, begin_with_threads])
@pytest.mark.parametrize(("name", "value"), [("PYTHONHASHSEED", "1"), ("LD_LIBRARY_PATH", "/")])
def test_a_variable_that_is_read_only_at_process_start_prevents_a_fork(tmp_path, begins, name, value):
    variables = {name: value, "PYTHONPATH": str(ROOT)}
    in_fresh_process(expect_a_module, begins, tmp_path, variables, False)


def expect_a_killed_child(begins: Callable[[], None]) -> None:
    """The signal may arrive before the process runs its program."""
    begins()
    process = start("wait")
    assert children_of(os.getpid()) == {process.pid}
    process.terminate()
    assert process.wait(60) == -signal.SIGTERM
    assert is_gone(process.pid)


@pytest.mark.parametrize("begins", [begin, begin_with_threads])
def test_a_forked_process_is_a_child_that_can_be_killed_and_waited_for(begins):
    in_fresh_process(expect_a_killed_child, begins)


def expect_a_child_with_the_name_of_the_helper() -> None:
    begin()
    process = start("rename", fork_helper.NAME)
    assert process.stdout is not None
    assert process.stdout.readline() == "renamed\n"
    assert children_of(os.getpid()) == {process.pid}
    process.kill()
    process.wait(60)


def test_a_process_that_starts_its_own_helper_is_found_as_a_child():
    in_fresh_process(expect_a_child_with_the_name_of_the_helper)


def expect_programs_with_another_identity() -> None:
    begin()
    for options in ({"umask": 0o077}, {"extra_groups": os.getgroups()}):
        with contextlib.suppress(PermissionError):  # only root sets groups
            printed = subprocess.run(["sh", "-c", "umask"], stdout=subprocess.PIPE, check=True, **options).stdout
            assert (printed == b"0077\n") == ("umask" in options)


def test_programs_with_other_groups_or_another_umask_are_started_with_them():
    in_fresh_process(expect_programs_with_another_identity)


def expect_a_process_of_multiprocessing() -> None:
    begin()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=report, args=(theirs,))
    process.start()
    seen = ours.recv()
    process.join(60)
    assert process.exitcode == 0
    assert (seen["parent"], seen["is forked"], seen["group"]) == (os.getpid(), True, os.getpgrp())


def test_a_process_of_multiprocessing_is_forked_too():
    in_fresh_process(expect_a_process_of_multiprocessing)


def direct_children() -> set[str]:
    return {*Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}


def leave_a_helper(path: Path, begins: Callable[[], None]) -> None:
    others = direct_children()
    begins()
    process = start("wait")
    (helper,) = direct_children() - others - {str(process.pid)}
    process.kill()
    path.write_text(helper)
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("begins", [begin, begin_with_threads])
def test_the_helper_ends_with_its_owner(tmp_path, begins):
    """The owner is killed, so it cannot end its helper."""
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=leave_a_helper, args=(tmp_path / "pid", begins))
    process.start()
    process.join(60)
    assert process.exitcode == -signal.SIGKILL
    wait_for(lambda: is_gone(int((tmp_path / "pid").read_text())))


def started_modules(*packages: str) -> set[str]:
    return {
        module
        for package in packages
        for path in (ROOT / package).rglob("*.py")
        for module in re.findall(r'python_module\(\s*"([^"]+)"', path.read_text())
    }


def test_every_module_that_the_product_starts_is_forked():
    assert started_modules("coordinator", "factory", "workers") == FORKED_OF_THE_PRODUCT


def test_every_module_of_the_tests_that_is_forked_is_started_by_a_test():
    of_tests = {module for module in started_modules("tests") if module.startswith("tests.")}
    assert of_tests == fork_helper.FORKED - FORKED_OF_THE_PRODUCT


@pytest.mark.parametrize("module", sorted(FORKED_OF_THE_PRODUCT - {"factory"} | {"factory.__main__"}))
def test_a_new_interpreter_imports_each_forked_module_first(module):
    """Forks have all modules imported already, which would hide an import that works in one order only."""
    command = [sys.executable, "-P", "-c", f"import {module}"]
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
