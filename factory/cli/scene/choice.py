"""The arguments SCENE|PACKAGE and FILE, and `--seed`: scenes by name or by file. Opens no scene."""

from __future__ import annotations

from pathlib import Path

import click
from click.shell_completion import CompletionItem

from factory.cli.common.options import count_option
from schemas.terms import BUILTIN_CATEGORIES

seed_option = count_option("--seed", 0, "Random seed of the layout of a built-in scene.", least=0)


def complete_scene(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Completes the name of a built-in or imported scene, or a file."""
    from factory.runs.imported import find_imported
    from factory.support.settings import scene_cache

    known = [*BUILTIN_CATEGORIES, *find_imported(scene_cache())]
    names = [CompletionItem(name) for name in known if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


def _complete_file(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Completes files of the formats that `factory scene import` reads, with their format, and folders."""
    from factory.scenes.stage_file import SCENE_SUFFIXES, kind_of_file

    folder = word[: word.rfind("/") + 1]
    paths = sorted(Path(folder or ".").iterdir()) if Path(folder or ".").is_dir() else []
    files = [path for path in paths if path.suffix.lower() in SCENE_SUFFIXES and (folder + path.name).startswith(word)]
    items = [CompletionItem(folder + path.name, help=kind_of_file(path)) for path in files]
    return [*items, CompletionItem(word, type="dir")]


file_argument = click.argument("file", type=click.Path(path_type=Path), shell_complete=_complete_file)
"""FILE: a scene of any format that `factory scene import` reads."""

scene_argument = click.argument("scene", metavar="SCENE|PACKAGE", shell_complete=complete_scene)
"""SCENE|PACKAGE: the name of a built-in or imported scene or of a layout (`office_00007`), or a scene package
(`*.scene.zip`)."""
