"""Finds system tools (ip, tc, mount, initdb ...) that are not on the PATH of a user without administration rights."""

from __future__ import annotations

import os

_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")


def find_system_tools() -> None:
    """Appends the folders of administration tools to the PATH of this process and its children."""
    path = os.environ.get("PATH", os.defpath).split(os.pathsep)
    os.environ["PATH"] = os.pathsep.join([*path, *(folder for folder in _FOLDERS if folder not in path)])
