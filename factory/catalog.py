"""The compiled scenes of a run: taken from the dataset if it has them, else built or imported.

A dataset keeps the packages it was made with, so that it can be resumed and replayed by later versions.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from coordinator.archive import SCENES
from coordinator.catalog import Catalog, SceneEntry, read_entry
from coordinator.draw import require_possible
from factory.scenes.build import build_scene, import_scene
from schemas.errors import ArchiveCorrupt
from schemas.plan import Plan, ScenePlan

__all__ = ["find_package", "open_catalog"]

Listener = Callable[[str], None]


def open_catalog(plan: Plan, root: Path, cache: Path, tell: Listener = lambda _: None) -> Catalog:
    """Returns the scenes of a plan.

    Args:
        plan: names the scenes.
        root: the dataset; packages in its `scenes/` are used as they are.
        cache: where new packages are built.
        tell: told the name of each scene before it is built.

    Raises:
        InvalidPlan: the scenes do not have what the plan asks for; nothing has been made in `root` by then.
    """
    entries: dict[str, SceneEntry] = {}
    for scene in plan.scenes:
        kept = sorted((root / SCENES).glob(f"{scene.name}-*.scene.zip"))
        if not kept:
            tell(scene.name)
        entries[scene.name] = read_entry(kept[0] if kept else _make(scene, cache))
    require_possible(plan, entries)
    return entries


def find_package(root: Path, name: str, sha256: str) -> SceneEntry:
    """Returns the package an episode was made with.

    Raises:
        ArchiveCorrupt: the dataset does not hold it.
    """
    for path in sorted((root / SCENES).glob(f"{name}-*.scene.zip")):
        entry = read_entry(path)
        if entry.sha256 == sha256:
            return entry
    raise ArchiveCorrupt(f"{root / SCENES} holds no package of {name} with SHA-256 {sha256}; run `factory verify`")


def _make(scene: ScenePlan, cache: Path) -> Path:
    if scene.usd is not None:
        return import_scene(Path(scene.usd), scene.name, cache)
    return build_scene(scene.name, scene.seed, cache)
