"""Whose a gateway's directory is: a small file names run and gateway, so that neither takes up another's episodes."""

from __future__ import annotations

import json
from pathlib import Path

from schemas.errors import UsageError
from schemas.storage.disk import sync_directory, sync_file, translated

__all__ = ["TITLE", "holds_title", "require_title", "write_title"]

TITLE = "gateway.json"


def holds_title(root: Path) -> bool:
    """Returns whether a gateway has worked in the directory before."""
    return (root / TITLE).exists()


def require_title(root: Path, run: str, gateway: str) -> None:
    """Makes sure that a directory which has a title has this one.

    Raises:
        UsageError: it belongs to another run or gateway, or cannot be read.
    """
    if not holds_title(root):
        return
    try:
        found = json.loads((root / TITLE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{root / TITLE} cannot be read: {error}; give the --out of a gateway, or a new directory"
        ) from error
    if found != {"run": run, "gateway": gateway}:
        raise UsageError(
            f"{root} belongs to {found}, not to gateway {gateway!r} of run {run!r}: choose another --out or --name"
        )


def write_title(root: Path, run: str, gateway: str) -> None:
    """Writes the title, durably; does nothing when it stands there.

    Raises:
        WorldError: the disk refuses.
    """
    if holds_title(root):
        return
    part = root / f".{TITLE}.part"
    with translated("write", root / TITLE):
        part.write_text(json.dumps({"run": run, "gateway": gateway}), encoding="utf-8")
        sync_file(part)
        part.replace(root / TITLE)
        sync_directory(root)
