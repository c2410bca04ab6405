"""The status in shared memory: one process writes, another reads, even when the writer is blocked."""

from __future__ import annotations

import os
import subprocess
import sys

from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus

WRITER = """
import sys
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
SharedStatus(int(sys.argv[1])).write(DriverStatus(Activity.ASKING, 12.5, 7, 3.0, 2.5, 2.25, 0.75, 4))
"""


def test_a_process_reads_the_state_that_another_process_wrote() -> None:
    status = SharedStatus.fresh()
    try:
        assert status.read().busy is Activity.STARTING
        command = [sys.executable, "-c", WRITER, str(status.descriptor)]
        subprocess.run(command, pass_fds=(status.descriptor,), check=True)
        assert status.read() == DriverStatus(Activity.ASKING, 12.5, 7, 3.0, 2.5, 2.25, 0.75, 4)
    finally:
        status.close()


BUSY_WRITER = """
import sys, time
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
status, end = SharedStatus(int(sys.argv[1])), time.monotonic() + 2
while time.monotonic() < end:
    for number in range(1, 1000):
        status.write(DriverStatus(Activity.ASKING, *[number] * 7))
"""


def test_reads_of_the_shared_state_are_atomic() -> None:
    status = SharedStatus.fresh()
    try:
        first, read = status.read(), []
        command = [sys.executable, "-c", BUSY_WRITER, str(status.descriptor)]
        with subprocess.Popen(command, pass_fds=(status.descriptor,)) as writer:
            while writer.poll() is None:
                read.append(status.read())
        assert writer.returncode == 0
        changed = [state for state in read if state != first]
        assert changed
        assert [state for state in changed if len(set(state[1:])) != 1] == []
    finally:
        status.close()


def test_a_writer_killed_during_a_write_leaves_the_previous_state() -> None:
    status = SharedStatus.fresh()
    try:
        status.write(DriverStatus(Activity.ASKING, 12.5, 7))
        assert status.read() == DriverStatus(Activity.ASKING, 12.5, 7)
        os.pwrite(status.descriptor, bytes(16), 0)
        assert status.read() == DriverStatus(Activity.ASKING, 12.5, 7)
    finally:
        status.close()
