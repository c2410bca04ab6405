"""Builds the layouts of the families of a plan in processes. If a seed has no valid layout, the next seed is tried.

The result depends on the plan only. Packages are kept in the cache, so an interrupted build continues.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from coordinator.expansion.catalog import read_entry
from coordinator.expansion.possible import faults_of
from coordinator.expansion.scene_cells import scene_cells
from factory.scenes.build import build_scene, package_path, rules_of
from factory.scenes.rules import load_rules
from factory.support.task_pool import run_tasks
from schemas.errors import InvalidPlan, LayoutError
from schemas.layouts import LayoutPlan
from schemas.plan import Plan


@dataclass(frozen=True)
class BuiltLayout:
    """Package of a layout."""

    name: str
    """Name of the layout."""
    path: Path
    """Path of the package."""
    refused: tuple[str, ...] = ()
    """Reasons why earlier seeds were not used, one line each."""


@dataclass(frozen=True)
class LayoutBuilds:
    """Settings of the builds of layouts."""

    processes: int = 0
    """Number of processes; 0 builds in the calling process."""
    stop: threading.Event = field(default_factory=threading.Event)
    """Event that ends the builds."""
    tell: Callable[[BuiltLayout, int], None] = lambda _built, _total: None
    """Called with each built layout and the number of all layouts to build."""


@dataclass(frozen=True)
class _Task:
    plan: str
    name: str
    cache: Path


def build_layouts(plan: Plan, names: Collection[str], cache: Path, builds: LayoutBuilds) -> Iterator[BuiltLayout]:
    """Yields the layouts in order of completion.

    Args:
        plan: plan with the families.
        names: names of the layouts to build.
        cache: folder of packages; layouts in it are not built again.
        builds: settings of the builds.

    Raises:
        InvalidPlan: a family has no objects of a category that the plan names, or no seed of a layout gives a package
            that fulfils the plan.
        KeyboardInterrupt: the builds were stopped.
        WorldError: the cache cannot be written, or a process died.
    """
    _require_categories(plan)
    text = plan.model_dump_json()
    tasks = (_Task(text, name, cache) for name in names)
    for built in run_tasks(_build, tasks, min(builds.processes, len(names)), builds.stop):
        builds.tell(built, len(names))
        yield built
    if builds.stop.is_set():
        raise KeyboardInterrupt


def find_layouts(plan: Plan, cache: Path) -> dict[str, Path]:
    """Returns the packages of the layouts of a plan that a run would use and that are in the cache; builds none."""
    found: dict[str, Path] = {}
    for part in plan.parts:
        if not isinstance(part, LayoutPlan):
            continue
        rules = None if part.rules is None else load_rules(Path(part.rules))
        for seed in part.seeds:
            path = package_path(part.family.name, seed, cache, rules, called=part.name)
            if not path.exists():
                break  # a run would build this seed first
            if not any(faults_of(scene_cells(plan, part, read_entry(path)), part.name)):
                found[part.name] = path
                break
    return found


def _require_categories(plan: Plan) -> None:
    """Checks that the families can have the categories that the plan names. No seed adds a category to a family."""
    mistakes = []
    for number, scene in enumerate(plan.scenes):
        if scene.layouts is None:
            continue
        rules = rules_of(scene.name) if scene.rules is None else load_rules(Path(scene.rules))
        known = {rule.category for rule in rules.rules}
        absent = sorted({name for group in scene.categories for name in group} - known)
        if absent:
            mistakes.append(
                f"scenes[{number}] {scene.name}: no layout has {', '.join(absent)}; remove them from its categories; "
                f"categories of the family: {', '.join(sorted(known))}"
            )
    if mistakes:
        raise InvalidPlan(f"plan {plan.name!r} names categories that its families do not have", mistakes)


def _build(task: _Task) -> BuiltLayout:
    plan = _parsed(task.plan)
    part = plan.part(task.name)
    if not isinstance(part, LayoutPlan):
        raise TypeError(f"{task.name} is not a layout")
    rules = None if part.rules is None else load_rules(Path(part.rules))
    refused: list[str] = []
    for seed in part.seeds:
        try:
            path = build_scene(part.family.name, seed, task.cache, rules, called=part.name)
            faults = list(faults_of(scene_cells(plan, part, read_entry(path)), f"seed {seed}"))
        except LayoutError as error:
            faults = [f"seed {seed}: {error}"]
        if not faults:
            return BuiltLayout(part.name, path, tuple(refused))
        refused += faults
    raise InvalidPlan(f"none of {len(part.seeds)} seeds of {part.name} gives a layout for plan {plan.name!r}", refused)


@lru_cache(maxsize=1)
def _parsed(text: str) -> Plan:
    return Plan.model_validate_json(text)
