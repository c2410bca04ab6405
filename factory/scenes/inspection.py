"""Describes a compiled scene and its package as plain data and as text: categories, targets, units, extents, notes.

Also proposes the commands to run after an import, with a first plan. Does not validate the scene.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from coordinator.expansion.catalog import SceneEntry, read_entry
from coordinator.expansion.nearest import find_nearest
from coordinator.expansion.plan_file import plan_to_toml
from factory.scenes.rules import BUILTIN_RULES
from factory.support.terminal import print_table, print_text
from schemas.config import TaskConfig
from schemas.plan import PAPER_SPLITS, Plan, ScenePlan
from schemas.scene import CompiledScene, SceneInfo, Target, read_geometry
from schemas.support.shell import quoted
from schemas.terms import Split, SuccessMeasure

_OTHER_LINES = ("categories", "targets", "no_target", "notes", "source_sha256", "bounds_m")
_TIERS = {
    "straight": "straight_tiers",
    "connected": "connected_tiers",
    "surface: straight": "surface_straight_tiers",
    "surface: connected": "surface_connected_tiers",
}
"""Column heading without `from` -> key of the tiers of a target, as in the output of `--json`."""
_IN_WORDS = ("targets", "instances", "no_target", "notes")
_MOST_NAMES = 12
_EPISODES = 100


def describe_scene(scene: CompiledScene) -> dict[str, Any]:
    """Returns the description of a scene as JSON-compatible data, lengths in metres."""
    info = scene.info
    (west, south, bottom), (east, north, top) = info.bounds_m
    return {
        "name": info.name,
        "source": info.source,
        "source_sha256": info.source_sha256,
        "metres_per_unit": info.metres_per_unit,
        "bounds_m": [list(corner) for corner in info.bounds_m],
        "extents_m": [round(side, 3) for side in (east - west, north - south, top - bottom)],
        "floor_height_m": info.floor_height_m,
        "free_area_m2": info.free_area_m2,
        "spawns": len(scene.spawns),
        "triangles": len(scene.positions) // 3,
        "collider_triangles": len(scene.collider_triangles),
        "textures": info.texture_count,
        "instances": len(info.instances),
        "categories": dict(sorted(Counter(target.category for target in info.targets).items())),
        "targets": [describe_target(target) for target in info.targets],
        "no_target": list_other_things(info),
        "notes": list(info.notes),
    }


def list_other_things(info: SceneInfo) -> list[dict[str, str | None]]:
    """Returns the instances of a scene that are not targets: walls, floor, unreachable and uncategorised objects."""
    targets = {target.instance_id for target in info.targets}
    return [
        {"prim_path": instance.prim_path, "category": instance.category}
        for instance in info.instances
        if instance.id not in targets
    ]


def describe_target(target: Target) -> dict[str, Any]:
    """Returns the description of a target as JSON-compatible data."""
    return {
        "id": target.target_id,
        "category": target.category,
        "colour": target.colour,
        "centroid_m": list(target.centroid_m),
        "size_m": list(target.size_m),
        "straight_tiers": [str(tier) for tier in target.straight_tiers],
        "connected_tiers": [str(tier) for tier in target.connected_tiers],
        "footprint_m": [list(vertex) for vertex in target.footprint_m],
        "surface_straight_tiers": [str(tier) for tier in target.surface_straight_tiers],
        "surface_connected_tiers": [str(tier) for tier in target.surface_connected_tiers],
        "prim_path": target.prim_path,
    }


def print_scene(facts: dict[str, Any]) -> None:
    """Prints the description of a scene as text."""
    for key, value in facts.items():
        if key not in _OTHER_LINES:
            print_text(f"{key}: {_format_value(value)}")
    print_text(f"categories: {describe_counts(facts['categories'])}")
    for line in describe_rest(facts["no_target"], facts["instances"]):
        print_text(line)
    click.echo("")
    columns = ("id", "category", "colour", "centroid m", *(f"{kind} from" for kind in _TIERS), "prim")
    print_table("", columns, [_target_row(target) for target in facts["targets"]])
    for note in facts["notes"]:
        click.echo(f"note: {note}", err=True)


def _format_value(value: Any) -> str:
    return " x ".join(f"{side:g}" for side in value) if isinstance(value, list) else str(value)


def _target_row(target: dict[str, Any]) -> tuple[str, ...]:
    centroid = ", ".join(f"{value:.2f}" for value in target["centroid_m"])
    tiers = (" ".join(target[key]) or "-" for key in _TIERS.values())
    return (target["id"], target["category"], target["colour"], centroid, *tiers, target["prim_path"])


def describe_package(path: Path) -> dict[str, Any]:
    """Returns the facts of a scene package as JSON data."""
    scene = read_geometry(path)
    info = scene.info
    return {
        "package": str(path),
        "bytes": path.stat().st_size,
        "shared_texture_bytes": sum(texture.size for texture in info.textures),
        "triangles": len(scene.positions) // 3,
        "collider_triangles": len(scene.collider_triangles),
        "textures": info.texture_count,
        "free_area_m2": round(info.free_area_m2, 1),
        "spawns": len(scene.spawns),
        "targets": dict(sorted(Counter(target.category for target in info.targets).items())),
        "instances": len(info.instances),
        "no_target": list_other_things(info),
        "notes": list(info.notes),
    }


def print_package(facts: dict[str, Any]) -> None:
    """Prints the facts as text."""
    for key, value in facts.items():
        if key not in _IN_WORDS:
            print_text(f"{key}: {value}")
    print_text(f"targets: {describe_counts(facts['targets'])}")
    for note in facts["notes"]:
        click.echo(f"note: {note}", err=True)


def print_others(facts: dict[str, Any]) -> None:
    """Prints which instances are not targets, and how to make them targets."""
    for line in describe_rest(facts["no_target"], facts["instances"]):
        print_text(line)
    if any(thing["category"] is None for thing in facts["no_target"]):
        print_text(describe_rules())


def describe_counts(categories: Mapping[str, int]) -> str:
    """Returns counts such as `6 shelf, 1 trash_can`, ordered by name; `none` if there are none."""
    return ", ".join(f"{categories[name]} {name}" for name in sorted(categories)) or "none"


def describe_rest(others: Sequence[Mapping[str, str | None]], instances: int) -> Iterator[str]:
    """Yields lines about the instances that are not targets, with the names of some of them.

    Args:
        others: the instances that are not targets, as returned by `list_other_things`.
        instances: number of instances in the scene.
    """
    yield f"not targets: {len(others)} of {instances} instances"
    nameless = [str(one["prim_path"]) for one in others if one["category"] is None]
    named = [f"{one['prim_path']} ({one['category']})" for one in others if one["category"] is not None]
    for names, why in ((nameless, "without a category"), (named, "with a category, but unreachable or excluded")):
        if names:
            yield f"  {len(names)} {why}: {_some(names)}"


def describe_rules() -> str:
    """Returns how to make an instance without a category a target."""
    return (
        f"to assign a category: copy {BUILTIN_RULES}, add rules, and import again with --rules FILE; for a few prims, "
        "add them to the file of `factory scene targets` and import again with --targets FILE"
    )


def _some(names: Sequence[str]) -> str:
    more = f", and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more


@dataclass(frozen=True)
class Steps:
    """Suggested next steps."""

    next: tuple[str, ...]
    """Commands to run next, in this order."""
    plan: str | None
    """A first plan as TOML; `None` if no target has a feasible start."""


def next_steps(package: Path, file: Path, is_in_cache: bool, files: dict[str, object]) -> Steps:
    """Returns the next steps for a scene package.

    Args:
        package: file of the scene package.
        file: root file of the scene.
        is_in_cache: True if the package is in the cache, where it is found by name.
        files: files and other options of the import, as in the scene of a plan.
    """
    entry = read_entry(package)
    name = entry.info.name
    scene = name if is_in_cache else quoted(package)
    plan = draft_plan(entry, str(file.resolve()), **files)
    commands = (f"factory scene inspect {scene} -o {name}.png", f"factory scene survey {scene}")
    ready = (f"factory plan show {name}.toml",) if plan else ()
    return Steps((*commands, *ready), None if plan is None else plan_to_toml(plan))


def print_steps(steps: Steps) -> None:
    """Prints the next steps as text."""
    *looks, last = steps.next
    for number, step in enumerate(looks if steps.plan else steps.next):
        click.echo(f"{'next:' if number == 0 else '':<8} {step}")
    if steps.plan is not None:
        click.echo(f"{'':<8} {last}, after saving this plan to that file:\n\n{steps.plan}", nl=False)


def draft_plan(entry: SceneEntry, file: str, **files: object) -> Plan | None:
    """Returns a feasible plan of a scene; holds out the rarest category if the scene has two or more.

    Args:
        entry: Scene.
        file: Path of the root file of the scene.
        files: Options of the import, as in the scene of a plan.

    Returns:
        The plan, or `None` when no target has a valid start pose for the expert.
    """
    counts = Counter(target.category for target in entry.info.targets)
    seen = sorted(counts, key=lambda name: (-counts[name], name))
    held_out = [seen.pop()] if len(seen) > 1 else []
    scene = ScenePlan.model_validate(
        {"name": entry.info.name, "file": file, "seen": seen, "held_out": held_out, "episodes": _EPISODES, **files}
    )
    splits = PAPER_SPLITS if held_out else _without_held_out()
    task = TaskConfig(success=SuccessMeasure.SURFACE)
    plan = Plan(name=entry.info.name, scenes=(scene,), splits=dict(splits), task=task)
    return find_nearest(plan, {entry.info.name: entry}).plan


def _without_held_out() -> dict[Split, float]:
    kept = {split: share for split, share in PAPER_SPLITS.items() if split is not Split.TEST_OOD_OBJ}
    return {split: round(share / sum(kept.values()), 4) for split, share in kept.items()}
