"""Reads and writes `gateway.json`, which records the run and the gateway that own a directory.

The file prevents a gateway from using the episodes of another run or gateway.
"""

from __future__ import annotations

import json
from pathlib import Path

from schemas.errors import UsageError
from schemas.storage.disk import sync_directory, sync_file, translated

__all__ = ["OWNER_FILE", "has_owner", "require_owner", "write_owner"]

OWNER_FILE = "gateway.json"
"""Name of the file in the directory of a gateway."""


def has_owner(root: Path) -> bool:
    """Returns whether the directory has an owner file."""
    return (root / OWNER_FILE).exists()


def require_owner(root: Path, run: str, gateway: str) -> None:
    """Checks that a directory with an owner file belongs to this run and gateway.

    Raises:
        UsageError: the directory belongs to another run or gateway, or the file cannot be read.
    """
    if not has_owner(root):
        return
    try:
        found = json.loads((root / OWNER_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{root / OWNER_FILE} cannot be read: {error}; give the --out of a gateway, or a new directory"
        ) from error
    if found != {"run": run, "gateway": gateway}:
        raise UsageError(
            f"{root} belongs to {found}, not to gateway {gateway!r} of run {run!r}: choose another --out or --name"
        )


def write_owner(root: Path, run: str, gateway: str) -> None:
    """Writes the owner file durably. Does nothing if the file exists.

    Raises:
        WorldError: the file cannot be written.
    """
    if has_owner(root):
        return
    part = root / f".{OWNER_FILE}.part"
    with translated("write", root / OWNER_FILE):
        part.write_text(json.dumps({"run": run, "gateway": gateway}), encoding="utf-8")
        sync_file(part)
        part.replace(root / OWNER_FILE)
        sync_directory(root)
