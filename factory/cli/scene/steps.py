"""What to do with a scene that was just imported: look at it, measure it, plan with it."""

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
    """What to do next."""

    next: tuple[str, ...]
    """Commands."""
    plan: str | None
    """A first plan as TOML; `None` when no start is possible for any target."""


def next_steps(package: Path, usd: Path, is_in_cache: bool, files: dict[str, str | bool]) -> Steps:
    """Returns what to do with a package.

    Args:
        package: its file.
        usd: the stage's root layer.
        is_in_cache: whether it lies where its name is known.
        files: what it was imported with, as a plan's scene has it.
    """
    entry = read_entry(package)
    name = entry.info.name
    scene = name if is_in_cache else shlex.quote(str(package))
    plan = draft_plan(entry, str(usd.resolve()), **files)
    commands = (f"factory scene inspect {scene} -o {name}.png", f"factory scene survey {scene}")
    ready = (f"factory plan show {name}.toml",) if plan else ()
    return Steps((*commands, *ready), None if plan is None else plan_to_toml(plan))


def print_steps(steps: Steps) -> None:
    """Prints them for people."""
    *looks, last = steps.next
    for number, step in enumerate(looks if steps.plan else steps.next):
        click.echo(f"{'next:' if number == 0 else '':<8} {step}")
    if steps.plan is not None:
        click.echo(f"{'':<8} {last}, when this first plan stands in that file:\n\n{steps.plan}", nl=False)
