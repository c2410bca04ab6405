"""Chooses the plan of a run, the one in its dataset directory or the requested one, before anything is built."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from coordinator.expansion.plan_file import load_plan
from coordinator.ledger.opening import require_plan
from factory.commands.common.plan_changes import shrunk_plan
from factory.dataset.site import Site
from factory.runs.ledger import plan_of, require_outside_datasets
from schemas.plan import Plan
from schemas.storage.dataset_files import EPISODES, is_part
from schemas.storage.disk import translated
from schemas.storage.place import children


class RunStart(NamedTuple):
    """The plan of a run, and whether the run is new."""

    plan: Plan
    is_new: bool
    """True when the dataset has neither a ledger nor episodes."""


def begin(name: str | None, site: Site, changes: Mapping[str, Any]) -> RunStart:
    """Returns the plan to run in a dataset directory.

    Args:
        name: name or file of the requested plan; `None` means the plan of the existing dataset, or `demo`.
        site: location of the dataset.
        changes: values of the shrink options.

    Raises:
        UsageError: the directory has a different plan, or is inside another dataset.
        WorldError: the directory cannot be read.
    """
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
