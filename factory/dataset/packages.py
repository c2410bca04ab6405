"""Finds the compiled scenes of a dataset by digest, as local files; downloads those of a remote dataset once."""

from __future__ import annotations

import functools
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from factory.support.settings import cache_directory, scene_path
from schemas.errors import ArchiveCorrupt
from schemas.scene import CompiledScene, SceneInfo, read_complete, read_geometry, read_info, read_scene
from schemas.scene.files import faulty_textures
from schemas.scene.info import TEXTURES
from schemas.storage.dataset_files import SCENES
from schemas.storage.disk import translated
from schemas.storage.place import Place, children, digest_of
from schemas.support.extras import require_package

if TYPE_CHECKING:
    from schemas.language.scene import SceneLanguage
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
        """Returns the complete package, with its textures; raises the errors of `scene`."""
        return read_complete(find_package_file(*self))

    def scene(self) -> CompiledScene:
        """Returns the scene.

        Raises:
            ArchiveCorrupt: No package has the digest.
            InvalidBundle: The package or a texture is damaged or missing.
        """
        return read_scene(find_package_file(*self))

    def geometry(self) -> CompiledScene:
        """Returns the scene without the pixels of its textures; raises the errors of `scene`."""
        return read_geometry(find_package_file(*self))

    def language(self) -> SceneLanguage:
        """Returns the scene graph; keeps the graphs of the most recently used scenes; raises the errors of `scene`."""
        return _language_of(self)

    def rays(self) -> SceneRays:
        """Returns the ray caster of the scene; keeps the ray casters of the most recently used scenes.

        Raises:
            ArchiveCorrupt: No package has the digest.
            UsageError: embreex is not installed; the message names the extra.
        """
        return _rays_of(self)

    def appearance_scene(self, with_light: bool) -> AppearanceScene:
        """Returns the data for drawing appearances of the scene; keeps the data of the most recently used scenes.

        Args:
            with_light: whether to add the light groups, which are baked first if the cache does not have them.

        Raises:
            ArchiveCorrupt: No package has the digest.
            UsageError: embreex is not installed, and the light groups must be baked.
        """
        return _appearance_scene(self, with_light)

    @functools.lru_cache(maxsize=_KEPT_INFOS)  # noqa: B019 - keeps few instances, all small tuples
    def info(self) -> SceneInfo:
        """Returns the metadata of the scene; raises the errors of `read`."""
        return read_info(find_package_file(*self))


@functools.lru_cache(maxsize=_KEPT_SCENES)
def _language_of(package: ScenePackage) -> SceneLanguage:
    from schemas.language.graph.scene_graph import build_graph
    from schemas.language.scene import SceneLanguage

    return SceneLanguage(build_graph(package.geometry()))


@functools.lru_cache(maxsize=_KEPT_RAYS)
def _rays_of(package: ScenePackage) -> SceneRays:
    require_package("embreex", "a lidar")
    from workers.sensors.rays import SceneRays

    return SceneRays(package.geometry())


@functools.lru_cache(maxsize=_KEPT_SCENES)
def _appearance_scene(package: ScenePackage, with_light: bool) -> AppearanceScene:
    from schemas.appearance.light_groups import decode_light_groups
    from workers.appearance import AppearanceScene

    path = find_package_file(*package)
    scene = read_scene(path)
    if not with_light:
        return AppearanceScene(scene)
    with light_file(path, package.sha256).open("rb") as file:
        return AppearanceScene(scene, decode_light_groups(file))


def light_file(package: Path, sha256: str) -> Path:
    """Returns the file of the light groups of a scene package; if it is not cached, bakes them in 10 to 30 s.

    Raises:
        UsageError: embreex is not installed.
        WorldError: the cache cannot be written.
    """
    from factory.scenes.light.groups import bake_once

    return bake_once(package, sha256, cache_directory() / "light")


def find_package_file(root: Place, name: str, sha256: str) -> Path:
    """Returns the package of a scene with the given digest, from the dataset or a folder of `MINIVLA_SCENES`.

    Raises:
        ArchiveCorrupt: No package has the digest; the message lists the digests found and the folders.
    """
    candidates = []
    folders = (root / SCENES, *scene_path())
    places = [place for folder in folders for place in packages_of(folder, name)]
    # a package with the digest in its name is read first
    for place in sorted(places, key=lambda place: sha256[:16] not in place.name):
        path = package_file(place)
        digest = digest_of(path)
        if digest == sha256:
            return path
        candidates.append(f"{place} has SHA-256 {digest}")
    others = "; ".join(candidates) or f"no package of scene {name} was found"
    raise ArchiveCorrupt(
        f"the package of scene {name} with SHA-256 {sha256} is missing: {others}; searched: "
        f"{', '.join(map(str, folders))}. Restore the file, or add its folder to MINIVLA_SCENES"
    )


def packages_of(folder: Place, name: str) -> list[Place]:
    """Returns the packages of a scene in a folder."""
    return sorted(folder.glob(f"{name}-*.scene.zip"), key=str)


def packages_by_scene(folder: Place) -> dict[str, Place]:
    """Returns one package for each scene in a folder, by scene name; the folder need not exist."""
    packages: dict[str, Place] = {}
    for place in children(folder):
        name, separator, _ = place.name.rpartition("-")
        if separator and place.name.endswith(".scene.zip"):
            packages.setdefault(name, place)
    return packages


def package_file(place: Place) -> Path:
    """Returns the local file of a scene package; downloads a remote package with the textures that it needs.

    Raises:
        FileNotFoundError: The package does not exist.
        ArchiveCorrupt: A texture does not exist.
        WorldError: The object store does not respond, or the cache cannot be written.
    """
    copy = package_copy(place)
    for texture in faulty_textures(copy) if copy != place else ():
        source = place.parent / texture.file
        try:
            _download(source, copy.parent / texture.file)
        except FileNotFoundError as error:
            raise ArchiveCorrupt(
                f"texture {source} of {place} is missing; restore it with `factory repair`, or copy the folder "
                f"{TEXTURES} with the packages"
            ) from error
    return copy


def package_copy(place: Place) -> Path:
    """Returns the local file of a scene package; does not download its textures.

    A cached copy is used if its content has the digest in its name.

    Raises:
        FileNotFoundError: The package does not exist.
        WorldError: The object store does not respond, or the cache cannot be written.
    """
    if isinstance(place, Path):
        return place
    copy = cache_directory() / "packages" / place.name
    if not (copy.is_file() and f"-{digest_of(copy)[:16]}." in copy.name):
        _download(place, copy)
    return copy


def _download(place: Place, copy: Path) -> None:
    part = copy.with_name(f"{copy.name}.{secrets.token_hex(8)}.part")
    with translated("write", copy.parent):
        copy.parent.mkdir(parents=True, exist_ok=True)
    try:
        data = place.read_bytes()
        with translated("write", part):
            part.write_bytes(data)
            part.replace(copy)
    finally:
        part.unlink(missing_ok=True)
