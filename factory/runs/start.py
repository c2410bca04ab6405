"""Starts a run: chooses its plan, the one in its dataset directory or the requested one, and opens the scenes.

Does not run anything.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import click
from rich.progress import TaskID

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.cells import empty_splits
from coordinator.expansion.plan_file import load_plan, shrink
from coordinator.ledger.opening import require_plan
from factory.dataset.site import Site
from factory.runs.catalog import open_catalog, scenes_before_run
from factory.runs.gate import gate_plans
from factory.runs.gate_mode import GateMode
from factory.runs.layouts import BuiltLayout, LayoutBuilds
from factory.runs.ledger import plan_of, require_outside_datasets, require_single_run
from factory.runs.plan_changes import PlanChanges
from factory.support.settings import scene_cache
from factory.support.terminal import Bars, print_building
from schemas.plan import Plan
from schemas.rig.rig_file import load_rig
from schemas.storage.dataset_files import EPISODES, is_part
from schemas.storage.disk import translated
from schemas.storage.place import Place, children
from schemas.terms import ExpertName, Recording


class RunStart(NamedTuple):
    """The plan of a run, and whether the run is new."""

    plan: Plan
    is_new: bool
    """True when the dataset has neither a ledger nor episodes."""


def begin(name: str | None, site: Site, changes: PlanChanges) -> RunStart:
    """Returns the plan to run in a dataset directory.

    Args:
        name: name or file of the requested plan; `None` means the plan of the existing dataset, or `demo`.
        site: location of the dataset.
        changes: changes of the requested plan.

    Raises:
        UsageError: the directory has a different plan, has several runs or an unfinished extension, or is inside
            another dataset.
        WorldError: the directory cannot be read.
    """
    require_single_run(site)
    recorded = plan_of(site)
    wanted = _load(name, recorded) if name is not None else recorded or load_plan("demo")
    plan = shrunk_plan(wanted, changes)
    if recorded is not None:
        require_plan(recorded, plan)
    elif site.store is None:
        with translated("look into", site.state_dir):
            require_outside_datasets(site)
            _note_foreign_files(site.state_dir)
    with translated("look into", site.state_dir):
        has_episodes = bool(children(site.place / EPISODES))
    return RunStart(plan, recorded is None and not has_episodes)


def shrunk_plan(plan: Plan, changes: PlanChanges) -> Plan:
    """Applies changes to a plan."""
    return shrink(
        plan,
        scenes=changes.scenes or (),
        episodes=changes.episodes,
        expert=ExpertName(changes.expert) if changes.expert else None,
        seed=changes.seed,
        record=Recording(changes.record) if changes.record else None,
        rig=load_rig(changes.rig, control_hz=None) if changes.rig else None,
        appearance=changes.appearance,
    )


def warn_of_empty_splits(plan: Plan) -> None:
    """Prints on stderr which splits have no episodes because the plan has too few."""
    empty = empty_splits(plan)
    if empty:
        click.echo(f"note: {plan.episodes} episodes are too few; splits without episodes: {', '.join(empty)}", err=True)


def open_scenes(
    plan: Plan,
    site: Site,
    gate_mode: GateMode,
    *,
    processes: int,
    stop: threading.Event,
    packages: Place | None = None,
    builds_all: bool = False,
) -> Catalog:
    """Returns the scenes of a plan after checking that they can fulfil it. Builds missing ones until `stop` is set.

    Shows a progress bar of the layouts, and prints why the builds do not use a seed.

    Args:
        plan: plan of the run.
        site: location of the dataset.
        gate_mode: mode of the gate, which needs its scenes before the run.
        processes: number of processes that build layouts.
        stop: event that ends the builds.
        packages: folder with the package of every scene; `None` uses those of the dataset, or builds them.
        builds_all: whether to build all layouts now, instead of only those that are needed before the run.

    Raises:
        InvalidPlan: the scenes cannot fulfil the plan.
    """
    is_complete = builds_all or packages is not None
    before = None if is_complete else scenes_before_run(plan, gate_plans(plan, gate_mode))
    with _building_layouts(processes, stop) as builds:
        return open_catalog(
            plan, site.place, scene_cache(), print_building, builds=builds, packages=packages, only=before
        )


@contextmanager
def _building_layouts(processes: int, stop: threading.Event) -> Iterator[LayoutBuilds]:
    with _LayoutBar() as bar:
        yield LayoutBuilds(processes, stop, bar.show)


class _LayoutBar(Bars):
    """Progress bar of the builds of layouts."""

    _task: TaskID | None = None

    def show(self, built: BuiltLayout, total: int) -> None:
        """Updates the bar, which appears with the first layout."""
        for line in built.refused:
            click.echo(f"note: {built.name} does not use {line}", err=True)
        if self._task is None:
            self._task = self.add_task("layouts", total=total)
        self.update(self._task, advance=1, note=built.name)


def _load(name: str, recorded: Plan | None) -> Plan:
    """Returns a plan; if its file has no success measure, the plan gets that of the recorded plan."""
    return load_plan(name) if recorded is None else load_plan(name, recorded.task.success)


def _note_foreign_files(out: Path) -> None:
    """Prints a note about files that do not belong to a dataset."""
    foreign = sorted(entry.name for entry in out.iterdir() if not is_part(entry.name)) if out.is_dir() else []
    if foreign:
        some = ", ".join(foreign[:3]) + (", ..." if len(foreign) > 3 else "")
        click.echo(
            f"note: {out} contains files that do not belong to a dataset; `factory verify` will report them: {some}",
            err=True,
        )
