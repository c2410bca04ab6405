"""Names and sizes across the product, read from the source: one public class a name, few modules a folder."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from pathlib import Path

from tests.test_layering import ROOT, sources

MOST_MODULES = 17


def public_classes(path: Path) -> list[str]:
    """Names of the classes that a module defines at its top level."""
    tree = ast.parse(path.read_text())
    return [node.name for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]


def test_a_public_class_name_is_defined_once_in_the_product() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for path in sources():
        for name in public_classes(path):
            places[name].append(str(path.relative_to(ROOT)))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_no_folder_has_more_modules_than_the_limit() -> None:
    counts = Counter(str(path.parent.relative_to(ROOT)) for path in sources() if path.name != "__init__.py")
    assert {folder: count for folder, count in counts.items() if count > MOST_MODULES} == {}
