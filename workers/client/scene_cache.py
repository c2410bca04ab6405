"""Compiled scenes on disk, named by their digest, fetched once a host and checked before use.

Never reads what is in a scene; where the bytes come from is the caller's.
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
from schemas.keys import MAX_CHUNK_BYTES, Chunk
from workers.client.host_lock import alone

__all__ = ["SceneCache"]

Fetch = Callable[[Chunk], bytes]
Wait = Callable[[], None]

_SUFFIX, _PART = ".scene", ".part"

log = structlog.get_logger(__name__)


class SceneCache:
    """A folder of scenes that several workers of a host may share.

    Args:
        directory: made when missing.
        max_bytes: beyond this, the scenes used longest ago are deleted.
    """

    def __init__(self, directory: Path, max_bytes: int) -> None:
        self._directory = directory
        self._max_bytes = max_bytes
        self._checked: set[str] = set()
        self._guard = threading.Lock()

    def ensure(self, sha256: str, size: int, fetch: Fetch, wait: Wait) -> Path:
        """Returns the path of a scene, fetching it unless it is there.

        Args:
            sha256: digest of the scene.
            size: its bytes.
            fetch: returns the bytes of a chunk; may raise to give up.
            wait: called over and over while another thread or process fetches the same scene; may raise.

        Raises:
            WorldError: the bytes are not the scene's, or the disk does not take them.
        """
        path = self._directory / f"{sha256}{_SUFFIX}"
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            with alone(self._directory / f"{sha256}.lock", wait):
                if not self._is_good(path, sha256):
                    self._bring(path, sha256, size, fetch)
                os.utime(path)
        except OSError as error:
            raise WorldError(
                f"cannot keep scene {sha256[:12]} in {self._directory}: {error}; {_remedy(error)}"
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

    def _bring(self, path: Path, sha256: str, size: int, fetch: Fetch) -> None:
        for stale in self._directory.glob(f"{sha256}.*{_PART}"):  # of a worker that was killed; the lock is ours
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
        """Deletes the scenes used longest ago until the folder fits; never the one just asked for."""
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
        return "free some space there, or set MINIVLA_CACHE to another folder"
    return "set MINIVLA_CACHE to a writable folder"
