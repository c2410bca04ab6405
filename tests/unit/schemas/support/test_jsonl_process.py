"""Child processes that write one message per line, with real processes and signals."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from schemas.support.jsonl_process import JsonlProcess, describe_exit

LONG_S = 60.0
Start = Callable[..., JsonlProcess[bytes]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts Python programs and ends them with the test."""
    started: list[JsonlProcess[bytes]] = []

    def begin(program: str, parse: Callable[[bytes], bytes | None] = bytes, **options: int) -> JsonlProcess[bytes]:
        command = (sys.executable, "-u", "-c", program)
        started.append(JsonlProcess(command, dict(os.environ), parse, **options))
        return started[-1]

    yield begin
    for process in started:
        process.kill()


def test_each_sent_line_can_be_answered_with_a_line(start: Start) -> None:
    process = start("import sys\nfor line in sys.stdin: print(line.upper(), end='')")
    for line in (b"one\n", b"two\n"):
        process.send(line)
        assert process.read(LONG_S) == line.upper()


def test_lines_that_are_not_messages_are_skipped(start: Start) -> None:
    process = start("print('noise'); print('{1}'); print('{2}')", parse=lambda line: line if b"{" in line else None)
    assert [process.read(LONG_S), process.read(LONG_S)] == [b"{1}\n", b"{2}\n"]
    with pytest.raises(EOFError):
        process.read(LONG_S)


def test_reading_ends_at_the_timeout_during_endless_noise(start: Start) -> None:
    process = start("while True: print('noise')", parse=lambda line: None)
    assert process.read(0.5) is None


def test_silent_process_gives_nothing_within_the_timeout(start: Start) -> None:
    assert start("import sys; sys.stdin.read()").read(0.05) is None


def test_last_line_without_line_end_is_read(start: Start) -> None:
    process = start("import sys; sys.stdout.write('whole\\npart')")
    assert [process.read(LONG_S), process.read(LONG_S)] == [b"whole\n", b"part"]


def test_line_beyond_the_limit_is_cut(start: Start) -> None:
    process = start("import sys\nwhile True: sys.stdout.write('x' * 1000)", max_line_bytes=5000)
    assert len(process.read(LONG_S) or b"") >= 5000


def test_end_of_the_process_is_reported_with_its_status_and_its_last_line_on_stderr(start: Start) -> None:
    process = start("import sys; print('first\\nlast', file=sys.stderr); sys.exit(7)")
    with pytest.raises(EOFError):
        process.read(LONG_S)
    assert process.last_stderr_line() == "last"
    assert describe_exit(process.wait()) == "exit status 7"


def test_send_to_a_process_that_has_ended_raises_nothing(start: Start) -> None:
    process = start("")
    process.wait()
    process.send(b"order\n")
    with pytest.raises(EOFError):
        process.read(LONG_S)


def test_kill_ends_the_children_of_the_process_too(start: Start) -> None:
    sleeper = "import subprocess, sys; child = subprocess.Popen(['sleep', '600']); print(child.pid); child.wait()"
    process = start(sleeper)
    grandchild = int(process.read(LONG_S) or b"0")
    status = process.kill()
    assert status == -signal.SIGKILL
    assert describe_exit(status) == "killed by SIGKILL"
    assert _ends(grandchild)


def test_kill_from_another_thread_ends_a_read(start: Start) -> None:
    process = start("import sys; sys.stdin.read()")
    killer = threading.Timer(0.2, process.kill)
    killer.start()
    with pytest.raises(EOFError):
        process.read(LONG_S)
    killer.join()
    assert not process.is_running


def test_a_large_stderr_file_is_emptied_before_the_next_message(start: Start) -> None:
    process = start("import sys\nfor line in sys.stdin: sys.stderr.write('x' * (2 << 20)); print(line, end='')")
    for _ in range(4):
        process.send(b"more\n")
        process.read(LONG_S)
    assert os.stat(f"/proc/{process.pid}/fd/2").st_size == 2 << 20


def _ends(pid: int) -> bool:
    """Waits for the end of a killed process, which the kernel carries out when it schedules the process."""
    deadline = time.monotonic() + LONG_S
    while _is_alive(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not _is_alive(pid)


def _is_alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_process_that_ends_after_the_time_limit_of_its_kill_is_reaped(start: Start) -> None:
    process = start("import time\nprint('ready')\nheld = bytearray(64 << 20)\nfor _ in iter(int, 1): time.sleep(60)")
    assert process.read(LONG_S) == b"ready\n"
    process.kill(timeout_s=0.0)
    until = time.monotonic() + LONG_S
    while os.path.exists(f"/proc/{process.pid}") and time.monotonic() < until:
        time.sleep(0.01)
    assert not os.path.exists(f"/proc/{process.pid}"), "the process is still there, or was not reaped"
