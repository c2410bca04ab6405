"""Finds the scene package with which an episode was generated. Builds no scene."""

from __future__ import annotations

from coordinator.expansion.catalog import SceneEntry, read_entry
from factory.dataset.packages import find_package_file
from schemas.storage.place import Place


def find_package(root: Place, name: str, sha256: str) -> SceneEntry:
    """Returns the scene package with which an episode was generated.

    Raises:
        ArchiveCorrupt: No package has the digest.
    """
    return read_entry(find_package_file(root, name, sha256))
