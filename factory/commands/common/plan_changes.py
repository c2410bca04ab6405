"""Applies the options that change a plan, and warns of empty splits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from coordinator.expansion.cells import empty_splits
from coordinator.expansion.plan_file import shrink
from schemas.plan import Plan
from schemas.rig.rig_file import load_rig
from schemas.terms import ExpertName, Recording


def shrunk_plan(plan: Plan, changes: Mapping[str, Any]) -> Plan:
    """Applies the shrink options to a plan."""
    expert = changes.get("expert")
    return shrink(
        plan,
        scenes=changes.get("scenes") or (),
        episodes=changes.get("episodes"),
        expert=ExpertName(expert) if expert else None,
        seed=changes.get("seed"),
        record=Recording(changes["record"]) if changes.get("record") else None,
        rig=load_rig(changes["rig"], control_hz=None) if changes.get("rig") else None,
        appearance=changes.get("appearance"),
    )


def warn_of_empty_splits(plan: Plan) -> None:
    """Prints on stderr which splits have no episodes because the plan has too few."""
    empty = empty_splits(plan)
    if empty:
        click.echo(f"note: {plan.episodes} episodes are too few; splits without episodes: {', '.join(empty)}", err=True)
