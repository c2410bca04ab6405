"""Writes routes of recorded paths as rows of `instructions.parquet` and `steps.parquet`. Opens no file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from schemas.language.instruction import InstructionKind
from schemas.language.route.model import RouteText

STEPS_SCHEMA = pa.schema(
    [
        ("episode_id", pa.string()),
        *((name, pa.int64()) for name in ("index", "number", "step", "start", "end")),
        *((name, pa.string()) for name in ("kind", "instruction", "language", "register", "template_id", "meaning")),
        ("held_out", pa.bool_()),
    ]
)
"""Columns of `steps.parquet` (docs/language.md#routes)."""


def route_row(episode_id: str, index: int, route: RouteText, distractors: int) -> dict[str, Any]:
    """Returns the row of a route in `instructions.parquet`, without its number."""
    kinds = sorted({str(each.step.kind) for each in route.steps})
    return {
        "episode_id": episode_id,
        "index": index,
        "kind": str(InstructionKind.ROUTE),
        "instruction": route.text,
        "language": route.language,
        "register": route.register_name,
        "template_id": route.template_id,
        "held_out": route.held_out,
        "expression": json.dumps([each.step.model_dump(mode="json") for each in route.steps]),
        "features": ",".join(kinds),
        "is_minimal": False,
        "fits": 1,
        "distractors": distractors,
    }


def step_rows(row: dict[str, Any], route: RouteText) -> Sequence[dict[str, Any]]:
    """Returns the rows of the steps of a route.

    Args:
        row: row of the route in `instructions.parquet`, with its number.
        route: the route.
    """
    shared = {name: row[name] for name in ("episode_id", "index", "number", "language", "register", "template_id")}
    return [
        {
            **shared,
            "held_out": route.held_out,
            "step": each.number,
            "start": each.start,
            "end": each.end,
            "kind": str(each.step.kind),
            "instruction": each.text,
            "meaning": each.step.model_dump_json(),
        }
        for each in route.steps
    ]
