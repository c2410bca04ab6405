"""Finds the file system of a path in mount lists as the kernel writes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.ledger.database.engine import open_writer, sqlite_url
from schemas.errors import WorldError
from schemas.storage.mounts import mount_of

LINE = "36 35 98:0 / {folder} rw,noatime shared:1 - {kind} server:/home rw,vers=4\n"
ROOT = LINE.format(folder="/", kind="ext4")


def listed(tmp_path: Path, *mounts: tuple[Path, str]) -> Path:
    file = tmp_path / "mountinfo"
    lines = (LINE.format(folder=str(folder).replace(" ", r"\040"), kind=kind) for folder, kind in mounts)
    file.write_text(ROOT + "".join(lines))
    return file


@pytest.mark.parametrize(
    "kind", ["nfs", "nfs4", "cifs", "smb3", "lustre", "gpfs", "beegfs", "ceph", "fuse", "fuse.sshfs", "fuse.gcsfuse"]
)
def test_the_error_of_a_ledger_on_a_network_file_system_names_the_alternatives(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "my home"
    folder.mkdir()
    mounts = listed(tmp_path, (folder, kind))
    with pytest.raises(WorldError, match=rf"\({kind} at .*\).*local disk or in object storage.*--ledger.*postgresql"):
        open_writer(sqlite_url(folder / "ledger.db"), mounts)
    assert not list(folder.iterdir())


@pytest.mark.parametrize("kind", ["ext4", "xfs", "overlay", "tmpfs", "fuseblk", "fuse.fuse-overlayfs", "9p"])
def test_a_ledger_on_a_local_file_system_is_opened(tmp_path: Path, kind: str) -> None:
    open_writer(sqlite_url(tmp_path / "ledger.db"), listed(tmp_path, (tmp_path, kind))).dispose()
    assert (tmp_path / "ledger.db").is_file()


def test_the_innermost_and_last_mount_of_a_path_counts(tmp_path: Path) -> None:
    inner = tmp_path / "scratch"
    mounts = listed(tmp_path, (tmp_path, "nfs4"), (inner, "nfs4"), (inner, "xfs"))
    assert mount_of(inner / "new" / "ledger.db", mounts) == (inner, "xfs")
    assert mount_of(tmp_path / "scratch2", mounts) == (tmp_path, "nfs4")


def test_a_system_without_a_list_of_mounts_passes_the_check(tmp_path: Path) -> None:
    assert mount_of(tmp_path, tmp_path / "absent") is None


def test_the_running_kernel_lists_the_mount_of_the_test_folder(tmp_path: Path) -> None:
    mount = mount_of(tmp_path)
    assert mount is not None
    assert mount.folder.is_dir()
