"""The archive in a directory: links, part files, full disks. The contract suite tests what all archives share."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from schemas.job import index_of_file


def publish(archive: Archive, index: int, data: bytes) -> Path:
    with archive.stage(index) as staged:
        staged.write(data)
        return archive.publish(staged, index)


def parts_of(archive: Archive) -> list[Path]:
    return list((archive.root / ".staging").iterdir())


def test_a_staged_file_has_size_and_digest_of_the_written_bytes(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive, archive.stage(1) as staged:
        for chunk in (b"ab", b"", b"c" * 100_000):
            staged.write(chunk)
        assert staged.size == 100_002
        assert staged.sha256 == hashlib.sha256(b"ab" + b"c" * 100_000).hexdigest()


def test_an_abandoned_part_file_is_removed(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        with pytest.raises(TypeError), archive.stage(1) as staged:
            staged.write("no bytes")  # type: ignore[arg-type]
        assert parts_of(archive) == []
        assert archive.present() == {}


def test_two_part_files_of_one_episode_have_different_names(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive, archive.stage(1) as one, archive.stage(1) as two:
        one.write(b"one")
        two.write(b"two")
        assert (one.path.read_bytes(), two.path.read_bytes()) == (b"one", b"two")


def test_foreign_files_are_distinguished_from_episodes(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        publish(archive, 2, b"two")
        publish(archive, 1, b"one")
        (tmp_path / "episodes/notes.txt").write_text("mine")
        (tmp_path / "episodes/ep_000003.zip").mkdir()
        (tmp_path / "episodes/ep_000004.zip").symlink_to("ep_000001.zip")
        assert list(archive.present()) == [1, 2]
        assert [path.name for path in archive.foreign()] == ["ep_000003.zip", "ep_000004.zip", "notes.txt"]


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("ep_000001.zip", 1),
        ("ep_1000000.zip", 1_000_000),
        ("ep_000000.zip", None),
        ("ep_0000001.zip", None),
        ("ep_000001.zip.part", None),
        ("ep_00001.zip", None),
        ("EP_000001.zip", None),
    ],
)
def test_only_a_file_with_a_canonical_name_is_an_episode(name: str, index: int | None) -> None:
    assert index_of_file(name) == index


def test_a_full_disk_is_reported_and_leaves_no_partial_file(tmp_path: Path) -> None:
    """A file size limit simulates a full disk: both raise an OSError during a write."""
    text = """
import resource, signal, sys
from pathlib import Path
from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from schemas.errors import WorldError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
root = Path(sys.argv[1])
with open_archive(root) as archive:
    staged = archive.stage(1)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
    try:
        staged.write(b"x" * 100_000)
    except WorldError as error:
        print(error)
    staged.abandon()
    print(len(list((root / ".staging").iterdir())), archive.present())
"""
    done = subprocess.run([sys.executable, "-c", text, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    message, rest = done.stdout.splitlines()
    assert message.startswith(f"cannot write {tmp_path}/.staging: File too large")
    assert rest == "0 {}"
