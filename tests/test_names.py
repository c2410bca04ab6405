"""Names and sizes across the product, read from the source: unique class names, sizes of modules and functions."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from pathlib import Path

from tests.test_layering import DOORS, ROOT, imports_of, module_name, parsed, sources

MOST_FILE_LINES = 600
SMALL_LINES = 60
"""A module with fewer lines is a fragment of another one, unless there is a reason to keep it apart."""
MOST_FUNCTION_LINES = 60
REGISTERED = (
    "factory/cli/",  # the table of the verbs
    "factory/report/figures/",  # the registry of the figures
    "factory/scenes/author/props/",  # the catalogue of the props
    "factory/web/pages/",  # the routes of the web page
    "workers/experts/",  # the registry of the experts
)
"""Folders whose modules are registered by name, so a small one may have a single importer."""
STARTED = {"factory/__main__.py", "minivla/command.py", "minivla/gym.py"}
"""Modules that an interpreter, a script or a user starts or imports by name."""


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


def test_a_small_module_has_two_importers_or_a_reason() -> None:
    importers = Counter(name for path in sources() for name in imports_of(path) - {module_name(path)})
    fragments = [
        str(path.relative_to(ROOT))
        for path in sources()
        if path.name != "__init__.py"
        and len(path.read_text().splitlines()) < SMALL_LINES
        and importers[module_name(path)] < 2
        and not set(DOORS) & {name.split(".")[0] for name in imports_of(path)}
    ]
    assert [path for path in fragments if not path.startswith(REGISTERED) and path not in STARTED] == []


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


def test_no_message_shows_the_representation_of_an_enum() -> None:
    trees = {path: parsed(path) for path in sources()}
    classes = [node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    enums = {one.name for one in classes if {ast.unparse(base) for base in one.bases} & {"Enum", "IntEnum", "StrEnum"}}
    assert {"Verb", "Role", "Split"} <= enums
    found = {
        f"{path.relative_to(ROOT)}: {name!r}"
        for path, tree in trees.items()
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for name in shown_by_representation(function)
        & {
            argument.arg
            for argument in (*function.args.args, *function.args.kwonlyargs)
            if argument.annotation is not None and ast.unparse(argument.annotation) in enums - assigned(tree)
        }
    }
    assert found == set()


def assigned(tree: ast.Module) -> set[str]:
    """Returns the names that a module assigns at its top level, such as a `Literal` with the name of an enum."""
    targets = (target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets)
    return {ast.unparse(target) for target in targets}


def shown_by_representation(function: ast.FunctionDef) -> set[str]:
    """Returns the expressions that a function formats with `!r`."""
    return {
        ast.unparse(node.value)
        for node in ast.walk(function)
        if isinstance(node, ast.FormattedValue) and node.conversion == ord("r")
    }
