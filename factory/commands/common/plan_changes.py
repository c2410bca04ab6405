"""Applies the changes of a plan that a benchmark makes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from factory.runs import start
from factory.runs.plan_changes import PlanChanges
from schemas.plan import Plan


def shrunk_plan(plan: Plan, changes: Mapping[str, Any]) -> Plan:
    """Applies changes to a plan."""
    return start.shrunk_plan(plan, PlanChanges(**changes))
