"""The compiled scenes of a run: taken from the dataset if it has them, else built or imported and kept there.

A dataset keeps the packages it was made with, so that it can be resumed and replayed by later versions.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from coordinator.catalog import Catalog, SceneEntry, read_entry
from factory.scenes.build import build_scene, import_scene
from schemas.plan import Plan, ScenePlan

__all__ = ["open_catalog", "packages_of"]

Listener = Callable[[str], None]


def open_catalog(plan: Plan, root: Path, cache: Path, tell: Listener = lambda _: None) -> Catalog:
    """Returns the scenes of a plan.

    Args:
        plan: names the scenes.
        root: the dataset; packages in its `scenes/` are used as they are.
        cache: where new packages are built.
        tell: told the name of each scene before it is built.
    """
    kept = packages_of(root)
    entries: dict[str, SceneEntry] = {}
    for scene in plan.scenes:
        path = kept.get(scene.name)
        if path is None:
            tell(scene.name)
            path = _make(scene, cache)
        entries[scene.name] = read_entry(path)
    return entries


def packages_of(root: Path) -> dict[str, Path]:
    """Returns the packages a dataset holds, by scene name."""
    return {path.name.rsplit("-", 1)[0]: path for path in sorted((root / "scenes").glob("*-*.scene.zip"))}


def _make(scene: ScenePlan, cache: Path) -> Path:
    if scene.usd is not None:
        return import_scene(Path(scene.usd), scene.name, cache)
    return build_scene(scene.name, scene.seed, cache)
