"""Whose a gateway's directory is: a small file names run and gateway, so that neither takes up another's episodes."""

from __future__ import annotations

import json
from pathlib import Path

from schemas.errors import UsageError
from schemas.storage.disk import sync_directory, sync_file, translated

__all__ = ["OWNER_FILE", "has_owner", "require_owner", "write_owner"]

OWNER_FILE = "gateway.json"


def has_owner(root: Path) -> bool:
    """Returns whether a gateway has worked in the directory before."""
    return (root / OWNER_FILE).exists()


def require_owner(root: Path, run: str, gateway: str) -> None:
    """Makes sure that a directory which has a title has this one.

    Raises:
        UsageError: it belongs to another run or gateway, or cannot be read.
    """
    if not has_owner(root):
        return
    try:
        found = json.loads((root / OWNER_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{root / OWNER_FILE} cannot be read: {error}; give the directory of a gateway, or a new one"
        ) from error
    if found != {"run": run, "gateway": gateway}:
        raise UsageError(
            f"{root} belongs to {found}, asked for gateway {gateway!r} of run {run!r}: choose another --out or --name"
        )


def write_owner(root: Path, run: str, gateway: str) -> None:
    """Writes the title, durably; does nothing when it stands there.

    Raises:
        WorldError: the disk refuses.
    """
    if has_owner(root):
        return
    part = root / f".{OWNER_FILE}.part"
    with translated("write", root / OWNER_FILE):
        part.write_text(json.dumps({"run": run, "gateway": gateway}), encoding="utf-8")
        sync_file(part)
        part.replace(root / OWNER_FILE)
        sync_directory(root)
