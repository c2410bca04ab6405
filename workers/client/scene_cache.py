"""Disk cache of compiled scenes by digest; each host fetches a scene and each texture once, and checks their digests.

Does not decode scenes; the caller provides the bytes.
"""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import structlog

from schemas.errors import WorldError
from schemas.protocol.keys import MAX_CHUNK_BYTES, Chunk
from schemas.scene import read_info
from schemas.scene.info import texture_file
from workers.client.host_lock import exclusive_lock

Fetch = Callable[[str, Chunk], bytes]
"""Function that returns a chunk of the file with the given SHA-256; may raise to give up."""
Wait = Callable[[], None]

_SUFFIX, _LOCK, _PART = ".scene", ".lock", ".part"

log = structlog.get_logger(__name__)


class _Busy(Exception):
    """Another thread or process uses the file."""


class _CachedFile(NamedTuple):
    """File that may be evicted; sorted by last use, and packages before textures with the same time of last use."""

    used_ns: int
    is_texture: bool
    path: Path
    size: int


class SceneCache:
    """Folder of scenes that several workers of a host may share.

    A texture is marked as used after each package that needs it, so packages are evicted before their textures.

    Args:
        directory: path of the folder; it is created if missing.
        max_bytes: size of the cache, bytes, above which the least recently used files are deleted.
    """

    def __init__(self, directory: Path, max_bytes: int) -> None:
        self._directory = directory
        self._max_bytes = max_bytes
        self._checked: set[str] = set()
        self._textures: dict[str, tuple[str, ...]] = {}
        """SHA-256 of the textures of each package."""
        self._guard = threading.Lock()

    def ensure(self, sha256: str, size: int, fetch: Fetch, wait: Wait) -> Path:
        """Returns the path of a file; fetches it if the cache does not contain it.

        Args:
            sha256: digest of the file.
            size: size of the file, bytes.
            fetch: returns the bytes of a chunk; may raise to give up.
            wait: called repeatedly while another thread or process fetches the same file; may raise to give up.

        Raises:
            WorldError: the bytes do not match the digest, or cannot be written.
        """
        path = self._directory / f"{sha256}{_SUFFIX}"
        if self._ensure(path, sha256, size=size, fetch=fetch, wait=wait):
            self._evict({path})
        return path

    def ensure_scene(self, sha256: str, size: int, fetch: Fetch, wait: Wait) -> Path:
        """Returns the path of a package whose textures are in the folder beside it; fetches what the cache does not
        contain. For arguments and errors see `ensure`.

        Raises:
            InvalidBundle: the package is damaged at the coordinator.
        """
        path = self._directory / f"{sha256}{_SUFFIX}"
        is_new = self._ensure(path, sha256, size=size, fetch=fetch, wait=wait)
        places = [self._texture_path(texture) for texture in self._textures.get(sha256, ())]
        if is_new or sha256 not in self._textures or not _mark_used(places):
            textures = read_info(path).textures
            places = [self._texture_path(texture.sha256) for texture in textures]
            fetched = [
                self._ensure(place, texture.sha256, size=texture.size, fetch=fetch, wait=wait)
                for place, texture in zip(places, textures, strict=True)
            ]
            with self._guard:
                self._textures[sha256] = tuple(sys.intern(texture.sha256) for texture in textures)
            if is_new or any(fetched):
                self._evict({path, *places})
        return path

    def _texture_path(self, sha256: str) -> Path:
        return self._directory / texture_file(sha256)

    def _ensure(self, path: Path, sha256: str, size: int, fetch: Fetch, wait: Wait) -> bool:
        """Fetches a file unless it exists, and marks it as used; returns whether it was fetched."""
        is_missing = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with exclusive_lock(path.with_name(f"{sha256}{_LOCK}"), wait):
                is_missing = not self._is_good(path, sha256)
                if is_missing:
                    self._download(path, sha256, size, fetch)
                os.utime(path)
        except OSError as error:
            raise WorldError(
                f"cannot store scene {sha256[:12]} in {self._directory}: {error}; {_remedy(error)}"
            ) from error
        with self._guard:
            self._checked.add(sha256)
        return is_missing

    def _is_good(self, path: Path, sha256: str) -> bool:
        if not path.is_file():
            return False
        if sha256 in self._checked:
            return True
        with path.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() == sha256:
                return True
        log.warning("cached_scene_damaged", path=str(path))
        return False

    def _download(self, path: Path, sha256: str, size: int, fetch: Fetch) -> None:
        # this worker has the lock of the file, so a worker that was killed has left these partial files
        for stale in path.parent.glob(f"{sha256}.*{_PART}"):
            stale.unlink(missing_ok=True)
        part = path.with_name(f"{sha256}.{secrets.token_hex(4)}{_PART}")
        digest = hashlib.sha256()
        try:
            with part.open("xb") as file:
                for offset in range(0, size, MAX_CHUNK_BYTES):
                    chunk = Chunk(offset, min(MAX_CHUNK_BYTES, size - offset))
                    data = fetch(sha256, chunk)
                    if len(data) != chunk.length:
                        raise WorldError(
                            f"scene {sha256[:12]}: {len(data)} bytes at {offset}, expected {chunk.length} of {size}; "
                            "the coordinator's package is damaged: run `factory scene build` there"
                        )
                    digest.update(data)
                    file.write(data)
            if digest.hexdigest() != sha256:
                raise WorldError(
                    f"scene {sha256[:12]} arrived with SHA-256 {digest.hexdigest()[:12]}; the coordinator's package "
                    "is damaged: run `factory scene build` there"
                )
            part.rename(path)
            log.info("scene_fetched", sha256=sha256[:12], size=size)
        finally:
            part.unlink(missing_ok=True)

    def _evict(self, keep: Collection[Path]) -> None:
        """Deletes the least recently used files, except those in `keep`, until the folder is small enough."""
        files = sorted(self._files())
        total = sum(file.size for file in files)
        for file in files:
            if total <= self._max_bytes:
                return
            if file.path not in keep and _delete_unused(file):
                total -= file.size

    def _files(self) -> Iterator[_CachedFile]:
        for pattern, is_texture in ((f"*{_SUFFIX}", False), (texture_file("*"), True)):
            for path in self._directory.glob(pattern):
                try:
                    status = path.stat()
                except FileNotFoundError:
                    continue
                yield _CachedFile(status.st_mtime_ns, is_texture, path, status.st_size)


def _mark_used(places: Collection[Path]) -> bool:
    """Marks files as used; returns whether all of them exist."""
    try:
        for place in places:
            os.utime(place)
    except FileNotFoundError:
        return False
    return True


def _delete_unused(file: _CachedFile) -> bool:
    """Deletes a file unless it is in use or was used after it was listed; returns `False` if it still exists."""

    def give_up() -> None:
        raise _Busy

    lock = file.path.with_name(f"{file.path.name.partition('.')[0]}{_LOCK}")
    try:
        with exclusive_lock(lock, give_up):
            if file.path.stat().st_mtime_ns != file.used_ns:
                return False
            file.path.unlink()
            lock.unlink(missing_ok=True)
    except _Busy:
        return False
    except FileNotFoundError:
        return True
    log.info("scene_evicted", path=file.path.name, size=file.size)
    return True


def _remedy(error: OSError) -> str:
    if error.errno in {errno.ENOSPC, errno.EDQUOT}:
        return "free space there, or set MINIVLA_CACHE to another folder"
    return "set MINIVLA_CACHE to a writable folder"
