"""Finds scene packages: of an episode, of imported scenes in the cache. Builds and opens none."""

from __future__ import annotations

import re
from pathlib import Path

from coordinator.expansion.catalog import SceneEntry, read_entry
from factory.dataset.packages import find_package_file
from schemas.storage.place import Place
from schemas.terms import BUILTIN_CATEGORIES, family_of


def find_package(root: Place, name: str, sha256: str) -> SceneEntry:
    """Returns the scene package with which an episode was generated.

    Raises:
        ArchiveCorrupt: No package has the digest.
    """
    return read_entry(find_package_file(root, name, sha256))


_PACKAGE = re.compile(r"([a-z][a-z0-9_]{0,63})-[0-9a-f]{12}\.scene\.zip")


def find_imported(cache: Path) -> dict[str, tuple[Path, ...]]:
    """Returns the packages of imported scenes.

    Args:
        cache: Folder of packages; it need not exist.

    Returns:
        The packages by scene name, the most recently written first.
    """
    found: dict[str, list[tuple[int, str, Path]]] = {}
    for path in cache.glob("*.scene.zip"):
        named = _PACKAGE.fullmatch(path.name)
        if named is not None and family_of(named[1]) not in BUILTIN_CATEGORIES:
            found.setdefault(named[1], []).append((path.stat().st_mtime_ns, path.name, path))
    return {name: tuple(path for *_, path in sorted(found[name], reverse=True)) for name in sorted(found)}
