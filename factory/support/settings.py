"""Reads the locations of caches and state from the environment. No other module of `factory` reads the environment."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_directory() -> Path:
    """Returns the folder of data that can be recreated; `MINIVLA_CACHE` overrides the platform's default."""
    chosen = os.environ.get("MINIVLA_CACHE")
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("minivla-factory"))


def state_directory() -> Path:
    """Returns the folder of data that must be kept; `MINIVLA_STATE` overrides the platform's default."""
    chosen = os.environ.get("MINIVLA_STATE")
    return Path(chosen) if chosen else Path(platformdirs.user_state_dir("minivla-factory"))


def store_endpoint() -> str:
    """Returns the URL of the S3 server set by the user; an empty string means the provider's default."""
    return os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL", "")


def scene_cache() -> Path:
    return cache_directory() / "scenes"


def scene_path() -> tuple[Path, ...]:
    """Returns the folders of `MINIVLA_SCENES`, in which scene packages are searched after the dataset itself."""
    return tuple(Path(folder) for folder in os.environ.get("MINIVLA_SCENES", "").split(os.pathsep) if folder)


def read_renderer() -> str:
    """Returns the renderer for episodes that store no frames; `MINIVLA_RENDERER` overrides the default, `gl`."""
    return os.environ.get("MINIVLA_RENDERER") or "gl"
