"""Permitted operations of a confined process: real processes, real system calls."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from coordinator.validation.sandbox import RLIMITS, SECCOMP
from coordinator.validation.validator import Validator
from schemas.errors import InvalidBundle
from tests.builders.bundle import job_for

SCRIPT = """
import ctypes, mmap, os, signal, socket, subprocess, sys, threading
from pathlib import Path
from coordinator.validation.sandbox import confine
folder = Path(sys.argv[1])
inherited = open(folder / "bundle", "rb")
print(*confine(2 << 30), flush=True)
try:
    eval(sys.argv[2])
except (OSError, RuntimeError, ValueError) as error:
    print("refused:", error)
else:
    print("done")
"""
FORBIDDEN = {
    "a network socket": "socket.socket()",
    "a Unix socket": "socket.socket(socket.AF_UNIX)",
    "a pair of sockets": "socket.socketpair()",
    "reading a secret": "open(folder / 'secret').read()",
    "reading a system file": "os.open('/etc/passwd', os.O_RDONLY)",
    "listing a folder": "os.listdir(folder)",
    "looking for a file": "os.stat(folder / 'secret')",
    "writing a file": "os.open(folder / 'new', os.O_CREAT | os.O_WRONLY)",
    "deleting a file": "os.unlink(folder / 'secret')",
    "renaming a file": "os.rename(folder / 'secret', folder / 'other')",
    "a link": "os.symlink('/etc', folder / 'etc')",
    "permissions": "os.chmod(folder / 'secret', 0o777)",
    "another program": "os.execv('/bin/true', ['true'])",
    "a child process": "os.fork()",
    "a program in a child": "subprocess.run(['/bin/true'])",
    "a thread": "threading.Thread(target=print).start()",
    "a signal": "os.kill(os.getppid(), signal.SIGTERM)",
    "code in memory": "mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_EXEC)",
    "another user": "os.setuid(1000)",
    "more memory": "__import__('resource').setrlimit(__import__('resource').RLIMIT_AS, (-1, -1))",
}
ALLOWED = {
    "reading the inherited file": "inherited.read()",
    "allocating memory": "bytearray(64 << 20)",
    "computing a hash": "hash('x')",
}


def outcome(folder: Path, action: str) -> tuple[list[str], str]:
    """Returns the active limits of a new process and the result of an action in it."""
    (folder / "secret").write_text("token")
    (folder / "bundle").write_bytes(b"frames")
    command = [sys.executable, "-c", SCRIPT, str(folder), action]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=Path(__file__).parents[4])
    layers, _, result = run.stdout.partition("\n")
    assert result, run.stderr
    return layers.split(), result.strip()


@pytest.mark.parametrize("operation", FORBIDDEN)
def test_a_confined_process_cannot_execute_a_forbidden_operation(operation: str, tmp_path: Path) -> None:
    layers, result = outcome(tmp_path, FORBIDDEN[operation])
    if SECCOMP not in layers:
        pytest.skip("no seccomp here: pyseccomp, libseccomp2 or the kernel's filters are missing")
    assert result.startswith("refused:"), result
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bundle", "secret"]


@pytest.mark.parametrize("operation", ALLOWED)
def test_a_confined_process_can_execute_an_allowed_operation(operation: str, tmp_path: Path) -> None:
    layers, result = outcome(tmp_path, ALLOWED[operation])
    assert RLIMITS in layers
    assert result == "done"


def test_limits_apply_without_the_library_and_the_log_names_the_missing_part(tmp_path: Path) -> None:
    (tmp_path / "pyseccomp.py").write_text("raise ImportError('not installed')")
    (tmp_path / "ep_000001.zip").write_bytes(b"rubbish")
    code = (
        "from pathlib import Path; from coordinator.validation.validator import Validator\n"
        "from tests.builders.bundle import job_for\n"
        f"with Validator() as validator: validator.check(Path({str(tmp_path / 'ep_000001.zip')!r}), job_for())"
    )
    root = Path(__file__).parents[4]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(root)])}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120, cwd=root
    )
    assert "bundle refused" in run.stderr
    assert "active=rlimits" in run.stdout.replace("'", "")
    assert "libseccomp2" in run.stdout


def test_a_pipe_instead_of_a_bundle_is_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "ep_000001.zip")
    with Validator() as validator, pytest.raises(InvalidBundle, match="not a regular file"):
        validator.check(tmp_path / "ep_000001.zip", job_for())
