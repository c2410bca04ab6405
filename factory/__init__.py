"""Top package: command line, runs on one machine, scenes, dataset reader, exports, training and evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from factory.dataset.reader import Dataset

__all__ = ["Dataset"]


def __getattr__(name: str) -> Any:
    """Imports the reader at its first use, so `import factory` stays light."""
    if name == "Dataset":
        from factory.dataset.reader import Dataset

        return Dataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
