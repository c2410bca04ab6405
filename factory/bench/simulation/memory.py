"""Benchmarks the memory growth of a simulation over many short episodes in all scenes.

Runs the simulation process of a worker. Most episodes are limited to a few frames, because leaks occur at the start and
end of an episode; some run to their end. Archives nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from coordinator.expansion.catalog import Catalog
from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.results import MemoryBench
from schemas.errors import WorldError
from schemas.job import Job
from schemas.terms import FailReason
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind
from workers.process.simulation import ProcessEnd, Simulation

_WHOLE_EVERY = 41
"""Every 41st episode runs to its end, and so does the first episode of each scene. The number is prime, so the episodes
that run to their end are from all scenes."""
_STEPS = 5
"""Step limit of the episodes that do not run to their end."""
_TENTH = 10
_HANG_S = 120.0
_ENDS = {SimulationReportKind.SUCCESS, SimulationReportKind.FAILURE}


def bench_memory(
    jobs: Sequence[Job], catalog: Catalog, command: Sequence[str], episodes: int, tell: Callable[[], None]
) -> MemoryBench:
    """Runs short episodes of the jobs in turn in one simulation and returns its memory over time.

    Args:
        jobs: Jobs of all scenes, in the order of execution.
        catalog: Scenes of the jobs.
        command: Command line of the simulation.
        episodes: Number of episodes, at least 20.
        tell: Progress callback, called after every episode.

    Raises:
        WorldError: The simulation process died, or failed on a job.
    """
    machine, held, frames, done = describe_machine(), [], 0, 0
    with TemporaryDirectory() as folder, closing(_SimulationUnderTest(Simulation(command, _HANG_S))) as simulation:
        bundle, start_mib = Path(folder, "bundle.zip"), resident_mib(simulation.pid)
        for number in range(episodes):
            is_whole = number < len(catalog) or number % _WHOLE_EVERY == 0
            job = jobs[number % len(jobs)] if is_whole else _short(jobs[number % len(jobs)])
            report = simulation.run(
                SimulationOrder(job=job, scene_path=catalog[job.scene].path, bundle_path=bundle, sid="bench")
            )
            done, frames = done + (report.kind is SimulationReportKind.SUCCESS), frames + report.step
            bundle.unlink(missing_ok=True)
            held.append(resident_mib(simulation.pid))
            tell()
        memory = measure_memory(start_mib, simulation.pid)
    tenth = episodes // _TENTH
    return MemoryBench(
        machine=machine,
        renderer=simulation.renderer,
        scenes=tuple(catalog),
        episodes=episodes,
        succeeded=done,
        frames=frames,
        settled_mib=median(held[tenth : 2 * tenth]),
        last_mib=median(held[-tenth:]),
        memory=memory,
    )


class _SimulationUnderTest:
    """Running simulation process; raises `WorldError` if the process exits."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        simulation.start()
        self.pid = simulation.pid or 0
        self.renderer = self._receive({SimulationReportKind.READY}).renderer

    def run(self, order: SimulationOrder) -> SimulationReport:
        """Runs one attempt and returns the report of its end."""
        self._simulation.order(order)
        report = self._receive(_ENDS)
        if report.reason is FailReason.CRASH:
            raise WorldError(f"the simulation failed in scene {order.job.scene}: {report.detail}")
        return report

    def close(self) -> None:
        self._simulation.kill()

    def _receive(self, wanted: set[SimulationReportKind]) -> SimulationReport:
        while True:
            said = self._simulation.receive(1.0)
            if isinstance(said, ProcessEnd):
                raise WorldError(f"the simulation died: {said.detail}")
            if said is not None and said.kind in wanted:
                return said


def _short(job: Job) -> Job:
    return job.model_copy(update={"task": job.task.model_copy(update={"max_steps": _STEPS})})
