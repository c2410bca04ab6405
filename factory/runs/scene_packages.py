"""Finds scene packages: of an episode, of imported scenes in the cache, and of a name or file that a user gives.

Also lists the scenes of the cache and of a dataset. Builds the built-in scene or layout that a user gives, if it is not
in the cache; imports no scene file.
"""

from __future__ import annotations

import re
import zipfile
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import click

from coordinator.expansion.catalog import SceneEntry, read_entry
from factory.dataset.packages import find_package_file, package_file, packages_of
from factory.scenes.stage_file import SCENE_SUFFIXES, find_fault
from factory.support.settings import scene_cache, scene_path
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.origin import EpisodeOrigin
from schemas.errors import FactoryError, UsageError, WorldError
from schemas.layouts import LayoutPlan
from schemas.plan import ScenePlan
from schemas.scene import CompiledScene, read_info, read_scene
from schemas.storage.place import Place, digest_of
from schemas.support.shell import quoted
from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES, family_of, layout_number

_PACKAGE = re.compile(r"([a-z][a-z0-9_]{0,63})-[0-9a-f]{12}\.scene\.zip")


def find_package(root: Place, name: str, sha256: str) -> SceneEntry:
    """Returns the scene package with which an episode was generated.

    Raises:
        ArchiveCorrupt: No package has the digest.
    """
    return read_entry(find_package_file(root, name, sha256))


def package_of_origin(origin: EpisodeOrigin, scenes: Place | None) -> Path:
    """Returns the package of the scene of an exported episode.

    Args:
        origin: origin of the episode.
        scenes: folder with the package; `None` searches `MINIVLA_SCENES` and the cache, and builds a built-in scene.

    Raises:
        WorldError: no package with the recorded digest was found or built.
    """
    job = origin.job
    folders = (scenes,) if scenes is not None else (*scene_path(), scene_cache())
    for place in (place for folder in folders for place in packages_of(folder, job.scene)):
        path = package_file(place)
        if digest_of(path) == job.scene_sha256:
            return path
    built = built_in_layout(job.scene, 0) if scenes is None else None
    if built is not None:
        from factory.scenes.build import build_scene

        path = build_scene(built.name, built.seed, scene_cache(), called=built.called)
        if digest_of(path) == job.scene_sha256:
            return path
    raise WorldError(
        f"{origin.episode} needs the package of scene {job.scene} with SHA-256 {job.scene_sha256}, which is not in "
        f"{', '.join(map(str, folders))}{' and which this version does not build' if built else ''}: give --scenes "
        "with "
        "the folder `scenes` of the dataset"
    )


def find_imported(cache: Path) -> dict[str, tuple[Path, ...]]:
    """Returns the packages of imported scenes.

    Args:
        cache: Folder of packages; it need not exist.

    Returns:
        The packages by scene name, the most recently written first.
    """
    packages: dict[str, list[tuple[int, str, Path]]] = {}
    for path in cache.glob("*.scene.zip"):
        named = _PACKAGE.fullmatch(path.name)
        if named is not None and family_of(named[1]) not in BUILTIN_CATEGORIES:
            packages.setdefault(named[1], []).append((path.stat().st_mtime_ns, path.name, path))
    return {name: tuple(path for *_, path in sorted(packages[name], reverse=True)) for name in sorted(packages)}


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
            f"{scene} is a scene file, not a scene package; import it with `factory scene import "
            f"{quoted(scene)}` and give the "
            "package"
        )
    if path.suffix and not path.is_file():
        raise UsageError(f"file {scene} does not exist; give a scene package (*.scene.zip) or the name of a scene")
    if path.is_file() and path.suffix.lower() != ".zip" and not zipfile.is_zipfile(path):
        fault = find_fault(path) or f"{scene} is not a scene package"
        raise UsageError(f"{fault}; import the scene with `factory scene import` and give the package")
    return path if path.is_file() else _package_called(scene, seed)


def list_builtin_scenes() -> list[dict[str, Any]]:
    """Returns the built-in scenes as JSON data."""
    from factory.scenes.author.scene import BUILTIN_SCENES, PAPER_LAYOUTS

    return [
        {
            "name": name,
            "origin": "built-in",
            "summary": scene.summary + (f"; seed 0: {PAPER_LAYOUTS[name].summary}" if name in PAPER_LAYOUTS else ""),
            "seen": ", ".join(BUILTIN_CATEGORIES[name].seen),
            "held_out": ", ".join(BUILTIN_CATEGORIES[name].held_out),
            "others": ", ".join(scene.others),
        }
        for name, scene in BUILTIN_SCENES.items()
    ]


def list_imported_scenes(cache: Path) -> list[dict[str, Any]]:
    """Returns the imported scenes in a folder of packages as JSON data, each with its newest package."""
    return [
        {"name": name, "origin": "imported", **_facts(packages[0]), "package": str(packages[0])}
        for name, packages in find_imported(cache).items()
    ]


def list_dataset_scenes(root: Place) -> list[dict[str, Any]]:
    """Returns the scenes and layouts of a dataset as JSON data."""
    meta = read_dataset_meta(root)
    return [_in_dataset(root, part, meta.scenes[part.name]) for part in meta.plan.parts if part.name in meta.scenes]


def _in_dataset(root: Place, part: ScenePlan, sha256: str) -> dict[str, Any]:
    is_unseen = isinstance(part, LayoutPlan) and part.is_unseen
    return {
        "family": family_of(part.name),
        "name": part.name,
        "planned": part.episodes,
        "splits": "test_unseen_scene*" if is_unseen else "others",
        **_facts(find_package_file(root, part.name, sha256)),
    }


def _facts(package: Path) -> dict[str, str]:
    from factory.scenes.inspection import describe_counts  # imports the planner, which the processes of an export omit

    try:
        info = read_info(package)
    except (FactoryError, OSError) as error:
        return {"summary": f"cannot be read: {' '.join(str(error).split())}", "targets": "-"}
    return {"summary": info.source, "targets": describe_counts(Counter(target.category for target in info.targets))}


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
