"""The archive on a real directory: what it promises about names, crashes, locks and full disks."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from coordinator.archive import Archive, index_of_file
from coordinator.open_archive import open_archive
from schemas.errors import ArchiveCorrupt, WorldError


def publish(archive: Archive, index: int, data: bytes) -> Path:
    with archive.stage(index) as staged:
        staged.write(data)
        return archive.publish(staged, index)


def parts_of(archive: Archive) -> list[Path]:
    return list((archive.root / ".staging").iterdir())


def test_published_episode_has_its_bytes_and_its_name(tmp_path: Path) -> None:
    with open_archive(tmp_path / "data") as archive:
        path = publish(archive, 123, b"bundle")
        assert path == tmp_path / "data/episodes/ep_000123.zip"
        assert path.read_bytes() == b"bundle"
        assert archive.present() == {123: path}
        assert parts_of(archive) == []


def test_staged_file_knows_size_and_digest_of_all_that_was_written(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive, archive.stage(1) as staged:
        for chunk in (b"ab", b"", b"c" * 100_000):
            staged.write(chunk)
        assert staged.size == 100_002
        assert staged.sha256 == hashlib.sha256(b"ab" + b"c" * 100_000).hexdigest()


def test_abandoned_part_file_is_gone(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        with pytest.raises(TypeError), archive.stage(1) as staged:
            staged.write("no bytes")  # type: ignore[arg-type]
        assert parts_of(archive) == []
        assert archive.present() == {}


def test_two_part_files_of_one_episode_do_not_meet(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive, archive.stage(1) as one, archive.stage(1) as two:
        one.write(b"one")
        two.write(b"two")
        assert (one.path.read_bytes(), two.path.read_bytes()) == (b"one", b"two")


def test_archived_episode_is_never_overwritten(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        path = publish(archive, 1, b"first")
        with pytest.raises(ArchiveCorrupt, match="lies there already and is not overwritten"):
            publish(archive, 1, b"second")
        assert path.read_bytes() == b"first"
        assert parts_of(archive) == []


def test_unpublishing_deletes_and_may_be_repeated(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        publish(archive, 1, b"late")
        archive.unpublish(1)
        archive.unpublish(1)
        assert archive.present() == {}


def test_quarantined_file_is_kept_with_its_reason(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        place = archive.quarantine(publish(archive, 1, b"torn"), "5 bytes, the ledger says 9")
        assert place.read_bytes() == b"torn"
        reason = place.with_name(f"{place.name}.reason.txt").read_text()
        assert "ep_000001.zip" in reason
        assert "5 bytes, the ledger says 9" in reason
        assert archive.present() == {}


def test_same_name_is_quarantined_twice_without_loss(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        places = {archive.quarantine(publish(archive, 1, data), "torn") for data in (b"one", b"two")}
        assert {place.read_bytes() for place in places} == {b"one", b"two"}


def test_leftover_part_files_are_removed_at_the_next_start(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        (tmp_path / ".staging/ep_000001.00.part").write_bytes(b"half")
    with open_archive(tmp_path) as archive:
        assert parts_of(archive) == []


def test_foreign_files_are_told_from_episodes(tmp_path: Path) -> None:
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
def test_only_the_canonical_name_is_an_episode(name: str, index: int | None) -> None:
    assert index_of_file(name) == index


def test_second_coordinator_is_told_who_works_there(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from coordinator.open_archive import open_archive;"
        "open_archive(Path(sys.argv[1]))"
    )
    with open_archive(tmp_path):
        other = subprocess.run(
            [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False
        )
    assert other.returncode == 1
    assert f"another coordinator works on {tmp_path} (pid {os.getpid()})" in other.stderr
    with open_archive(tmp_path):
        pass


def test_lock_is_free_again_when_the_holder_was_killed(tmp_path: Path) -> None:
    script = (
        "import os, sys; from pathlib import Path; from coordinator.open_archive import open_archive;"
        "archive = open_archive(Path(sys.argv[1])); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=False)
    with open_archive(tmp_path):
        pass


def test_file_in_place_of_the_directory_is_named_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    with pytest.raises(WorldError, match=r"cannot open .*data.*; a file stands where a directory is wanted"):
        open_archive(tmp_path / "data")


def test_full_disk_is_named_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    """A limit on the size of files stands in for a full disk: both end in an OSError within a write."""
    script = """
import resource, signal, sys
from pathlib import Path
from coordinator.archive import Archive
from coordinator.open_archive import open_archive
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
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    message, rest = done.stdout.splitlines()
    assert message.startswith(f"cannot write {tmp_path}/.staging: File too large")
    assert rest == "0 {}"


def test_scene_is_kept_once_under_its_digest(tmp_path: Path) -> None:
    source = tmp_path / "office.scene"
    source.write_bytes(b"package")
    sha256 = hashlib.sha256(b"package").hexdigest()
    with open_archive(tmp_path / "data") as archive:
        path = archive.add_scene(source, "office", sha256)
        source.unlink()
        assert archive.add_scene(source, "office", sha256) == path
        assert path.read_bytes() == b"package"
        assert path.name == f"office-{sha256[:16]}.scene.zip"


def test_scene_with_another_digest_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "office.scene"
    source.write_bytes(b"package")
    with open_archive(tmp_path / "data") as archive:
        with pytest.raises(ArchiveCorrupt, match="expected 0000"):
            archive.add_scene(source, "office", "0" * 64)
        assert list((archive.root / "scenes").iterdir()) == []
        assert parts_of(archive) == []


def test_table_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        with archive.replacing("metadata.parquet") as path:
            path.write_bytes(b"old")
        with pytest.raises(TypeError), archive.replacing("metadata.parquet") as path:
            path.write_bytes("no bytes")  # type: ignore[arg-type]
        assert (tmp_path / "metadata.parquet").read_bytes() == b"old"
        assert parts_of(archive) == []


def test_free_space_is_what_the_file_system_says(tmp_path: Path) -> None:
    with open_archive(tmp_path) as archive:
        assert 0 < archive.free_bytes() <= os.statvfs(tmp_path).f_blocks * os.statvfs(tmp_path).f_frsize
