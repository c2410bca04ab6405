"""The lock of a directory, which can be checked without blocking a coordinator, and the part files."""

from __future__ import annotations

import ctypes
import mmap
import os
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from coordinator.archive.staging import Staging, is_held
from schemas.errors import WorldError
from schemas.storage.shards import MAX_PACKED_BYTES

HOLD = """
import sys
from pathlib import Path
from coordinator.archive.staging import Staging
Staging(Path(sys.argv[1]), "dataset")
print("held", flush=True)
sys.stdin.read()
"""


def test_a_directory_is_locked_until_its_coordinator_is_killed(tmp_path: Path) -> None:
    assert is_held(tmp_path) is False
    command = [sys.executable, "-c", HOLD, tmp_path]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        assert is_held(tmp_path) is True
        with pytest.raises(WorldError, match=f"another coordinator works on dataset .pid {holder.pid}"):
            Staging(tmp_path, "dataset")
        holder.kill()
    assert is_held(tmp_path) is False


def test_checking_the_lock_never_prevents_a_coordinator_from_taking_the_lock(tmp_path: Path) -> None:
    Staging(tmp_path, "dataset").close()
    ended = threading.Event()

    def ask() -> None:
        while not ended.is_set():
            is_held(tmp_path)

    askers = [threading.Thread(target=ask) for _ in range(3)]
    for asker in askers:
        asker.start()
    try:
        for _ in range(200):
            with closing(Staging(tmp_path, "dataset")):
                assert is_held(tmp_path) is True
    finally:
        ended.set()
        for asker in askers:
            asker.join()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_an_unreadable_lock_does_not_count_as_free(tmp_path: Path) -> None:
    Staging(tmp_path, "dataset").close()
    (tmp_path / ".lock").chmod(0)
    assert is_held(tmp_path) is None


def test_only_large_transferred_files_leave_the_page_cache(tmp_path: Path) -> None:
    control = tmp_path / "control"
    control.write_bytes(bytes(_LARGE))
    with control.open("rb") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    if _cached_share(control) > 0.5:
        pytest.skip("the file system of this folder does not free its page cache")
    with closing(Staging(tmp_path, "dataset")) as staging, staging.stage(1) as large, staging.stage(2) as small:
        large.write(b"x" * _LARGE)
        small.write(b"x" * MAX_PACKED_BYTES)
        assert _cached_share(large.path) > 0.5
        large.flush()
        small.flush()
        assert _cached_share(large.path) < 0.5
        assert _cached_share(small.path) > 0.5
        assert large.path.read_bytes() == b"x" * _LARGE
        with staging.stage(3) as linked:
            linked.link(large.path)
            linked.flush()
            assert _cached_share(large.path) > 0.5


_LARGE = 8 * MAX_PACKED_BYTES


def _cached_share(path: Path) -> float:
    """Returns the share of the pages of a file in the page cache; reads no page, because that would load more pages."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as mapped:
        found = (ctypes.c_ubyte * (len(mapped) // mmap.PAGESIZE))()
        first = ctypes.c_char.from_buffer(mapped)
        assert ctypes.CDLL(None).mincore(ctypes.byref(first), ctypes.c_size_t(len(mapped)), found) == 0
        del first
    return sum(flags & 1 for flags in found) / len(found)
