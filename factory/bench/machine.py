"""Describes the machine of a benchmark, reads process memory from /proc, and records the time of stages.

Runs no workload. The only state that it changes is the peak memory counter of the process.
"""

from __future__ import annotations

import contextlib
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path

from factory.bench.results import Machine, Memory, Spread, StageCost

_PAGE = os.sysconf("SC_PAGE_SIZE")
_MIB = 1 << 20
StageTimes = dict[str, tuple[float, float]]
"""Stage -> wall time and CPU time, seconds."""


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


def reset_peak() -> None:
    """Resets the peak memory counter of this process, so the peak excludes the building of scenes.

    Building a scene needs more memory than simulating in it. Does nothing if the kernel does not support the reset.
    """
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def measure_memory(start_mib: float, pid: int | str = "self") -> Memory:
    """Returns the memory of a process: the given memory at the start, the current memory and the peak memory."""
    return Memory(start_mib=start_mib, end_mib=resident_mib(pid), peak_mib=_peak_mib(pid))


def _peak_mib(pid: int | str) -> float:
    # the kernel keeps the maximum of getrusage across an exec, so it would include the memory of the parent process
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return round(int(line.split()[1]) / 1024, 1)
    raise AssertionError("VmHWM is missing in /proc/PID/status")


def _cpu_name() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


class StageRecorder:
    """Recorder of stage times, a `schemas.support.stage_timer.StageTimer`.

    Call `start` before the first stage and `take` after the last.
    """

    def __init__(self) -> None:
        self._times: StageTimes = {}
        self._wall = self._cpu = 0.0

    def start(self) -> None:
        """Clears the recorded times and starts the first stage."""
        self._times = {}
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def __call__(self, stage: str) -> None:
        """Ends the given stage and starts the next one."""
        wall, cpu = time.perf_counter(), time.process_time()
        before = self._times.get(stage, (0.0, 0.0))
        self._times[stage] = (before[0] + wall - self._wall, before[1] + cpu - self._cpu)
        self._wall, self._cpu = wall, cpu

    def take(self) -> StageTimes:
        """Returns the stage times since `start`."""
        return self._times


def stage_costs(runs: Sequence[tuple[int, StageTimes]]) -> tuple[StageCost, ...]:
    """Returns the cost per frame of every stage.

    Args:
        runs: Number of frames and stage times of each repetition; all repetitions have the same stages.
    """
    return tuple(
        StageCost(
            stage=stage,
            wall_ms=Spread.of([1000 * times[stage][0] / frames for frames, times in runs]),
            cpu_ms=Spread.of([1000 * times[stage][1] / frames for frames, times in runs]),
        )
        for stage in runs[0][1]
    )
