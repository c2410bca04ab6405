"""Describes the machine of a benchmark and reads process memory from /proc. Resets the peak memory counter only."""

from __future__ import annotations

import contextlib
import os
import platform
from pathlib import Path

from factory.bench.model import Machine, Memory

__all__ = ["describe_machine", "forget_peak", "measure_memory", "resident_mib"]

_PAGE = os.sysconf("SC_PAGE_SIZE")
_MIB = 1 << 20


def describe_machine() -> Machine:
    """Returns the hardware, the system and the load of this machine."""
    return Machine(
        cpu=_cpu_name(),
        cores=len(os.sched_getaffinity(0)),
        memory_gib=round(os.sysconf("SC_PHYS_PAGES") * _PAGE / (1 << 30), 1),
        system=f"{platform.system()} {platform.machine()}",
        python=platform.python_version(),
        load_1m=round(os.getloadavg()[0], 2),
    )


def resident_mib(pid: int | str = "self") -> float:
    """Returns the resident memory of a process, MiB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return round(pages * _PAGE / _MIB, 1)


def forget_peak() -> None:
    """Resets the peak memory counter, because building a scene needs more memory than simulating in it.

    Without kernel support, the peak remains that of the whole process.
    """
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def measure_memory(start_mib: float, pid: int | str = "self") -> Memory:
    """Returns the current and peak memory of a process, together with its memory at the start."""
    return Memory(start_mib=start_mib, end_mib=resident_mib(pid), peak_mib=_peak_mib(pid))


def _peak_mib(pid: int | str) -> float:
    # not getrusage: its maximum survives an exec and would include the parent
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return round(int(line.split()[1]) / 1024, 1)
    raise AssertionError("Linux names the peak of every process")


def _cpu_name() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()
