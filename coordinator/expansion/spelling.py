"""Writes a plan as TOML text, which `coordinator.expansion.file` reads back as the same plan. Pure."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from schemas.plan import Plan

__all__ = ["spell_plan"]


def spell_plan(plan: Plan) -> str:
    """Returns the plan as TOML; what is as usual is left out, but for the shares."""
    shares = {"tiers", "splits"}
    data = plan.model_dump(mode="json", exclude_defaults=True, exclude_none=True, exclude=shares)
    data |= plan.model_dump(mode="json", include=shares)
    scenes = data.pop("scenes")
    lines = list(_table("", data))
    for scene in scenes:
        lines += ["", "[[scenes]]", *_table("scenes", scene)]
    return "\n".join(lines) + "\n"


def _table(path: str, data: dict[str, Any]) -> Iterator[str]:
    """Plain keys first, then tables: TOML has no way back out of a table."""
    inner = {key: value for key, value in data.items() if isinstance(value, dict)}
    for key, value in data.items():
        if key not in inner:
            yield f"{key} = {json.dumps(value, ensure_ascii=False)}"
    for key, value in inner.items():
        name = f"{path}.{key}" if path else key
        yield from ("", f"[{name}]", *_table(name, value))
