"""How a verb is told which scene: a built-in name, built when the cache lacks it, or the file of a compiled package."""

from __future__ import annotations

from pathlib import Path

import click
from click.shell_completion import CompletionItem

from factory.settings import scene_cache
from schemas.errors import UsageError
from schemas.scene import CompiledScene, decode_scene
from schemas.terms import BUILTIN_CATEGORIES

__all__ = ["chosen_scene", "open_scene", "scene_argument", "seed_option"]


def _complete(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    names = [CompletionItem(name) for name in BUILTIN_CATEGORIES if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


scene_argument = click.argument("scene", metavar="SCENE|PACKAGE", shell_complete=_complete)
"""SCENE|PACKAGE: a built-in name or a compiled package (`*.scene.zip`)."""

seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Layout seed of a built-in scene."
)


def chosen_scene(scene: str, seed: int) -> CompiledScene:
    """Returns the scene that a user named.

    Raises:
        UsageError: neither a built-in name nor a file, or a file that is a stage and no package.
    """
    from factory.scenes.build import build_scene

    path = Path(scene)
    if path.suffix.lower().startswith(".usd"):
        raise UsageError(f"{scene} is a stage; compile it with `factory scene import {scene}` and give the package")
    if path.suffix and not path.is_file():
        raise UsageError(f"no file {scene}; give a compiled package (*.scene.zip) or the name of a built-in scene")
    return open_scene(path if path.is_file() else build_scene(scene, seed, scene_cache()))


def open_scene(path: Path) -> CompiledScene:
    """Reads a package."""
    with path.open("rb") as file:
        return decode_scene(file)
