"""Files of a scene cache: written whole or not at all; what a stage was compiled to is remembered beside the package.

Knows no stage: it is told the digest of all that goes into a package.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from schemas.errors import WorldError

__all__ = ["mark_as_last", "package_name", "recall_package", "remember_package", "write_whole"]

_DIGITS = 12


def package_name(scene: str, digest: str) -> str:
    """Returns the name of a package's file."""
    return f"{scene}-{digest[:_DIGITS]}.scene.zip"


def recall_package(cache: Path, scene: str, made_from: str) -> Path | None:
    """Returns the package that was compiled from the same before.

    Args:
        cache: directory of packages.
        scene: name of the scene.
        made_from: SHA-256 of all that goes in.

    Returns:
        Its path, or `None` when there is none or its bytes are not those that its name says.
    """
    try:
        package = cache / _mark(cache, scene, made_from).read_text(encoding="utf-8")
        with package.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None
    return package if package.name == package_name(scene, digest) else None


def mark_as_last(package: Path) -> None:
    """Makes a package the one that was imported last under its name."""
    with suppress(PermissionError):  # a cache that is shared read-only may be used all the same
        os.utime(package)


def remember_package(cache: Path, scene: str, made_from: str, package: Path) -> None:
    """Notes what a package was compiled from.

    Raises:
        WorldError: the cache cannot be written.
    """
    write_whole(_mark(cache, scene, made_from), package.name.encode())


def _mark(cache: Path, scene: str, made_from: str) -> Path:
    return cache / f"{scene}-{made_from[:32]}.made"


def write_whole(path: Path, data: bytes) -> None:
    """Writes beside, syncs, renames.

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
            f"cannot write {path} ({error.strerror}); free some space, or choose another folder with --out"
        ) from error
