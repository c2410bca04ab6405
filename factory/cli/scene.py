"""`factory scene`: list, build and import scenes; other verbs are files of their own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import click

from factory.cli import scene_inspect, scene_render, scene_survey, scene_targets
from factory.cli.options import verbose_option
from factory.cli.output import json_option, print_json, print_table, stderr
from factory.cli.scene_choice import open_scene
from factory.logs import configure_logs
from factory.settings import scene_cache

__all__ = ["command"]


@click.group("scene")
def command() -> None:
    """Built-in scenes and your own."""


command.add_command(scene_inspect.command)
command.add_command(scene_render.command)
command.add_command(scene_survey.command)
command.add_command(scene_targets.command)


@command.command("list")
@json_option
def list_(as_json: bool) -> None:
    """List the built-in scenes."""
    from factory.scenes.author import BUILTIN_SCENES
    from schemas.terms import BUILTIN_CATEGORIES

    rows = [
        (name, scene.summary, ", ".join(BUILTIN_CATEGORIES[name].seen), ", ".join(BUILTIN_CATEGORIES[name].held_out))
        for name, scene in BUILTIN_SCENES.items()
    ]
    if as_json:
        print_json([dict(zip(("name", "summary", "seen", "held_out"), row, strict=True)) for row in rows])
    else:
        print_table("", ("scene", "summary", "seen", "held out"), rows)


def _edit_options(verb: Callable[..., None]) -> Callable[..., None]:
    """`--rules --targets --cache`: what is called how, and where the package goes."""
    file = click.Path(path_type=Path)
    for option in (
        click.option("--cache", type=file, help="Folder for the package; default: the user's cache."),
        click.option("--targets", type=file, help="An edited list of targets (see `factory scene targets`)."),
        click.option("--rules", type=file, help="Your own table of category rules (YAML)."),
    ):
        verb = option(verb)
    return verb


@command.command("build")
@click.argument("name")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Layout seed.")
@_edit_options
@json_option
@verbose_option
def build(
    name: str, seed: int, rules: Path | None, targets: Path | None, cache: Path | None, as_json: bool, verbose: bool
) -> None:
    """Author and compile the built-in scene NAME; does nothing when it is in the cache."""
    from factory.scenes.build import build_scene, load_edits

    configure_logs(verbose)
    book, chosen = load_edits(rules, targets)
    with stderr.status(f"building {name}, seed {seed}"):
        path = build_scene(name, seed, cache or scene_cache(), book, chosen)
    _print_scene(path, as_json)


@command.command("import")
@click.argument("usd", type=click.Path(path_type=Path))
@click.option("--name", help="Name of the scene; default: the file's.")
@click.option("--max-triangles", type=click.IntRange(1), help="Refuse larger stages.  [default: 10000000]")
@click.option("--allow-outside", is_flag=True, help="Also read textures from outside of the stage's folder.")
@_edit_options
@json_option
@verbose_option
def import_(
    usd: Path,
    name: str | None,
    max_triangles: int | None,
    allow_outside: bool,
    rules: Path | None,
    targets: Path | None,
    cache: Path | None,
    as_json: bool,
    verbose: bool,
) -> None:
    """Compile your own stage (usd, usda, usdc, usdz)."""
    from factory.scenes.build import import_scene, load_edits  # needs usd-core
    from factory.scenes.limits import MAX_TRIANGLES, StageLimits

    configure_logs(verbose)
    book, chosen = load_edits(rules, targets)
    limits = StageLimits(max_triangles or MAX_TRIANGLES, allow_outside)
    with stderr.status(f"importing {usd}"):
        path = import_scene(usd, name or usd.stem.lower(), cache or scene_cache(), book, chosen, limits)
    _print_scene(path, as_json)


def _print_scene(path: Path, as_json: bool) -> None:
    scene = open_scene(path)
    info = scene.info
    facts = {
        "package": str(path),
        "bytes": path.stat().st_size,
        "triangles": len(scene.positions) // 3,
        "collider_triangles": len(scene.collider_triangles),
        "textures": info.texture_count,
        "free_area_m2": round(info.free_area_m2, 1),
        "spawns": len(scene.spawns),
        "targets": dict(sorted(Counter(target.category for target in info.targets).items())),
        "notes": list(info.notes),
    }
    if as_json:
        print_json(facts)
        return
    for key, value in facts.items():
        if key == "notes":
            for note in info.notes:
                click.echo(f"note: {note}", err=True)
        else:
            click.echo(f"{key}: {value}")
