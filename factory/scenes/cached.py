"""Reads and writes the files of a scene cache atomically, with a marker file for the inputs of each imported package.

Does not read stages; callers pass the digest of all inputs of a package.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from schemas.errors import WorldError

_DIGITS = 12


def package_name(scene: str, digest: str) -> str:
    return f"{scene}-{digest[:_DIGITS]}.scene.zip"


def recall_package(cache: Path, scene: str, made_from: str) -> Path | None:
    """Returns the cached package that was compiled from the same inputs.

    Args:
        cache: directory of packages.
        scene: name of the scene.
        made_from: SHA-256 of all inputs.

    Returns:
        Its path, or `None` when it does not exist or its digest differs from the one in its name.
    """
    try:
        package = cache / _mark(cache, scene, made_from).read_text(encoding="utf-8")
        with package.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None
    return package if package.name == package_name(scene, digest) else None


def mark_as_last(package: Path) -> None:
    """Updates the modification time of a package, so it is the latest import of its name."""
    with suppress(PermissionError):  # a shared read-only cache is allowed
        os.utime(package)


def remember_package(cache: Path, scene: str, made_from: str, package: Path) -> None:
    """Writes the marker file that maps inputs to a package.

    Raises:
        WorldError: the cache cannot be written.
    """
    write_whole(_mark(cache, scene, made_from), package.name.encode())


def _mark(cache: Path, scene: str, made_from: str) -> Path:
    return cache / f"{scene}-{made_from[:32]}.made"


def write_whole(path: Path, data: bytes) -> None:
    """Writes a file atomically: temporary file, fsync, rename.

    Raises:
        WorldError: the cache cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(prefix=path.name, suffix=".part", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(beside).chmod(0o644)
            Path(beside).replace(path)
        finally:
            Path(beside).unlink(missing_ok=True)
    except OSError as error:
        raise WorldError(
            f"cannot write {path} ({error.strerror}); free some space, or choose another folder: MINIVLA_CACHE, or "
            "--out of a scene command"
        ) from error
