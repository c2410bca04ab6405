"""Finds the system's tools (ip, tc, mount, initdb ...) where an ordinary user's PATH does not lead."""

from __future__ import annotations

import os

__all__ = ["find_system_tools"]

_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")


def find_system_tools() -> None:
    """Appends the folders of administration tools to this process's PATH, for it and for what it starts."""
    path = os.environ.get("PATH", os.defpath).split(os.pathsep)
    os.environ["PATH"] = os.pathsep.join([*path, *(folder for folder in _FOLDERS if folder not in path)])
