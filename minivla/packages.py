"""Checks that Python imports the product's packages, and not packages of the same name from another distribution.

Does not import them, and does not change `sys.path` or `sys.modules`.

Design: docs/design/program.md#the-import-name-minivla.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib import metadata
from importlib.machinery import ModuleSpec
from pathlib import Path

NAMES = ("schemas", "coordinator", "workers", "factory")
"""Names of the product's packages."""
_ROOT = Path(__file__).resolve().parent.parent


def require_own_packages(root: Path = _ROOT) -> None:
    """Checks that each package in `NAMES` is imported from the installation that contains this file.

    A package whose `__init__.py` was overwritten in place (factory_boy does this to `factory`) passes, because its
    modules still exist.

    Args:
        root: directory that contains the product's packages.

    Raises:
        ImportError: another package or module of that name is found first; the message names it and the remedy.
    """
    for name in NAMES:
        locations = _locations(name)
        if root / name not in locations:
            raise ImportError(_message(name, root, locations), name=name)


def _locations(name: str) -> list[Path]:
    module = sys.modules.get(name)
    spec = module.__spec__ if module is not None else importlib.util.find_spec(name)
    return _places_of(spec)


def _places_of(spec: ModuleSpec | None) -> list[Path]:
    if spec is None:
        return []
    locations = list(spec.submodule_search_locations or ()) or [spec.origin or ""]
    return [Path(place).resolve() for place in locations]


def _message(name: str, root: Path, locations: list[Path]) -> str:
    if not locations:
        return f"minivla-factory is incomplete: its package {name!r} is missing in {root}; install it again"
    foreign = locations[0]
    owner = _distribution_of(name, foreign)
    whose = f", which the package {owner} installed" if owner else ""
    remedy = (
        f"uninstall {owner}, or use a separate virtual environment"
        if owner
        else "rename it, or start Python in another directory and without it on PYTHONPATH"
    )
    return f"minivla-factory needs its package {name!r} in {root}, but Python imports {foreign}{whose}; {remedy}"


def _distribution_of(name: str, place: Path) -> str | None:
    for owner in metadata.packages_distributions().get(name, ()):
        if owner != "minivla-factory" and place.is_relative_to(Path(str(metadata.distribution(owner).locate_file("")))):
            return owner
    return None
