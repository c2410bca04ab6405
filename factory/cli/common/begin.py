"""The plan of a run: the one that its directory was begun with, or the one asked for; told before anything is built."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from coordinator.expansion.file import load_plan
from coordinator.ledger.opening import require_plan
from factory.cli.common.options import shrunk_plan
from factory.dataset.site import Site
from factory.runs.ledger import plan_of
from schemas.dataset_files import EPISODES, is_dataset, is_part
from schemas.errors import UsageError
from schemas.plan import Plan
from schemas.storage.disk import translated
from schemas.storage.place import children

__all__ = ["Beginning", "begin"]


class Beginning(NamedTuple):
    """What is to be made."""

    plan: Plan
    is_new: bool
    """Nothing of it has been made yet."""


def begin(name: str | None, site: Site, changes: Mapping[str, Any]) -> Beginning:
    """Returns the plan to work on in a place.

    Args:
        name: of the plan asked for; `None` goes on with the one that is there, or takes demo.
        site: where the dataset is made.
        changes: the shrink options.

    Raises:
        UsageError: the place was begun with another plan, or lies in another dataset.
        WorldError: it cannot be looked into.
    """
    begun = plan_of(site)
    wanted = load_plan(name) if name is not None else begun or load_plan("demo")
    plan = shrunk_plan(wanted, changes)
    if begun is not None:
        require_plan(begun, plan)
    elif site.store is None:
        with translated("look into", site.home):
            _look_around(site.home)
    with translated("look into", site.home):
        has_episodes = bool(children(site.place / EPISODES))
    return Beginning(plan, begun is None and not has_episodes)


def _look_around(out: Path) -> None:
    """Refuses a directory within a dataset, and says what a new one holds that is not of a dataset."""
    around = next((parent for parent in out.absolute().parents if is_dataset(parent)), None)
    if around is not None:
        raise UsageError(f"{out} lies in the dataset {around}: choose an --out outside of it")
    strange = sorted(entry.name for entry in out.iterdir() if not is_part(entry.name)) if out.is_dir() else []
    if strange:
        some = ", ".join(strange[:3]) + (", ..." if len(strange) > 3 else "")
        click.echo(f"note: {out} holds what is no part of a dataset, as `factory verify` will say: {some}", err=True)
