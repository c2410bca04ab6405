"""Finds the scene of the argument SCENE|PACKAGE: a built-in or imported scene, a layout, or the file of a package.

A built-in scene or layout that is not in the cache is built.
"""

from __future__ import annotations

import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import click

from factory.runs.scene_packages import find_imported
from factory.scenes.stage_file import SCENE_SUFFIXES, find_fault
from factory.support.settings import scene_cache
from schemas.errors import UsageError
from schemas.scene import CompiledScene, read_scene
from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES, family_of, layout_number


class BuiltInLayout(NamedTuple):
    """Layout of a built-in scene: arguments of `build_scene`."""

    name: str
    seed: int
    called: str | None


def built_in_layout(name: str, seed: int) -> BuiltInLayout | None:
    """Returns the layout that the name of a built-in scene or of a layout denotes; `None` for any other name.

    Args:
        name: name of a built-in scene, such as `office`, or of a layout, such as `office_00007` with seed 7.
        seed: seed of the layout if the name has no number.

    Raises:
        UsageError: the name has a number, and `seed` is neither 0 nor this number.
    """
    number = layout_number(name)
    if number is None:
        return BuiltInLayout(name, seed, None) if name in BUILTIN_CATEGORIES else None
    if seed not in (0, number):
        raise UsageError(f"{name} is the layout of seed {number}, not {seed}; remove --seed")
    return BuiltInLayout(family_of(name), number, name)


def chosen_scene(scene: str, seed: int) -> CompiledScene:
    """Returns the scene with a name or in a file; raises the errors of `scene_package`."""
    return read_scene(scene_package(scene, seed))


def scene_package(scene: str, seed: int) -> Path:
    """Returns the package of a name or file; if the name was imported several times, the package of the last import.

    The number in the name of a layout is its seed.

    Raises:
        UsageError: the name or file does not exist, or the file is not a scene package.
    """
    path = Path(scene)
    if path.suffix.lower() in SCENE_SUFFIXES:
        raise UsageError(
            f"{scene} is a scene file, not a scene package; import it with `factory scene import {scene}` and give the "
            "package"
        )
    if path.suffix and not path.is_file():
        raise UsageError(f"file {scene} does not exist; give a scene package (*.scene.zip) or the name of a scene")
    if path.is_file() and path.suffix.lower() != ".zip" and not zipfile.is_zipfile(path):
        fault = find_fault(path) or f"{scene} is not a scene package"
        raise UsageError(f"{fault}; import the scene with `factory scene import` and give the package")
    return path if path.is_file() else _package_called(scene, seed)


def _package_called(name: str, seed: int) -> Path:
    from factory.scenes.build import build_scene

    built_in = built_in_layout(name, seed)
    if built_in is not None:
        return build_scene(built_in.name, built_in.seed, scene_cache(), called=built_in.called)
    imported = find_imported(scene_cache())
    if name not in imported:
        raise UsageError(_unknown_scene_error(name, imported))
    package, *older = imported[name]
    if older:
        click.echo(f"note: {name} was imported {len(older) + 1} times; the last import is used: {package}", err=True)
    return package


def _unknown_scene_error(name: str, imported: Collection[str]) -> str:
    return (
        f"{name!r} is neither a scene nor an existing file; built-in scenes: {', '.join(BUILTIN_CATEGORIES)}; "
        f"imported scenes: {', '.join(imported) or 'none'}; import a file with "
        f"`factory scene import FILE --name NAME`{did_you_mean(name, [*BUILTIN_CATEGORIES, *imported])}"
    )
