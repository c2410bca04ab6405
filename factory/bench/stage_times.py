"""The watch behind the laps of a loop: wall clock and CPU time of every stage. Knows no stage by name."""

from __future__ import annotations

import time
from collections.abc import Sequence

from factory.bench.model import Spread, StageCost

__all__ = ["StageClock", "StageTimes", "stage_costs"]

StageTimes = dict[str, tuple[float, float]]
"""Stage -> seconds of wall clock, seconds of CPU time."""


class StageClock:
    """A `schemas.support.stage_timer.Lap` that keeps time; `start` before the first stage, `take` after the last."""

    def __init__(self) -> None:
        self._times: StageTimes = {}
        self._wall = self._cpu = 0.0

    def start(self) -> None:
        """Forgets what was counted and begins with the first stage."""
        self._times = {}
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def __call__(self, stage: str) -> None:
        """Ends a stage, and begins the next."""
        wall, cpu = time.perf_counter(), time.process_time()
        before = self._times.get(stage, (0.0, 0.0))
        self._times[stage] = (before[0] + wall - self._wall, before[1] + cpu - self._cpu)
        self._wall, self._cpu = wall, cpu

    def take(self) -> StageTimes:
        """Returns the times of every stage since `start`."""
        return self._times


def stage_costs(runs: Sequence[tuple[int, StageTimes]]) -> tuple[StageCost, ...]:
    """Returns the cost of every stage a frame.

    Args:
        runs: frames and stage times of every repeat; all have the same stages.
    """
    return tuple(
        StageCost(
            stage=stage,
            wall_ms=Spread.of([1000 * times[stage][0] / frames for frames, times in runs]),
            cpu_ms=Spread.of([1000 * times[stage][1] / frames for frames, times in runs]),
        )
        for stage in runs[0][1]
    )
