"""Packages that only an extra brings: looked for before anything is begun. Imports none of them."""

from __future__ import annotations

import importlib.util

from schemas.errors import UsageError

__all__ = ["require_package"]


def require_package(module: str, extra: str, who: str) -> None:
    """Makes sure that a package is installed.

    Args:
        module: its top-level module.
        extra: which brings it.
        who: needs it.

    Raises:
        UsageError: it is not; the message names the extra.
    """
    if importlib.util.find_spec(module) is None:
        raise UsageError(f"{who} needs the package {module}: pip install 'minivla-factory[{extra}]'")
