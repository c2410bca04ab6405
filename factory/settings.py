"""Where this user's caches live. The only reader of the environment on this side."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

__all__ = ["cache_directory", "scene_cache"]


def cache_directory() -> Path:
    """Returns the folder for what can be made again; `MINIVLA_CACHE` overrides the platform's place."""
    chosen = os.environ.get("MINIVLA_CACHE")
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("minivla-factory"))


def scene_cache() -> Path:
    """Returns the folder of compiled scenes."""
    return cache_directory() / "scenes"
