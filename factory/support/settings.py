"""Where this user's caches and state live. The only reader of the environment on this side."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

__all__ = ["cache_directory", "scene_cache", "state_directory", "store_endpoint"]


def cache_directory() -> Path:
    """Returns the folder for what can be made again; `MINIVLA_CACHE` overrides the platform's place."""
    chosen = os.environ.get("MINIVLA_CACHE")
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("minivla-factory"))


def state_directory() -> Path:
    """Returns the folder for what must not be lost; `MINIVLA_STATE` overrides the platform's place."""
    chosen = os.environ.get("MINIVLA_STATE")
    return Path(chosen) if chosen else Path(platformdirs.user_state_dir("minivla-factory"))


def store_endpoint() -> str:
    """Returns the S3 server that the user has chosen; empty for the cloud's own."""
    return os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL", "")


def scene_cache() -> Path:
    """Returns the folder of compiled scenes."""
    return cache_directory() / "scenes"
