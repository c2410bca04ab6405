"""Finds the compiled scenes of a dataset by digest, as local files; downloads those of a remote dataset once."""

from __future__ import annotations

import functools
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from factory.support.settings import cache_directory, scene_path
from schemas.errors import ArchiveCorrupt
from schemas.scene import SceneInfo, decode_scene, read_scene_info
from schemas.storage.dataset_files import SCENES
from schemas.storage.disk import translated
from schemas.storage.place import Place, children, digest_of
from schemas.support.extras import require_package

if TYPE_CHECKING:
    from workers.appearance import AppearanceScene
    from workers.sensors.rays import SceneRays

_KEPT_SCENES = 2
_KEPT_INFOS = 64
_KEPT_RAYS = 2


class ScenePackage(NamedTuple):
    """Compiled scene of a dataset, identified by its digest."""

    root: Place
    """Location of the dataset."""
    name: str
    """Name of the scene."""
    sha256: str
    """SHA-256 of the package."""

    def read(self) -> bytes:
        """Returns the bytes of the package.

        Raises:
            ArchiveCorrupt: No package has the digest.
        """
        return find_package_file(*self).read_bytes()

    def rays(self) -> SceneRays:
        """Returns the ray caster of the scene; those of the most recently used scenes are kept.

        Raises:
            ArchiveCorrupt: No package has the digest.
            UsageError: embreex is not installed; the message names the extra.
        """
        return _rays_of(self)

    def appearance_scene(self, with_light: bool) -> AppearanceScene:
        """Returns what the appearance of an episode depends on; those of the most recently used scenes are kept.

        Args:
            with_light: whether the light groups are read, or baked if this machine has not baked them.

        Raises:
            ArchiveCorrupt: No package has the digest.
            UsageError: embreex is not installed, and the light groups must be baked.
        """
        return _appearance_scene(self, with_light)

    @functools.lru_cache(maxsize=_KEPT_INFOS)  # noqa: B019 - the keys are values, and few
    def info(self) -> SceneInfo:
        """Returns the metadata of the scene; raises the errors of `read`."""
        with find_package_file(*self).open("rb") as file:
            return read_scene_info(file)


@functools.lru_cache(maxsize=_KEPT_RAYS)
def _rays_of(package: ScenePackage) -> SceneRays:
    require_package("embreex", "a lidar")
    from workers.sensors.rays import SceneRays

    with find_package_file(*package).open("rb") as file:
        return SceneRays(decode_scene(file))


@functools.lru_cache(maxsize=_KEPT_SCENES)
def _appearance_scene(package: ScenePackage, with_light: bool) -> AppearanceScene:
    from schemas.appearance.light_groups import decode_light_groups
    from workers.appearance import AppearanceScene

    path = find_package_file(*package)
    with path.open("rb") as file:
        scene = decode_scene(file)
    if not with_light:
        return AppearanceScene(scene)
    with light_file(path, package.sha256).open("rb") as file:
        return AppearanceScene(scene, decode_light_groups(file))


def light_file(package: Path, sha256: str) -> Path:
    """Returns the light groups of a scene package; bakes them once for each cache, which takes 10 to 30 s.

    Raises:
        UsageError: embreex is not installed.
        WorldError: the cache cannot be written.
    """
    from factory.scenes.light.cached import bake_once

    return bake_once(package, sha256, cache_directory() / "light")


def find_package_file(root: Place, name: str, sha256: str) -> Path:
    """Returns the package of a scene with that digest, from the dataset or a folder of `MINIVLA_SCENES`.

    Raises:
        ArchiveCorrupt: No package has the digest; the message has the digests of the packages found, and the folders.
    """
    found = []
    folders = (root / SCENES, *scene_path())
    places = [place for folder in folders for place in packages_of(folder, name)]
    for place in sorted(places, key=lambda place: sha256[:16] not in place.name):  # reading each would take long
        path = package_file(place)
        digest = digest_of(path)
        if digest == sha256:
            return path
        found.append(f"{place} has SHA-256 {digest}")
    others = "; ".join(found) or f"no package of scene {name} was found"
    raise ArchiveCorrupt(
        f"the package of scene {name} with SHA-256 {sha256} is missing: {others}; searched: "
        f"{', '.join(map(str, folders))}. Restore the file, or add its folder to MINIVLA_SCENES"
    )


def packages_of(folder: Place, name: str) -> list[Place]:
    """Returns the packages of a scene in a folder."""
    return sorted(folder.glob(f"{name}-*.scene.zip"), key=str)


def packages_by_scene(folder: Place) -> dict[str, Place]:
    """Returns a package of each scene that has one in a folder; the folder need not exist."""
    found: dict[str, Place] = {}
    for place in children(folder):
        name, separator, _ = place.name.rpartition("-")
        if separator and place.name.endswith(".scene.zip"):
            found.setdefault(name, place)
    return found


def package_file(place: Place) -> Path:
    """Returns the local file of a scene package; the digest in its name identifies a cached copy.

    Raises:
        FileNotFoundError: The package does not exist.
        WorldError: The object store does not respond, or the cache cannot be written.
    """
    if isinstance(place, Path):
        return place
    folder = cache_directory() / "packages"
    copy = folder / place.name
    if copy.is_file() and f"-{digest_of(copy)[:16]}." in copy.name:
        return copy
    part = folder / f"{place.name}.{secrets.token_hex(8)}.part"
    with translated("write", folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        data = place.read_bytes()
        with translated("write", part):
            part.write_bytes(data)
            part.replace(copy)
    finally:
        part.unlink(missing_ok=True)
    return copy
