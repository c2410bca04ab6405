"""How a verb is told which scene: a built-in name, built when the cache lacks it, the name of an imported scene, or the
file of a compiled package.
"""

from __future__ import annotations

import zipfile
from collections.abc import Collection
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from factory.runs.imported import find_imported
from factory.scenes.stage_file import STAGE_SUFFIXES, find_fault
from factory.support.settings import scene_cache
from schemas.errors import UsageError
from schemas.scene import CompiledScene, decode_scene
from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES

__all__ = ["chosen_scene", "open_scene", "scene_argument", "seed_option"]


def _complete(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    known = [*BUILTIN_CATEGORIES, *find_imported(scene_cache())]
    names = [CompletionItem(name) for name in known if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


scene_argument = click.argument("scene", metavar="SCENE|PACKAGE", shell_complete=_complete)
"""SCENE|PACKAGE: a built-in name, the name of an imported scene, or a compiled package (`*.scene.zip`)."""

seed_option = click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    metavar="N",
    help="Layout seed of a built-in scene.",
)


def chosen_scene(scene: str, seed: int) -> CompiledScene:
    """Returns the scene that a user named; of several packages imported under one name the last, and says so.

    Raises:
        UsageError: no such name or file, or a file that is not a package.
    """
    path = Path(scene)
    if path.suffix.lower() in STAGE_SUFFIXES:
        raise UsageError(f"{scene} is a stage; compile it with `factory scene import {scene}` and give the package")
    if path.suffix and not path.is_file():
        raise UsageError(f"no file {scene}; give a compiled package (*.scene.zip) or the name of a scene")
    if path.is_file() and path.suffix.lower() != ".zip" and not zipfile.is_zipfile(path):
        raise UsageError(f"{find_fault(path)}; compile the stage with `factory scene import` and give the package")
    return open_scene(path if path.is_file() else _package_called(scene, seed))


def open_scene(path: Path) -> CompiledScene:
    """Reads a package."""
    with path.open("rb") as file:
        return decode_scene(file)


def _package_called(name: str, seed: int) -> Path:
    from factory.scenes.build import build_scene

    if name in BUILTIN_CATEGORIES:
        return build_scene(name, seed, scene_cache())
    imported = find_imported(scene_cache())
    if name not in imported:
        raise UsageError(_say_unknown(name, imported))
    package, *older = imported[name]
    if older:
        click.echo(f"{name} was imported {len(older) + 1} times; taking the last, {package}", err=True)
    return package


def _say_unknown(name: str, imported: Collection[str]) -> str:
    return (
        f"no scene is called {name!r}, and no package lies there; built in: {', '.join(BUILTIN_CATEGORIES)}; "
        f"imported: {', '.join(imported) or 'none'}; compile a stage of your own with "
        f"`factory scene import FILE --name NAME`{did_you_mean(name, [*BUILTIN_CATEGORIES, *imported])}"
    )
