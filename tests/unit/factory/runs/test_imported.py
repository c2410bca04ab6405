"""Imported scenes are found by name in a cache, newest first, without built-in scenes."""

from __future__ import annotations

import os
from pathlib import Path

from factory.runs.scene_packages import find_imported


def put(cache: Path, name: str, when: int) -> Path:
    path = cache / f"{name}.scene.zip"
    path.write_bytes(b"")
    os.utime(path, (when, when))
    return path


def test_a_missing_cache_has_no_imported_scenes(tmp_path: Path) -> None:
    assert find_imported(tmp_path / "nowhere") == {}


def test_the_newest_package_is_first(tmp_path: Path) -> None:
    old, new = put(tmp_path, "lab-ffffffffffff", 1), put(tmp_path, "lab-000000000000", 2)
    other = put(tmp_path, "lab_2-000000000000", 3)
    assert find_imported(tmp_path) == {"lab": (new, old), "lab_2": (other,)}


def test_built_in_scenes_and_other_files_are_omitted(tmp_path: Path) -> None:
    for name in ("office-000000000000", "lab", "lab-000000000000.part", "Lab-000000000000"):
        put(tmp_path, name, 1)
    assert find_imported(tmp_path) == {}
