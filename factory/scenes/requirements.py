"""Packages that building a scene needs. Imports none of them."""

from __future__ import annotations

from importlib.util import find_spec

from schemas.support.extras import require_package

_BUILDING = ("pxr", "mapbox_earcut", "embreex", "defusedxml", "collada")


def can_build() -> bool:
    """Returns whether the packages that building a scene needs are installed."""
    return all(find_spec(module) is not None for module in _BUILDING)


def require_building() -> None:
    """Checks that the packages that building a scene needs are installed.

    Raises:
        UsageError: a package is not installed; the message names the extra.
    """
    for module in _BUILDING:
        require_package(module, "building a scene")
