"""Keeps the light groups of scene packages in the cache; one process bakes them, and others wait."""

from __future__ import annotations

import time
from pathlib import Path

import structlog

from factory.scenes.cached import write_whole
from schemas.appearance.light_groups import LIGHT_FORMAT, encode_light_groups
from schemas.scene import read_scene
from schemas.storage.disk import translated
from schemas.support.extras import require_package
from workers.client.host_lock import exclusive_lock

_POLL_S = 0.2


def bake_once(package: Path, sha256: str, folder: Path) -> Path:
    """Returns the file of the light groups of a package, which is baked if the folder does not have it.

    Args:
        package: compiled scene.
        sha256: digest of the package.
        folder: folder of light groups; created if missing.

    Raises:
        InvalidBundle: the package is damaged.
        UsageError: embreex is not installed.
        WorldError: the folder cannot be written.
    """
    path = folder / f"{sha256}-{LIGHT_FORMAT}.light.zip"
    if path.is_file():
        return path
    require_package("embreex", "randomised light")
    from factory.scenes.light.groups import bake_light_groups

    with translated("write", folder):
        folder.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(folder / f"{sha256}.lock", lambda: time.sleep(_POLL_S)):
            if not path.is_file():
                scene = read_scene(package)
                structlog.get_logger(__name__).info("light_groups_baked", scene=scene.info.name, path=str(path))
                write_whole(path, encode_light_groups(bake_light_groups(scene, sha256)))
    return path
