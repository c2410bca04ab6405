"""Suggests the next commands after an import: inspect the scene, measure it, and plan a dataset."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import click

from coordinator.expansion.catalog import read_entry
from coordinator.expansion.plan_toml import plan_to_toml
from factory.runs.first_plan import draft_plan

__all__ = ["Steps", "next_steps", "print_steps"]


@dataclass(frozen=True)
class Steps:
    """Suggested next steps."""

    next: tuple[str, ...]
    """Commands."""
    plan: str | None
    """A first plan as TOML; `None` if no target has a feasible start."""


def next_steps(package: Path, usd: Path, is_in_cache: bool, files: dict[str, object]) -> Steps:
    """Returns the next steps for a scene package.

    Args:
        package: file of the scene package.
        usd: the stage's root layer.
        is_in_cache: True if the package is in the cache, where it is found by name.
        files: files and other options of the import, as in the scene of a plan.
    """
    entry = read_entry(package)
    name = entry.info.name
    scene = name if is_in_cache else shlex.quote(str(package))
    plan = draft_plan(entry, str(usd.resolve()), **files)
    commands = (f"factory scene inspect {scene} -o {name}.png", f"factory scene survey {scene}")
    ready = (f"factory plan show {name}.toml",) if plan else ()
    return Steps((*commands, *ready), None if plan is None else plan_to_toml(plan))


def print_steps(steps: Steps) -> None:
    """Prints the next steps as text."""
    *looks, last = steps.next
    for number, step in enumerate(looks if steps.plan else steps.next):
        click.echo(f"{'next:' if number == 0 else '':<8} {step}")
    if steps.plan is not None:
        click.echo(f"{'':<8} {last}, after saving this plan to that file:\n\n{steps.plan}", nl=False)
