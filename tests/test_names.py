"""Names and sizes across the product, read from the source: unique class names, small folders, files and functions."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from pathlib import Path

from tests.test_layering import ROOT, parsed, sources

MOST_MODULES = 17
MOST_FILE_LINES = 350
MOST_FUNCTION_LINES = 60


def public_classes(path: Path) -> list[str]:
    """Names of the classes that a module defines at its top level."""
    tree = parsed(path)
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


def test_no_file_has_more_lines_than_the_limit() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in sources()}
    assert {path: length for path, length in lengths.items() if length > MOST_FILE_LINES} == {}


def test_no_function_has_more_lines_than_the_limit() -> None:
    """The lines of docstrings do not count."""
    found = {}
    for path in sources():
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                first, last = node.body[0], node.end_lineno or node.lineno
                written = (first.end_lineno or first.lineno) - first.lineno + 1 if ast.get_docstring(node) else 0
                found[f"{path.relative_to(ROOT)}:{node.name}"] = last - node.lineno + 1 - written
    assert {name: length for name, length in found.items() if length > MOST_FUNCTION_LINES} == {}
