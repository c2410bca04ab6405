"""Disk cache of compiled scenes by digest; each host fetches a scene once, and its digest is checked before use.

Does not decode scenes; the caller provides the bytes.
"""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import threading
from collections.abc import Callable
from pathlib import Path

import structlog

from schemas.errors import WorldError
from schemas.protocol.keys import MAX_CHUNK_BYTES, Chunk
from workers.client.host_lock import exclusive_lock

Fetch = Callable[[Chunk], bytes]
Wait = Callable[[], None]

_SUFFIX, _PART = ".scene", ".part"

log = structlog.get_logger(__name__)


class SceneCache:
    """Folder of scenes that several workers of a host may share.

    Args:
        directory: path of the folder; it is created if missing.
        max_bytes: size of the cache, bytes, above which the least recently used scenes are deleted.
    """

    def __init__(self, directory: Path, max_bytes: int) -> None:
        self._directory = directory
        self._max_bytes = max_bytes
        self._checked: set[str] = set()
        self._guard = threading.Lock()

    def ensure(self, sha256: str, size: int, fetch: Fetch, wait: Wait) -> Path:
        """Returns the path of a scene; fetches it if the cache does not contain it.

        Args:
            sha256: digest of the scene.
            size: size of the scene, bytes.
            fetch: returns the bytes of a chunk; may raise to give up.
            wait: called repeatedly while another thread or process fetches the same scene; may raise to give up.

        Raises:
            WorldError: the bytes do not match the digest, or cannot be written.
        """
        path = self._directory / f"{sha256}{_SUFFIX}"
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            with exclusive_lock(self._directory / f"{sha256}.lock", wait):
                if not self._is_good(path, sha256):
                    self._download(path, sha256, size, fetch)
                os.utime(path)
        except OSError as error:
            raise WorldError(
                f"cannot store scene {sha256[:12]} in {self._directory}: {error}; {_remedy(error)}"
            ) from error
        with self._guard:
            self._checked.add(sha256)
        self._evict(path)
        return path

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
        for stale in self._directory.glob(f"{sha256}.*{_PART}"):  # left by a killed worker, since this one has the lock
            stale.unlink(missing_ok=True)
        part = path.with_name(f"{sha256}.{secrets.token_hex(4)}{_PART}")
        digest = hashlib.sha256()
        try:
            with part.open("xb") as file:
                for offset in range(0, size, MAX_CHUNK_BYTES):
                    chunk = Chunk(offset, min(MAX_CHUNK_BYTES, size - offset))
                    data = fetch(chunk)
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

    def _evict(self, keep: Path) -> None:
        """Deletes the least recently used scenes until the folder is within its size; never the scene `keep`."""
        used = []
        for path in self._directory.glob(f"*{_SUFFIX}"):
            try:
                status = path.stat()
            except FileNotFoundError:
                continue
            used.append((status.st_mtime_ns, status.st_size, path))
        total = sum(size for _, size, _ in used)
        for _, size, path in sorted(used):
            if total <= self._max_bytes:
                return
            if path != keep:
                path.unlink(missing_ok=True)
                path.with_suffix(".lock").unlink(missing_ok=True)
                total -= size
                log.info("scene_evicted", path=path.name, size=size)


def _remedy(error: OSError) -> str:
    if error.errno in {errno.ENOSPC, errno.EDQUOT}:
        return "free space there, or set MINIVLA_CACHE to another folder"
    return "set MINIVLA_CACHE to a writable folder"
