"""A process of the fork server behaves like a process of a new interpreter."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

import pytest

from tests.builders.fork_server import ForkServer


def main() -> int:
    """Program of a test: prints its arguments and environment, and ends in the way that its first argument names."""
    sys.stdout.write(json.dumps([sys.argv[1:], dict(os.environ), str(Path.cwd()), os.getsid(0) == os.getpid()]) + "\n")
    sys.stdout.flush()
    sys.stderr.write(sys.modules["__main__"].__name__ + "\n")
    if sys.argv[1] == "killed":
        os.kill(os.getpid(), signal.SIGTERM)
    if sys.argv[1] == "interrupted":
        os.kill(os.getpid(), signal.SIGINT)
    if sys.argv[1] == "sleeping":
        signal.pause()
    return 7


@pytest.fixture(scope="module")
def server():
    with ForkServer([__name__], os.environ) as started:
        yield started


@pytest.mark.parametrize(("how", "status"), [("returned", 7), ("killed", -15), ("interrupted", -2)])
def test_a_process_has_its_own_arguments_environment_folder_session_files_and_status(
    server, tmp_path, monkeypatch, how, status
):
    monkeypatch.chdir(tmp_path)
    child = server.start(__name__, [how, "a b"], {"ONLY": "this\n"}, tmp_path / "out", tmp_path / "err")
    assert child.wait(60) == child.poll() == status
    found = json.loads((tmp_path / "out").read_text())
    assert found == [[how, "a b"], {"ONLY": "this\n"}, str(tmp_path), True]
    assert (tmp_path / "err").read_text().startswith(f"{__name__}\n")
    assert ("KeyboardInterrupt" in (tmp_path / "err").read_text()) == (how == "interrupted")


def test_output_is_appended_and_errors_go_to_the_same_file_by_default(server, tmp_path):
    for _ in range(2):
        server.start(__name__, ["returned"], {}, tmp_path / "log").wait(60)
    lines = (tmp_path / "log").read_text().splitlines()
    assert [line for line in lines if line == __name__] == [__name__] * 2
    assert len(lines) == 4


def test_the_end_of_the_server_kills_its_processes(tmp_path):
    with ForkServer([__name__], os.environ) as server:
        child = server.start(__name__, ["sleeping"], {}, tmp_path / "log")
    assert child.wait(60) == -signal.SIGKILL
