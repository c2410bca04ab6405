"""`factory scene`: the group and its commands `build` and `import`; the other commands have their own modules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import click

from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import count_option, former_option, verbose_option, write_option
from factory.cli.common.output import json_option, print_json, print_result, stderr
from factory.cli.scene import inspect as scene_inspect
from factory.cli.scene import light as scene_light
from factory.cli.scene import list as scene_list
from factory.cli.scene import render as scene_render
from factory.cli.scene import survey as scene_survey
from factory.cli.scene import targets as scene_targets
from factory.cli.scene.choice import seed_option
from factory.cli.scene.package import describe_package, next_steps, print_others, print_package, print_steps
from factory.scenes.limits import MAX_TRIANGLES, StageLimits
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache


@click.group("scene", cls=CommandGroup)
def command() -> None:
    """Build, import, inspect and render scenes."""


command.add_command(scene_list.command)
command.add_command(scene_inspect.command)
command.add_command(scene_light.command)
command.add_command(scene_render.command)
command.add_command(scene_survey.command)
command.add_command(scene_targets.command)


def _edit_options(verb: Callable[..., None]) -> Callable[..., None]:
    """Adds `--rules --targets --out`: category rules, targets, and the folder of the package."""
    file = click.Path(path_type=Path)
    for option in (
        former_option("--cache", "cache", "--out", type=file),
        write_option("DIR", "Output folder of the scene package. Default: the user's cache.", "cache"),
        click.option(
            "--targets",
            type=file,
            metavar="FILE",
            help="List of targets, written by `factory scene targets` and edited. Default: all that the rules find.",
        ),
        click.option(
            "--rules", type=file, metavar="FILE", help="YAML file of category rules. Default: the built-in rules."
        ),
    ):
        verb = option(verb)
    return verb


@command.command("build")
@click.argument("name")
@seed_option
@_edit_options
@json_option
@verbose_option
def build(
    name: str, seed: int, rules: Path | None, targets: Path | None, cache: Path | None, as_json: bool, verbose: bool
) -> None:
    """Build a built-in scene.

    NAME is the name of a built-in scene; see `factory scene list`. A scene that is in the cache is not built again.
    """
    from factory.scenes.build import build_scene, load_edits

    configure_logs(verbose)
    book, chosen = load_edits(rules, targets, name)
    with stderr.status(f"building {name}, seed {seed}"):
        path = build_scene(name, seed, cache or scene_cache(), book, chosen)
    facts = describe_package(path)
    print_result(facts, as_json, print_package)


@command.command("import")
@click.argument("usd", type=click.Path(path_type=Path))
@click.option("--name", metavar="NAME", help="Name of the scene. Default: the file name without suffix.")
@count_option("--max-triangles", MAX_TRIANGLES, "Maximum number of triangles; a larger stage is an error.")
@click.option("--allow-outside", is_flag=True, help="Also read textures outside of the stage's folder.")
@click.option(
    "--ceiling",
    type=click.FloatRange(1.0, 100.0),
    metavar="M",
    help="Height above the floor of a flat ceiling to add to an open stage, metres. Default: none.",
)
@_edit_options
@json_option
@verbose_option
def import_(
    usd: Path,
    name: str | None,
    max_triangles: int,
    allow_outside: bool,
    ceiling: float | None,
    rules: Path | None,
    targets: Path | None,
    cache: Path | None,
    as_json: bool,
    verbose: bool,
) -> None:
    """Import a USD stage as a scene package.

    USD is a .usd, .usda, .usdc or .usdz file.
    """
    from factory.scenes.build import import_scene, load_edits  # needs usd-core

    configure_logs(verbose)
    called = name or usd.stem.lower()
    book, chosen = load_edits(rules, targets, called)
    limits = StageLimits(max_triangles, allow_outside, ceiling)
    with stderr.status(f"importing {usd}"):
        path = import_scene(usd, called, cache or scene_cache(), book, chosen, limits)
    facts = describe_package(path)
    made_with = {"rules": rules, "targets": targets}
    files: dict[str, object] = {key: str(file.resolve()) for key, file in made_with.items() if file is not None}
    if allow_outside:
        files["allow_outside"] = True
    if ceiling is not None:
        files["ceiling_m"] = ceiling
    steps = next_steps(path, usd, cache is None, files)
    if as_json:
        print_json(facts | asdict(steps))
    else:
        print_package(facts)
        print_others(facts)
        print_steps(steps)
