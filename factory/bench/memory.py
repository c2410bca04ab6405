"""Whether a simulation's memory stays flat: many short episodes in all scenes by turns, watched one by one.

The process is the one that a worker starts. Most episodes are cut short after a few frames, for a leak shows at starts
and ends; some are driven to their end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from coordinator.expansion.catalog import Catalog
from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.model import MemoryBench
from schemas.errors import WorldError
from schemas.job import Job
from schemas.terms import FailReason
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind
from workers.process.simulation import Death, Simulation

__all__ = ["bench_memory"]

_WHOLE_EVERY = 41
"""One in so many episodes is driven to its end, after one of every scene; a prime, so that all scenes get a turn."""
_STEPS = 5
"""Of all others."""
_TENTH = 10
_HANG_S = 120.0
_ENDS = {SimulationReportKind.SUCCESS, SimulationReportKind.FAILURE}


def bench_memory(
    jobs: Sequence[Job], catalog: Catalog, command: Sequence[str], episodes: int, tell: Callable[[], None]
) -> MemoryBench:
    """Has a simulation do short episodes of the jobs in turn and returns what it held along the way.

    Args:
        jobs: of all scenes, in the order in which they take turns.
        catalog: their scenes.
        command: how to start it.
        episodes: how many, at least 20.
        tell: told after every episode.

    Raises:
        WorldError: the simulation died, or broke on a job.
    """
    machine, held, frames, done = describe_machine(), [], 0, 0
    with TemporaryDirectory() as folder, closing(_Watched(Simulation(command, _HANG_S))) as watched:
        bundle, start_mib = Path(folder, "bundle.zip"), resident_mib(watched.pid)
        for number in range(episodes):
            is_whole = number < len(catalog) or number % _WHOLE_EVERY == 0
            job = jobs[number % len(jobs)] if is_whole else _short(jobs[number % len(jobs)])
            report = watched.run(
                SimulationOrder(job=job, scene_path=catalog[job.scene].path, bundle_path=bundle, sid="bench")
            )
            done, frames = done + (report.kind is SimulationReportKind.SUCCESS), frames + report.step
            bundle.unlink(missing_ok=True)
            held.append(resident_mib(watched.pid))
            tell()
        memory = measure_memory(start_mib, watched.pid)
    tenth = episodes // _TENTH
    return MemoryBench(
        machine=machine,
        renderer=watched.renderer,
        scenes=tuple(catalog),
        episodes=episodes,
        succeeded=done,
        frames=frames,
        settled_mib=median(held[tenth : 2 * tenth]),
        last_mib=median(held[-tenth:]),
        memory=memory,
    )


class _Watched:
    """A running simulation that must not die."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        simulation.start()
        self.pid = simulation.pid or 0
        self.renderer = self._hear({SimulationReportKind.READY}).renderer

    def run(self, order: SimulationOrder) -> SimulationReport:
        """Returns how the attempt ended."""
        self._simulation.order(order)
        report = self._hear(_ENDS)
        if report.reason is FailReason.CRASH:
            raise WorldError(f"the simulation failed in scene {order.job.scene}: {report.detail}")
        return report

    def close(self) -> None:
        self._simulation.kill()

    def _hear(self, wanted: set[SimulationReportKind]) -> SimulationReport:
        while True:
            said = self._simulation.receive(1.0)
            if isinstance(said, Death):
                raise WorldError(f"the simulation died: {said.detail}")
            if said is not None and said.kind in wanted:
                return said


def _short(job: Job) -> Job:
    return job.model_copy(update={"task": job.task.model_copy(update={"max_steps": _STEPS})})
