"""Reads the memory of this host from `/proc/meminfo`."""

from __future__ import annotations

from pathlib import Path

from schemas.protocol.messages import HostMemory

_KIB = 1024


def read_memory(path: Path = Path("/proc/meminfo")) -> HostMemory | None:
    """Returns the memory of the host; `None` if the system does not report it.

    Args:
        path: file in the format of Linux' `/proc/meminfo`.
    """
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        sizes = {name: int(rest.split()[0]) * _KIB for name, _, rest in (line.partition(":") for line in lines)}
        total = sizes["MemTotal"]
        return HostMemory(used_bytes=max(0, total - sizes["MemAvailable"]), total_bytes=total)
    except (OSError, ValueError, KeyError, IndexError):
        return None
