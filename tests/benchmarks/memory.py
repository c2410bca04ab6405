"""Benchmarks the memory growth of a simulation over many short episodes in all scenes.

Runs the simulation process of a worker. Most episodes are limited to a few frames, because leaks occur at the start and
end of an episode; some run to their end. Archives nothing.

    python -m tests.benchmarks.memory --episodes 200
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import click

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.plan_file import load_plan
from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.results import Machine, Memory
from factory.bench.tables import print_machine, progress_bar
from factory.bench.workload import first_attempts, narrow, temporary_folder
from factory.cli.options import count_option, json_option, renderer_option, scene_filter
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result, print_table
from schemas.base import Model
from schemas.errors import WorldError
from schemas.job import Job
from schemas.terms import FailReason, RendererKind
from tests.benchmarks.command import run
from workers.client.settings import WorkerSettings
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind
from workers.process.simulation import ProcessEnd, Simulation

_WHOLE_EVERY = 41
"""Every 41st episode runs to its end, and so does the first episode of each scene. The number is prime, so the episodes
that run to their end are from all scenes."""
_STEPS = 5
"""Step limit of the episodes that do not run to their end."""
_SCENE_JOBS = 25
"""Number of different jobs of each scene; they are repeated in turn."""
_TENTH = 10
_HANG_S = 120.0
_ENDS = {SimulationReportKind.SUCCESS, SimulationReportKind.FAILURE}


class MemoryBench(Model):
    """Result of the benchmark."""

    bench: str = "memory"
    machine: Machine
    renderer: str
    scenes: tuple[str, ...]
    """Names of the scenes, in the order of execution."""
    episodes: int
    succeeded: int
    """Number of successful episodes. Most episodes have a short step limit and end before they can succeed."""
    frames: int
    """Total number of frames."""
    settled_mib: float
    """Median memory over the second tenth of the episodes, MiB; by then all scenes are loaded and caches are full."""
    last_mib: float
    """Median memory over the last tenth, MiB; the difference to `settled_mib` is the growth."""
    memory: Memory


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


@click.command()
@scene_filter()
@count_option("--episodes", 200, "Total number of episodes; most are ended early.", least=20)
@renderer_option
@json_option
def command(scenes: tuple[str, ...] | None, episodes: int, renderer: RendererKind, as_json: bool) -> None:
    """Measure the memory of a simulation over many episodes.

    The process switches to another scene after each episode.
    """
    plan = narrow(load_plan("paper"), scenes or (), _SCENE_JOBS)
    with progress_bar("memory", episodes) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        turns = zip(*(first_attempts(plan, catalog, name) for name in catalog), strict=True)
        jobs = [job for turn in turns for job in turn]
        words = WorkerSettings(connect=(), renderer=renderer).simulation_command
        report = bench_memory(jobs, catalog, words, episodes, tell)
    print_result(report, as_json, _show)


def _show(report: MemoryBench) -> None:
    print_machine(report.machine, report.renderer)
    rows = [
        ("episodes", report.episodes),
        ("successful episodes, the others ended early", report.succeeded),
        ("frames", report.frames),
        ("before the first episode, MiB", report.memory.start_mib),
        ("second tenth of the episodes, MiB", report.settled_mib),
        ("last tenth of the episodes, MiB", report.last_mib),
        ("peak, MiB", report.memory.peak_mib),
    ]
    print_table(f"Resident memory, alternating scenes: {', '.join(report.scenes)}", ("quantity", "value"), rows)


if __name__ == "__main__":
    run(command)
