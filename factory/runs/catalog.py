"""Provides the compiled scenes of a run: the packages in the dataset, otherwise newly built or imported ones.

A dataset keeps the packages that it was generated with, so later versions can resume and replay it. Also checks that
the files named in a plan can be read. Simulates nothing.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from coordinator.expansion.catalog import Catalog, add_files, read_entry
from coordinator.expansion.nearest import find_nearest
from coordinator.expansion.possible import find_impossible
from coordinator.expansion.scene_cells import each_scene
from coordinator.expansion.sentences import find_missing_instructions
from factory.dataset.packages import light_file, package_file, packages_by_scene
from factory.runs.layouts import LayoutBuilds, build_layouts, find_layouts
from factory.scenes.build import build_scene, find_import, import_scene, load_edits, package_path
from factory.scenes.limits import StageLimits
from factory.scenes.rules import RuleBook
from factory.scenes.stage_file import find_fault
from factory.scenes.targets.target_list import TargetList, format_target_list, list_file_name
from schemas.errors import ArchiveCorrupt, InvalidPlan, UsageError
from schemas.layouts import LayoutPlan
from schemas.plan import Plan, ScenePlan
from schemas.scene.info import TEXTURES
from schemas.storage.dataset_files import SCENES, STAGING
from schemas.storage.disk import replacing
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place
from schemas.terms import Recording, family_of, layout_number


def require_files(plan: Plan, kept: Collection[str] = ()) -> None:
    """Raises an error unless the files of all scenes of a plan can be read.

    Args:
        plan: Plan with the file names.
        kept: Names of scenes whose package is in the dataset, so their files are not needed.

    Raises:
        InvalidPlan: A file is missing or invalid; the message lists all such files.
    """
    wanted = [(number, scene) for number, scene in enumerate(plan.scenes) if scene.name not in kept]
    mistakes = [f"scenes[{number}] {scene.name}: {line}" for number, scene in wanted for line in _missing_of(scene)]
    if mistakes:
        raise InvalidPlan(f"plan {plan.name!r} names files that cannot be used", mistakes)


def _missing_of(scene: ScenePlan) -> Iterator[str]:
    fault = find_fault(Path(scene.file)) if scene.file is not None else ""
    if fault:
        yield f"file: {fault}"
    if scene.rules is not None:
        yield from (f"rules: {line}" for line in _refusal(scene, Path(scene.rules), None))
    if scene.targets is not None:
        targets = Path(scene.targets)
        first = (
            f"; before that `factory scene import {shlex.quote(scene.file)} --name {scene.name}`" if scene.file else ""
        )
        first = "" if targets.is_file() else first
        yield from (f"targets: {line}{first}" for line in _refusal(scene, None, targets))


def _refusal(scene: ScenePlan, rules: Path | None, targets: Path | None) -> Iterator[str]:
    """Yields the errors of the rules and target list of a scene."""
    try:
        load_edits(rules, targets, scene.name)
    except UsageError as error:
        yield str(error)


MessageCallback = Callable[[str], None]


def open_catalog(
    plan: Plan,
    root: Place,
    cache: Path,
    tell: MessageCallback = lambda _: None,
    builds: LayoutBuilds | None = None,
    packages: Place | None = None,
    only: Collection[str] | None = None,
) -> Catalog:
    """Returns the scenes of a plan after checking that they can fulfil it; see `collect_scenes`.

    Raises:
        InvalidPlan: The scenes cannot fulfil the plan; the message describes the nearest feasible plan. Nothing has
            been written to `root`.
    """
    entries = collect_scenes(plan, root, cache=cache, tell=tell, builds=builds, only=only, packages=packages)
    mistakes = find_impossible(plan, entries)
    if mistakes:
        nearest = find_nearest(plan, entries)
        if nearest.plan is not None:
            mistakes += [f"nearest possible: {change}" for change in nearest.changes]
            mistakes.append("write that plan with `factory plan nearest PLAN -o FILE.toml`")
        raise InvalidPlan(f"plan {plan.name!r} cannot be fulfilled with its scenes", mistakes)
    faults = find_missing_instructions(plan, each_scene(plan, entries))
    if faults:
        raise InvalidPlan(f"plan {plan.name!r} has a language block that its scenes do not permit", faults)
    return entries


def collect_scenes(
    plan: Plan,
    root: Place,
    cache: Path,
    tell: MessageCallback = lambda _: None,
    builds: LayoutBuilds | None = None,
    only: Collection[str] | None = None,
    packages: Place | None = None,
) -> Catalog:
    """Returns the scenes of a plan. Checks whether its layouts can fulfil the plan; does not check other scenes.

    Args:
        plan: Plan with the scenes.
        root: Location of the dataset; packages in its `scenes/` folder are used unchanged.
        cache: Folder in which new packages are built.
        tell: Called with the name of each scene before it is built or compiled.
        builds: Settings of the builds of layouts; `None` builds them in this process.
        only: Names of the scenes to build or compile if they are missing. Other missing scenes are omitted from the
            result. `None` selects all scenes.
        packages: Folder with the package of every scene, so none is built; `None` uses `root`.

    Raises:
        UsageError: `packages` lacks a scene.
        ArchiveCorrupt: A texture of a package is missing.
        InvalidPlan: A file that the plan names for a scene is missing, and the dataset has no package of the scene; or
            a layout cannot fulfil the plan with any of its seeds.
        KeyboardInterrupt: The builds were stopped.
    """
    held = packages_by_scene(root / SCENES if packages is None else packages)
    lacking = [part.name for part in plan.parts if part.name not in held] if packages is not None else []
    if lacking:
        raise UsageError(
            f"{packages} has no package of {', '.join(lacking)}: give the folder `scenes` of a dataset of the plan, or "
            f"copy the packages that `factory scene build` or `factory scene import` prints, with the folder {TEXTURES}"
        )
    require_files(plan, held)
    collected: dict[str, Path] = {}
    missing: list[str] = []
    parts = [part for part in plan.parts if only is None or part.name in held or part.name in only]
    for part in parts:
        if part.name in held:
            collected[part.name] = package_file(held[part.name])
        elif isinstance(part, LayoutPlan):
            missing.append(part.name)
        else:
            collected[part.name] = _make(part, cache, partial(tell, part.name))
    builds = builds or LayoutBuilds()
    collected |= {built.name: built.path for built in build_layouts(plan, missing, cache, builds)}
    catalog = {part.name: read_entry(collected[part.name]) for part in parts}
    _require_textures(catalog)
    return with_light(plan, catalog)


def _require_textures(catalog: Catalog) -> None:
    files: dict[str, Path] = {}
    for entry in catalog.values():
        add_files(files, entry)
    missing = [path for path in files.values() if not path.exists()]
    if missing:
        raise ArchiveCorrupt(
            f"texture {missing[0]} is missing ({len(missing)} of {len(files)} files of scenes): restore it with "
            f"`factory repair`, or copy the folder {TEXTURES} with the packages"
        )


def scenes_before_run(plan: Plan, gates: Iterable[Plan]) -> frozenset[str] | None:
    """Returns the names of the scenes that are needed before a run; `None` for all. The workers build the other scenes.

    These are the scenes that are not layouts, the first layout of each family, which shows whether the plan is
    possible, and the scenes of the gate. A plan with varied light needs all scenes, because light groups are baked
    before the run.

    Args:
        plan: Plan of the run.
        gates: Plans of the gate runs before the run.
    """
    if plan.record is Recording.FRAMES and plan.appearance is not None and plan.appearance.light is not None:
        return None
    first = {family_of(part.name): part.name for part in reversed(plan.parts)}
    fixed = {part.name for part in plan.parts if not isinstance(part, LayoutPlan)}
    return frozenset({*fixed, *first.values(), *(part.name for gate in gates for part in gate.parts)})


def with_light(plan: Plan, catalog: Catalog) -> Catalog:
    """Returns the scenes with their light groups if the frames of a plan have varied light; bakes missing ones.

    Raises:
        UsageError: embreex is not installed, and light groups must be baked.
    """
    if plan.record is not Recording.FRAMES or plan.appearance is None or plan.appearance.light is None:
        return catalog
    return {name: replace(entry, light=light_file(entry.path, entry.sha256)) for name, entry in catalog.items()}


def find_built(plan: Plan, cache: Path) -> Catalog:
    """Returns the scenes of a plan whose current version is in the cache, also the layouts that a run would use.

    Builds none.
    """
    fixed = {part.name: _find(part, cache) for part in plan.parts if not isinstance(part, LayoutPlan)}
    packages = {name: path for name, path in fixed.items() if path is not None} | find_layouts(plan, cache)
    return {name: read_entry(path) for name, path in packages.items()}


def write_target_lists(catalog: Catalog, root: Place) -> None:
    """Writes `targets_<scene>.yaml` next to the scene packages of a dataset, for people; keeps existing files.

    No file is written for layouts, because a plan can edit the targets of single scenes only.

    Raises:
        WorldError: A file cannot be written.
    """
    for name, entry in catalog.items():
        path = root / SCENES / list_file_name(name)
        if layout_number(name) is not None or path.exists():
            continue
        text = format_target_list(entry.info)
        if isinstance(path, ObjectPath):
            path.objects.put(path.key, text.encode())
            continue
        with replacing(path, part=path.parents[1] / STAGING / path.name) as part:
            part.write_text(text, encoding="utf-8")


def _make(scene: ScenePlan, cache: Path, tell: Callable[[], None]) -> Path:
    book, chosen = _edits(scene)
    if scene.file is None:
        family = family_of(scene.name)
        return build_scene(
            family, scene.seed, cache=cache, rules=book, targets=chosen, tell=tell, called=_called(scene)
        )
    return import_scene(
        Path(scene.file), scene.name, cache=cache, rules=book, targets=chosen, limits=_limits(scene), tell=tell
    )


def _find(scene: ScenePlan, cache: Path) -> Path | None:
    book, chosen = _edits(scene)
    if scene.file is None:
        path = package_path(
            family_of(scene.name), scene.seed, cache=cache, rules=book, targets=chosen, called=_called(scene)
        )
        return path if path.is_file() else None
    return find_import(Path(scene.file), scene.name, cache=cache, rules=book, targets=chosen, limits=_limits(scene))


def _called(scene: ScenePlan) -> str | None:
    """Returns the name of a numbered layout; `None` for a scene that has the name of its family."""
    return None if family_of(scene.name) == scene.name else scene.name


def _edits(scene: ScenePlan) -> tuple[RuleBook | None, TargetList | None]:
    rules, targets = (None if path is None else Path(path) for path in (scene.rules, scene.targets))
    return load_edits(rules, targets, scene.name)


def _limits(scene: ScenePlan) -> StageLimits:
    return StageLimits(
        allow_outside=scene.allow_outside,
        ceiling_m=scene.ceiling_m,
        unit=scene.unit,
        up=scene.up,
        models=tuple(map(Path, scene.models)),
        floor_m=scene.floor_m,
        skip_missing=scene.skip_missing,
    )
