"""`factory plan show`: the cells and counts a plan expands to, before anything is built."""

from __future__ import annotations

from typing import Any

import click

from coordinator.draw import cells
from coordinator.plan_file import load_plan
from factory.cli.options import plan_argument, shrink_options, shrunk_plan
from factory.cli.output import json_option, print_json, print_table
from schemas.plan import Plan
from schemas.terms import Tier

__all__ = ["command"]


@click.group("plan")
def command() -> None:
    """Look at plans."""


@command.command("show")
@plan_argument(default="demo")
@shrink_options
@json_option
def show(plan_name: str, as_json: bool, **changes: Any) -> None:
    """Show the cells that PLAN (a built-in name or a TOML file) expands to."""
    plan = shrunk_plan(load_plan(plan_name), changes)
    if as_json:
        print_json({"plan": plan.model_dump(mode="json"), "digest": plan.digest, "cells": list(_rows(plan))})
        return
    click.echo(f"plan {plan.name}: {plan.episodes} episodes, seed {plan.seed}, expert {plan.expert}, run {plan.run}")
    for scene in plan.scenes:
        seen, held_out = scene.categories
        click.echo(f"  {scene.name}: seen {', '.join(seen)}; held out {', '.join(held_out) or 'none'}")
    rows = [(row["scene"], row["split"], *(row[tier] for tier in Tier), row["episodes"]) for row in _rows(plan)]
    print_table("", ("scene", "split", *(str(tier) for tier in Tier), "episodes"), rows)


def _rows(plan: Plan) -> list[dict[str, Any]]:
    rows = []
    for scene in plan.scenes:
        quota = cells(plan, scene)
        for split in plan.splits:
            counts: dict[str, Any] = {str(tier): quota.get((split, tier), 0) for tier in Tier}
            if sum(counts.values()):
                rows.append({"scene": scene.name, "split": str(split), **counts, "episodes": sum(counts.values())})
    return rows
