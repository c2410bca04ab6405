"""Records wall and CPU time of the stages of a loop, for any stage names. Does not run the loop."""

from __future__ import annotations

import time
from collections.abc import Sequence

from factory.bench.model import Spread, StageCost

__all__ = ["StageRecorder", "StageTimes", "stage_costs"]

StageTimes = dict[str, tuple[float, float]]
"""Stage -> wall time and CPU time, seconds."""


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
        runs: Number of frames and stage times of every repetition; all have the same stages.
    """
    return tuple(
        StageCost(
            stage=stage,
            wall_ms=Spread.of([1000 * times[stage][0] / frames for frames, times in runs]),
            cpu_ms=Spread.of([1000 * times[stage][1] / frames for frames, times in runs]),
        )
        for stage in runs[0][1]
    )
