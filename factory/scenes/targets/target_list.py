"""Reads and writes `targets_<scene>.yaml`, the target list of a scene that users edit.

Does not apply the list; `target_edits.py` does.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from factory.scenes.yaml_text import os_reason, read_yaml
from schemas.base import Model, Name
from schemas.errors import UsageError
from schemas.scene import SceneInfo, Target
from schemas.support.shell import quoted
from schemas.terms import COLOUR_NAMES

_HEAD = """\
# The targets of {scene}. Set `enabled: false` to disable one, change its category, colour or id, delete rows that
# are not targets, or add a prim by its path; then `factory scene {verb} ... --targets FILE`, or `targets = "FILE"`
# below the scene in a plan. Centroid and size (metres) are information only and are not read back.
# `box_m` instead of `prim_path` makes the part of a mesh in a box a target: its lower and upper corner, metres.
"""
_FARTHEST_M = 10_000.0
BOXES = "/Boxes"
"""Path of the objects that boxes cut out of the meshes of a scene."""


Coordinate = Annotated[float, Field(ge=-_FARTHEST_M, le=_FARTHEST_M)]
Corner = tuple[Coordinate, Coordinate, Coordinate]


class TargetEntry(Model):
    """Row of the list: a prim, or the part of the scene in a box, with the id, category and colour of its target."""

    id: Name
    """Target id in the dataset, e.g. `chair_007`."""
    category: Name
    colour: str = "unknown"
    """One of the eleven basic colours, or `unknown`."""
    enabled: bool = True
    prim_path: Annotated[str, Field(pattern="^/")] = ""
    """Path of the prim; of a row with a box, `/Boxes/` and its id."""
    box_m: tuple[Corner, Corner] | None = None
    """Lower and upper corner of a box, world metres, z up: the part of the scene in it is the target."""
    centroid_m: tuple[float, float, float] | None = None
    size_m: tuple[float, float, float] | None = None

    @model_validator(mode="before")
    @classmethod
    def _has_a_path(cls, row: Any) -> Any:
        if not isinstance(row, dict) or row.get("box_m") is None:
            if isinstance(row, dict) and not row.get("prim_path"):
                raise ValueError("give `prim_path`, or `box_m` with two corners")
            return row
        path = f"{BOXES}/{row.get('id')}"
        if row.get("prim_path") not in (None, path):
            raise ValueError("give either `prim_path` or `box_m`")
        return {**row, "prim_path": path}

    @field_validator("box_m")
    @classmethod
    def _has_a_volume(cls, box: tuple[Corner, Corner] | None) -> tuple[Corner, Corner] | None:
        if box is not None and not all(low < high for low, high in zip(*box, strict=True)):
            raise ValueError("the first corner must be below the second one in x, y and z")
        return box

    @field_validator("colour")
    @classmethod
    def _is_a_colour(cls, colour: str) -> str:
        if colour not in (*COLOUR_NAMES, "unknown"):
            raise ValueError(f"not a valid colour; valid colours: {', '.join(COLOUR_NAMES)}, unknown")
        return colour


class TargetList(Model):
    """Content of the file. Prims that it does not list are not targets."""

    scene: Name
    targets: tuple[TargetEntry, ...]

    @model_validator(mode="after")
    def _makes_sense(self) -> TargetList:
        for what, values in (("id", [e.id for e in self.targets]), ("prim_path", [e.prim_path for e in self.targets])):
            twice = sorted({value for value in values if values.count(value) > 1})
            if twice:
                raise ValueError(f"{what} is listed twice: {', '.join(twice)}")
        if not any(entry.enabled for entry in self.targets):
            raise ValueError("all targets are disabled; enable at least one")
        return self

    @property
    def digest(self) -> str:
        """SHA-256 of the rows, without comments, centroids and sizes, which have no effect."""
        rows = (
            f"{e.prim_path}\n{e.id}\n{e.category}\n{e.colour}\n{e.enabled}" + (f"\n{e.box_m}" if e.box_m else "")
            for e in self.targets
        )
        return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()


def list_file_name(scene: str) -> str:
    return f"targets_{scene}.yaml"


def format_target_list(info: SceneInfo) -> str:
    """Returns the text of the target list of a compiled scene, all targets enabled."""
    rows = [
        {
            "id": target.target_id,
            "category": target.category,
            "colour": target.colour,
            "enabled": True,
            "centroid_m": list(target.centroid_m),
            "size_m": list(target.size_m),
            **_place_of(target),
        }
        for target in info.targets
    ]
    verb = "build" if info.source.startswith("built-in ") else "import"
    body = yaml.safe_dump({"scene": info.name, "targets": rows}, sort_keys=False, default_flow_style=None, width=120)
    return _HEAD.format(scene=info.name, verb=verb) + body


def _place_of(target: Target) -> dict[str, Any]:
    """Returns the prim of a target or, if a box cut it out, a box slightly larger than the target."""
    if not target.prim_path.startswith(f"{BOXES}/"):
        return {"prim_path": target.prim_path}
    sides = [(middle, size / 2 + 1e-3) for middle, size in zip(target.centroid_m, target.size_m, strict=True)]
    return {"box_m": [[round(middle + sign * half, 4) for middle, half in sides] for sign in (-1, 1)]}


def load_target_list(path: Path, scene: str = "SCENE") -> TargetList:
    """Reads a target list.

    Args:
        path: path of the file.
        scene: name of the scene, used in the command that an error message suggests.

    Raises:
        UsageError: the file does not exist or is not valid; the message lists every error with its row.
    """
    try:
        return TargetList.model_validate(read_yaml(path.read_text(encoding="utf-8")))
    except OSError as error:
        command = f"factory scene targets {scene} -o {quoted(path)}"
        raise UsageError(
            f"cannot read targets file {path} ({os_reason(error)}); use all targets without --targets, or create "
            f"the file with `{command}`"
        ) from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not a valid targets file: it is not UTF-8 text") from error
    except yaml.YAMLError as error:
        raise UsageError(f"{path} is not valid YAML: {error}") from error
    except ValidationError as error:
        mistakes = "\n".join(f"  - {_key(item['loc'])}{_message(item['msg'])}" for item in error.errors())
        raise UsageError(f"{path} is not a valid targets file:\n{mistakes}") from error


def _key(place: tuple[int | str, ...]) -> str:
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")
    return f"{key}: " if key else ""


def _message(text: str) -> str:
    return text.removeprefix("Value error, ")
