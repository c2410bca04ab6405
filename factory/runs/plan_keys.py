"""Lists the keys of plan files from the models of a plan: type, default and meaning. Writes the starter plan.

The meanings are the docstrings of the fields, so the list cannot differ from the models.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import textwrap
import typing
from collections.abc import Iterator, Sequence
from enum import Enum
from functools import cache
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from schemas.plan import Plan
from schemas.support.toml_file import models_in

_ENDLESS = 1e9
"""Bounds of at least this size only exclude infinite numbers."""
_IN_A_FILE = {"name": '"FILE"', "task.success": '"surface"'}
"""Defaults of a plan file that differ from those of the model."""
_ELSEWHERE = ("rig", "appearance")
"""Keys whose tables have their own documents."""
_NOT_IN_FILES = frozenset({"correction", "extends"})
"""Keys that a plan file cannot have."""

STARTER = """\
# A plan of minivla-factory. `factory plan keys` explains every key; `factory plan show FILE` checks this file.
name = "mine"
seed = 42                  # another seed gives other episodes
record = "states"          # trajectories, about 15 kB per episode; "frames" also stores images, about 40 MB
expert = "planner"         # drives around obstacles; "proportional" is the expert of the paper

[tiers]                    # distance of the start from the target: 1.5 to 3.5 m, 3.5 to 7 m, or a drive of 5 to 11 m
near = 0.4
mid = 0.4
far = 0.2

[splits]                   # shares of the episodes; *_ood_obj uses categories that training does not contain
train_id = 0.7
test_id = 0.1
test_paraphrase_ood = 0.1
test_ood_obj = 0.1

[[scenes]]
name = "office"            # office, hospital, full_warehouse, warehouse_multiple_shelves, home, shop, school
episodes = 100

[[scenes]]
name = "home"              # a family: every layout is another home
layouts = 10
episodes = 100

# [[scenes]]               # your own scene; `factory scene import FILE` shows what it contains
# name = "my_lab"
# file = "lab/world.usda"  # relative to this file
# seen = ["chair", "table"]
# held_out = ["plant"]
# episodes = 100

# [language]               # verified sentences that fit only the target, instead of templates
"""


class PlanKey(NamedTuple):
    """One key of a plan file."""

    key: str
    """Path of the key, e.g. `camera.fov_deg`; `scenes[].` for keys of each scene."""
    type: str
    """Values that the key takes."""
    default: str
    """Default as TOML; empty if there is none, `required` if the key must be given."""
    meaning: str
    """Meaning with its unit."""


def list_keys() -> tuple[PlanKey, ...]:
    """Returns every key of a plan file, in the order of the models."""
    return tuple(_keys_of(Plan, ""))


def describe_key(key: PlanKey, width: int) -> str:
    """Returns a key as wrapped text.

    Args:
        key: key.
        width: largest length of a line, characters.
    """
    default = {"": "", "required": " (required)"}.get(key.default, f" (default: {key.default})")
    lines = textwrap.wrap(f"{key.type}{default}. {key.meaning}", max(20, width - 4))
    return "\n".join([key.key, *(f"    {line}" for line in lines)])


def keys_as_markdown(keys: Sequence[PlanKey]) -> str:
    """Returns keys as the table of the documentation."""
    rows = ["| key | values | default | meaning |", "|---|---|---|---|"]
    for key in keys:
        cells = (f"`{key.key}`", key.type, f"`{key.default}`" if key.default else "", key.meaning)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def _keys_of(model: type[BaseModel], prefix: str) -> Iterator[PlanKey]:
    meanings = _docstrings(model)
    for name, field in model.model_fields.items():
        if name in _NOT_IN_FILES:
            continue
        inner = next(models_in(field.annotation), None)
        key = f"{prefix}{name}"
        if inner is None or name in _ELSEWHERE:
            values = "a name, a file or a table" if name in _ELSEWHERE else _values(field.annotation, field)
            yield PlanKey(key, values, _IN_A_FILE.get(key) or _default(field), meanings.get(name, ""))
        else:
            is_list = typing.get_origin(field.annotation) is tuple
            yield PlanKey(f"{key}[]" if is_list else key, "tables" if is_list else "table", "", meanings.get(name, ""))
            yield from _keys_of(inner, f"{key}[]." if is_list else f"{key}.")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or isinstance(value, BaseModel):
        return ""
    return _toml(value)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Enum | str):
        return f'"{value}"'
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }" if value else "{}"
    if isinstance(value, tuple | list | frozenset):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _values(annotation: Any, field: FieldInfo | None = None) -> str:
    """Returns the values of a type as text, e.g. `number from 0 to 1` or `"m", "cm"`."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _with_bounds(_values(parts[0]), [*parts[1:], *(field.metadata if field else [])])
    if origin is Literal:
        return ", ".join(f'"{part}"' for part in parts)
    if origin is dict:
        return f"table; each value: {_values(parts[1])}"
    if origin is tuple or origin is list:
        kinds = [_values(part) for part in parts if part is not Ellipsis]
        return f"list; each: {', '.join(dict.fromkeys(kinds))}"
    if parts:  # a union
        return " or ".join(_values(part) for part in parts if part is not type(None))
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return ", ".join(f'"{one.value}"' for one in annotation)
    names = {bool: "true, false", int: "integer", float: "number", str: "text"}
    return _with_bounds(names.get(annotation, "value"), field.metadata if field else [])


def _with_bounds(kind: str, metadata: Any) -> str:
    bounds: dict[str, Any] = {}
    for constraint in metadata:
        for part in getattr(constraint, "metadata", None) or (constraint,):
            for name in ("ge", "gt", "le", "lt"):
                if (value := getattr(part, name, None)) is not None and abs(value) < _ENDLESS:
                    bounds[name] = value
    if kind not in {"integer", "number"}:
        return kind
    low = f"from {bounds['ge']:.10g}" if "ge" in bounds else f"above {bounds['gt']:g}" if "gt" in bounds else ""
    high = f"to {bounds['le']:.10g}" if "le" in bounds else f"below {bounds['lt']:g}" if "lt" in bounds else ""
    return " ".join(part for part in (kind, low, high) if part)


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Returns the docstring below each field of a model, as one line."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not issubclass(base, BaseModel) or base is BaseModel:
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        body = tree.body if isinstance(tree, ast.ClassDef) else []
        for field, text in itertools.pairwise(body):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
            ):
                found[field.target.id] = " ".join(str(text.value.value).split())
    return found
