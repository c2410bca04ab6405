"""Prints the content of a new scene package: its size, its targets, and the instances that are not targets."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import click

from factory.cli.common.output import print_text
from factory.cli.scene.choice import open_scene
from factory.cli.scene.words import say_counts, say_rest, say_rules

__all__ = ["describe_package", "print_others", "print_package"]

_IN_WORDS = ("targets", "instances", "no_target", "notes")


def describe_package(path: Path) -> dict[str, Any]:
    """Returns the facts of a scene package as JSON data."""
    from factory.scenes.inspection import list_other_things

    scene = open_scene(path)
    info = scene.info
    return {
        "package": str(path),
        "bytes": path.stat().st_size,
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
    print_text(f"targets: {say_counts(facts['targets'])}")
    for note in facts["notes"]:
        click.echo(f"note: {note}", err=True)


def print_others(facts: dict[str, Any]) -> None:
    """Prints which instances are not targets, and how to make them targets."""
    for line in say_rest(facts["no_target"], facts["instances"]):
        print_text(line)
    if any(thing["category"] is None for thing in facts["no_target"]):
        print_text(say_rules())
