"""Reads datasets: rows, episodes, frames, PyTorch samples."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from factory.dataset.reader import Dataset, Episode, Frame

__all__ = ["Dataset", "Episode", "Frame"]


def __getattr__(name: str) -> Any:
    """Imports the reader at its first use, so that its neighbours load without it."""
    if name in __all__:
        return getattr(importlib.import_module("factory.dataset.reader"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
