"""The sheet in shared memory: what one process writes, another reads, even when the writer is stuck."""

from __future__ import annotations

import subprocess
import sys

from factory.eval.sheet import Busy, Sheet, State

WRITER = """
import sys
from factory.eval.sheet import Busy, Sheet, State
Sheet(int(sys.argv[1])).write(State(Busy.ASKING, 12.5, 7, 3.0, 2.5, 2.25, 0.75, 4))
"""


def test_what_another_process_wrote_is_read_here() -> None:
    sheet = Sheet.fresh()
    try:
        assert sheet.read().busy is Busy.STARTING
        command = [sys.executable, "-c", WRITER, str(sheet.descriptor)]
        subprocess.run(command, pass_fds=(sheet.descriptor,), check=True)
        assert sheet.read() == State(Busy.ASKING, 12.5, 7, 3.0, 2.5, 2.25, 0.75, 4)
    finally:
        sheet.close()
