"""`factory scene list`: lists the built-in and imported scenes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import click

from factory.commands.common.output import print_json, print_table
from factory.commands.scene.package import describe_counts
from factory.dataset.packages import find_package_file
from factory.runs.scene_packages import find_imported
from factory.support.settings import scene_cache
from schemas.dataset.meta import read_dataset_meta
from schemas.errors import FactoryError
from schemas.layouts import LayoutPlan
from schemas.plan import ScenePlan
from schemas.scene import read_info
from schemas.storage.place import Place
from schemas.terms import BUILTIN_CATEGORIES, family_of


def execute(place: Place | None, as_json: bool) -> None:
    """Executes `factory scene list`."""
    if place is not None:
        _list_dataset(place, as_json)
        return
    built_in, imported = _built_in(), _imported()
    if as_json:
        print_json([*built_in, *imported])
        return
    _print(
        "",
        ("scene", "summary", "seen categories", "held-out categories", "other common categories"),
        built_in,
        ("name", "summary", "seen", "held_out", "others"),
    )
    if imported:
        click.echo("")
        _print("", ("imported", "source", "targets", "package"), imported, ("name", "summary", "targets", "package"))


def _print(title: str, columns: tuple[str, ...], scenes: list[dict[str, Any]], keys: tuple[str, ...]) -> None:
    print_table(title, columns, [[scene[key] for key in keys] for scene in scenes])


def _list_dataset(root: Place, as_json: bool) -> None:
    meta = read_dataset_meta(root)
    scenes = [_in_dataset(root, part, meta.scenes[part.name]) for part in meta.plan.parts if part.name in meta.scenes]
    if as_json:
        print_json(scenes)
        return
    keys = ("family", "name", "planned", "splits", "summary")
    _print("", ("family", "scene", "planned episodes", "splits", "source"), scenes, keys)


def _in_dataset(root: Place, part: ScenePlan, sha256: str) -> dict[str, Any]:
    is_unseen = isinstance(part, LayoutPlan) and part.is_unseen
    return {
        "family": family_of(part.name),
        "name": part.name,
        "planned": part.episodes,
        "splits": "test_unseen_scene*" if is_unseen else "others",
        **_facts(find_package_file(root, part.name, sha256)),
    }


def _built_in() -> list[dict[str, Any]]:
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


def _imported() -> list[dict[str, Any]]:
    return [
        {"name": name, "origin": "imported", **_facts(packages[0]), "package": str(packages[0])}
        for name, packages in find_imported(scene_cache()).items()
    ]


def _facts(package: Path) -> dict[str, str]:
    try:
        info = read_info(package)
    except (FactoryError, OSError) as error:
        return {"summary": f"cannot be read: {' '.join(str(error).split())}", "targets": "-"}
    return {"summary": info.source, "targets": describe_counts(Counter(target.category for target in info.targets))}
