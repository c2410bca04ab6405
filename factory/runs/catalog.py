"""The compiled scenes of a run: taken from the dataset if it has them, else built or imported.

A dataset keeps the packages it was made with, so that it can be resumed and replayed by later versions.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from coordinator.expansion.catalog import Catalog, SceneEntry, read_entry
from coordinator.expansion.draw import find_impossible
from coordinator.expansion.nearest import find_nearest
from factory.dataset.packages import package_file
from factory.runs.plan_files import require_files
from factory.scenes.build import build_scene, find_import, import_scene, load_edits, package_path
from factory.scenes.limits import StageLimits
from factory.scenes.rules import RuleBook
from factory.scenes.targets.target_list import TargetList, format_target_list, list_file_name
from schemas.dataset_files import SCENES, STAGING
from schemas.errors import ArchiveCorrupt, InvalidPlan, WorldError
from schemas.plan import Plan, ScenePlan
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place

__all__ = ["collect_scenes", "find_built", "find_package", "open_catalog", "write_target_lists"]

MessageCallback = Callable[[str], None]


def open_catalog(plan: Plan, root: Place, cache: Path, tell: MessageCallback = lambda _: None) -> Catalog:
    """Returns the scenes of a plan that they can fulfil; see `collect_scenes`.

    Raises:
        InvalidPlan: the scenes do not have what the plan asks for; the nearest plan that they could fulfil is told,
            and nothing has been made in `root` by then.
    """
    entries = collect_scenes(plan, root, cache, tell)
    mistakes = find_impossible(plan, entries)
    if mistakes:
        nearest = find_nearest(plan, entries)
        if nearest.plan is not None:
            mistakes += [f"nearest possible: {change}" for change in nearest.changes]
            mistakes.append("write that plan with `factory plan nearest PLAN -o FILE.toml`")
        raise InvalidPlan(f"plan {plan.name!r} requires what its scenes do not have", mistakes)
    return entries


def collect_scenes(plan: Plan, root: Place, cache: Path, tell: MessageCallback = lambda _: None) -> Catalog:
    """Returns the scenes of a plan, whatever they hold.

    Args:
        plan: names the scenes.
        root: the dataset; packages in its `scenes/` are used as they are.
        cache: where new packages are built.
        tell: told the name of each scene that is built or compiled, before it is.

    Raises:
        InvalidPlan: a file that the plan names and the dataset does not make needless is not there.
    """
    entries: dict[str, SceneEntry] = {}
    held = {scene.name: _packages(root, scene.name) for scene in plan.scenes}
    require_files(plan, [name for name, packages in held.items() if packages])
    for scene in plan.scenes:
        kept = held[scene.name]
        package = package_file(kept[0]) if kept else _make(scene, cache, partial(tell, scene.name))
        entries[scene.name] = read_entry(package)
    return entries


def find_built(plan: Plan, cache: Path) -> Catalog:
    """Returns those scenes of a plan that were built or imported before as they are now; makes none."""
    found = {scene.name: _find(scene, cache) for scene in plan.scenes}
    return {name: read_entry(path) for name, path in found.items() if path is not None}


def find_package(root: Place, name: str, sha256: str) -> SceneEntry:
    """Returns the package an episode was made with.

    Raises:
        ArchiveCorrupt: the dataset does not hold it.
    """
    for path in _packages(root, name):
        entry = read_entry(package_file(path))
        if entry.sha256 == sha256:
            return entry
    raise ArchiveCorrupt(f"{root / SCENES} has no package of scene {name} with SHA-256 {sha256}; run `factory verify`")


def write_target_lists(catalog: Catalog, root: Place) -> None:
    """Writes `targets_<scene>.yaml` beside the packages of a dataset, for people; leaves those that are there alone.

    Raises:
        WorldError: it cannot be written.
    """
    for name, entry in catalog.items():
        path = root / SCENES / list_file_name(name)
        if path.exists():
            continue
        text = format_target_list(entry.info)
        if isinstance(path, ObjectPath):
            path.objects.put(path.key, text.encode())
            continue
        beside = path.parents[1] / STAGING / path.name
        try:
            beside.write_text(text, encoding="utf-8")
            beside.replace(path)
        except OSError as error:
            raise WorldError(f"cannot write {path} ({error.strerror}); free space and run the command again") from error


def _packages(root: Place, name: str) -> list[Place]:
    """Returns the packages of a scene that a dataset holds."""
    return sorted((root / SCENES).glob(f"{name}-*.scene.zip"), key=str)


def _make(scene: ScenePlan, cache: Path, tell: Callable[[], None]) -> Path:
    book, chosen = _edits(scene)
    if scene.usd is None:
        return build_scene(scene.name, scene.seed, cache, book, chosen, tell)
    return import_scene(Path(scene.usd), scene.name, cache, book, chosen, _limits(scene), tell)


def _find(scene: ScenePlan, cache: Path) -> Path | None:
    book, chosen = _edits(scene)
    if scene.usd is None:
        path = package_path(scene.name, scene.seed, cache, book, chosen)
        return path if path.is_file() else None
    return find_import(Path(scene.usd), scene.name, cache, book, chosen, _limits(scene))


def _edits(scene: ScenePlan) -> tuple[RuleBook | None, TargetList | None]:
    rules, targets = (None if path is None else Path(path) for path in (scene.rules, scene.targets))
    return load_edits(rules, targets, scene.name)


def _limits(scene: ScenePlan) -> StageLimits:
    return StageLimits(allow_outside=scene.allow_outside)
