"""The arguments SCENE|PACKAGE and FILE, and `--seed`: scenes by name or by file. Opens no scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import click
from click.shell_completion import CompletionItem

from factory.cli.common.options import count_option
from factory.scenes.limits import Unit, UnitName
from schemas.terms import BUILTIN_CATEGORIES

_UNITS = get_args(UnitName)
_UNIT_RANGE_M = (1e-6, 1e6)


class UnitType(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """Unit of a file: `m`, `cm`, `mm`, `in`, or a number: the length of one unit in metres."""

    name = "unit"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Unit:
        """Returns the name, or the length in metres; other values are a usage error."""
        if isinstance(value, float) or value in _UNITS:
            return value  # type: ignore[no-any-return]  # click gives strings and defaults only
        try:
            metres = float(value)
        except ValueError:
            metres = 0.0
        least, most = _UNIT_RANGE_M
        if not least <= metres <= most:
            self.fail(f"{value!r}: give {', '.join(_UNITS)}, or metres from {least:g} to {most:g}", param, ctx)
        return metres

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Completes the names."""
        return [CompletionItem(name) for name in _UNITS if name.startswith(incomplete)]


seed_option = count_option("--seed", 0, "Random seed of the layout of a built-in scene.", least=0)


def complete_scene(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Completes the name of a built-in or imported scene, or a file."""
    from factory.runs.scene_packages import find_imported
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
