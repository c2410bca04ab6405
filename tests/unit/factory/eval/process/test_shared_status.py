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
    sheet = SharedStatus.fresh()
    try:
        assert sheet.read().busy is Activity.STARTING
        command = [sys.executable, "-c", WRITER, str(sheet.descriptor)]
        subprocess.run(command, pass_fds=(sheet.descriptor,), check=True)
        assert sheet.read() == DriverStatus(Activity.ASKING, 12.5, 7, 3.0, 2.5, 2.25, 0.75, 4)
    finally:
        sheet.close()


BUSY_WRITER = """
import sys, time
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
sheet, end = SharedStatus(int(sys.argv[1])), time.monotonic() + 2
while time.monotonic() < end:
    for number in range(1, 1000):
        sheet.write(DriverStatus(Activity.ASKING, *[number] * 7))
"""


def test_reads_of_the_shared_state_are_atomic() -> None:
    sheet = SharedStatus.fresh()
    try:
        first, read = sheet.read(), []
        command = [sys.executable, "-c", BUSY_WRITER, str(sheet.descriptor)]
        with subprocess.Popen(command, pass_fds=(sheet.descriptor,)) as writer:
            while writer.poll() is None:
                read.append(sheet.read())
        assert writer.returncode == 0
        changed = [state for state in read if state != first]
        assert changed
        assert [state for state in changed if len(set(state[1:])) != 1] == []
    finally:
        sheet.close()


def test_a_writer_killed_during_a_write_leaves_the_previous_state() -> None:
    sheet = SharedStatus.fresh()
    try:
        sheet.write(DriverStatus(Activity.ASKING, 12.5, 7))
        assert sheet.read() == DriverStatus(Activity.ASKING, 12.5, 7)
        os.pwrite(sheet.descriptor, bytes(16), 0)
        assert sheet.read() == DriverStatus(Activity.ASKING, 12.5, 7)
    finally:
        sheet.close()
