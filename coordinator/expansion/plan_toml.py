"""Serialises a plan as TOML, which `coordinator.expansion.file` parses into the same plan. Writes no file."""

from __future__ import annotations

import tomli_w

from schemas.plan import Plan


def plan_to_toml(plan: Plan) -> str:
    """Returns the plan as TOML. Values that equal their default are omitted, except shares and success measure."""
    shares = {"tiers", "splits"}
    data = plan.model_dump(mode="json", exclude_defaults=True, exclude_none=True, exclude=shares)
    scenes = [{"file" if key == "usd" else key: value for key, value in scene.items()} for scene in data.pop("scenes")]
    data["task"] = {"success": str(plan.task.success), **data.pop("task", {})}
    data |= plan.model_dump(mode="json", include=shares)
    data["scenes"] = scenes
    return tomli_w.dumps(data)
