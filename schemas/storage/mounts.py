"""Finds the file system of a path in the kernel's list of mounts. Creates nothing."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

MOUNTS = Path("/proc/self/mountinfo")
_NETWORK = frozenset(
    {
        "nfs",
        "nfs4",
        "cifs",
        "smb3",
        "smbfs",
        "lustre",
        "gpfs",
        "beegfs",
        "ceph",
        "afs",
        "panfs",
        "pvfs2",
        "gfs2",
        "ocfs2",
    }
)
_LOCAL_FUSE = frozenset({"fuse.fuse-overlayfs", "fuse.overlayfs", "fuse.mergerfs", "fuse.bindfs", "fuse.lxcfs"})
_ESCAPED = re.compile(r"\\([0-7]{3})")


class MountPoint(NamedTuple):
    """Entry of the list of mounts."""

    folder: Path
    """Mount point."""
    kind: str
    """Type of the file system, e.g. `ext4` or `nfs4`."""

    @property
    def is_network(self) -> bool:
        """Whether other hosts may change files, so locks and shared memory are unreliable."""
        is_fuse = self.kind == "fuse" or (self.kind.startswith("fuse.") and self.kind not in _LOCAL_FUSE)
        return self.kind in _NETWORK or is_fuse


def mount_of(path: Path, mounts: Path = MOUNTS) -> MountPoint | None:
    """Returns the mount that contains a path, which need not exist; `None` if the kernel does not list its mounts.

    Args:
        path: file or folder.
        mounts: list of mounts in the format of `/proc/self/mountinfo`.
    """
    try:
        lines = mounts.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return None
    point: MountPoint | None = None
    resolved = path.resolve()
    for line in lines:
        before, _, after = line.partition(" - ")
        folder = Path(_ESCAPED.sub(lambda code: chr(int(code[1], 8)), before.split()[4]))
        if resolved.is_relative_to(folder) and (point is None or len(folder.parts) >= len(point.folder.parts)):
            point = MountPoint(folder, after.split()[0])
    return point
