"""Writes a plan as TOML text, which `coordinator.expansion.file` reads back as the same plan. Pure."""

from __future__ import annotations

import tomli_w

from schemas.plan import Plan

__all__ = ["spell_plan"]


def spell_plan(plan: Plan) -> str:
    """Returns the plan as TOML, without values that equal their default, except for the shares."""
    shares = {"tiers", "splits"}
    data = plan.model_dump(mode="json", exclude_defaults=True, exclude_none=True, exclude=shares)
    scenes = data.pop("scenes")
    data |= plan.model_dump(mode="json", include=shares)
    data["scenes"] = scenes
    return tomli_w.dumps(data)
