"""`factory scene inspect`: prints the content of a scene as text or JSON, and draws its map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.commands.common.output import print_result, print_table, print_text
from factory.commands.scene.choice import chosen_scene
from factory.commands.scene.package import describe_counts, describe_rest
from schemas.storage.disk import translated

_LISTED = ("categories", "targets", "no_target", "notes", "source_sha256", "bounds_m")
_TIERS = {
    "straight": "straight_tiers",
    "connected": "connected_tiers",
    "surface: straight": "surface_straight_tiers",
    "surface: connected": "surface_connected_tiers",
}
"""Column heading without `from` -> key of the tiers of a target, as in the output of `--json`."""


def execute(scene: str, seed: int, out: Path | None, as_json: bool) -> None:
    """Executes `factory scene inspect`."""
    from factory.scenes.inspection import describe_scene
    from factory.scenes.topdown import encode_topdown

    compiled = chosen_scene(scene, seed)
    if out is not None:
        with translated("write", out):
            out.write_bytes(encode_topdown(compiled))
    facts = describe_scene(compiled)
    print_result(facts, as_json, _print)


def _print(facts: dict[str, Any]) -> None:
    for key, value in facts.items():
        if key not in _LISTED:
            print_text(f"{key}: {_words(value)}")
    print_text(f"categories: {describe_counts(facts['categories'])}")
    for line in describe_rest(facts["no_target"], facts["instances"]):
        print_text(line)
    click.echo("")
    columns = ("id", "category", "colour", "centroid m", *(f"{kind} from" for kind in _TIERS), "prim")
    print_table("", columns, [_row(target) for target in facts["targets"]])
    for note in facts["notes"]:
        click.echo(f"note: {note}", err=True)


def _words(value: Any) -> str:
    return " x ".join(f"{side:g}" for side in value) if isinstance(value, list) else str(value)


def _row(target: dict[str, Any]) -> tuple[str, ...]:
    centroid = ", ".join(f"{value:.2f}" for value in target["centroid_m"])
    tiers = (" ".join(target[key]) or "-" for key in _TIERS.values())
    return (target["id"], target["category"], target["colour"], centroid, *tiers, target["prim_path"])
