"""Kills a process that writes to the archive: every archived episode is intact, no partial file has an episode name."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from coordinator.archive.opening import open_archive

_WRITER = """
import hashlib, sys
from pathlib import Path
from coordinator.archive.opening import open_archive
with open_archive(Path(sys.argv[1])) as archive:
    for index in range(int(sys.argv[2]), 100000):
        with archive.stage(index) as staged:
            for block in range(8):
                staged.write(hashlib.sha256(b"%d.%d" % (index, block)).digest() * 1000)
            archive.publish(staged, index)
        print(index, flush=True)
"""


def content(index: int) -> bytes:
    return b"".join(hashlib.sha256(b"%d.%d" % (index, block)).digest() * 1000 for block in range(8))


def test_killed_writer_leaves_only_whole_episodes(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    following = 1
    for _ in range(6):
        command = [sys.executable, "-c", _WRITER, tmp_path, str(following)]
        writer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert writer.stdout is not None
        reported = [int(writer.stdout.readline())]  # the writer has started
        time.sleep(float(rng.uniform(0, 0.1)))
        writer.kill()
        reported += [int(line) for line in writer.stdout if line.endswith("\n")]
        writer.stdout.close()
        writer.wait()
        with open_archive(tmp_path) as archive:
            present = archive.present()
            assert list((tmp_path / ".staging").iterdir()) == []
        assert set(reported) <= set(present)
        assert all(path.read_bytes() == content(index) for index, path in present.items() if index >= following)
        following = max(present) + 1
