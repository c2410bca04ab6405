"""Taxonomy of object categories: the superclass and the synonyms of each category. Reads `taxonomy.toml` once."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

_FILE = Path(__file__).with_name("taxonomy.toml")


class CategoryKind(NamedTuple):
    """Place of a category in the taxonomy."""

    superclass: str
    """Name of the superclass, such as `seat` for a chair."""
    synonyms: tuple[str, ...]
    """Other English names of the category, in singular."""


@cache
def load_taxonomy() -> Mapping[str, CategoryKind]:
    """Returns the place of every category by its name."""
    table = tomllib.loads(_FILE.read_text(encoding="utf-8"))
    return MappingProxyType(
        {
            category: CategoryKind(superclass, tuple(synonyms))
            for superclass, categories in table.items()
            for category, synonyms in categories.items()
        }
    )


def category_of(name: str) -> str | None:
    """Returns the category with a name or synonym, in any case, with spaces or underscores; `None` for other names."""
    said = name.lower().replace("_", " ")
    for category, kind in load_taxonomy().items():
        if said == category.replace("_", " ") or said in kind.synonyms:
            return category
    return None
