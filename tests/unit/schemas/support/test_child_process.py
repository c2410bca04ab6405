"""Child processes that write one message per line, with real processes and signals."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from schemas.support.child_process import ChildProcess, Ended
from tests.builders.process_state import is_gone

LONG_S = 60.0
ECHO = "import sys\nfor line in sys.stdin: print(line, end='')"
SILENT = "import sys; sys.stdin.read()"
OWNER = f"""
import os, sys, time
from schemas.support.child_process import ChildProcess
process = ChildProcess(bytes)
process.start((sys.executable, "-c", {SILENT!r}), os.environ)
print(process.pid, flush=True)
time.sleep(600)
"""
Start = Callable[..., ChildProcess[bytes]]


def run(process: ChildProcess[Any], program: str) -> None:
    process.start((sys.executable, "-u", "-c", program), os.environ)


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts Python programs and ends them with the test."""
    started: list[ChildProcess[bytes]] = []

    def begin(program: str, parse: Callable[[bytes], bytes | None] = bytes, **options: Any) -> ChildProcess[bytes]:
        started.append(ChildProcess(parse, **options))
        run(started[-1], program)
        return started[-1]

    yield begin
    for process in started:
        process.kill()


def end_of(process: ChildProcess[Any]) -> Ended:
    """Waits for the end of a process that sends no more messages."""
    end = process.wait()
    assert isinstance(end, Ended)
    return end


def ends(pid: int) -> bool:
    """Waits for the end of a killed process, which the kernel carries out when it schedules the process."""
    deadline = time.monotonic() + LONG_S
    while not is_gone(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    return is_gone(pid)


def test_each_sent_line_can_be_answered_with_a_line(start: Start) -> None:
    process = start("import sys\nfor line in sys.stdin: print(line.upper(), end='')")
    for line in (b"one\n", b"two\n"):
        process.send(line)
        assert process.receive(LONG_S) == line.upper()


def test_a_message_may_carry_open_files(start: Start, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("content")
    process = start(
        "import os, socket\n"
        "text, (file,), *_ = socket.recv_fds(socket.socket(fileno=0), 5, 1)\n"
        "print(text.decode(), os.read(file, 99).decode())"
    )
    with (tmp_path / "file").open("rb") as file:
        process.send(b"order", [file.fileno()])
    assert process.receive(LONG_S) == b"order content\n"


def test_lines_that_are_not_messages_are_skipped(start: Start) -> None:
    process = start("print('noise'); print('{1}'); print('{2}')", parse=lambda line: line if b"{" in line else None)
    assert [process.receive(LONG_S), process.receive(LONG_S)] == [b"{1}\n", b"{2}\n"]
    assert end_of(process).status == 0


def test_last_line_without_line_end_is_read(start: Start) -> None:
    process = start("import sys; sys.stdout.write('whole\\npart')")
    assert [process.receive(LONG_S), process.receive(LONG_S)] == [b"whole\n", b"part"]


def test_line_beyond_the_limit_is_cut(start: Start) -> None:
    process = start("import sys\nwhile True: sys.stdout.write('x' * 1000)", max_line_bytes=5000)
    answer = process.receive(LONG_S)
    assert isinstance(answer, bytes)
    assert len(answer) >= 5000


def test_the_end_has_the_exit_status_and_the_last_line_on_stderr(start: Start) -> None:
    process = start("import sys; print('first\\nlast', file=sys.stderr); sys.exit(7)")
    pid = process.pid
    end = end_of(process)
    assert end == Ended(pid or 0, status=7, last_output="last")
    assert (end.description, end.is_hung, end.is_from_outside) == ("exit status 7", False, False)
    assert (process.pid, process.is_started, process.is_alive) == (None, False, False)


def test_the_end_is_returned_again_until_the_next_start(start: Start) -> None:
    process = start("raise SystemExit(7)")
    end = end_of(process)
    assert process.receive(LONG_S) is end
    assert process.kill() is None
    run(process, "print('again')")
    assert process.receive(LONG_S) == b"again\n"


def test_a_process_that_was_not_started_has_no_messages() -> None:
    with pytest.raises(RuntimeError, match="before start"):
        ChildProcess(bytes).receive(LONG_S)


def test_a_command_that_does_not_exist_is_an_error_and_leaves_nothing_open() -> None:
    before = len(os.listdir("/proc/self/fd"))
    process = ChildProcess(bytes)
    with pytest.raises(FileNotFoundError):
        process.start(("/nowhere/program",), {})
    assert not process.is_started
    assert len(os.listdir("/proc/self/fd")) == before


def test_no_descriptor_stays_open_after_the_end(start: Start) -> None:
    before = len(os.listdir("/proc/self/fd"))
    end_of(start(""))
    assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize("program", ["raise SystemExit(7)", SILENT])
def test_ends_before_the_first_message_are_counted_until_a_message_comes(start: Start, program: str) -> None:
    process = start(program, start_s=0.2)
    end_of(process)
    run(process, program)
    end_of(process)
    assert process.failed_starts == 2
    run(process, "print('ready')")
    assert process.receive(LONG_S) == b"ready\n"
    assert process.failed_starts == 0
    end_of(process)
    assert process.failed_starts == 0


def test_a_wanted_end_is_not_a_failed_start(start: Start) -> None:
    process = start(SILENT)
    process.kill()
    assert process.failed_starts == 0


def test_a_process_that_hangs_silently_is_killed_at_its_limit(start: Start) -> None:
    process = start(ECHO, start_s=LONG_S, silence_s=0.2)
    pid = process.pid or 0
    process.send(b"one\n")
    assert process.wait() == b"one\n"
    process.send(b"no line end")
    assert process.receive(0.1) is None
    end = end_of(process)
    assert (end.is_hung, end.limit_s, end.is_killed, end.description) == (True, 0.2, True, "killed by SIGKILL")
    assert 0.2 <= end.silence_s < LONG_S
    assert is_gone(pid)


def test_only_the_time_that_the_owner_waits_counts_as_silence(start: Start) -> None:
    process = start(SILENT, start_s=0.5)
    for _ in range(3):
        time.sleep(0.5)
        assert process.receive(0.1) is None


def test_a_stopped_process_that_does_not_read_is_hung(start: Start) -> None:
    process = start("import sys, time\nprint('ready', flush=True)\nsys.stdin.read()", silence_s=0.3)
    assert process.wait() == b"ready\n"
    os.kill(process.pid or 0, signal.SIGSTOP)
    process.send(bytes(16 << 20))
    assert end_of(process).is_hung


def test_receiving_ends_at_the_timeout_while_a_process_floods_its_output(start: Start) -> None:
    process = start("while True: print('noise')", parse=lambda line: None)
    begin_s = time.monotonic()
    assert process.receive(0.5) is None
    assert time.monotonic() - begin_s < LONG_S


def test_a_flood_of_lines_that_are_not_messages_is_a_silence(start: Start) -> None:
    assert end_of(start("while True: print('noise')", parse=lambda line: None, start_s=0.3)).is_hung


def test_send_to_a_process_that_has_ended_raises_nothing(start: Start) -> None:
    process = start("raise SystemExit(7)")
    while process.is_alive:
        time.sleep(0.01)
    process.send(b"order\n")
    assert end_of(process).status == 7
    process.send(b"order\n")


@pytest.mark.parametrize(
    ("number", "is_from_outside"), [(signal.SIGTERM, True), (signal.SIGUSR1, True), (signal.SIGKILL, False)]
)
def test_a_process_killed_from_outside_is_reported_with_its_signal(
    start: Start, number: signal.Signals, is_from_outside: bool
) -> None:
    process = start(f"print('ready', flush=True)\n{SILENT}")
    assert process.receive(LONG_S) == b"ready\n"
    os.kill(process.pid or 0, number)
    end = end_of(process)
    assert (end.description, end.is_from_outside) == (f"killed by {number.name}", is_from_outside)


def test_a_process_that_closes_its_stdout_is_killed(start: Start) -> None:
    process = start("import os, time\nos.close(1)\ntime.sleep(600)", reap_s=0.2)
    assert end_of(process).is_killed


def test_kill_from_another_thread_ends_a_receive(start: Start) -> None:
    process = start(SILENT)
    ends: list[Ended | None] = []
    killer = threading.Timer(0.2, lambda: ends.append(process.kill()))
    killer.start()
    end = end_of(process)
    killer.join()
    assert end.is_killed
    assert ends in ([end], [None])  # None if the other thread has already returned the end
    assert not process.is_alive


def test_kill_ends_the_children_of_the_process_too(start: Start) -> None:
    sleeper = "import subprocess, sys; child = subprocess.Popen(['sleep', '600']); print(child.pid); child.wait()"
    process = start(sleeper)
    grandchild = process.receive(LONG_S)
    end = process.kill()
    assert end is not None
    assert end.is_killed
    assert isinstance(grandchild, bytes)
    assert ends(int(grandchild))


def test_children_that_a_process_leaves_behind_are_killed(start: Start) -> None:
    leaver = "import subprocess; print(subprocess.Popen(['sleep', '600'], stdout=subprocess.DEVNULL).pid)"
    process = start(leaver)
    grandchild = process.receive(LONG_S)
    assert end_of(process).status == 0
    assert isinstance(grandchild, bytes)
    assert ends(int(grandchild))


def test_the_input_of_a_process_ends_when_its_owner_is_killed() -> None:
    with subprocess.Popen((sys.executable, "-c", OWNER), stdout=subprocess.PIPE) as owner:
        assert owner.stdout is not None
        pid = int(owner.stdout.readline())
        owner.kill()
    assert ends(pid)


def test_a_process_has_its_own_session_so_a_terminal_does_not_interrupt_it(start: Start) -> None:
    process = start(SILENT)
    assert os.getsid(process.pid or 0) == process.pid


def test_a_process_may_exit_by_itself_when_its_input_ends(start: Start) -> None:
    end = start(f"{SILENT}; sys.exit(5)", leave_s=LONG_S).kill()
    assert end is not None
    assert end.status == 5


def test_a_process_that_does_not_exit_when_its_input_ends_is_killed(start: Start) -> None:
    process = start("import time\nprint('ready', flush=True)\ntime.sleep(600)", leave_s=0.2)
    process.wait()
    process.end_input()
    end = process.kill()
    assert end is not None
    assert end.is_killed


def test_a_process_without_messages_writes_to_stderr_and_has_only_an_end(capfd: pytest.CaptureFixture[str]) -> None:
    process = ChildProcess(None, stderr="inherit")
    run(process, "import sys; print('output'); sys.stdin.read(); sys.exit(3)")
    assert process.receive(0.1) is None
    process.end_input()
    assert end_of(process).status == 3
    assert capfd.readouterr().err == "output\n"


def test_a_large_stderr_file_is_emptied_before_the_next_message(start: Start) -> None:
    process = start("import sys\nfor line in sys.stdin: sys.stderr.write('x' * (2 << 20)); print(line, end='')")
    for _ in range(4):
        process.send(b"more\n")
        process.receive(LONG_S)
    assert os.stat(f"/proc/{process.pid}/fd/2").st_size == 2 << 20


def test_a_process_that_ends_after_the_time_limit_of_its_kill_is_reaped(start: Start) -> None:
    program = "import time\nprint('ready')\nheld = bytearray(64 << 20)\nfor _ in iter(int, 1): time.sleep(60)"
    process = start(program, reap_s=0.0)
    pid = process.pid
    assert process.receive(LONG_S) == b"ready\n"
    end = process.kill()
    assert end is not None
    assert (end.status, end.description) == (-signal.SIGKILL, "killed by SIGKILL")
    until = time.monotonic() + LONG_S
    while os.path.exists(f"/proc/{pid}") and time.monotonic() < until:
        time.sleep(0.01)
    assert not os.path.exists(f"/proc/{pid}"), "the process is still there, or was not reaped"


def test_a_fork_of_the_owner_releases_the_process_and_does_not_end_it(start: Start) -> None:
    process = start(ECHO)
    process.send(b"before\n")
    assert process.wait() == b"before\n"
    fork = multiprocessing.get_context("fork").Process(target=process.release_in_fork)
    fork.start()
    fork.join(LONG_S)
    assert fork.exitcode == 0
    process.send(b"after\n")
    assert process.wait() == b"after\n"
