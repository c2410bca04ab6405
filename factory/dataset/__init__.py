"""Reads datasets: metadata rows, episodes, frames and PyTorch samples. Writes no files."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from factory.dataset.reader import Dataset, Episode, Frame

__all__ = ["Dataset", "Episode", "Frame"]


def __getattr__(name: str) -> Any:
    """Imports the reader on first access, so importing a sibling module does not load it."""
    if name in __all__:
        return getattr(importlib.import_module("factory.dataset.reader"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
